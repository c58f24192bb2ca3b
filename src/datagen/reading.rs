//! What the sketch code makes of the strokes, held against the truth.

use super::layers::Layers;
use super::{Reason, Rejection};
use crate::sketch::{CANVAS_SIZE, Orientation, PatchSketch, Sketch, canvas_pixels, understand};

/// Share of the canvas' pixels on which the reading of a sketch may differ from the truth.
const MAX_MISREAD: f64 = 0.02;

/// The one patch of the sketch.
///
/// # Errors
/// [`Reason::Unread`] if the strokes cannot be understood or give several patches.
pub(super) fn read(sketch: &Sketch) -> Result<PatchSketch, Rejection> {
    let understanding = understand(sketch).map_err(|_| Rejection(Reason::Unread))?;
    let [patch] = <[PatchSketch; 1]>::try_from(understanding.patches).map_err(|_| Rejection(Reason::Unread))?;
    Ok(patch)
}

/// Compares layers and orientations pixel by pixel on the 256 canvas; `layers` are those of the surface in the patch's frame.
///
/// # Errors
/// [`Reason::Misread`] if more than 2 % of the canvas differ, or anything but slivers of an exactly drawn sketch, or if
/// the sketch hides what the surface does not.
pub(super) fn check(patch: &PatchSketch, layers: &Layers, noisy: bool) -> Result<(), Rejection> {
    let code = |side: Orientation| if side == Orientation::Front { 1u8 } else { 2 };
    let mut read = vec![[0u8; 2]; CANVAS_SIZE * CANVAS_SIZE];
    for region in &patch.regions {
        let labels = [code(region.visible), region.occluded.map_or(0, code)];
        for (row, column) in canvas_pixels(region) {
            read[row * CANVAS_SIZE + column] = labels;
        }
    }
    let mut differ = 0;
    let mut hidden = [0usize; 2];
    for (read, hits) in read.iter().zip(&layers.hits) {
        let truth = hits.map(|hit| hit.map_or(0, |h| if h.front { 1u8 } else { 2 }));
        differ += usize::from(*read != truth);
        hidden[0] += usize::from(read[1] > 0);
        hidden[1] += usize::from(truth[1] > 0);
    }
    let share = if noisy { MAX_MISREAD } else { 0.5 * MAX_MISREAD };
    let same = (hidden[0] == 0) == (hidden[1] == 0);
    if same && (differ as f64) <= share * (CANVAS_SIZE * CANVAS_SIZE) as f64 {
        Ok(())
    } else {
        Err(Rejection(Reason::Misread))
    }
}
