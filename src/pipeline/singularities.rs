//! A host's singularities, brought onto its surfaces and their triangulations.

use super::placement::Placement;
use crate::error::Error;
use crate::field::Singularity;
use crate::surface::{NurbsSurface, SurfaceMesh, SurfaceProjector};
use nalgebra::Point3;

/// A place on one of several surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfacePlace {
    /// A point on or near a surface, world frame; it is brought to the nearest point of the nearest surface.
    Point(Point3<f64>),
    /// Parameters (u, v) of a patch.
    Parameters {
        /// Number of the patch.
        patch: usize,
        /// Within the patch's domain.
        uv: [f64; 2],
    },
}

/// A singularity that the field shall have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedSingularity {
    /// Inside a patch; the field has it at the nearest inner vertex of its triangulation.
    pub place: SurfacePlace,
    /// Index in quarter turns: 1 where three, -1 where five quads meet.
    pub index: i32,
}

/// Parameters of a singularity and its index, quarter turns.
pub(super) type Place = ([f64; 2], i32);

/// Farthest that a point may be from the surface, working units: a tenth of the surface's size.
const REACH: f64 = 0.8;

/// The singularities of each patch, as parameters and index.
///
/// - `surfaces`: in their working frames.
///
/// # Errors
/// [`Error::Argument`] for a point that is not finite or farther than a tenth of a surface's size from each of them, a patch that does not
/// exist, or parameters outside its domain.
pub(super) fn on_surfaces(
    surfaces: &[(NurbsSurface, Placement)],
    singularities: &[FixedSingularity],
) -> Result<Vec<Vec<Place>>, Error> {
    let mut found = vec![vec![]; surfaces.len()];
    let fail = |value: String, expected| Err(Error::Argument { name: "singularities", value, expected });
    let mut projectors: Option<Vec<SurfaceProjector>> = None;
    for (number, FixedSingularity { place, index }) in singularities.iter().enumerate() {
        let (patch, uv) = match place {
            SurfacePlace::Parameters { patch, uv } => {
                let Some((surface, _)) = surfaces.get(*patch) else {
                    return fail(format!("number {number} on patch {patch} of {}", surfaces.len()), "existing patches");
                };
                let inside = (0..2).all(|k| {
                    let [low, high] = [0.0, 1.0].map(|s| surface.knots()[k].at_fraction(s));
                    uv[k] >= low && uv[k] <= high
                });
                if !inside {
                    return fail(format!("number {number} at {uv:?}"), "parameters within the patch's domain");
                }
                (*patch, *uv)
            }
            SurfacePlace::Point(point) => {
                if !point.iter().all(|x| x.is_finite()) {
                    return fail(format!("number {number} with a coordinate that is not finite"), "finite coordinates");
                }
                let projectors =
                    projectors.get_or_insert_with(|| surfaces.iter().map(|(s, _)| SurfaceProjector::new(s)).collect());
                let feet =
                    surfaces.iter().zip(projectors.iter()).enumerate().map(|(k, ((_, placement), projector))| {
                        let foot = projector.closest(&placement.from_world(point));
                        (k, foot, foot.distance / placement.scale)
                    });
                match feet.min_by(|a, b| a.2.total_cmp(&b.2)) {
                    Some((patch, foot, _)) if foot.distance <= REACH => (patch, foot.parameters),
                    Some((_, _, distance)) => {
                        let value = format!("number {number} at a distance of {distance:.4}");
                        return fail(value, "points on or near the surface");
                    }
                    None => return fail(format!("number {number} without a surface"), "a surface"),
                }
            }
        };
        found[patch].push((uv, *index));
    }
    Ok(found)
}

/// The inner vertices of a triangulation nearest to places in its parameter domain.
pub(super) fn on_mesh(mesh: &SurfaceMesh, places: &[Place]) -> Vec<Singularity> {
    let nv = mesh.cells[1];
    places
        .iter()
        .map(|&(uv, index)| {
            let [i, j] = [0, 1].map(|k| {
                let stride = if k == 0 { nv + 1 } else { 1 };
                let off = |i: &usize| (mesh.parameters[i * stride][k] - uv[k]).abs();
                (1..mesh.cells[k]).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
            });
            Singularity { vertex: (i * (nv + 1) + j) as u32, index }
        })
        .collect()
}
