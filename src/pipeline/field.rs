//! Second call: surface to conjugate direction field.

use super::curves::{FeatureCurve, on_surfaces};
use super::lift::{Seen, canvas_field};
use super::mesh::check_panels;
use super::placement::Placement;
use super::report::Report;
use super::session::{Session, Times, timed};
use super::singularities::{self, FixedSingularity, Place};
use super::surface::{SurfacePatch, SurfaceResult};
use crate::control::Control;
use crate::error::Error;
use crate::field::{
    CanvasView, ConjugateField, DirectionConstraint, conjugate_field, conjugate_field_with_singularities,
    constraints_from_lines, constraints_from_parameters, guess_from_canvas,
};
use crate::infer::{Networks, SketchMaps};
use crate::sketch::{CanonicalFrame, PatchSketch, Sketch, StrokeKind, rasterize, understand};
use crate::surface::{NurbsSurface, SurfaceMesh};
use nalgebra::{Point3, Vector3};

/// What a host may ask of a field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldOptions {
    /// Whether the network's guess steers the field where the sketch has an outline.
    pub use_network: bool,
    /// Whether one family follows the border along the sides u = min, u = max, v = min, v = max of each patch.
    pub aligned_sides: [bool; 4],
    /// Cells of the triangulation along the longer side of a patch, 8 to 256; 0: chosen by the library.
    pub resolution: usize,
    /// Smallest crossing angle of the two families, degrees, in (0, 80].
    pub crossing_floor_deg: f64,
    /// The singularities that the fields shall have, and no others; `None`: the solver places what it needs.
    pub singularities: Option<Vec<FixedSingularity>>,
    /// Faces over all patches that the mesh will be asked for, where `edge_length` is 0; 1 to a million. Where aligned sides turn by more than
    /// 45 degrees within a panel's length the panels have a corner; nothing else depends on it.
    pub faces: usize,
    /// Edge length that the mesh will be asked for, canvas unit; 0: that of the wanted number of faces.
    pub edge_length: f64,
}

/// Cells along the longer side of a patch unless the host says otherwise.
const DEFAULT_RESOLUTION: usize = 40;
/// Weight of a feature line that crosses a whole triangle. In the solver's unit an edge weighs about 1, so the field
/// follows the line and yields where two lines contradict each other.
const LINE_WEIGHT: f64 = 300.0;
/// Pull towards running parallel to feature lines beside them, in the solver's unit: panels are larger than triangles, and where the field
/// turned back to what the network guesses within half a panel their edges would not see the line at all.
const PARALLEL_WEIGHT: f64 = 6400.0;
/// Range of what a host may say, and fewest cells along the shorter side.
const RESOLUTIONS: std::ops::RangeInclusive<usize> = 8..=256;

impl FieldOptions {
    /// The defaults.
    pub const DEFAULT: Self = Self {
        use_network: true,
        aligned_sides: [false; 4],
        resolution: 0,
        crossing_floor_deg: 20.0,
        singularities: None,
        faces: 500,
        edge_length: 0.0,
    };

    fn check(&self) -> Result<(), Error> {
        if self.resolution != 0 && !RESOLUTIONS.contains(&self.resolution) {
            let value = self.resolution.to_string();
            return Err(Error::Argument { name: "resolution", value, expected: "0, or a number from 8 to 256" });
        }
        check_panels(self.faces, self.edge_length)
    }

    /// Length of the panels' edges on a surface, canvas unit; 0 where no side is aligned and none is asked for.
    ///
    /// # Errors
    /// As [`SurfaceMesh::new`].
    fn panel_length(&self, surface: &SurfaceResult) -> Result<f64, Error> {
        if self.edge_length > 0.0 || !self.aligned_sides.contains(&true) {
            return Ok(self.edge_length);
        }
        let area = |patch: &SurfacePatch| Ok(SurfaceMesh::new(&patch.surface, cells(&patch.surface, 0))?.area());
        let areas = surface.patches.iter().map(area).collect::<Result<Vec<f64>, Error>>()?;
        Ok((areas.iter().sum::<f64>() / self.faces as f64).sqrt())
    }

