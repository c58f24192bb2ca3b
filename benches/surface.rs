//! First surface and refinement of an open and of a folded sketch, from exact maps, one thread.
//!
//! `cargo bench --bench surface`; the aim is 25 ms for both together.

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;
use sketch2pq::control::Control;
use sketch2pq::datagen::{MAP, Options, Sample, sample};
use sketch2pq::sketch::{CANVAS_HALF_WIDTH, Layer, StrokeKind, horizontal_slope};
use sketch2pq::surface::{
    BorderCurves, BorderLoop, LayerMap, LayerMaps, NurbsSurface, RefineOptions, SurfaceTargets, refine, unfolded_net,
};

/// What perfect networks would say of a layer.
fn layer_map(truth: &Sample, layer: usize) -> LayerMap {
    const PIXELS: usize = MAP * MAP;
    let slope = horizontal_slope(&truth.patch.view);
    let mut map = LayerMap::empty(MAP, CANVAS_HALF_WIDTH);
    for k in (0..PIXELS).filter(|k| truth.maps.valid[layer * PIXELS + k] > 0) {
        map.valid[k] = true;
        map.front[k] = truth.maps.valid[layer * PIXELS + k] == 1;
        map.depth[k] = f64::from(truth.maps.depth[layer * PIXELS + k]) + slope * map.center(k)[1];
        let normal = |axis: usize| f64::from(truth.maps.normal[(layer * 3 + axis) * PIXELS + k]);
        map.normal[k] = Vector3::new(normal(0), normal(1), normal(2));
    }
    map
}

fn targets(truth: &Sample) -> SurfaceTargets {
    let border = &truth.patch.border;
    let flags = border.iter().map(|b| b.layer == Layer::Occluded).collect();
    let border = BorderLoop::new(border.iter().map(|b| b.position).collect(), flags).expect("a border");
    let corners = border.choose_corners().expect("corners");
    let strokes = truth.patch.strokes.iter().filter(|s| s.kind == StrokeKind::Contour);
    let contours = strokes.map(|s| s.points.clone()).collect();
    let maps = LayerMaps { visible: layer_map(truth, 0), occluded: layer_map(truth, 1) };
    SurfaceTargets { border, corners, contours, samples: vec![], maps }
}

fn surfaces(criterion: &mut Criterion) {
    for (name, wanted) in [("open", false), ("folded", true)] {
        let mut samples = (0..200).filter_map(|seed| sample(seed, &Options::default()).ok());
        let truth = samples.find(|truth| truth.occluded == wanted && !truth.noisy).expect("such a sample");
        let targets = targets(&truth);
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).expect("curves");
        let first = || {
            let net = unfolded_net(&targets.border, &curves, &targets.contours, &targets.maps).expect("a net");
            NurbsSurface::new(curves.knots.clone(), net, None).expect("a surface")
        };
        let start = first();
        let refined =
            || refine(&start, &targets, &RefineOptions::default(), &Control::default()).expect("a refined surface");
        let mut group = criterion.benchmark_group(name);
        group.sample_size(20);
        group.bench_function("unfold", |bench| bench.iter(first));
        group.bench_function("refine", |bench| bench.iter(refined));
        group.finish();
    }
}

criterion_group!(benches, surfaces);
criterion_main!(benches);
