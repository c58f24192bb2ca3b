//! Third call: field to a mesh of planar panels.

use super::field::{FieldPatch, FieldResult};
use super::report::Report;
use super::session::{Session, Times, timed};
use crate::control::Control;
use crate::error::Error;
use crate::field::MapOptions;
use crate::mesh::{
    BorderMode, ExtractOptions, ExtractedMesh, PanelMesh, PanelTarget, PlanarizeInput, PlanarizeOptions, Planarized,
    VertexKind, border_vertices, edge_lengths, panels, planarize, write_obj,
};
use crate::surface::{NurbsSurface, SurfaceProjector};
use nalgebra::{Point3, Vector3};

/// Most faces that a host may ask for.
pub const MAX_FACES: usize = 1_000_000;

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
}

impl MeshOptions {
    /// The defaults.
    pub const DEFAULT: Self =
        Self { border: BorderMode::Trimmed, faces: 500, strict: false, edge_length: 0.0, planarity: 1e-6 };

    fn check(&self) -> Result<(), Error> {
        let fail = |name, value: String, expected| Err(Error::Argument { name, value, expected });
        if !(1..=MAX_FACES).contains(&self.faces) {
            return fail("faces", self.faces.to_string(), "a number from 1 to 1,000,000");
        }
        if !(self.edge_length.is_finite() && self.edge_length >= 0.0) {
            return fail("edge_length", self.edge_length.to_string(), "a length, or 0 for automatic");
        }
        if !(1e-12..=1.0).contains(&self.planarity) {
            return fail("planarity", self.planarity.to_string(), "a number in [1e-12, 1]");
        }
        Ok(())
    }
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
    /// For each vertex whether it lies on the mesh's border.
    pub on_border: Vec<bool>,
    /// Inner vertices where another number than four edges meets.
    pub irregular: Vec<u32>,
    /// Faces that had to be left out.
    pub dropped: usize,
    /// Length of the surface's border, and how much of it lies within a tenth of the mean edge length of the mesh's
    /// border; canvas unit.
    pub border_length: [f64; 2],
    /// Sum over the feature lines of length times angle to the nearer family of edges, degrees; and their length.
    pub feature_angle: [f64; 2],
    /// Newton rounds of the planarization.
    pub rounds: usize,
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
    /// Planarity of the worst face.
    pub planarity_max: f64,
    /// Mean planarity of the faces.
    pub planarity_mean: f64,
    /// Largest distance of a vertex from the surface, canvas unit.
    pub deviation_max: f64,
    /// The same over the patch's mean edge length.
    pub deviation_max_edges: f64,
    /// Mean length of the edges, canvas unit.
    pub edge_length_mean: f64,
    /// Share of the surface's border, by length, that lies within a tenth of the mean edge length of the mesh's border.
    pub border_covered: f64,
    /// Mean angle between a feature line and the nearer family of the mesh's edges, degrees; `None` without feature
    /// lines.
    pub feature_angle_deg: Option<f64>,
}

impl MeshResult {
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
            all.planarity_max = patch.planarity.iter().copied().fold(all.planarity_max, f64::max);
            all.planarity_mean += patch.planarity.iter().sum::<f64>();
            all.deviation_max = all.deviation_max.max(deviation);
            all.deviation_max_edges = all.deviation_max_edges.max(deviation * lengths.len() as f64 / sum);
            all.edge_length_mean += sum;
            edges += lengths.len();
            for k in 0..2 {
                border[k] += patch.border_length[k];
                lines[k] += patch.feature_angle[k];
            }
        }
        all.planarity_mean /= all.faces as f64;
        all.edge_length_mean /= edges as f64;
        all.border_covered = border[1] / border[0];
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
    let mut result = MeshResult { patches, report: Report::new() };
    let all = result.measures();
    result.report = Report {
        d_f_deg: all.feature_angle_deg,
        p_max: Some(all.planarity_max),
        p_mean: Some(all.planarity_mean),
        deviation_max: Some(all.deviation_max),
        deviation_max_edges: Some(all.deviation_max_edges),
        border_covered: Some(all.border_covered),
        irregular_vertices: Some(all.irregular_vertices),
        edge_length_mean: Some(all.edge_length_mean),
        faces: Some(all.faces),
        quads: Some(all.quads),
        dropped: Some(all.dropped),
        time_ms: times,
        ..field.report.clone()
    };
    Ok(result)
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
    let mut best: Option<(ExtractedMesh, Vec<u32>, Planarized)> = None;
    for factor in DENSITIES {
        let extracted = timed(&mut times.mesh, || {
            panels(&patch.field, &patch.surface, target.scaled(factor), &MapOptions::default(), &extract, control)
        })?;
        control.step("planarize", 0.0)?;
        let outline = border_vertices(&extracted.mesh);
        let planarized =
            timed(&mut times.planarize, || flatten(&patch.surface, &extracted, &outline, options, control))?;
        let better = best.as_ref().is_none_or(|(_, _, b)| planarized.planarity_max() < b.planarity_max());
        if better {
            best = Some((extracted, outline, planarized));
        }
        if best.as_ref().is_some_and(|(_, _, b)| b.planarity_max() <= FABRICATION_PLANARITY.max(options.planarity)) {
            break;
        }
    }
    let Some((extracted, outline, planarized)) = best else {
        return Err(Error::NoMesh { reason: "no density was tried".into() });
    };
    if options.strict && !planarized.is_planar {
        let (reached, rounds) = (planarized.planarity_max(), planarized.rounds);
        return Err(Error::NotPlanar { reached, target: options.planarity, rounds });
    }
    let mut on_border = vec![false; extracted.mesh.vertices.len()];
    outline.iter().for_each(|&v| on_border[v as usize] = true);
    let scale = patch.placement.scale;
    let length = border_length(&patch.surface, &planarized.mesh, &outline);
    let feature_angle = feature_angle(&patch.feature_lines, &planarized.mesh);
    let vertices = planarized.mesh.vertices.iter().map(|p| patch.placement.to_world(p)).collect();
    Ok(MeshPatch {
        mesh: PanelMesh { vertices, ..planarized.mesh },
        planarity: planarized.planarity,
        deviation: planarized.deviation.iter().map(|d| d / scale).collect(),
        on_border,
        irregular: extracted.irregular,
        dropped: extracted.repairs.dropped,
        border_length: length.map(|l| l / scale),
        feature_angle: [feature_angle[0] / scale, feature_angle[1] / scale],
        rounds: planarized.rounds,
    })
}

