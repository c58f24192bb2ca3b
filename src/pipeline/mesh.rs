//! Third call: field to a mesh of planar panels.

use super::field::{FieldPatch, FieldResult};
use super::placement::Placement;
use super::report::Report;
use super::session::{Session, Times, timed};
use crate::control::Control;
use crate::error::Error;
use crate::field::MapOptions;
use crate::mesh::{
    BorderMode, ExtractOptions, ExtractedMesh, OffsetKind, PanelMesh, PanelTarget, PlanarizeInput, PlanarizeOptions,
    Planarized, VertexKind, border_vertices, edge_lengths, feature_angle, panels, planarize, width, write_obj,
};
use crate::surface::{NurbsSurface, SurfaceProjector};
use nalgebra::Point3;

/// Most faces that a host may ask for.
pub const MAX_FACES: usize = 1_000_000;

/// What vertices on the border of a mesh may do while its faces become planar.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BorderHold {
    /// Move along the border of the surface, or of the mesh as it is given; the surface's corners stay.
    #[default]
    Slide,
    /// Not move at all.
    Pinned,
    /// Move like any other vertex.
    Free,
}

/// What a host may ask of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshOptions {
    /// What becomes of the cells at the border.
    pub border: BorderMode,
    /// Wanted number of faces over all patches, where `edge_length` is 0; 1 to [`MAX_FACES`].
    pub faces: usize,
    /// Whether a mesh whose planarity misses the target is an error.
    pub strict: bool,
    /// Wanted edge length, canvas unit; 0: chosen to give the wanted number of faces.
    pub edge_length: f64,
    /// Wanted planarity of the worst face, in [1e-12, 1].
    pub planarity: f64,
    /// Offsets that the panels should have, as far as planarity and closeness allow.
    pub offsets: OffsetKind,
    /// What the vertices on the border may do.
    pub hold: BorderHold,
}

impl MeshOptions {
    /// The defaults.
    pub const DEFAULT: Self = Self {
        border: BorderMode::Trimmed,
        faces: 500,
        strict: false,
        edge_length: 0.0,
        planarity: 1e-6,
        offsets: OffsetKind::Any,
        hold: BorderHold::Slide,
    };

    fn check(&self) -> Result<(), Error> {
        check_panels(self.faces, self.edge_length)?;
        if !(1e-12..=1.0).contains(&self.planarity) {
            let value = self.planarity.to_string();
            return Err(Error::Argument { name: "planarity", value, expected: "a number in [1e-12, 1]" });
        }
        Ok(())
    }
}

