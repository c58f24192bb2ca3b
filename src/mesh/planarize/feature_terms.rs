//! How far edges turn from the feature lines beside them.

use super::{PlanarizeInput, PlanarizeOptions};
use crate::mesh::feature_lines::feature_pieces;
use nalgebra::Vector3;

/// The squared angle between a piece of a feature line and the edges of the panel under it.
pub(super) struct FeatureTerm {
    /// Corners of the panel.
    pub(super) corners: [u32; 4],
    /// How the edges' direction at the piece comes from the corners.
    pub(super) factors: [f64; 4],
    /// Unit vector in the panel, across the line: the direction should have no part in it.
    pub(super) across: Vector3<f64>,
    /// On the square of that part, in mean edges.
    pub(super) weight: f64,
}

/// Angle between a feature line and both families of edges beyond which neither is meant, radians.
const FARTHEST_FEATURE: f64 = 0.6;

/// The pieces of the feature lines, each with the family of edges that is nearer to it.
pub(super) fn feature_terms(input: &PlanarizeInput, options: &PlanarizeOptions, edge: f64) -> Vec<FeatureTerm> {
    let mesh = input.mesh;
    let mut terms = vec![];
    for piece in feature_pieces(input.feature_lines, mesh) {
        let directions = piece.directions(mesh);
        let normal = directions[0].cross(&directions[1]);
        let Some(across) = normal.cross(&piece.along).try_normalize(0.0) else { continue };
        let sines = directions.map(|d| d.dot(&across).abs() / d.norm().max(f64::MIN_POSITIVE));
        let family = usize::from(sines[1] < sines[0]);
        if sines[family] > FARTHEST_FEATURE.sin() {
            continue;
        }
        let face = mesh.face(piece.face as usize);
        let weight = options.features * piece.along.norm() * edge / directions[family].norm_squared();
        let (corners, factors) = ([0, 1, 2, 3].map(|k| face[k]), piece.families()[family]);
        terms.push(FeatureTerm { corners, factors, across, weight });
    }
    terms
}
