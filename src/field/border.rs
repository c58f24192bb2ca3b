//! How often the cross turns against a border that the field follows: the corners that panels have there.

use super::topology::EdgeTopology;
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// Least turning of a corner, radians.
const LEAST_TURN: f64 = FRAC_PI_4;
/// Share of the largest turning nearby that the corner itself has, when several vertices see it.
const AS_SHARP: f64 = 0.9;

/// A place where the border turns sharply or, seen from as far as a panel, as good as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Corner {
    /// The vertex of the triangulation.
    pub vertex: u32,
    /// Quarter turns of the border to the left: 1 where one panel meets, -1 where three do, against two elsewhere.
    pub turns: i32,
}

/// Border edges that the field follows, by the vertex that they leave counter-clockwise; edges of collapsed sides are none.
pub(super) fn followed(mesh: &SurfaceMesh, edges: &EdgeTopology, sides: &[bool; 4]) -> BTreeMap<u32, u32> {
    let [nu, nv] = mesh.cells.map(|c| c as u32);
    // Coordinate of the grid and its value on each side.
    let lines = [(0, 0), (0, nu), (1, 0), (1, nv)];
    let follows = |e: &usize| {
        let ends = edges.vertices[*e];
        let grid = ends.map(|v| [v / (nv + 1), v % (nv + 1)]);
        let followed = lines.iter().zip(sides).any(|(&(k, value), &side)| side && grid.iter().all(|g| g[k] == value));
        followed && mesh.position(ends[0]) != mesh.position(ends[1])
    };
    let border = (0..edges.len()).filter(|&e| edges.is_border(e));
    border.filter(follows).map(|e| (edges.vertices[e][0], e as u32)).collect()
}

/// The corners between border edges that the field follows, in the order of their vertices.
///
/// A corner is where the chords over `window`, the length of a panel, before and after a vertex turn by more than 45 degrees, seen along the
/// surface's normal there; the turning counts in whole quarters, but never so many that no panel is left.
pub(super) fn corners(mesh: &SurfaceMesh, edges: &EdgeTopology, sides: &[bool; 4], window: f64) -> Vec<Corner> {
    let outline = Outline::new(mesh, edges, sides);
    let turning: BTreeMap<u32, f64> = outline.inner().map(|v| (v, outline.turning(v, window))).collect();
    let mut sharp: Vec<(u32, f64)> = turning.iter().map(|(&v, &turn)| (v, turn)).collect();
    sharp.retain(|(_, turn)| turn.abs() > LEAST_TURN);
    sharp.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()).then(a.0.cmp(&b.0)));
    let mut corners = vec![];
    let mut taken: Vec<u32> = vec![];
    for (v, turn) in sharp {
        if taken.contains(&v) {
            continue;
        }
        taken.extend(outline.around(v, 2.0 * window));
        // Of the vertices that see it nearly as sharp, the one where the border itself turns most.
        let sees = |w: &u32| turning.get(w).is_some_and(|t| t * turn.signum() > AS_SHARP * turn.abs());
        let own = |w: u32| outline.turning(w, 0.0) * turn.signum();
        let near = outline.around(v, window).into_iter().filter(sees);
        let vertex = near.max_by(|&a, &b| own(a).total_cmp(&own(b)).then(b.cmp(&a))).unwrap_or(v);
        corners.push(Corner { vertex, turns: ((turn / FRAC_PI_2).round() as i32).clamp(-2, 1) });
    }
    corners.sort_by_key(|c| c.vertex);
    corners
}

/// The border that a field follows, vertex by vertex.
struct Outline<'a> {
    mesh: &'a SurfaceMesh,
    edges: &'a EdgeTopology,
    next: BTreeMap<u32, u32>,
    before: BTreeMap<u32, u32>,
}

impl<'a> Outline<'a> {
    fn new(mesh: &'a SurfaceMesh, edges: &'a EdgeTopology, sides: &[bool; 4]) -> Self {
        let next: BTreeMap<u32, u32> =
            followed(mesh, edges, sides).iter().map(|(&v, &e)| (v, edges.vertices[e as usize][1])).collect();
        let before = next.iter().map(|(&v, &w)| (w, v)).collect();
        Self { mesh, edges, next, before }
    }

    /// Vertices between two edges of it.
    fn inner(&self) -> impl Iterator<Item = u32> {
        self.next.keys().copied().filter(|v| self.before.contains_key(v))
    }

    /// Vertices within `reach` of one along the border, itself first.
    fn around(&self, v: u32, reach: f64) -> Vec<u32> {
        let mut found = vec![v];
        for ways in [&self.next, &self.before] {
            let (mut at, mut way) = (v, 0.0);
            while let Some(&to) = ways.get(&at) {
                way += (self.mesh.position(to) - self.mesh.position(at)).norm();
                if way > reach || to == v {
                    break;
                }
                found.push(to);
                at = to;
            }
        }
        found
    }

    /// The chord from a vertex to the point `reach` further along one of the ways, at least to the next vertex.
    fn chord(&self, v: u32, ways: &BTreeMap<u32, u32>, reach: f64) -> Vector3<f64> {
        let (mut at, mut way) = (v, 0.0);
        let start = self.mesh.position(v);
        while let Some(&to) = ways.get(&at) {
            let step = self.mesh.position(to) - self.mesh.position(at);
            let length = step.norm();
            if way + length >= reach || to == v {
                let share = if way > 0.0 { (reach - way) / length } else { (reach / length).max(1.0) };
                return self.mesh.position(at) + step * share.min(1.0) - start;
            }
            way += length;
            at = to;
        }
        self.mesh.position(at) - start
    }

