//! Moves vertices until every face is planar.

use super::border_trace::BorderTrace;
use super::feature_lines::feature_pieces;
use super::offsets::{AngleSum, OffsetKind, angle_sums};
use super::panel_mesh::PanelMesh;
use super::planarity::{edges, mean_edge_length, planarity, width};
use super::reference::{Foot, MeshReference, Reference};
use super::split::split_faces;
use crate::control::Control;
use crate::error::Error;
use crate::numeric::{BlockMatrix, Cholesky, SymbolicCholesky};
use nalgebra::{Matrix3, Point3, Vector3};

/// What to planarize, and what to keep to.
#[derive(Clone, Copy)]
pub struct PlanarizeInput<'a> {
    /// Any mesh of polygons; model frame, any unit.
    pub mesh: &'a PanelMesh,
    /// The surface to stay on. Without one the mesh stays close to itself as it is given.
    pub reference: Option<&'a dyn Reference>,
    /// Vertices that stay on the reference's border, in any order; see [`border_vertices`].
    pub border: &'a [u32],
    /// Vertices that do not move at all.
    pub pins: &'a [u32],
    /// Neighbours (previous, vertex, next) along polylines that stay fair; see [`super::grid_triples`].
    pub polylines: &'a [[u32; 3]],
    /// Faces that may be split into triangles where planarity would turn a face over or collapse an edge; any order.
    pub splittable: &'a [u32],
    /// Lines near the mesh that edges should run along: polylines.
    pub feature_lines: &'a [Vec<Point3<f64>>],
    /// Where each vertex lies in the reference's parameters, if that is known; spares the search for its first closest point.
    pub parameters: Option<&'a [[f64; 2]]>,
}

impl<'a> PlanarizeInput<'a> {
    /// The mesh alone: it is its own reference, nothing is held, kept fair or split.
    pub fn new(mesh: &'a PanelMesh) -> Self {
        Self {
            mesh,
            reference: None,
            border: &[],
            pins: &[],
            polylines: &[],
            splittable: &[],
            feature_lines: &[],
            parameters: None,
        }
    }
}

/// How [`planarize`] weighs its aims. Weights multiply squared lengths in units of the mesh's mean edge length.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarizeOptions {
    /// Largest planarity of a face, as [`planarity`] measures it, that counts as planar. The result is usually far below.
    pub target: f64,
    /// Distance to the reference that no vertex should exceed, mesh unit. `None`: 2 % of the mesh's width (sqrt 2 times the
    /// largest distance of a vertex from the centroid, the side for a square), or a fifth of its mean edge length, whichever
    /// is smaller.
    pub deviation: Option<f64>,
    /// Planarity beyond which a face is split into triangles at last, listed in [`PlanarizeInput::splittable`] or not; `None`: such
    /// faces stay as they are.
    pub split_beyond: Option<f64>,
    /// Deviation over its limit up to which a planar mesh is preferred to a closer one that is not planar.
    pub allowance: f64,
    /// Most Newton rounds in search of the best compromise of the soft terms, and as many again for the cautious attempts that follow where those find
    /// none; projections onto the constraints come on top.
    pub rounds: usize,
    /// Weight of the distance to the surface (to its tangent plane at the closest point).
    pub closeness: f64,
    /// Weight of the distance from where a vertex started; holds vertices against sliding in the surface.
    pub anchor: f64,
    /// Weight of the distance of border vertices from the border's tangent line.
    pub border: f64,
    /// Weight of the change of second differences along the polylines.
    pub fairness: f64,
    /// Weight of the change of edge vectors, relative to the edge's length where it is shorter than the mean; grows for an
    /// edge that loses more than half of its length.
    pub stretch: f64,
    /// Weight of the squared angle, radians, between a feature line and the nearer family of edges, for each mean edge length of line.
    pub features: f64,
    /// Offsets that the mesh should have, as far as the other terms allow.
    pub offsets: OffsetKind,
    /// Weight of the squared angle sums, radians, that vanish for such meshes; see [`super::circularity`], [`super::conicality`].
    pub offset_weight: f64,
}

impl PlanarizeOptions {
    /// The defaults.
    pub const DEFAULT: Self = Self {
        target: 1e-6,
        deviation: None,
        split_beyond: None,
        allowance: 3.0,
        rounds: 240,
        closeness: 1.0,
        anchor: 1e-2,
        border: 1e3,
        fairness: 0.5,
        stretch: 5e-2,
        features: 10.0,
        offsets: OffsetKind::Any,
        offset_weight: 100.0,
    };
}

impl Default for PlanarizeOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A planarized mesh and how well it came out.
#[derive(Clone, Debug)]
pub struct Planarized {
    /// The input's faces on moved vertices; those that were split as triangles in their place.
    pub mesh: PanelMesh,
    /// Faces of the input that were split, ascending.
    pub split: Vec<u32>,
    /// Planarity of each face, see [`planarity`].
    pub planarity: Vec<f64>,
    /// Distance of each vertex from the reference surface, from its border for border vertices, from its corner for those that start there; mesh unit.
    pub deviation: Vec<f64>,
    /// The limit that `deviation` was held against, mesh unit.
    pub deviation_limit: f64,
    /// Newton rounds made.
    pub rounds: usize,
    /// Whether every face is planar to the target.
    pub is_planar: bool,
    /// Whether every vertex is within the deviation limit.
    pub is_close: bool,
}

impl Planarized {
    /// Largest planarity of a face.
    pub fn planarity_max(&self) -> f64 {
        self.planarity.iter().copied().fold(0.0, f64::max)
    }

    /// Largest deviation of a vertex, mesh unit.
    pub fn deviation_max(&self) -> f64 {
        self.deviation.iter().copied().fold(0.0, f64::max)
    }
}

/// Makes every face planar by moving vertices as little as possible off the reference, its border and fair polylines.
///
/// Each face of k > 3 corners must satisfy k - 3 equations: with its unit normal n (Newell's) and the projector P onto the
/// vectors orthogonal to 1, x, y (corner coordinates in the face's plane), P (n . v_i)_i = 0. For a quad that is the
/// distance of its diagonals. The derivatives of n and of P vanish where the face is planar, so P and n held fixed give a
/// Newton step that converges quadratically. Each round minimizes the Gauss-Newton model of the soft terms (distance to
/// tangent planes and border tangents at fresh closest points, anchoring, change of the polylines' second differences) under
/// the linearized equations; the equality-constrained system is solved by a sparse Cholesky factorization of H + mu C^T C,
/// whose symbolic part all rounds share, and multiplier updates. Where vertices leave the allowed deviation, their
/// weights grow; so do those of the anchors where border vertices slide so far that an edge between them cuts a bend of the border short. The last
/// rounds drop the soft gradient and only project onto the constraints.
///
/// A planar mesh that turns a face over or collapses an edge is no answer: vertices there go a part of their step only, and the edges there become
/// stiffer; if the planar mesh does so all the same, the search goes on from the last sound state with edges stiffer still. If that does not
/// help either, faces there are let off being planar: those in [`PlanarizeInput::splittable`], which then become triangles, and, at last, any
/// that [`PlanarizeOptions::split_beyond`] allows. A planar mesh that leaves the allowed deviation gets a few attempts more in the same way.
///
/// Planarity and closeness may contradict each other (panels along the rulings of a saddle). Then the better compromise
/// is returned with its numbers: the planar mesh unless it strays more than [`PlanarizeOptions::allowance`] times the allowed
/// deviation, else the mesh with the least planarity within the deviation; [`Planarized::is_planar`] and
/// [`Planarized::is_close`] tell.
///
/// # Errors
/// [`Error::VertexOutOfRange`], [`Error::NotFinite`] and [`Error::Degenerate`] for an unusable mesh or index list,
/// [`Error::Argument`] for options out of range, [`Error::Cancelled`].
///
/// # Source
/// Tang et al. 2014, "Form-finding with polyhedral meshes made simple" (guided projection). We eliminate its face normals,
/// which leaves a third fewer unknowns and exact constraints instead of penalties.
pub fn planarize(input: &PlanarizeInput, options: &PlanarizeOptions, control: &Control) -> Result<Planarized, Error> {
    check(input, options)?;
    let own;
    let reference: &dyn Reference = match input.reference {
        Some(reference) => reference,
        None => {
            own = MeshReference::from_panels(input.mesh);
            &own
        }
    };
    let edge = mean_edge_length(input.mesh);
    let width = width(&input.mesh.vertices);
    let limit = options.deviation.unwrap_or((0.02 * width).min(0.2 * edge));
    let mut state = State::new(input, reference, options, edge, limit)?;
    state.run(control)?;

    let State { vertices, feet, rounds, freed, may_split, .. } = state;
    let mut mesh = PanelMesh { vertices, ..input.mesh.clone() };
    let last_resort = options.split_beyond.unwrap_or(f64::INFINITY);
    let split: Vec<bool> = planarity(&mesh)
        .into_iter()
        .enumerate()
        .map(|(f, p)| p > last_resort.max(options.target) || (p > options.target && freed[f] && may_split[f]))
        .collect();
    if split.contains(&true) {
        mesh = split_faces(&mesh, |f| split[f]);
    }
    let split = (0..split.len() as u32).filter(|&f| split[f as usize]).collect();
    let planarity = planarity(&mesh);
    let deviation: Vec<f64> = mesh.vertices.iter().zip(&feet).map(|(p, foot)| (p - foot.point).norm()).collect();
    let is_planar = planarity.iter().all(|p| *p <= options.target);
    let is_close = deviation.iter().all(|d| *d <= limit);
    Ok(Planarized { mesh, split, planarity, deviation, deviation_limit: limit, rounds, is_planar, is_close })
}

/// The vertices on edges that belong to one face only, ascending.
pub fn border_vertices(mesh: &PanelMesh) -> Vec<u32> {
    let mut vertices = border_sides(mesh).into_flattened();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// The edges that belong to one face only.
fn border_sides(mesh: &PanelMesh) -> Vec<[u32; 2]> {
    let mut sides = Vec::with_capacity(mesh.indices.len());
    for face in mesh.faces() {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            sides.push([a.min(b), a.max(b)]);
        }
    }
    sides.sort_unstable();
    sides.chunk_by(|a, b| a == b).filter(|group| group.len() == 1).map(|group| group[0]).collect()
}

/// The vertices with two border edges, and the angle by which the border turns at each, radians.
fn border_turns(mesh: &PanelMesh) -> Vec<(u32, f64)> {
    let mut ends: Vec<(u32, u32)> = border_sides(mesh).into_iter().flat_map(|[a, b]| [(a, b), (b, a)]).collect();
    ends.sort_unstable();
    let at = |v: u32| mesh.vertices[v as usize];
    ends.chunk_by(|a, b| a.0 == b.0)
        .filter(|group| group.len() == 2)
        .map(|group| (group[0].0, (at(group[0].0) - at(group[0].1)).angle(&(at(group[1].1) - at(group[0].0)))))
        .collect()
}

