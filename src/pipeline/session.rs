//! What a host keeps between calls: loaded networks, threads, progress, cancel.

use super::live::LiveSurfaces;
use crate::control::Control;
use crate::error::Error;
use crate::infer::{BackendChoice, BackendInfo, BackendOptions, Models, Networks};
use serde::ser::{Serialize, SerializeStruct, Serializer};
use std::cell::Cell;
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, mpsc};
use std::time::Instant;

/// Stack of each worker thread, bytes: sparse factorizations recurse.
const STACK_SIZE: usize = 8 << 20;

/// Most threads that a session may be given.
pub const MAX_THREADS: usize = 256;

/// Called with the stage's name and the fraction of it done, in [0, 1].
pub type Progress = dyn FnMut(&str, f64) + Send;

/// How a session is made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionOptions {
    /// What runs the networks.
    pub backend: BackendChoice,
    /// File or folder of the ONNX Runtime; `None`: search for one.
    pub runtime_path: Option<PathBuf>,
    /// Folder of models to use instead of the built-in ones.
    pub models_folder: Option<PathBuf>,
    /// Threads for the stages; 0: as many as the machine has cores.
    pub threads: usize,
    /// For a sketch that is drawn while the host looks on: [`super::sketch_to_surface`] begins with the last surface where the
    /// sketch changed little, and in a [`super::SharedSession`] a newer sketch stops older work.
    ///
    /// The price: a surface then depends on what was drawn before, within what the strokes leave open. Without it the same sketch
    /// gives the same bytes.
    pub live: bool,
}

/// Loaded networks and the threads that the stages run on.
///
/// Cheap to keep, and the three calls take it in turn: one thread at a time. The stages run on the session's own
/// threads; progress is reported on the thread that called, so that a host may touch its user interface there.
pub struct Session {
    networks: Networks,
    control: Control,
    threads: rayon::ThreadPool,
    progress: Option<Box<Progress>>,
    /// The last sketch's surfaces; `None` unless the session is live.
    live: Option<LiveSurfaces>,
    /// The newest ticket of a live session, and that of the work at hand: a newer one cancels.
    pub(super) newest: Arc<AtomicU64>,
    pub(super) ticket: u64,
}

