//! The example sketches are understood as what they show; the broken ones are refused with the reason.

use sketch2pq::Error;
use sketch2pq::sketch::{Layer, Orientation, Sketch, Stroke, StrokeKind, View, rasterize, read_sketch, understand};
use std::path::{Path, PathBuf};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Regions that the visible front, the visible back, and two layers have.
fn counts(file: &str) -> [usize; 3] {
    let sketch = read_sketch(&folder("examples/sketches").join(file)).unwrap();
    let understanding = understand(&sketch).unwrap_or_else(|e| panic!("{file}: {e}"));
    assert_eq!(understanding.patches.len(), 1, "{file}");
    assert!(understanding.unused.is_empty(), "{file}");
    let patch = &understanding.patches[0];
    assert_eq!(patch.depth_samples.len(), sketch.depth_samples.len());
    let features = |kinds: Vec<StrokeKind>| kinds.into_iter().filter(|&k| k == StrokeKind::Feature).count();
    let drawn = features(sketch.strokes.iter().map(|s| s.kind).collect());
    assert_eq!(features(patch.strokes.iter().map(|s| s.kind).collect()), drawn, "{file}");
    // The border is closed and dense, and runs counter-clockwise as seen from the front.
    let n = patch.border.len();
    for i in 0..n {
        let (a, b) = (patch.border[i].position, patch.border[(i + 1) % n].position);
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.05, "{file}: gap in the border");
    }
    let hidden = patch.border.iter().any(|b| b.layer == Layer::Occluded);
    let double = patch.regions.iter().filter(|r| r.occluded.is_some()).count();
    assert_eq!(hidden, double > 0, "{file}");
    assert!(rasterize(patch).data.iter().all(|x| x.is_finite() && x.abs() <= 1.0 + 1e-5));
    let side = |s: Orientation| patch.regions.iter().filter(|r| r.visible == s).count();
    [side(Orientation::Front), side(Orientation::Back), double]
}

#[test]
fn examples_have_the_regions_that_they_show() {
    for (name, expected) in [
        ("rounded_corner.json", [2, 0, 1]),
        ("rounded_corner.svg", [2, 0, 1]),
        ("results_left.json", [2, 0, 1]),
        ("results_right.json", [2, 2, 1]),
        ("dome.json", [2, 0, 1]),
        ("dome.svg", [2, 0, 1]),
        ("saddle.json", [1, 0, 0]),
        ("barrel_vault.json", [2, 1, 1]),
        ("leaning_shell.json", [2, 2, 1]),
        ("front_foldover.json", [2, 0, 1]),
    ] {
        assert_eq!(counts(name), expected, "{name}");
    }
}

#[test]
fn svg_and_json_of_a_sketch_mean_the_same() {
    for name in ["rounded_corner", "dome"] {
        let area = |extension: &str| {
            let path = folder("examples/sketches").join(format!("{name}.{extension}"));
            let patch = understand(&read_sketch(&path).unwrap()).unwrap().patches.remove(0);
            (patch.regions.iter().map(|r| r.area).collect::<Vec<_>>(), patch.depth_samples.len())
        };
        let (json, svg) = (area("json"), area("svg"));
        assert!(json.0.iter().zip(&svg.0).all(|(a, b)| (a - b).abs() < 0.01 * a), "{json:?} {svg:?}");
        assert_eq!(json.1, svg.1);
    }
}

#[test]
fn broken_sketches_are_refused_with_the_reason() {
    let error = |name: &str| {
        let sketch = read_sketch(&folder("tests/corpus").join(format!("{name}.json")));
        sketch.and_then(|s| understand(&s)).err().unwrap_or_else(|| panic!("{name} was understood"))
    };
    for name in ["empty", "one_point", "only_features"] {
        assert_eq!(error(name), Error::NoOutline, "{name}");
    }
    for (name, reason) in [("unknown_kind", "silhouette"), ("not_a_number", "line 2"), ("missing_field", "kind")] {
        let error = error(name);
        assert!(matches!(error, Error::Format { .. }) && error.to_string().contains(reason), "{name}: {error}");
    }
    let Error::OpenOutline { x, y, gap, .. } = error("open_outline") else { panic!() };
    assert!((gap - 160.3).abs() < 3.0 && (x - 50.0).abs() < 12.0 && (60.0..220.5).contains(&y), "{x} {y} {gap}");
    for (name, place, reason) in [
        ("self_crossing", [128.0, 128.0], "crosses or touches itself"),
        ("contour_missing", [145.0, 210.0], "nothing hides it"),
        ("hole", [140.0, 130.0], "holes are not supported"),
    ] {
        let Error::Contradiction { x, y, reason: found } = error(name) else { panic!("{name}") };
        assert!(found.contains(reason), "{name}: {found}");
        assert!((x - place[0]).hypot(y - place[1]) < 35.0, "{name}: {x} {y}");
    }
    assert!(matches!(error("beyond_coordinates"), Error::Argument { name: "coordinate", .. }));
    assert!(matches!(error("sample_outside"), Error::SampleOutside { index: 0, .. }));
}

/// Hand-drawn projections of known surfaces that were once refused; only their larger regions are sure.
#[test]
fn unsteady_drawings_are_understood() {
    for (name, front, back, double) in [
        ("ear_of_ten_pixels", 2, 0, 1),
        ("overlapping_ends", 2, 1, 1),
        ("contour_crosses_border", 2, 0, 1),
        ("narrow_corner", 2, 0, 1),
        ("tiny_loop", 2, 0, 1),
        ("contour_in_pieces", 2, 0, 1),
        ("thin_fold", 1, 1, 1),
        ("contour_ends_beside_corner", 2, 0, 1),
    ] {
        let sketch = read_sketch(&folder("tests/corpus").join(format!("{name}.json"))).unwrap();
        let patch = understand(&sketch).unwrap_or_else(|e| panic!("{name}: {e}")).patches.remove(0);
        let large = || patch.regions.iter().filter(|r| r.area > 0.12);
        let side = |s: Orientation| large().filter(|r| r.visible == s).count();
        let found =
            (side(Orientation::Front), side(Orientation::Back), large().filter(|r| r.occluded.is_some()).count());
        assert_eq!(found, (front, back, double), "{name}");
    }
}

#[test]
fn odd_but_sound_sketches_are_understood() {
    let read = |name: &str| read_sketch(&folder("tests/corpus").join(format!("{name}.json"))).unwrap();
    let area = |sketch: &Sketch| understand(sketch).unwrap().patches[0].regions[0].area;
    let understanding = understand(&read("duplicate_strokes")).unwrap();
    assert_eq!(understanding.unused, [4, 5, 6, 8]);
    let expected = understanding.patches[0].regions[0].area;
    for name in ["huge_coordinates", "tiny_coordinates"] {
        assert!((area(&read(name)) - expected).abs() < 1e-6, "{name}");
    }
}

#[test]
fn a_million_scribbled_points_end_quickly() {
    let scribble = |i: u32| {
        let t = f64::from(i) * 0.37;
        [100.0 * (t * 1.01).sin() + 20.0 * (t * 7.3).cos(), 100.0 * (t * 0.77).cos() + 20.0 * (t * 5.1).sin()]
    };
    let sketch = Sketch {
        name: String::new(),
        canvas_size: [256.0; 2],
        view: View::default(),
        strokes: vec![Stroke { kind: StrokeKind::VisibleBoundary, points: (0..1_000_000).map(scribble).collect() }],
        depth_samples: vec![],
    };
    assert!(matches!(understand(&sketch), Err(Error::TooLarge { limit: 100_000, .. })));
}
