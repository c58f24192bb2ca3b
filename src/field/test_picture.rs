//! Contact sheets of fields, for looking at them: run the ignored test `draw_fields` with `FIELD_PICTURE` set to a file name.

use super::conjugate::second_forms;
use super::conjugate_field::ConjugateField;
use super::smooth::DirectionConstraint;
use super::topology::TriangleFrames;
use super::trace::trace_both_ways;
use nalgebra::{Point3, Vector3};
use tiny_skia::{Color, FillRule, Paint, PathBuilder, Pixmap, Stroke, Transform};

/// Side of one picture on the sheet, pixels.
pub const SIDE: f32 = 560.0;

/// Draws streamlines of both families (blue, brown), singularities (red +, blue -), constraints (green), and the sign of the Gaussian curvature
/// (bluish negative, yellowish positive), looked at from obliquely above, into cell (column, row) of `sheet`.
pub fn draw(sheet: &mut Pixmap, cell: [f32; 2], field: &ConjugateField, constraints: &[DirectionConstraint]) {
    let axes = [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 0.85, 0.53), Vector3::new(0.0, -0.53, 0.85)];
    let flat = |p: &Point3<f64>| [p.coords.dot(&axes[0]), p.coords.dot(&axes[1])];
    let all: Vec<[f64; 2]> = field.mesh.points.iter().map(|p| flat(&p.position)).collect();
    let low = [0, 1].map(|k| all.iter().map(|p| p[k]).fold(f64::MAX, f64::min));
    let high = [0, 1].map(|k| all.iter().map(|p| p[k]).fold(f64::MIN, f64::max));
    let scale = (f64::from(SIDE) - 30.0) / (high[0] - low[0]).max(high[1] - low[1]);
    let place = |p: &Point3<f64>| {
        let q = flat(p);
        let x = cell[0] * SIDE + 15.0 + ((q[0] - low[0]) * scale) as f32;
        let y = (cell[1] + 1.0) * SIDE - 15.0 - ((q[1] - low[1]) * scale) as f32;
        (x, y)
    };
    let frames = TriangleFrames::new(&field.mesh, &field.edges).unwrap();
    let forms = second_forms(&field.mesh, &frames);
    let flat_triangles = &field.diagnostics.flat_triangles;
    let mut order: Vec<usize> = (0..forms.len()).collect();
    let depth = |t: usize| -> f64 {
        field.mesh.triangles[t].iter().map(|&v| field.mesh.position(v).coords.dot(&axes[2])).sum()
    };
    order.sort_by(|&a, &b| depth(a).total_cmp(&depth(b)));
    for t in order {
        let k = (forms[t].h.powi(2) - forms[t].deviator().powi(2)) / (forms[t].norm().powi(2) * 0.5 + 1e-30);
        let shade = (0.75 + 0.25 * frames.normals[t].dot(&Vector3::new(0.4, -0.3, 0.86))) as f32;
        let (r, g, b) = if flat_triangles.binary_search(&(t as u32)).is_ok() {
            (0.7, 0.7, 0.7)
        } else if k > 0.0 {
            (1.0, 1.0, 1.0 - 0.35 * k as f32)
        } else {
            (1.0 + 0.3 * k as f32, 1.0 + 0.15 * k as f32, 1.0)
        };
        let [p, q, s] = field.mesh.triangles[t].map(|v| place(&field.mesh.position(v)));
        let mut path = PathBuilder::new();
        path.move_to(p.0, p.1);
        path.line_to(q.0, q.1);
        path.line_to(s.0, s.1);
        path.close();
        let mut paint = Paint::default();
        paint.set_color(Color::from_rgba(r * shade, g * shade, b * shade, 1.0).unwrap());
        paint.anti_alias = false;
        sheet.fill_path(&path.finish().unwrap(), &paint, FillRule::Winding, Transform::identity(), None);
    }
    let mut line = |points: &[Point3<f64>], color: [u8; 3], width: f32| {
        let mut path = PathBuilder::new();
        for (i, p) in points.iter().enumerate() {
            let (x, y) = place(p);
            if i == 0 { path.move_to(x, y) } else { path.line_to(x, y) }
        }
        if let Some(path) = path.finish() {
            let mut paint = Paint::default();
            paint.set_color_rgba8(color[0], color[1], color[2], 255);
            paint.anti_alias = true;
            let stroke = Stroke { width, ..Stroke::default() };
            sheet.stroke_path(&path, &paint, &stroke, Transform::identity(), None);
        }
    };
    // Streamlines from seeds far enough from the lines of their family so far.
    let size = frames.areas.iter().sum::<f64>().sqrt();
    let spacing = size / 22.0;
    let mut drawn: [Vec<Point3<f64>>; 2] = [vec![], vec![]];
    let count = field.mesh.triangles.len();
    for i in 0..count {
        let t = (i * 7919) % count;
        for k in 0..2 {
            // A seed's u may belong to the family that elsewhere is called v: compare directions through both lists.
            let corners = field.mesh.triangles[t].map(|v| field.mesh.position(v).coords);
            let seed = Point3::from((corners[0] + corners[1] + corners[2]) / 3.0);
            let direction = field.directions[t][k];
            let crowded = drawn.iter().flatten().collect::<Vec<_>>().windows(2).any(|w| {
                let tangent = w[1] - w[0];
                (w[0] - seed).norm() < spacing
                    && tangent.norm() < 0.2 * size
                    && tangent.normalize().dot(&direction).abs() > 0.8
            });
            if !crowded {
                let trace = trace_both_ways(field, t as u32, [1.0 / 3.0; 3], k, 2.0 * size);
                line(&trace.points, if k == 0 { [30, 70, 170] } else { [150, 80, 20] }, 1.2);
                drawn[k].extend(trace.points);
            }
        }
    }
    for constraint in constraints {
        let corners = field.mesh.triangles[constraint.triangle as usize].map(|v| field.mesh.position(v).coords);
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        let d = constraint.direction.normalize() * size * 0.015;
        line(&[Point3::from(middle - d), Point3::from(middle + d)], [0, 140, 30], 3.5);
    }
    for s in &field.singularities {
        let (x, y) = place(&field.mesh.position(s.vertex));
        let mut paint = Paint::default();
        let color = if s.index > 0 { [230, 20, 20] } else { [20, 20, 230] };
        paint.set_color_rgba8(color[0], color[1], color[2], 255);
        let path = PathBuilder::from_circle(x, y, 3.0 + 2.0 * s.index.abs() as f32).unwrap();
        sheet.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
    }
    for &t in &field.diagnostics.floor_triangles {
        let (x, y) = place(&field.mesh.position(field.mesh.triangles[t as usize][0]));
        let mut paint = Paint::default();
        paint.set_color_rgba8(230, 0, 230, 255);
        let path = PathBuilder::from_circle(x, y, 2.0).unwrap();
        sheet.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
    }
}
