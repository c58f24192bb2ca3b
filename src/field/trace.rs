//! Curves that follow one family of a field.

use super::conjugate_field::ConjugateField;
use nalgebra::{Point3, Vector3};

/// Why a trace ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TraceEnd {
    /// At the border of the surface.
    Border,
    /// At the length that was asked for.
    Length,
    /// After as many triangles as a sensible curve could cross: it runs in circles.
    Circling,
}

/// A polyline on the surface that follows one family.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// Points on the triangles, one more than `triangles`.
    pub points: Vec<Point3<f64>>,
    /// Surface parameters (u, v) of the points.
    pub parameters: Vec<[f64; 2]>,
    /// The triangle of each segment.
    pub triangles: Vec<u32>,
    /// Length in the unit of the mesh.
    pub length: f64,
    /// Why it ended; of a trace both ways, at its two ends.
    pub ends: [TraceEnd; 2],
}

/// Follows a direction from a point on a triangle, until the border or `length`.
///
/// - `barycentric`: weights of the triangle's vertices, sum 1; moved inside the triangle where not.
/// - `direction`: the number of the direction among (u, v, -u, -v), mod 4.
///
/// Inside a triangle the curve is straight; across an edge the matching says which direction continues it. Where the directions of the two
/// triangles both point at their edge, the curve crosses it straight on.
///
/// # Panics
/// If there is no such triangle.
pub fn trace(field: &ConjugateField, triangle: u32, barycentric: [f64; 3], direction: usize, length: f64) -> Trace {
    let mesh = &field.mesh;
    let weights = inside(barycentric);
    let mut t = triangle;
    let mut family = direction;
    let corners = mesh.triangles[t as usize];
    let mut point = combine(weights, corners.map(|v| mesh.position(v).coords));
    let mut parameters = [0, 1].map(|k| (0..3).map(|i| weights[i] * mesh.parameters[corners[i] as usize][k]).sum());
    let mut heading = field.direction(t, family);
    let mut result = Trace {
        points: vec![Point3::from(point)],
        parameters: vec![parameters],
        triangles: vec![],
        length: 0.0,
        ends: [TraceEnd::Length; 2],
    };
    let mut entered: Option<u32> = None;
    let most = 8 * (mesh.cells[0] + mesh.cells[1] + 16);
    while result.length < length {
        if result.triangles.len() >= most {
            result.ends[1] = TraceEnd::Circling;
            break;
        }
        let normal = mesh.triangle_normal_area(t as usize).0;
        let corners = mesh.triangles[t as usize];
        // The edge through which the ray leaves: the nearest one that it approaches from inside.
        let mut exit = (f64::INFINITY, 0, 0.0);
        for k in 0..3 {
            if entered == Some(field.edges.triangle_edges[t as usize][k]) {
                continue;
            }
            let [a, b] = [corners[k], corners[(k + 1) % 3]].map(|v| mesh.position(v).coords);
            let side = b - a;
            let outward = side.cross(&normal);
            let speed = heading.dot(&outward);
            if speed > 1e-12 * side.norm() {
                let distance = ((a - point).dot(&outward) / speed).max(0.0);
                if distance < exit.0 {
                    let at = (point + heading * distance - a).dot(&side) / side.norm_squared();
                    exit = (distance, k, at);
                }
            }
        }
        let (distance, k, at) = exit;
        if !distance.is_finite() {
            // Only possible on a triangle without area.
            result.ends[1] = TraceEnd::Circling;
            break;
        }
        // Kept off the vertices, so that the next triangle is always the one across an edge.
        let at = at.clamp(1e-4, 1.0 - 1e-4);
        let [a, b] = [corners[k], corners[(k + 1) % 3]];
        let mut next = mesh.position(a).coords.lerp(&mesh.position(b).coords, at);
        let [pa, pb] = [a, b].map(|v| mesh.parameters[v as usize]);
        let mut next_parameters = [0, 1].map(|i| pa[i] + at * (pb[i] - pa[i]));
        let step = (next - point).norm();
        result.triangles.push(t);
        let rest = length - result.length;
        if distance > rest && step > rest {
            let share = rest / step;
            next = point.lerp(&next, share);
            next_parameters = [0, 1].map(|i| parameters[i] + share * (next_parameters[i] - parameters[i]));
        }
        result.length += (next - point).norm();
        (point, parameters) = (next, next_parameters);
        result.points.push(Point3::from(point));
        result.parameters.push(parameters);
        if result.length >= length {
            break;
        }
        let edge = field.edges.triangle_edges[t as usize][k];
        let Some(neighbour) = field.edges.neighbour(t, k) else {
            result.ends[1] = TraceEnd::Border;
            break;
        };
        family += usize::from(field.matching_across(edge, t, neighbour));
        let other = mesh.triangle_normal_area(neighbour as usize).0;
        let side = (mesh.position(b) - mesh.position(a)).normalize();
        // Both triangles lie left of the edge as they run through it: the neighbour is to the right.
        let inward = side.cross(&other);
        let wanted = field.direction(neighbour, family);
        heading = if wanted.dot(&inward) > 1e-3 {
            wanted
        } else {
            // Unfolded across the edge.
            let along = heading.dot(&side);
            (side * along + inward * heading.dot(&side.cross(&normal)).max(1e-3)).normalize()
        };
        t = neighbour;
        entered = Some(edge);
    }
    result
}

