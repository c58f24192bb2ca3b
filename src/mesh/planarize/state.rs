//! A mesh on its way to planarity, and how far it is.

use super::feature_terms::{FeatureTerm, feature_terms};
use super::outline::{border_sides, border_turns};
use super::{PlanarizeInput, PlanarizeOptions};
use crate::error::Error;
use crate::mesh::border_trace::BorderTrace;
use crate::mesh::offsets::{AngleSum, angle_sums};
use crate::mesh::panel_mesh::PanelMesh;
use crate::mesh::planarity::{edges, planarity, width};
use crate::mesh::reference::{Foot, Reference};
use crate::numeric::{BlockMatrix, SymbolicCholesky};
use nalgebra::{Point3, Vector3};

/// Growth of the anchor weight of a border vertex with the square of the angle, radians, by which the border turns there: where vertices slide away
/// from a bend, the edge beside them cuts it short. On a straight border they slide freely.
const TURN_ANCHOR: f64 = 100.0;

/// Motion, in mean edge lengths, below which a vertex keeps its closest point's tangent plane.
pub(super) const STALE: f64 = 1e-2;

/// Distance from the border that no border vertex should exceed, in widths of the mesh.
const BORDER_LIMIT: f64 = 1e-3;

/// Distance from the nearest border edge that no point of the border should exceed, in mean edge lengths, unless it starts farther away.
pub(super) const BORDER_GAP: f64 = 0.09;

/// The mesh as it is now, with all weights of the search.
pub(super) struct State<'a> {
    pub(super) input: &'a PlanarizeInput<'a>,
    pub(super) reference: &'a dyn Reference,
    pub(super) options: &'a PlanarizeOptions,
    /// Mean edge length of the input: the unit of all residuals.
    pub(super) edge: f64,
    pub(super) limit: f64,
    pub(super) border_limit: f64,
    pub(super) vertices: Vec<Point3<f64>>,
    pub(super) on_border: Vec<bool>,
    /// Vertices at corners of the reference's border: they stay there, however near a side is.
    pub(super) at_corner: Vec<bool>,
    pub(super) pinned: Vec<bool>,
    pub(super) feet: Vec<Foot>,
    /// Where each foot was asked for.
    pub(super) asked: Vec<Point3<f64>>,
    /// Weight of the distance of each vertex from where it started.
    pub(super) anchors: Vec<f64>,
    /// Factor on that weight where the border is left behind.
    pub(super) hold: Vec<f64>,
    pub(super) border_trace: BorderTrace,
    /// Factor on the closeness and border weight of each vertex.
    pub(super) emphasis: Vec<f64>,
    /// Vertices drawn to their closest point itself: where the reference bends sharply, its tangent leads away.
    pub(super) drawn: Vec<bool>,
    /// Multipliers of each face, one for each corner.
    pub(super) multipliers: Vec<Vec<f64>>,
    pub(super) edges: Vec<[u32; 2]>,
    /// Factor on the stretch weight of each edge.
    pub(super) stiffness: Vec<f64>,
    /// Whether each face may be split into triangles.
    pub(super) may_split: Vec<bool>,
    /// Whether each face is let off being planar.
    pub(super) freed: Vec<bool>,
    /// Whether a step that would spoil the mesh somewhere is shortened everywhere.
    pub(super) is_cautious: bool,
    pub(super) angle_sums: Vec<AngleSum>,
    pub(super) feature_terms: Vec<FeatureTerm>,
    pub(super) matrix: BlockMatrix,
    pub(super) symbolic: SymbolicCholesky,
    pub(super) rounds: usize,
}

impl<'a> State<'a> {
    pub(super) fn new(
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
        pairs.extend(input.polylines.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [a, c]]));
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
    pub(super) fn refresh(&mut self, tolerance: f64) {
        for v in 0..self.vertices.len() {
            if !self.at_corner[v] && (self.vertices[v] - self.asked[v]).norm() > tolerance * self.edge {
                self.feet[v] = self.ask(v, Some(self.feet[v].parameters));
                self.asked[v] = self.vertices[v];
            }
        }
    }

    /// Largest planarity of a face that should be planar, and largest deviation over the limit.
    pub(super) fn measure(&self) -> (f64, f64) {
        let mesh = PanelMesh { vertices: self.vertices.clone(), ..self.input.mesh.clone() };
        let bound = planarity(&mesh).into_iter().zip(&self.freed).filter(|(_, freed)| !**freed);
        let worst = bound.map(|(p, _)| p).fold(0.0, f64::max);
        let far = (0..self.vertices.len()).map(|v| self.distance(v)).fold(0.0, f64::max);
        (worst, far / self.limit)
    }

    /// Distance of a vertex from the reference over what it should not exceed, which is less on the border.
    pub(super) fn strain(&self, vertex: usize) -> f64 {
        let limit = if self.on_border[vertex] { self.border_limit } else { self.limit };
        self.distance(vertex) / limit
    }

    /// The same for each vertex, and for those on the border how far the border is from edges there over what it should be, if that is more.
    pub(super) fn strains(&self) -> Vec<f64> {
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

    /// Largest of [`State::strains`].
    pub(super) fn largest_strain(&self) -> f64 {
        self.strains().into_iter().fold(0.0, f64::max)
    }
}
