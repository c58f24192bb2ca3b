//! Time of the mesh stage over the number of faces, and the exponent: `cargo run --release --example panel_scale -- 500 5000 50000`.
//!
//! With `--chart FILE` among the arguments the times are drawn there, as SVG; with `--obj DIR` whole quads before planarization are written there
//! for `benches/peers`.

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
fn measure(field: &ConjugateField, surface: &NurbsSurface, faces: usize) -> Result<[f64; 2], Error> {
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
    Ok([extraction, planarization])
}

/// Slope of the least-squares line through (ln faces, ln milliseconds); `None` for less than two sizes.
fn exponent(times: &[(usize, f64)]) -> Option<f64> {
    let points: Vec<[f64; 2]> = times.iter().map(|&(faces, ms)| [(faces as f64).ln(), ms.ln()]).collect();
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64;
    let [x, y] = [mean(0), mean(1)];
    let [xx, xy] = [0, 1].map(|k| points.iter().map(|p| (p[0] - x) * (p[k] - [x, y][k])).sum::<f64>());
    (xx > 0.0).then(|| xy / xx)
}

/// A chart of both stages over the number of faces, both axes logarithmic.
fn chart(sizes: &[usize], times: &[[f64; 2]]) -> String {
    let decades = |low: f64, high: f64| (low.log10().floor() as i32, high.log10().ceil() as i32);
    let all: Vec<f64> = times.iter().flatten().copied().collect();
    let fold = |values: &[f64]| {
        (values.iter().copied().fold(f64::INFINITY, f64::min), values.iter().copied().fold(0.0, f64::max))
    };
    let faces: Vec<f64> = sizes.iter().map(|&n| n as f64).collect();
    let ((low_x, high_x), (low_y, high_y)) = (fold(&faces), fold(&all));
    let (x_range, y_range) = (decades(low_x, high_x), decades(low_y, high_y));
    let place = |value: f64, range: (i32, i32), from: f64, to: f64| {
        from + (to - from) * (value.log10() - f64::from(range.0)) / f64::from(range.1 - range.0)
    };
    let x = |value: f64| place(value, x_range, 70.0, 610.0);
    let y = |value: f64| place(value, y_range, 340.0, 20.0);
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 640 400\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"640\" height=\"400\" fill=\"white\"/>\n",
    );
    let mut line = |text: String| {
        svg.push_str(&text);
        svg.push('\n');
    };
    for k in x_range.0..=x_range.1 {
        let at = x(10f64.powi(k));
        line(format!("<path d=\"M{at:.1} 20V340\" stroke=\"#ddd\"/>"));
        line(format!("<text x=\"{at:.1}\" y=\"358\" text-anchor=\"middle\">{}</text>", 10f64.powi(k)));
    }
    for k in y_range.0..=y_range.1 {
        let at = y(10f64.powi(k));
        line(format!("<path d=\"M70 {at:.1}H610\" stroke=\"#ddd\"/>"));
        line(format!("<text x=\"62\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", at + 4.0, 10f64.powi(k)));
    }
    line("<text x=\"340\" y=\"385\" text-anchor=\"middle\">faces</text><text x=\"14\" y=\"14\">ms</text>".into());
    for (stage, (name, color)) in [("map and extraction", "#2b6cb0"), ("planarization", "#c05621")].iter().enumerate() {
        let points: Vec<(usize, f64)> = sizes.iter().zip(times).map(|(&n, ms)| (n, ms[stage])).collect();
        let path: Vec<String> = points.iter().map(|&(n, ms)| format!("{:.1},{:.1}", x(n as f64), y(ms))).collect();
        line(format!("<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>", path.join(" ")));
        for &(n, ms) in &points {
            line(format!("<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{color}\"/>", x(n as f64), y(ms)));
        }
        let label = exponent(&points).map_or(name.to_string(), |e| format!("{name}: exponent {e:.2}"));
        line(format!("<text x=\"90\" y=\"{}\" fill=\"{color}\">{label}</text>", 44 + 20 * stage));
    }
    line("</svg>".into());
    svg
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let surface = waves::waves();
    let mesh = SurfaceMesh::new(&surface, [48; 2])?;
    let field = conjugate_field(mesh, None, &[], &FieldOptions::default(), &Control::default())?;
    let named = |name: &str| arguments.iter().position(|a| a == name).and_then(|k| arguments.get(k + 1));
    let sizes: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    let sizes = if sizes.is_empty() { vec![500, 5000] } else { sizes };
    println!("| faces | map and extraction, ms | planarization, ms | rounds | P_max | deviation over its limit |");
    println!("| --- | --- | --- | --- | --- | --- |");
    let mut times = vec![];
    for &faces in &sizes {
        times.push(measure(&field, &surface, faces)?);
        if let Some(folder) = named("--obj") {
            let options = ExtractOptions { border: BorderMode::Interior, ..ExtractOptions::default() };
            let target = PanelTarget::Faces(faces);
            let whole = panels(&field, &surface, target, &MapOptions::default(), &options, &Control::default())?;
            std::fs::write(format!("{folder}/waves_{faces}.obj"), write_obj(&[&whole.mesh]))?;
        }
    }
    if let Some(file) = named("--chart") {
        std::fs::write(file, chart(&sizes, &times))?;
    }
    let whole: Vec<(usize, f64)> = sizes.iter().zip(&times).map(|(&n, ms)| (n, ms[0] + ms[1])).collect();
    if let Some(exponent) = exponent(&whole) {
        println!("\nexponent {exponent:.2} over {} sizes", sizes.len());
    }
    Ok(())
}
