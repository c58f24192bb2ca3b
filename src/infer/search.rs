//! Where an ONNX Runtime may lie.
//!
//! In this order:
//! 1. the path that the host gave,
//! 2. the environment variables `SKETCH2PQ_ORT_PATH`, then `ORT_DYLIB_PATH`,
//! 3. beside our own library, where a release puts it,
//! 4. Python environments: the package `onnxruntime` of the one that is active (`VIRTUAL_ENV`, `CONDA_PREFIX`), of one
//!    that our own library lies in, of a `.venv` in a folder above our library (the repository's, for a build inside it),
//!    and of the system's Python,
//! 5. the system's library folders, on Unix.
//!
//! A given path is a file or a folder. The bare name is never asked for, and neither is the working folder: Windows keeps an
//! outdated `onnxruntime.dll` in System32, other plugins bring theirs, and a folder that a document lies in must not
//! decide what code runs.

use super::library;
use std::path::{Path, PathBuf};

/// Environment variables that name a runtime, file or folder, first wins.
pub const ENVIRONMENT: [&str; 2] = ["SKETCH2PQ_ORT_PATH", "ORT_DYLIB_PATH"];

/// Source of what the host named itself.
pub const GIVEN: &str = "the path that was given";

/// How many folders above our own library may hold a `.venv`: target/debug/deps/x lies four below the repository.
const LEVELS_ABOVE: usize = 5;

/// One file to try, and who asked for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// Absolute path; the file may not exist if the host or the environment named it.
    pub path: PathBuf,
    /// For messages: [`GIVEN`], `ORT_DYLIB_PATH` and so on.
    pub source: String,
    /// Whether a person named it, so that its failure is worth a word.
    pub named: bool,
}

/// All candidates in the order of the module's description; files that nobody named are listed only if they exist.
pub fn candidates(given: Option<&Path>) -> Vec<Candidate> {
    let own = library::own_path();
    collect(given, &|name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from), own.as_deref())
}

/// [`candidates`] with its surroundings passed in.
fn collect(given: Option<&Path>, variable: &dyn Fn(&str) -> Option<PathBuf>, own: Option<&Path>) -> Vec<Candidate> {
    let mut list = Vec::new();
    if let Some(path) = given {
        named(&mut list, path, GIVEN);
    }
    for name in ENVIRONMENT {
        if let Some(path) = variable(name) {
            named(&mut list, &path, name);
        }
    }
    if let Some(folder) = own.and_then(Path::parent) {
        found(&mut list, folder, "beside our library");
    }
    for name in ["VIRTUAL_ENV", "CONDA_PREFIX"] {
        if let Some(prefix) = variable(name) {
            python_prefix(&mut list, &prefix, name);
        }
    }
    for folder in own.into_iter().flat_map(|path| path.ancestors().skip(1).take(LEVELS_ABOVE)) {
        found(&mut list, &folder.join("onnxruntime/capi"), "the Python packages around our library");
        python_prefix(&mut list, &folder.join(".venv"), "a .venv above our library");
    }
    if cfg!(unix) {
        if let Some(home) = variable("HOME") {
            python_prefix(&mut list, &home.join(".local"), "the user's Python packages");
        }
        for prefix in ["/usr/local", "/usr", "/opt/homebrew"] {
            python_prefix(&mut list, Path::new(prefix), "the system's Python packages");
        }
        let multiarch = format!("/usr/lib/{}-linux-gnu", std::env::consts::ARCH);
        for folder in
            ["/usr/local/lib", "/opt/homebrew/lib", "/opt/onnxruntime/lib", "/usr/lib64", "/usr/lib", &multiarch]
        {
            found(&mut list, Path::new(folder), "the system's libraries");
        }
    }
    let mut seen = Vec::new();
    list.retain(|candidate| {
        !seen.contains(&candidate.path) && {
            seen.push(candidate.path.clone());
            true
        }
    });
    list
}

/// Adds what a person named: the libraries of a folder, else the path itself.
fn named(list: &mut Vec<Candidate>, path: &Path, source: &str) {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let inside = if path.is_dir() { libraries(&path) } else { Vec::new() };
    let paths = if inside.is_empty() { vec![path] } else { inside };
    list.extend(paths.into_iter().map(|path| Candidate { path, source: source.into(), named: true }));
}

