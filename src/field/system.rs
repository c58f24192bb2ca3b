//! Sparse systems whose unknowns sit on triangles and whose couplings sit on edges.

use super::topology::EdgeTopology;
use crate::error::Error;
use crate::numeric::{Cholesky, SymbolicCholesky};
use sprs::CsMat;

/// A symmetric matrix with a block for each triangle (0, 1 or 2 unknowns) and one for each inner edge; the pattern is analysed once.
pub(super) struct TriangleSystem {
    /// First unknown of each triangle; the last entry is the size.
    pub starts: Vec<usize>,
    /// Right-hand side, then solution.
    pub vector: Vec<f64>,
    matrix: CsMat<f64>,
    symbolic: SymbolicCholesky,
    diagonal: Vec<[usize; 3]>,
    off_diagonal: Vec<[usize; 4]>,
}

impl TriangleSystem {
    /// The pattern for `unknowns[t]` unknowns on triangle t.
    pub fn new(edges: &EdgeTopology, unknowns: impl Iterator<Item = usize>) -> Result<Self, Error> {
        let mut starts = vec![0];
        for n in unknowns {
            starts.push(starts[starts.len() - 1] + n);
        }
        let count = starts.len() - 1;
        let size = starts[count];
        let mut column_starts = vec![0];
        let mut rows: Vec<usize> = vec![];
        let mut diagonal = vec![[usize::MAX; 3]; count];
        let mut off_diagonal = vec![[usize::MAX; 4]; edges.len()];
        for t in 0..count {
            // Neighbours of higher number, in order: the lower triangle of a column.
            let mut neighbours: Vec<(u32, u32)> = edges.triangle_edges[t]
                .iter()
                .filter_map(|&e| {
                    let [f, g] = edges.triangles[e as usize];
                    let other = if f as usize == t { g } else { f };
                    (!edges.is_border(e as usize) && other as usize > t).then_some((other, e))
                })
                .collect();
            neighbours.sort_unstable();
            for column in 0..starts[t + 1] - starts[t] {
                for row in column..starts[t + 1] - starts[t] {
                    diagonal[t][row + column] = rows.len();
                    rows.push(starts[t] + row);
                }
                for &(other, e) in &neighbours {
                    let range = starts[other as usize]..starts[other as usize + 1];
                    for (row, unknown) in range.enumerate() {
                        off_diagonal[e as usize][2 * row + column] = rows.len();
                        rows.push(unknown);
                    }
                }
                column_starts.push(rows.len());
            }
        }
        let values = vec![0.0; rows.len()];
        let matrix = CsMat::new_csc((size, size), column_starts, rows, values);
        let symbolic = SymbolicCholesky::new(&matrix)?;
        Ok(Self { starts, vector: vec![0.0; size], matrix, symbolic, diagonal, off_diagonal })
    }

    /// Sets matrix and right-hand side to 0.
    pub fn clear(&mut self) {
        self.matrix.data_mut().fill(0.0);
        self.vector.fill(0.0);
    }

    /// Number of unknowns of a triangle.
    pub fn unknowns(&self, triangle: usize) -> usize {
        self.starts[triangle + 1] - self.starts[triangle]
    }

    /// Adds to the entry (row, column) of a triangle's own block, row >= column.
    pub fn add_diagonal(&mut self, triangle: usize, row: usize, column: usize, value: f64) {
        self.matrix.data_mut()[self.diagonal[triangle][row + column]] += value;
    }

    /// Adds to the entry of unknown `i` of the edge's first triangle f and unknown `j` of its second one g.
    pub fn add_off_diagonal(&mut self, edge: usize, [f, g]: [u32; 2], i: usize, j: usize, value: f64) {
        let (row, column) = if f > g { (i, j) } else { (j, i) };
        self.matrix.data_mut()[self.off_diagonal[edge][2 * row + column]] += value;
    }

    /// Factorizes.
    pub fn factorize(&self, what: &'static str) -> Result<Cholesky, Error> {
        self.symbolic.factorize(&self.matrix, what)
    }
}
