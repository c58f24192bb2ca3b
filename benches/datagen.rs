//! Training samples with all their maps, one thread: 32 seeds of the default mix an iteration.
//!
//! `cargo bench --bench datagen`; the aim is 40 samples a second on two cores.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use sketch2pq::datagen::{Options, sample};
use std::time::Duration;

fn samples(criterion: &mut Criterion) {
    let options = Options::default();
    let mut group = criterion.benchmark_group("datagen");
    group.sample_size(10).measurement_time(Duration::from_secs(10)).throughput(Throughput::Elements(32));
    group.bench_function("32 samples", |bench| {
        bench.iter(|| (0..32).filter(|&seed| sample(seed, &options).is_ok()).count());
    });
    group.finish();
}

criterion_group!(benches, samples);
criterion_main!(benches);
