//! A host's curves in space, brought onto its surface.

use super::lift::resampled;
use super::placement::Placement;
use crate::error::Error;
use crate::surface::{NurbsSurface, SurfaceProjector};
use nalgebra::Point3;

/// A curve on or near a surface that one family of the field follows.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureCurve {
    /// At least two points, world frame; they are brought to the nearest points of the surface.
    pub points: Vec<Point3<f64>>,
    /// Whether the field follows it exactly, triangle by triangle, instead of yielding where curves contradict each other.
    pub hard: bool,
}

/// A piece of a curve on one patch.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CurvePiece {
    /// Surface parameters.
    pub parameters: Vec<[f64; 2]>,
    /// The same points, working frame.
    pub positions: Vec<Point3<f64>>,
    /// As asked for by the host.
    pub hard: bool,
}

/// Farthest that a curve may be from the surface, working units: a tenth of the surface's size.
const REACH: f64 = 0.8;
/// Distance of the points that are brought to the surface, working units: less than a third of a cell.
const STEP: f64 = 0.05;

/// Brings `curves` to the nearest of several surfaces, given in their working frames; pieces by surface.
///
/// Where the nearest surface changes, the curve is cut.
///
/// # Errors
/// [`Error::Argument`] for a curve of less than two points, with a coordinate that is not finite, or farther than a tenth of a surface's size
/// from each of them.
pub(super) fn on_surfaces(
    surfaces: &[(NurbsSurface, Placement)],
    curves: &[FeatureCurve],
) -> Result<Vec<Vec<CurvePiece>>, Error> {
    let mut pieces: Vec<Vec<CurvePiece>> = vec![vec![]; surfaces.len()];
    let fail = |value: String, expected| Err(Error::Argument { name: "curves", value, expected });
    for (index, curve) in curves.iter().enumerate() {
        if curve.points.len() < 2 {
            return fail(format!("curve {index} of {} points", curve.points.len()), "two points or more each");
        }
        if !curve.points.iter().flat_map(|p| p.iter()).all(|x| x.is_finite()) {
            return fail(format!("curve {index} with a coordinate that is not finite"), "finite coordinates");
        }
    }
    if curves.is_empty() {
        return Ok(pieces);
    }
    let projectors: Vec<SurfaceProjector> =
        surfaces.iter().map(|(surface, _)| SurfaceProjector::new(surface)).collect();
    let step = surfaces.iter().map(|(_, placement)| STEP / placement.scale).fold(f64::INFINITY, f64::min);
    for (index, curve) in curves.iter().enumerate() {
        let points: Vec<[f64; 3]> = curve.points.iter().map(|p| [p.x, p.y, p.z]).collect();
        let mut last = None;
        for point in resampled(&points, step) {
            let feet = surfaces.iter().zip(&projectors).enumerate().map(|(k, ((_, placement), projector))| {
                let foot = projector.closest(&placement.from_world(&Point3::from(point)));
                (k, foot, foot.distance / placement.scale)
            });
            let nearest = feet.min_by(|a, b| a.2.total_cmp(&b.2));
            let Some((patch, foot, distance)) = nearest else { continue };
            if foot.distance > REACH {
                return fail(format!("curve {index} at a distance of {distance:.4}"), "curves on or near the surface");
            }
            if last != Some(patch) {
                pieces[patch].push(CurvePiece { parameters: vec![], positions: vec![], hard: curve.hard });
            }
            last = Some(patch);
            if let Some(piece) = pieces[patch].last_mut() {
                piece.parameters.push(foot.parameters);
                piece.positions.push(foot.position);
            }
        }
    }
    pieces.iter_mut().for_each(|pieces| pieces.retain(|piece| piece.positions.len() > 1));
    Ok(pieces)
}