/// Whether a host may ask for so many faces, and for edges of this length.
///
/// # Errors
/// [`Error::Argument`] if not.
pub(super) fn check_panels(faces: usize, edge_length: f64) -> Result<(), Error> {
    let fail = |name, value: String, expected| Err(Error::Argument { name, value, expected });
    if !(1..=MAX_FACES).contains(&faces) {
        return fail("faces", faces.to_string(), "a number from 1 to 1,000,000");
    }
    if !(edge_length.is_finite() && edge_length >= 0.0) {
        return fail("edge_length", edge_length.to_string(), "a length, or 0 for automatic");
    }
    Ok(())
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Panels of one patch, world frame, canvas unit.
#[derive(Clone, Debug)]
pub struct MeshPatch {
    /// Vertices and polygons.
    pub mesh: PanelMesh,
    /// Planarity of each face, see [`crate::mesh::planarity`].
    pub planarity: Vec<f64>,
    /// Distance of each vertex from the surface, of border vertices from its border; canvas unit.
    pub deviation: Vec<f64>,
    /// Largest deviation over what was allowed; above 1 planarity and closeness contradict each other.
    pub deviation_over_limit: f64,
    /// Largest deviation of a vertex that was held to the surface's border over the patch's [`width`]; 0 where none was.
    pub border_deviation_widths: f64,
    /// For each vertex whether it lies on the mesh's border.
    pub on_border: Vec<bool>,
    /// Inner vertices where another number than four edges meets.
    pub irregular: Vec<u32>,
    /// Faces that had to be left out.
    pub dropped: usize,
    /// Cells at the border that were split into triangles.
    pub split: usize,
    /// Panels inside that were split into triangles, as a last resort: planar they would have turned over or strayed too far.
    pub split_inside: usize,
    /// Length of the surface's border, and how much of it lies within a tenth of the mean edge length of the mesh's
    /// border; canvas unit.
    pub border_length: [f64; 2],
    /// Sum over the feature lines of length times angle to the nearer family of edges, degrees; and their length.
    pub feature_angle: [f64; 2],
    /// Newton rounds of the planarization.
    pub rounds: usize,
}

impl MeshPatch {
    /// A planarized mesh with what can be measured on it alone, in its own frame; `outline`: its border vertices, ascending; `held`: those that were
    /// held to the surface's border.
    pub(super) fn new(
        planarized: Planarized,
        surface: Option<&NurbsSurface>,
        outline: &[u32],
        held: &[u32],
        irregular: Vec<u32>,
    ) -> Self {
        let mut on_border = vec![false; planarized.mesh.vertices.len()];
        outline.iter().for_each(|&v| on_border[v as usize] = true);
        Self {
            border_length: surface.map_or([0.0; 2], |surface| border_length(surface, &planarized.mesh, outline)),
            deviation_over_limit: planarized.deviation_max() / planarized.deviation_limit,
            border_deviation_widths: held.iter().map(|&v| planarized.deviation[v as usize]).fold(0.0, f64::max)
                / width(&planarized.mesh.vertices),
            mesh: planarized.mesh,
            planarity: planarized.planarity,
            deviation: planarized.deviation,
            on_border,
            irregular,
            dropped: 0,
            split: planarized.split.len(),
            split_inside: 0,
            feature_angle: [0.0; 2],
            rounds: planarized.rounds,
        }
    }

    /// The patch in the world, from the working frame that `placement` describes.
    fn placed(mut self, placement: &Placement) -> Self {
        self.mesh.vertices.iter_mut().for_each(|p| *p = placement.to_world(p));
        let lengths = self.deviation.iter_mut().chain(&mut self.border_length).chain(&mut self.feature_angle);
        lengths.for_each(|length| *length /= placement.scale);
        self
    }
}

/// Meshes of all patches.
#[derive(Clone, Debug)]
pub struct MeshResult {
    /// One for each patch of the surface.
    pub patches: Vec<MeshPatch>,
    /// Measures and times of all stages.
    pub report: Report,
}

/// Measures over all patches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeshMeasures {
    /// Number of faces.
    pub faces: usize,
    /// Number of faces with four corners.
    pub quads: usize,
    /// Inner vertices where another number than four edges meets.
    pub irregular_vertices: usize,
    /// Faces that had to be left out.
    pub dropped: usize,
    /// Cells at the border that were split into triangles.
    pub split: usize,
    /// Panels inside that were split into triangles as a last resort.
    pub split_inside: usize,
    /// Planarity of the worst face.
    pub planarity_max: f64,
    /// Mean planarity of the faces.
    pub planarity_mean: f64,
    /// Largest distance of a vertex from the surface, canvas unit.
    pub deviation_max: f64,
    /// The same over the patch's mean edge length.
    pub deviation_max_edges: f64,
    /// Largest deviation over what was allowed; above 1 planarity and closeness contradict each other.
    pub deviation_over_limit: f64,
    /// Largest distance of a border vertex from the surface's border, over the patch's [`width`].
    pub border_deviation_widths: f64,
    /// Mean length of the edges, canvas unit.
    pub edge_length_mean: f64,
    /// Share of the surface's border, by length, that lies within a tenth of the mean edge length of the mesh's border;
    /// `None` without a surface.
    pub border_covered: Option<f64>,
    /// Mean angle between a feature line and the nearer family of the mesh's edges, degrees; `None` without feature
    /// lines.
    pub feature_angle_deg: Option<f64>,
}

