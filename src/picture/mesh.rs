//! Panel meshes, coloured by planarity.

use super::canvas::{Brush, Corner, DepthBuffer, Frame, Picture, mix, shaded};
use super::lettering::{draw_text, text_width};
use crate::mesh::PanelMesh;
use crate::sketch::View;
use nalgebra::{Point3, Vector3};

const EDGE: [u8; 3] = [38, 46, 56];
const BORDER: [u8; 3] = [10, 14, 20];
const IRREGULAR: [u8; 3] = [214, 30, 120];
/// Tint of panels seen from behind.
const BACK: [u8; 3] = [120, 112, 190];

/// Half the width of a line between two panels, and width of the border, pixels.
const EDGE_WIDTH: f64 = 0.6;
const BORDER_WIDTH: f64 = 2.0;

/// One mesh of a picture and what is marked on it.
#[derive(Clone, Copy, Debug)]
pub struct MeshPart<'a> {
    /// Panels, world frame.
    pub mesh: &'a PanelMesh,
    /// Planarity of each face; a missing one counts as 0.
    pub planarity: &'a [f64],
    /// Vertices to mark as irregular.
    pub irregular: &'a [u32],
}

/// Colour of a planarity value: green up to 1e-6, over yellow at 1e-4, to red from 1e-2; linear in its logarithm.
pub fn planarity_color(planarity: f64) -> [u8; 3] {
    let stops = [[118, 196, 150], [188, 216, 132], [246, 214, 112], [238, 150, 86], [212, 66, 62]];
    let t = ((planarity.max(1e-300).log10() + 6.0) / 4.0).clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let k = (t as usize).min(stops.len() - 2);
    mix(stops[k], stops[k + 1], t - k as f64)
}

/// Draws panel meshes, seen along `view`: flat panels in the colour of their planarity, tinted violet from behind, dark edges, a bold border,
/// irregular vertices as dots. What lies behind is hidden.
pub fn mesh_picture(parts: &[MeshPart], view: &View, frame: &Frame) -> Picture {
    let mut buffer = DepthBuffer::new(frame);
    for part in parts {
        draw_panels(&mut buffer, part, view);
    }
    for part in parts {
        for &v in part.irregular {
            let Some(point) = part.mesh.vertices.get(v as usize) else { continue };
            let p = view.world_to_camera(point);
            buffer.line([p, p], 9.0, [255; 3], 0, 8.0 / frame.scale);
            buffer.line([p, p], 6.5, IRREGULAR, 0, 9.0 / frame.scale);
        }
    }
    buffer.resolve(1.0)
}

fn draw_panels(buffer: &mut DepthBuffer, part: &MeshPart, view: &View) {
    let mesh = part.mesh;
    let camera: Vec<Point3<f64>> = mesh.vertices.iter().map(|p| view.world_to_camera(p)).collect();
    let border = border_sides(mesh);
    let density = buffer.samples_per_pixel();
    for (f, face) in mesh.faces().enumerate() {
        let points: Vec<Point3<f64>> = face.iter().map(|&v| camera[v as usize]).collect();
        let normal = area_vector(&points);
        let base = planarity_color(part.planarity.get(f).copied().unwrap_or(0.0));
        let color = shaded(if normal.z >= 0.0 { base } else { mix(base, BACK, 0.6) }, &normal, 0.55, 0.0);
        let places: Vec<[f64; 2]> = points.iter().map(|p| buffer.place(p)).collect();
        let sides: Vec<_> = (0..face.len())
            .map(|k| {
                let (width, line) =
                    if border[mesh.starts[f] as usize + k] { (BORDER_WIDTH, BORDER) } else { (EDGE_WIDTH, EDGE) };
                (places[k], places[(k + 1) % face.len()], width * density, line)
            })
            .collect();
        for triangle in triangulated(&points, &normal) {
            let corners = triangle.map(|k| Corner { position: points[k], normal });
            // Each panel draws its half of the lines around it: hidden lines vanish with their panels.
            buffer.triangle(&corners, 0, 0.0, |fragment| {
                let mut result = color;
                for (a, b, width, line) in &sides {
                    let cover = (width + 0.5 - distance(fragment.place, *a, *b)).clamp(0.0, 1.0);
                    result = mix(result, *line, cover);
                }
                result
            });
        }
    }
}

