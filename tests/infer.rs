//! Both backends run the shipped networks alike, and whatever is wrong with a runtime is said and survived.
//!
//! One process holds one ONNX Runtime, so the order of the steps matters where `ort` is involved: they are one test.

use sketch2pq::Error;
use sketch2pq::infer::{Backend, BackendChoice, BackendOptions, Models, Network, Networks};
use std::path::{Path, PathBuf};

/// Largest difference between the backends, in the units of the networks' outputs.
const TOLERANCE: f32 = 1e-3;

fn options(choice: BackendChoice, runtime_path: Option<&Path>) -> BackendOptions {
    BackendOptions { choice, runtime_path: runtime_path.map(PathBuf::from), threads: 2 }
}

/// Smooth values in [-1, 1] that no network gets bored of.
fn input(length: usize) -> Vec<f32> {
    (0..length).map(|i| (i as f32 * 0.37).sin() * (i as f32 * 0.0113).cos()).collect()
}

/// A library that is no ONNX Runtime, under the name of one.
#[cfg(unix)]
fn impostor(folder: &Path) -> Option<PathBuf> {
    let name = if cfg!(target_vendor = "apple") { "libonnxruntime.1.99.0.dylib" } else { "libonnxruntime.so.1.99.0" };
    let places = ["/lib/x86_64-linux-gnu", "/lib/aarch64-linux-gnu", "/usr/lib64", "/lib64", "/usr/lib"];
    let library = places.iter().map(|place| Path::new(place).join("libm.so.6")).find(|path| path.is_file())?;
    let path = folder.join(name);
    std::fs::copy(library, &path).ok()?;
    Some(path)
}

#[cfg(not(unix))]
fn impostor(_: &Path) -> Option<PathBuf> {
    None
}

fn refusal(path: &Path) -> String {
    match Backend::open(&options(BackendChoice::Ort, Some(path))) {
        Err(error @ Error::Backend { .. }) => error.to_string(),
        Err(error) => panic!("another error: {error}"),
        Ok(backend) => panic!("{} was taken for a runtime", backend.info()),
    }
}

/// Compiles a library that answers as the head of an ONNX Runtime does, and has no body. `None` without a C compiler.
#[cfg(unix)]
fn hollow_runtime(folder: &Path, name: &str, base: &str, version: &str) -> Option<PathBuf> {
    let (source, library) = (folder.join(format!("{name}.c")), folder.join(format!("lib{name}.so")));
    let text = format!(
        "typedef struct {{ const void *(*api)(unsigned); const char *(*version)(void); }} Base;
         static const void *api(unsigned number) {{ (void)number; return 0; }}
         static const char *version(void) {{ return {version}; }}
         static const Base base = {{ api, version }};
         const Base *OrtGetApiBase(void) {{ return {base}; }}"
    );
    std::fs::write(&source, text).unwrap();
    let compiled = std::process::Command::new("cc").args(["-shared", "-fPIC", "-o"]).args([&library, &source]).status();
    compiled.is_ok_and(|status| status.success()).then_some(library)
}

/// Libraries that pass for an ONNX Runtime until they are asked what they can do.
#[cfg(unix)]
fn old_and_hollow_runtimes_are_refused(folder: &Path) {
    for (name, base, version, reason) in [
        ("old", "&base", "\"1.16.3\"", "it is version 1.16.3, need 1.17 or later"),
        ("strange", "&base", "\"unknown\"", "it is version unknown"),
        ("other", "&base", "\"2.0.0\"", "it is version 2.0.0"),
        ("speechless", "&base", "0", "it tells no version"),
        ("refusing", "&base", "\"1.20.0\"", "version 1.20.0 refuses interface 17"),
        ("baseless", "0", "\"1.20.0\"", "OrtGetApiBase returned null"),
    ] {
        let Some(path) = hollow_runtime(folder, name, base, version) else {
            assert!(std::env::var_os("CI").is_none(), "no C compiler");
            eprintln!("skipped: no C compiler");
            return;
        };
        let message = refusal(&path);
        assert!(message.contains(reason), "{message}");
    }
}

