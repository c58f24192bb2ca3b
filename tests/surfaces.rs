//! First call: surfaces obey their sketches, in any view, and hosts' own surfaces of any kind go on.

use nalgebra::{Point3, Rotation3, Vector3};
use sketch2pq::control::Control;
use sketch2pq::datagen::{Options, sample};
use sketch2pq::evaluate::Split;
use sketch2pq::evaluate::metrics::{SurfaceSamples, chamfer};
use sketch2pq::infer::BackendChoice;
use sketch2pq::pipeline::{
    FieldOptions, MeshOptions, Session, SessionOptions, SurfaceOptions, SurfaceResult, extract_pq_mesh, sketch_to_cdf,
    sketch_to_surface,
};
use sketch2pq::sketch::{Sketch, Stroke, StrokeKind, View, parse_json};
use sketch2pq::surface::{BorderCurves, KnotVector, NurbsSurface, RefineOptions, Refined, SurfaceProjector, fit};

fn session() -> Session {
    let options = SessionOptions { backend: BackendChoice::Embedded, threads: 1, ..SessionOptions::default() };
    Session::new(&options).unwrap()
}

fn surface(session: &mut Session, sketch: &Sketch) -> SurfaceResult {
    sketch_to_surface(session, sketch, &SurfaceOptions::default()).unwrap()
}