/// Planarity that a fabricator accepts in any case; above it, being planar goes before being close.
const FABRICATION_PLANARITY: f64 = 1e-3;
/// How much farther from the surface each further try may go.
const WIDENING: [f64; 2] = [3.0, 9.0];

/// Densities that are tried, as factors of the number of faces, until one gives panels that can be built flat. The integers of
/// the map decide where panels fall on saddles and folds; another layout within the allowed face count often avoids the
/// place where the first gets stuck.
const DENSITIES: [f64; 5] = [1.0, 0.94, 1.06, 0.89, 1.11];

/// Planarizes within the default deviation; where that leaves faces that nobody can build flat, allows more of it.
///
/// A sketch can ask for shapes whose panels are planar only some way off the surface. The report tells planarity and
/// deviation both, so neither is traded silently.
fn flatten(
    surface: &NurbsSurface,
    extracted: &ExtractedMesh,
    outline: &[u32],
    options: &MeshOptions,
    control: &Control,
) -> Result<Planarized, Error> {
    // Without the cut cells the mesh ends inside the surface's border and is free there.
    let on_surface_border = |v: &u32| !matches!(extracted.origins[*v as usize].kind, VertexKind::Interior);
    let held: Vec<u32> = outline.iter().copied().filter(on_surface_border).collect();
    let strips = extracted.strips();
    let projector = SurfaceProjector::new(surface);
    let input = PlanarizeInput {
        mesh: &extracted.mesh,
        reference: Some(&projector),
        border: &held,
        pins: &[],
        polylines: &strips,
    };
    let target = options.planarity;
    let options = PlanarizeOptions { target, ..PlanarizeOptions::default() };
    let mut best = planarize(&input, &options, control)?;
    let limit = best.deviation_limit;
    for factor in WIDENING {
        if best.planarity_max() <= FABRICATION_PLANARITY.max(target) {
            break;
        }
        let wider = PlanarizeOptions { deviation: Some(limit * factor), ..options.clone() };
        let next = planarize(&input, &wider, control)?;
        if next.planarity_max() < best.planarity_max() {
            best = next;
        }
    }
    Ok(best)
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

/// Sum over the segments of the feature lines of length times angle to the better aligned family of edges of the
/// nearest quad, degrees, and the sum of the lengths.
///
/// The families of a quad are its two midlines; the nearest quad is the one with the nearest centre.
///
/// # Source
/// Sketch2PQ, Sec. 4.1 (D_f). As printed it is a sum, and to the closest edge, which is often one of the crossing
/// family.
fn feature_angle(lines: &[Vec<Point3<f64>>], mesh: &PanelMesh) -> [f64; 2] {
    let quads: Vec<(Point3<f64>, [Vector3<f64>; 2])> = mesh
        .faces()
        .filter(|face| face.len() == 4)
        .map(|face| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| mesh.vertices[face[k] as usize].coords);
            (Point3::from((a + b + c + d) / 4.0), [b + c - a - d, c + d - a - b])
        })
        .collect();
    let mut sum = [0.0; 2];
    for ends in lines.iter().flat_map(|line| line.windows(2)) {
        let (along, middle) = (ends[1] - ends[0], nalgebra::center(&ends[0], &ends[1]));
        let distance = |quad: &&(Point3<f64>, _)| (quad.0 - middle).norm_squared();
        let Some((_, families)) = quads.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) else { break };
        let angle = |family: &Vector3<f64>| along.cross(family).norm().atan2(along.dot(family).abs()).to_degrees();
        let length = along.norm();
        sum[0] += length * families.iter().map(angle).fold(90.0, f64::min);
        sum[1] += length;
    }
    sum
}
