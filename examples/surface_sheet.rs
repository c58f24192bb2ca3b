//! Surfaces of held-out sketches under their strokes: `cargo run --release --example surface_sheet -- FILE.png [COUNT] [FIRST]`.
//!
//! Each tile shows the surface along the sketch's view with the strokes over it; a second one below shows its parameter lines. Prints a row of
//! measures for each, in the order of the tiles, and how many miss the bars. `--rotations` takes unseen views of known surfaces, `--every N` each
//! N-th, `--only 24,119` these numbers of the split, `--tile 900` makes tiles so wide, `--start` shows the surfaces before Gauss-Newton, `--write DIR`
//! writes each sketch and surface as JSON; with `-` for the file nothing is drawn.

use sketch2pq::datagen::{Options, Sample};
use sketch2pq::evaluate::{Split, surface_scores};
use sketch2pq::mesh::PanelMesh;
use sketch2pq::picture::{Frame, MeshPart, Picture, mesh_picture, overlay_sketch, surface_picture};
use sketch2pq::pipeline::{Session, SessionOptions, SurfaceOptions, sketch_to_surface};
use sketch2pq::sketch::write_json;
use sketch2pq::surface::{NurbsSurface, SurfaceMesh};

const COLUMNS: usize = 5;
/// Width of a tile, pixels, unless told otherwise.
const TILE_WIDTH: usize = 400;
/// Cells along each side of a surface in its picture.
const CELLS: usize = 80;
/// Parameter lines in each direction.
const LINES: usize = 40;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let rotations = arguments.iter().any(|a| a == "--rotations");
    let start = arguments.iter().any(|a| a == "--start");
    arguments.retain(|a| a != "--rotations" && a != "--start");
    let mut valued = |name: &str| {
        let at = arguments.iter().position(|a| a == name)?;
        arguments.remove(at);
        (at < arguments.len()).then(|| arguments.remove(at))
    };
    let (only, every, tile, folder) = (valued("--only"), valued("--every"), valued("--tile"), valued("--write"));
    let file = arguments.first().ok_or("a file for the sheet, please")?;
    let number = |k: usize, or: u64| arguments.get(k).map_or(Ok(or), |a| a.parse::<u64>());
    let (count, first) = (number(1, 20)?, number(2, 0)?);
    let width = tile.map_or(Ok(TILE_WIDTH), |a| a.parse::<usize>())?;
    let tile = [width, width * 17 / 20];
    let mut options = SurfaceOptions::default();
    if start {
        options.refine.iterations = 0;
    }
    let every = every.map_or(Ok(1), |a| a.parse::<u64>())?;
    let indices: Vec<u64> = match only {
        Some(list) => list.split(',').map(str::parse).collect::<Result<_, _>>()?,
        None => (0..count).map(|k| first + every * k).collect(),
    };
    let split = if rotations { Split::Rotations } else { Split::Surfaces };
    let mut session = Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() })?;
    let drawn = file != "-";
    let rows = if drawn { indices.len().div_ceil(COLUMNS) } else { 0 };
    let mut sheet = Picture::new(COLUMNS * tile[0], 2 * rows * tile[1]);
    println!(
        "| seed | family | samples | strokes, mean px | largest px | folds | misfacing | D_c | D_n | refine, ms |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let (mut taken, mut missing, mut folding, mut times) = (0, 0, 0, vec![]);
    for index in indices {
        let Ok(truth) = split.sample(index, &Options::default()) else { continue };
        let result = sketch_to_surface(&mut session, &truth.sketch, &options)?;
        let patch = &result.patches[0];
        let d = &patch.diagnostics;
        let (frame, view) = (truth.patch.frame, truth.sketch.view);
        let canonical = patch.surface.mapped(|p| frame.point_from_camera(&view.world_to_camera(p)));
        let (_, [distance, angle]) = surface_scores(&canonical, &truth);
        println!(
            "| {} | {} | {} | {:.2} | {:.1} | {} | {:.4} | {distance:.3} | {angle:.1} | {:.0} |",
            truth.seed,
            truth.family.name(),
            truth.sketch.depth_samples.len(),
            d.reprojection_mean_px,
            d.reprojection_max_px,
            d.fold_overs,
            d.misfacing,
            result.report.time_ms.refine
        );
        missing += usize::from(d.reprojection_mean_px > 0.5);
        folding += usize::from(d.fold_overs > 0);
        times.push(result.report.time_ms.refine);
        if let Some(folder) = &folder {
            let path = |name: &str| std::path::Path::new(folder).join(format!("{}_{name}.json", truth.seed));
            std::fs::write(path("sketch"), write_json(&truth.sketch)?)?;
            std::fs::write(path("surface"), result.to_json())?;
        }
        if drawn {
            let (column, row) = (taken % COLUMNS * tile[0], 2 * (taken / COLUMNS) * tile[1]);
            let [shaded, lines] = pictures(&patch.surface, &truth, tile)?;
            sheet.paste(&shaded, column, row);
            sheet.paste(&lines, column, row + tile[1]);
        }
        taken += 1;
    }
    times.sort_by(f64::total_cmp);
    let median = times.get(times.len() / 2).copied().unwrap_or(0.0);
    println!(
        "\n{taken} sketches: {missing} miss their strokes by more than 0.5 px, {folding} fold over; refine {median:.0} ms"
    );
    if drawn {
        std::fs::write(file, sheet.to_png()?)?;
    }
    Ok(())
}

/// The surface under its strokes, and its parameter lines under them.
fn pictures(
    surface: &NurbsSurface,
    truth: &Sample,
    tile: [usize; 2],
) -> Result<[Picture; 2], Box<dyn std::error::Error>> {
    let view = truth.sketch.view;
    let strokes = truth.sketch.strokes.iter().flat_map(|s| &s.points).map(|p| view.canvas_to_camera(*p));
    let frame = Frame::fitting(strokes, tile, 16.0);
    let mut shaded = surface_picture(&[&SurfaceMesh::new(surface, [CELLS; 2])?], &view, &frame);
    let cells = (0..LINES * LINES).map(|k| (k / LINES * (LINES + 1) + k % LINES) as u32);
    let quads = cells.flat_map(|k| [k, k + LINES as u32 + 1, k + LINES as u32 + 2, k + 1]).collect();
    let vertices = (0..(LINES + 1) * (LINES + 1)).map(|k| {
        let [u, v] =
            surface.at_fraction((k / (LINES + 1)) as f64 / LINES as f64, (k % (LINES + 1)) as f64 / LINES as f64);
        surface.point(u, v)
    });
    let starts = (0..=LINES * LINES).map(|k| 4 * k as u32).collect();
    let mesh = PanelMesh { vertices: vertices.collect(), starts, indices: quads };
    let part = MeshPart { mesh: &mesh, planarity: &vec![0.0; LINES * LINES], irregular: &[] };
    let mut lines = mesh_picture(&[part], &view, &frame);
    overlay_sketch(&mut shaded, &truth.sketch, &frame);
    overlay_sketch(&mut lines, &truth.sketch, &frame);
    Ok([shaded, lines])
}