/// Draws the colour scale of planarity, `width` pixels wide, its upper left corner at (x, y); about 40 pixels high.
pub(crate) fn draw_legend(brush: &mut Brush, [x, y]: [f64; 2], width: f64) {
    let steps = 160;
    for k in 0..steps {
        let t = (k as f64 + 0.5) / steps as f64;
        let left = x + width * k as f64 / steps as f64;
        // A little wider than a step, so that no seam shows.
        brush.rectangle([left, y], [width / steps as f64 + 0.6, 12.0], planarity_color(10f64.powf(-6.0 + 4.0 * t)));
    }
    for k in 0..5 {
        let label = format!("1e-{}", 6 - k);
        let at = x + width * k as f64 / 4.0;
        brush.rectangle([at - 0.5, y + 12.0], [1.0, 4.0], EDGE);
        let shift = text_width(&label, 9.0) * k as f64 / 4.0;
        draw_text(brush, &label, [at - shift, y + 31.0], 9.0, EDGE);
    }
}

/// For each corner of each face whether the side from it to the next corner belongs to no other face.
fn border_sides(mesh: &PanelMesh) -> Vec<bool> {
    let mut sides: Vec<([u32; 2], usize)> = vec![];
    for (f, face) in mesh.faces().enumerate() {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            sides.push(([a.min(b), a.max(b)], mesh.starts[f] as usize + k));
        }
    }
    sides.sort_unstable();
    let mut border = vec![false; mesh.indices.len()];
    for group in sides.chunk_by(|a, b| a.0 == b.0) {
        if let [(_, corner)] = group {
            border[*corner] = true;
        }
    }
    border
}

fn area_vector(points: &[Point3<f64>]) -> Vector3<f64> {
    (1..points.len().saturating_sub(1)).map(|k| (points[k] - points[0]).cross(&(points[k + 1] - points[0]))).sum()
}

fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (along, to) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
    let t = ((to[0] * along[0] + to[1] * along[1]) / length).clamp(0.0, 1.0);
    (to[0] - t * along[0]).hypot(to[1] - t * along[1])
}

/// Triangles of a polygon that may have inward corners, by cutting ears in the plane of `normal`.
pub(crate) fn triangulated(points: &[Point3<f64>], normal: &Vector3<f64>) -> Vec<[usize; 3]> {
    let mut left: Vec<usize> = (0..points.len()).collect();
    let turn = |a: usize, b: usize, c: usize| (points[b] - points[a]).cross(&(points[c] - points[b])).dot(normal);
    let mut triangles = Vec::with_capacity(points.len().saturating_sub(2));
    while left.len() > 3 {
        let count = left.len();
        let ear = (0..count).find(|&k| {
            let [a, b, c] = [left[(k + count - 1) % count], left[k], left[(k + 1) % count]];
            let inside = |p: usize| turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
            turn(a, b, c) > 0.0 && !left.iter().any(|&p| p != a && p != b && p != c && inside(p))
        });
        // A polygon that crosses itself has no ear left: any corner will do.
        let k = ear.unwrap_or(0);
        triangles.push([left[(k + count - 1) % count], left[k], left[(k + 1) % count]]);
        left.remove(k);
    }
    if let [a, b, c] = left[..] {
        triangles.push([a, b, c]);
    }
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arrowhead_is_cut_inside() {
        let points = [[0.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.5, 1.0, 0.0]].map(Point3::from);
        let normal = area_vector(&points);
        let area: f64 = triangulated(&points, &normal).iter().map(|t| area_vector(&t.map(|k| points[k])).z / 2.0).sum();
        assert!((area - 1.5).abs() < 1e-12);
        for t in triangulated(&points, &normal) {
            assert!(area_vector(&t.map(|k| points[k])).z > 0.0);
        }
    }

    #[test]
    fn planarity_runs_from_green_to_red() {
        assert_eq!(planarity_color(0.0), planarity_color(1e-7));
        assert_eq!(planarity_color(1.0), planarity_color(1e-2));
        let (green, red) = (planarity_color(1e-6), planarity_color(1e-2));
        assert!(green[1] > green[0] && red[0] > red[1] + 100);
    }
}
