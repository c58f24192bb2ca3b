//! The example sketches are understood as what they show; the broken ones are refused with the reason.

use sketch2pq::Error;
use sketch2pq::sketch::{
    CANONICAL_PER_PX, CanonicalFrame, Layer, Orientation, Sketch, Stroke, StrokeKind, View, rasterize, read_sketch,
    understand,
};
use std::f64::consts::TAU;
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

/// Xorshift: enough chance for a test, the same everywhere.
struct Dice(u64);

impl Dice {
    fn range(&mut self, low: f64, high: f64) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        low + (high - low) * ((self.0 >> 11) as f64 / (1u64 << 53) as f64)
    }
}

/// Draws a stroke again: wobble of about a pixel, ends up to 2.5 px short or long, on top of what the example has, in either direction.
fn redraw(points: &[[f64; 2]], px: f64, dice: &mut Dice) -> Vec<[f64; 2]> {
    let waves: Vec<[f64; 4]> = (0..3)
        .map(|_| [dice.range(0.0, TAU), dice.range(0.2, 0.7) * px, dice.range(25.0, 120.0) * px, dice.range(0.0, TAU)])
        .collect();
    let mut length = 0.0;
    let mut drawn: Vec<[f64; 2]> = vec![];
    for (i, &[x, y]) in points.iter().enumerate() {
        let [u, v] = points[i.saturating_sub(1)];
        length += (x - u).hypot(y - v);
        let sum = |f: fn(f64) -> f64| -> f64 {
            waves.iter().map(|[angle, size, wave, phase]| f(*angle) * size * (length / wave * TAU + phase).sin()).sum()
        };
        drawn.push([x + sum(f64::cos), y + sum(f64::sin)]);
    }
    for _ in 0..2 {
        let reach = dice.range(-2.5, 2.5) * px;
        let [x, y] = drawn[drawn.len() - 1];
        let distance = |p: &[f64; 2]| (p[0] - x).hypot(p[1] - y);
        if reach < 0.0 {
            let kept = drawn.iter().rposition(|p| distance(p) >= -reach).unwrap_or(0);
            drawn.truncate(kept.max(3) + 1);
        } else if let Some(back) = drawn.iter().rev().find(|p| distance(p) > 5.0 * px) {
            let d = distance(back);
            drawn.push([x + (x - back[0]) / d * reach, y + (y - back[1]) / d * reach]);
        }
        drawn.reverse();
    }
    if dice.range(0.0, 1.0) < 0.5 {
        drawn.reverse();
    }
    drawn
}

#[test]
fn every_hand_draws_the_same_regions() {
    let names = [
        "rounded_corner",
        "results_left",
        "results_right",
        "dome",
        "saddle",
        "barrel_vault",
        "leaning_shell",
        "front_foldover",
    ];
    let mut dice = Dice(0x9E37_79B9_7F4A_7C15);
    for name in names {
        let original = read_sketch(&folder("examples/sketches").join(format!("{name}.json"))).unwrap();
        let structural = original.strokes.iter().filter(|s| s.kind.is_structural());
        let frame = CanonicalFrame::fitting(structural.flat_map(|s| s.points.iter().copied())).unwrap();
        let px = CANONICAL_PER_PX / frame.scale;
        let regions = |sketch: &Sketch| {
            let patch = understand(sketch).unwrap_or_else(|e| panic!("{name}: {e}")).patches.remove(0);
            let large: Vec<_> =
                patch.regions.iter().filter(|r| r.area > 0.3).map(|r| (r.visible, r.occluded)).collect();
            let count = |side| large.iter().filter(|r| r.0 == side).count();
            [count(Orientation::Front), count(Orientation::Back), large.iter().filter(|r| r.1.is_some()).count()]
        };
        let expected = regions(&original);
        for _ in 0..15 {
            let mut sketch = original.clone();
            sketch.depth_samples.clear();
            sketch.strokes.clear();
            for stroke in &original.strokes {
                let n = stroke.points.len();
                let middle = (n as f64 * dice.range(0.3, 0.7)) as usize;
                let split = stroke.kind.is_structural() && n > 40 && dice.range(0.0, 1.0) < 0.4;
                let pieces = if split {
                    vec![&stroke.points[..=middle], &stroke.points[middle..]]
                } else {
                    vec![&stroke.points[..]]
                };
                for piece in pieces {
                    let place = dice.range(0.0, sketch.strokes.len() as f64 + 1.0) as usize;
                    sketch.strokes.insert(place, Stroke { kind: stroke.kind, points: redraw(piece, px, &mut dice) });
                }
            }
            assert_eq!(regions(&sketch), expected, "{name}");
        }
    }
}

#[test]
fn random_strokes_give_an_answer() {
    for seed in 1..400u64 {
        let mut dice = Dice(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let count = dice.range(1.0, 13.0) as usize;
        let strokes = (0..count).map(|_| {
            let kind = StrokeKind::ALL[dice.range(0.0, 3.3) as usize];
            let (mut p, mut angle, step) =
                ([dice.range(0.0, 256.0), dice.range(0.0, 256.0)], dice.range(0.0, TAU), dice.range(0.0, 12.0));
            let on_grid = dice.range(0.0, 1.0) < 0.4;
            let points = (0..dice.range(1.0, 120.0) as usize).map(|_| {
                angle += dice.range(-0.6, 0.7);
                p = [p[0] + step * angle.cos(), p[1] + step * angle.sin()];
                if on_grid { p.map(|x| (x / 32.0).round() * 32.0) } else { p }
            });
            Stroke { kind, points: points.collect() }
        });
        let sketch = Sketch {
            name: String::new(),
            canvas_size: [256.0; 2],
            view: View::default(),
            strokes: strokes.collect(),
            depth_samples: vec![],
        };
        for patch in understand(&sketch).map(|u| u.patches).unwrap_or_default() {
            assert!(!patch.regions.is_empty() && patch.border.len() > 3);
            assert!(rasterize(&patch).data.iter().all(|x| x.is_finite()));
        }
    }
}