/// Refuses what the rounds could not index or scale.
fn check(input: &PlanarizeInput, options: &PlanarizeOptions) -> Result<(), Error> {
    let mesh = input.mesh;
    let count = mesh.vertices.len();
    if let Some(index) = mesh.vertices.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(Error::NotFinite { what: "vertex", index });
    }
    let faces: Vec<&[u32]> = mesh.faces().collect();
    PanelMesh::new(mesh.vertices.clone(), &faces)?;
    let lists = input.border.iter().chain(input.pins).chain(input.polylines.iter().flatten());
    if let Some(vertex) = lists.copied().find(|&v| v as usize >= count) {
        let reason = format!("a border, pin or polyline list refers to vertex {vertex} of {count}");
        return Err(Error::Degenerate { reason });
    }
    if let Some(face) = input.splittable.iter().find(|&&f| f as usize >= mesh.face_count()) {
        let value = face.to_string();
        return Err(Error::Argument { name: "splittable", value, expected: "numbers of faces" });
    }
    if let Some(parameters) = input.parameters
        && parameters.len() != count
    {
        let value = parameters.len().to_string();
        return Err(Error::Argument { name: "parameters", value, expected: "one pair for each vertex" });
    }
    let edge = mean_edge_length(mesh);
    if !(edge > 0.0 && edge.is_finite() && (1.0 / edge).is_finite()) {
        return Err(Error::Degenerate { reason: format!("the mean edge length of the mesh is {edge}") });
    }
    let positive = |name: &'static str, value: f64| {
        if value > 0.0 && value.is_finite() {
            Ok(())
        } else {
            Err(Error::Argument { name, value: value.to_string(), expected: "a positive number" })
        }
    };
    positive("target", options.target)?;
    positive("anchor", options.anchor)?;
    positive("deviation", options.deviation.unwrap_or(1.0))?;
    positive("allowance", options.allowance)?;
    positive("split_beyond", options.split_beyond.unwrap_or(1.0))?;
    for (name, value) in [
        ("closeness", options.closeness),
        ("border", options.border),
        ("fairness", options.fairness),
        ("stretch", options.stretch),
        ("features", options.features),
        ("offset_weight", options.offset_weight),
    ] {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(Error::Argument { name, value: value.to_string(), expected: "a number that is not negative" });
        }
    }
    Ok(())
}

/// Penalty on the squared constraint residuals, in units of the soft terms' weights; only the speed of the multiplier
/// updates depends on it. Smooth bends of a fine mesh hardly show in the residuals, by the fourth power of their length in
/// panels: 1e6 is too little for 30,000 faces.
const PENALTY: f64 = 1e8;

/// Solutions with each factorization; each updates the multipliers, which gains a factor of about `PENALTY` over the stiffest soft weight, and
/// halves what the matrix has too much of the fairness term.
const UPDATES: usize = 3;

/// Longest step of a vertex against its neighbours in one round, in mean edge lengths.
const LONGEST_STEP: f64 = 0.3;

/// Growth of the anchor weight of a border vertex with the square of the angle, radians, by which the border turns there: where vertices slide away
/// from a bend, the edge beside them cuts it short. On a straight border they slide freely.
const TURN_ANCHOR: f64 = 100.0;

/// How much less a step counts that a vertex makes together with its neighbours.
const JOINT_STEP: f64 = 0.15;

/// A step shorter than this, in mean edge lengths, ends the search for the best compromise of the soft terms.
const STEP_TOLERANCE: f64 = 2e-3;

/// The same of the root mean square over all vertices, where all keep the limits: fairness, all that is left to gain, is not seen by then.
const TYPICAL_STEP: f64 = 0.03;

/// Motion, in mean edge lengths, below which a vertex keeps its closest point's tangent plane.
const STALE: f64 = 1e-2;

/// Length of an edge over its length at the start, below which a mesh counts as spoiled.
const COLLAPSED: f64 = 0.05;

/// Distance from the border that no border vertex should exceed, in widths of the mesh.
const BORDER_LIMIT: f64 = 1e-3;

/// Distance from the nearest border edge that no point of the border should exceed, in mean edge lengths, unless it starts farther away.
const BORDER_GAP: f64 = 0.09;

/// Bound of closeness and border weights where they grow; stiffer ones slow the multipliers down.
const LARGEST_WEIGHT: f64 = 1e5;

/// Bound of the factor on the anchor weight of vertices on the border.
const LARGEST_HOLD: f64 = 1e5;

/// Step, in mean edge lengths, below which weights may grow before the search has settled.
const GROWTH_STEP: f64 = 0.3;

/// The same of the root mean square over all vertices.
const TYPICAL_GROWTH_STEP: f64 = 0.1;

/// Share of the largest strain before one round that is left after it where it falls by itself.
const FALLING: f64 = 0.8;

/// Rounds in a row that are kept from going their way by the same face, after which the next attempt has to do something about it.
const STUCK_ROUNDS: usize = 5;

/// Most steps towards planarity with one factorization.
const CORRECTIONS: usize = 4;

/// How often weights may grow in one search.
const GROWTHS: usize = 8;

/// Most attempts at a planar mesh that turns no face over and collapses no edge.
const ATTEMPTS: usize = 9;

/// Newton rounds of the first attempt in search of the best compromise of the soft terms, and of each later one, which goes on from there.
const BALANCE_ROUNDS: [usize; 2] = [40, 12];

/// How often a step that would spoil the mesh is halved where it does, before it is left out there.
const HALVINGS: usize = 2;

/// How often a step is shortened in all, each time where it still would spoil the mesh, before it is left out everywhere.
const SHORTENINGS: usize = 12;

/// Attempts that answer a turned face or a collapsed edge by stiffer edges; later ones give up the planarity of faces there.
const STIFFENINGS: usize = 1;

/// Attempts to draw in a planar mesh that strays too far; all but the first let faces be split.
const DRAWN_IN: usize = 5;

/// Of these, how many pass before any face there is let off, where that is allowed.
const RESORT: usize = 3;

/// Bound of the factor on an edge's stretch weight.
const LARGEST_STIFFNESS: f64 = 1e4;

/// Factor on the stretch weight of all edges, for each attempt that failed.
const STIFFENING: f64 = 2.0;

/// Further factor on that of edges at turned faces and of collapsed edges.
const STIFFENING_THERE: f64 = 5.0;

/// Where a mesh is no longer what it was.
struct Spoiled {
    /// Faces that turned over or got stuck before they were planar.
    faces: Vec<usize>,
    /// Edges that all but collapsed, as places in the list of edges.
    edges: Vec<usize>,
}

impl Spoiled {
    fn is_empty(&self) -> bool {
        self.faces.is_empty() && self.edges.is_empty()
    }
}

/// The equations of one face.
struct FaceEquations {
    normal: Vector3<f64>,
    /// Projector onto what an affine function on the face's plane cannot reach, k x k, row by row.
    projector: Vec<f64>,
    /// Projector times n . v_i, in mean edge lengths.
    residual: Vec<f64>,
}

impl FaceEquations {
    /// `None` for triangles and for faces on a line, which are planar.
    fn new(corners: &[Vector3<f64>]) -> Option<Self> {
        let count = corners.len();
        if count < 4 {
            return None;
        }
        let center: Vector3<f64> = corners.iter().sum::<Vector3<f64>>() / count as f64;
        let local: Vec<Vector3<f64>> = corners.iter().map(|p| p - center).collect();
        let area: Vector3<f64> = (0..count).map(|k| local[k].cross(&local[(k + 1) % count])).sum();
        let spread: f64 = local.iter().map(|p| p.norm_squared()).sum();
        let normal = area.try_normalize(1e-12 * spread)?;
        let longest = local.iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
        let e1 = (longest - normal * normal.dot(longest)).try_normalize(1e-300)?;
        let e2 = normal.cross(&e1);
        let mut x: Vec<f64> = local.iter().map(|p| p.dot(&e1)).collect();
        let mut y: Vec<f64> = local.iter().map(|p| p.dot(&e2)).collect();
        // Gram-Schmidt; both are already orthogonal to the constant vector.
        let norm = |v: &[f64]| v.iter().map(|t| t * t).sum::<f64>().sqrt();
        let nx = norm(&x);
        x.iter_mut().for_each(|t| *t /= nx);
        let xy: f64 = x.iter().zip(&y).map(|(a, b)| a * b).sum();
        y.iter_mut().zip(&x).for_each(|(b, a)| *b -= xy * a);
        let ny = norm(&y);
        if ny <= 1e-9 * nx {
            return None;
        }
        y.iter_mut().for_each(|t| *t /= ny);
        let mut projector = vec![0.0; count * count];
        for i in 0..count {
            for j in 0..count {
                let identity = if i == j { 1.0 } else { 0.0 };
                projector[i * count + j] = identity - 1.0 / count as f64 - x[i] * x[j] - y[i] * y[j];
            }
        }
        let heights: Vec<f64> = local.iter().map(|p| normal.dot(p)).collect();
        let residual = product(&projector, &heights);
        Some(Self { normal, projector, residual })
    }
}

fn product(matrix: &[f64], vector: &[f64]) -> Vec<f64> {
    matrix.chunks_exact(vector.len()).map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum()).collect()
}

/// The squared angle between a piece of a feature line and the edges of the panel under it.
struct FeatureTerm {
    /// Corners of the panel.
    corners: [u32; 4],
    /// How the edges' direction at the piece comes from the corners.
    factors: [f64; 4],
    /// Unit vector in the panel, across the line: the direction should have no part in it.
    across: Vector3<f64>,
    /// On the square of that part, in mean edges.
    weight: f64,
}

/// Angle between a feature line and both families of edges beyond which neither is meant, radians.
const FARTHEST_FEATURE: f64 = 0.6;

/// The pieces of the feature lines, each with the family of edges that is nearer to it.
fn feature_terms(input: &PlanarizeInput, options: &PlanarizeOptions, edge: f64) -> Vec<FeatureTerm> {
    let mesh = input.mesh;
    let mut terms = vec![];
    for piece in feature_pieces(input.feature_lines, mesh) {
        let directions = piece.directions(mesh);
        let normal = directions[0].cross(&directions[1]);
        let Some(across) = normal.cross(&piece.along).try_normalize(0.0) else { continue };
        let sines = directions.map(|d| d.dot(&across).abs() / d.norm().max(f64::MIN_POSITIVE));
        let family = usize::from(sines[1] < sines[0]);
        if sines[family] > FARTHEST_FEATURE.sin() {
            continue;
        }
        let face = mesh.face(piece.face as usize);
        let weight = options.features * piece.along.norm() * edge / directions[family].norm_squared();
        let (corners, factors) = ([0, 1, 2, 3].map(|k| face[k]), piece.families()[family]);
        terms.push(FeatureTerm { corners, factors, across, weight });
    }
    terms
}

