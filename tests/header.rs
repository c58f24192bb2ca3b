//! The header is a golden file: what cbindgen writes from `src/ffi` must be what is committed, and C and C++ must take
//! it.
//!
//! `UPDATE_GOLDEN=1 cargo test --test header` rewrites it.

use cbindgen::{Builder, Config, DocumentationLength, DocumentationStyle, EnumConfig, Language, RenameRule, Style};
use std::path::{Path, PathBuf};
use std::process::Command;

const MANUAL: &str = r"/* sketch2pq: an architect's sketch in, a NURBS surface and a mesh of planar quads out.
 *
 * Written by cbindgen from src/ffi; do not edit.
 *
 * The pipeline
 *   S2pqSketch  -- sketch_to_surface -->  S2pqSurface  -- sketch_to_cdf -->  S2pqField  -- extract_pq_mesh -->  S2pqMesh
 *   A host that has a NURBS surface enters by s2pq_surface_from_nurbs, and goes on with surface_to_cdf and its own feature curves.
 *
 * Calls
 *   Every call that can fail returns an S2pqStatus and writes its outputs only on success. The status says what to do; s2pq_last_message,
 *   asked on the same thread before its next call, says what happened. No call ends the process, whatever it is given of NULL
 *   pointers, freed handles and handles of another kind; arrays and structs must be as large as their counts and sizes say.
 *
 * Handles
 *   Opaque; made by the library, freed by the function named s2pq_..._free, which takes NULL too. Inputs are borrowed for the call. Arrays and
 *   texts that come out are lent by a handle and die with it. Results do not need the handles that they were made from.
 *
 * Structs
 *   Every struct begins with its own size. Options: call s2pq_..._options_init(&options, sizeof options), then change fields. Results: set
 *   struct_size = sizeof the struct before the call. Fields are only ever appended, and a library takes the structs of older and of
 *   newer headers; an option that it does not know must be zero.
 *
 * Enumerations arrive as uint32_t and are checked.
 *
 * Threads
 *   One thread at a time for each handle, any thread; different handles are independent. s2pq_cancel stops a session's call from any thread,
 *   and on a session made with live = 1 so does a newer sketch_to_surface: the older call answers S2PQ_STATUS_CANCELLED.
 *   Progress callbacks run on the thread that called. They must not throw or long-jump.
 *
 * Frames and units
 *   Canvas: the host's own unit, x right, y up or down as the sketch's view says. World: right-handed, z up, in the canvas' unit. Depth is
 *   measured along the view and grows away from the viewer. Angles are in degrees, times in milliseconds. All numbers are double precision,
 *   all texts UTF-8.
 */";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn header_path() -> PathBuf {
    root().join("include/sketch2pq.h")
}

fn generated() -> String {
    let version = |text: &str| text.parse::<u32>().expect("a number from Cargo");
    let abi = 1000 * version(env!("CARGO_PKG_VERSION_MAJOR")) + version(env!("CARGO_PKG_VERSION_MINOR"));
    let config = Config {
        language: Language::C,
        cpp_compat: true,
        header: Some(MANUAL.into()),
        include_guard: Some("SKETCH2PQ_H".into()),
        no_includes: true,
        sys_includes: vec!["stddef.h".into(), "stdint.h".into()],
        after_includes: Some(format!(
            "\n/* What s2pq_abi_version returns for this header: 1000 * major + minor of the version. */\n#define S2PQ_ABI_VERSION {abi}u"
        )),
        documentation_style: DocumentationStyle::C99,
        documentation_length: DocumentationLength::Full,
        style: Style::Both,
        line_length: 120,
        usize_is_size_t: true,
        enumeration: EnumConfig { rename_variants: RenameRule::QualifiedScreamingSnakeCase, ..EnumConfig::default() },
        export: cbindgen::ExportConfig {
            include: ["S2pqStrokeKind", "S2pqLayer", "S2pqBackend", "S2pqBorder", "S2pqHold", "S2pqOffsets"]
                .map(String::from)
                .into(),
            ..cbindgen::ExportConfig::default()
        },
        ..Config::default()
    };
    let mut builder = Builder::new().with_config(config);
    for file in ["status", "library", "session", "sketch", "surface", "field", "mesh", "planarize"] {
        builder = builder.with_src(root().join(format!("src/ffi/{file}.rs")));
    }
    let mut bytes = vec![];
    builder.generate().expect("src/ffi is what cbindgen reads").write(&mut bytes);
    let text = String::from_utf8(bytes).expect("cbindgen writes UTF-8");
    // What Rust calls safety is to a C reader the list of what must be valid.
    text.replace("// # Safety\n", "// Must be valid:\n").replace(" //\n", "//\n")
}

#[test]
fn the_header_is_what_the_sources_say() {
    let (path, text) = (header_path(), generated());
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        // In one step: the test beside this one reads the header meanwhile.
        let new = path.with_extension("h.new");
        std::fs::write(&new, text).unwrap();
        std::fs::rename(&new, &path).unwrap();
        return;
    }
    let committed = std::fs::read_to_string(&path).expect("include/sketch2pq.h is committed");
    assert!(committed == text, "include/sketch2pq.h is stale: UPDATE_GOLDEN=1 cargo test --test header");
}

#[test]
fn c99_and_cpp17_take_the_header_without_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    for (compiler, language, standard) in [("cc", "c", "c99"), ("c++", "c++", "c++17")] {
        let source = folder.path().join(format!("include_twice.{}", if language == "c" { "c" } else { "cpp" }));
        std::fs::write(
            &source,
            "#include \"sketch2pq.h\"\n#include \"sketch2pq.h\"\nint main(void) { return s2pq_abi_version() == S2PQ_ABI_VERSION ? 0 : 1; }\n",
        )
        .unwrap();
        let output = Command::new(compiler)
            .args([
                &format!("-std={standard}"),
                "-Wall",
                "-Wextra",
                "-Wpedantic",
                "-Werror",
                "-fsyntax-only",
                "-x",
                language,
            ])
            .arg("-I")
            .arg(root().join("include"))
            .arg(&source)
            .output()
            .unwrap_or_else(|error| panic!("{compiler}: {error}"));
        assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
    }
}
