//! The vertices that a round moves, and the matrix of their equations.

use crate::error::Error;
use crate::numeric::{BlockMatrix, Cholesky, SymbolicCholesky};
use nalgebra::{Matrix3, Vector3};

/// Place of a vertex that is held.
const HELD: u32 = u32::MAX;

/// The vertices that move while all others are held, and the matrix of their equations.
pub(super) struct Unknowns {
    /// The vertices that move, ascending.
    vertices: Vec<u32>,
    /// Of each vertex, its place among them, or [`HELD`].
    places: Vec<u32>,
    matrix: BlockMatrix,
    symbolic: SymbolicCholesky,
}

impl Unknowns {
    /// - `moves`: whether each vertex moves.
    /// - `couplings`: pairs of vertices that share a term; those with a vertex that is held do not count.
    ///
    /// # Errors
    /// As [`BlockMatrix::analyse`].
    pub(super) fn new(moves: &[bool], couplings: &[[u32; 2]]) -> Result<Self, Error> {
        let vertices: Vec<u32> = (0..moves.len() as u32).filter(|&v| moves[v as usize]).collect();
        let mut places = vec![HELD; moves.len()];
        (0..).zip(&vertices).for_each(|(place, &v)| places[v as usize] = place);
        let pairs = couplings.iter().map(|pair| pair.map(|v| places[v as usize])).filter(|pair| !pair.contains(&HELD));
        let matrix = BlockMatrix::new(vertices.len(), pairs.collect());
        let symbolic = matrix.analyse()?;
        Ok(Self { vertices, places, matrix, symbolic })
    }

    /// The vertices that move, ascending.
    pub(super) fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    pub(super) fn moves(&self, vertex: u32) -> bool {
        self.places[vertex as usize] != HELD
    }

    /// Whether any of them moves.
    pub(super) fn moves_any(&self, vertices: &[u32]) -> bool {
        vertices.iter().any(|&v| self.moves(v))
    }

    /// Sets the matrix to zero.
    pub(super) fn clear(&mut self) {
        self.matrix.clear();
    }

    /// Adds a block between two vertices, see [`BlockMatrix::add`]; none where one of them is held.
    pub(super) fn add(&mut self, v: u32, w: u32, block: &Matrix3<f64>) {
        let places = [v, w].map(|v| self.places[v as usize]);
        if !places.contains(&HELD) {
            self.matrix.add(places[0], places[1], block);
        }
    }

    /// Factorizes the matrix.
    ///
    /// # Errors
    /// [`Error::Singular`].
    pub(super) fn factorize(&self) -> Result<Cholesky, Error> {
        self.symbolic.factorize(self.matrix.matrix(), "planarization")
    }

    /// Displacements by which the vertices answer `forces`, one for each vertex of the mesh; those that are held stay.
    pub(super) fn solve(&self, factor: &Cholesky, forces: &mut [Vector3<f64>]) {
        let mut column: Vec<f64> = self.vertices.iter().flat_map(|&v| <[f64; 3]>::from(forces[v as usize])).collect();
        factor.solve(&mut column);
        forces.fill(Vector3::zeros());
        for (&v, step) in self.vertices.iter().zip(column.chunks_exact(3)) {
            forces[v as usize] = Vector3::from_row_slice(step);
        }
    }
}