/// Follows a family from a point both ways, up to `length` on each side; runs against direction `family` first, then along it.
///
/// Arguments as in [`trace`].
pub fn trace_both_ways(
    field: &ConjugateField,
    triangle: u32,
    barycentric: [f64; 3],
    family: usize,
    length: f64,
) -> Trace {
    let mut back = trace(field, triangle, barycentric, family + 2, length);
    let ahead = trace(field, triangle, barycentric, family, length);
    back.points.reverse();
    back.parameters.reverse();
    back.triangles.reverse();
    back.points.extend_from_slice(&ahead.points[1..]);
    back.parameters.extend_from_slice(&ahead.parameters[1..]);
    back.triangles.extend_from_slice(&ahead.triangles);
    back.length += ahead.length;
    back.ends = [back.ends[1], ahead.ends[1]];
    back
}

fn combine(weights: [f64; 3], corners: [Vector3<f64>; 3]) -> Vector3<f64> {
    corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]
}

/// Weights moved inside the triangle and off its edges.
fn inside(weights: [f64; 3]) -> [f64; 3] {
    let clamped = weights.map(|w| if w.is_finite() { w.max(1e-4) } else { 1.0 });
    let sum: f64 = clamped.iter().sum();
    clamped.map(|w| w / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Control;
    use crate::field::test_surfaces::*;
    use crate::field::{DirectionConstraint, FieldOptions, conjugate_field};
    use crate::surface::SurfaceMesh;

    #[test]
    fn traces_of_a_translational_surface_are_parameter_lines() {
        let mesh = SurfaceMesh::new(&translational(), [24, 24]).unwrap();
        let constraints: Vec<_> = (0..mesh.triangles.len())
            .map(|t| DirectionConstraint {
                triangle: t as u32,
                direction: mesh.triangles[t].iter().map(|&v| mesh.points[v as usize].du).sum(),
                weight: f64::INFINITY,
            })
            .collect();
        let options = FieldOptions::default();
        let field = conjugate_field(mesh, None, &constraints, &options, &Control::default()).unwrap();
        for triangle in [300, 700, 1000] {
            for family in 0..2 {
                let line = trace_both_ways(&field, triangle, [1.0 / 3.0; 3], family, 1e9);
                assert_eq!(line.ends, [TraceEnd::Border; 2]);
                assert_eq!(line.points.len(), line.triangles.len() + 1);
                let spread = |k: usize| {
                    let values = line.parameters.iter().map(|p| p[k]);
                    values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
                };
                let (long, short) = (spread(0).max(spread(1)), spread(0).min(spread(1)));
                assert!(long > 1.0 - 1e-9 && short < 0.02, "{long} {short}");
            }
        }
    }

    #[test]
    fn a_trace_stops_at_its_length_and_stays_on_the_mesh() {
        for seed in 0..6 {
            let mesh = SurfaceMesh::new(&wavy(seed), [16, 16]).unwrap();
            let field = conjugate_field(mesh, None, &[], &FieldOptions::default(), &Control::default()).unwrap();
            for triangle in (0..field.directions.len() as u32).step_by(37) {
                for direction in 0..4 {
                    let line = trace(&field, triangle, [0.2, 0.3, 0.5], direction, 0.5);
                    let length: f64 = line.points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
                    assert!((length - line.length).abs() < 1e-9 && length < 0.5 + 1e-9);
                    assert!(line.ends[1] == TraceEnd::Border || (length - 0.5).abs() < 1e-6);
                    // Each step crosses into a neighbour.
                    for pair in line.triangles.windows(2) {
                        assert!(field.edges.between(pair[0], pair[1]).is_some());
                    }
                    assert!(line.parameters.iter().flatten().all(|p| (-1e-12..=1.0 + 1e-12).contains(p)));
                    let again = trace(&field, triangle, [0.2, 0.3, 0.5], direction, 1e9);
                    assert!(again.ends[1] != TraceEnd::Length);
                }
            }
        }
    }
}