impl MeshResult {
    /// The patches with their measures added to the report of the stages before.
    pub(super) fn new(patches: Vec<MeshPatch>, report: Report) -> Self {
        let mut result = Self { patches, report };
        let all = result.measures();
        result.report = Report {
            d_f_deg: all.feature_angle_deg,
            p_max: Some(all.planarity_max),
            p_mean: Some(all.planarity_mean),
            deviation_max: Some(all.deviation_max),
            deviation_max_edges: Some(all.deviation_max_edges),
            deviation_over_limit: Some(all.deviation_over_limit),
            border_deviation_widths: Some(all.border_deviation_widths),
            border_covered: all.border_covered,
            irregular_vertices: Some(all.irregular_vertices),
            edge_length_mean: Some(all.edge_length_mean),
            faces: Some(all.faces),
            quads: Some(all.quads),
            dropped: Some(all.dropped),
            split: Some(all.split),
            split_inside: Some(all.split_inside),
            ..result.report
        };
        result
    }

    /// Measures over all patches; means over all faces or edges.
    pub fn measures(&self) -> MeshMeasures {
        let mut all = MeshMeasures::default();
        let (mut edges, mut border, mut lines) = (0, [0.0; 2], [0.0; 2]);
        for patch in &self.patches {
            let lengths = edge_lengths(&patch.mesh);
            let sum: f64 = lengths.iter().sum();
            let deviation = patch.deviation.iter().copied().fold(0.0, f64::max);
            all.faces += patch.mesh.face_count();
            all.quads += patch.mesh.faces().filter(|face| face.len() == 4).count();
            all.irregular_vertices += patch.irregular.len();
            all.dropped += patch.dropped;
            all.split += patch.split;
            all.split_inside += patch.split_inside;
            all.planarity_max = patch.planarity.iter().copied().fold(all.planarity_max, f64::max);
            all.planarity_mean += patch.planarity.iter().sum::<f64>();
            all.deviation_max = all.deviation_max.max(deviation);
            all.deviation_max_edges = all.deviation_max_edges.max(deviation * lengths.len() as f64 / sum);
            all.deviation_over_limit = all.deviation_over_limit.max(patch.deviation_over_limit);
            all.border_deviation_widths = all.border_deviation_widths.max(patch.border_deviation_widths);
            all.edge_length_mean += sum;
            edges += lengths.len();
            for k in 0..2 {
                border[k] += patch.border_length[k];
                lines[k] += patch.feature_angle[k];
            }
        }
        all.planarity_mean /= all.faces as f64;
        all.edge_length_mean /= edges as f64;
        all.border_covered = (border[0] > 0.0).then(|| border[1] / border[0]);
        all.feature_angle_deg = (lines[1] > 0.0).then(|| lines[0] / lines[1]);
        all
    }

    /// The mesh as Wavefront OBJ, one object for each patch.
    pub fn obj(&self) -> String {
        write_obj(&self.patches.iter().map(|p| &p.mesh).collect::<Vec<_>>())
    }
}

/// Extracts panels along a field and moves their vertices until every panel is planar.
///
/// The field is integrated to a seamless map; its integer isolines cut the surface into panels, cut at the border as
/// the options say; Newton's method on the planarity constraints then moves the vertices, close to the surface and its
/// border. Of several patches each gets faces by its share of the whole area.
///
/// # Errors
/// [`Error::Argument`] for options out of range; [`Error::NoMesh`] if no panel fits on a patch; [`Error::NotPlanar`] if
/// asked to be strict; else as [`panels`] and [`planarize`]; [`Error::Cancelled`].
///
/// # Source
/// Sketch2PQ, Sec. 3.2.4 and 4, with another extraction and planarization: see there.
pub fn extract_pq_mesh(session: &mut Session, field: &FieldResult, options: &MeshOptions) -> Result<MeshResult, Error> {
    options.check()?;
    session.run(|_, control| run(field, options, control))
}

