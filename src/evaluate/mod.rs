//! Measures the whole pipeline on sketches whose truth is known.

mod case;
pub mod metrics;
mod table;

pub use case::{Case, KEYS, measure};
pub use table::{groups, markdown, scores_json};

use crate::control::Control;
use crate::datagen::{Options, sample};
use crate::error::Error;
use crate::infer::{BackendOptions, Models, Networks};
use crate::pipeline::Session;

/// First seed of the held-out surfaces; training seeds stay below.
pub const FIRST_HELD_OUT_SEED: u64 = 9_000_000;

/// Measures `count` sketches of surfaces that training never saw, one after another; [`Control::step`] reports each.
///
/// A sketch that the pipeline refuses is a case with `failed` set, not an error.
///
/// # Errors
/// [`Error::Model`] and [`Error::Backend`] if the networks do not load, [`Error::Cancelled`].
pub fn evaluate(
    session: &mut Session,
    models: &Models,
    backend: &BackendOptions,
    count: u64,
    options: &Options,
    control: &Control,
) -> Result<Vec<Case>, Error> {
    let mut networks = Networks::load(models, backend)?;
    let mut cases = vec![];
    for index in 0..count {
        control.step("evaluate", index as f64 / count as f64)?;
        let Ok(truth) = sample(FIRST_HELD_OUT_SEED + index, options) else { continue };
        cases.push(measure(session, &mut networks, &truth)?);
    }
    control.step("evaluate", 1.0)?;
    Ok(cases)
}