    /// What the solver is told; `panel_length` in the working unit.
    fn solver(&self, panel_length: f64) -> crate::field::FieldOptions {
        crate::field::FieldOptions {
            crossing_floor_deg: self.crossing_floor_deg,
            aligned_sides: self.aligned_sides,
            panel_length,
            parallel_weight: PARALLEL_WEIGHT,
            ..crate::field::FieldOptions::default()
        }
    }
}

impl Default for FieldOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The field of one patch, and the surface that it lies on, both in the patch's working frame.
#[derive(Clone, Debug)]
pub struct FieldPatch {
    /// Two directions on each triangle, working frame.
    pub field: ConjugateField,
    /// The surface, working frame.
    pub surface: NurbsSurface,
    /// From the working frame to the world.
    pub placement: Placement,
    /// Feature lines on the surface: polylines, working frame.
    pub feature_lines: Vec<Vec<Point3<f64>>>,
}

impl FieldPatch {
    /// Vertices of the field's triangulation, world frame.
    pub fn vertices(&self) -> impl ExactSizeIterator<Item = Point3<f64>> {
        self.field.mesh.points.iter().map(|p| self.placement.to_world(&p.position))
    }

    /// Directions u and v of each triangle, unit, world frame.
    pub fn directions(&self) -> impl ExactSizeIterator<Item = [Vector3<f64>; 2]> {
        self.field.directions.iter().map(|pair| pair.map(|d| self.placement.direction_to_world(&d)))
    }
}

/// Fields of all patches.
#[derive(Clone, Debug)]
pub struct FieldResult {
    /// One for each patch of the surface.
    pub patches: Vec<FieldPatch>,
    /// Measures and times so far.
    pub report: Report,
}

/// How good a field is, over all patches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldMeasures {
    /// Mean conjugacy residual |II(u, v)| / (|II| |u| |v|) over the curved triangles.
    pub conjugacy_mean: f64,
    /// Largest of the same.
    pub conjugacy_max: f64,
    /// Smallest crossing angle of the two families, degrees.
    pub crossing_min_deg: f64,
    /// Mean angle between the feature lines and the nearer family, degrees; 0 without feature lines.
    pub feature_angle_deg: f64,
    /// Smoothness energy, summed.
    pub smoothness_energy: f64,
}

impl FieldResult {
    /// Measures over all patches; means are weighted by the number of triangles.
    pub fn measures(&self) -> FieldMeasures {
        let mut all = FieldMeasures { crossing_min_deg: 90.0, ..FieldMeasures::default() };
        let count: usize = self.patches.iter().map(|p| p.field.directions.len()).sum();
        let mut lined = 0;
        for patch in &self.patches {
            let d = &patch.field.diagnostics;
            let share = patch.field.directions.len() as f64 / count.max(1) as f64;
            all.conjugacy_mean += share * d.conjugacy_mean;
            all.conjugacy_max = all.conjugacy_max.max(d.conjugacy_max);
            all.crossing_min_deg = all.crossing_min_deg.min(d.crossing_min_deg);
            all.smoothness_energy += d.smoothness_energy;
            if !patch.feature_lines.is_empty() {
                all.feature_angle_deg += d.constraint_angle_deg;
                lined += 1;
            }
        }
        all.feature_angle_deg /= f64::from(lined.max(1));
        all
    }
}

/// Finds a conjugate direction field on each patch of a surface.
///
/// - `sketch`: the sketch that the surface was made from, perhaps with other feature lines; or, for a host's own
///   surface, lines drawn over its picture in the sketch's view; or none: the surface alone decides.
///
/// Where the sketch has an outline, CDF-Net guesses the directions in the canvas plane; they are lifted to the first
/// and second layer of the surface along the view. Feature lines are lifted to the first layer and steer the field as
/// strong soft constraints.
///
/// # Errors
/// [`Error::Argument`] for options out of range, singularities among them; [`Error::SingularityCount`] for singularities that a border
/// followed all around leaves no room for; as [`understand`] for the sketch and [`conjugate_field`] for the
/// surface; [`Error::Backend`] and [`Error::Model`] from the network; [`Error::Cancelled`].
///
/// # Source
/// Sketch2PQ, Sec. 3.2.4 and 3.3. The paper smooths the lifted guess; here the solver starts from it and keeps the
/// field conjugate.
pub fn sketch_to_cdf(
    session: &mut Session,
    sketch: Option<&Sketch>,
    surface: &SurfaceResult,
    options: &FieldOptions,
) -> Result<FieldResult, Error> {
    options.check()?;
    session.run(|networks, control| run(networks, sketch, surface, options, control))
}

