use super::*;
use crate::sketch::{DepthSample, Stroke};

use StrokeKind::{Contour as R, Feature as F, OccludedBoundary as B, VisibleBoundary as G};

/// A smooth polyline through points (Catmull-Rom, 12 steps a span), canvas y down.
fn curve(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = points.len();
    let at = |i: isize| points[i.clamp(0, n as isize - 1) as usize];
    let mut result = vec![points[0]];
    for i in 0..n - 1 {
        let [a, b, c, d] = [-1, 0, 1, 2].map(|k| at(i as isize + k));
        for step in 1..=12 {
            let t = f64::from(step) / 12.0;
            result.push([0, 1].map(|k| {
                0.5 * (2.0 * b[k]
                    + (c[k] - a[k]) * t
                    + (2.0 * a[k] - 5.0 * b[k] + 4.0 * c[k] - d[k]) * t * t
                    + (3.0 * b[k] - a[k] - 3.0 * c[k] + d[k]) * t * t * t)
            }));
        }
    }
    result
}

fn sketch(strokes: &[(StrokeKind, &[[f64; 2]])]) -> Sketch {
    Sketch {
        name: String::new(),
        canvas_size: [256.0; 2],
        view: View::default(),
        strokes: strokes.iter().map(|(kind, p)| Stroke { kind: *kind, points: curve(p) }).collect(),
        depth_samples: vec![],
    }
}

fn square() -> Sketch {
    let mut sketch = sketch(&[]);
    for w in [[20.0, 20.0], [220.0, 30.0], [230.0, 200.0], [30.0, 210.0], [20.0, 20.0]].windows(2) {
        sketch.strokes.push(Stroke { kind: G, points: w.to_vec() });
    }
    sketch
}

/// A vault with a fold at the back (results, left).
fn folded() -> Sketch {
    sketch(&[
        (
            G,
            &[
                [42.0, 60.0],
                [20.0, 100.0],
                [38.0, 160.0],
                [120.0, 128.0],
                [190.0, 150.0],
                [240.0, 190.0],
                [245.0, 70.0],
                [230.0, 40.0],
            ],
        ),
        (B, &[[40.0, 62.0], [100.0, 100.0], [140.0, 95.0], [190.0, 50.0], [228.0, 38.0]]),
        (R, &[[43.0, 61.0], [110.0, 48.0], [170.0, 10.0], [229.0, 41.0]]),
    ])
}

/// A fold whose back border shows on both sides (results, right).
fn eared() -> Sketch {
    sketch(&[
        (R, &[[20.0, 48.0], [80.0, 30.0], [130.0, 14.0], [180.0, 20.0], [224.0, 46.0]]),
        (
            G,
            &[
                [60.0, 92.0],
                [40.0, 125.0],
                [20.0, 118.0],
                [6.0, 78.0],
                [18.0, 48.0],
                [60.0, 90.0],
                [80.0, 150.0],
                [120.0, 200.0],
                [160.0, 170.0],
                [185.0, 100.0],
                [222.0, 46.0],
                [250.0, 60.0],
                [240.0, 130.0],
                [215.0, 128.0],
                [186.0, 101.0],
            ],
        ),
        (B, &[[61.0, 89.0], [120.0, 62.0], [184.0, 98.0]]),
    ])
}

fn only(sketch: &Sketch) -> PatchSketch {
    let mut understanding = understand(sketch).unwrap();
    assert_eq!(understanding.patches.len(), 1);
    understanding.patches.remove(0)
}

fn layers(patch: &PatchSketch) -> Vec<(Orientation, bool)> {
    patch.regions.iter().map(|r| (r.visible, r.occluded.is_some())).collect()
}

use Orientation::{Back, Front};

#[test]
fn a_square_is_one_front_region() {
    let patch = only(&square());
    assert_eq!(layers(&patch), [(Front, false)]);
    let ring: Vec<_> = patch.border.iter().map(|b| b.position).collect();
    let area = super::super::polyline::signed_area(&ring);
    assert!((area - patch.regions[0].area).abs() < 1e-9 && area > 0.0);
    assert!(patch.strokes.iter().all(|s| {
        s.points.windows(2).all(|w| super::super::polyline::distance(w[0], w[1]) < 1.05 * CANONICAL_PER_PX)
    }));
}

