use super::super::silhouette::{self, Polyline};
use super::super::synthetic::{self, Scene};
use super::super::tensor::{GridAxis, GridPlanes, TensorGrid};
use super::super::{BorderCurves, LayerSample, SurfaceProjector, coons_net, unfolded_net};
use super::*;
use nalgebra::Vector3;

fn targets(scene: &Scene) -> SurfaceTargets {
    SurfaceTargets {
        border: scene.border.clone(),
        corners: scene.corners,
        contours: scene.contours.clone(),
        samples: vec![],
        maps: scene.maps.clone(),
        guess: None,
    }
}

fn coons(targets: &SurfaceTargets) -> NurbsSurface {
    let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
    NurbsSurface::new(curves.knots.clone(), coons_net(&curves), None).unwrap()
}

/// Root mean square and largest distance from samples of `surface` to `truth`.
fn deviation(surface: &NurbsSurface, truth: &NurbsSurface) -> [f64; 2] {
    let projector = SurfaceProjector::new(truth);
    let (mut sum, mut largest, mut count) = (0.0, 0f64, 0);
    for i in 0..=30 {
        for j in 0..=30 {
            let [u, v] = surface.at_fraction(i as f64 / 30.0, j as f64 / 30.0);
            let distance = projector.closest(&surface.point(u, v)).distance;
            sum += distance * distance;
            largest = largest.max(distance);
            count += 1;
        }
    }
    [(sum / count as f64).sqrt(), largest]
}

fn start_of(scene: &Scene, size: f64) -> NurbsSurface {
    // A network's answer: the truth with smooth errors.
    let net = scene.truth.control_points().iter().map(|p| {
        let error = [0.5 * (p.y * 1.1).sin(), 0.5 * (p.x * 0.9).cos(), (p.x + p.y).sin()];
        p + Vector3::from(error) * size
    });
    NurbsSurface::uniform(3, [30, 30], net.collect()).unwrap()
}

fn run(start: &NurbsSurface, targets: &SurfaceTargets) -> Refined {
    refine(start, targets, &RefineOptions::default(), &Control::default()).unwrap()
}

#[test]
fn open_surfaces_are_recovered_from_the_coons_patch() {
    for truth in [synthetic::dome(), synthetic::saddle()] {
        let scene = synthetic::scene(truth);
        let targets = targets(&scene);
        let start = coons(&targets);
        let refined = run(&start, &targets);
        let [rms, largest] = deviation(&refined.surface, &scene.truth);
        assert!(rms < 0.002 && largest < 0.02, "{rms} {largest}");
        assert!(rms < deviation(&start, &scene.truth)[0]);
        let report = refined.report;
        assert!(report.border_px[0] < 0.05 && report.border_px[1] < 0.3, "{report:?}");
        assert!(report.folds == 0 && report.misfacing == 0.0 && report.energy[1] <= report.energy[0]);
    }
}

#[test]
fn a_folded_vault_is_recovered_from_a_bent_start_and_from_the_unfolded_maps() {
    let scene = synthetic::scene(synthetic::vault());
    let targets = targets(&scene);
    let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
    let net = unfolded_net(&targets.border, &curves, &targets.contours, &targets.maps, 1.0).unwrap();
    let unfolded = NurbsSurface::new(curves.knots, net, None).unwrap();
    // Rms and largest deviation, mean and largest miss of border and contours, pixels.
    let far = (start_of(&scene, 0.3), [0.03, 0.2], [0.3, 3.0]);
    let near = (unfolded, [0.015, 0.25], [0.1, 1.0]);
    // From far away the contour is still on its way after the usual twelve steps.
    let options = RefineOptions { iterations: 16, ..RefineOptions::default() };
    for (start, [most_rms, most], [mean_px, max_px]) in [far, near] {
        let refined = refine(&start, &targets, &options, &Control::default()).unwrap();
        let [rms, largest] = deviation(&refined.surface, &scene.truth);
        assert!(rms < most_rms && largest < most, "{rms} {largest}");
        assert!(rms < deviation(&start, &scene.truth)[0]);
        let report = refined.report;
        for [mean, max] in [report.border_px, report.contour_px] {
            assert!(mean < mean_px && max < max_px, "{report:?}");
        }
        assert!(report.folds == 0 && report.misfacing < 0.005, "{report:?}");
    }
}

