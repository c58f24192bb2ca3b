//! The shape that a panel mesh should keep to: closest points on a surface and on its border.

use super::panel_mesh::PanelMesh;
use crate::surface::{SurfaceMesh, SurfaceProjector};
use nalgebra::{Point3, Vector3};
use rstar::primitives::GeomWithData;
use rstar::{AABB, PointDistance, RTree, RTreeObject};
use std::sync::OnceLock;

/// Closest point of a [`Reference`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// The closest point.
    pub point: Point3<f64>,
    /// Unit normal of the surface there, either sign; for a point on the border the unit tangent of the border, or zero
    /// at a corner of the border.
    pub direction: Vector3<f64>,
    /// Where the point lies in the reference's own parameters; handed back as the hint of the next query.
    pub parameters: [f64; 2],
}

/// A surface with a border, asked for closest points.
pub trait Reference {
    /// Closest point on the surface; `hint` is the [`Foot::parameters`] of an earlier answer for a point nearby.
    fn closest(&self, point: &Point3<f64>, hint: Option<[f64; 2]>) -> Foot;

    /// Closest point on the border, `None` for a closed surface.
    fn closest_on_border(&self, point: &Point3<f64>, hint: Option<[f64; 2]>) -> Option<Foot>;
}

impl Reference for SurfaceProjector {
    fn closest(&self, point: &Point3<f64>, hint: Option<[f64; 2]>) -> Foot {
        let foot = match hint {
            Some(start) => self.closest_near(point, start),
            None => self.closest(point),
        };
        Foot { point: foot.position, direction: foot.normal, parameters: foot.parameters }
    }

    fn closest_on_border(&self, point: &Point3<f64>, hint: Option<[f64; 2]>) -> Option<Foot> {
        let foot = match hint {
            Some(start) => self.closest_on_border_near(point, start),
            None => self.closest_on_border(point),
        };
        let [u, v] = foot.parameters;
        let at = self.surface().evaluate(u, v);
        let [on_u, on_v] = [0, 1].map(|k| self.surface().knots()[k].domain().contains(&foot.parameters[k]));
        // On a side u = const the border runs along v.
        let tangent = match (on_u, on_v) {
            (true, false) => at.dv,
            (false, true) => at.du,
            _ => Vector3::zeros(),
        };
        Some(Foot {
            point: foot.position,
            direction: tangent.try_normalize(0.0).unwrap_or_default(),
            parameters: foot.parameters,
        })
    }
}

/// A [`Reference`] made of triangles with smoothly interpolated normals. Its first parameter is the number of a triangle, from which a search with a
/// hint goes from neighbour to neighbour for as long as that leads nearer.
pub struct MeshReference {
    vertices: Vec<Point3<f64>>,
    /// Unit normal at each vertex.
    normals: Vec<Vector3<f64>>,
    triangles: Vec<[u32; 3]>,
    /// For each vertex, the start of its triangles in `around`.
    starts: Vec<usize>,
    around: Vec<u32>,
    /// Grown by the first search without a hint.
    tree: OnceLock<RTree<GeomWithData<Triangle, u32>>>,
    border: RTree<Segment>,
}

struct Triangle([Point3<f64>; 3]);

struct Segment {
    ends: [Point3<f64>; 2],
    /// Whether each end is a corner of the border.
    corners: [bool; 2],
}

/// Turn of the border at a corner, radians: more than where a curve is given by a few edges.
const CORNER: f64 = 0.25 * std::f64::consts::PI;

impl MeshReference {
    /// The surface given by its tessellation, with the surface's own normals.
    pub fn from_surface(mesh: &SurfaceMesh) -> Self {
        let vertices: Vec<_> = mesh.points.iter().map(|p| p.position).collect();
        Self::build(&vertices, &mesh.normals, &mesh.triangles)
    }

    /// The faces of a panel mesh, each as a fan of triangles; normals at the vertices are the faces' area-weighted means.
    pub fn from_panels(mesh: &PanelMesh) -> Self {
        let mut triangles = vec![];
        let mut normals = vec![Vector3::zeros(); mesh.vertices.len()];
        for face in mesh.faces() {
            for k in 1..face.len() - 1 {
                let triangle = [face[0], face[k], face[k + 1]];
                let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
                triangles.push(triangle);
                for v in triangle {
                    normals[v as usize] += (b - a).cross(&(c - a));
                }
            }
        }
        Self::build(&mesh.vertices, &normals, &triangles)
    }

