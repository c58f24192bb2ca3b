//! The command as users meet it: files appear all together or not at all, errors are one message that names the place.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn sketch2pq(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sketch2pq")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A sketch file whose strokes are given as (kind, points as JSON text).
fn sketch_json(strokes: &[(&str, &str)]) -> String {
    let strokes: Vec<String> =
        strokes.iter().map(|(kind, points)| format!(r#"{{"kind": "{kind}", "points": {points}}}"#)).collect();
    format!(r#"{{"name": "test", "strokes": [{}]}}"#, strokes.join(", "))
}

fn points(list: impl IntoIterator<Item = [f64; 2]>) -> String {
    let list: Vec<String> = list.into_iter().map(|[x, y]| format!("[{x:e}, {y:e}]")).collect();
    format!("[{}]", list.join(", "))
}

const SQUARE: [[f64; 2]; 13] = [
    [40.0, 60.0],
    [90.0, 60.0],
    [140.0, 60.0],
    [200.0, 60.0],
    [200.0, 100.0],
    [200.0, 150.0],
    [200.0, 200.0],
    [150.0, 200.0],
    [100.0, 200.0],
    [40.0, 200.0],
    [40.0, 150.0],
    [40.0, 100.0],
    [40.0, 60.0],
];

fn run(folder: &Path, name: &str, sketch: &str) -> (Output, bool) {
    let (file, out) = (folder.join(format!("{name}.json")), folder.join(format!("{name}_out")));
    fs::write(&file, sketch).unwrap();
    let output = sketch2pq(&[
        "run",
        file.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--backend",
        "embedded",
        "--faces",
        "100",
    ]);
    (output, out.exists())
}

#[test]
fn a_sketch_becomes_all_its_files_and_one_summary() {
    let folder = tempfile::tempdir().unwrap();
    let (output, made) = run(folder.path(), "square", &sketch_json(&[("visible_boundary", &points(SQUARE))]));
    assert!(output.status.success() && made, "{}", text(&output.stderr));
    let mut names: Vec<String> = fs::read_dir(folder.path().join("square_out"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["mesh.obj", "picture.png", "report.json", "surface.json"]);
    let report = fs::read_to_string(folder.path().join("square_out/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    for key in ["backend", "p_max", "p_mean", "deviation_max_edges", "border_covered", "faces", "quads"] {
        assert!(!report[key].is_null(), "{key}: {report}");
    }
    for stage in ["sketch", "infer", "refine", "field", "mesh", "planarize", "total"] {
        assert!(report["time_ms"][stage].as_f64().unwrap() > 0.0, "{stage}");
    }
    assert!(report["p_max"].as_f64().unwrap() <= 1e-3);
    let summary = text(&output.stdout);
    for word in ["faces", "planarity", "deviation", "ms", "rten", "mesh.obj"] {
        assert!(summary.contains(word), "{word}: {summary}");
    }
    assert_eq!(text(&output.stderr), "", "progress is for terminals");
}

#[test]
fn broken_sketches_get_one_message_and_leave_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let boundary = "visible_boundary";
    let square = points(SQUARE);
    let broken = [
        ("empty", sketch_json(&[])),
        ("no_text", String::new()),
        ("one_point", sketch_json(&[(boundary, "[[3, 4]]")])),
        ("not_a_number", sketch_json(&[(boundary, "[[3, 4], [NaN, 5], [9, 9]]")])),
        ("open", sketch_json(&[(boundary, &points(SQUARE[..9].to_vec()))])),
        ("only_features", sketch_json(&[("feature", &square)])),
        ("unknown_kind", sketch_json(&[("scribble", &square)])),
        ("too_large", sketch_json(&[(boundary, &points(SQUARE.map(|p| p.map(|x| x * 1e300))))])),
    ];
    for (name, sketch) in broken {
        let (output, made) = run(folder.path(), name, &sketch);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{name}: {message}");
        assert!(!made, "{name} left its folder");
        assert!(message.starts_with("error: ") && message.lines().count() == 1, "{name}: {message}");
        assert!(message.contains(&format!("{name}.json")), "{name}: {message}");
        assert_eq!(text(&output.stdout), "", "{name}");
    }
}

#[test]
fn odd_but_readable_sketches_give_a_result() {
    let folder = tempfile::tempdir().unwrap();
    let square = points(SQUARE);
    let circle = (0..=100_000).map(|i| {
        let angle = f64::from(i) / 100_000.0 * std::f64::consts::TAU;
        [128.0 + 90.0 * angle.cos(), 128.0 + 70.0 * angle.sin()]
    });
    for (name, sketch) in [
        ("twice", sketch_json(&[("visible_boundary", &square), ("visible_boundary", &square)])),
        ("huge", sketch_json(&[("visible_boundary", &points(SQUARE.map(|p| p.map(|x| x * 1e12))))])),
        ("tiny", sketch_json(&[("visible_boundary", &points(SQUARE.map(|p| p.map(|x| x * 1e-12))))])),
        ("many_points", sketch_json(&[("visible_boundary", &points(circle))])),
    ] {
        let (output, made) = run(folder.path(), name, &sketch);
        assert!(output.status.success() && made, "{name}: {}", text(&output.stderr));
    }
    // A figure of eight: whatever is answered, it is an answer.
    let eight = points([[40.0, 60.0], [200.0, 200.0], [200.0, 60.0], [40.0, 200.0], [40.0, 60.0]]);
    let (output, made) = run(folder.path(), "eight", &sketch_json(&[("visible_boundary", &eight)]));
    assert_eq!(output.status.success(), made);
    assert!(matches!(output.status.code(), Some(0 | 1)), "{}", text(&output.stderr));
}

#[test]
fn an_output_that_cannot_be_written_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let sketch = folder.path().join("square.json");
    fs::write(&sketch, sketch_json(&[("visible_boundary", &points(SQUARE))])).unwrap();
    let out = folder.path().join("out");
    fs::create_dir_all(out.join("report.json")).unwrap();
    let arguments = ["run", sketch.to_str().unwrap(), "--out", out.to_str().unwrap(), "--backend", "embedded"];
    let output = sketch2pq(&arguments);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("report.json"), "{}", text(&output.stderr));
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
    let output = sketch2pq(&["run", "missing.json", "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("missing.json"));
}

#[test]
fn wrong_usage_is_2_and_a_closed_pipe_is_no_panic() {
    assert_eq!(sketch2pq(&["run"]).status.code(), Some(2));
    assert_eq!(sketch2pq(&["fly"]).status.code(), Some(2));
    assert_eq!(sketch2pq(&["run", "a.json", "--out", "b", "--faces", "5", "--edge", "2"]).status.code(), Some(2));
    let mut child = Command::new(env!("CARGO_BIN_EXE_sketch2pq"))
        .args(["info", "--backend", "embedded"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(!text(&output.stderr).contains("panic"), "{}", text(&output.stderr));
    assert_eq!(output.status.code(), Some(0));
}