/// Lengths of the steps that the vertices asked for in one round, mean edges.
struct Step {
    longest: f64,
    /// Root mean square over all vertices.
    typical: f64,
}

/// A factorized round: what small further steps towards planarity need.
struct System {
    factor: Cholesky,
    /// Those of each face that has any.
    equations: Vec<Option<FaceEquations>>,
}

/// What a round aims at.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Minimum of the soft terms under the constraints.
    Balance,
    /// The nearest planar mesh.
    Project,
    /// Minimum of soft terms plus this multiple of the squared residuals.
    Penalty(f64),
}

struct State<'a> {
    input: &'a PlanarizeInput<'a>,
    reference: &'a dyn Reference,
    options: &'a PlanarizeOptions,
    /// Mean edge length of the input: the unit of all residuals.
    edge: f64,
    limit: f64,
    border_limit: f64,
    vertices: Vec<Point3<f64>>,
    on_border: Vec<bool>,
    /// Vertices at corners of the reference's border: they stay there, however near a side is.
    at_corner: Vec<bool>,
    pinned: Vec<bool>,
    feet: Vec<Foot>,
    /// Where each foot was asked for.
    asked: Vec<Point3<f64>>,
    /// Weight of the distance of each vertex from where it started.
    anchors: Vec<f64>,
    /// Factor on that weight where the border is left behind.
    hold: Vec<f64>,
    border_trace: BorderTrace,
    /// Factor on the closeness and border weight of each vertex.
    emphasis: Vec<f64>,
    /// Vertices drawn to their closest point itself: where the reference bends sharply, its tangent leads away.
    drawn: Vec<bool>,
    /// Multipliers of each face, one for each corner.
    multipliers: Vec<Vec<f64>>,
    edges: Vec<[u32; 2]>,
    /// Factor on the stretch weight of each edge.
    stiffness: Vec<f64>,
    /// Whether each face may be split into triangles.
    may_split: Vec<bool>,
    /// Whether each face is let off being planar.
    freed: Vec<bool>,
    /// Whether a step that would spoil the mesh somewhere is shortened everywhere.
    is_cautious: bool,
    angle_sums: Vec<AngleSum>,
    feature_terms: Vec<FeatureTerm>,
    matrix: BlockMatrix,
    symbolic: SymbolicCholesky,
    rounds: usize,
}

impl<'a> State<'a> {
    fn new(
        input: &'a PlanarizeInput<'a>,
        reference: &'a dyn Reference,
        options: &'a PlanarizeOptions,
        edge: f64,
        limit: f64,
    ) -> Result<Self, Error> {
        let count = input.mesh.vertices.len();
        let mut on_border = vec![false; count];
        input.border.iter().for_each(|&v| on_border[v as usize] = true);
        // A vertex of no face has nothing to move for.
        let mut pinned = vec![true; count];
        input.mesh.indices.iter().for_each(|&v| pinned[v as usize] = false);
        input.pins.iter().for_each(|&v| pinned[v as usize] = true);
        let mut may_split = vec![false; input.mesh.face_count()];
        input.splittable.iter().for_each(|&f| may_split[f as usize] = true);
        let mut pairs = vec![];
        for group in input.mesh.faces().filter(|f| f.len() > 3) {
            for (k, &a) in group.iter().enumerate() {
                pairs.extend(group[..k].iter().map(|&b| [a, b]));
            }
        }
        pairs.extend(input.polylines.iter().flat_map(|&[a, b, c]| [[a, b], [b, c]]));
        let edges = edges(input.mesh);
        pairs.extend_from_slice(&edges);
        let angle_sums = angle_sums(input.mesh, options.offsets);
        for sum in &angle_sums {
            let group = sum.angles.as_flattened();
            for (k, &a) in group.iter().enumerate() {
                pairs.extend(group[..k].iter().map(|&b| [a, b]));
            }
        }
        let matrix = BlockMatrix::new(count, pairs);
        let symbolic = SymbolicCholesky::new(matrix.matrix())?;
        let vertices = input.mesh.vertices.clone();
        let mut state = Self {
            input,
            reference,
            options,
            edge,
            limit,
            border_limit: limit.min(BORDER_LIMIT * width(&input.mesh.vertices)),
            asked: vertices.clone(),
            vertices,
            on_border,
            at_corner: vec![false; count],
            pinned,
            feet: vec![],
            anchors: vec![options.anchor; count],
            hold: vec![1.0; count],
            border_trace: BorderTrace::default(),
            emphasis: vec![1.0; count],
            drawn: vec![false; count],
            multipliers: input.mesh.faces().map(|f| vec![0.0; f.len()]).collect(),
            stiffness: vec![1.0; edges.len()],
            may_split,
            freed: vec![false; input.mesh.face_count()],
            is_cautious: false,
            edges,
            angle_sums,
            feature_terms: feature_terms(input, options, edge),
            matrix,
            symbolic,
            rounds: 0,
        };
        if !state.vertices.is_empty() && reference.closest_on_border(&state.vertices[0], None).is_none() {
            state.on_border.fill(false);
        }
        state.feet = (0..count).map(|v| state.ask(v, input.parameters.map(|p| p[v]))).collect();
        if let Some(index) =
            state.feet.iter().position(|f| !f.point.iter().chain(f.direction.iter()).all(|x| x.is_finite()))
        {
            return Err(Error::NotFinite { what: "closest point on the reference of vertex", index });
        }
        state.at_corner = (0..count).map(|v| state.is_at_corner(v)).collect();
        let allowed = BORDER_GAP * edge;
        let parameters: Vec<[f64; 2]> = state.feet.iter().map(|foot| foot.parameters).collect();
        let sides = border_sides(input.mesh);
        state.border_trace =
            BorderTrace::new(&state.vertices, &sides, &state.on_border, &parameters, reference, edge, allowed);
        for (v, turn) in border_turns(input.mesh) {
            if state.on_border[v as usize] {
                state.anchors[v as usize] *= 1.0 + TURN_ANCHOR * turn * turn;
            }
        }
        Ok(state)
    }

    fn ask(&self, vertex: usize, hint: Option<[f64; 2]>) -> Foot {
        let point = &self.vertices[vertex];
        let border = if self.on_border[vertex] { self.reference.closest_on_border(point, hint) } else { None };
        border.unwrap_or_else(|| self.reference.closest(point, hint))
    }

    fn is_at_corner(&self, vertex: usize) -> bool {
        let foot = &self.feet[vertex];
        let near = (self.vertices[vertex] - foot.point).norm() < STALE * self.edge;
        self.on_border[vertex] && near && foot.direction == Vector3::zeros()
    }

    /// Asks again for the closest points of vertices that moved by more than `tolerance` mean edges.
    fn refresh(&mut self, tolerance: f64) {
        for v in 0..self.vertices.len() {
            if !self.at_corner[v] && (self.vertices[v] - self.asked[v]).norm() > tolerance * self.edge {
                self.feet[v] = self.ask(v, Some(self.feet[v].parameters));
                self.asked[v] = self.vertices[v];
            }
        }
    }

    /// Largest planarity of a face that should be planar, and largest deviation over the limit.
    fn measure(&self) -> (f64, f64) {
        let mesh = PanelMesh { vertices: self.vertices.clone(), ..self.input.mesh.clone() };
        let bound = planarity(&mesh).into_iter().zip(&self.freed).filter(|(_, freed)| !**freed);
        let worst = bound.map(|(p, _)| p).fold(0.0, f64::max);
        let far = (0..self.vertices.len()).map(|v| self.distance(v)).fold(0.0, f64::max);
        (worst, far / self.limit)
    }

    /// Distance of a vertex from the reference over what it should not exceed, which is less on the border.
    fn strain(&self, vertex: usize) -> f64 {
        let limit = if self.on_border[vertex] { self.border_limit } else { self.limit };
        self.distance(vertex) / limit
    }

    /// The same for each vertex, and for those on the border how far the border is from edges there over what it should be, if that is more.
    fn strains(&self) -> Vec<f64> {
        let mut strains = self.border_trace.strains(&self.vertices);
        strains.iter_mut().enumerate().for_each(|(v, strain)| *strain = strain.max(self.strain(v)));
        strains
    }

    /// Distance of a vertex from the reference, exact to second order in its motion since its foot was asked for.
    fn distance(&self, vertex: usize) -> f64 {
        let offset = self.vertices[vertex] - self.feet[vertex].point;
        if self.on_border[vertex] && self.asked[vertex] != self.vertices[vertex] {
            let t = self.feet[vertex].direction;
            (offset - t * t.dot(&offset)).norm()
        } else if self.asked[vertex] != self.vertices[vertex] {
            self.feet[vertex].direction.dot(&offset).abs()
        } else {
            offset.norm()
        }
    }

    /// Faces that should be planar and miss `target`, or turned over, and edges that all but collapsed, compared with the start.
    fn spoiled(&self, target: f64) -> Spoiled {
        let before = &self.input.mesh.vertices;
        let area = |vertices: &[Point3<f64>], face: &[u32]| -> Vector3<f64> {
            let origin = vertices[face[0] as usize];
            (1..face.len() - 1)
                .map(|k| (vertices[face[k] as usize] - origin).cross(&(vertices[face[k + 1] as usize] - origin)))
                .sum()
        };
        let length = |vertices: &[Point3<f64>], [a, b]: [u32; 2]| (vertices[a as usize] - vertices[b as usize]).norm();
        let turned = |face: &[u32]| area(before, face).dot(&area(&self.vertices, face)) < 0.0;
        let collapsed = |edge: [u32; 2]| length(&self.vertices, edge) < COLLAPSED * length(before, edge);
        let mesh = self.input.mesh;
        let bent: Vec<bool> = if target < f64::INFINITY {
            let moved = PanelMesh { vertices: self.vertices.clone(), ..mesh.clone() };
            planarity(&moved).into_iter().zip(&self.freed).map(|(p, freed)| p > target && !freed).collect()
        } else {
            vec![false; mesh.face_count()]
        };
        Spoiled {
            faces: (0..mesh.face_count()).filter(|&f| turned(mesh.face(f)) || bent[f]).collect(),
            edges: (0..self.edges.len()).filter(|&e| collapsed(self.edges[e])).collect(),
        }
    }