#[test]
fn a_start_that_folds_over_is_unfolded() {
    let scene = synthetic::scene(synthetic::dome());
    let targets = targets(&scene);
    // Parameter lines that run back in the middle of the patch, by more than their distance.
    let net = scene.truth.control_points().iter().map(|p| {
        let back = (-(p.x * p.x + p.y * p.y) / 0.5).exp();
        p + Vector3::new(-2.5 * p.x * back, 0.0, 0.0)
    });
    let start = NurbsSurface::uniform(3, [30, 30], net.collect()).unwrap();
    let unrefined = RefineOptions { iterations: 0, ..RefineOptions::default() };
    let before = refine(&start, &targets, &unrefined, &Control::default()).unwrap().report;
    let refined = run(&start, &targets);
    let after = refined.report;
    assert!(before.folds > 0 && before.misfacing > 0.005, "{before:?}");
    assert!(after.folds == 0 && after.misfacing == 0.0 && after.border_px[0] < 0.1, "{after:?}");
    assert!(deviation(&refined.surface, &scene.truth)[0] < 0.01);
}

#[test]
fn strokes_win_over_maps_that_disagree() {
    let scene = synthetic::scene(synthetic::saddle());
    let mut targets = targets(&scene);
    for (k, depth) in targets.maps.visible.depth.iter_mut().enumerate() {
        *depth += 0.15 * (k as f64 * 0.37).sin() + 0.1 * ((k / 64) as f64 * 0.2).cos();
    }
    let refined = run(&coons(&targets), &targets);
    assert!(refined.report.border_px[0] < 0.1, "{:?}", refined.report);
    assert!(deviation(&refined.surface, &scene.truth)[0] < 0.12);
}

#[test]
fn contours_that_count_more_are_met_more_nearly() {
    let scene = synthetic::scene(synthetic::vault());
    let mut targets = targets(&scene);
    // Four pixels from where the maps fold.
    for p in targets.contours.iter_mut().flatten() {
        p[1] += 0.14;
    }
    let mut refiner = Refiner::new(scene.truth.knots(), &targets, &RefineOptions::default()).unwrap();
    let mut miss = |insistence: f64| {
        refiner.insistence = insistence;
        refiner.run_best(std::slice::from_ref(&scene.truth), &Control::default()).unwrap().report.contour_px[0]
    };
    let (usual, insistent) = (miss(1.0), miss(8.0));
    assert!(usual > 0.1 && insistent < 0.7 * usual, "{usual} {insistent}");
}

#[test]
fn depth_samples_are_met_and_act_locally() {
    let scene = synthetic::scene(synthetic::vault());
    let mut targets = targets(&scene);
    let plain = run(&start_of(&scene, 0.1), &targets).surface;
    let mesh = crate::surface::SurfaceMesh::new(&scene.truth, [100, 100]).unwrap();
    let caster = crate::surface::RayCaster::new(&mesh, [Vector3::x(), Vector3::y(), Vector3::z()]);
    let visible = caster.hits(-2.0, -1.0)[0].depth;
    let occluded = caster.hits(2.0, 2.1)[1].depth;
    targets.samples = vec![
        LayerSample { position: [-2.0, -1.0], occluded: false, depth: visible + 0.4 },
        LayerSample { position: [2.0, 2.1], occluded: true, depth: occluded - 0.3 },
    ];
    let refined = run(&start_of(&scene, 0.1), &targets);
    let range = 6.0;
    assert!(refined.report.sample_residual < 0.01 * range, "{:?}", refined.report);
    assert_eq!(refined.report.samples_missed, 0);
    assert!(refined.report.border_px[0] < 0.3 && refined.report.folds == 0, "{:?}", refined.report);
    // The corner of the near side, far from both.
    let [u, v] = plain.at_fraction(0.97, 0.95);
    assert!((plain.point(u, v) - refined.surface.point(u, v)).norm() < 0.05);
}

