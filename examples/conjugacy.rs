//! How conjugate fields are, over held-out surfaces: `cargo run --release --example conjugacy -- [COUNT] [FIRST]`.
//!
//! Fields along the feature lines of held-out sketches, on the exact surfaces. The residual |II(u, v)| / (|II| |u| |v|) is that of the surface itself, at
//! the triangles' middles. Flat triangles count for nothing, nor do places where the crossing floor won; both are counted.

use sketch2pq::Error;
use sketch2pq::datagen::Options;
use sketch2pq::evaluate::Split;
use sketch2pq::field::ConjugateField;
use sketch2pq::pipeline::{FieldOptions, Placement, Session, SessionOptions, SurfaceResult, sketch_to_cdf};
use sketch2pq::surface::{FundamentalForms, NurbsSurface};

fn main() -> Result<(), Error> {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let (count, first) = (numbers.first().copied().unwrap_or(100), numbers.get(1).copied().unwrap_or(0));
    let mut session = Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() })?;
    println!("| seed | mean | largest | flat, % | floor, % | smallest crossing, deg |");
    println!("|{}", " --- |".repeat(6));
    let mut rows: Vec<[f64; 5]> = vec![];
    for index in first..first + count {
        let Ok(truth) = Split::Surfaces.sample(index, &Options::default()) else { continue };
        let placement = Placement::of_sketch(&truth.sketch.view, &truth.patch.frame, 0.0);
        let surface = SurfaceResult::from_nurbs(vec![truth.surface.mapped(|p| placement.to_world(p))])?;
        let options = FieldOptions { use_network: false, ..FieldOptions::default() };
        let result = sketch_to_cdf(&mut session, Some(&truth.sketch), &surface, &options)?;
        let patch = &result.patches[0];
        let [mean, largest] = residuals(&patch.field, &patch.surface);
        let share = |list: &[u32]| 100.0 * list.len() as f64 / patch.field.directions.len() as f64;
        let d = &patch.field.diagnostics;
        let row = [mean, largest, share(&d.flat_triangles), share(&d.floor_triangles), d.crossing_min_deg];
        print_row(&truth.seed.to_string(), &row);
        rows.push(row);
    }
    let column = |k: usize| rows.iter().map(move |row| row[k]);
    let mean = |k: usize| column(k).sum::<f64>() / rows.len() as f64;
    print_row(&format!("mean of {}", rows.len()), &[0, 1, 2, 3, 4].map(mean));
    let largest = |k: usize| column(k).fold(0.0, f64::max);
    let smallest = column(4).fold(f64::INFINITY, f64::min);
    let mut worst = [0, 1, 2, 3, 4].map(largest);
    worst[4] = smallest;
    print_row("worst", &worst);
    Ok(())
}

fn print_row(name: &str, [mean, largest, flat, floor, crossing]: &[f64; 5]) {
    println!("| {name} | {mean:.0e} | {largest:.0e} | {flat:.1} | {floor:.2} | {crossing:.1} |");
}

/// Mean by area, and largest.
fn residuals(field: &ConjugateField, surface: &NurbsSurface) -> [f64; 2] {
    let mesh = &field.mesh;
    let left_out = [&field.diagnostics.flat_triangles, &field.diagnostics.floor_triangles];
    let (mut sum, mut largest, mut area) = (0.0, 0.0f64, 0.0);
    for t in (0..mesh.triangles.len()).filter(|&t| left_out.iter().all(|list| list.binary_search(&(t as u32)).is_err()))
    {
        let corners = mesh.triangles[t].map(|v| mesh.parameters[v as usize]);
        let [a, b] = [0, 1].map(|k| corners.iter().map(|p| p[k]).sum::<f64>() / 3.0);
        let point = surface.evaluate(a, b);
        let Some(forms) = FundamentalForms::new(&point) else { continue };
        let x = point.du.normalize();
        let norm = forms.second_in(&point, &x, &forms.normal.cross(&x)).norm();
        let [u, v] = field.directions[t].map(|d| (d - forms.normal * forms.normal.dot(&d)).normalize());
        let residual = forms.second_in(&point, &u, &v)[(0, 1)].abs() / norm;
        let own = mesh.triangle_normal_area(t).1;
        (sum, area) = (sum + residual * own, area + own);
        largest = largest.max(residual);
    }
    [sum / area, largest]
}
