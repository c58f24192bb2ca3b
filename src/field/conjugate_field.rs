//! The field that the later stages read: two directions on each triangle, their matching, their singularities.

use super::smooth::DirectionConstraint;
use super::topology::{EdgeTopology, NO_TRIANGLE};
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;

/// Two directions on each triangle of a surface mesh, conjugate wherever the surface is curved.
///
/// The directions of a triangle are the four of the cross u, v, -u, -v, in this order counter-clockwise about the normal.
#[derive(Clone, Debug)]
pub struct ConjugateField {
    /// The triangulated parameter domain of one patch, lifted.
    pub mesh: SurfaceMesh,
    /// Unit vectors u, v in the plane of each triangle, with (u x v) . normal > 0.
    pub directions: Vec<[Vector3<f64>; 2]>,
    /// Unit vectors u, v that the map follows, named as `directions` are: conjugate on the mean over a panel, smoother than those.
    pub layout: Vec<[Vector3<f64>; 2]>,
    /// Edges of the mesh.
    pub edges: EdgeTopology,
    /// For each edge (f, g): k in 0..4 such that direction i of (u, v, -u, -v) of f corresponds to direction (i + k) mod 4 of g.
    ///
    /// Order-preserving; 0 on border edges.
    pub matching: Vec<u8>,
    /// Inner vertices with an index other than 0, in order of their numbers.
    pub singularities: Vec<Singularity>,
    /// Whether the host fixed the singularities, so that the map keeps all of them.
    pub fixed_singularities: bool,
    /// Whether a family follows the border along the sides u = min, u = max, v = min, v = max.
    pub aligned_sides: [bool; 4],
    /// What the field was asked to follow: unit tangent directions with their weights; the map follows them too.
    pub lines: Vec<DirectionConstraint>,
    /// The same for the directions that run parallel to those lines, beside them.
    pub parallels: Vec<DirectionConstraint>,
    /// How good the field is.
    pub diagnostics: FieldDiagnostics,
}

/// A vertex around which the cross turns against the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Singularity {
    /// The vertex.
    pub vertex: u32,
    /// Index in quarter turns: +1 where three, -1 where five quads meet.
    pub index: i32,
}

/// Measures of a field. Residuals and angles are per triangle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldDiagnostics {
    /// Mean over the curved triangles, by area, of |II(u, v)| / (|II| |u| |v|), |II| the Frobenius norm; in [0, 1/sqrt 2].
    pub conjugacy_mean: f64,
    /// Largest of the same over the curved triangles.
    pub conjugacy_max: f64,
    /// Smallest angle between u and v as lines, degrees, in (0, 90].
    pub crossing_min_deg: f64,
    /// Dirichlet energy of the PolyVector coefficients, see [`super::smoothness_energy`].
    pub smoothness_energy: f64,
    /// Triangles where a hard constraint and the crossing floor left no conjugate pair: the floor won there.
    pub floor_triangles: Vec<u32>,
    /// Triangles too flat for conjugacy to mean anything; smoothness alone decided there.
    pub flat_triangles: Vec<u32>,
    /// Mean angle between a constraint and the nearer of the two families, degrees, by weight (hard ones count 1); 0 without constraints.
    pub constraint_angle_deg: f64,
    /// Gauss-Newton iterations spent.
    pub iterations: usize,
}

impl ConjugateField {
    /// Direction `i` mod 4 of (u, v, -u, -v) on a triangle.
    pub fn direction(&self, triangle: u32, i: usize) -> Vector3<f64> {
        numbered(self.directions[triangle as usize], i)
    }

    /// Layout direction `i` mod 4 of (u, v, -u, -v) on a triangle.
    pub fn layout_direction(&self, triangle: u32, i: usize) -> Vector3<f64> {
        numbered(self.layout[triangle as usize], i)
    }

    /// Matching from `from` to `to` across `edge`: direction i of `from` is direction (i + k) mod 4 of `to`.
    ///
    /// # Panics
    /// If the edge does not lie between the two triangles.
    pub fn matching_across(&self, edge: u32, from: u32, to: u32) -> u8 {
        let [f, g] = self.edges.triangles[edge as usize];
        let k = self.matching[edge as usize];
        if (f, g) == (from, to) && to != NO_TRIANGLE {
            k
        } else {
            assert!((f, g) == (to, from), "edge {edge} is not between triangles {from} and {to}");
            (4 - k) % 4
        }
    }
}

fn numbered([u, v]: [Vector3<f64>; 2], i: usize) -> Vector3<f64> {
    match i % 4 {
        0 => u,
        1 => v,
        2 => -u,
        _ => -v,
    }
}