#[test]
fn behind_a_contour_there_are_two_layers() {
    let patch = only(&folded());
    let mut found = layers(&patch);
    found.sort_by_key(|l| l.1);
    assert_eq!(found, [(Front, false), (Front, true)]);
    assert!(patch.border.iter().any(|b| b.layer == Layer::Occluded));
    assert_eq!(patch.strokes.iter().map(|s| s.kind).collect::<Vec<_>>(), [G, B, R]);
}

#[test]
fn what_shows_below_a_fold_is_the_back() {
    let patch = only(&eared());
    let mut found = layers(&patch);
    found.sort_by_key(|l| (l.0 == Back, l.1));
    assert_eq!(found, [(Front, false), (Front, true), (Back, false), (Back, false)]);
}

#[test]
fn the_border_has_one_layer_more_on_the_side_of_its_sheet() {
    for patch in [folded(), eared(), square()].map(|sketch| only(&sketch)) {
        let layers = |p: [f64; 2]| patch.region_at(p).map_or(0, |region| 1 + usize::from(region.occluded.is_some()));
        let n = patch.border.len();
        let (mut agreeing, mut sides) = (0, vec![]);
        for i in 0..n {
            let (a, b) = (patch.border[i], patch.border[(i + 1) % n].position);
            let (middle, d) = ([0, 1].map(|k| 0.5 * (a.position[k] + b[k])), [0, 1].map(|k| b[k] - a.position[k]));
            let [left, right] = [0.5, -0.5].map(|s| layers([middle[0] - s * d[1], middle[1] + s * d[0]]));
            agreeing += usize::from(if a.side == Front { left > right } else { right > left });
            sides.push(a.side);
        }
        assert!(agreeing > n - n / 50, "{agreeing} of {n}");
        // The border turns over with the sheet wherever that folds.
        assert_eq!(sides.contains(&Back), patch.strokes.iter().any(|s| s.kind == R));
    }
}

#[test]
fn order_and_direction_of_strokes_do_not_matter() {
    for original in [folded(), eared(), square()] {
        let expected = only(&original);
        let mut changed = original.clone();
        changed.strokes.reverse();
        for s in changed.strokes.iter_mut().step_by(2) {
            s.points.reverse();
        }
        let patch = only(&changed);
        assert_eq!(layers(&patch), layers(&expected));
        for (a, b) in patch.regions.iter().zip(&expected.regions) {
            assert!((a.area - b.area).abs() < 0.03 + 0.002 * b.area, "{} {}", a.area, b.area);
        }
    }
}

