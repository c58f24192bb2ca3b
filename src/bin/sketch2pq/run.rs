//! `sketch2pq run`: one sketch, all results.

use crate::{Runtime, print};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use sketch2pq::mesh::BorderMode;
use sketch2pq::picture::{Scene, ScenePatch, scene_picture};
use sketch2pq::pipeline::{
    FieldOptions, MeshOptions, MeshResult, Session, SurfaceOptions, SurfaceResult, extract_pq_mesh, sketch_to_cdf,
    sketch_to_surface,
};
use sketch2pq::sketch::{Sketch, read_sketch};
use sketch2pq::surface::SurfaceMesh;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};
use std::path::{Path, PathBuf};

/// The stages in their order, as they report themselves.
const STAGES: [&str; 6] = ["sketch", "infer", "refine", "field", "mesh", "planarize"];
/// Steps of the progress bar for each stage.
const STEPS: u64 = 100;

#[derive(Args)]
pub struct Run {
    /// The sketch, JSON or SVG.
    sketch: PathBuf,
    /// Folder for the results; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Wanted number of faces [default: 500].
    #[arg(long, value_name = "N", conflicts_with = "edge")]
    faces: Option<usize>,
    /// Wanted edge length, in the sketch's unit.
    #[arg(long, value_name = "L")]
    edge: Option<f64>,
    /// What becomes of the cells at the border.
    #[arg(long, value_enum, default_value_t = Border::Trimmed)]
    border: Border,
    /// Wanted planarity of the worst face.
    #[arg(long, value_name = "P", default_value_t = MeshOptions::DEFAULT.planarity)]
    planarity: f64,
    #[command(flatten)]
    runtime: Runtime,
    /// No progress, no summary.
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Border {
    /// Cells cut by the border become polygons that end on it.
    Trimmed,
    /// Edge loops follow the border.
    Aligned,
    /// Whole quads only.
    Interior,
}

impl From<Border> for BorderMode {
    fn from(border: Border) -> Self {
        match border {
            Border::Trimmed => Self::Trimmed,
            Border::Aligned => Self::Aligned,
            Border::Interior => Self::Interior,
        }
    }
}

impl Run {
    /// Runs the pipeline and writes its files, all of them or none.
    pub fn execute(&self) -> Result<(), String> {
        if self.out.exists() && !self.out.is_dir() {
            return Err(format!("{}: not a folder", self.out.display()));
        }
        let sketch = read_sketch(&self.sketch).map_err(|e| named(&self.sketch, &e))?;
        let mut session = Session::new(&self.runtime.session_options()).map_err(|e| e.to_string())?;
        let bar = self.progress_bar();
        let watched = bar.clone();
        session.set_progress(Some(Box::new(move |stage, fraction| advance(&watched, stage, fraction))));

        let mesh_options = MeshOptions {
            border: self.border.into(),
            faces: self.faces.unwrap_or(MeshOptions::DEFAULT.faces),
            edge_length: self.edge.unwrap_or(0.0),
            planarity: self.planarity,
            ..MeshOptions::default()
        };
        let field_options = FieldOptions {
            aligned_sides: [matches!(self.border, Border::Aligned); 4],
            faces: mesh_options.faces,
            edge_length: mesh_options.edge_length,
            ..FieldOptions::default()
        };
        let results = sketch_to_surface(&mut session, &sketch, &SurfaceOptions::default()).and_then(|surface| {
            let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &field_options)?;
            let mesh = extract_pq_mesh(&mut session, &field, &mesh_options)?;
            Ok((surface, mesh))
        });
        bar.finish_and_clear();
        let (surface, mesh) = results.map_err(|e| named(&self.sketch, &e))?;
        let picture = picture(&sketch, &surface, &mesh).map_err(|e| e.to_string())?;
        let files: [(&str, Vec<u8>); 4] = [
            ("surface.json", surface.to_json().into_bytes()),
            ("mesh.obj", mesh.obj().into_bytes()),
            ("report.json", mesh.report.to_json().into_bytes()),
            ("picture.png", picture),
        ];
        write_all(&self.out, &files)?;
        if !self.quiet {
            print(&self.summary(&surface, &mesh, &files.map(|(name, _)| name)));
        }
        Ok(())
    }

    fn progress_bar(&self) -> ProgressBar {
        if self.quiet || !std::io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::with_template("{msg:10} [{bar:40}] {percent:>3}%").expect("the template is valid");
        ProgressBar::new(STAGES.len() as u64 * STEPS).with_style(style.progress_chars("=> "))
    }

