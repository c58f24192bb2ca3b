//! First call: sketch to surface.

use super::live::{LivePatch, LiveSurfaces};
use super::placement::Placement;
use super::report::Report;
use super::session::{Session, Times, timed};
use super::start::{network_surface, targets};
use crate::control::Control;
use crate::error::Error;
use crate::infer::{BackendInfo, Networks, SketchMaps};
use crate::sketch::{PatchSketch, Sketch, Understanding, rasterize, understand};
use crate::surface::{NurbsSurface, RefineOptions, RefineReport, SurfaceTargets, fit, refine};
use serde_json::{Value, json};

/// What a host may ask of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceOptions {
    /// Places near the outline, canvas frame, in any order, that become the four corners of the patch; `None`: they are
    /// found.
    ///
    /// Only for a sketch with one outline.
    pub corners: Option<[[f64; 2]; 4]>,
    /// How the surface is refined.
    pub refine: RefineOptions,
}

/// One patch of the result.
#[derive(Clone, Debug)]
pub struct SurfacePatch {
    /// The surface, world frame, canvas unit.
    pub surface: NurbsSurface,
    /// From the frame in which the stages see the surface to the world.
    pub placement: Placement,
    /// How well it obeys the sketch.
    pub diagnostics: SurfaceDiagnostics,
}

/// How well a patch obeys the sketch. All zero for a host's own surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceDiagnostics {
    /// Mean distance from the structural strokes to the projected border and silhouette, pixels of the 256 canvas: that
    /// of border and contour strokes, weighted by their lengths.
    pub reprojection_mean_px: f64,
    /// The largest of the same.
    pub reprojection_max_px: f64,
    /// Largest distance along the view between a depth sample and the surface, canvas unit.
    pub sample_residual: f64,
    /// Share of the surface whose side facing the viewer is not drawn there.
    pub misfacing: f64,
    /// Whether the surface began with that of the sketch before, see [`super::SessionOptions::live`].
    pub warm_start: bool,
    /// Places of a grid where the surface turns from front to back, seen along the view, and no contour is drawn.
    pub fold_overs: usize,
}

/// Surfaces of all patches.
#[derive(Clone, Debug)]
pub struct SurfaceResult {
    /// One for each outline of the sketch.
    pub patches: Vec<SurfacePatch>,
    /// Places in the sketch's list of strokes that played no part.
    pub unused_strokes: Vec<usize>,
    /// What ran the networks; `None` for a host's own surfaces.
    pub backend: Option<BackendInfo>,
    /// Measures and times so far.
    pub report: Report,
}

impl SurfaceResult {
    /// A result made of a host's own surfaces, world frame.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if there is none, or one without extent.
    pub fn from_nurbs(surfaces: Vec<NurbsSurface>) -> Result<Self, Error> {
        if surfaces.is_empty() {
            return Err(Error::Degenerate { reason: "no surface was given".into() });
        }
        let mut patches = Vec::with_capacity(surfaces.len());
        for (index, surface) in surfaces.into_iter().enumerate() {
            let placement = Placement::of_surface(&surface).ok_or_else(|| Error::Degenerate {
                reason: format!("surface {index} is a point, or too small or large for its place"),
            })?;
            patches.push(SurfacePatch { surface, placement, diagnostics: SurfaceDiagnostics::default() });
        }
        let report = Report { patches: patches.len(), ..Report::new() };
        Ok(Self { patches, unused_strokes: vec![], backend: None, report })
    }

    /// The surfaces as JSON: for each patch degrees, counts, knots in both conventions, control points and weights.
    pub fn to_json(&self) -> String {
        let patches: Vec<Value> = self.patches.iter().map(|patch| surface_value(&patch.surface)).collect();
        let value = json!({ "frame": "world: right-handed, z up, canvas unit", "patches": patches });
        let mut text = serde_json::to_string(&value).expect("a tree of numbers and texts");
        text.push('\n');
        text
    }
}

fn surface_value(surface: &NurbsSurface) -> Value {
    let [u, v] = surface.knots();
    let rows: Vec<Vec<[f64; 3]>> =
        surface.control_points().chunks(v.count()).map(|row| row.iter().map(|p| [p.x, p.y, p.z]).collect()).collect();
    let mut value = json!({
        "degrees": [u.degree(), v.degree()],
        "counts": [u.count(), v.count()],
        "knots": [u.knots(), v.knots()],
        "rhino_knots": [u.rhino(), v.rhino()],
        "control_points": rows,
    });
    if let Some(weights) = surface.weights() {
        value["weights"] = json!(weights.chunks(v.count()).collect::<Vec<_>>());
    }
    value
}

