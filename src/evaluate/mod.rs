//! Measures the whole pipeline on sketches whose truth is known.

mod bars;
mod case;
mod compare;
pub mod metrics;
mod sheet;
mod table;
mod timing;

pub use bars::{Bar, bars, bars_markdown};
pub use case::{Case, KEYS, measure, surface_scores};
pub use compare::comparison_markdown;
pub use sheet::{Rank, sheet};
pub use table::{groups, markdown, scores_json};
pub use timing::timing_markdown;

use crate::control::Control;
use crate::datagen::{Options, Rejection, Sample, sample, sample_again};
use crate::error::Error;
use crate::infer::Networks;
use crate::pipeline::Session;

/// First seed of the held-out surfaces; training seeds stay below.
pub const FIRST_HELD_OUT_SEED: u64 = 9_000_000;
/// First seed for unseen views of training surfaces.
const FIRST_ROTATION_SEED: u64 = 8_000_000;
/// First of the training seeds whose surfaces the split of rotations shows, and how far apart they are: a new surface each
/// time, within the first 16,384 seeds that the networks in `models/` were trained on.
const FIRST_SHOWN_SEED: u64 = 2_048;
const SHOWN_STRIDE: u64 = 16;

/// What was kept from training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Surfaces that training never saw, four sketches of each: the main one.
    Surfaces,
    /// New views of surfaces that training saw in four others. The paper splits pairs, 60 of each surface, so that its numbers
    /// are probably of this kind.
    Rotations,
}

impl Split {
    /// The sketch of this number.
    ///
    /// # Errors
    /// [`Rejection`] if its dice give none.
    pub fn sample(self, index: u64, options: &Options) -> Result<Sample, Rejection> {
        match self {
            Self::Surfaces => sample(FIRST_HELD_OUT_SEED + index, options),
            Self::Rotations => {
                // What training saw was made with the defaults.
                let shown = sample(FIRST_SHOWN_SEED + SHOWN_STRIDE * index, &Options::default())?;
                sample_again(&shown, FIRST_ROTATION_SEED + index, options)
            }
        }
    }
}

/// Measures the first `count` sketches of a split, one after another; [`Control::step`] reports each.
///
/// A sketch that the pipeline refuses is a case with `failed` set, not an error.
///
/// # Errors
/// [`Error::Model`] and [`Error::Backend`] if the networks do not load, [`Error::Cancelled`].
pub fn evaluate(
    session: &mut Session,
    networks: &mut Networks,
    split: Split,
    count: u64,
    options: &Options,
    control: &Control,
) -> Result<Vec<Case>, Error> {
    let mut cases = vec![];
    for index in 0..count {
        control.step("evaluate", index as f64 / count as f64)?;
        let Ok(truth) = split.sample(index, options) else { continue };
        cases.push(Case { index, ..measure(session, networks, &truth)? });
    }
    control.step("evaluate", 1.0)?;
    Ok(cases)
}
