//! From a field to planar panels: map and extraction, and planarization, at 500 and 5,000 faces.
//!
//! `cargo bench --bench mesh`; `examples/panel_scale.rs` prints one run of each size with the exponent.

use criterion::{Criterion, criterion_group, criterion_main};
use sketch2pq::control::Control;
use sketch2pq::field::{ConjugateField, FieldOptions, MapOptions, conjugate_field};
use sketch2pq::mesh::{
    ExtractOptions, ExtractedMesh, PanelTarget, PlanarizeInput, PlanarizeOptions, border_vertices, panels, planarize,
};
use sketch2pq::surface::{NurbsSurface, SurfaceMesh, SurfaceProjector};
use std::hint::black_box;
use std::time::Duration;

#[path = "../examples/shared/waves.rs"]
mod waves;

fn extract(field: &ConjugateField, surface: &NurbsSurface, faces: usize) -> ExtractedMesh {
    let target = PanelTarget::Faces(faces);
    let (map, options) = (MapOptions::default(), ExtractOptions::default());
    panels(field, surface, target, &map, &options, &Control::default()).expect("waves have panels")
}

fn stages(criterion: &mut Criterion) {
    let surface = waves::waves();
    let tessellation = SurfaceMesh::new(&surface, [48; 2]).expect("waves have normals");
    let field = conjugate_field(tessellation, None, &[], &FieldOptions::default(), &Control::default())
        .expect("waves have a field");
    let mut group = criterion.benchmark_group("mesh");
    group.sample_size(10).measurement_time(Duration::from_secs(3)).warm_up_time(Duration::from_millis(500));
    for faces in [500, 5000] {
        group.bench_function(format!("extract/{faces}"), |bencher| {
            bencher.iter(|| extract(black_box(&field), &surface, faces));
        });
        let extracted = extract(&field, &surface, faces);
        group.bench_function(format!("planarize/{faces}"), |bencher| {
            bencher.iter(|| {
                let parameters: Vec<[f64; 2]> = extracted.origins.iter().map(|o| o.parameter).collect();
                let input = PlanarizeInput {
                    reference: Some(&SurfaceProjector::new(&surface)),
                    border: &border_vertices(&extracted.mesh),
                    polylines: &extracted.strips(),
                    parameters: Some(&parameters),
                    ..PlanarizeInput::new(black_box(&extracted.mesh))
                };
                planarize(&input, &PlanarizeOptions::default(), &Control::default()).expect("waves become planar")
            });
        });
    }
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