/// Adds the runtimes that lie in `folder`.
fn found(list: &mut Vec<Candidate>, folder: &Path, source: &str) {
    if folder.is_absolute() {
        let files = libraries(folder).into_iter();
        list.extend(files.map(|path| Candidate { path, source: source.into(), named: false }));
    }
}

/// Adds the package `onnxruntime` of the Python installation or environment `prefix`.
fn python_prefix(list: &mut Vec<Candidate>, prefix: &Path, source: &str) {
    let mut sites = vec![prefix.join("Lib/site-packages")];
    for lib in ["lib", "lib64"] {
        for folder in entries(&prefix.join(lib)) {
            if name(&folder).starts_with("python3") {
                sites.extend(["site-packages", "dist-packages"].map(|packages| folder.join(packages)));
            }
        }
    }
    for site in sites {
        found(list, &site.join("onnxruntime/capi"), source);
    }
}

/// The files in `folder` that are called like an ONNX Runtime, newest version first.
fn libraries(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = entries(folder).into_iter().filter(|path| is_runtime_name(&name(path))).collect();
    files.sort_by_key(|path| std::cmp::Reverse(numbers(&name(path))));
    files
}

/// Whether a file of this name may be an ONNX Runtime on this system.
fn is_runtime_name(name: &str) -> bool {
    if cfg!(windows) {
        name.eq_ignore_ascii_case("onnxruntime.dll")
    } else if cfg!(target_vendor = "apple") {
        name == "libonnxruntime.dylib" || (name.starts_with("libonnxruntime.1.") && name.ends_with(".dylib"))
    } else {
        name == "libonnxruntime.so" || name.starts_with("libonnxruntime.so.1")
    }
}

/// The numbers in a name, for sorting by version.
fn numbers(name: &str) -> Vec<u32> {
    name.split(|c: char| !c.is_ascii_digit()).filter_map(|digits| digits.parse().ok()).collect()
}

/// The entries of a folder in the order of their names; none if it cannot be read.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file name of this system for version 1.`minor`.
    fn file(minor: u32) -> String {
        if cfg!(windows) {
            "onnxruntime.dll".into()
        } else if cfg!(target_vendor = "apple") {
            format!("libonnxruntime.1.{minor}.0.dylib")
        } else {
            format!("libonnxruntime.so.1.{minor}.0")
        }
    }

    fn place(folder: &Path, minor: u32) -> PathBuf {
        std::fs::create_dir_all(folder).unwrap();
        let path = folder.join(file(minor));
        std::fs::write(&path, "").unwrap();
        path
    }

    #[test]
    fn the_order_is_given_environment_beside_python() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let own = root.join("target/debug/deps/libsketch2pq.so");
        let given = place(&root.join("given"), 20);
        let variable = place(&root.join("variable"), 21);
        let beside = place(own.parent().unwrap(), 22);
        let active = place(&root.join("active/lib/python3.12/site-packages/onnxruntime/capi"), 23);
        let local = place(&root.join(".venv/lib/python3.11/site-packages/onnxruntime/capi"), 24);
        let environment = |name: &str| match name {
            "SKETCH2PQ_ORT_PATH" => Some(root.join("variable")),
            "ORT_DYLIB_PATH" => Some(root.join("absent.so")),
            "VIRTUAL_ENV" => Some(root.join("active")),
            _ => None,
        };
        let list = collect(Some(&given), &environment, Some(&own));
        let paths: Vec<_> = list.iter().filter(|c| c.path.starts_with(root)).map(|c| c.path.clone()).collect();
        assert_eq!(paths, [given, variable, root.join("absent.so"), beside, active, local]);
        assert_eq!(list.iter().filter(|candidate| candidate.named).count(), 3);
    }

    #[test]
    fn the_newest_of_a_folder_comes_first() {
        if cfg!(windows) {
            return; // one name only
        }
        let folder = tempfile::tempdir().unwrap();
        for minor in [9, 31, 17] {
            place(folder.path(), minor);
        }
        let list = collect(Some(folder.path()), &|_| None, None);
        let names: Vec<_> = list.iter().filter(|c| c.named).map(|c| name(&c.path)).collect();
        assert_eq!(names, [31, 17, 9].map(file));
    }

    #[test]
    fn companions_of_the_runtime_are_not_candidates() {
        for name in ["libonnxruntime_providers_shared.so", "onnxruntime_pybind11_state.so", "libonnxruntime4j_jni.so"] {
            assert!(!is_runtime_name(name));
        }
    }
}