#[test]
fn moving_and_scaling_the_canvas_changes_only_the_frame() {
    for original in [folded(), eared()] {
        let expected = only(&original);
        for (scale, shift) in [(1e-7, [0.0, 0.0]), (40.0, [1e5, -3e4]), (1e9, [0.0, 1e9])] {
            let mut changed = original.clone();
            for p in changed.strokes.iter_mut().flat_map(|s| &mut s.points) {
                *p = [0, 1].map(|k| p[k] * scale + shift[k]);
            }
            let patch = only(&changed);
            assert_eq!(patch.border.len(), expected.border.len());
            for (a, b) in patch.border.iter().zip(&expected.border) {
                assert!((a.position[0] - b.position[0]).abs() < 1e-6 && (a.position[1] - b.position[1]).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn features_are_clipped_to_the_visible_surface() {
    let mut s = square();
    s.strokes.push(Stroke { kind: F, points: vec![[100.0, -50.0], [110.0, 300.0]] });
    s.strokes.push(Stroke { kind: F, points: vec![[400.0, 0.0], [500.0, 300.0]] });
    let understanding = understand(&s).unwrap();
    assert_eq!(understanding.unused, [5]);
    let features: Vec<_> = understanding.patches[0].strokes.iter().filter(|s| s.kind == F).collect();
    assert_eq!(features.len(), 1);
    let low = features[0].points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    assert!((-3.6..-3.2).contains(&low), "{low}");
}

#[test]
fn two_outlines_become_two_patches() {
    let mut s = folded();
    let count = s.strokes.len();
    for stroke in square().strokes {
        s.strokes.push(Stroke { kind: G, points: stroke.points.iter().map(|p| [p[0] + 300.0, p[1]]).collect() });
    }
    s.depth_samples.push(DepthSample { position: [400.0, 100.0], layer: Layer::Visible, depth: 10.0 });
    s.depth_samples.push(DepthSample { position: [150.0, 60.0], layer: Layer::Occluded, depth: 20.0 });
    let understanding = understand(&s).unwrap();
    assert_eq!(understanding.patches.len(), 2);
    assert!(understanding.patches.iter().all(|p| p.depth_samples.len() == 1));
    assert_eq!(count, 3);
}

#[test]
fn nothing_to_bound_a_surface_is_no_outline() {
    assert_eq!(understand(&sketch(&[])).unwrap_err(), Error::NoOutline);
    assert_eq!(understand(&sketch(&[(F, &[[0.0, 0.0], [10.0, 10.0]])])).unwrap_err(), Error::NoOutline);
    let mut point = sketch(&[]);
    point.strokes.push(Stroke { kind: G, points: vec![[3.0, 4.0]] });
    assert_eq!(understand(&point).unwrap_err(), Error::NoOutline);
}

#[test]
fn an_open_outline_names_its_gap() {
    let mut s = square();
    s.strokes[1].points = vec![[220.0, 30.0], [226.0, 140.0]];
    let Error::OpenOutline { x, y, gap, .. } = understand(&s).unwrap_err() else { panic!() };
    let ends = [[226.0, 140.0], [230.0, 200.0]];
    assert!(ends.iter().any(|e| (x - e[0]).hypot(y - e[1]) < 1.0), "{x} {y}");
    assert!((gap - 60.3).abs() < 2.0, "{gap}");
}

#[test]
fn a_figure_eight_names_its_crossing() {
    let mut s = sketch(&[]);
    let points = (0..=200).map(|i| {
        let t = f64::from(i) / 200.0 * std::f64::consts::TAU + 0.3;
        [128.0 + 100.0 * t.sin(), 128.0 + 60.0 * (2.0 * t).sin()]
    });
    s.strokes.push(Stroke { kind: G, points: points.collect() });
    let Error::Contradiction { x, y, reason } = understand(&s).unwrap_err() else { panic!() };
    assert!((x - 128.0).hypot(y - 128.0) < 1.0, "{x} {y}");
    assert!(reason.contains("crosses"), "{reason}");
}

#[test]
fn wrong_kinds_are_named_where_they_are() {
    let mut s = folded();
    s.strokes[2].kind = F;
    assert!(matches!(understand(&s), Err(Error::Contradiction { .. })));
    let mut s = folded();
    s.strokes[1].kind = G;
    understand(&s).unwrap();
    let mut s = eared();
    s.strokes[2].kind = G;
    let Err(Error::Contradiction { x, y, .. }) = understand(&s) else { panic!() };
    assert!([[61.0, 89.0], [184.0, 99.0]].iter().any(|p| (x - p[0]).hypot(y - p[1]) < 5.0), "{x} {y}");
}

#[test]
fn a_sample_outside_its_layer_is_refused() {
    let mut s = square();
    s.depth_samples.push(DepthSample { position: [19.0, 100.0], layer: Layer::Visible, depth: 1.0 });
    let patch = only(&s);
    assert!(patch.region_at(patch.depth_samples[0].position.map(|x| x * 0.999)).is_some());
    s.depth_samples.push(DepthSample { position: [100.0, 100.0], layer: Layer::Occluded, depth: 1.0 });
    assert!(matches!(understand(&s), Err(Error::SampleOutside { index: 1, layer: "occluded", .. })));
}

#[test]
fn a_million_points_are_understood_quickly() {
    let mut s = sketch(&[]);
    let points = (0..1_000_000).map(|i| {
        let t = f64::from(i) * 1e-6 * std::f64::consts::TAU;
        [128.0 + 100.0 * t.cos(), 128.0 + 80.0 * t.sin()]
    });
    s.strokes.push(Stroke { kind: G, points: points.collect() });
    let patch = only(&s);
    assert!((patch.regions[0].area / (16.0 * 0.8 * std::f64::consts::PI) - 1.0).abs() < 2e-3);
}
