//! A mesh on its way to planarity, and how far it is.

use super::feature_terms::{FeatureTerm, feature_terms};
use super::outline::{border_sides, border_turns};
use super::unknowns::Unknowns;
use super::{PlanarizeInput, PlanarizeOptions};
use crate::error::Error;
use crate::mesh::border_trace::BorderTrace;
use crate::mesh::offsets::{AngleSum, angle_sums};
use crate::mesh::planarity::{edges, out_of_plane, width};
use crate::mesh::reference::{Foot, Reference};
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

/// Share of the free vertices beyond which a patch saves nothing.
const LARGEST_PATCH: f64 = 0.5;

/// The mesh as it is now, with all weights of the search.
pub(super) struct State<'a> {
    pub(super) input: &'a PlanarizeInput<'a>,
    pub(super) reference: &'a dyn Reference,
    pub(super) options: &'a PlanarizeOptions,
    /// Mean edge length of the input: the unit of all residuals.
    pub(super) edge: f64,
    pub(super) width: f64,
    pub(super) limit: f64,
    pub(super) border_limit: f64,
    pub(super) vertices: Vec<Point3<f64>>,
    pub(super) on_border: Vec<bool>,
    /// Vertices at corners of the reference's border: they stay there, however near a side is.
    pub(super) at_corner: Vec<bool>,
    /// Whether each vertex may move at all.
    pub(super) is_free: Vec<bool>,
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
    /// Pairs of vertices that share a term.
    pub(super) couplings: Vec<[u32; 2]>,
    /// What a round moves: all free vertices, or those of a patch.
    pub(super) unknowns: Unknowns,
    /// All free vertices, put aside while a patch is worked on.
    pub(super) whole: Option<Unknowns>,
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
        let mut is_free = vec![false; count];
        input.mesh.indices.iter().for_each(|&v| is_free[v as usize] = true);
        input.pins.iter().for_each(|&v| is_free[v as usize] = false);
        let mut may_split = vec![false; input.mesh.face_count()];
        input.splittable.iter().for_each(|&f| may_split[f as usize] = true);
        let mut couplings = vec![];
        for group in input.mesh.faces().filter(|f| f.len() > 3) {
            for (k, &a) in group.iter().enumerate() {
                couplings.extend(group[..k].iter().map(|&b| [a, b]));
            }
        }
        if options.fairness > 0.0 {
            couplings.extend(input.polylines.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [a, c]]));
        }
        let edges = edges(input.mesh);
        couplings.extend_from_slice(&edges);
        let angle_sums = angle_sums(input.mesh, options.offsets);
        for sum in &angle_sums {
            let group = sum.angles.as_flattened();
            for (k, &a) in group.iter().enumerate() {
                couplings.extend(group[..k].iter().map(|&b| [a, b]));
            }
        }
        couplings.iter_mut().for_each(|pair| pair.sort_unstable());
        couplings.sort_unstable();
        couplings.dedup();
        let unknowns = Unknowns::new(&is_free, &couplings)?;
        let vertices = input.mesh.vertices.clone();
        let width = width(&vertices);
        let mut state = Self {
            input,
            reference,
            options,
            edge,
            width,
            limit,
            border_limit: limit.min(BORDER_LIMIT * width),
            asked: vertices.clone(),
            vertices,
            on_border,
            at_corner: vec![false; count],
            is_free,
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
            couplings,
            unknowns,
            whole: None,
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

    /// Planarity of each face as [`crate::mesh::planarity()`] defines it; 0 for those let off being planar.
    pub(super) fn planarity(&self) -> Vec<f64> {
        let length = |&[a, b]: &[u32; 2]| (self.vertices[a as usize] - self.vertices[b as usize]).norm();
        let mean = self.edges.iter().map(length).sum::<f64>() / self.edges.len() as f64;
        let of = |(face, freed): (&[u32], &bool)| if *freed { 0.0 } else { out_of_plane(&self.vertices, face) / mean };
        self.input.mesh.faces().zip(&self.freed).map(of).collect()
    }

    /// Largest planarity of a face that should be planar and has a corner that moves.
    pub(super) fn worst_planarity(&self) -> f64 {
        let moves = self.input.mesh.faces().map(|face| self.unknowns.moves_any(face));
        self.planarity().into_iter().zip(moves).filter(|(_, moves)| *moves).fold(0.0, |worst, (p, _)| worst.max(p))
    }

    /// Largest deviation over the limit.
    pub(super) fn largest_deviation(&self) -> f64 {
        (0..self.vertices.len()).map(|v| self.distance(v)).fold(0.0, f64::max) / self.limit
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

    /// Holds all but the vertices within `rings` faces of `seeds`, unless those are most of the mesh or none. Whether it does.
    pub(super) fn focus(&mut self, seeds: Vec<bool>, rings: usize) -> Result<bool, Error> {
        let mut moves = seeds;
        for _ in 0..rings {
            let before = moves.clone();
            for face in self.input.mesh.faces().filter(|face| face.iter().any(|&v| before[v as usize])) {
                face.iter().for_each(|&v| moves[v as usize] = true);
            }
        }
        moves.iter_mut().zip(&self.is_free).for_each(|(moves, free)| *moves &= free);
        let count = |flags: &[bool]| flags.iter().filter(|flag| **flag).count() as f64;
        let share = count(&moves) / count(&self.is_free);
        if !(share > 0.0 && share < LARGEST_PATCH) {
            return Ok(false);
        }
        let patch = Unknowns::new(&moves, &self.couplings)?;
        let before = std::mem::replace(&mut self.unknowns, patch);
        self.whole.get_or_insert(before);
        Ok(true)
    }

    /// Lets all vertices move again.
    pub(super) fn widen(&mut self) {
        if let Some(whole) = self.whole.take() {
            self.unknowns = whole;
        }
    }
}
