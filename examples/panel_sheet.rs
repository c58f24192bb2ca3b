//! Meshes of held-out sketches on one sheet, borders bold, irregular vertices as dots: `cargo run --release --example panel_sheet -- FILE.png [COUNT] [FIRST]`.
//!
//! Prints a row of measures for each, in the order of the tiles. With `--truth` the panels lie on the surfaces that the sketches were made from, so
//! that they are judged apart from the networks; the field follows the feature lines all the same.

use sheet::{STRIDE, Sheet};
use sketch2pq::datagen::Options;
use sketch2pq::evaluate::Split;
use sketch2pq::picture::{Frame, MeshPart, Picture, mesh_picture};
use sketch2pq::pipeline::{
    FieldOptions, MeshOptions, Session, SessionOptions, SurfaceOptions, SurfaceResult, extract_pq_mesh, sketch_to_cdf,
    sketch_to_surface,
};

#[path = "shared/sheet.rs"]
mod sheet;

const COLUMNS: usize = 6;
const TILE: [usize; 2] = [330, 280];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Sheet { file, count, first, on_truth } = Sheet::from_arguments()?;
    let mut session = Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() })?;
    let rows = (count as usize).div_ceil(COLUMNS);
    let mut sheet = Picture::new(COLUMNS * TILE[0], rows * TILE[1]);
    println!(
        "| seed | family | faces | P_max | deviation, edges | border covered | D_f | irregular | split | planarization, ms |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for k in 0..count {
        let Ok(truth) = Split::Surfaces.sample(first + STRIDE * k, &Options::default()) else { continue };
        let view = truth.sketch.view;
        let surface = if on_truth {
            let place = |p: &nalgebra::Point3<f64>| view.camera_to_world(&truth.patch.frame.point_to_camera(p));
            SurfaceResult::from_nurbs(vec![truth.surface.mapped(place)])?
        } else {
            sketch_to_surface(&mut session, &truth.sketch, &SurfaceOptions::default())?
        };
        let field = sketch_to_cdf(&mut session, Some(&truth.sketch), &surface, &FieldOptions::default())?;
        let mesh = extract_pq_mesh(&mut session, &field, &MeshOptions::default())?;
        let all = mesh.measures();
        println!(
            "| {} | {} | {} | {:.0e} | {:.3} | {:.4} | {} | {} | {} | {:.0} |",
            truth.seed,
            truth.family.name(),
            all.faces,
            all.planarity_max,
            all.deviation_max_edges,
            all.border_covered.unwrap_or(0.0),
            all.feature_angle_deg.map_or(String::new(), |angle| format!("{angle:.1}")),
            all.irregular_vertices,
            all.split + all.split_inside,
            mesh.report.time_ms.planarize
        );
        let parts: Vec<MeshPart> = (mesh.patches.iter())
            .map(|p| MeshPart { mesh: &p.mesh, planarity: &p.planarity, irregular: &p.irregular })
            .collect();
        let places = mesh.patches.iter().flat_map(|p| &p.mesh.vertices).map(|p| view.world_to_camera(p));
        let frame = Frame::fitting(places.map(|p| [p.x, p.y]), TILE, 14.0);
        let k = k as usize;
        sheet.paste(&mesh_picture(&parts, &view, &frame), k % COLUMNS * TILE[0], k / COLUMNS * TILE[1]);
    }
    std::fs::write(file, sheet.to_png()?)?;
    Ok(())
}
