//! How smooth a field of crosses is.

use super::polyvector::PolyVector;
use super::topology::{EdgeTopology, TriangleFrames};
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;

/// Dirichlet energy of the PolyVector coefficients of a field of unit directions: the sum over inner edges of
/// w (|s_g - s_f|^2 + |p_g - p_f|^2), the coefficients of f carried to the frame of g.
///
/// w = 2 / (cot a + cot b), the edge's length over that of its dual, a and b being the opposite angles (at least 0.1 below the line): so
/// the sum approximates the integral of |grad s|^2 + |grad p|^2, which is dimensionless and does not change with scale.
///
/// # Source
/// Sketch2PQ, Sec. 5 (E_smooth), with the energy of Diamanti et al. 2015; the paper gives no weights.
pub fn smoothness_energy(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    frames: &TriangleFrames,
    directions: &[[Vector3<f64>; 2]],
) -> f64 {
    weighted_energy(edges, frames, directions, &edge_weights(mesh, edges))
}

/// [`smoothness_energy`] with the edges' weights at hand.
pub(super) fn weighted_energy(
    edges: &EdgeTopology,
    frames: &TriangleFrames,
    directions: &[[Vector3<f64>; 2]],
    weights: &[f64],
) -> f64 {
    let poly: Vec<PolyVector> = directions
        .iter()
        .enumerate()
        .map(|(t, d)| PolyVector::from_directions(frames.components(t, &d[0]), frames.components(t, &d[1])))
        .collect();
    (0..edges.len())
        .filter(|&e| !edges.is_border(e))
        .map(|e| {
            let [f, g] = edges.triangles[e].map(|t| t as usize);
            let carried = poly[f].rotated(frames.turns[e]);
            weights[e] * ((poly[g].s - carried.s).norm_sqr() + (poly[g].p - carried.p).norm_sqr())
        })
        .sum()
}

/// Length of each inner edge over that of its dual, at most 20; 0 on the border.
pub(super) fn edge_weights(mesh: &SurfaceMesh, edges: &EdgeTopology) -> Vec<f64> {
    let mut cotangents = vec![0.0; edges.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|i| mesh.position(corners[(k + i) % 3]));
            let (p, q) = (a - c, b - c);
            let area = p.cross(&q).norm();
            // A triangle without area couples its neighbours as if it were not there.
            let cotangent = if area > 0.0 { p.dot(&q) / area } else { 0.0 };
            cotangents[edges.triangle_edges[t][k] as usize] += cotangent;
        }
    }
    (0..edges.len()).map(|e| if edges.is_border(e) { 0.0 } else { 2.0 / cotangents[e].clamp(0.1, 1e3) }).collect()
}
