//! Networks through ONNX Runtime, loaded at run time.

use super::backend::{Engine, check_length, guarded, no_fixed_shape};
use super::{library, search};
use crate::error::Error;
use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::{Outlet, TensorElementType, TensorRef};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The ONNX Runtime of this process.
pub struct Runtime {
    /// The library file.
    pub path: PathBuf,
    /// Its version.
    pub version: String,
    environment: Environment,
}

/// What became of the first attempt: `ort` keeps the library and the environment that it was given first.
enum State {
    Untried,
    /// Held until the process ends: once the last handle of an environment is dropped, none can be made again.
    Ready(Arc<Runtime>),
    Broken {
        path: PathBuf,
        reason: String,
    },
}

static STATE: Mutex<State> = Mutex::new(State::Untried);

impl Runtime {
    /// The runtime of this process, searched for on the first call (see [`search`]).
    ///
    /// - `given`: file or folder that the host names; with `only_given` nothing else is considered.
    /// - returns the runtime, and how it was found.
    ///
    /// # Errors
    /// Where it was looked for and what was wrong there, as a clause for a message.
    pub fn find(given: Option<&Path>, only_given: bool) -> Result<(Arc<Self>, String), String> {
        // A panic while the state is held leaves it as it was before.
        let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
        let mut candidates = search::candidates(given);
        if only_given && given.is_some() {
            candidates.retain(|candidate| candidate.source == search::GIVEN);
        }
        match &*state {
            State::Ready(runtime) => {
                let wanted = candidates.first().filter(|candidate| candidate.source == search::GIVEN);
                let same = wanted.is_none_or(|candidate| same_file(&candidate.path, &runtime.path));
                if same {
                    return Ok((runtime.clone(), "already loaded".into()));
                }
                let loaded = format!("this process already runs {} from {}", runtime.version, runtime.path.display());
                return if only_given { Err(loaded) } else { Ok((runtime.clone(), loaded)) };
            }
            State::Broken { path, reason } => {
                return Err(format!("ONNX Runtime from {} failed earlier in this process: {reason}", path.display()));
            }
            State::Untried => {}
        }
        let mut failures = Vec::new();
        for candidate in &candidates {
            match library::probe(&candidate.path) {
                Ok(version) => {
                    let why = Self::explain(&candidate.source, &failures);
                    return match Self::start(&candidate.path, version) {
                        Ok(runtime) => {
                            let runtime = Arc::new(runtime);
                            *state = State::Ready(runtime.clone());
                            Ok((runtime, why))
                        }
                        Err(reason) => {
                            let message = format!("{}: {reason}", candidate.path.display());
                            *state = State::Broken { path: candidate.path.clone(), reason };
                            Err(message)
                        }
                    };
                }
                Err(reason) => failures.push(format!("{} ({}): {reason}", candidate.path.display(), candidate.source)),
            }
        }
        Err(if failures.is_empty() {
            "no ONNX Runtime found: none named, none beside the library, in Python environments or system folders"
                .into()
        } else {
            format!("no usable ONNX Runtime found: {}", failures.join("; "))
        })
    }

    fn explain(source: &str, failures: &[String]) -> String {
        match failures {
            [] => format!("found through {source}"),
            _ => format!("found through {source}, after {}", failures.join("; ")),
        }
    }

    /// Hands a probed library to `ort` and makes the one environment of the process.
    fn start(path: &Path, version: String) -> Result<Self, String> {
        let environment = ort::init_from(path)
            .map_err(|error| error.to_string())?
            .with_name("sketch2pq")
            .with_telemetry(false)
            // Errors come back as results; a library has no business on its host's stderr.
            .with_logger(Arc::new(|_, _, _, _, _| {}))
            .build()
            .map_err(|error| error.to_string())?;
        Ok(Self { path: path.to_path_buf(), version, environment })
    }
}