    fn summary(&self, surface: &SurfaceResult, mesh: &MeshResult, files: &[&str]) -> String {
        let measures = mesh.measures();
        let report = &mesh.report;
        let mut text = String::new();
        let mut line = |label: &str, value: String| {
            let _ = writeln!(text, "{label:11}{value}");
        };
        line("sketch", self.sketch.display().to_string());
        let px = report.reprojection_mean_px.zip(report.reprojection_max_px);
        let strokes =
            px.map_or(String::new(), |(mean, max)| format!(", strokes met to {mean:.2} px (at most {max:.2})"));
        line("surface", format!("{}{strokes}", counted(surface.patches.len(), "patch", "patches")));
        let others = measures.faces - measures.quads;
        line(
            "mesh",
            format!(
                "{}, {others} of them with 3, 5 or more corners, {}",
                counted(measures.faces, "face", "faces"),
                counted(measures.irregular_vertices, "irregular vertex", "irregular vertices")
            ),
        );
        line("planarity", format!("{:.1e} worst, {:.1e} mean", measures.planarity_max, measures.planarity_mean));
        let over = measures.deviation_over_limit;
        let contradiction = if over > 1.0 { format!(", {over:.2} times what was allowed") } else { String::new() };
        line(
            "deviation",
            format!(
                "{:.3} at most, {:.3} edge lengths{contradiction}",
                measures.deviation_max, measures.deviation_max_edges
            ),
        );
        let times = &report.time_ms;
        line(
            "time",
            format!(
                "{:.0} ms (sketch {:.0}, infer {:.0}, refine {:.0}, field {:.0}, mesh {:.0}, planarize {:.0})",
                times.total(),
                times.sketch,
                times.infer,
                times.refine,
                times.field,
                times.mesh,
                times.planarize
            ),
        );
        line("backend", surface.backend.as_ref().map(ToString::to_string).unwrap_or_default());
        if !surface.unused_strokes.is_empty() {
            line("unused", format!("strokes {:?}: too short, or drawn twice", surface.unused_strokes));
        }
        line("written", format!("{} in {}", files.join(", "), self.out.display()));
        text
    }
}

fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// An error with the file that it is about, unless it names it itself.
fn named(path: &Path, error: &sketch2pq::Error) -> String {
    match error {
        sketch2pq::Error::File { .. } => error.to_string(),
        _ => format!("{}: {error}", path.display()),
    }
}

fn advance(bar: &ProgressBar, stage: &str, fraction: f64) {
    if let Some(index) = STAGES.iter().position(|&s| s == stage) {
        bar.set_message(STAGES[index]);
        bar.set_position(index as u64 * STEPS + (fraction * STEPS as f64) as u64);
    }
}

/// Writes all files beside their places first, then moves them there: an error before the first move leaves nothing
/// behind.
fn write_all(folder: &Path, files: &[(&str, Vec<u8>)]) -> Result<(), String> {
    let fresh = !folder.exists();
    let fail = |path: &Path, error: std::io::Error| format!("{}: {error}", path.display());
    std::fs::create_dir_all(folder).map_err(|e| fail(folder, e))?;
    if let Some(path) = files.iter().map(|(name, _)| folder.join(name)).find(|path| path.is_dir()) {
        return Err(format!("{}: a folder is in the way", path.display()));
    }
    let waiting = |name: &str| folder.join(format!(".{name}.{}", std::process::id()));
    let written = files.iter().try_for_each(|(name, bytes)| {
        let path = waiting(name);
        let mut file = std::fs::File::create(&path).map_err(|e| fail(&path, e))?;
        file.write_all(bytes).and_then(|()| file.sync_all()).map_err(|e| fail(&path, e))
    });
    let moved = written.and_then(|()| {
        files.iter().try_for_each(|(name, _)| {
            let path = folder.join(name);
            std::fs::rename(waiting(name), &path).map_err(|e| fail(&path, e))
        })
    });
    if moved.is_err() {
        for (name, _) in files {
            let _ = std::fs::remove_file(waiting(name));
        }
        if fresh {
            let _ = std::fs::remove_dir(folder);
        }
    }
    moved
}

/// Cells along each side of a patch in the picture.
const PICTURE_CELLS: usize = 60;
/// Width of the picture, pixels.
const PICTURE_WIDTH: usize = 1500;

/// Sketch, surface and panels side by side, as PNG.
fn picture(sketch: &Sketch, surface: &SurfaceResult, mesh: &MeshResult) -> Result<Vec<u8>, sketch2pq::Error> {
    let patches = surface.patches.iter().zip(&mesh.patches).map(|(surface, mesh)| {
        Ok(ScenePatch {
            surface: Some(SurfaceMesh::new(&surface.surface, [PICTURE_CELLS; 2])?),
            mesh: Some(mesh.mesh.clone()),
            planarity: mesh.planarity.clone(),
            irregular: mesh.irregular.clone(),
        })
    });
    let measures = mesh.measures();
    let scene = Scene {
        sketch: Some(sketch.clone()),
        view: sketch.view,
        patches: patches.collect::<Result<_, _>>()?,
        notes: vec![
            format!("{} faces, {} quads", measures.faces, measures.quads),
            format!("planarity {:.1e} worst, {:.1e} mean", measures.planarity_max, measures.planarity_mean),
            format!("deviation {:.3} edge lengths at most", measures.deviation_max_edges),
            format!("{} irregular vertices", measures.irregular_vertices),
            format!("{:.0} ms", mesh.report.time_ms.total()),
        ],
    };
    scene_picture(&scene, PICTURE_WIDTH).to_png()
}
