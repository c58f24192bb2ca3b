//! First surface and refinement of an open and of a folded sketch, from exact maps, one thread.
//!
//! `cargo bench --bench surface`; the aim is 25 ms for both together.

use criterion::{Criterion, criterion_group, criterion_main};
use sketch2pq::control::Control;
use sketch2pq::datagen::{Options, sample};
use sketch2pq::surface::{BorderCurves, RefineOptions, refine, unfolded_surface};

fn surfaces(criterion: &mut Criterion) {
    for (name, wanted) in [("open", false), ("folded", true)] {
        let mut samples = (0..200).filter_map(|seed| sample(seed, &Options::default()).ok());
        let truth = samples.find(|truth| truth.occluded == wanted && !truth.noisy).expect("such a sample");
        let targets = truth.surface_targets().expect("targets");
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).expect("curves");
        let first = || unfolded_surface(&targets, &curves, 1.0).expect("a surface");
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
