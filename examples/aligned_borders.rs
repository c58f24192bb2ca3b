//! Borders that the field follows: the examples' sketches, then held-out ones, on one sheet: `cargo run --release --example aligned_borders -- FILE.png
//! [COUNT] [FIRST]`.
//!
//! Prints a row of measures for each, in the order of the tiles: `stray` is the farthest that a border vertex is from the surface's border and `chord`
//! the farthest that the surface's border is from the mesh's, in mean edge lengths; `cut` counts the faces that are no quads. With `--truth` held-out
//! panels lie on the surfaces that the sketches were made from.

use nalgebra::Point3;
use sheet::{STRIDE, Sheet};
use sides::sides;
use sketch2pq::Error;
use sketch2pq::datagen::Options;
use sketch2pq::evaluate::Split;
use sketch2pq::mesh::BorderMode;
use sketch2pq::picture::{Frame, MeshPart, Picture, mesh_picture};
use sketch2pq::pipeline::{
    FieldOptions, MeshOptions, MeshResult, Placement, Session, SessionOptions, SurfaceOptions, SurfaceResult,
    extract_pq_mesh, sketch_to_cdf, sketch_to_surface,
};
use sketch2pq::sketch::{Sketch, read_sketch};
use std::collections::BTreeMap;

#[path = "shared/sheet.rs"]
mod sheet;
#[path = "shared/sides.rs"]
mod sides;

const COLUMNS: usize = 5;
const TILE: [usize; 2] = [400, 330];
/// Points on each side of a surface's border.
const SAMPLES: usize = 400;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Sheet { file, count, first, on_truth } = Sheet::from_arguments()?;
    let mut session = Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() })?;
    let mut cases: Vec<(String, Sketch, Option<SurfaceResult>)> = vec![];
    let mut files: Vec<_> =
        std::fs::read_dir("examples/sketches")?.map(|f| Ok(f?.path())).collect::<Result<_, std::io::Error>>()?;
    files.retain(|f| f.extension().is_some_and(|e| e == "json"));
    files.sort();
    for file in files {
        let name = file.file_stem().map_or(String::new(), |name| name.to_string_lossy().into_owned());
        cases.push((name, read_sketch(&file)?, None));
    }
    for k in 0..count {
        let Ok(truth) = Split::Surfaces.sample(first + STRIDE * k, &Options::default()) else { continue };
        let placement = Placement::of_sketch(&truth.sketch.view, &truth.patch.frame, 0.0);
        let exact = SurfaceResult::from_nurbs(vec![truth.surface.mapped(|p| placement.to_world(p))])?;
        let name = format!("{} {}", truth.seed, truth.family.name());
        cases.push((name, truth.sketch, on_truth.then_some(exact)));
    }
    let rows = cases.len().div_ceil(COLUMNS);
    let mut sheet = Picture::new(COLUMNS * TILE[0], rows * TILE[1]);
    println!(
        "| case | faces | cut | P_max | deviation | stray | chord | singular | irregular | valences | split | manifold | ms |"
    );
    println!("|{}", " --- |".repeat(13));
    for (k, (name, sketch, exact)) in cases.iter().enumerate() {
        let mesh = match aligned(&mut session, sketch, exact.as_ref()) {
            Ok((surface, mesh)) => {
                print_row(name, &surface, &mesh);
                mesh
            }
            Err(error) => {
                println!("| {name} | {error} |");
                continue;
            }
        };
        let parts: Vec<MeshPart> = (mesh.patches.iter())
            .map(|p| MeshPart { mesh: &p.mesh, planarity: &p.planarity, irregular: &p.irregular })
            .collect();
        let places = mesh.patches.iter().flat_map(|p| &p.mesh.vertices).map(|p| sketch.view.world_to_camera(p));
        let frame = Frame::fitting(places.map(|p| [p.x, p.y]), TILE, 14.0);
        sheet.paste(&mesh_picture(&parts, &sketch.view, &frame), k % COLUMNS * TILE[0], k / COLUMNS * TILE[1]);
    }
    std::fs::write(file, sheet.to_png()?)?;
    Ok(())
}

fn aligned(
    session: &mut Session,
    sketch: &Sketch,
    exact: Option<&SurfaceResult>,
) -> Result<(SurfaceResult, MeshResult), Error> {
    let surface = match exact {
        Some(surface) => surface.clone(),
        None => sketch_to_surface(session, sketch, &SurfaceOptions::default())?,
    };
    let options = FieldOptions { aligned_sides: [true; 4], ..FieldOptions::default() };
    let field = sketch_to_cdf(session, Some(sketch), &surface, &options)?;
    let options = MeshOptions { border: BorderMode::Aligned, ..MeshOptions::default() };
    let mesh = extract_pq_mesh(session, &field, &options)?;
    Ok((surface, mesh))
}

fn print_row(name: &str, surface: &SurfaceResult, mesh: &MeshResult) {
    let all = mesh.measures();
    let mut valences: BTreeMap<usize, usize> = BTreeMap::new();
    let (mut stray, mut chord, mut manifold) = (0.0f64, 0.0f64, true);
    for (surface, patch) in surface.patches.iter().zip(&mesh.patches) {
        let sides = sides(&patch.mesh);
        manifold &= sides.values().all(|&n| n <= 2);
        for &v in &patch.irregular {
            *valences.entry(sides.keys().filter(|side| side.contains(&v)).count()).or_default() += 1;
        }
        let outline: Vec<[Point3<f64>; 2]> =
            sides.iter().filter(|s| *s.1 == 1).map(|s| s.0.map(|v| patch.mesh.vertices[v as usize])).collect();
        let border: Vec<[Point3<f64>; 2]> =
            (0..4 * SAMPLES).map(|i| [i, i + 1].map(|i| border_point(&surface.surface, i))).collect();
        for ends in &outline {
            stray = stray.max(distance(&border, &ends[0]));
        }
        for ends in border.iter().step_by(4) {
            chord = chord.max(distance(&outline, &ends[0]));
        }
    }
    let edge = all.edge_length_mean;
    println!(
        "| {name} | {} | {} | {:.0e} | {:.3} | {:.4} | {:.3} | {} | {} | {valences:?} | {} | {manifold} | {:.0} |",
        all.faces,
        all.faces - all.quads,
        all.planarity_max,
        all.deviation_max_edges,
        stray / edge,
        chord / edge,
        mesh.report.singularities.unwrap_or(0),
        all.irregular_vertices,
        all.split + all.split_inside,
        mesh.report.time_ms.field + mesh.report.time_ms.mesh + mesh.report.time_ms.planarize,
    );
}

/// Point `i` of the surface's border.
fn border_point(surface: &sketch2pq::surface::NurbsSurface, i: usize) -> Point3<f64> {
    let t = (i % SAMPLES) as f64 / SAMPLES as f64;
    let [s, t] = [[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]][i / SAMPLES % 4];
    let [u, v] = surface.at_fraction(s, t);
    surface.point(u, v)
}

fn distance(segments: &[[Point3<f64>; 2]], p: &Point3<f64>) -> f64 {
    let to = |[a, b]: &[Point3<f64>; 2]| {
        let d = b - a;
        let t = ((p - a).dot(&d) / d.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (p - (a + d * t)).norm()
    };
    segments.iter().map(to).fold(f64::INFINITY, f64::min)
}
