//! Time of the mesh stage over the number of faces, and the exponent: `cargo run --release --example panel_scale -- 500 5000 50000`.
//!
//! With `--obj DIR` among the arguments, whole quads before planarization are written there for `benches/peers`.

use sketch2pq::Error;
use sketch2pq::control::Control;
use sketch2pq::field::{ConjugateField, FieldOptions, MapOptions, conjugate_field};
use sketch2pq::mesh::{
    BorderMode, ExtractOptions, PanelTarget, PlanarizeInput, PlanarizeOptions, border_vertices, panels, planarize,
    write_obj,
};
use sketch2pq::surface::{NurbsSurface, SurfaceMesh, SurfaceProjector};
use std::time::Instant;

#[path = "shared/waves.rs"]
mod waves;

/// Milliseconds of extraction and of planarization; prints a row of the table.
fn measure(field: &ConjugateField, surface: &NurbsSurface, faces: usize) -> Result<f64, Error> {
    let control = Control::default();
    let start = Instant::now();
    let target = PanelTarget::Faces(faces);
    let extracted = panels(field, surface, target, &MapOptions::default(), &ExtractOptions::default(), &control)?;
    let extraction = start.elapsed().as_secs_f64() * 1e3;
    let start = Instant::now();
    let parameters: Vec<[f64; 2]> = extracted.origins.iter().map(|o| o.parameter).collect();
    let input = PlanarizeInput {
        reference: Some(&SurfaceProjector::new(surface)),
        border: &border_vertices(&extracted.mesh),
        polylines: &extracted.strips(),
        parameters: Some(&parameters),
        ..PlanarizeInput::new(&extracted.mesh)
    };
    let result = planarize(&input, &PlanarizeOptions::default(), &control)?;
    let planarization = start.elapsed().as_secs_f64() * 1e3;
    println!(
        "| {} | {extraction:.0} | {planarization:.0} | {} | {:.1e} | {:.2} |",
        result.mesh.face_count(),
        result.rounds,
        result.planarity_max(),
        result.deviation_max() / result.deviation_limit
    );
    Ok(extraction + planarization)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let surface = waves::waves();
    let mesh = SurfaceMesh::new(&surface, [48; 2])?;
    let field = conjugate_field(mesh, None, &[], &FieldOptions::default(), &Control::default())?;
    let folder = arguments.iter().position(|a| a == "--obj").and_then(|k| arguments.get(k + 1));
    let sizes: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    let sizes = if sizes.is_empty() { vec![500, 5000] } else { sizes };
    println!("| faces | map and extraction, ms | planarization, ms | rounds | P_max | deviation over its limit |");
    println!("| --- | --- | --- | --- | --- | --- |");
    let mut times = vec![];
    for &faces in &sizes {
        times.push(measure(&field, &surface, faces)?);
        if let Some(folder) = folder {
            let options = ExtractOptions { border: BorderMode::Interior, ..ExtractOptions::default() };
            let target = PanelTarget::Faces(faces);
            let whole = panels(&field, &surface, target, &MapOptions::default(), &options, &Control::default())?;
            std::fs::write(format!("{folder}/waves_{faces}.obj"), write_obj(&[&whole.mesh]))?;
        }
    }
    if let [.., before, last] = times[..] {
        let [.., n, m] = sizes[..] else { return Ok(()) };
        println!("\nexponent {:.2} from {n} to {m} faces", (last / before).ln() / (m as f64 / n as f64).ln());
    }
    Ok(())
}