impl Session {
    /// Loads the networks and starts the threads.
    ///
    /// # Errors
    /// [`Error::Backend`] and [`Error::Model`] if the networks cannot be run as asked; [`Error::Argument`] for more
    /// than [`MAX_THREADS`] threads, or if the system gives none.
    pub fn new(options: &SessionOptions) -> Result<Self, Error> {
        let fail = |expected| Error::Argument { name: "threads", value: options.threads.to_string(), expected };
        if options.threads > MAX_THREADS {
            return Err(fail("at most 256"));
        }
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads)
            .stack_size(STACK_SIZE)
            .thread_name(|i| format!("sketch2pq {i}"))
            .build()
            .map_err(|_| fail("a number of threads that the system can start"))?;
        let backend = BackendOptions {
            choice: options.backend,
            runtime_path: options.runtime_path.clone(),
            threads: options.threads,
        };
        let models = match &options.models_folder {
            Some(folder) => Models::from_folder(folder)?,
            None => Models::embedded()?,
        };
        let networks = Networks::load(&models, &backend)?;
        Ok(Self {
            networks,
            control: Control::default(),
            threads,
            progress: None,
            live: options.live.then(LiveSurfaces::default),
            newest: Arc::default(),
            ticket: 0,
        })
    }

    /// A handle on the session's cancel flag, for any thread.
    ///
    /// A cancel stops the running call, or, if none runs, the next one; the call that it stops forgets it again, and so
    /// does a call that ends before it sees it.
    pub fn control(&self) -> Control {
        self.control.clone()
    }

    /// Watches the stages of later calls; `None` ends it.
    pub fn set_progress(&mut self, progress: Option<Box<Progress>>) {
        self.progress = progress;
    }

    /// Whether [`SessionOptions::live`] was asked for.
    pub fn is_live(&self) -> bool {
        self.live.is_some()
    }

    /// What runs the networks.
    pub fn backend(&self) -> &BackendInfo {
        self.networks.backend()
    }

    /// Number of threads that the stages run on.
    pub fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Runs `body` on the session's threads, and reports its progress on this one.
    pub(super) fn run<T: Send>(
        &mut self,
        body: impl FnOnce(&mut Networks, &Control) -> Result<T, Error> + Send,
    ) -> Result<T, Error> {
        self.run_with(|networks, _, control| body(networks, control))
    }

    /// [`Self::run`] with what a live session keeps of the last sketch.
    pub(super) fn run_with<T: Send>(
        &mut self,
        body: impl FnOnce(&mut Networks, Option<&mut LiveSurfaces>, &Control) -> Result<T, Error> + Send,
    ) -> Result<T, Error> {
        let (sender, receiver) = mpsc::channel::<(String, f64)>();
        let control = self.control.watched_by(Arc::new(move |stage: &str, fraction| {
            // The receiver lives as long as the scope below.
            let _ = sender.send((stage.to_owned(), fraction));
        }));
        let control = control.while_newest(Arc::clone(&self.newest), self.ticket);
        let live = self.live.as_mut();
        let networks = &mut self.networks;
        let progress = &mut self.progress;
        let mut outcome = None;
        self.threads.in_place_scope(|scope| {
            let outcome = &mut outcome;
            // The control moves in: when the body ends, however it ends, the channel closes.
            scope.spawn(move |_| *outcome = Some(body(networks, live, &control)));
            while let Ok(first) = receiver.recv() {
                // A slow host sees the newest step only.
                let (stage, fraction) = receiver.try_iter().last().unwrap_or(first);
                let (stage, fraction) = whole_stage(&stage, fraction);
                if let Some(progress) = progress {
                    REPORTING.set(true);
                    progress(stage, fraction);
                    REPORTING.set(false);
                }
            }
        });
        self.control.reset();
        outcome.expect("the scope ended, so its body did, and a panic would have left this function")
    }
}

thread_local! {
    /// Whether a progress callback runs on this thread, from which no call may wait for a session.
    pub(super) static REPORTING: Cell<bool> = const { Cell::new(false) };
}

/// The stage that a host knows, and the fraction of it, for a step that reports itself by a name of its own.
fn whole_stage(step: &str, fraction: f64) -> (&str, f64) {
    match step {
        "map" => ("mesh", 0.8 * fraction),
        "extract" => ("mesh", 0.8 + 0.2 * fraction),
        other => (other, fraction),
    }
}

/// Wall-clock milliseconds of each stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// Reading the strokes: curves, arrangement, visibility, maps.
    pub sketch: f64,
    /// The networks.
    pub infer: f64,
    /// Corners, border curves, first control net, Gauss-Newton.
    pub refine: f64,
    /// Conjugate direction field.
    pub field: f64,
    /// Integer-grid map, extraction, border.
    pub mesh: f64,
    /// Planarization and measures.
    pub planarize: f64,
}

impl Serialize for Times {
    /// The stages and their `total`.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_struct("Times", 7)?;
        map.serialize_field("sketch", &self.sketch)?;
        map.serialize_field("infer", &self.infer)?;
        map.serialize_field("refine", &self.refine)?;
        map.serialize_field("field", &self.field)?;
        map.serialize_field("mesh", &self.mesh)?;
        map.serialize_field("planarize", &self.planarize)?;
        map.serialize_field("total", &self.total())?;
        map.end()
    }
}

impl Times {
    /// All stages together.
    pub fn total(&self) -> f64 {
        self.sketch + self.infer + self.refine + self.field + self.mesh + self.planarize
    }
}

/// Runs `work` and adds its milliseconds to `time`.
pub(super) fn timed<T>(time: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *time += start.elapsed().as_secs_f64() * 1e3;
    result
}