#[cfg(not(unix))]
fn old_and_hollow_runtimes_are_refused(_: &Path) {}

#[test]
fn both_backends_answer_alike_and_bad_runtimes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("hollow")).unwrap();

    // What is no runtime leaves the process able to load a real one afterwards.
    assert!(refusal(&folder.path().join("absent.so")).contains("no such file"));
    assert!(refusal(folder.path()).contains("no such file"));
    let text = folder.path().join("libonnxruntime.so");
    std::fs::write(&text, "this is not a library").unwrap();
    assert!(refusal(&text).contains(&text.display().to_string()));
    if let Some(path) = impostor(folder.path()) {
        assert!(refusal(&path).contains("OrtGetApiBase"));
    }
    old_and_hollow_runtimes_are_refused(&folder.path().join("hollow"));

    // The search finds the runtime that the tests installed; only a machine without one may go without this check.
    let found = Backend::open(&options(BackendChoice::Ort, None));
    let runtime = match found {
        Ok(runtime) => runtime,
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "{error}");
            eprintln!("skipped: {error}");
            return;
        }
    };
    let path = runtime.info().path.clone().unwrap();
    assert!(path.is_absolute() && path.is_file());
    assert_eq!(runtime.info().name, "onnxruntime");
    assert!(runtime.info().version.starts_with("1."), "{}", runtime.info());

    // The same one again is fine, another one is not; with a free choice the loaded one stays.
    Backend::open(&options(BackendChoice::Ort, Some(&path))).unwrap();
    assert!(refusal(&text).contains("already"));
    let stays = Backend::open(&options(BackendChoice::Auto, Some(&text))).unwrap();
    assert_eq!(stays.info().path.as_deref(), Some(path.as_path()));
    assert!(stays.info().why.contains("already"), "{}", stays.info().why);

    // Golden pairs: ONNX Runtime is the reference.
    let embedded = Backend::open(&options(BackendChoice::Embedded, None)).unwrap();
    let models = Models::embedded().unwrap();
    for network in Network::ALL {
        let [mut a, mut b] = [&runtime, &embedded].map(|backend| models.load(network, backend).unwrap());
        let input = input(a.input_shape().iter().product());
        let (a, b) = (a.run(&input).unwrap(), b.run(&input).unwrap());
        let difference = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let largest = a.iter().map(|a| a.abs()).fold(0.0, f32::max);
        assert_eq!(a.len(), b.len());
        assert!(difference < TOLERANCE, "{}: the backends differ by {difference:.1e}", network.name());
        assert!(largest.is_finite(), "{}", network.name());
    }

    // Damaged networks are refused by either.
    let bytes = models.bytes(Network::Cdf);
    for backend in [&runtime, &embedded] {
        for damaged in [&bytes[..0], &bytes[..bytes.len() / 2], b"not a network".as_slice()] {
            assert!(matches!(backend.load("damaged", damaged), Err(Error::Model { .. })));
        }
        let mut engine = models.load(Network::Bsr, backend).unwrap();
        assert!(matches!(engine.run(&[0.0; 3]), Err(Error::Model { .. })));
    }
}

#[test]
fn the_embedded_backend_needs_nothing_and_says_so() {
    let networks = Networks::load(&Models::embedded().unwrap(), &options(BackendChoice::Embedded, None)).unwrap();
    let info = networks.backend();
    assert_eq!((info.name, info.path.as_ref(), info.why.as_str()), ("rten", None, "asked for"));
    assert_eq!(info.threads, 2);
}

#[test]
fn the_reported_version_is_that_of_the_lock_file() {
    let lock = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.lock")).unwrap();
    let backend = Backend::open(&options(BackendChoice::Embedded, None)).unwrap();
    assert!(lock.contains(&format!("name = \"rten\"\nversion = \"{}\"", backend.info().version)));
}
