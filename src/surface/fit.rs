//! From what a surface has to obey to the surface: a first one from the maps, refined.

use super::border::BorderCurves;
use super::nurbs::NurbsSurface;
use super::refine::{RefineOptions, RefineReport, Refined, Refiner};
use super::targets::SurfaceTargets;
use super::unfold::unfolded_net;
use crate::control::Control;
use crate::error::Error;

/// Smoothness of the second start of a surface that does not obey.
const SMOOTHER: f64 = 10.0;
/// Factor on the weights of contours that are still missed after that.
const INSISTENCE: f64 = 8.0;
/// Largest mean miss of the contours that stands, pixels of the 256 canvas: what is asked of the strokes.
const CONTOUR_MISS_PX: f64 = 0.5;
/// Largest miss of a depth sample that stands, canonical units: a hundredth of the depth range of a usual patch.
const SAMPLE_MISS: f64 = 0.06;

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
/// over, or misses contours or depth samples, once more from smoother unfolded maps, and where the better of the two still misses, once
/// more from there with contours that count more; the best of all.
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
    if faults(&refined.report) == (0, 0.0) || options.iterations == 0 {
        return Ok(refined);
    }
    // Parameter lines that jam in the start seldom come apart; in a smoother one they run more evenly.
    let smoother = unfolded_surface(targets, curves, SMOOTHER)?;
    let again = refiner.run_best(&[smoother], control)?;
    let better = |a: Refined, b: Refined| if faults(&b.report) < faults(&a.report) { b } else { a };
    let refined = better(refined, again);
    if faults(&refined.report) == (0, 0.0) || targets.contours.is_empty() {
        return Ok(refined);
    }
    refiner.insistence = INSISTENCE;
    let insistent = refiner.run_best(std::slice::from_ref(&refined.surface), control)?;
    Ok(better(refined, insistent))
}

/// Fold-overs, and by how many times what is asked contours and depth samples are missed beyond it.
fn faults(report: &RefineReport) -> (usize, f64) {
    let beyond = |miss: f64, asked: f64| (miss / asked - 1.0).max(0.0);
    (report.folds, beyond(report.contour_px[0], CONTOUR_MISS_PX) + beyond(report.sample_residual, SAMPLE_MISS))
}