/// Finds a conjugate direction field on each patch of a surface, aligned with curves in space.
///
/// - `surface`: any NURBS surfaces, e.g. from [`SurfaceResult::from_nurbs`].
/// - `curves`: each of them is followed by one family, hard or soft. Without any, and without aligned sides, the field is the smoothest one near
///   the principal directions where these are distinct.
///
/// No network runs, whatever the options say.
///
/// # Errors
/// [`Error::Argument`] for options out of range, a curve of less than two points, with a coordinate that is not finite, or farther from the
/// surface than a tenth of its size; singularities as in [`sketch_to_cdf`]; as [`conjugate_field`]; [`Error::Cancelled`].
///
/// # Source
/// The last stage of Sketch2PQ, Sec. 3.2.4, for surfaces that were not sketched; the paper has no such entry.
pub fn surface_to_cdf(
    session: &mut Session,
    surface: &SurfaceResult,
    curves: &[FeatureCurve],
    options: &FieldOptions,
) -> Result<FieldResult, Error> {
    options.check()?;
    session.run(|_, control| {
        let mut times = surface.report.time_ms;
        control.step("field", 0.0)?;
        let surfaces = working(surface);
        let fixed = fixed_places(&surfaces, options)?;
        let panel_length = options.panel_length(surface)?;
        let pieces = timed(&mut times.field, || on_surfaces(&surfaces, curves))?;
        let mut patches = Vec::with_capacity(surfaces.len());
        for (((surface, placement), pieces), fixed) in surfaces.into_iter().zip(pieces).zip(fixed) {
            let cells = cells(&surface, options.resolution);
            let field = timed(&mut times.field, || {
                let mesh = SurfaceMesh::with_middles(&surface, cells)?;
                let mut constraints = vec![];
                for piece in &pieces {
                    let weight = if piece.hard { f64::INFINITY } else { LINE_WEIGHT };
                    let curve = std::slice::from_ref(&piece.parameters);
                    constraints.extend(constraints_from_parameters(&mesh, curve, weight)?);
                }
                let solver = options.solver(panel_length * placement.scale);
                solve(mesh, None, &constraints, fixed.as_deref(), &solver, control)
            })?;
            let feature_lines = pieces.into_iter().map(|piece| piece.positions).collect();
            patches.push(FieldPatch { field, surface, placement, feature_lines });
        }
        control.step("field", 1.0)?;
        Ok(reported(patches, surface, surface.report.backend.clone(), times))
    })
}

/// The surfaces in the frames in which the stages see them.
fn working(surface: &SurfaceResult) -> Vec<(NurbsSurface, Placement)> {
    let working = |patch: &SurfacePatch| (patch.surface.mapped(|p| patch.placement.from_world(p)), patch.placement);
    surface.patches.iter().map(working).collect()
}

/// For each patch the singularities that its field shall have: parameters and indices; `None` where the solver places them.
fn fixed_places(
    surfaces: &[(NurbsSurface, Placement)],
    options: &FieldOptions,
) -> Result<Vec<Option<Vec<Place>>>, Error> {
    match &options.singularities {
        Some(fixed) => Ok(singularities::on_surfaces(surfaces, fixed)?.into_iter().map(Some).collect()),
        None => Ok(vec![None; surfaces.len()]),
    }
}

/// Solves for the field of a patch.
fn solve(
    mesh: SurfaceMesh,
    guess: Option<&[[Vector3<f64>; 2]]>,
    constraints: &[DirectionConstraint],
    fixed: Option<&[Place]>,
    options: &crate::field::FieldOptions,
    control: &Control,
) -> Result<ConjugateField, Error> {
    let Some(places) = fixed else { return conjugate_field(mesh, guess, constraints, options, control) };
    let fixed = singularities::on_mesh(&mesh, places);
    conjugate_field_with_singularities(mesh, guess, constraints, &fixed, options, control)
}

