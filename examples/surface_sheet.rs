//! Surfaces of held-out sketches under their strokes: `cargo run --release --example surface_sheet -- FILE.png [COUNT] [FIRST]`.
//!
//! Each tile shows the surface along the sketch's view with the strokes over it; a second one below shows its parameter lines. Prints a row of
//! measures for each, in the order of the tiles, and how many miss the bars. `--rotations` takes unseen views of known surfaces, `--every N` each
//! N-th, `--only 24,119` these numbers of the split, `--tile 900` makes tiles so wide, `--start` shows the surfaces before Gauss-Newton, `--write DIR`
//! writes each sketch and surface as JSON, `--exact` gives the exact maps and no depth samples instead of the networks; with `-` for the file nothing is drawn.

use sketch2pq::control::Control;
use sketch2pq::datagen::{NET, Options, Sample};
use sketch2pq::error::Error;
use sketch2pq::evaluate::metrics::{SurfaceSamples, chamfer};
use sketch2pq::evaluate::{Split, surface_scores};
use sketch2pq::mesh::PanelMesh;
use sketch2pq::picture::{Frame, MeshPart, Picture, mesh_picture, overlay_sketch, surface_picture};
use sketch2pq::pipeline::{
    Placement, Session, SessionOptions, SurfaceOptions, SurfacePatch, SurfaceResult, sketch_to_surface,
};
use sketch2pq::sketch::write_json;
use sketch2pq::surface::{BorderCurves, NurbsSurface, RefineOptions, Refined, SurfaceMesh, fit};
use std::time::Instant;

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
    let exact = arguments.iter().any(|a| a == "--exact");
    arguments.retain(|a| !["--rotations", "--start", "--exact"].contains(&&**a));
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
    let (mut taken, mut missing, mut folding) = (0, 0, 0);
    let (mut times, mut distances, mut angles) = (vec![], vec![], vec![]);
    for index in indices {
        let Ok(truth) = split.sample(index, &Options::default()) else { continue };
        let found = if exact {
            Found::from_exact_maps(&truth, &options.refine)?
        } else {
            Found::from_networks(&mut session, &truth, &options)?
        };
        let [distance, angle] = found.scores;
        println!(
            "| {} | {} | {} | {:.2} | {:.1} | {} | {:.4} | {distance:.4} | {angle:.1} | {:.0} |",
            truth.seed,
            truth.family.name(),
            truth.sketch.depth_samples.len(),
            found.strokes_px[0],
            found.strokes_px[1],
            found.folds,
            found.misfacing,
            found.refine_ms
        );
        missing += usize::from(found.strokes_px[0] > 0.5);
        folding += usize::from(found.folds > 0);
        times.push(found.refine_ms);
        distances.push(distance);
        angles.push(angle);
        if let Some(folder) = &folder {
            let path = |name: &str| std::path::Path::new(folder).join(format!("{}_{name}.json", truth.seed));
            std::fs::write(path("sketch"), write_json(&truth.sketch)?)?;
            std::fs::write(path("surface"), SurfaceResult::from_nurbs(vec![found.surface.clone()])?.to_json())?;
        }
        if drawn {
            let (column, row) = (taken % COLUMNS * tile[0], 2 * (taken / COLUMNS) * tile[1]);
            let [shaded, lines] = pictures(&found.surface, &truth, tile)?;
            sheet.paste(&shaded, column, row);
            sheet.paste(&lines, column, row + tile[1]);
        }
        taken += 1;
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    println!(
        "\n{taken} sketches: {missing} miss their strokes by more than 0.5 px, {folding} fold over; D_c {:.4}, D_n {:.2}; refine {:.0} ms",
        mean(&distances),
        mean(&angles),
        mean(&times)
    );
    if drawn {
        std::fs::write(file, sheet.to_png()?)?;
    }
    Ok(())
}

/// A surface and what is said of it.
struct Found {
    /// World frame.
    surface: NurbsSurface,
    /// Mean and largest distance to the strokes, pixels.
    strokes_px: [f64; 2],
    folds: usize,
    misfacing: f64,
    /// D_c and D_n.
    scores: [f64; 2],
    refine_ms: f64,
}

impl Found {
    fn from_networks(session: &mut Session, truth: &Sample, options: &SurfaceOptions) -> Result<Self, Error> {
        let result = sketch_to_surface(session, &truth.sketch, options)?;
        let SurfacePatch { surface, diagnostics, .. } = &result.patches[0];
        let (frame, view) = (truth.patch.frame, truth.sketch.view);
        let canonical = surface.mapped(|p| frame.point_from_camera(&view.world_to_camera(p)));
        Ok(Self {
            surface: surface.clone(),
            strokes_px: [diagnostics.reprojection_mean_px, diagnostics.reprojection_max_px],
            folds: diagnostics.fold_overs,
            misfacing: diagnostics.misfacing,
            scores: surface_scores(&canonical, truth).1,
            refine_ms: result.report.time_ms.refine,
        })
    }

    fn from_exact_maps(truth: &Sample, options: &RefineOptions) -> Result<Self, Error> {
        let targets = truth.surface_targets()?;
        let started = Instant::now();
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [NET; 2])?;
        let Refined { surface, report } = fit(&targets, &curves, options, &Control::default())?;
        let refine_ms = started.elapsed().as_secs_f64() * 1e3;
        let samples = [&surface, &truth.surface].map(|surface| SurfaceSamples::new(surface, 100));
        let (distance, angle) = chamfer(&samples[0], &samples[1]);
        let placement = Placement::of_sketch(&truth.patch.view, &truth.patch.frame, 0.0);
        Ok(Self {
            surface: surface.mapped(|p| placement.to_world(p)),
            strokes_px: [0, 1].map(|k| report.border_px[k].max(report.contour_px[k])),
            folds: report.folds,
            misfacing: report.misfacing,
            scores: [distance, angle],
            refine_ms,
        })
    }
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