/// Turns a sketch into a surface: one patch for each outline.
///
/// Strokes are arranged into regions and drawn as maps; VD-Net and OD-Net predict depth and normals of both layers, which
/// are joined where a hidden sheet comes to light; the border strokes, lifted to those depths, are the rim of the patch;
/// inside, the layers are unfolded across the contours and fitted, and where the sketch draws no contour BSR-Net shapes a
/// Coons patch too; Gauss-Newton refines the better of the two, between both. Without depth
/// samples the lowest point of each patch has z = 0 (seen from within three degrees of the horizon, where sliding along
/// the view moves nothing up or down: its mean depth is 0); with depth samples the patch passes through them.
///
/// The samples are met, and each moves the surface smoothly, but not only there, since the networks read them too. A single one says where
/// the patch lies, and takes all of it along. Of two and more, one that moves by a twenty-fifth of the drawing's size changes the surface
/// beyond half that size by a third of what it does around itself if there are two, by a seventh of it if there are more (means of 18
/// held-out sketches). A very small move may change it by up to a hundredth of the size, where the refinement ends a step earlier or later.
///
/// # Errors
/// As [`understand`]; [`Error::Argument`] for corners of a sketch with several outlines, or not finite;
/// [`Error::Degenerate`] for an outline that spans no patch; [`Error::Backend`] and [`Error::Model`] from the networks;
/// [`Error::Cancelled`].
///
/// In a live session ([`super::SessionOptions::live`]) the refinement begins with the last sketch's surface where the outline, its
/// corners and the contours moved by eight pixels at most and nothing was added or taken away, and with the above where the result then
/// misses the strokes.
///
/// # Source
/// Sketch2PQ, Sec. 3.2; refined beyond the paper on strokes and samples, see [`refine`].
pub fn sketch_to_surface(
    session: &mut Session,
    sketch: &Sketch,
    options: &SurfaceOptions,
) -> Result<SurfaceResult, Error> {
    session.run_with(|networks, live, control| run(networks, live, sketch, options, control))
}

fn run(
    networks: &mut Networks,
    mut live: Option<&mut LiveSurfaces>,
    sketch: &Sketch,
    options: &SurfaceOptions,
    control: &Control,
) -> Result<SurfaceResult, Error> {
    let mut times = Times::default();
    control.step("sketch", 0.0)?;
    let Understanding { patches: drawn, unused } = timed(&mut times.sketch, || understand(sketch))?;
    let corners = check_corners(sketch, options, drawn.len())?;
    let (mut patches, mut kept) = (Vec::with_capacity(drawn.len()), vec![]);
    for (index, patch) in drawn.iter().enumerate() {
        let last = live.as_deref().and_then(|live| live.patch(index, drawn.len()));
        let (surface, targets, anew) = patch_surface(networks, patch, last, corners, options, control, &mut times)?;
        if live.is_some() {
            let canonical = surface.surface.mapped(|p| surface.placement.from_world(p));
            kept.push(LivePatch::new(patch, options, &targets, canonical, anew));
        }
        patches.push(surface);
    }
    control.step("refine", 1.0)?;
    if let Some(live) = &mut live {
        live.keep(kept);
    }
    let backend = networks.backend().clone();
    let report = report(&drawn, &patches, &unused, &backend, times);
    Ok(SurfaceResult { patches, unused_strokes: unused, backend: Some(backend), report })
}

/// The corners that the host gave, camera frame.
fn check_corners(sketch: &Sketch, options: &SurfaceOptions, outlines: usize) -> Result<Option<[[f64; 2]; 4]>, Error> {
    let Some(corners) = options.corners else { return Ok(None) };
    if outlines != 1 {
        let value = format!("given for {outlines} outlines");
        return Err(Error::Argument { name: "corners", value, expected: "corners for a sketch with one outline" });
    }
    if let Some(index) = corners.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(Error::NotFinite { what: "corner", index });
    }
    Ok(Some(corners.map(|p| sketch.view.canvas_to_camera(p))))
}

fn patch_surface(
    networks: &mut Networks,
    patch: &PatchSketch,
    last: Option<&LivePatch>,
    corners: Option<[[f64; 2]; 4]>,
    options: &SurfaceOptions,
    control: &Control,
    times: &mut Times,
) -> Result<(SurfacePatch, SurfaceTargets, RefineReport), Error> {
    let raster = timed(&mut times.sketch, || rasterize(patch));
    control.step("infer", 0.0)?;
    let maps = SketchMaps::new(patch, &raster);
    let depths = timed(&mut times.infer, || networks.predict_depths(&maps, control))?;
    control.step("infer", 0.7)?;
    let (mut targets, curves) = timed(&mut times.refine, || targets(patch, corners, &depths))?;
    // BSR-Net misses some folds, and the refinement cannot make a fold that its start lacks: on 40 folded held-out sketches the contours ended
    // 4.4 px off from BSR-Net's start, 1.0 px from the unfolded one. As a guess beside the maps, with a third of their weight, D_c of 45
    // such sketches falls by 1 % and D_n rises by as little, and the network takes longer than the whole refinement.
    if targets.contours.is_empty() {
        targets.guess = Some(timed(&mut times.infer, || network_surface(networks, &maps, &depths, &curves, control))?);
    }
    let mut warm = None;
    if let Some(last) = last {
        let refined = timed(&mut times.refine, || {
            let start = last.start(patch, options, &targets);
            start.map(|start| refine(&start, &targets, &options.refine, control)).transpose()
        })?;
        warm = refined.filter(|refined| last.obeys(&refined.report)).map(|refined| (refined, last.anew()));
    }
    let warm_start = warm.is_some();
    let (refined, anew) = match warm {
        Some(warm) => warm,
        None => {
            control.step("refine", 0.0)?;
            let refined = timed(&mut times.refine, || fit(&targets, &curves, &options.refine, control))?;
            let report = refined.report;
            (refined, report)
        }
    };
    let lift = if patch.depth_samples.is_empty() { resting_lift(&refined.surface, patch) } else { 0.0 };
    let placement = Placement::of_sketch(&patch.view, &patch.frame, lift);
    let diagnostics = SurfaceDiagnostics { warm_start, ..diagnostics(&refined.report, &targets, patch.frame.scale) };
    let surface = refined.surface.mapped(|p| placement.to_world(p));
    Ok((SurfacePatch { surface, placement, diagnostics }, targets, anew))
}

