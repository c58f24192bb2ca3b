//! Imports point downwards only, `ort` stays in `infer`, and `unsafe` where it belongs: this test reads the sources and
//! keeps it so.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What each module of the crate may import, besides itself, `error` and `control`.
const BELOW: [(&str, &[&str]); 12] = [
    ("numeric", &[]),
    ("surface", &["numeric", "sketch"]),
    ("field", &["surface", "numeric", "sketch"]),
    ("mesh", &["field", "surface", "numeric", "sketch"]),
    ("sketch", &["numeric"]),
    ("infer", &["sketch", "numeric"]),
    ("pipeline", &["infer", "mesh", "field", "surface", "sketch", "numeric"]),
    ("picture", &["pipeline", "mesh", "field", "surface", "sketch"]),
    ("datagen", &["infer", "mesh", "field", "surface", "sketch", "numeric"]),
    ("evaluate", &["datagen", "picture", "pipeline", "infer", "mesh", "field", "surface", "sketch", "numeric"]),
    ("ffi", &["pipeline", "infer", "mesh", "field", "surface", "sketch"]),
    ("control", &[]),
];

/// Where `unsafe` may stand.
const UNSAFE: [&str; 2] = ["ffi/", "infer/library.rs"];

fn sources() -> BTreeMap<String, String> {
    fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                collect(&path, files);
            } else if path.extension().is_some_and(|e| e == "rs") {
                files.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = vec![];
    collect(&root, &mut files);
    let name = |path: &Path| path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/");
    files.iter().map(|path| (name(path), without_comments(&std::fs::read_to_string(path).unwrap()))).collect()
}

/// The text without line comments, which name what they do not import.
fn without_comments(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

/// The modules that `text` reaches by `crate::`, also inside braces.
fn imports(text: &str) -> Vec<String> {
    let word = |s: &str| s.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut found = vec![];
    for (at, _) in text.match_indices("crate::") {
        let rest = &text[at + "crate::".len()..];
        if let Some(list) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut start = 0;
            for (i, c) in list.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => {
                        found.push(word(list[start..i].trim()));
                        break;
                    }
                    '}' => depth -= 1,
                    ',' if depth == 0 => {
                        found.push(word(list[start..i].trim()));
                        start = i + 1;
                    }
                    _ => {}
                }
            }
        } else {
            found.push(word(rest));
        }
    }
    found.retain(|module| module.starts_with(char::is_lowercase));
    found
}

/// Whether `word` stands alone somewhere in `text`.
fn has_word(text: &str, word: &str) -> bool {
    let part_of_name = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word)
        .any(|(at, _)| !text[..at].ends_with(part_of_name) && !text[at + word.len()..].starts_with(part_of_name))
}

#[test]
fn imports_point_downwards_only() {
    let mut wrong = vec![];
    for (file, text) in sources() {
        let module = file.split(['/', '.']).next().unwrap();
        let Some((_, below)) = BELOW.iter().find(|(name, _)| *name == module) else {
            assert!(
                matches!(module, "lib" | "bin" | "error"),
                "{file} belongs to no layer: give it one in tests/layers.rs"
            );
            continue;
        };
        for import in imports(&text) {
            let fine = import == module || matches!(import.as_str(), "error" | "control") || below.contains(&&*import);
            if !fine {
                wrong.push(format!("{file} imports crate::{import}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_layers_have_no_cycle() {
    // The order of the list need not be the order of the layers: follow every arrow.
    fn reaches(from: &str, to: &str) -> bool {
        let below = BELOW.iter().find(|(name, _)| *name == from).map_or(&[][..], |(_, below)| below);
        below.iter().any(|&next| next == to || reaches(next, to))
    }
    for (name, _) in BELOW {
        assert!(!reaches(name, name), "{name} lies below itself");
    }
}

#[test]
fn only_infer_imports_the_runtime() {
    for (file, text) in sources() {
        let found = text.contains("ort::") && has_word(&text.replace("ort::", "ort "), "ort");
        assert!(file.starts_with("infer/") || !found, "{file} uses ort");
        assert!(file.starts_with("infer/") || !text.contains("rten::"), "{file} uses rten");
    }
}

#[test]
fn unsafe_stands_at_the_borders_only() {
    for (file, text) in sources() {
        let allowed = UNSAFE.iter().any(|place| file.starts_with(place));
        assert!(allowed || !has_word(&text, "unsafe"), "{file} contains unsafe");
    }
}