    /// The edges of a face, as places in the list of edges.
    fn edges_around(&self, face: usize) -> impl Iterator<Item = usize> + '_ {
        let face = self.input.mesh.face(face);
        (0..face.len()).filter_map(|k| {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            self.edges.binary_search(&[a.min(b), a.max(b)]).ok()
        })
    }

    /// The edges of the spoiled faces, and the spoiled edges; ascending.
    fn edges_of(&self, spoiled: &Spoiled) -> Vec<usize> {
        let mut edges = spoiled.edges.clone();
        edges.extend(spoiled.faces.iter().flat_map(|&f| self.edges_around(f)));
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// The faces with an edge among `edges`, which ascend; ascending.
    fn faces_at(&self, edges: &[usize]) -> Vec<usize> {
        let is_there = |f: &usize| self.edges_around(*f).any(|e| edges.binary_search(&e).is_ok());
        (0..self.input.mesh.face_count()).filter(is_there).collect()
    }

    /// Makes edges stiffer, those of `spoiled` above all.
    fn stiffen(&mut self, spoiled: &Spoiled, all: f64) {
        let edges = self.edges_of(spoiled);
        edges.iter().for_each(|&e| self.stiffness[e] *= STIFFENING_THERE);
        self.stiffness.iter_mut().for_each(|s| *s = (*s * all).min(LARGEST_STIFFNESS));
    }

    /// Answers to a spoiled mesh, the milder ones first: stiffer edges, there above all; then faces there that need not be
    /// planar because they may be split; where those do not help and any may be split, the spoiled ones.
    fn repair(&mut self, spoiled: &Spoiled, attempt: usize) {
        self.stiffen(spoiled, STIFFENING);
        if attempt >= STIFFENINGS {
            let mut faces = self.faces_at(&self.edges_of(spoiled));
            faces.retain(|&f| self.may_split[f]);
            if self.options.split_beyond.is_some() && faces.iter().all(|&f| self.freed[f]) {
                faces.clone_from(&spoiled.faces);
            }
            faces.iter().for_each(|&f| self.freed[f] = true);
        }
    }

    /// Lets faces off being planar that may be split, or any as a last resort, and have a corner farther from the reference than it should be.
    fn release_strained(&mut self, any: bool) {
        let strains = self.strains();
        let any = any && self.options.split_beyond.is_some();
        for (f, face) in self.input.mesh.faces().enumerate() {
            self.freed[f] |= (any || self.may_split[f]) && face.iter().any(|&v| strains[v as usize] > 1.0);
        }
    }

    /// Largest of [`State::strains`].
    fn largest_strain(&self) -> f64 {
        self.strains().into_iter().fold(0.0, f64::max)
    }

    fn restart(&mut self) {
        self.vertices.clone_from(&self.input.mesh.vertices);
        self.multipliers.iter_mut().for_each(|m| m.fill(0.0));
        self.emphasis.fill(1.0);
        self.drawn.fill(false);
        self.hold.fill(1.0);
        self.refresh(0.0);
    }

    /// Attempts at a planar mesh that covers its border; if none is sound or close enough, more cautious ones that may leave bends of the border
    /// behind; at last the compromise.
    fn run(&mut self, control: &Control) -> Result<(), Error> {
        if self.attempts(control)? {
            return Ok(());
        }
        self.border_trace = BorderTrace::default();
        self.is_cautious = true;
        self.stiffness.fill(1.0);
        self.freed.fill(false);
        self.restart();
        if self.attempts(control)? {
            return Ok(());
        }
        self.compromise(control)
    }

    /// Searches and projects, again with other weights where that spoils the mesh or strays too far. Whether the vertices are a planar mesh within the
    /// allowance now.
    fn attempts(&mut self, control: &Control) -> Result<bool, Error> {
        let end = self.rounds + self.options.rounds;
        // The planar mesh that strays least, how far it does, and the faces that need not be planar there.
        let mut best: Option<(f64, Vec<Point3<f64>>, Vec<bool>)> = None;
        let mut strayed = 0;
        for attempt in 0..ATTEMPTS {
            self.balance((self.rounds + BALANCE_ROUNDS[attempt.min(1)]).min(end), control)?;
            let sound = self.vertices.clone();
            self.project(control)?;
            let spoiled = self.spoiled(self.options.target);
            if spoiled.is_empty() {
                let strain = self.largest_strain();
                if best.as_ref().is_none_or(|b| strain < b.0) {
                    best = Some((strain, self.vertices.clone(), self.freed.clone()));
                }
                if strain <= 1.0 || strayed >= DRAWN_IN {
                    break;
                }
                for v in 0..self.vertices.len() {
                    self.drawn[v] |= self.strain(v) > 1.0;
                }
                if strayed > 0 {
                    self.release_strained(strayed >= RESORT);
                }
                strayed += 1;
            } else {
                self.repair(&spoiled, attempt);
            }
            self.vertices = sound;
            self.refresh(0.0);
        }
        if let Some((_, vertices, freed)) = best {
            (self.vertices, self.freed) = (vertices, freed);
            self.refresh(0.0);
            return Ok(self.measure().1 <= self.options.allowance);
        }
        Ok(false)
    }

    /// One round after which no face is turned over and no edge collapsed that was not before: vertices there go a part of their way only, and
    /// the edges there become stiffer. Returns the longest step, in mean edges, and the faces that stayed where they were.
    fn sound_round(&mut self, control: &Control) -> Result<(Step, Vec<usize>), Error> {
        let before = self.vertices.clone();
        let (step, _) = self.round(Phase::Balance, control)?;
        let mut stuck = vec![];
        for shortening in 0..SHORTENINGS {
            let spoiled = self.spoiled(f64::INFINITY);
            if spoiled.is_empty() {
                break;
            }
            let share = if shortening < HALVINGS { 0.5 } else { 0.0 };
            if shortening < HALVINGS {
                self.stiffen(&spoiled, 1.0);
            } else if shortening == HALVINGS {
                stuck.clone_from(&spoiled.faces);
            }
            let there = if self.is_cautious { (0..self.vertices.len()).collect() } else { self.vertices_of(&spoiled) };
            for v in there {
                self.vertices[v] = before[v] + (self.vertices[v] - before[v]) * share;
            }
            if shortening + 1 == SHORTENINGS && !self.spoiled(f64::INFINITY).is_empty() {
                self.vertices.clone_from(&before);
            }
        }
        Ok((step, stuck))
    }

    /// The corners of the spoiled faces and the ends of the spoiled edges, ascending.
    fn vertices_of(&self, spoiled: &Spoiled) -> Vec<usize> {
        let mesh = self.input.mesh;
        let corners = spoiled.faces.iter().flat_map(|&f| mesh.face(f)).copied();
        let ends = spoiled.edges.iter().flat_map(|&e| self.edges[e]);
        let mut vertices: Vec<usize> = corners.chain(ends).map(|v| v as usize).collect();
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    }

    /// Minimum of the soft terms under the constraints; where vertices leave the allowed deviation, their weights grow.
    fn balance(&mut self, end: usize, control: &Control) -> Result<(), Error> {
        let (mut shortest, mut idle, mut growths) = (f64::INFINITY, 0, 0);
        let mut last_strain = 0.0;
        // Faces that kept all rounds so far from going their way, and how many.
        let (mut stuck, mut stuck_for) = (vec![], 0);
        while self.rounds < end {
            let (Step { longest: step, typical }, faces) = self.sound_round(control)?;
            let same: Vec<usize> = faces.iter().copied().filter(|f| stuck.contains(f)).collect();
            (stuck, stuck_for) = if same.is_empty() { (faces, 0) } else { (same, stuck_for + 1) };
            if stuck_for >= STUCK_ROUNDS && !self.is_cautious {
                break;
            }
            // Closest points on a reference of flat triangles jump: then steps stay small without shrinking.
            idle = if step > (0.9 * shortest).max(shortest - 0.3 * LONGEST_STEP) { idle + 1 } else { 0 };
            let is_settled =
                step < STEP_TOLERANCE || (step > 0.7 * shortest && step < 50.0 * STEP_TOLERANCE) || idle > 3;
            shortest = shortest.min(step);
            if !is_settled && step > GROWTH_STEP && typical > TYPICAL_GROWTH_STEP {
                continue;
            }
            self.refresh(STALE);
            // A strain that still falls by itself needs no more weight.
            let strain = self.largest_strain();
            let stays = strain > 0.9 && (is_settled || strain > FALLING * last_strain && last_strain > 0.0);
            last_strain = strain;
            if stays && growths < GROWTHS && self.rounds + 3 < end {
                self.grow();
                growths += 1;
            } else if is_settled || strain <= 0.9 && typical < TYPICAL_STEP {
                break;
            }
        }
        self.refresh(STALE);
        Ok(())
    }

    /// More weight for vertices that strain the limits, so that they end within them.
    fn grow(&mut self) {
        let largest = [self.options.closeness, self.options.border].map(|w| (LARGEST_WEIGHT / w).max(1.0));
        let growth = |strain: f64| (strain / 0.7).powi(2).clamp(1.0, 30.0);
        let gaps = self.border_trace.strains(&self.vertices);
        for (v, gap) in gaps.into_iter().enumerate() {
            let bound = largest[usize::from(self.on_border[v])];
            self.emphasis[v] = (self.emphasis[v] * growth(self.strain(v))).min(bound);
            self.hold[v] = (self.hold[v] * growth(gap)).min(LARGEST_HOLD);
        }
    }

    /// Planar and close contradict each other: the stiffest penalty that keeps within the deviation.
    fn compromise(&mut self, control: &Control) -> Result<(), Error> {
        self.restart();
        self.freed.fill(false);
        let mut best = (self.vertices.clone(), self.measure());
        for penalty in [1.0, 1e1, 3e1, 1e2, 3e2, 1e3, 3e3, 1e4] {
            for _ in 0..6 {
                if self.round(Phase::Penalty(penalty), control)?.0.longest < STEP_TOLERANCE {
                    break;
                }
            }
            self.refresh(0.0);
            let measured = self.measure();
            let spoiled = self.spoiled(f64::INFINITY);
            if measured.1 > 1.0 || !spoiled.is_empty() {
                break;
            }
            if measured.0 < best.1.0 {
                best = (self.vertices.clone(), measured);
            }
        }
        self.vertices = best.0;
        self.refresh(0.0);
        Ok(())
    }

    /// Rounds of projection until the residuals are at rounding level.
    fn project(&mut self, control: &Control) -> Result<(), Error> {
        let mut best = (self.vertices.clone(), self.measure().0);
        // The soft terms' forces, which the multipliers hold up, are gone now.
        let multipliers = self.multipliers.clone();
        self.multipliers.iter_mut().for_each(|m| m.fill(0.0));
        for _ in 0..8 {
            if best.1 <= 1e-12 {
                break;
            }
            let (step, system) = self.round(Phase::Project, control)?;
            let worst = self.measure().0;
            if worst >= 0.5 * best.1 && step.longest < LONGEST_STEP {
                if worst < best.1 {
                    best = (self.vertices.clone(), worst);
                }
                break;
            }
            best = (self.vertices.clone(), worst);
            for _ in 0..CORRECTIONS {
                if best.1 <= 1e-12 || step.longest > LONGEST_STEP {
                    break;
                }
                self.correct(&system);
                let corrected = self.measure().0;
                let converges = corrected < 0.3 * best.1;
                if corrected < best.1 {
                    best = (self.vertices.clone(), corrected);
                }
                if !converges {
                    break;
                }
            }
            self.vertices.clone_from(&best.0);
        }
        self.multipliers = multipliers;
        self.vertices = best.0;
        self.refresh(0.0);
        Ok(())
    }

    /// A step towards planarity with the factorization of a round before.
    fn correct(&mut self, system: &System) {
        let mut step = vec![0.0; 3 * self.vertices.len()];
        for (face, equation) in self.input.mesh.faces().zip(&system.equations) {
            let Some(equation) = equation else { continue };
            let corners: Vec<_> = face.iter().map(|&v| self.vertices[v as usize].coords / self.edge).collect();
            let Some(now) = FaceEquations::new(&corners) else { continue };
            for (&v, residual) in face.iter().zip(&now.residual) {
                let force = equation.normal * (PENALTY * residual * now.normal.dot(&equation.normal).signum());
                (0..3).for_each(|a| step[3 * v as usize + a] -= force[a]);
            }
        }
        for v in (0..self.vertices.len()).filter(|&v| self.pinned[v]) {
            step[3 * v..3 * v + 3].fill(0.0);
        }
        system.factor.solve(&mut step);
        for (point, s) in self.vertices.iter_mut().zip(step.chunks_exact(3)) {
            *point += Vector3::from_row_slice(s) * self.edge;
        }
    }

    /// One Newton round; returns the step that it asked for and the system it solved.
    fn round(&mut self, phase: Phase, control: &Control) -> Result<(Step, System), Error> {
        control.check()?;
        self.rounds += 1;
        if phase != Phase::Project {
            self.refresh(STALE);
        }
        let mesh = self.input.mesh;
        let count = self.vertices.len();
        let gradient = self.soft_terms(phase);

        let penalty = if let Phase::Penalty(penalty) = phase { penalty } else { PENALTY };
        let mut equations = Vec::with_capacity(mesh.face_count());
        for (f, face) in mesh.faces().enumerate() {
            let corners: Vec<_> = face.iter().map(|&v| self.vertices[v as usize].coords / self.edge).collect();
            let equation = if self.freed[f] { None } else { FaceEquations::new(&corners) };
            if let Some(equation) = &equation {
                let block = equation.normal * equation.normal.transpose() * penalty;
                for i in 0..face.len() {
                    for j in 0..=i {
                        if !self.pinned[face[i] as usize] && !self.pinned[face[j] as usize] {
                            self.matrix.add(face[i], face[j], &(block * equation.projector[i * face.len() + j]));
                        }
                    }
                }
                // Only what the present equations can transmit.
                self.multipliers[f] = product(&equation.projector, &self.multipliers[f]);
            }
            equations.push(equation);
        }
        let factor = self.symbolic.factorize(self.matrix.matrix(), "planarization")?;

        let mut step = vec![0.0; 3 * count];
        for _ in 0..UPDATES {
            let excess = self.fairness_excess(&step);
            step.iter_mut().zip(&gradient).zip(&excess).for_each(|((s, g), e)| *s = e - g);
            for (f, face) in mesh.faces().enumerate() {
                let Some(equation) = &equations[f] else { continue };
                for (k, &v) in face.iter().enumerate() {
                    let force = equation.normal * (self.multipliers[f][k] + penalty * equation.residual[k]);
                    (0..3).for_each(|a| step[3 * v as usize + a] -= force[a]);
                }
            }
            for v in (0..count).filter(|&v| self.pinned[v]) {
                step[3 * v..3 * v + 3].fill(0.0);
            }
            factor.solve(&mut step);
            if matches!(phase, Phase::Penalty(_)) {
                continue;
            }
            for (f, face) in mesh.faces().enumerate() {
                let Some(equation) = &equations[f] else { continue };
                let moved: Vec<f64> =
                    face.iter().map(|&v| (0..3).map(|a| equation.normal[a] * step[3 * v as usize + a]).sum()).collect();
                for (k, change) in product(&equation.projector, &moved).into_iter().enumerate() {
                    self.multipliers[f][k] += penalty * (equation.residual[k] + change);
                }
            }
        }

        let longest = step.chunks_exact(3).map(|s| Vector3::from_row_slice(s).norm()).fold(0.0, f64::max);
        if !longest.is_finite() {
            return Err(Error::Degenerate { reason: "a planarization step is not finite".into() });
        }
        // Neighbours that move together keep their panels' shapes, and may move farther.
        let at = |v: u32| Vector3::from_row_slice(&step[3 * v as usize..3 * v as usize + 3]);
        let strain = self.edges.iter().map(|&[a, b]| (at(a) - at(b)).norm()).fold(0.0, f64::max);
        let scale = self.edge * (LONGEST_STEP / longest.min(strain.max(longest * JOINT_STEP))).min(1.0);
        for (point, s) in self.vertices.iter_mut().zip(step.chunks_exact(3)) {
            *point += Vector3::from_row_slice(s) * scale;
        }
        let typical = (step.iter().map(|s| s * s).sum::<f64>() / count as f64).sqrt();
        Ok((Step { longest, typical }, System { factor, equations }))
    }

    /// What the matrix has too much of the fairness term's Hessian, times a step.
    fn fairness_excess(&self, step: &[f64]) -> Vec<f64> {
        let mut excess = vec![0.0; step.len()];
        for &[a, _, c] in self.input.polylines {
            for (v, w) in [(a as usize, c as usize), (c as usize, a as usize)] {
                if !self.pinned[v] {
                    (0..3)
                        .for_each(|k| excess[3 * v + k] += self.options.fairness * (step[3 * v + k] - step[3 * w + k]));
                }
            }
        }
        excess
    }

    /// Fills the matrix with the soft terms' Hessian and returns their gradient, both in units of the mean edge.
    fn soft_terms(&mut self, phase: Phase) -> Vec<f64> {
        let options = self.options;
        let count = self.vertices.len();
        let mut gradient = vec![0.0; 3 * count];
        self.matrix.clear();
        let with_gradient = phase != Phase::Project;
        for v in 0..count {
            if self.pinned[v] {
                self.matrix.add(v as u32, v as u32, &Matrix3::identity());
                continue;
            }
            let foot = &self.feet[v];
            let d = foot.direction;
            let along = d * d.transpose();
            let block = if self.drawn[v] {
                let weight = if self.on_border[v] { options.border } else { options.closeness };
                Matrix3::identity() * (weight * self.emphasis[v])
            } else if self.on_border[v] {
                (Matrix3::identity() - along) * (options.border * self.emphasis[v])
            } else {
                along * (options.closeness * self.emphasis[v])
            };
            let anchor = self.anchors[v] * self.hold[v];
            self.matrix.add(v as u32, v as u32, &(block + Matrix3::identity() * anchor));
            if with_gradient {
                let offset = (self.vertices[v] - foot.point) / self.edge;
                let drift = (self.vertices[v] - self.input.mesh.vertices[v]) / self.edge;
                let g = block * offset + drift * anchor;
                (0..3).for_each(|a| gradient[3 * v + a] += g[a]);
            }
        }
        for (&[v, w], stiffness) in self.edges.iter().zip(&self.stiffness) {
            let (before, after) = (
                self.input.mesh.vertices[w as usize] - self.input.mesh.vertices[v as usize],
                self.vertices[w as usize] - self.vertices[v as usize],
            );
            // Strains count, so that slivers keep their shape. A collapsed edge would make its faces planar: shrinking edges are
            // held ever more firmly.
            let length = (before.norm() / self.edge).clamp(1e-2, 1.0);
            let left = (2.0 * after.norm() / before.norm().max(f64::MIN_POSITIVE)).clamp(1e-1, 1.0);
            let weight = options.stretch * stiffness / (length * left).powi(2);
            let change = (after - before) * (weight / self.edge);
            let block = Matrix3::identity() * weight;
            for (a, b, sign) in [(v, w, -1.0), (w, v, 1.0)] {
                if self.pinned[a as usize] {
                    continue;
                }
                self.matrix.add(a, a, &block);
                if a > b && !self.pinned[b as usize] {
                    self.matrix.add(a, b, &-block);
                }
                if with_gradient {
                    (0..3).for_each(|k| gradient[3 * a as usize + k] += sign * change[k]);
                }
            }
        }
        for sum in &self.angle_sums {
            let Some((value, gradients)) = sum.evaluate(&self.vertices) else { continue };
            for (&v, g) in sum.angles.as_flattened().iter().zip(gradients.as_flattened()) {
                if self.pinned[v as usize] {
                    continue;
                }
                let scaled = g * (options.offset_weight * self.edge);
                for (&w, h) in sum.angles.as_flattened().iter().zip(gradients.as_flattened()) {
                    if w <= v && !self.pinned[w as usize] {
                        self.matrix.add(v, w, &(scaled * (h * self.edge).transpose()));
                    }
                }
                if with_gradient {
                    (0..3).for_each(|a| gradient[3 * v as usize + a] += value * scaled[a]);
                }
            }
        }
        for term in &self.feature_terms {
            let mut slip = 0.0;
            for (&v, c) in term.corners.iter().zip(term.factors) {
                slip += term.across.dot(&self.vertices[v as usize].coords) * c / self.edge;
            }
            for (i, &v) in term.corners.iter().enumerate() {
                if self.pinned[v as usize] {
                    continue;
                }
                for (j, &w) in term.corners.iter().enumerate() {
                    if w <= v && !self.pinned[w as usize] {
                        let block = term.across * term.across.transpose();
                        self.matrix.add(v, w, &(block * (term.weight * term.factors[i] * term.factors[j])));
                    }
                }
                if with_gradient {
                    let g = term.across * (term.weight * term.factors[i] * slip);
                    (0..3).for_each(|a| gradient[3 * v as usize + a] += g[a]);
                }
            }
        }
        for triple in self.input.polylines {
            let factors = [1.0, -2.0, 1.0];
            let mut change = Vector3::zeros();
            for (&v, c) in triple.iter().zip(factors) {
                change += (self.vertices[v as usize] - self.input.mesh.vertices[v as usize]) * (c / self.edge);
            }
            // Twice the squared differences along the two edges instead of the squared second difference: what is too much, the squared difference of
            // the ends, is put right when the system is solved, and without its block the factor is a third as full.
            let block = Matrix3::identity() * (2.0 * options.fairness);
            for (v, w) in [(triple[0], triple[1]), (triple[2], triple[1])] {
                for (a, b) in [(v, w), (w, v)] {
                    if v != w && !self.pinned[a as usize] {
                        self.matrix.add(a, a, &block);
                        if a > b && !self.pinned[b as usize] {
                            self.matrix.add(a, b, &-block);
                        }
                    }
                }
            }
            if with_gradient {
                for (&v, c) in triple.iter().zip(factors).filter(|(v, _)| !self.pinned[**v as usize]) {
                    let g = change * (options.fairness * c);
                    (0..3).for_each(|a| gradient[3 * v as usize + a] += g[a]);
                }
            }
        }
        gradient
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::grid_triples;
    use nalgebra::{Rotation3, Translation3};

    /// A grid of (nu + 1) x (nv + 1) vertices over [0, 1]^2.
    fn grid(nu: u32, nv: u32, at: impl Fn(f64, f64) -> [f64; 3]) -> PanelMesh {
        let vertices = (0..=nu)
            .flat_map(|i| (0..=nv).map(move |j| (i as f64 / nu as f64, j as f64 / nv as f64)))
            .map(|(s, t)| Point3::from(at(s, t)))
            .collect();
        let faces: Vec<[u32; 4]> = (0..nu * nv)
            .map(|k| {
                let a = k / nv * (nv + 1) + k % nv;
                [a, a + nv + 1, a + nv + 2, a + 1]
            })
            .collect();
        PanelMesh::new(vertices, &faces).unwrap()
    }

    /// A repeatable perturbation of size `size`.
    fn shaken(mesh: &PanelMesh, size: f64) -> PanelMesh {
        let noise = |k: f64| (k * 12.9898).sin() * 43758.5453 % 1.0;
        let vertices = mesh
            .vertices
            .iter()
            .enumerate()
            .map(|(i, p)| p + Vector3::from_fn(|a, _| noise((3 * i + a + 1) as f64)) * size)
            .collect();
        PanelMesh { vertices, ..mesh.clone() }
    }

    struct Implicit<F: Fn(&Point3<f64>) -> (Point3<f64>, Vector3<f64>)>(F);

    impl<F: Fn(&Point3<f64>) -> (Point3<f64>, Vector3<f64>)> Reference for Implicit<F> {
        fn closest(&self, point: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
            let (point, direction) = (self.0)(point);
            Foot { point, direction, parameters: [0.0; 2] }
        }
        fn closest_on_border(&self, _: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
            None
        }
    }

    fn run(mesh: &PanelMesh, reference: Option<&dyn Reference>) -> Planarized {
        let (border, polylines) = (border_vertices(mesh), grid_triples(mesh, |_| false));
        let input = PlanarizeInput { reference, border: &border, polylines: &polylines, ..PlanarizeInput::new(mesh) };
        planarize(&input, &PlanarizeOptions::default(), &Control::default()).unwrap()
    }

    fn farthest(a: &PanelMesh, b: &PanelMesh) -> f64 {
        a.vertices.iter().zip(&b.vertices).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
    }

    fn translational(s: f64, t: f64) -> [f64; 3] {
        [8.0 * s, 6.0 * t, (3.0 * s).sin() + 1.5 * (2.0 * t).cos()]
    }

    /// Quads on a sphere of radius 5 that are not planar.
    fn skew_sphere(n: u32) -> PanelMesh {
        grid(n, n, |s, t| {
            let (a, b) = (1.6 * (s - 0.5), 1.4 * (t - 0.5));
            (Vector3::new(a.tan(), b.tan() + 0.2 * a, 1.0).normalize() * 5.0).into()
        })
    }

    fn sphere() -> impl Reference {
        Implicit(|p: &Point3<f64>| {
            let n = p.coords.normalize();
            (Point3::from(n * 5.0), n)
        })
    }

    /// The saddle z = (x^2 - y^2) / 8 over a square, on a net turned by `degrees` from its principal net.
    fn saddle(degrees: f64) -> PanelMesh {
        let (sin, cos) = degrees.to_radians().sin_cos();
        grid(16, 16, move |s, t| {
            let (x, y) = (6.0 * (s - 0.5), 6.0 * (t - 0.5));
            let (x, y) = (x * cos - y * sin, x * sin + y * cos);
            [x, y, (x * x - y * y) / 8.0]
        })
    }

    #[test]
    fn a_translational_net_is_left_alone() {
        let mesh = grid(16, 12, translational);
        let result = run(&mesh, None);
        assert!(farthest(&mesh, &result.mesh) < 1e-9 && result.is_planar && result.is_close);
    }

    #[test]
    fn a_shaken_translational_net_becomes_planar() {
        let mesh = shaken(&grid(16, 12, translational), 0.02);
        let result = run(&mesh, None);
        assert!(result.planarity_max() < 1e-10 && result.is_close && result.rounds < 20, "{}", result.rounds);
    }

    #[test]
    fn nets_on_curved_surfaces_become_planar_and_stay_close() {
        let mesh = skew_sphere(16);
        let result = run(&mesh, Some(&sphere()));
        assert!(planarity(&mesh).into_iter().fold(0.0, f64::max) > 1e-2);
        assert!(result.planarity_max() < 1e-10 && result.is_close && result.rounds < 20);

        for degrees in [5.0, 10.0, 20.0] {
            let mesh = saddle(degrees);
            let reference = MeshReference::from_panels(&mesh);
            let result = run(&mesh, Some(&reference));
            assert!(result.planarity_max() < 1e-8 && result.is_close, "{degrees}: {}", result.deviation_max());
        }
    }

    #[test]
    fn rulings_of_a_saddle_are_given_up_with_numbers() {
        // All edges asymptotic: no planar net close to the surface has this layout.
        let mesh = saddle(45.0);
        let result = run(&mesh, None);
        let before = planarity(&mesh).into_iter().fold(0.0, f64::max);
        assert!(result.planarity_max() <= before && result.deviation_max() <= 3.0 * result.deviation_limit);
        assert_eq!(result.is_planar, result.planarity_max() <= 1e-6);
        assert!(!result.is_planar || !result.is_close);
    }

    #[test]
    fn newton_converges_quadratically() {
        let mesh = skew_sphere(12);
        let (border, polylines) = (border_vertices(&mesh), grid_triples(&mesh, |_| false));
        let input = PlanarizeInput { border: &border, polylines: &polylines, ..PlanarizeInput::new(&mesh) };
        let options = PlanarizeOptions::default();
        let reference = sphere();
        let edge = mean_edge_length(&mesh);
        let mut state = State::new(&input, &reference, &options, edge, 0.1).unwrap();
        let mut trace = vec![state.measure().0];
        for _ in 0..8 {
            state.round(Phase::Project, &Control::default()).unwrap();
            trace.push(state.measure().0);
        }
        let fast = trace.windows(2).any(|w| w[0] < 1e-3 && w[0] > 1e-6 && w[1] < 30.0 * w[0] * w[0]);
        assert!(fast && trace[8] < 1e-12, "{trace:?}");
    }

    #[test]
    fn face_equations_match_finite_differences_on_planar_faces() {
        let flat = [[0.0, 0.0], [1.1, -0.2], [1.7, 0.8], [0.9, 1.6], [-0.3, 0.9]];
        let frame = Rotation3::from_euler_angles(0.4, -1.1, 2.0);
        for count in [4, 5] {
            let corners: Vec<Vector3<f64>> =
                flat[..count].iter().map(|p| frame * Vector3::new(p[0], p[1], 0.3)).collect();
            let equation = FaceEquations::new(&corners).unwrap();
            let h = 1e-6;
            for corner in 0..count {
                for axis in 0..3 {
                    let value = |sign: f64| {
                        let mut moved = corners.clone();
                        moved[corner][axis] += sign * h;
                        FaceEquations::new(&moved).unwrap().residual
                    };
                    for (k, (a, b)) in value(1.0).iter().zip(value(-1.0)).enumerate() {
                        let expected = equation.projector[k * count + corner] * equation.normal[axis];
                        assert!(((a - b) / (2.0 * h) - expected).abs() < 1e-8);
                    }
                }
            }
        }
    }

    #[test]
    fn soft_gradient_matches_finite_differences() {
        let mesh = grid(4, 3, translational);
        let (border, polylines) = (border_vertices(&mesh), grid_triples(&mesh, |_| false));
        let line = [0.2, 0.45, 0.8].map(|s| Point3::from(translational(s, 0.3 + 0.2 * s))).to_vec();
        let input = PlanarizeInput {
            border: &border,
            pins: &[7],
            polylines: &polylines,
            feature_lines: &[line],
            ..PlanarizeInput::new(&mesh)
        };
        let options = PlanarizeOptions::default();
        let reference = MeshReference::from_panels(&mesh);
        let edge = mean_edge_length(&mesh);
        let mut state = State::new(&input, &reference, &options, edge, 0.1).unwrap();
        assert_eq!(state.feature_terms.len(), 2);
        state.vertices = shaken(&mesh, 0.05).vertices;
        state.vertices[7] = mesh.vertices[7];
        // Feet held where they were asked for.
        let energy = |state: &State| {
            let mut sum = 0.0;
            for v in 0..state.vertices.len() {
                let offset = (state.vertices[v] - state.feet[v].point) / edge;
                let along = state.feet[v].direction.dot(&offset);
                sum += if state.on_border[v] {
                    options.border * (offset.norm_squared() - along * along)
                } else {
                    options.closeness * along * along
                };
                sum += state.anchors[v] * ((state.vertices[v] - mesh.vertices[v]) / edge).norm_squared();
            }
            let change = |v: u32| (state.vertices[v as usize] - mesh.vertices[v as usize]) / edge;
            for &[a, b] in &state.edges {
                let length = (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm() / edge;
                sum += options.stretch * ((change(b) - change(a)) / length.min(1.0)).norm_squared();
            }
            for &[a, b, c] in &polylines {
                sum += options.fairness * (change(a) - change(b) * 2.0 + change(c)).norm_squared();
            }
            for term in &state.feature_terms {
                let part = |k: usize| state.vertices[term.corners[k] as usize].coords * (term.factors[k] / edge);
                let direction: Vector3<f64> = (0..4).map(part).sum();
                sum += term.weight * term.across.dot(&direction).powi(2);
            }
            sum
        };
        let gradient = state.soft_terms(Phase::Balance);
        for v in (0..state.vertices.len()).filter(|&v| v != 7) {
            for axis in 0..3 {
                let h = 1e-5;
                let start = state.vertices[v];
                state.vertices[v][axis] = start[axis] + h;
                let above = energy(&state);
                state.vertices[v][axis] = start[axis] - h;
                let below = energy(&state);
                state.vertices[v] = start;
                // The energy is a sum of squares without the factor one half, its unit is the mean edge.
                let difference = (above - below) / (2.0 * h) * edge / 2.0;
                assert!((difference - gradient[3 * v + axis]).abs() < 1e-6 * (1.0 + difference.abs()));
            }
        }
    }

    #[test]
    fn a_single_quad_ends_on_its_best_plane() {
        let h = 0.1;
        let vertices = [[1.0, 0.0, h], [0.0, 1.0, -h], [-1.0, 0.0, h], [0.0, -1.0, -h]].map(Point3::from).to_vec();
        let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
        let input = PlanarizeInput::new(&mesh);
        let options = PlanarizeOptions { closeness: 0.0, deviation: Some(1.0), ..PlanarizeOptions::default() };
        let result = planarize(&input, &options, &Control::default()).unwrap();
        assert!(result.mesh.vertices.iter().all(|p| p.z.abs() < 1e-9 && (p.coords.xy().norm() - 1.0).abs() < 1e-3));
    }

    #[test]
    fn the_answer_follows_motion_scale_and_renumbering() {
        let mesh = skew_sphere(6);
        let expected = run(&mesh, Some(&sphere())).mesh;

        let motion = Translation3::new(30.0, -7.0, 2.0) * Rotation3::from_euler_angles(0.3, 1.0, -2.0);
        let count = mesh.vertices.len() as u32;
        let moved = mesh.vertices.iter().rev().map(|p| motion * (p * 40.0)).collect();
        let faces: Vec<Vec<u32>> = mesh.faces().map(|f| f.iter().map(|v| count - 1 - v).collect()).collect();
        let center = motion * Point3::origin();
        let moved_sphere = Implicit(|p: &Point3<f64>| {
            let n = (p - center).normalize();
            (center + n * 200.0, n)
        });
        let result = run(&PanelMesh::new(moved, &faces).unwrap(), Some(&moved_sphere)).mesh;
        for (p, q) in expected.vertices.iter().rev().zip(&result.vertices) {
            assert!((motion * (p * 40.0) - q).norm() < 40.0 * 1e-6, "{}", (motion * (p * 40.0) - q).norm());
        }
    }

    #[test]
    fn offsets_are_approached_without_giving_up_planarity() {
        use crate::mesh::{circularity, conicality};
        // Parallels and meridians of a waisted surface, shaken: the circular and conical net is near.
        let mesh = grid(10, 10, |s, t| {
            let radius = 2.0 - 1.4 * t * (1.2 - t);
            [radius * (1.5 * s).cos(), radius * (1.5 * s).sin(), 3.0 * t]
        });
        let reference = MeshReference::from_panels(&mesh);
        let mesh = shaken(&mesh, 0.01);
        let border = border_vertices(&mesh);
        let polylines = grid_triples(&mesh, |_| false);
        let input = PlanarizeInput {
            reference: Some(&reference),
            border: &border,
            polylines: &polylines,
            ..PlanarizeInput::new(&mesh)
        };
        let try_with = |offsets| {
            let options = PlanarizeOptions { offsets, ..PlanarizeOptions::default() };
            planarize(&input, &options, &Control::default()).unwrap()
        };
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
        let (any, circular, conical) =
            (try_with(OffsetKind::Any), try_with(OffsetKind::Circular), try_with(OffsetKind::Conical));
        for result in [&any, &circular, &conical] {
            let (p, d) = (result.planarity_max(), result.deviation_max() / result.deviation_limit);
            assert!(p < 1e-10 && result.is_close, "{p:.1e} {d}");
        }
        assert!(mean(circularity(&circular.mesh)) < 0.1 * mean(circularity(&any.mesh)));
        assert!(mean(conicality(&conical.mesh)) < 0.1 * mean(conicality(&any.mesh)));
    }

    #[test]
    fn pins_hold_exactly() {
        let mesh = skew_sphere(8);
        let (border, polylines) = (border_vertices(&mesh), grid_triples(&mesh, |_| false));
        let pins = [0, 8, 40, 72, 80];
        let reference = sphere();
        let input = PlanarizeInput {
            reference: Some(&reference),
            border: &border,
            pins: &pins,
            polylines: &polylines,
            ..PlanarizeInput::new(&mesh)
        };
        let result = planarize(&input, &PlanarizeOptions::default(), &Control::default()).unwrap();
        assert!(result.planarity_max() < 1e-10);
        for v in pins {
            assert_eq!(mesh.vertices[v as usize], result.mesh.vertices[v as usize]);
        }
    }

    #[test]
    fn border_vertices_stay_on_the_border() {
        let mesh = saddle(10.0);
        let result = run(&mesh, None);
        assert!(result.is_planar && result.is_close);
        let reference = MeshReference::from_panels(&mesh);
        for v in border_vertices(&mesh) {
            let p = result.mesh.vertices[v as usize];
            let off = (reference.closest_on_border(&p, None).unwrap().point - p).norm();
            let deviation = result.deviation[v as usize];
            assert!(deviation < 5e-3 * 6.0, "{deviation}");
            // Those at corners are held against the corner, which may be farther than the nearest point of the border.
            let is_corner = [0, 16, 272, 288].contains(&v);
            assert!((off - deviation).abs() < 1e-12 || is_corner && deviation > off, "{off} {deviation}");
        }
    }

    #[test]
    fn larger_polygons_become_planar() {
        // A honeycomb on a sphere.
        let place = |x: f64, y: f64| Point3::new(x, y, (25.0 - x * x - y * y).sqrt());
        let (n, side) = (6, 0.35);
        let mut vertices: Vec<Point3<f64>> = vec![];
        let mut faces = vec![];
        for row in 0..n {
            for column in 0..n {
                let x = (column as f64 + 0.5 * (row % 2) as f64 - 2.7) * side * 3f64.sqrt();
                let y = (row as f64 - 2.5) * side * 1.5;
                let mut face = vec![];
                for k in 0..6 {
                    let angle = (k as f64 + 0.5) * std::f64::consts::FRAC_PI_3;
                    let p = place(x + side * angle.cos(), y + side * angle.sin());
                    let index = vertices.iter().position(|q| (q - p).norm() < 1e-6).unwrap_or_else(|| {
                        vertices.push(p);
                        vertices.len() - 1
                    });
                    face.push(index as u32);
                }
                faces.push(face);
            }
        }
        let mesh = shaken(&PanelMesh::new(vertices, &faces).unwrap(), 0.01);
        let result = run(&mesh, Some(&sphere()));
        assert!(planarity(&mesh).into_iter().fold(0.0, f64::max) > 1e-2);
        assert!(result.planarity_max() < 1e-10 && result.is_close, "{:?}", result.planarity_max());
    }

    #[test]
    fn hopeless_pins_give_a_result_with_numbers() {
        let vertices = [[1.0, 0.0, 0.3], [0.0, 1.0, -0.3], [-1.0, 0.0, 0.3], [0.0, -1.0, -0.3]];
        let mesh = PanelMesh::new(vertices.map(Point3::from).to_vec(), &[[0u32, 1, 2, 3]]).unwrap();
        let input = PlanarizeInput { pins: &[0, 1, 2, 3], ..PlanarizeInput::new(&mesh) };
        let result = planarize(&input, &PlanarizeOptions::default(), &Control::default()).unwrap();
        assert!(!result.is_planar && result.mesh == mesh);
        // As a last resort it may become triangles.
        let options = PlanarizeOptions { split_beyond: Some(1e-4), ..PlanarizeOptions::default() };
        let result = planarize(&input, &options, &Control::default()).unwrap();
        assert!(result.is_planar && result.mesh.face_count() == 2 && result.split == [0]);
        assert_eq!(result.mesh.vertices, mesh.vertices);
    }

    #[test]
    fn edges_turn_along_feature_lines() {
        use crate::mesh::feature_angle;
        let mesh = grid(10, 10, |s, t| [s, t, 0.2 * s * s]);
        let line = (0..=40).map(|k| 0.1 + 0.02 * f64::from(k));
        let lines = [line.map(|s| Point3::new(s, 0.4 + 0.12 * s, 0.2 * s * s)).collect::<Vec<_>>()];
        let reference = MeshReference::from_panels(&mesh);
        let polylines = grid_triples(&mesh, |_| false);
        let border = border_vertices(&mesh);
        let input = PlanarizeInput {
            reference: Some(&reference),
            border: &border,
            polylines: &polylines,
            feature_lines: &lines,
            ..PlanarizeInput::new(&mesh)
        };
        let result = planarize(&input, &PlanarizeOptions::default(), &Control::default()).unwrap();
        let angle = |mesh: &PanelMesh| {
            let [sum, length] = feature_angle(&lines, mesh);
            sum / length
        };
        assert!(angle(&mesh) > 5.0 && angle(&result.mesh) < 0.5 * angle(&mesh), "{}", angle(&result.mesh));
        assert!(result.planarity_max() < 1e-10 && result.is_close);
    }

    /// The plane z = 0 with a border that falls from a corner at (0, 0, 0.3) along x, reaching the plane at (0.5, 0, 0), and
    /// runs level along y.
    struct FallingCorner;

    impl Reference for FallingCorner {
        fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
            Foot { point: Point3::new(p.x, p.y, 0.0), direction: Vector3::z(), parameters: [0.0; 2] }
        }
        fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
            let corner = Point3::new(0.0, 0.0, 0.3);
            let feet = [Vector3::new(1.0, 0.0, -0.6).normalize(), Vector3::y()].map(|along| {
                let t = along.dot(&(p - corner)).max(0.0);
                let direction = if t > 0.0 { along } else { Vector3::zeros() };
                Foot { point: corner + along * t, direction, parameters: [0.0; 2] }
            });
            feet.into_iter().min_by(|a, b| (a.point - p).norm().total_cmp(&(b.point - p).norm()))
        }
    }

    #[test]
    fn corners_of_the_border_do_not_slide_along_a_side() {
        let vertices = [[0.0, 0.0, 0.3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].map(Point3::from).to_vec();
        let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
        let input = PlanarizeInput {
            reference: Some(&FallingCorner),
            border: &[0],
            pins: &[1, 2, 3],
            ..PlanarizeInput::new(&mesh)
        };
        let options = PlanarizeOptions { deviation: Some(1.0), ..PlanarizeOptions::default() };
        let result = planarize(&input, &options, &Control::default()).unwrap();
        let p = result.mesh.vertices[0];
        assert!(result.is_planar && p.coords.norm() < 0.05, "{p}");
    }

    #[test]
    fn degenerate_input_gives_an_error_or_a_finite_mesh() {
        let options = PlanarizeOptions::default();
        let try_on = |mesh: &PanelMesh| {
            let (border, polylines) = (border_vertices(mesh), grid_triples(mesh, |_| false));
            let input = PlanarizeInput { border: &border, polylines: &polylines, ..PlanarizeInput::new(mesh) };
            planarize(&input, &options, &Control::default())
        };
        let good = grid(3, 3, translational);
        let mut collapsed = good.clone();
        collapsed.vertices[5] = collapsed.vertices[6];
        let result = try_on(&collapsed).unwrap();
        assert!(result.mesh.vertices.iter().all(|p| p.iter().all(|x| x.is_finite())));

        let mut broken = good.clone();
        broken.vertices[2].x = f64::NAN;
        assert!(matches!(try_on(&broken), Err(Error::NotFinite { index: 2, .. })));
        let point = PanelMesh { vertices: vec![Point3::origin(); 16], ..good.clone() };
        assert!(matches!(try_on(&point), Err(Error::Degenerate { .. })));
        assert!(matches!(try_on(&PanelMesh::default()), Err(Error::Degenerate { .. })));

        let triangle = PanelMesh::new(good.vertices[..5].to_vec(), &[[0u32, 1, 4]]).unwrap();
        assert_eq!(try_on(&triangle).unwrap().mesh, triangle);
        let line = grid(3, 1, |s, t| [s, 0.5 * t, 0.0]);
        let flat =
            PanelMesh { vertices: line.vertices.iter().map(|p| Point3::new(p.x + p.y, 0.0, 0.0)).collect(), ..line };
        assert!(try_on(&flat).unwrap().mesh.vertices.iter().all(|p| p.iter().all(|x| x.is_finite())));

        let control = Control::default();
        control.cancel();
        let input = PlanarizeInput::new(&good);
        assert_eq!(planarize(&input, &options, &control).unwrap_err(), Error::Cancelled);
        let input = PlanarizeInput { pins: &[99], ..input };
        assert!(matches!(planarize(&input, &options, &Control::default()), Err(Error::Degenerate { .. })));
    }

    /// A heightfield z = f(x, y) trimmed by the circle of radius `radius`, cells of a grid turned by `degrees`, cut off at the circle.
    fn trimmed(f: impl Fn(f64, f64) -> f64, radius: f64, cell: f64, degrees: f64) -> (PanelMesh, Vec<u32>) {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let half = (radius / cell).ceil() as i64 + 1;
        let corner = |i: i64, j: i64| [(i as f64 + 0.37) * cell, (j as f64 + 0.21) * cell];
        let inside = |p: [f64; 2]| p[0].hypot(p[1]) < radius;
        let mut plane: Vec<[f64; 2]> = vec![];
        let mut faces = vec![];
        let mut index = |p: [f64; 2]| {
            plane.iter().position(|q| (q[0] - p[0]).hypot(q[1] - p[1]) < 1e-9).unwrap_or_else(|| {
                plane.push(p);
                plane.len() - 1
            }) as u32
        };
        for i in -half..half {
            for j in -half..half {
                let ring = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                let mut face = vec![];
                for k in 0..4 {
                    let (a, b) = (ring[k], ring[(k + 1) % 4]);
                    if inside(a) {
                        face.push(index(a));
                    }
                    if inside(a) != inside(b) {
                        let (mut low, mut high) = if inside(a) { (a, b) } else { (b, a) };
                        for _ in 0..60 {
                            let middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
                            if inside(middle) { low = middle } else { high = middle }
                        }
                        face.push(index(low));
                    }
                }
                if face.len() >= 3 {
                    faces.push(face);
                }
            }
        }
        let vertices: Vec<_> = plane
            .iter()
            .map(|p| {
                let (x, y) = (p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos);
                Point3::new(x, y, f(x, y))
            })
            .collect();
        let border =
            (0..plane.len() as u32).filter(|&v| plane[v as usize][0].hypot(plane[v as usize][1]) > radius - 1e-6);
        let border = border.collect();
        (PanelMesh::new(vertices, &faces).unwrap(), border)
    }

    /// Closest points, to first order, on a heightfield trimmed by a circle.
    struct Trimmed<F: Fn(f64, f64) -> f64>(F, f64);

    impl<F: Fn(f64, f64) -> f64> Reference for Trimmed<F> {
        fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
            let h = 1e-5;
            let (mut x, mut y) = (p.x, p.y);
            let mut normal = Vector3::z();
            for _ in 0..20 {
                let z = (self.0)(x, y);
                let (zx, zy) = (((self.0)(x + h, y) - z) / h, ((self.0)(x, y + h) - z) / h);
                normal = Vector3::new(-zx, -zy, 1.0).normalize();
                let foot = p.coords - normal * normal.dot(&(p.coords - Vector3::new(x, y, z)));
                (x, y) = (foot.x, foot.y);
            }
            Foot { point: Point3::new(x, y, (self.0)(x, y)), direction: normal, parameters: [0.0; 2] }
        }
        fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
            let at = |a: f64| {
                let (x, y) = (self.1 * a.cos(), self.1 * a.sin());
                Point3::new(x, y, (self.0)(x, y))
            };
            let mut angle = p.y.atan2(p.x);
            let h = 1e-5;
            for _ in 0..20 {
                let tangent = (at(angle + h) - at(angle - h)) / (2.0 * h);
                angle += (p - at(angle)).dot(&tangent) / tangent.norm_squared();
            }
            let tangent = (at(angle + h) - at(angle - h)).normalize();
            Some(Foot { point: at(angle), direction: tangent, parameters: [0.0; 2] })
        }
    }

    fn turned_faces(before: &PanelMesh, after: &[Point3<f64>]) -> usize {
        let area = |vertices: &[Point3<f64>], face: &[u32]| -> Vector3<f64> {
            let at = |k: usize| vertices[face[k] as usize];
            (1..face.len() - 1).map(|k| (at(k) - at(0)).cross(&(at(k + 1) - at(0)))).sum()
        };
        before.faces().filter(|f| area(&before.vertices, f).dot(&area(after, f)) <= 0.0).count()
    }

    #[test]
    fn a_net_near_the_rulings_of_a_saddle_becomes_planar_without_turning_faces() {
        let f = |x: f64, y: f64| (x * x - y * y) / 8.0;
        let (mesh, border) = trimmed(f, 4.0, 0.45, 40.0);
        let polylines = grid_triples(&mesh, |_| false);
        let input = PlanarizeInput {
            reference: Some(&Trimmed(f, 4.0)),
            border: &border,
            polylines: &polylines,
            ..PlanarizeInput::new(&mesh)
        };
        let options = PlanarizeOptions { allowance: 10.0, ..PlanarizeOptions::default() };
        let result = planarize(&input, &options, &Control::default()).unwrap();
        assert!(result.planarity_max() < 1e-10, "{:.1e}", result.planarity_max());
        assert_eq!(turned_faces(&mesh, &result.mesh.vertices), 0);
    }

    /// The plane z = 0 with the line through (0, 1, 0.3) along (0, 1, 0.1) as its border.
    struct SlantedBorder;

    impl Reference for SlantedBorder {
        fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
            Foot { point: Point3::new(p.x, p.y, 0.0), direction: Vector3::z(), parameters: [0.0; 2] }
        }
        fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
            let (start, along) = (Point3::new(0.0, 1.0, 0.3), Vector3::new(0.0, 1.0, 0.1).normalize());
            Some(Foot { point: start + along * along.dot(&(p - start)), direction: along, parameters: [0.0; 2] })
        }
    }

    #[test]
    fn a_cell_that_could_only_turn_over_is_split_where_it_may_be() {
        // Its last corner would have to slide down the border to (0, -2, 0).
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.3]].map(Point3::from).to_vec();
        let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
        let input = PlanarizeInput {
            reference: Some(&SlantedBorder),
            border: &[3],
            pins: &[0, 1, 2],
            splittable: &[0],
            ..PlanarizeInput::new(&mesh)
        };
        let options = PlanarizeOptions { border: 1e7, ..PlanarizeOptions::default() };
        let result = planarize(&input, &options, &Control::default()).unwrap();
        assert_eq!((result.mesh.face_count(), result.split.as_slice()), (2, [0u32].as_slice()));
        assert!(result.is_planar && result.is_close && turned_faces(&mesh, &result.mesh.vertices) == 0);

        let whole = planarize(&PlanarizeInput { splittable: &[], ..input }, &options, &Control::default()).unwrap();
        assert!(whole.mesh.face_count() == 1 && !whole.is_planar && whole.planarity_max() > 0.1);
        assert_eq!(turned_faces(&mesh, &whole.mesh.vertices), 0);
    }

    #[test]
    fn trimmed_cells_become_planar_on_the_border_too() {
        type Height = fn(f64, f64) -> f64;
        let shapes: [(Height, f64); 4] = [
            (|x, y| 0.8 * (0.7 * x).sin() + 0.6 * (0.6 * y + 0.4).cos(), 0.0),
            (|x, y| (36.0 - x * x - y * y).sqrt(), 20.0),
            (|x, y| (x * x - y * y) / 8.0, 0.0),
            (|x, y| (x * x - y * y) / 8.0, 10.0),
        ];
        for (f, degrees) in shapes {
            let (mesh, border) = trimmed(f, 4.0, 0.45, degrees);
            assert!(mesh.faces().any(|f| f.len() == 5) && mesh.faces().any(|f| f.len() == 3));
            let reference = Trimmed(f, 4.0);
            let polylines = grid_triples(&mesh, |_| false);
            let input = PlanarizeInput {
                reference: Some(&reference),
                border: &border,
                polylines: &polylines,
                ..PlanarizeInput::new(&mesh)
            };
            let result = planarize(&input, &PlanarizeOptions::default(), &Control::default()).unwrap();
            assert!(result.planarity_max() < 1e-10 && result.is_close, "{:.1e}", result.planarity_max());
            // Border vertices within 1e-3 of the width.
            assert!(border.iter().all(|&v| result.deviation[v as usize] < 8e-3));
            // No edge on the border cuts a bend of it short.
            let edge = mean_edge_length(&mesh);
            let mut held = vec![false; mesh.vertices.len()];
            border.iter().for_each(|&v| held[v as usize] = true);
            let sides = border_sides(&mesh);
            let starts = vec![[0.0; 2]; held.len()];
            let trace = BorderTrace::new(&mesh.vertices, &sides, &held, &starts, &reference, edge, BORDER_GAP * edge);
            assert!(trace.strains(&result.mesh.vertices).into_iter().all(|strain| strain <= 1.0));
            // Slivers keep their shape.
            let shortest = |m: &PanelMesh| crate::mesh::edge_lengths(m).into_iter().fold(f64::INFINITY, f64::min);
            assert!(shortest(&result.mesh) > 0.5 * shortest(&mesh));
        }
    }
}
