//! Meshes of polygonal panels, mostly quads.

use crate::error::Error;
use nalgebra::Point3;

/// A mesh of polygons: vertices, and for each face its vertex indices, counter-clockwise seen from the front.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PanelMesh {
    /// Vertex positions, model frame.
    pub vertices: Vec<Point3<f64>>,
    /// F + 1 offsets into `indices`; face f is `indices[starts[f]..starts[f + 1]]`.
    pub starts: Vec<u32>,
    /// Vertex indices of all faces, one after another.
    pub indices: Vec<u32>,
}

impl PanelMesh {
    /// Checks and takes a mesh.
    ///
    /// # Errors
    /// [`Error::VertexOutOfRange`] for the first bad index, [`Error::NotFinite`] for a bad vertex, [`Error::Degenerate`] for
    /// a face with fewer than three or with repeated vertices.
    pub fn new(vertices: Vec<Point3<f64>>, faces: &[impl AsRef<[u32]>]) -> Result<Self, Error> {
        if let Some(index) = vertices.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(Error::NotFinite { what: "vertex", index });
        }
        let mut mesh = Self { vertices, starts: vec![0], indices: vec![] };
        for (face, corners) in faces.iter().enumerate() {
            let corners = corners.as_ref();
            let count = mesh.vertices.len();
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= count) {
                return Err(Error::VertexOutOfRange { face, vertex, count });
            }
            let repeated = (1..corners.len()).any(|i| corners[..i].contains(&corners[i]));
            if corners.len() < 3 || repeated {
                return Err(Error::Degenerate { reason: format!("face {face} has the corners {corners:?}") });
            }
            mesh.indices.extend_from_slice(corners);
            mesh.starts.push(mesh.indices.len() as u32);
        }
        Ok(mesh)
    }

    /// Number of faces.
    pub fn face_count(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Vertex indices of a face.
    pub fn face(&self, face: usize) -> &[u32] {
        &self.indices[self.starts[face] as usize..self.starts[face + 1] as usize]
    }

    /// All faces in order.
    pub fn faces(&self) -> impl ExactSizeIterator<Item = &[u32]> {
        (0..self.face_count()).map(|f| self.face(f))
    }
}
