//! Symmetric sparse matrices of 3 x 3 blocks.

use super::cholesky::SymbolicCholesky;
use crate::error::Error;
use nalgebra::Matrix3;
use sprs::CsMat;

/// A symmetric matrix of 3 x 3 blocks whose pattern is fixed once; its lower triangle is kept in CSC.
///
/// What Gauss-Newton systems over points in space need: clear, add blocks, factorize, again and again.
#[derive(Clone, Debug)]
pub struct BlockMatrix {
    matrix: CsMat<f64>,
    /// For each block column, its start in `below`.
    starts: Vec<usize>,
    /// Block rows below the diagonal, ascending in each column.
    below: Vec<u32>,
    /// Start of each scalar column in the values.
    columns: Vec<usize>,
}

impl BlockMatrix {
    /// The zero matrix of `size` blocks a side, with room for blocks at `pairs` (in either order) and on the diagonal.
    ///
    /// # Panics
    /// If a pair refers to a block beyond `size`.
    pub fn new(size: usize, mut pairs: Vec<[u32; 2]>) -> Self {
        pairs.iter_mut().for_each(|p| p.sort_unstable());
        pairs.retain(|p| p[0] != p[1]);
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0; size + 1];
        for p in &pairs {
            starts[p[0] as usize + 1] += 1;
        }
        for i in 0..size {
            starts[i + 1] += starts[i];
        }
        let below: Vec<u32> = pairs.iter().map(|p| p[1]).collect();
        let mut columns = Vec::with_capacity(3 * size + 1);
        let mut rows = vec![];
        columns.push(0);
        for j in 0..size {
            for b in 0..3 {
                rows.extend((b..3).map(|a| 3 * j + a));
                for &i in &below[starts[j]..starts[j + 1]] {
                    rows.extend((0..3).map(|a| 3 * i as usize + a));
                }
                columns.push(rows.len());
            }
        }
        let values = vec![0.0; rows.len()];
        let matrix = CsMat::new_csc((3 * size, 3 * size), columns.clone(), rows, values);
        Self { matrix, starts, below, columns }
    }

    /// The lower triangle, 3 `size` x 3 `size`, CSC.
    pub fn matrix(&self) -> &CsMat<f64> {
        &self.matrix
    }

    /// Analyses the pattern, see [`SymbolicCholesky::new`].
    ///
    /// # Errors
    /// As there.
    pub fn analyse(&self) -> Result<SymbolicCholesky, Error> {
        let size = self.starts.len() - 1;
        let (mut starts, mut rows) = (vec![0], Vec::with_capacity(size + self.below.len()));
        for j in 0..size {
            rows.push(j);
            rows.extend(self.below[self.starts[j]..self.starts[j + 1]].iter().map(|&i| i as usize));
            starts.push(rows.len());
        }
        SymbolicCholesky::of_blocks(&self.matrix, 3, &starts, &rows)
    }

    /// Sets all blocks to zero.
    pub fn clear(&mut self) {
        self.matrix.data_mut().fill(0.0);
    }

    /// Adds `block` at block row i, block column j, and means its transpose at (j, i); for i = j a symmetric block.
    ///
    /// # Panics
    /// If the pattern has no such block.
    pub fn add(&mut self, i: u32, j: u32, block: &Matrix3<f64>) {
        if i < j {
            return self.add(j, i, &block.transpose());
        }
        let column = j as usize;
        let values = self.matrix.data_mut();
        if i == j {
            for b in 0..3 {
                for a in b..3 {
                    values[self.columns[3 * column + b] + a - b] += block[(a, b)];
                }
            }
        } else {
            let range = &self.below[self.starts[column]..self.starts[column + 1]];
            let place = range.binary_search(&i).expect("every added block is in the pattern");
            for b in 0..3 {
                let start = self.columns[3 * column + b] + 3 - b + 3 * place;
                for a in 0..3 {
                    values[start + a] += block[(a, b)];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_land_in_both_triangles() {
        let mut matrix = BlockMatrix::new(3, vec![[2, 0], [0, 1], [1, 0]]);
        let coupling = Matrix3::new(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9);
        for _ in 0..2 {
            // Cleared in between: the second time must give the same.
            matrix.clear();
            (0..3).for_each(|i| matrix.add(i, i, &(Matrix3::identity() * 4.0)));
            matrix.add(0, 2, &coupling);
            matrix.add(1, 0, &-coupling);
        }
        let mut dense = nalgebra::DMatrix::<f64>::identity(9, 9) * 4.0;
        for (i, j, block) in [(0, 2, coupling), (1, 0, -coupling)] {
            dense.view_mut((3 * i, 3 * j), (3, 3)).copy_from(&block);
            dense.view_mut((3 * j, 3 * i), (3, 3)).copy_from(&block.transpose());
        }
        let truth = nalgebra::DVector::from_fn(9, |i, _| (i as f64).sin());
        let mut columns = (&dense * &truth).as_slice().to_vec();
        let symbolic = matrix.analyse().unwrap();
        symbolic.factorize(matrix.matrix(), "test").unwrap().solve(&mut columns);
        assert!(columns.iter().zip(truth.iter()).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