/// Smallest sine of the view's elevation at which a patch can be put on the ground by sliding it along the view: three
/// degrees.
const LOWEST_VIEW: f64 = 0.052;
/// Samples a side, and halvings of their distance around the lowest, in the search for the lowest point.
const LOWEST_SAMPLES: usize = 65;
const LOWEST_HALVINGS: usize = 40;

/// How far towards the viewer, in canvas units, the patch has to slide until its lowest point has z = 0.
fn resting_lift(surface: &NurbsSurface, patch: &PatchSketch) -> f64 {
    let toward = patch.view.toward().z;
    let placement = Placement::of_sketch(&patch.view, &patch.frame, 0.0);
    if toward.abs() < LOWEST_VIEW {
        let points = surface.control_points();
        return -points.iter().map(|p| p.z).sum::<f64>() / points.len() as f64 / placement.scale;
    }
    let height = |s: f64, t: f64| {
        let [u, v] = surface.at_fraction(s, t);
        placement.to_world(&surface.point(u, v)).z
    };
    let mut step = 1.0 / (LOWEST_SAMPLES - 1) as f64;
    let mut lowest = (f64::INFINITY, 0.0, 0.0);
    for i in 0..LOWEST_SAMPLES {
        for j in 0..LOWEST_SAMPLES {
            let (s, t) = (i as f64 * step, j as f64 * step);
            let z = height(s, t);
            if z < lowest.0 {
                lowest = (z, s, t);
            }
        }
    }
    for _ in 0..LOWEST_HALVINGS {
        step *= 0.5;
        let (_, s, t) = lowest;
        for (ds, dt) in
            [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0), (-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)]
        {
            let (s, t) = ((s + step * ds).clamp(0.0, 1.0), (t + step * dt).clamp(0.0, 1.0));
            let z = height(s, t);
            if z < lowest.0 {
                lowest = (z, s, t);
            }
        }
    }
    -lowest.0 / toward
}

fn diagnostics(report: &RefineReport, targets: &SurfaceTargets, scale: f64) -> SurfaceDiagnostics {
    let length = |line: &[[f64; 2]]| line.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1])).sum::<f64>();
    let border = length(&targets.border.points);
    let contours: f64 = targets.contours.iter().map(|line| length(line)).sum();
    let mean = (report.border_px[0] * border + report.contour_px[0] * contours) / (border + contours);
    SurfaceDiagnostics {
        reprojection_mean_px: mean,
        reprojection_max_px: report.border_px[1].max(report.contour_px[1]),
        sample_residual: report.sample_residual / scale,
        misfacing: report.misfacing,
        fold_overs: report.folds,
        warm_start: false,
    }
}

fn report(
    drawn: &[PatchSketch],
    patches: &[SurfacePatch],
    unused: &[usize],
    backend: &BackendInfo,
    times: Times,
) -> Report {
    let worst = |of: fn(&SurfaceDiagnostics) -> f64| patches.iter().map(|p| of(&p.diagnostics)).fold(0.0, f64::max);
    let samples = drawn.iter().map(|p| p.depth_samples.len()).sum::<usize>();
    let mean = patches.iter().map(|p| p.diagnostics.reprojection_mean_px).sum::<f64>() / patches.len() as f64;
    Report {
        backend: Some(backend.to_string()),
        patches: patches.len(),
        unused_strokes: Some(unused.to_vec()),
        reprojection_mean_px: Some(mean),
        reprojection_max_px: Some(worst(|d| d.reprojection_max_px)),
        sample_residual: (samples > 0).then(|| worst(|d| d.sample_residual)),
        misfacing: Some(worst(|d| d.misfacing)),
        fold_overs: Some(patches.iter().map(|p| p.diagnostics.fold_overs).sum()),
        time_ms: times,
        ..Report::new()
    }
}
