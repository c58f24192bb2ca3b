//! Where feature lines lose their angle, stage by stage: `cargo run --release --example feature_lines -- 60`, or with the names of sketches,
//! `-- examples/sketches/*.json`.
//!
//! For held-out sketches, on the predicted surfaces and, with `--true`, on the exact ones, or for the named ones: the mean angle between the drawn lines and the nearer
//! family of the field, of its layout, of the map's isolines, of the panels before planarization and of those after it.

use nalgebra::{Point3, Vector3};
use sketch2pq::Error;
use sketch2pq::control::Control;
use sketch2pq::datagen::{Options, Sample};
use sketch2pq::evaluate::Split;
use sketch2pq::field::{ConjugateField, Density, MapOptions, SeamlessMap, integrate};
use sketch2pq::mesh::{ExtractOptions, PanelMesh, PanelTarget, panels};
use sketch2pq::pipeline::{
    FieldOptions, FieldPatch, MeshOptions, Placement, Session, SessionOptions, SurfaceOptions, SurfaceResult,
    extract_pq_mesh, sketch_to_cdf, sketch_to_surface,
};
use sketch2pq::sketch::{Sketch, read_sketch};
use std::path::Path;
use std::time::Instant;

/// The stages in the order of the columns.
const STAGES: [&str; 8] = ["field", "layout", "map", "panels", "in plane", "planar", "in plane", "D_f"];

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let exact = arguments.iter().any(|a| a == "--true");
    let numbers: Vec<u64> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    let (count, first) = (numbers.first().copied().unwrap_or(20), numbers.get(1).copied().unwrap_or(0));
    let mut session = Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() })?;
    println!("| seed | {} | irregular | deviation | P_max | field, ms | mesh, ms |", STAGES.join(" | "));
    println!("|{}", " --- |".repeat(STAGES.len() + 6));
    let mut rows: Vec<Vec<f64>> = vec![];
    let files: Vec<&String> = arguments.iter().filter(|a| a.ends_with(".json")).collect();
    for file in &files {
        let path = Path::new(file);
        let Some(row) = measure(&mut session, &read_sketch(path)?, None)? else { continue };
        print_row(&path.file_stem().unwrap_or_default().to_string_lossy(), &row);
        rows.push(row);
    }
    for index in (first..first + count).take_while(|_| files.is_empty()) {
        let Ok(truth) = Split::Surfaces.sample(index, &Options::default()) else { continue };
        let surface = exact.then(|| true_surface(&truth)).transpose()?;
        let Some(row) = measure(&mut session, &truth.sketch, surface)? else { continue };
        print_row(&truth.seed.to_string(), &row);
        rows.push(row);
    }
    let columns = rows.first().map_or(0, Vec::len);
    let mean: Vec<f64> = (0..columns).map(|k| rows.iter().map(|row| row[k]).sum::<f64>() / rows.len() as f64).collect();
    print_row(&format!("mean of {}", rows.len()), &mean);
    Ok(())
}

fn print_row(name: &str, row: &[f64]) {
    let cells: Vec<String> =
        row.iter().map(|x| if x.abs() < 0.01 { format!("{x:.0e}") } else { format!("{x:.2}") }).collect();
    println!("| {name} | {} |", cells.join(" | "));
}

/// The surface that a sketch was drawn from.
fn true_surface(truth: &Sample) -> Result<SurfaceResult, Error> {
    let placement = Placement::of_sketch(&truth.sketch.view, &truth.patch.frame, 0.0);
    SurfaceResult::from_nurbs(vec![truth.surface.mapped(|p| placement.to_world(p))])
}

