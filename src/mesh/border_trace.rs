//! How far the border of a mesh strays from the border that it stands for.

use super::reference::Reference;
use nalgebra::Point3;

/// Pieces of each border edge, to whose ends the closest points of the reference's border are looked for.
const PIECES: usize = 4;

/// How often the gap between two such points is halved where it is much wider than the piece: no point of an edge is closest to the tip of a
/// bend that it cuts.
const HALVINGS: usize = 4;

/// How much wider.
const WIDE: f64 = 1.3;

/// How far along the border, in mean edge lengths, the edge that is nearest to a point is looked for: farther than vertices slide.
const REACH: f64 = 8.0;

/// Points of the reference's border, each with the edges of the mesh's border among which the nearest is looked for.
///
/// Where vertices slide away from a bend of the border, the edge between them cuts it short though both are on the border: only the points between
/// them tell.
#[derive(Default)]
pub(crate) struct BorderTrace {
    points: Vec<Point3<f64>>,
    /// Distance that each point may have from the nearest edge, mesh unit.
    allowed: Vec<f64>,
    /// For each point, its edges in `near`.
    ranges: Vec<[usize; 2]>,
    near: Vec<[u32; 2]>,
}

impl BorderTrace {
    /// Points along the border that the mesh starts with.
    ///
    /// - `sides`: edges that belong to one face only; those with an end that is not `held` to the border do not count.
    /// - `parameters`: of each vertex in the reference, where the search along the border starts.
    /// - `edge`: mean edge length; `allowed`: distance from the nearest edge, mesh unit. A point that starts farther away may stay as far.
    pub fn new(
        vertices: &[Point3<f64>],
        sides: &[[u32; 2]],
        held: &[bool],
        parameters: &[[f64; 2]],
        reference: &dyn Reference,
        edge: f64,
        allowed: f64,
    ) -> Self {
        let mut trace = Self { points: vec![], allowed: vec![], ranges: vec![], near: vec![] };
        let sides: Vec<[u32; 2]> = sides.iter().copied().filter(|s| s.iter().all(|&v| held[v as usize])).collect();
        let mut at: Vec<(u32, u32)> = (0u32..).zip(&sides).flat_map(|(k, s)| s.map(|v| (v, k))).collect();
        at.sort_unstable();
        // The other border edge at a vertex, if there is just one.
        let across = |vertex: u32, side: u32| {
            let from = at.partition_point(|e| e.0 < vertex);
            match at[from..].iter().take_while(|e| e.0 == vertex).map(|e| e.1).collect::<Vec<_>>().as_slice() {
                &[a, b] => Some(if a == side { b } else { a }),
                _ => None,
            }
        };
        for (k, side) in (0u32..).zip(&sides) {
            let [a, b] = side.map(|v| vertices[v as usize]);
            let start = trace.near.len();
            trace.near.push(*side);
            for end in *side {
                let (mut vertex, mut current, mut length) = (end, k, 0.0);
                while length < REACH * edge {
                    let Some(next) = across(vertex, current).filter(|&next| next != k) else { break };
                    let [p, q] = sides[next as usize];
                    length += (vertices[p as usize] - vertices[q as usize]).norm();
                    trace.near.push([p, q]);
                    (vertex, current) = (if p == vertex { q } else { p }, next);
                }
            }
            let range = [start, trace.near.len()];
            for point in along(&[a, b], side.map(|v| parameters[v as usize]), reference) {
                trace.points.push(point);
                trace.allowed.push(allowed.max(distance_to_segment(&[a, b], &point)));
                trace.ranges.push(range);
            }
        }
        trace
    }

    /// For each vertex, the largest distance of a point to whose nearest edge it belongs, over what is allowed; 0 inside.
    pub fn strains(&self, vertices: &[Point3<f64>]) -> Vec<f64> {
        let mut strains = vec![0f64; vertices.len()];
        for ((point, allowed), range) in self.points.iter().zip(&self.allowed).zip(&self.ranges) {
            let distances = self.near[range[0]..range[1]]
                .iter()
                .map(|side| (distance_to_segment(&side.map(|v| vertices[v as usize]), point), side));
            if let Some((distance, side)) = distances.min_by(|x, y| x.0.total_cmp(&y.0)) {
                for &v in side {
                    strains[v as usize] = strains[v as usize].max(distance / allowed);
                }
            }
        }
        strains
    }
}