    /// Angle by which the border turns left between the chords over `reach` before and after a vertex, radians.
    fn turning(&self, v: u32, reach: f64) -> f64 {
        let (there, back) = (self.chord(v, &self.next, reach), self.chord(v, &self.before, reach));
        let triangles = self.around(v, reach).into_iter().flat_map(|w| self.edges.fan(w).iter().copied());
        let normal: Vector3<f64> = triangles
            .map(|t| {
                let (normal, area) = self.mesh.triangle_normal_area(t as usize);
                normal * area
            })
            .sum();
        let Some(normal) = normal.try_normalize(0.0) else { return 0.0 };
        let flat = |d: Vector3<f64>| d - normal * normal.dot(&d);
        let (from, to) = (-flat(back), flat(there));
        from.cross(&to).dot(&normal).atan2(from.dot(&to))
    }
}

/// Sum of the angles of the triangles at a vertex, radians.
pub(super) fn inner_angle(mesh: &SurfaceMesh, edges: &EdgeTopology, vertex: u32) -> f64 {
    let angle = |&t: &u32| {
        let triangle = mesh.triangles[t as usize];
        let k = triangle.iter().position(|&v| v == vertex).unwrap_or(0);
        let [at, a, b] = [0, 1, 2].map(|i| mesh.position(triangle[(k + i) % 3]));
        (a - at).angle(&(b - at))
    };
    edges.fan(vertex).iter().map(angle).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::test_surfaces::graph;
    use crate::surface::NurbsSurface;
    use nalgebra::Point3;

    fn corners_of(surface: &NurbsSurface, cells: [usize; 2], sides: [bool; 4]) -> Vec<(u32, i32)> {
        corners_within(surface, cells, sides, 0.1)
    }

    fn corners_within(surface: &NurbsSurface, cells: [usize; 2], sides: [bool; 4], window: f64) -> Vec<(u32, i32)> {
        let mesh = SurfaceMesh::new(surface, cells).unwrap();
        let edges = EdgeTopology::new(mesh.points.len(), &mesh.triangles).unwrap();
        corners(&mesh, &edges, &sides, window).iter().map(|c| (c.vertex, c.turns)).collect()
    }

    #[test]
    fn a_square_has_four_corners_and_those_between_sides_that_are_followed() {
        let square = graph(|_, _| 0.0);
        let all = [(0, 1), (12, 1), (13 * 20, 1), (13 * 20 + 12, 1)];
        assert_eq!(corners_of(&square, [20, 12], [true; 4]), all);
        // u = max and v = min meet at the vertex 20 * 13.
        assert_eq!(corners_of(&square, [20, 12], [false, true, true, false]), [(13 * 20, 1)]);
        assert_eq!(corners_of(&square, [20, 12], [true, true, false, false]), []);
    }

    #[test]
    fn a_notch_turns_the_other_way_and_a_disk_not_at_all() {
        // Seven bilinear corners of a square whose side v = min is pushed in at the middle.
        let flat = |x: f64, y: f64| Point3::new(x, y, 0.0);
        let rows =
            [[flat(0.0, 0.0), flat(0.0, 4.0)], [flat(2.0, 2.0), flat(2.0, 4.0)], [flat(4.0, 0.0), flat(4.0, 4.0)]];
        let notch = NurbsSurface::uniform(1, [3, 2], rows.concat()).unwrap();
        let found = corners_of(&notch, [20, 20], [true; 4]);
        assert_eq!(found.iter().map(|c| c.1).sum::<i32>(), 4 - 1);
        assert!(found.contains(&(10 * 21, -1)), "{found:?}");
        // A square net bent to a disk: its border turns evenly, and its corners are straight.
        let n = 40;
        let disk = |k: usize| {
            let [x, y] = [k / (n + 1), k % (n + 1)].map(|i| 2.0 * i as f64 / n as f64 - 1.0);
            flat(x * (1.0 - 0.5 * y * y).sqrt(), y * (1.0 - 0.5 * x * x).sqrt())
        };
        let disk = NurbsSurface::uniform(1, [n + 1, n + 1], (0..(n + 1) * (n + 1)).map(disk).collect()).unwrap();
        assert_eq!(corners_of(&disk, [40, 40], [true; 4]), []);
    }

    #[test]
    fn a_rounded_corner_is_one_for_panels_longer_than_its_arc() {
        // x^8 + y^8 = 1: radii of curvature of 0.18 on the diagonals.
        let n = 40;
        let point = |k: usize| {
            let [s, t] = [k / (n + 1), k % (n + 1)].map(|i| 2.0 * i as f64 / n as f64 - 1.0);
            let share = s.abs().max(t.abs()) / (s.powi(8) + t.powi(8)).powf(0.125).max(f64::MIN_POSITIVE);
            Point3::new(s * share, t * share, 0.0)
        };
        let rounded = NurbsSurface::uniform(1, [n + 1, n + 1], (0..(n + 1) * (n + 1)).map(point).collect()).unwrap();
        let all = [(0, 1), (40, 1), (41 * 40, 1), (41 * 40 + 40, 1)];
        assert_eq!(corners_within(&rounded, [40, 40], [true; 4], 0.5), all);
        assert_eq!(corners_within(&rounded, [40, 40], [true; 4], 0.08), []);
    }
}