/// The angles of one sketch on a surface, or on the predicted one, then what they cost; `None` without feature lines.
fn measure(session: &mut Session, sketch: &Sketch, surface: Option<SurfaceResult>) -> Result<Option<Vec<f64>>, Error> {
    let surface = match surface {
        Some(surface) => surface,
        None => sketch_to_surface(session, sketch, &SurfaceOptions::default())?,
    };
    let field = sketch_to_cdf(session, Some(sketch), &surface, &FieldOptions::default())?;
    let start = Instant::now();
    let mesh = extract_pq_mesh(session, &field, &MeshOptions::default())?;
    let mesh_ms = start.elapsed().as_secs_f64() * 1e3;
    let Some(planar) = mesh.report.d_f_deg else { return Ok(None) };
    let mut sums = [[0.0; 3]; 2];
    let mut mesh_sums = [[0.0; 4]; 2];
    for (patch, planar) in field.patches.iter().zip(&mesh.patches) {
        let rough = panels(
            &patch.field,
            &patch.surface,
            PanelTarget::Faces(500),
            &MapOptions::default(),
            &ExtractOptions::default(),
            &Control::default(),
        )?;
        let mut working = planar.mesh.clone();
        working.vertices.iter_mut().for_each(|p| *p = patch.placement.from_world(p));
        for (k, mesh) in [&rough.mesh, &working].into_iter().enumerate() {
            let [angle, in_plane, length] = mesh_angles(&patch.feature_lines, mesh);
            mesh_sums[0][2 * k] += angle;
            mesh_sums[0][2 * k + 1] += in_plane;
            mesh_sums[1][2 * k] += length;
            mesh_sums[1][2 * k + 1] += length;
        }
        let map = map_of(patch)?;
        for line in &patch.field.lines {
            let t = line.triangle as usize;
            let weight = if line.weight.is_finite() { line.weight } else { 1.0 };
            let families = [patch.field.directions[t], patch.field.layout[t], isolines(&patch.field, &map, t)];
            for (k, families) in families.iter().enumerate() {
                sums[0][k] += weight * angle_deg(&line.direction, families);
                sums[1][k] += weight;
            }
        }
    }
    let mut row: Vec<f64> = (0..3).map(|k| sums[0][k] / sums[1][k]).collect();
    let report = &mesh.report;
    row.extend((0..4).map(|k| mesh_sums[0][k] / mesh_sums[1][k]));
    row.push(planar);
    row.push(report.irregular_vertices.unwrap_or(0) as f64);
    row.extend([report.deviation_max_edges, report.p_max].map(|x| x.unwrap_or(f64::NAN)));
    row.extend([field.report.time_ms.field, mesh_ms]);
    Ok(Some(row))
}

/// Length times angle of the lines to the nearer family of the nearest quad, taken as a bilinear patch: in space, and within the quad's plane; and
/// the length.
fn mesh_angles(lines: &[Vec<Point3<f64>>], mesh: &PanelMesh) -> [f64; 3] {
    let quads: Vec<[Vector3<f64>; 4]> = mesh
        .faces()
        .filter(|face| face.len() == 4)
        .map(|face| [0, 1, 2, 3].map(|k| mesh.vertices[face[k] as usize].coords))
        .collect();
    let mut sums = [0.0; 3];
    for ends in lines.iter().flat_map(|line| line.windows(2)) {
        let (along, middle) = (ends[1] - ends[0], nalgebra::center(&ends[0], &ends[1]).coords);
        let closest = quads.iter().map(|quad| closest(quad, &middle)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, families)) = closest else { break };
        let length = along.norm();
        let normal = families[0].cross(&families[1]).normalize();
        sums[0] += length * angle_deg(&along, &families);
        sums[1] += length * angle_deg(&(along - normal * normal.dot(&along)), &families);
        sums[2] += length;
    }
    sums
}

/// Distance from a point to a bilinear patch, and its families at the closest point.
fn closest(&[a, b, c, d]: &[Vector3<f64>; 4], query: &Vector3<f64>) -> (f64, [Vector3<f64>; 2]) {
    let families = |[s, t]: [f64; 2]| [(b - a) * (1.0 - t) + (c - d) * t, (d - a) * (1.0 - s) + (c - b) * s];
    let apart = |[s, t]: [f64; 2]| query - ((a * (1.0 - s) + b * s) * (1.0 - t) + (d * (1.0 - s) + c * s) * t);
    let mut at = [0.5; 2];
    for round in 0..24 {
        let family = families(at)[round % 2];
        at[round % 2] = (at[round % 2] + apart(at).dot(&family) / family.norm_squared()).clamp(0.0, 1.0);
    }
    (apart(at).norm(), families(at))
}

fn map_of(patch: &FieldPatch) -> Result<SeamlessMap, Error> {
    let options = MapOptions { density: Density::CellCount(450.0), ..MapOptions::default() };
    integrate(&patch.field, &options, &Control::default())
}

/// Directions of the isolines of both coordinates on a triangle.
fn isolines(field: &ConjugateField, map: &SeamlessMap, t: usize) -> [Vector3<f64>; 2] {
    let [a, b, c] = field.mesh.triangles[t].map(|v| field.mesh.position(v));
    let corners = map.corners[t];
    [0, 1].map(|k| {
        let [from, e, f] = corners.map(|z| z[k]);
        ((b - a) * (f - from) as f64 - (c - a) * (e - from) as f64).normalize()
    })
}

/// Angle between a line and the nearer of two families, degrees.
fn angle_deg(line: &Vector3<f64>, families: &[Vector3<f64>; 2]) -> f64 {
    let angle = |d: &Vector3<f64>| line.cross(d).norm().atan2(line.dot(d).abs()).to_degrees();
    families.iter().map(angle).fold(90.0, f64::min)
}
