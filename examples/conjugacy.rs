//! How conjugate fields are, over held-out surfaces: `cargo run --release --example conjugacy -- [COUNT] [FIRST]`.
//!
//! Fields along the feature lines of held-out sketches, on the exact surfaces. The residual |II(u, v)| / (|II| |u| |v|) is measured twice: with the second
//! forms of the triangles that the solver works on, and with those of the surface itself at the triangles' middles, which differ from them by
//! the size of the triangles. Flat triangles count for nothing, and places where the crossing floor won are counted.

use sketch2pq::Error;
use sketch2pq::datagen::Options;
use sketch2pq::evaluate::Split;
use sketch2pq::field::{ConjugateField, TriangleFrames, second_forms};
use sketch2pq::pipeline::{FieldOptions, Placement, Session, SessionOptions, SurfaceResult, sketch_to_cdf};
use sketch2pq::surface::{FundamentalForms, NurbsSurface};

/// Residuals of one field.
#[derive(Default)]
struct Residuals {
    /// Mean by area and largest, on the triangles.
    triangles: [f64; 2],
    /// Mean by area and 99th percentile, on the surface.
    surface: [f64; 2],
    /// Shares of triangles: flat; where the floor won.
    flat: f64,
    floor: f64,
}

fn main() -> Result<(), Error> {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let (count, first) = (numbers.first().copied().unwrap_or(100), numbers.get(1).copied().unwrap_or(0));
    let mut session = Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() })?;
    println!(
        "| seed | mean | largest | on the surface: mean | 99 % below | flat, % | floor, % | smallest crossing, deg |"
    );
    println!("|{}", " --- |".repeat(8));
    let mut rows: Vec<[f64; 7]> = vec![];
    for index in first..first + count {
        let Ok(truth) = Split::Surfaces.sample(index, &Options::default()) else { continue };
        let placement = Placement::of_sketch(&truth.sketch.view, &truth.patch.frame, 0.0);
        let surface = SurfaceResult::from_nurbs(vec![truth.surface.mapped(|p| placement.to_world(p))])?;
        let options = FieldOptions { use_network: false, ..FieldOptions::default() };
        let result = sketch_to_cdf(&mut session, Some(&truth.sketch), &surface, &options)?;
        let patch = &result.patches[0];
        let found = residuals(&patch.field, &patch.surface)?;
        let row = [
            found.triangles[0],
            found.triangles[1],
            found.surface[0],
            found.surface[1],
            100.0 * found.flat,
            100.0 * found.floor,
            result.measures().crossing_min_deg,
        ];
        print_row(&truth.seed.to_string(), &row);
        rows.push(row);
    }
    let column = |k: usize| rows.iter().map(move |row| row[k]);
    let mean = |k: usize| column(k).sum::<f64>() / rows.len() as f64;
    print_row(&format!("mean of {}", rows.len()), &[0, 1, 2, 3, 4, 5, 6].map(mean));
    let largest = |k: usize| column(k).fold(0.0, f64::max);
    let smallest = column(6).fold(f64::INFINITY, f64::min);
    let mut worst = [0, 1, 2, 3, 4, 5, 6].map(largest);
    worst[6] = smallest;
    print_row("worst", &worst);
    Ok(())
}

fn print_row(name: &str, row: &[f64; 7]) {
    let [a, b, c, d, flat, floor, crossing] = row;
    println!("| {name} | {a:.0e} | {b:.0e} | {c:.1e} | {d:.1e} | {flat:.1} | {floor:.2} | {crossing:.1} |");
}

fn residuals(field: &ConjugateField, surface: &NurbsSurface) -> Result<Residuals, Error> {
    let mesh = &field.mesh;
    let frames = TriangleFrames::new(mesh, &field.edges)?;
    let forms = second_forms(mesh, &frames);
    let mut found = Residuals::default();
    let mut area = 0.0;
    let mut on_surface: Vec<(f64, f64)> = vec![];
    let count = mesh.triangles.len() as f64;
    found.flat = field.diagnostics.flat_triangles.len() as f64 / count;
    found.floor = field.diagnostics.floor_triangles.len() as f64 / count;
    for t in 0..mesh.triangles.len() {
        let left_out = [&field.diagnostics.flat_triangles, &field.diagnostics.floor_triangles];
        if left_out.iter().any(|list| list.binary_search(&(t as u32)).is_ok()) {
            continue;
        }
        let [u, v] = field.directions[t];
        let residual = u.dot(&(forms[t].tensor(&frames.x[t], &frames.y[t]) * v)).abs() / forms[t].norm();
        found.triangles[0] += residual * frames.areas[t];
        found.triangles[1] = found.triangles[1].max(residual);
        area += frames.areas[t];
        let corners = mesh.triangles[t].map(|v| mesh.parameters[v as usize]);
        let [a, b] = [0, 1].map(|k| corners.iter().map(|p| p[k]).sum::<f64>() / 3.0);
        let point = surface.evaluate(a, b);
        let Some(exact) = FundamentalForms::new(&point) else { continue };
        let x = point.du.normalize();
        let norm = exact.second_in(&point, &x, &exact.normal.cross(&x)).norm();
        let [u, v] = [u, v].map(|d| (d - exact.normal * exact.normal.dot(&d)).normalize());
        if norm > 0.0 {
            on_surface.push(((exact.second_in(&point, &u, &v)[(0, 1)] / norm).abs(), frames.areas[t]));
        }
    }
    found.triangles[0] /= area;
    found.surface[0] = on_surface.iter().map(|(r, a)| r * a).sum::<f64>() / area;
    on_surface.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.surface[1] = on_surface.get(on_surface.len() * 99 / 100).map_or(0.0, |r| r.0);
    Ok(found)
}