    fn build(vertices: &[Point3<f64>], normals: &[Vector3<f64>], faces: &[[u32; 3]]) -> Self {
        let mut starts = vec![0; vertices.len() + 1];
        faces.as_flattened().iter().for_each(|&v| starts[v as usize + 1] += 1);
        for v in 0..vertices.len() {
            starts[v + 1] += starts[v];
        }
        let (mut next, mut around) = (starts.clone(), vec![0; 3 * faces.len()]);
        for (t, triangle) in (0..).zip(faces) {
            for &v in triangle {
                around[next[v as usize]] = t;
                next[v as usize] += 1;
            }
        }
        // The sides of triangles that occur once.
        let mut sides: Vec<[u32; 2]> = faces
            .iter()
            .flat_map(|t| [0, 1, 2].map(|k| [t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3])]))
            .collect();
        sides.sort_unstable();
        let sides: Vec<[u32; 2]> =
            sides.chunk_by(|a, b| a == b).filter(|group| group.len() == 1).map(|group| group[0]).collect();
        let mut neighbours: Vec<[u32; 2]> = sides.iter().flat_map(|&[a, b]| [[a, b], [b, a]]).collect();
        neighbours.sort_unstable();
        let at = |v: u32| vertices[v as usize];
        let corners: Vec<u32> = neighbours
            .chunk_by(|a, b| a[0] == b[0])
            .filter(|group| match group {
                [[v, p], [_, q]] => (at(*v) - at(*p)).angle(&(at(*q) - at(*v))) > CORNER,
                _ => true,
            })
            .map(|group| group[0][0])
            .collect();
        let border = sides
            .into_iter()
            .map(|ends| Segment { ends: ends.map(at), corners: ends.map(|v| corners.binary_search(&v).is_ok()) })
            .collect();
        Self {
            vertices: vertices.to_vec(),
            normals: normals.iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect(),
            triangles: faces.to_vec(),
            starts,
            around,
            tree: OnceLock::new(),
            border: RTree::bulk_load(border),
        }
    }

    /// For each vertex, parameters of where it lies; not numbers, and so no hint, for one without a triangle.
    pub(super) fn vertex_parameters(&self) -> Vec<[f64; 2]> {
        self.starts
            .windows(2)
            .map(|range| self.around[range[0]..range[1]].first().map_or([f64::NAN; 2], |&t| [f64::from(t), 0.0]))
            .collect()
    }

    fn corners(&self, triangle: u32) -> [Point3<f64>; 3] {
        self.triangles[triangle as usize].map(|v| self.vertices[v as usize])
    }

    /// Squared distance of a triangle; infinite for one on a line that has none.
    fn squared(&self, triangle: u32, point: &Point3<f64>) -> f64 {
        let squared = squared_distance(&self.corners(triangle), point);
        if squared.is_nan() { f64::INFINITY } else { squared }
    }

    /// The triangle reached from `start` by going to the nearest around it.
    fn descend(&self, point: &Point3<f64>, start: u32) -> (u32, f64) {
        let mut best = (start, self.squared(start, point));
        loop {
            let from = best.0;
            for v in self.triangles[from as usize] {
                for &t in &self.around[self.starts[v as usize]..self.starts[v as usize + 1]] {
                    let squared = self.squared(t, point);
                    if squared < best.1 {
                        best = (t, squared);
                    }
                }
            }
            if best.0 == from {
                return best;
            }
        }
    }

    /// The nearest triangle of all; `None` if there is none.
    fn nearest(&self, point: &Point3<f64>) -> Option<u32> {
        let grow = || {
            let count = self.triangles.len() as u32;
            RTree::bulk_load((0..count).map(|t| GeomWithData::new(Triangle(self.corners(t)), t)).collect())
        };
        self.tree.get_or_init(grow).nearest_neighbor([point.x, point.y, point.z]).map(|nearest| nearest.data)
    }
}

