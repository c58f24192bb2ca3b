//! Planarity, edge lengths and deviation of panel meshes: measures only.

use super::panel_mesh::PanelMesh;
use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};

/// Sqrt 2 times the largest distance of a point from the centroid: the side for a square, whichever way it is turned.
pub fn width(points: &[Point3<f64>]) -> f64 {
    let center = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    2f64.sqrt() * points.iter().map(|p| (p.coords - center).norm()).fold(0.0, f64::max)
}

/// Planarity of each face; dimensionless, >= 0, 0 for a planar face.
///
/// - Triangles: 0.
/// - Quads: distance between the lines of the two diagonals over the mesh's mean edge length; 0 where the diagonals are
///   parallel.
/// - Faces of five and more corners: twice the largest distance of a corner from the least-squares plane of the corners,
///   over the mesh's mean edge length. For a parallelogram with lifted corners that is the very same number as the
///   distance of the diagonals, so the two may be compared and P_max taken over both.
///
/// Returns one value for each face, in face order; all zero if every edge of the mesh has length zero.
///
/// # Source
/// Sketch2PQ, Sec. 4.1, for quads; the paper has no larger faces. libigl's `quad_planarity` divides by the diagonals' mean
/// length instead, and Liu et al. 2011 measure an angle sum in degrees.
pub fn planarity(mesh: &PanelMesh) -> Vec<f64> {
    let scale = mean_edge_length(mesh);
    if scale > 0.0 {
        mesh.faces().map(|face| out_of_plane(&mesh.vertices, face) / scale).collect()
    } else {
        vec![0.0; mesh.face_count()]
    }
}

/// Planarity of one face as [`planarity`] defines it, before the division by the mean edge length.
pub(crate) fn out_of_plane(vertices: &[Point3<f64>], face: &[u32]) -> f64 {
    let corner = |k: usize| vertices[face[k] as usize];
    match face.len() {
        0..=3 => 0.0,
        4 => {
            let (d1, d2) = (corner(2) - corner(0), corner(3) - corner(1));
            let cross = d1.cross(&d2);
            let area = cross.norm();
            if area > 1e-14 * d1.norm() * d2.norm() { (corner(1) - corner(0)).dot(&cross).abs() / area } else { 0.0 }
        }
        count => {
            let points: Vec<_> = (0..count).map(corner).collect();
            let (center, normal) = best_plane(&points);
            2.0 * points.iter().map(|p| normal.dot(&(p - center)).abs()).fold(0.0, f64::max)
        }
    }
}

/// The plane with the least sum of squared distances to `points`: a point on it and its unit normal.
///
/// The normal's sign is arbitrary; for points on a line or at one place it is any normal of them.
pub fn best_plane(points: &[Point3<f64>]) -> (Point3<f64>, Vector3<f64>) {
    let sum: Vector3<f64> = points.iter().map(|p| p.coords).sum();
    let center = Point3::from(sum / points.len().max(1) as f64);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - center) * (p - center).transpose()).sum();
    let eigen = SymmetricEigen::new(scatter);
    let smallest = eigen.eigenvalues.imin();
    (center, eigen.eigenvectors.column(smallest).into_owned())
}

/// The edges of the mesh, each once, as ascending vertex pairs in ascending order.
pub fn edges(mesh: &PanelMesh) -> Vec<[u32; 2]> {
    let mut edges = Vec::with_capacity(mesh.indices.len());
    for face in mesh.faces() {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            edges.push([a.min(b), a.max(b)]);
        }
    }
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// Length of each edge, in the order of [`edges`].
pub fn edge_lengths(mesh: &PanelMesh) -> Vec<f64> {
    let length = |[a, b]: [u32; 2]| (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm();
    edges(mesh).into_iter().map(length).collect()
}

/// Mean length of the edges, each counted once; 0 for a mesh without edges.
pub fn mean_edge_length(mesh: &PanelMesh) -> f64 {
    let lengths = edge_lengths(mesh);
    lengths.iter().sum::<f64>() / lengths.len().max(1) as f64
}

/// Distance of each vertex from its closest point on a reference, given vertex by vertex, in the mesh's unit.
pub fn deviation(vertices: &[Point3<f64>], closest: &[Point3<f64>]) -> Vec<f64> {
    vertices.iter().zip(closest).map(|(p, q)| (p - q).norm()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Translation3};

    fn lifted_square(h: f64) -> PanelMesh {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, h], [0.0, 1.0, 0.0]].map(Point3::from).to_vec();
        PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap()
    }

    #[test]
    fn lifting_one_corner_of_a_square_parts_the_diagonals_by_half() {
        let h = 1e-3;
        let mesh = lifted_square(h);
        assert!((planarity(&mesh)[0] - 0.5 * h).abs() < 1e-6 * h);
    }

    #[test]
    fn planarity_ignores_motion_scale_and_renumbering() {
        let mesh = lifted_square(0.2);
        let expected = planarity(&mesh)[0];
        let motion = Translation3::new(3.0, -7.0, 2.0) * Rotation3::from_euler_angles(0.3, 1.0, -2.0);
        let vertices = mesh.vertices.iter().map(|p| motion * (p * 40.0)).rev().collect();
        let moved = PanelMesh::new(vertices, &[[1u32, 0, 3, 2]]).unwrap();
        assert!((planarity(&moved)[0] - expected).abs() < 1e-12);
    }

    #[test]
    fn a_pentagon_is_measured_like_a_quad() {
        // A rhombus with alternately lifted corners, then the same with a fifth corner on one of its edges' middle plane.
        let h = 0.01;
        let corners = [[1.0, 0.0, h], [0.0, 1.0, -h], [-1.0, 0.0, h], [0.0, -1.0, -h]].map(Point3::from);
        let quad = PanelMesh::new(corners.to_vec(), &[[0u32, 1, 2, 3]]).unwrap();
        let mean = mean_edge_length(&quad);
        assert!((planarity(&quad)[0] - 2.0 * h / mean).abs() < 1e-12);
        let mut five = corners.to_vec();
        five.push(Point3::new(0.5, -0.5, 0.0));
        let pentagon = PanelMesh::new(five, &[[0u32, 1, 2, 3, 4]]).unwrap();
        let relative = planarity(&pentagon)[0] * mean_edge_length(&pentagon) / (2.0 * h);
        assert!((relative - 1.0).abs() < 0.05, "{relative}");
    }

    #[test]
    fn triangles_and_parallel_diagonals_are_planar() {
        let vertices =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 1.0, 5.0]].map(Point3::from);
        let faces: [&[u32]; 2] = [&[0, 1, 4], &[0, 1, 2, 3]];
        let mesh = PanelMesh::new(vertices.to_vec(), &faces).unwrap();
        assert_eq!(planarity(&mesh), [0.0, 0.0]);
        assert_eq!(planarity(&PanelMesh { vertices: vec![Point3::origin(); 5], ..mesh }), [0.0, 0.0]);
    }

    #[test]
    fn each_edge_counts_once() {
        let vertices = (0..6).map(|i| Point3::new((i / 2) as f64, (i % 2) as f64 * 2.0, 0.0)).collect();
        let mesh = PanelMesh::new(vertices, &[[0u32, 2, 3, 1], [2, 4, 5, 3]]).unwrap();
        assert_eq!(edge_lengths(&mesh).len(), 7);
        assert!((mean_edge_length(&mesh) - 10.0 / 7.0).abs() < 1e-15);
    }
}