/// Adds measures to the fields of all patches.
fn reported(patches: Vec<FieldPatch>, surface: &SurfaceResult, backend: Option<String>, times: Times) -> FieldResult {
    let mut result = FieldResult { patches, report: Report::new() };
    let all = result.measures();
    let has_lines = result.patches.iter().any(|p| !p.feature_lines.is_empty());
    result.report = Report {
        backend,
        conjugacy_mean: Some(all.conjugacy_mean),
        crossing_min_deg: Some(all.crossing_min_deg),
        e_smooth: Some(all.smoothness_energy),
        field_d_f_deg: has_lines.then_some(all.feature_angle_deg),
        singularities: Some(result.patches.iter().map(|p| p.field.singularities.len()).sum()),
        time_ms: times,
        ..surface.report.clone()
    };
    result
}

fn run(
    networks: &mut Networks,
    sketch: Option<&Sketch>,
    surface: &SurfaceResult,
    options: &FieldOptions,
    control: &Control,
) -> Result<FieldResult, Error> {
    let mut times = surface.report.time_ms;
    control.step("field", 0.0)?;
    let drawn = match sketch {
        Some(sketch) if sketch.strokes.iter().any(|s| s.kind.is_structural()) => {
            timed(&mut times.sketch, || understand(sketch))?.patches
        }
        _ => vec![],
    };
    let mut patches = Vec::with_capacity(surface.patches.len());
    let fixed = fixed_places(&working(surface), options)?;
    let panel_length = options.panel_length(surface)?;
    for (index, (patch, fixed)) in surface.patches.iter().zip(&fixed).enumerate() {
        let outline = if drawn.len() == surface.patches.len() {
            drawn.get(index)
        } else {
            // Fewer or more outlines than patches: the outline that the patch covers best.
            sketch.and_then(|sketch| best_outline(&drawn, patch, sketch))
        };
        patches.push(patch_field(
            networks,
            sketch,
            outline,
            patch,
            fixed.as_deref(),
            panel_length,
            options,
            control,
            &mut times,
        )?);
    }
    control.step("field", 1.0)?;
    let ran = (options.use_network && !drawn.is_empty()).then(|| networks.backend().to_string());
    let backend = surface.report.backend.clone().or(ran);
    Ok(reported(patches, surface, backend, times))
}

/// Box around canvas-plane points: lowest and highest x, y.
fn bounds(points: impl Iterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    points.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], p| {
        [[0, 1].map(|k| low[k].min(p[k])), [0, 1].map(|k| high[k].max(p[k]))]
    })
}

/// Camera x, y of a patch's control points.
fn seen_points<'a>(patch: &'a SurfacePatch, sketch: &'a Sketch) -> impl Iterator<Item = [f64; 2]> + 'a {
    patch.surface.control_points().iter().map(|p| {
        let p = sketch.view.world_to_camera(p);
        [p.x, p.y]
    })
}

/// The outline whose bounding box has the largest share in common with the patch's.
fn best_outline<'a>(drawn: &'a [PatchSketch], patch: &SurfacePatch, sketch: &Sketch) -> Option<&'a PatchSketch> {
    let seen = bounds(seen_points(patch, sketch));
    let area = |[low, high]: [[f64; 2]; 2]| (high[0] - low[0]).max(0.0) * (high[1] - low[1]).max(0.0);
    let share = |outline: &PatchSketch| {
        let drawn = bounds(outline.border.iter().map(|b| outline.frame.to_camera(b.position)));
        let common = [[0, 1].map(|k| seen[0][k].max(drawn[0][k])), [0, 1].map(|k| seen[1][k].min(drawn[1][k]))];
        area(common) / (area(seen) + area(drawn) - area(common))
    };
    drawn
        .iter()
        .map(|outline| (share(outline), outline))
        .filter(|(share, _)| *share > 0.0)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, outline)| outline)
}

