//! What runs the networks: ONNX Runtime where one is found, an embedded engine where not.

use super::embedded::{self, EmbeddedEngine};
use super::onnx_runtime::{OnnxEngine, Runtime};
use crate::error::Error;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;

/// Most threads that a network uses unless the host asks for more; beyond that the small maps gain nothing.
const DEFAULT_THREADS_LIMIT: usize = 4;

/// Which backend to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BackendChoice {
    /// ONNX Runtime if a usable one is found, else the embedded engine.
    #[default]
    Auto,
    /// ONNX Runtime, or an error.
    Ort,
    /// The engine inside the library.
    Embedded,
}

impl BackendChoice {
    /// All choices, in the order of their numbers in the ABI.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Ort, Self::Embedded];

    /// Name in options and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Ort => "ort",
            Self::Embedded => "embedded",
        }
    }
}

impl std::str::FromStr for BackendChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|choice| choice.name() == text).ok_or_else(|| Error::Argument {
            name: "backend",
            value: text.into(),
            expected: "auto, ort or embedded",
        })
    }
}

/// How the networks are to be run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BackendOptions {
    /// Which backend.
    pub choice: BackendChoice,
    /// File or folder of the ONNX Runtime to use. With [`BackendChoice::Ort`] no other is considered, with
    /// [`BackendChoice::Auto`] it is the first to be tried.
    pub runtime_path: Option<PathBuf>,
    /// Threads within a network; 0 is the number of cores, at most 4.
    pub threads: usize,
}

impl BackendOptions {
    /// The number of threads that 0 stands for, or the one asked for.
    pub fn effective_threads(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from).min(DEFAULT_THREADS_LIMIT),
            threads => threads,
        }
    }
}

/// Which backend runs, for reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BackendInfo {
    /// `onnxruntime` or `rten`.
    pub name: &'static str,
    /// Its version.
    pub version: String,
    /// The library that was loaded; none for the embedded engine.
    pub path: Option<PathBuf>,
    /// Threads within a network.
    pub threads: usize,
    /// Why this one: what was asked, what was found, what was tried in vain.
    pub why: String,
}

impl std::fmt::Display for BackendInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.name, self.version)?;
        if let Some(path) = &self.path {
            write!(f, " ({})", path.display())?;
        }
        Ok(())
    }
}

/// One network, ready to run. One handle, one thread at a time.
pub trait Engine: Send {
    /// Shape of the only input, as the model file says.
    fn input_shape(&self) -> &[usize];

    /// Shape of the only output: as the model file says, or found by a run if it leaves that open.
    fn output_shape(&self) -> &[usize];

    /// Runs the network once.
    ///
    /// - `input`: as many values as the input shape says, row-major.
    /// - returns as many values as the output shape says, row-major.
    ///
    /// # Errors
    /// [`Error::Model`] if the lengths do not fit; [`Error::Backend`] if the engine fails.
    fn run(&mut self, input: &[f32]) -> Result<Vec<f32>, Error>;
}

/// A chosen backend, which loads models.
#[derive(Clone)]
pub struct Backend {
    kind: Kind,
    info: BackendInfo,
}

#[derive(Clone)]
enum Kind {
    OnnxRuntime(Arc<Runtime>),
    Embedded(Arc<rten::ThreadPool>),
}

impl Backend {
    /// Chooses a backend and gets it ready.
    ///
    /// A process can hold one ONNX Runtime only: the first that is loaded stays.
    ///
    /// # Errors
    /// [`Error::Backend`] if [`BackendChoice::Ort`] was asked for and no usable one is found.
    /// [`BackendChoice::Auto`] does not fail.
    pub fn open(options: &BackendOptions) -> Result<Self, Error> {
        let threads = options.effective_threads();
        if options.choice == BackendChoice::Embedded {
            return Ok(Self::embedded(threads, "asked for".into()));
        }
        match Runtime::find(options.runtime_path.as_deref(), options.choice == BackendChoice::Ort) {
            Ok((runtime, why)) => {
                let path = Some(runtime.path.clone());
                let info = BackendInfo { name: "onnxruntime", version: runtime.version.clone(), path, threads, why };
                Ok(Self { kind: Kind::OnnxRuntime(runtime), info })
            }
            Err(reason) if options.choice == BackendChoice::Ort => Err(Error::Backend { backend: "ort", reason }),
            Err(reason) => Ok(Self::embedded(threads, reason)),
        }
    }

    /// The embedded engine, and why it was taken.
    pub(super) fn embedded(threads: usize, why: String) -> Self {
        let pool = Arc::new(rten::ThreadPool::with_num_threads(threads));
        let version = embedded::VERSION.into();
        Self { kind: Kind::Embedded(pool), info: BackendInfo { name: "rten", version, path: None, threads, why } }
    }

    /// Which backend this is.
    pub fn info(&self) -> &BackendInfo {
        &self.info
    }

    /// Whether this is the engine inside the library.
    pub fn is_embedded(&self) -> bool {
        matches!(self.kind, Kind::Embedded(_))
    }

    /// Loads a network from the bytes of its ONNX file.
    ///
    /// `name` stands in messages. The network has one input and one output, both of fixed shape and 32-bit floats.
    ///
    /// # Errors
    /// [`Error::Model`] if the bytes are no such network, or use an operator that the backend lacks.
    pub fn load(&self, name: &str, bytes: &[u8]) -> Result<Box<dyn Engine>, Error> {
        guarded(name, || match &self.kind {
            Kind::OnnxRuntime(runtime) => OnnxEngine::load(runtime, name, bytes, self.info.threads)
                .map(|engine| Box::new(engine) as Box<dyn Engine>),
            Kind::Embedded(pool) => {
                EmbeddedEngine::load(pool, name, bytes).map(|engine| Box::new(engine) as Box<dyn Engine>)
            }
        })
    }
}

/// Turns a panic inside a backend into an error: what it is given comes from files.
pub(super) fn guarded<T>(name: &str, body: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    catch_unwind(AssertUnwindSafe(body)).unwrap_or_else(|panic| {
        let reason = format!("the backend gave up: {}", panic_text(panic.as_ref()));
        Err(Error::Model { name: name.into(), reason })
    })
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason told")
}

/// The error for a model file that leaves the size of its input or output open.
pub(super) fn no_fixed_shape(name: &str, what: &str) -> Error {
    Error::Model { name: name.into(), reason: format!("its {what} has no fixed shape") }
}

/// Checks what goes into a network and what comes out, so that one backend is as strict as the other.
pub(super) fn check_length(name: &str, what: &str, shape: &[usize], length: usize) -> Result<(), Error> {
    let expected = shape.iter().product::<usize>();
    if length == expected {
        return Ok(());
    }
    Err(Error::Model {
        name: name.into(),
        reason: format!("{what} of {length} values, expected {expected} ({shape:?})"),
    })
}