#[test]
fn moving_a_depth_sample_moves_the_surface_continuously() {
    let scene = synthetic::scene(synthetic::vault());
    let mut targets = targets(&scene);
    let mesh = crate::surface::SurfaceMesh::new(&scene.truth, [100, 100]).unwrap();
    let caster = crate::surface::RayCaster::new(&mesh, [Vector3::x(), Vector3::y(), Vector3::z()]);
    let visible = caster.hits(-2.0, -1.0)[0].depth;
    let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
    let mut at = |offset: f64| {
        targets.samples = vec![LayerSample { position: [-2.0, -1.0], occluded: false, depth: visible + offset }];
        let maps = targets.maps.meeting(&targets.samples);
        let net = unfolded_net(&targets.border, &curves, &targets.contours, &maps, 1.0).unwrap();
        run(&NurbsSurface::new(curves.knots.clone(), net, None).unwrap(), &targets).surface
    };
    // How far the surface moves, not its parameters, which no one sees.
    let moved = |a: &NurbsSurface, b: &NurbsSurface| deviation(a, b)[1];
    let (base, little, more) = (at(0.2), at(0.201), at(0.3));
    assert!(moved(&base, &little) < 0.01 && moved(&base, &more) > 0.05, "{}", moved(&base, &little));
    assert!(moved(&base, &more) < 0.4);
}

#[test]
fn a_shift_in_depth_shifts_the_result() {
    let scene = synthetic::scene(synthetic::dome());
    let mut targets = targets(&scene);
    let start = start_of(&scene, 0.1);
    let before = run(&start, &targets).surface;
    for depth in &mut targets.maps.visible.depth {
        *depth -= 3.0;
    }
    let shift = Vector3::new(0.0, 0.0, 3.0);
    let after = run(&start.mapped(|p| p + shift), &targets).surface;
    for (a, b) in before.control_points().iter().zip(after.control_points()) {
        assert!((a + shift - b).norm() < 1e-6);
    }
}

#[test]
fn the_gradient_is_that_of_the_energy() {
    // On a plane with exact linear maps the lagged directions and footpoints are exact too.
    let scene = synthetic::scene(synthetic::surface(|s, t| {
        let (x, y) = (7.0 * t - 3.5, 3.5 - 7.0 * s);
        [x, y, 0.3 * x - 0.2 * y - 4.0]
    }));
    let targets = targets(&scene);
    let start = start_of(&scene, 0.02);
    let mut refiner = Refiner::new(start.knots(), &targets, &RefineOptions::default()).unwrap();
    refiner.begin(&start);
    let net = refiner.start.clone();
    let model = refiner.linearize(&net);
    let h = 1e-6;
    for k in [0, 35, 435, 899, 900 + 14 * 30, 900 + 455, 1800, 1800 + 222, 1800 + 871] {
        let moved = |by: f64| {
            let mut net = net.clone();
            net[k] += by;
            refiner.linearize(&net).energy
        };
        let difference = (moved(h) - moved(-h)) / (4.0 * h);
        let scale = 1e-4 + difference.abs();
        assert!((difference - model.gradient[k]).abs() < 0.05 * scale, "{k}: {difference} {}", model.gradient[k]);
    }
}

#[test]
fn the_silhouette_moves_by_the_projected_normal_displacement() {
    let scene = synthetic::scene(synthetic::vault());
    let surface = &scene.truth;
    let knots = surface.knots();
    let grid = TensorGrid { axes: [GridAxis::even(&knots[0], GRID), GridAxis::even(&knots[1], GRID)] };
    let contour = |surface: &NurbsSurface| {
        let net = planes_of(surface);
        let planes = [0, 1, 2].map(|c| {
            let mut planes = GridPlanes::default();
            grid.forward(&net[c * 900..(c + 1) * 900], &mut planes);
            planes
        });
        silhouette::crossings(surface, &grid, &silhouette::facing(&planes))
    };
    let before = contour(surface);
    let point = before[before.len() / 2];
    let (i, j) = (point.bases[0].first + 1, point.bases[1].first + 2);
    let d = surface.evaluate_with(&point.bases[0], &point.bases[1]);
    let normal = d.du.cross(&d.dv).normalize();
    let h = 1e-4;
    let mut net = surface.control_points().to_vec();
    net[i * 30 + j] += normal * h;
    let moved = NurbsSurface::uniform(3, [30, 30], net).unwrap();
    let line = Polyline::new(
        contour(&moved).iter().filter(|p| (p.position[0] - point.position[0]).abs() < 1.0).map(|p| p.position),
    );
    let expected = h * point.bases[0].values[0][1] * point.bases[1].values[0][2];
    // The new silhouette lies beyond the old point by the displacement along the normal.
    let mut sorted = line.points.clone();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let foot = Polyline::new(sorted).nearest(point.position, [0.0, f64::INFINITY]).unwrap();
    let offset = (foot.position[0] - point.position[0]) * normal.x + (foot.position[1] - point.position[1]) * normal.y;
    assert!((offset - expected).abs() < 0.15 * expected, "{offset} {expected}");
}

