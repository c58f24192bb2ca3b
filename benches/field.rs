//! From a surface to a field at the default resolution, with and without feature lines, and the seamless map for 500, 5,000 and 50,000 cells.
//!
//! `cargo bench --bench field`; one thread.

use criterion::{Criterion, criterion_group, criterion_main};
use sketch2pq::control::Control;
use sketch2pq::field::{
    ConjugateField, Density, FieldOptions, MapOptions, conjugate_field, constraints_from_parameters, integrate,
};
use sketch2pq::surface::SurfaceMesh;
use std::hint::black_box;
use std::time::Duration;

#[path = "../examples/shared/waves.rs"]
mod waves;

/// Weights as `sketch_to_cdf` gives them.
const LINE_WEIGHT: f64 = 300.0;
const PARALLEL_WEIGHT: f64 = 6400.0;

fn solve(mesh: &SurfaceMesh, lines: &[Vec<[f64; 2]>]) -> ConjugateField {
    let constraints = constraints_from_parameters(mesh, lines, LINE_WEIGHT).expect("finite lines");
    let options = FieldOptions { parallel_weight: PARALLEL_WEIGHT, ..FieldOptions::default() };
    conjugate_field(mesh.clone(), None, &constraints, &options, &Control::default()).expect("waves have a field")
}

fn stages(criterion: &mut Criterion) {
    let mesh = SurfaceMesh::new(&waves::waves(), [40; 2]).expect("waves have normals");
    // Two lines that cross and one that winds.
    let winding = (0..=20).map(|i| f64::from(i) / 20.0).map(|t| [t, 0.7 + 0.1 * (5.0 * t).sin()]).collect();
    let lines = [vec![[0.1, 0.2], [0.9, 0.4]], vec![[0.3, 0.05], [0.45, 0.95]], winding];
    let mut group = criterion.benchmark_group("field");
    group.sample_size(10).measurement_time(Duration::from_secs(3)).warm_up_time(Duration::from_millis(500));
    group.bench_function("solve", |bencher| bencher.iter(|| solve(black_box(&mesh), &[])));
    group.bench_function("solve/lines", |bencher| bencher.iter(|| solve(black_box(&mesh), &lines)));
    let field = solve(&mesh, &lines);
    for cells in [500, 5_000, 50_000] {
        group.bench_function(format!("map/{cells}"), |bencher| {
            let options = MapOptions { density: Density::CellCount(f64::from(cells)), ..MapOptions::default() };
            bencher.iter(|| integrate(black_box(&field), &options, &Control::default()).expect("waves have a map"));
        });
    }
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
