//! Splits faces into triangles, which are planar whatever their corners.

use super::panel_mesh::PanelMesh;
use nalgebra::{Point3, Vector3};

/// The mesh with each face for which `is_split` says so as triangles, in the face's place.
pub(crate) fn split_faces(mesh: &PanelMesh, is_split: impl Fn(usize) -> bool) -> PanelMesh {
    let mut result = PanelMesh { vertices: mesh.vertices.clone(), starts: vec![0], indices: vec![] };
    for (f, face) in mesh.faces().enumerate() {
        let pieces = if is_split(f) { triangles(&mesh.vertices, face) } else { vec![face.to_vec()] };
        for piece in pieces {
            result.indices.extend(piece);
            result.starts.push(result.indices.len() as u32);
        }
    }
    result
}

/// A polygon cut into triangles, ear by ear, the best shaped first; all of them turned as the polygon is, if it is simple.
fn triangles(vertices: &[Point3<f64>], face: &[u32]) -> Vec<Vec<u32>> {
    let at = |v: u32| vertices[v as usize];
    let normal: Vector3<f64> =
        (1..face.len() - 1).map(|k| (at(face[k]) - at(face[0])).cross(&(at(face[k + 1]) - at(face[0])))).sum();
    let mut rest = face.to_vec();
    let mut pieces = vec![];
    while rest.len() > 3 {
        let count = rest.len();
        let corners = |k: usize| [rest[(k + count - 1) % count], rest[k], rest[(k + 1) % count]];
        // For a quad both triangles of the diagonal count.
        let quality = |k: usize| {
            let ear = shape(corners(k).map(at), &normal);
            if count == 4 { ear.min(shape(corners((k + 2) % 4).map(at), &normal)) } else { ear }
        };
        let is_free =
            |k: usize| !rest.iter().any(|v| !corners(k).contains(v) && inside(corners(k).map(at), at(*v), &normal));
        let best = (0..count)
            .max_by(|&a, &b| is_free(a).cmp(&is_free(b)).then(quality(a).total_cmp(&quality(b))).then(b.cmp(&a)));
        let Some(best) = best else { break };
        pieces.push(corners(best).to_vec());
        rest.remove(best);
    }
    pieces.push(rest);
    pieces
}

/// Signed area over the sum of the squared sides; negative for a triangle turned against `normal`.
fn shape([a, b, c]: [Point3<f64>; 3], normal: &Vector3<f64>) -> f64 {
    let cross = (b - a).cross(&(c - a));
    let size = (b - a).norm_squared() + (c - b).norm_squared() + (a - c).norm_squared();
    let area = if cross.dot(normal) < 0.0 { -cross.norm() } else { cross.norm() };
    area / size.max(f64::MIN_POSITIVE)
}

/// Whether `p` lies within the triangle, seen along `normal`.
fn inside([a, b, c]: [Point3<f64>; 3], p: Point3<f64>, normal: &Vector3<f64>) -> bool {
    [(a, b), (b, c), (c, a)].iter().all(|(from, to)| (to - from).cross(&(p - from)).dot(normal) >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_cover_a_polygon_once() {
        // An L, seen from above, with corners lifted out of its plane.
        let points =
            [[0.0, 0.0, 0.1], [2.0, 0.0, 0.0], [2.0, 1.0, -0.1], [1.0, 1.0, 0.0], [1.0, 2.0, 0.1], [0.0, 2.0, 0.0]];
        let mut vertices = points.map(Point3::from).to_vec();
        vertices.push(Point3::new(3.0, 0.0, 0.0));
        let mesh = PanelMesh::new(vertices, &[vec![0u32, 1, 2, 3, 4, 5], vec![1, 6, 2]]).unwrap();
        let result = split_faces(&mesh, |f| f == 0);
        assert_eq!((result.face_count(), result.face(4)), (5, [1u32, 6, 2].as_slice()));
        let area = |f: &[u32]| {
            let [a, b, c] = [0, 1, 2].map(|k| result.vertices[f[k] as usize]);
            0.5 * (b - a).cross(&(c - a)).z
        };
        assert!(result.faces().all(|f| area(f) > 0.0));
        assert!((result.faces().map(area).sum::<f64>() - 3.5).abs() < 1e-12);
        assert_eq!(crate::mesh::check(&result).border_loops, 1);
        assert_eq!(split_faces(&mesh, |_| false), mesh);
    }

    #[test]
    fn a_reflex_quad_is_cut_at_its_reflex_corner() {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0], [1.0, 3.0, 0.2]].map(Point3::from).to_vec();
        let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
        let result = split_faces(&mesh, |_| true);
        assert!(result.face_count() == 2 && result.faces().all(|f| f.contains(&1) && f.contains(&3)));
    }
}
