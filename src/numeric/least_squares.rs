//! Sparse linear least squares, assembled row by row.

use sprs::{CsMat, TriMat};

/// The system min |A x - b|^2, collected one weighted row at a time.
///
/// The pattern of [`LeastSquares::normal_equations`] depends only on the pushed indices, so a caller that pushes the same
/// rows in the same order in every iteration can keep one [`super::SymbolicCholesky`].
#[derive(Clone, Debug)]
pub struct LeastSquares {
    unknowns: usize,
    row_starts: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    right_hand_side: Vec<f64>,
}

impl LeastSquares {
    /// An empty system in `unknowns` unknowns.
    pub fn new(unknowns: usize) -> Self {
        Self { unknowns, row_starts: vec![0], columns: vec![], values: vec![], right_hand_side: vec![] }
    }

    /// Adds the row sum of coefficient times unknown = `value`; scale both sides by the square root of the weight.
    pub fn push(&mut self, row: &[(usize, f64)], value: f64) {
        for &(column, coefficient) in row {
            debug_assert!(column < self.unknowns);
            self.columns.push(column);
            self.values.push(coefficient);
        }
        self.row_starts.push(self.columns.len());
        self.right_hand_side.push(value);
    }

    /// Number of rows pushed so far.
    pub fn len(&self) -> usize {
        self.right_hand_side.len()
    }

    /// Whether no row was pushed yet.
    pub fn is_empty(&self) -> bool {
        self.right_hand_side.is_empty()
    }

    /// Sum of squared residuals at `x`.
    pub fn energy(&self, x: &[f64]) -> f64 {
        let mut sum = 0.0;
        for (r, b) in self.right_hand_side.iter().enumerate() {
            let range = self.row_starts[r]..self.row_starts[r + 1];
            let product: f64 = range.map(|k| self.values[k] * x[self.columns[k]]).sum();
            sum += (product - b).powi(2);
        }
        sum
    }

    /// A^T A, n x n CSC with both triangles and a full diagonal, and A^T b.
    pub fn normal_equations(&self) -> (CsMat<f64>, Vec<f64>) {
        let mut triplets = TriMat::with_capacity((self.unknowns, self.unknowns), self.columns.len() * 4);
        let mut gradient = vec![0.0; self.unknowns];
        for i in 0..self.unknowns {
            triplets.add_triplet(i, i, 0.0);
        }
        for (r, b) in self.right_hand_side.iter().enumerate() {
            let range = self.row_starts[r]..self.row_starts[r + 1];
            for i in range.clone() {
                gradient[self.columns[i]] += self.values[i] * b;
                for j in range.clone() {
                    triplets.add_triplet(self.columns[i], self.columns[j], self.values[i] * self.values[j]);
                }
            }
        }
        (triplets.to_csc(), gradient)
    }
}