fn run(field: &FieldResult, options: &MeshOptions, control: &Control) -> Result<MeshResult, Error> {
    let mut times = field.report.time_ms;
    control.step("mesh", 0.0)?;
    let areas: Vec<f64> = field.patches.iter().map(area).collect();
    let area: f64 = areas.iter().sum();
    let mut patches = Vec::with_capacity(field.patches.len());
    for (patch, share) in field.patches.iter().zip(&areas) {
        let target = if options.edge_length > 0.0 {
            PanelTarget::EdgeLength(options.edge_length * patch.placement.scale)
        } else {
            PanelTarget::Faces(((options.faces as f64 * share / area).round() as usize).max(1))
        };
        patches.push(patch_mesh(patch, target, options, control, &mut times)?);
    }
    control.step("planarize", 1.0)?;
    Ok(MeshResult::new(patches, Report { time_ms: times, ..field.report.clone() }))
}

/// Area of a patch, canvas unit.
fn area(patch: &FieldPatch) -> f64 {
    let mesh = &patch.field.mesh;
    (0..mesh.triangles.len()).map(|t| mesh.triangle_normal_area(t).1).sum::<f64>() / patch.placement.scale.powi(2)
}

fn patch_mesh(
    patch: &FieldPatch,
    target: PanelTarget,
    options: &MeshOptions,
    control: &Control,
    times: &mut Times,
) -> Result<MeshPatch, Error> {
    if let PanelTarget::EdgeLength(edge) = target {
        // Fewer panels than one, or more than anyone can ask for by number, is a mistake of the unit.
        let faces = area(patch) * patch.placement.scale.powi(2) / edge.powi(2);
        if faces.is_nan() || faces > MAX_FACES as f64 {
            let value = options.edge_length.to_string();
            return Err(Error::Argument {
                name: "edge_length",
                value,
                expected: "a length that gives at most a million faces",
            });
        }
    }
    let extract = ExtractOptions { border: options.border, ..ExtractOptions::default() };
    let extracted = timed(&mut times.mesh, || {
        panels(&patch.field, &patch.surface, target, &MapOptions::default(), &extract, control)
    })?;
    control.step("planarize", 0.0)?;
    let outline = border_vertices(&extracted.mesh);
    // Without the cut cells the mesh ends inside the surface's border and is free there.
    let on_surface_border = |v: &u32| !matches!(extracted.origins[*v as usize].kind, VertexKind::Interior);
    let mut held: Vec<u32> = outline.iter().copied().filter(on_surface_border).collect();
    if options.hold == BorderHold::Free {
        held.clear();
    }
    let planarized = timed(&mut times.planarize, || flatten(patch, &extracted, &outline, &held, options, control))?;
    if options.strict && !planarized.is_planar {
        let (reached, rounds) = (planarized.planarity_max(), planarized.rounds);
        return Err(Error::NotPlanar { reached, target: options.planarity, rounds });
    }
    let inside = planarized.split.iter().filter(|&&f| !at_border(extracted.mesh.face(f as usize), &outline)).count();
    let mut result = MeshPatch::new(planarized, Some(&patch.surface), &outline, &held, extracted.irregular);
    result.split -= inside;
    result.split_inside = inside;
    result.feature_angle = feature_angle(&patch.feature_lines, &result.mesh);
    result.dropped = extracted.repairs.dropped;
    Ok(result.placed(&patch.placement))
}

/// Whether a face has a corner on the border, given as its ascending vertices.
fn at_border(face: &[u32], outline: &[u32]) -> bool {
    face.iter().any(|v| outline.binary_search(v).is_ok())
}

/// How many times the allowed deviation a planar mesh may stray: panels that cannot be built are no panels, and the report
/// tells the deviation.
const ALLOWANCE: f64 = 10.0;

/// Planarity beyond which a panel is not left as it is: it becomes triangles.
const SPLIT_BEYOND: f64 = 1e-4;