impl Reference for MeshReference {
    fn closest(&self, point: &Point3<f64>, hint: Option<[f64; 2]>) -> Foot {
        let start = hint.filter(|[t, _]| (0.0..self.triangles.len() as f64).contains(t)).map(|[t, _]| t as u32);
        let near = start.map(|t| self.descend(point, t)).filter(|near| near.1.is_finite()).map(|near| near.0);
        let Some(triangle) = near.or_else(|| self.nearest(point)) else {
            return Foot { point: *point, direction: Vector3::zeros(), parameters: [0.0; 2] };
        };
        let corners = self.corners(triangle);
        let weights = closest_in_triangle(&corners, point);
        let [l, m, n] = self.triangles[triangle as usize].map(|v| self.normals[v as usize]);
        let direction = (l * weights[0] + m * weights[1] + n * weights[2]).try_normalize(0.0).unwrap_or_default();
        let point = Point3::from(weighted(&corners, weights));
        Foot { point, direction, parameters: [f64::from(triangle), 0.0] }
    }

    fn closest_on_border(&self, point: &Point3<f64>, _hint: Option<[f64; 2]>) -> Option<Foot> {
        let segment = self.border.nearest_neighbor([point.x, point.y, point.z])?;
        let foot = closest_on_segment(&segment.ends, point);
        let is_corner = (0..2).any(|k| segment.corners[k] && segment.ends[k] == foot);
        let along = if is_corner { Vector3::zeros() } else { segment.ends[1] - segment.ends[0] };
        let direction = along.try_normalize(0.0).unwrap_or_default();
        Some(Foot { point: foot, direction, parameters: [0.0; 2] })
    }
}

fn bounds(points: &[Point3<f64>]) -> AABB<[f64; 3]> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points {
        for k in 0..3 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    AABB::from_corners(low, high)
}

impl RTreeObject for Triangle {
    type Envelope = AABB<[f64; 3]>;
    fn envelope(&self) -> Self::Envelope {
        bounds(&self.0)
    }
}

impl PointDistance for Triangle {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        squared_distance(&self.0, &Point3::from(*point))
    }
}

fn weighted(corners: &[Point3<f64>; 3], weights: [f64; 3]) -> Vector3<f64> {
    (0..3).map(|k| corners[k].coords * weights[k]).sum()
}

fn squared_distance(corners: &[Point3<f64>; 3], point: &Point3<f64>) -> f64 {
    (weighted(corners, closest_in_triangle(corners, point)) - point.coords).norm_squared()
}

impl RTreeObject for Segment {
    type Envelope = AABB<[f64; 3]>;
    fn envelope(&self) -> Self::Envelope {
        bounds(&self.ends)
    }
}

impl PointDistance for Segment {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let point = Point3::from(*point);
        (closest_on_segment(&self.ends, &point) - point).norm_squared()
    }
}

pub(crate) fn closest_on_segment(ends: &[Point3<f64>; 2], point: &Point3<f64>) -> Point3<f64> {
    let along = ends[1] - ends[0];
    let length = along.norm_squared();
    let t = if length > 0.0 { ((point - ends[0]).dot(&along) / length).clamp(0.0, 1.0) } else { 0.0 };
    if t == 1.0 { ends[1] } else { ends[0] + along * t }
}