#[allow(clippy::too_many_arguments)]
fn patch_field(
    networks: &mut Networks,
    sketch: Option<&Sketch>,
    outline: Option<&PatchSketch>,
    patch: &SurfacePatch,
    fixed: Option<&[Place]>,
    panel_length: f64,
    options: &FieldOptions,
    control: &Control,
    times: &mut Times,
) -> Result<FieldPatch, Error> {
    // Work in the sketch's canonical frame where there is a sketch: x and y are its canvas then.
    let frame = match (sketch, outline) {
        (_, Some(outline)) => Some(outline.frame),
        (Some(sketch), None) => CanonicalFrame::fitting(seen_points(patch, sketch)),
        (None, None) => None,
    };
    let placement = match (sketch, frame) {
        (Some(sketch), Some(frame)) => Placement::of_sketch(&sketch.view, &frame, 0.0),
        _ => patch.placement,
    };
    let surface = patch.surface.mapped(|p| placement.from_world(p));
    let mesh = timed(&mut times.field, || SurfaceMesh::with_middles(&surface, cells(&surface, options.resolution)))?;
    let view = CanvasView::default();
    let seen = timed(&mut times.field, || sketch.map(|_| Seen::new(&mesh)));

    let mut guess = None;
    if let (Some(outline), Some(seen), true) = (outline, &seen, options.use_network) {
        let raster = timed(&mut times.sketch, || rasterize(outline));
        let maps = SketchMaps::new(outline, &raster);
        let normals = timed(&mut times.field, || seen.prediction(&raster, maps.slope));
        let predicted = timed(&mut times.infer, || networks.predict_directions(&maps, &normals, control))?;
        let crosses = canvas_field(&predicted, &raster)?;
        guess = Some(timed(&mut times.field, || guess_from_canvas(&mesh, seen.caster(), &view, &crosses)));
    }
    let lines: Vec<Vec<[f64; 2]>> = match (sketch, outline, frame) {
        (_, Some(outline), _) => {
            outline.strokes.iter().filter(|s| s.kind == StrokeKind::Feature).map(|s| s.points.clone()).collect()
        }
        (Some(sketch), None, Some(frame)) => {
            let features = sketch.strokes.iter().filter(|s| s.kind == StrokeKind::Feature);
            let canonical = |p: &[f64; 2]| frame.from_camera(sketch.view.canvas_to_camera(*p));
            features.map(|s| s.points.iter().map(canonical).collect()).collect()
        }
        _ => vec![],
    };
    let (feature_lines, constraints) = timed(&mut times.field, || match &seen {
        Some(seen) => {
            let constraints = constraints_from_lines(&mesh, seen.caster(), &view, &lines, LINE_WEIGHT)?;
            Ok((seen.lifted_lines(&lines), constraints))
        }
        None => Ok((vec![], vec![])),
    })?;
    drop(seen);
    let field = timed(&mut times.field, || {
        let solver = options.solver(panel_length * placement.scale);
        solve(mesh, guess.as_deref(), &constraints, fixed, &solver, control)
    })?;
    Ok(FieldPatch { field, surface, placement, feature_lines })
}

/// Cells in u and v: squares, about, with `resolution` of them along the longer side.
fn cells(surface: &NurbsSurface, resolution: usize) -> [usize; 2] {
    const SAMPLES: usize = 16;
    let longest = if resolution == 0 { DEFAULT_RESOLUTION } else { resolution };
    let point = |s: usize, t: usize| {
        let [u, v] = surface.at_fraction(s as f64 / SAMPLES as f64, t as f64 / SAMPLES as f64);
        surface.point(u, v)
    };
    // Mean lengths of the parameter lines at both ends and in the middle.
    let mut lengths = [0.0; 2];
    for fixed in [0, SAMPLES / 2, SAMPLES] {
        for k in 0..SAMPLES {
            lengths[0] += (point(k + 1, fixed) - point(k, fixed)).norm();
            lengths[1] += (point(fixed, k + 1) - point(fixed, k)).norm();
        }
    }
    let longer = lengths[0].max(lengths[1]).max(f64::MIN_POSITIVE);
    lengths.map(|l| ((longest as f64 * l / longer).round() as usize).clamp(*RESOLUTIONS.start(), longest))
}