fn same_file(a: &Path, b: &Path) -> bool {
    a == b || matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// A network in an ONNX Runtime session of its own.
pub struct OnnxEngine {
    name: String,
    session: Session,
    input_name: String,
    input_shape: Vec<usize>,
    output_shape: Vec<usize>,
}

impl OnnxEngine {
    /// See [`super::backend::Backend::load`].
    pub fn load(runtime: &Runtime, name: &str, bytes: &[u8], threads: usize) -> Result<Self, Error> {
        let refused =
            |error: String| Error::Model { name: name.into(), reason: format!("ONNX Runtime refuses it: {error}") };
        let session = Self::session(runtime, bytes, threads).map_err(refused)?;
        let (input_name, input_shape) = only_tensor(name, "input", session.inputs())?;
        let (_, output_shape) = only_tensor(name, "output", session.outputs())?;
        let input_shape = input_shape.ok_or_else(|| no_fixed_shape(name, "input"))?;
        let mut engine = Self { name: name.into(), session, input_name, input_shape, output_shape: Vec::new() };
        engine.output_shape = match output_shape {
            Some(shape) => shape,
            None => engine.run_once(&vec![0.0; engine.input_shape.iter().product()])?.0,
        };
        Ok(engine)
    }

    fn session(runtime: &Runtime, bytes: &[u8], threads: usize) -> Result<Session, String> {
        fn text<R>(error: ort::Error<R>) -> String {
            error.to_string()
        }
        Session::builder(&runtime.environment)
            .map_err(text)?
            .with_log_level(LogLevel::Fatal)
            .map_err(text)?
            .with_optimization_level(GraphOptimizationLevel::All)
            .map_err(text)?
            .with_intra_threads(threads)
            .map_err(text)?
            .with_intra_op_spinning(false) // a host's interface needs the cores between runs
            .map_err(text)?
            .commit_from_memory(bytes)
            .map_err(text)
    }

    /// Shape and values of the output for an input of the right length.
    fn run_once(&mut self, input: &[f32]) -> Result<(Vec<usize>, Vec<f32>), Error> {
        let failed = |error: ort::Error| Error::Backend { backend: "ort", reason: format!("{}: {error}", self.name) };
        let tensor = TensorRef::from_array_view((self.input_shape.as_slice(), input)).map_err(failed)?;
        let outputs = self.session.run(ort::inputs![self.input_name.as_str() => tensor]).map_err(failed)?;
        let (shape, values) = outputs[0].try_extract_tensor::<f32>().map_err(failed)?;
        let shape = shape.iter().map(|&n| usize::try_from(n).unwrap_or(0)).collect();
        Ok((shape, values.to_vec()))
    }
}

impl Engine for OnnxEngine {
    fn input_shape(&self) -> &[usize] {
        &self.input_shape
    }

    fn output_shape(&self) -> &[usize] {
        &self.output_shape
    }

    fn run(&mut self, input: &[f32]) -> Result<Vec<f32>, Error> {
        check_length(&self.name, "input", &self.input_shape, input.len())?;
        let (_, values) = guarded(&self.name.clone(), || self.run_once(input))?;
        check_length(&self.name, "output", &self.output_shape, values.len())?;
        Ok(values)
    }
}

/// Name and shape of the only input or output; no shape if the file leaves a dimension open.
fn only_tensor(name: &str, what: &str, outlets: &[Outlet]) -> Result<(String, Option<Vec<usize>>), Error> {
    let wrong = |reason: String| Error::Model { name: name.into(), reason };
    let [outlet] = outlets else {
        return Err(wrong(format!("it has {} {what}s, expected one", outlets.len())));
    };
    let dtype = outlet.dtype();
    if dtype.tensor_type() != Some(TensorElementType::Float32) {
        return Err(wrong(format!("its {what} is {dtype:?}, expected 32-bit floats")));
    }
    let shape = dtype.tensor_shape().and_then(|shape| shape.iter().map(|&n| usize::try_from(n).ok()).collect());
    Ok((outlet.name().to_owned(), shape))
}
