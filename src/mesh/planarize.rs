//! Moves vertices until every face is planar.

mod face_equations;
mod feature_terms;
mod newton;
mod outline;
mod search;
mod soundness;
mod state;
mod unknowns;

use super::offsets::OffsetKind;
use super::panel_mesh::PanelMesh;
use super::planarity::{mean_edge_length, planarity, width};
use super::reference::{MeshReference, Reference};
use super::split::split_faces;
use crate::control::Control;
use crate::error::Error;
use nalgebra::Point3;
use state::State;

pub use outline::border_vertices;

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
/// weights grow; so do those of the anchors where border vertices slide so far that an edge between them cuts a bend of the border short. Once four of
/// five vertices have settled, only the others and those that strain the limits go on, with what is around them. The last rounds drop the soft
/// gradient and only project onto the constraints.
///
/// A planar mesh that turns a face over or collapses an edge is no answer: vertices there go a part of their step only, and the edges there become
/// stiffer; if the planar mesh does so all the same, the search goes on there from the last sound state with edges stiffer still. If that does not
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
    let (own, parameters);
    let (reference, input): (&dyn Reference, _) = match input.reference {
        Some(reference) => (reference, *input),
        None => {
            own = MeshReference::from_panels(input.mesh);
            parameters = own.vertex_parameters();
            (&own, PlanarizeInput { parameters: Some(&parameters), ..*input })
        }
    };
    let edge = mean_edge_length(input.mesh);
    let width = width(&input.mesh.vertices);
    let limit = options.deviation.unwrap_or((0.02 * width).min(0.2 * edge));
    let mut state = State::new(&input, reference, options, edge, limit)?;
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

#[cfg(test)]
mod tests;
