//! Where a mesh is no longer what it was: faces turned over, edges collapsed.

use super::state::State;
use nalgebra::{Point3, Vector3};

/// Length of an edge over its length at the start, below which a mesh counts as spoiled.
const COLLAPSED: f64 = 0.05;

/// Bound of the factor on an edge's stretch weight.
const LARGEST_STIFFNESS: f64 = 1e4;

/// Further factor on that of edges at turned faces and of collapsed edges.
const STIFFENING_THERE: f64 = 5.0;

/// Where a mesh is no longer what it was.
pub(super) struct Spoiled {
    /// Faces that turned over or got stuck before they were planar.
    pub(super) faces: Vec<usize>,
    /// Edges that all but collapsed, as places in the list of edges.
    pub(super) edges: Vec<usize>,
}

impl Spoiled {
    pub(super) fn is_empty(&self) -> bool {
        self.faces.is_empty() && self.edges.is_empty()
    }
}

impl State<'_> {
    /// Faces that should be planar and miss `target`, or turned over, and edges that all but collapsed, compared with the start.
    pub(super) fn spoiled(&self, target: f64) -> Spoiled {
        let before = &self.input.mesh.vertices;
        let area = |vertices: &[Point3<f64>], face: &[u32]| -> Vector3<f64> {
            let origin = vertices[face[0] as usize];
            (1..face.len() - 1)
                .map(|k| (vertices[face[k] as usize] - origin).cross(&(vertices[face[k + 1] as usize] - origin)))
                .sum()
        };
        let length = |vertices: &[Point3<f64>], [a, b]: [u32; 2]| (vertices[a as usize] - vertices[b as usize]).norm();
        let turned = |face: &[u32]| area(before, face).dot(&area(&self.vertices, face)) < 0.0;
        let collapsed = |edge: [u32; 2]| length(&self.vertices, edge) < COLLAPSED * length(before, edge);
        let mesh = self.input.mesh;
        let bent: Vec<bool> = if target < f64::INFINITY {
            self.planarity().into_iter().map(|p| p > target).collect()
        } else {
            vec![false; mesh.face_count()]
        };
        Spoiled {
            faces: (0..mesh.face_count()).filter(|&f| turned(mesh.face(f)) || bent[f]).collect(),
            edges: (0..self.edges.len()).filter(|&e| collapsed(self.edges[e])).collect(),
        }
    }

    /// The edges of a face, as places in the list of edges.
    fn edges_around(&self, face: usize) -> impl Iterator<Item = usize> + '_ {
        let face = self.input.mesh.face(face);
        (0..face.len()).filter_map(|k| {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            self.edges.binary_search(&[a.min(b), a.max(b)]).ok()
        })
    }

    /// The edges of the spoiled faces, and the spoiled edges; ascending.
    pub(super) fn edges_of(&self, spoiled: &Spoiled) -> Vec<usize> {
        let mut edges = spoiled.edges.clone();
        edges.extend(spoiled.faces.iter().flat_map(|&f| self.edges_around(f)));
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// The faces with an edge among `edges`, which ascend; ascending.
    pub(super) fn faces_at(&self, edges: &[usize]) -> Vec<usize> {
        let is_there = |f: &usize| self.edges_around(*f).any(|e| edges.binary_search(&e).is_ok());
        (0..self.input.mesh.face_count()).filter(is_there).collect()
    }

    /// The corners of the spoiled faces and the ends of the spoiled edges, ascending.
    pub(super) fn vertices_of(&self, spoiled: &Spoiled) -> Vec<usize> {
        let mesh = self.input.mesh;
        let corners = spoiled.faces.iter().flat_map(|&f| mesh.face(f)).copied();
        let ends = spoiled.edges.iter().flat_map(|&e| self.edges[e]);
        let mut vertices: Vec<usize> = corners.chain(ends).map(|v| v as usize).collect();
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    }

    /// Makes edges stiffer, those of `spoiled` above all.
    pub(super) fn stiffen(&mut self, spoiled: &Spoiled, all: f64) {
        let edges = self.edges_of(spoiled);
        edges.iter().for_each(|&e| self.stiffness[e] *= STIFFENING_THERE);
        self.stiffness.iter_mut().for_each(|s| *s = (*s * all).min(LARGEST_STIFFNESS));
    }
}