#[test]
fn fairness_irons_out_waves_and_closeness_keeps_the_start() {
    let scene = synthetic::scene(synthetic::dome());
    let mut targets = targets(&scene);
    // Eight waves a side, a twentieth of a unit high.
    for k in 0..targets.maps.visible.depth.len() {
        let [x, y] = targets.maps.visible.center(k);
        targets.maps.visible.depth[k] += 0.05 * (7.0 * x).sin() * (7.0 * y).cos();
    }
    let start = start_of(&scene, 0.05);
    let with = |fairness: f64, closeness: f64| {
        let options = RefineOptions { fairness, closeness, ..RefineOptions::default() };
        refine(&start, &targets, &options, &Control::default()).unwrap().surface
    };
    let off = |surface: &NurbsSurface| deviation(surface, &scene.truth)[0];
    let [rough, usual] = [0.01, 1.0].map(|fairness| off(&with(fairness, 1.0)));
    assert!(usual < 0.7 * rough, "{rough} {usual}");
    let moved = |surface: &NurbsSurface| {
        let pairs = surface.control_points().iter().zip(start.control_points());
        pairs.map(|(p, q)| (p - q).norm_squared()).sum::<f64>().sqrt()
    };
    let [free, held, fixed] = [0.0, 100.0, 1e9].map(|closeness| moved(&with(1.0, closeness)));
    assert!(held < free && fixed < 0.1 * free, "{free} {held} {fixed}");
}

#[test]
fn another_guess_counts_as_much_as_the_maps() {
    let scene = synthetic::scene(synthetic::dome());
    let mut targets = targets(&scene);
    let depth = |surface: &NurbsSurface| {
        let [u, v] = surface.at_fraction(0.5, 0.5);
        -surface.point(u, v).z
    };
    let truth = depth(&scene.truth);
    targets.maps.visible.depth.iter_mut().for_each(|depth| *depth += 0.1);
    targets.guess = Some(scene.truth.mapped(|p| p + Vector3::new(0.0, 0.0, 0.1)));
    let between = depth(&run(&scene.truth, &targets).surface);
    assert!((between - truth).abs() < 0.03, "{between} {truth}");
    targets.guess = Some(NurbsSurface::uniform(3, [10, 90], scene.truth.control_points().to_vec()).unwrap());
    let other = refine(&scene.truth, &targets, &RefineOptions::default(), &Control::default());
    assert!(matches!(other, Err(Error::Nurbs { .. })));
}

#[test]
fn of_several_starts_the_nearest_is_taken() {
    let scene = synthetic::scene(synthetic::saddle());
    let targets = targets(&scene);
    let starts = [start_of(&scene, 0.8), start_of(&scene, 0.05)];
    let best = |starts: &[NurbsSurface]| refine_best(starts, &targets, &RefineOptions::default(), &Control::default());
    let alone = run(&starts[1], &targets);
    for order in [[0, 1], [1, 0]] {
        let refined = best(&order.map(|k| starts[k].clone())).unwrap();
        assert_eq!((refined.surface, refined.report), (alone.surface.clone(), alone.report));
    }
    assert!(matches!(best(&[]), Err(Error::Degenerate { .. })));
    let coarse = NurbsSurface::uniform(3, [10, 90], starts[0].control_points().to_vec()).unwrap();
    assert!(matches!(best(&[starts[0].clone(), coarse]), Err(Error::Nurbs { .. })));
}

#[test]
fn cancelling_and_bad_input_are_errors() {
    let scene = synthetic::scene(synthetic::saddle());
    let targets = targets(&scene);
    let control = Control::default();
    control.cancel();
    let options = RefineOptions::default();
    assert_eq!(refine(&scene.truth, &targets, &options, &control).unwrap_err(), Error::Cancelled);
    let bad = RefineOptions { fairness: f64::NAN, ..options };
    assert!(matches!(refine(&scene.truth, &targets, &bad, &Control::default()), Err(Error::Argument { .. })));
    let flat = NurbsSurface::uniform(2, [30, 30], scene.truth.control_points().to_vec()).unwrap();
    assert!(matches!(refine(&flat, &targets, &options, &Control::default()), Err(Error::Nurbs { .. })));
}
