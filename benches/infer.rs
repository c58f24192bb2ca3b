//! The four networks on each backend that is there: loading, and one run each, with one thread and with two.
//!
//! `cargo bench --bench infer`; `SKETCH2PQ_ORT_PATH` names an ONNX Runtime that the search does not find.

use criterion::{Criterion, criterion_group, criterion_main};
use sketch2pq::infer::{Backend, BackendChoice, BackendOptions, Models, Network, Networks};
use std::time::Duration;

fn networks(criterion: &mut Criterion) {
    let models = Models::embedded().expect("the embedded networks are described by their manifest");
    for choice in [BackendChoice::Ort, BackendChoice::Embedded] {
        for threads in [1, 2] {
            let options = BackendOptions { choice, runtime_path: None, threads };
            let backend = match Backend::open(&options) {
                Ok(backend) => backend,
                Err(error) => {
                    eprintln!("{error}");
                    continue;
                }
            };
            let mut group = criterion.benchmark_group(format!("{}/{threads} threads", backend.info()));
            group.sample_size(20).measurement_time(Duration::from_secs(2));
            group.bench_function("load all", |bench| bench.iter(|| Networks::load(&models, &options).map(drop)));
            for network in Network::ALL {
                let mut engine = models.load(network, &backend).expect("the embedded networks load");
                let length = engine.input_shape().iter().product::<usize>();
                let input: Vec<f32> = (0..length).map(|i| (i as f32 * 0.37).sin()).collect();
                group.bench_function(network.name(), |bench| bench.iter(|| engine.run(&input)));
            }
            group.finish();
        }
    }
}

criterion_group!(benches, networks);
criterion_main!(benches);
