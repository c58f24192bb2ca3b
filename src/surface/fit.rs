//! From what a surface has to obey to the surface: a first one from the maps, refined.

use super::border::BorderCurves;
use super::nurbs::NurbsSurface;
use super::refine::{RefineOptions, Refined, Refiner};
use super::targets::SurfaceTargets;
use super::unfold::unfolded_net;
use crate::control::Control;
use crate::error::Error;

/// Smoothness of the second start of a surface that folds over.
const SMOOTHER: f64 = 10.0;

/// The layer maps, meeting the depth samples, as one sheet; `smoothness` as [`unfolded_net`] has it.
///
/// # Errors
/// As [`unfolded_net`].
pub fn unfolded_surface(
    targets: &SurfaceTargets,
    curves: &BorderCurves,
    smoothness: f64,
) -> Result<NurbsSurface, Error> {
    let maps = targets.maps.meeting(&targets.samples);
    let net = unfolded_net(&targets.border, curves, &targets.contours, &maps, smoothness)?;
    NurbsSurface::new(curves.knots.clone(), net, None)
}

/// Surface that obeys `targets`: the unfolded maps, or the targets' other guess if that begins with less energy, refined; where it folds
/// over, once more from smoother unfolded maps, and the better of the two.
///
/// - `curves`: the border in space, made of the targets' border, corners and maps.
///
/// # Errors
/// As [`unfolded_net`] and [`super::refine_best`].
pub fn fit(
    targets: &SurfaceTargets,
    curves: &BorderCurves,
    options: &RefineOptions,
    control: &Control,
) -> Result<Refined, Error> {
    let (refiner, unfolded) =
        rayon::join(|| Refiner::new(&curves.knots, targets, options), || unfolded_surface(targets, curves, 1.0));
    let (mut refiner, mut starts) = (refiner?, vec![unfolded?]);
    starts.extend(targets.guess.clone());
    let refined = refiner.run_best(&starts, control)?;
    if refined.report.folds == 0 || options.iterations == 0 {
        return Ok(refined);
    }
    // Parameter lines that jam in the start seldom come apart; in a smoother one they run more evenly.
    let smoother = unfolded_surface(targets, curves, SMOOTHER)?;
    let again = refiner.run_best(&[smoother], control)?;
    Ok(if again.report.folds < refined.report.folds { again } else { refined })
}
