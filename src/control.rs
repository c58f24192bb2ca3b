//! Progress and cancellation, shared by every long stage.

use crate::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Called with the stage's name and the fraction done, in [0, 1].
pub type ProgressCallback = dyn Fn(&str, f64) + Send + Sync;

/// How a host watches and stops a running stage.
///
/// Every stage calls [`Control::check`] at least once per outer iteration, and between networks, so that a cancel is
/// answered within tens of milliseconds.
#[derive(Clone, Default)]
pub struct Control {
    cancelled: Arc<AtomicBool>,
    /// The newest ticket handed out, and the one that this work was begun with.
    ticket: Option<(Arc<AtomicU64>, u64)>,
    progress: Option<Arc<ProgressCallback>>,
}

impl Control {
    /// A control whose progress is reported to `progress`.
    pub fn with_progress(progress: Arc<ProgressCallback>) -> Self {
        Self { progress: Some(progress), ..Self::default() }
    }

    /// The same cancel flag, watched by another callback.
    pub fn watched_by(&self, progress: Arc<ProgressCallback>) -> Self {
        Self { progress: Some(progress), ..self.clone() }
    }

    /// The same control, cancelled also once `newest` counts beyond `ticket`: newer work has come, the rest of this is in vain.
    pub fn while_newest(self, newest: Arc<AtomicU64>, ticket: u64) -> Self {
        Self { ticket: Some((newest, ticket)), ..self }
    }

    /// Asks the running stage to stop; may be called from any thread.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Forgets an earlier cancel, before a new run.
    pub fn reset(&self) {
        self.cancelled.store(false, Ordering::Relaxed);
    }

    /// # Errors
    /// [`Error::Cancelled`] once [`Control::cancel`] was called, or newer work has come, see [`Control::while_newest`].
    pub fn check(&self) -> Result<(), Error> {
        let outdated = self.ticket.as_ref().is_some_and(|(newest, ticket)| newest.load(Ordering::Relaxed) != *ticket);
        if outdated || self.cancelled.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Reports progress, then looks for a cancel.
    ///
    /// # Errors
    /// [`Error::Cancelled`] as [`Control::check`].
    pub fn step(&self, stage: &str, fraction: f64) -> Result<(), Error> {
        if let Some(progress) = &self.progress {
            progress(stage, fraction.clamp(0.0, 1.0));
        }
        self.check()
    }
}
