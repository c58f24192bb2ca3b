//! The shape that a panel mesh should keep to: closest points on a surface and on its border.

use super::panel_mesh::PanelMesh;
use crate::surface::{SurfaceMesh, SurfaceProjector};
use nalgebra::{Point3, Vector3};
use rstar::{AABB, PointDistance, RTree, RTreeObject};

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

/// A [`Reference`] made of triangles with smoothly interpolated normals.
pub struct MeshReference {
    triangles: RTree<Triangle>,
    border: RTree<Segment>,
}

struct Triangle {
    corners: [Point3<f64>; 3],
    normals: [Vector3<f64>; 3],
}

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
        let triangles = faces
            .iter()
            .map(|t| Triangle {
                corners: t.map(|v| vertices[v as usize]),
                normals: t.map(|v| normals[v as usize].try_normalize(0.0).unwrap_or_default()),
            })
            .collect();
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
        Self { triangles: RTree::bulk_load(triangles), border: RTree::bulk_load(border) }
    }
}

impl Reference for MeshReference {
    fn closest(&self, point: &Point3<f64>, _hint: Option<[f64; 2]>) -> Foot {
        let Some(triangle) = self.triangles.nearest_neighbor([point.x, point.y, point.z]) else {
            return Foot { point: *point, direction: Vector3::zeros(), parameters: [0.0; 2] };
        };
        let [a, b, c] = closest_in_triangle(&triangle.corners, point);
        let [p, q, r] = triangle.corners.map(|p| p.coords);
        let [l, m, n] = triangle.normals;
        let direction = (l * a + m * b + n * c).try_normalize(0.0).unwrap_or_default();
        Foot { point: Point3::from(p * a + q * b + r * c), direction, parameters: [0.0; 2] }
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
        bounds(&self.corners)
    }
}

impl PointDistance for Triangle {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let point = Point3::from(*point);
        let weights = closest_in_triangle(&self.corners, &point);
        let foot: Vector3<f64> = (0..3).map(|k| self.corners[k].coords * weights[k]).sum();
        (foot - point.coords).norm_squared()
    }
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

    #[test]
    fn feet_lie_on_the_surface_and_on_its_border() {
        let n = 8u32;
        let vertices =
            (0..(n + 1) * (n + 1)).map(|k| Point3::new((k / (n + 1)) as f64, (k % (n + 1)) as f64, 0.0)).collect();
        let faces: Vec<[u32; 4]> = (0..n * n)
            .map(|k| {
                let a = k / n * (n + 1) + k % n;
                [a, a + n + 1, a + n + 2, a + 1]
            })
            .collect();
        let reference = MeshReference::from_panels(&PanelMesh::new(vertices, &faces).unwrap());
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