/// Points of the reference's border from one end of an edge, itself included, to before the other.
fn along([a, b]: &[Point3<f64>; 2], parameters: [[f64; 2]; 2], reference: &dyn Reference) -> Vec<Point3<f64>> {
    // Searched from the end that is nearer: another side of the border may be as near to the point itself.
    let foot = |p: Point3<f64>, hint: [f64; 2]| {
        reference.closest_on_border(&p, Some(hint)).map(|foot| (foot.point, foot.parameters))
    };
    let inner = (1..PIECES)
        .filter_map(|k| foot(a + (b - a) * (k as f64 / PIECES as f64), parameters[usize::from(2 * k > PIECES)]));
    let mut points: Vec<(Point3<f64>, [f64; 2])> =
        std::iter::once((*a, parameters[0])).chain(inner).chain([(*b, parameters[1])]).collect();
    let wide = WIDE * (b - a).norm() / PIECES as f64;
    for _ in 0..HALVINGS {
        let gaps: Vec<_> = points.windows(2).map(|w| [w[0], w[1]]).collect();
        points.truncate(1);
        for [p, q] in gaps {
            let between = if (q.0 - p.0).norm() > wide { foot(nalgebra::center(&p.0, &q.0), p.1) } else { None };
            points.extend(between.into_iter().chain([q]));
        }
    }
    points.pop();
    points.into_iter().map(|p| p.0).collect()
}

fn distance_to_segment(ends: &[Point3<f64>; 2], point: &Point3<f64>) -> f64 {
    (super::reference::closest_on_segment(ends, point) - point).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::reference::Foot;
    use nalgebra::Vector3;

    /// The unit circle.
    struct Circle;

    impl Reference for Circle {
        fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
            Foot { point: *p, direction: Vector3::z(), parameters: [0.0; 2] }
        }
        fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
            let point = Point3::from(p.coords.normalize());
            Some(Foot { point, direction: Vector3::z().cross(&point.coords), parameters: [0.0; 2] })
        }
    }

    #[test]
    fn a_vertex_that_slides_leaves_a_gap_beside_its_longer_edge() {
        let on_circle = |degrees: f64| Point3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0);
        let mut vertices: Vec<_> = (0..12).map(|k| on_circle(30.0 * f64::from(k))).collect();
        let sides: Vec<[u32; 2]> = (0..12).map(|k| [k, (k + 1) % 12]).collect();
        let edge = 2.0 * 15f64.to_radians().sin();
        let sag = |degrees: f64| 1.0 - (0.5 * degrees).to_radians().cos();
        let trace = BorderTrace::new(&vertices, &sides, &[true; 12], &[[0.0; 2]; 12], &Circle, edge, 0.1);
        let before = trace.strains(&vertices);
        assert!(before.iter().all(|s| (s - sag(30.0) / 0.1).abs() < 1e-12));
        // The edge from 60 to 105 degrees is farthest off at 82.5; the nearest points that are asked for are within 3 degrees.
        vertices[3] = on_circle(105.0);
        let after = trace.strains(&vertices);
        for v in [2, 3] {
            assert!(after[v] <= sag(45.0) / 0.1 && after[v] > 0.95 * sag(45.0) / 0.1, "{after:?}");
        }
        assert!((after[8] - before[8]).abs() < 1e-12);
        // Where an end is not held nothing is asked.
        let mut held = [true; 12];
        held[3] = false;
        let trace = BorderTrace::new(&vertices, &sides, &held, &[[0.0; 2]; 12], &Circle, edge, 0.1);
        assert_eq!(trace.strains(&vertices)[3], 0.0);
    }
}