fn example(name: &str) -> Sketch {
    let path = format!("{}/examples/sketches/{name}.json", env!("CARGO_MANIFEST_DIR"));
    parse_json(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn every_example_meets_its_strokes() {
    let mut session = session();
    for name in [
        "barrel_vault",
        "dome",
        "front_foldover",
        "leaning_shell",
        "results_left",
        "results_right",
        "rounded_corner",
        "saddle",
    ] {
        let result = surface(&mut session, &example(name));
        let diagnostics = result.patches[0].diagnostics;
        // The fold in front of front_foldover was 14 px off, its mean, while no start had a silhouette there; it still
        // bulges over its contour by more than the half pixel that is wanted.
        let bound = if name == "front_foldover" { 0.7 } else { 0.2 };
        assert!(
            diagnostics.reprojection_mean_px < bound && diagnostics.reprojection_max_px < 6.0,
            "{name}: {diagnostics:?}"
        );
        assert!(diagnostics.misfacing < 0.02, "{name}: {diagnostics:?}");
        assert_eq!(result.report.fold_overs, Some(diagnostics.fold_overs));
    }
}

/// Seeds whose surface once missed its strokes: small second folds, samples behind folds, starts that could not be left.
#[test]
fn seeds_with_trouble_stay_near_their_strokes() {
    let mut session = session();
    for seed in [152, 9_000_004, 9_000_020, 9_000_080, 9_000_091, 9_000_103] {
        let truth = sample(seed, &Options::default()).unwrap();
        let diagnostics = surface(&mut session, &truth.sketch).patches[0].diagnostics;
        assert!(diagnostics.reprojection_mean_px < 0.5, "{seed}: {diagnostics:?}");
    }
}

/// Sketches whose surface was once wrong although the maps were exact: it folded over, in strips between a contour and the border behind it
/// that are thinner than a map pixel, in deep notches, where parameter lines jammed beside a contour's end; or it lost the strip that shows
/// its underside, because the border there was lifted to what lies behind.
#[test]
fn exact_maps_give_the_surface() {
    let surfaces =
        [4, 20, 23, 43, 46, 62, 102, 103, 129, 143, 163, 388, 399, 551, 679, 778].map(|index| (Split::Surfaces, index));
    for (split, index) in surfaces.into_iter().chain([(Split::Rotations, 24)]) {
        let truth = split.sample(index, &Options::default()).unwrap();
        let targets = truth.surface_targets().unwrap();
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
        let Refined { surface, report } =
            fit(&targets, &curves, &RefineOptions::default(), &Control::default()).unwrap();
        let [found, actual] = [&surface, &truth.surface].map(|surface| SurfaceSamples::new(surface, 100));
        let (distance, angle) = chamfer(&found, &actual);
        assert_eq!(report.folds, 0, "{split:?} {index}: {report:?}");
        assert!(report.border_px[0] < 0.5 && report.contour_px[0] < 0.5, "{split:?} {index}: {report:?}");
        // The squared distance between points of the same surface, sampled twice, is about 0.001.
        assert!(distance < 0.006 && angle < 4.0, "{split:?} {index}: {distance} {angle}");
    }
}

#[test]
fn moving_one_of_many_depth_samples_leaves_the_others_met_and_moves_little_far_away() {
    let mut session = session();
    let sketch = sample(9_000_009, &Options::default()).unwrap().sketch;
    assert!(sketch.depth_samples.len() > 3);
    let view = sketch.view;
    let extent = |axis: usize| {
        let values = || sketch.strokes.iter().flat_map(|s| &s.points).map(|p| p[axis]);
        values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
    };
    let size = extent(0).max(extent(1));
    let mut at = |offset: f64| {
        let mut moved = sketch.clone();
        moved.depth_samples[0].depth += offset * size;
        let result = surface(&mut session, &moved);
        assert!(result.patches[0].diagnostics.sample_residual < 0.01 * size);
        result.patches[0].surface.mapped(|p| view.world_to_camera(p))
    };
    let (base, little, more) = (at(0.0), at(0.0005), at(0.02));
    let sample = view.canvas_to_camera(sketch.depth_samples[0].position);
    // Distance on the canvas from the sample, and of the surfaces; both over the drawing's size.
    let apart = |other: &NurbsSurface| {
        let projector = SurfaceProjector::new(&base);
        let points = (0..21 * 21).map(|k| other.at_fraction((k / 21) as f64 / 20.0, (k % 21) as f64 / 20.0));
        let at = |p: Point3<f64>| [(p.x - sample[0]).hypot(p.y - sample[1]), projector.closest(&p).distance];
        points.map(|[u, v]| at(other.point(u, v)).map(|d| d / size)).collect::<Vec<_>>()
    };
    let (little, more) = (apart(&little), apart(&more));
    // A fortieth of the move is little of the change, and nothing moves much farther than the sample.
    let [small, large] = [&little, &more].map(|all| all.iter().map(|[_, change]| *change).fold(0.0, f64::max));
    assert!(small < 0.002 && large > 0.005 && large < 0.06, "{small} {large}");
    let mean = |low: f64, high: f64| {
        let changes: Vec<f64> = more.iter().filter(|[far, _]| (low..high).contains(far)).map(|[_, d]| *d).collect();
        changes.iter().sum::<f64>() / changes.len() as f64
    };
    let [near, far] = [mean(0.0, 0.125), mean(0.5, f64::INFINITY)];
    assert!(near > 0.01 && far < 0.2 * near, "{near} {far}");
}

#[test]
fn turning_the_view_turns_the_surface() {
    let mut session = session();
    let mut sketch = example("leaning_shell");
    sketch.view = View::from_angles(10.0, 35.0, true).unwrap();
    let net = surface(&mut session, &sketch).patches[0].surface.control_points().to_vec();
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 73f64.to_radians());
    let [right, up, toward] = [sketch.view.right(), sketch.view.up(), sketch.view.toward()].map(|axis| turn * axis);
    sketch.view = View::from_axes(right, up, toward, true).unwrap();
    let turned = surface(&mut session, &sketch);
    let size = net.iter().map(|p| p.coords.norm()).fold(0.0, f64::max);
    for (p, q) in net.iter().zip(turned.patches[0].surface.control_points()) {
        assert!((turn * p - q).norm() < 1e-6 * size, "{p} {q}");
    }
}

#[test]
fn strokes_are_met_from_every_elevation() {
    let mut session = session();
    for elevation in [25.0, 45.0, 65.0] {
        for name in ["leaning_shell", "saddle"] {
            let mut sketch = example(name);
            sketch.view = View::from_angles(-30.0, elevation, true).unwrap();
            let diagnostics = surface(&mut session, &sketch).patches[0].diagnostics;
            assert!(diagnostics.reprojection_mean_px < 0.5, "{name} at {elevation}: {diagnostics:?}");
        }
    }
}

#[test]
fn strokes_that_belong_to_no_patch_are_named() {
    let mut session = session();
    let mut sketch = example("saddle");
    let count = sketch.strokes.len();
    let line = |points: Vec<[f64; 2]>| Stroke { kind: StrokeKind::Feature, points };
    sketch.strokes.insert(0, line(vec![[900.0, 900.0], [950.0, 940.0], [990.0, 900.0]]));
    sketch.strokes.push(sketch.strokes[1].clone());
    let result = surface(&mut session, &sketch);
    assert_eq!((result.patches.len(), &result.unused_strokes), (1, &vec![0, count + 1]));
    assert_eq!(result.report.unused_strokes, Some(vec![0, count + 1]));
}

#[test]
fn hosts_surfaces_of_any_degree_size_and_weights_become_panels() {
    let mut session = session();
    for (degrees, counts, rational, size) in
        [([5, 2], [9, 6], true, 40.0), ([1, 1], [2, 2], false, 0.01), ([3, 4], [40, 12], false, 7e4)]
    {
        let knots = [0, 1].map(|k| KnotVector::uniform(degrees[k], counts[k]));
        let net = (0..counts[0] * counts[1]).map(|k| {
            let [s, t] =
                [(k / counts[1]) as f64 / (counts[0] - 1) as f64, (k % counts[1]) as f64 / (counts[1] - 1) as f64];
            Point3::new(s, t, 0.3 * s * t + 0.1 * (s - 0.5).powi(2)) * size
        });
        let weights = rational.then(|| (0..counts[0] * counts[1]).map(|k| 1.0 + 0.3 * (k as f64).sin()).collect());
        let host = NurbsSurface::new(knots, net.collect(), weights).unwrap();
        let surface = SurfaceResult::from_nurbs(vec![host]).unwrap();
        let field = sketch_to_cdf(&mut session, None, &surface, &FieldOptions::default()).unwrap();
        let options = MeshOptions { faces: 100, ..MeshOptions::default() };
        let mesh = extract_pq_mesh(&mut session, &field, &options).unwrap();
        assert!(mesh.report.faces.unwrap() > 40, "{degrees:?}: {:?}", mesh.report);
        assert!(mesh.report.deviation_max_edges.unwrap() < 0.5, "{degrees:?}: {:?}", mesh.report);
    }
}