/// Makes extracted panels planar.
///
/// Where planarity would turn a face over or collapse an edge, cells at the border may become triangles, and panels inside as a last resort.
fn flatten(
    patch: &FieldPatch,
    extracted: &ExtractedMesh,
    outline: &[u32],
    held: &[u32],
    options: &MeshOptions,
    control: &Control,
) -> Result<Planarized, Error> {
    let strips = extracted.strips();
    let parameters: Vec<[f64; 2]> = extracted.origins.iter().map(|origin| origin.parameter).collect();
    // Triangles at the border are panels like any other there.
    let count = extracted.mesh.face_count() as u32;
    let splittable: Vec<u32> = (0..count).filter(|&f| at_border(extracted.mesh.face(f as usize), outline)).collect();
    let projector = SurfaceProjector::new(&patch.surface);
    let input = PlanarizeInput {
        mesh: &extracted.mesh,
        reference: Some(&projector),
        border: held,
        pins: if options.hold == BorderHold::Pinned { outline } else { &[] },
        polylines: &strips,
        parameters: Some(&parameters),
        splittable: &splittable,
        feature_lines: &patch.feature_lines,
    };
    let options = PlanarizeOptions {
        target: options.planarity,
        offsets: options.offsets,
        allowance: ALLOWANCE,
        split_beyond: Some(SPLIT_BEYOND),
        ..PlanarizeOptions::default()
    };
    planarize(&input, &options, control)
}

/// Samples of each side of the surface's border.
const BORDER_SAMPLES: usize = 200;
/// How near the mesh's border must come, mean edge lengths: chords of a curved border stay well within.
const BORDER_REACH: f64 = 0.1;

/// Length of the surface's border, and how much of it lies near the mesh's border.
fn border_length(surface: &NurbsSurface, mesh: &PanelMesh, outline: &[u32]) -> [f64; 2] {
    let mut sides: Vec<[u32; 2]> = vec![];
    for face in mesh.faces() {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            if outline.binary_search(&a).is_ok() && outline.binary_search(&b).is_ok() {
                sides.push([a.min(b), a.max(b)]);
            }
        }
    }
    sides.sort_unstable();
    let sides: Vec<[Point3<f64>; 2]> = sides
        .chunk_by(|a, b| a == b)
        .filter(|group| group.len() == 1)
        .map(|group| group[0].map(|v| mesh.vertices[v as usize]))
        .collect();
    let lengths = edge_lengths(mesh);
    let reach = BORDER_REACH * lengths.iter().sum::<f64>() / lengths.len() as f64;
    let mut sum = [0.0; 2];
    for side in 0..4 {
        let point = |i: usize| {
            let t = i as f64 / BORDER_SAMPLES as f64;
            let [s, t] = [[t, 0.0], [1.0, t], [t, 1.0], [0.0, t]][side];
            let [u, v] = surface.at_fraction(s, t);
            surface.point(u, v)
        };
        for i in 0..BORDER_SAMPLES {
            let (a, b) = (point(i), point(i + 1));
            let middle = nalgebra::center(&a, &b);
            sum[0] += (b - a).norm();
            if sides.iter().any(|side| distance_to_segment(side, &middle) <= reach) {
                sum[1] += (b - a).norm();
            }
        }
    }
    sum
}

fn distance_to_segment([a, b]: &[Point3<f64>; 2], p: &Point3<f64>) -> f64 {
    let d = b - a;
    let t = ((p - a).dot(&d) / d.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    (p - (a + d * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_border_is_covered_where_the_mesh_reaches_it() {
        let square = |x: f64, y: f64| Point3::new(x, y, 0.0);
        let net = vec![square(0.0, 0.0), square(0.0, 1.0), square(1.0, 0.0), square(1.0, 1.0)];
        let surface = NurbsSurface::uniform(1, [2, 2], net).unwrap();
        // A panel over the left half: half of the lower and upper side and the whole left one, and a tenth of the edges'
        // mean length, 0.75, more.
        let mesh = PanelMesh {
            vertices: vec![square(0.0, 0.0), square(0.5, 0.0), square(0.5, 1.0), square(0.0, 1.0)],
            starts: vec![0, 4],
            indices: vec![0, 1, 2, 3],
        };
        let [all, covered] = border_length(&surface, &mesh, &[0, 1, 2, 3]);
        assert!((all - 4.0).abs() < 1e-9);
        assert!((covered - (2.0 + 2.0 * 0.075)).abs() < 0.03, "{covered}");
    }
}
