//! Progress and cancellation, shared by every long stage.

use crate::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Called with the stage's name and the fraction done, in [0, 1].
pub type ProgressCallback = dyn Fn(&str, f64) + Send + Sync;

/// How a host watches and stops a running stage.
///
/// Every stage calls [`Control::check`] at least once per outer iteration, and between networks, so that a cancel is
/// answered within tens of milliseconds.
#[derive(Clone, Default)]
pub struct Control {
    cancelled: Arc<AtomicBool>,
    progress: Option<Arc<ProgressCallback>>,
}

impl Control {
    /// A control whose progress is reported to `progress`.
    pub fn with_progress(progress: Arc<ProgressCallback>) -> Self {
        Self { cancelled: Arc::default(), progress: Some(progress) }
    }

    /// The same cancel flag, watched by another callback.
    pub fn watched_by(&self, progress: Arc<ProgressCallback>) -> Self {
        Self { cancelled: Arc::clone(&self.cancelled), progress: Some(progress) }
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
    /// [`Error::Cancelled`] once [`Control::cancel`] was called.
    pub fn check(&self) -> Result<(), Error> {
        if self.cancelled.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
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