/// Barycentric coordinates of the point of a triangle closest to `point` (Ericson, Real-Time Collision Detection, 5.1.5).
fn closest_in_triangle(corners: &[Point3<f64>; 3], point: &Point3<f64>) -> [f64; 3] {
    let [a, b, c] = corners;
    let (ab, ac) = (b - a, c - a);
    let ap = point - a;
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = point - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let cp = point - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::NurbsSurface;

    #[test]
    fn feet_on_a_nurbs_surface_carry_normals_and_tangents() {
        let points = (0..16).map(|k| Point3::new((k / 4) as f64, (k % 4) as f64, 0.0)).collect();
        let projector = SurfaceProjector::new(&NurbsSurface::uniform(3, [4, 4], points).unwrap());
        let reference: &dyn Reference = &projector;
        let foot = reference.closest(&Point3::new(1.3, 2.2, 0.5), None);
        assert!((foot.point - Point3::new(1.3, 2.2, 0.0)).norm() < 1e-9);
        assert!((foot.direction.z.abs() - 1.0).abs() < 1e-9);
        let side = reference.closest_on_border(&Point3::new(1.3, 2.8, 0.5), None).unwrap();
        assert!((side.point - Point3::new(1.3, 3.0, 0.0)).norm() < 1e-9 && (side.direction.x.abs() - 1.0).abs() < 1e-9);
        let corner = reference.closest_on_border(&Point3::new(3.5, 3.2, 0.5), None).unwrap();
        assert!((corner.point - Point3::new(3.0, 3.0, 0.0)).norm() < 1e-9 && corner.direction == Vector3::zeros());
    }

    #[test]
    fn closest_points_beat_a_fine_sampling() {
        let corners = [[0.0, 0.0, 0.0], [2.0, 0.3, 0.1], [0.4, 1.5, -0.2]].map(Point3::from);
        for i in 0..200 {
            let t = i as f64;
            let point = Point3::new((t * 1.7).sin() * 3.0, (t * 0.9).cos() * 3.0, (t * 2.3).sin() * 2.0);
            let w = closest_in_triangle(&corners, &point);
            assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-12 && w.iter().all(|x| *x >= -1e-12));
            let at = |w: [f64; 3]| -> Vector3<f64> { (0..3).map(|k| corners[k].coords * w[k]).sum() };
            let best = (at(w) - point.coords).norm();
            for a in 0..=40 {
                for b in 0..=40 - a {
                    let (a, b) = (a as f64 / 40.0, b as f64 / 40.0);
                    assert!((at([a, b, 1.0 - a - b]) - point.coords).norm() >= best - 1e-12);
                }
            }
        }
    }

    /// Unit squares over [0, 8]^2 at height z(x, y).
    fn squares(z: impl Fn(f64, f64) -> f64) -> PanelMesh {
        let place = |k: u32| (f64::from(k / 9), f64::from(k % 9));
        let vertices = (0..81).map(place).map(|(x, y)| Point3::new(x, y, z(x, y))).collect();
        let faces: Vec<[u32; 4]> = (0..64)
            .map(|k| {
                let a = k / 8 * 9 + k % 8;
                [a, a + 9, a + 10, a + 1]
            })
            .collect();
        PanelMesh::new(vertices, &faces).unwrap()
    }

    #[test]
    fn a_hint_leads_to_the_same_foot() {
        let mesh = squares(|x, y| 0.1 * x * x - 0.05 * x * y);
        let reference = MeshReference::from_panels(&mesh);
        for (hint, p) in reference.vertex_parameters().into_iter().zip(&mesh.vertices) {
            assert_eq!(reference.closest(p, Some(hint)).point, *p);
            for (x, y) in [(1.3, 0.4), (-0.7, 1.6), (0.2, -2.1)] {
                let query = p + Vector3::new(x, y, 0.3);
                let (near, anywhere) = (reference.closest(&query, Some(hint)), reference.closest(&query, None));
                assert!((near.point - anywhere.point).norm() < 1e-12, "{query}");
                assert!((near.direction - anywhere.direction).norm() < 1e-12, "{query}");
            }
        }
        let far = Point3::new(7.7, 7.2, 1.0);
        assert_eq!(reference.closest(&far, Some([f64::NAN; 2])), reference.closest(&far, None));
    }

    #[test]
    fn feet_lie_on_the_surface_and_on_its_border() {
        let reference = MeshReference::from_panels(&squares(|_, _| 0.0));
        let point = Point3::new(3.3, 1.2, 0.7);
        let foot = reference.closest(&point, None);
        assert!((foot.point - Point3::new(3.3, 1.2, 0.0)).norm() < 1e-12);
        assert!((foot.direction - Vector3::z()).norm() < 1e-12);
        let border = reference.closest_on_border(&point, None).unwrap();
        assert!((border.point - Point3::new(3.3, 0.0, 0.0)).norm() < 1e-12);
        assert!((border.direction.x.abs() - 1.0).abs() < 1e-12);
        for (query, end) in [([-1.0, -2.0, 0.3], [0.0, 0.0, 0.0]), ([9.0, 8.5, 0.0], [8.0, 8.0, 0.0])] {
            let corner = reference.closest_on_border(&Point3::from(query), None).unwrap();
            assert!(corner.point == Point3::from(end) && corner.direction == Vector3::zeros());
        }
    }
}
