//! Sparse Cholesky factorization, its symbolic part reusable.

use crate::error::Error;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{CholeskySymbolicParams, LltRef, SymmetricOrdering, factorize_symbolic_cholesky};
use faer::sparse::linalg::{SupernodalThreshold, amd, cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
use sprs::CsMat;
use std::sync::Arc;

/// Fill-reducing order and elimination structure of one sparsity pattern.
///
/// Worth keeping where many matrices with the same pattern are factorized, as in Gauss-Newton iterations.
#[derive(Clone)]
pub struct SymbolicCholesky {
    inner: Arc<cholesky::SymbolicCholesky<usize>>,
    column_starts: Vec<usize>,
    rows: Vec<usize>,
}

/// The factorization L L^T of a symmetric positive definite sparse matrix.
#[derive(Clone)]
pub struct Cholesky {
    symbolic: Arc<cholesky::SymbolicCholesky<usize>>,
    values: Vec<f64>,
    size: usize,
}

impl SymbolicCholesky {
    /// Analyses the pattern of `matrix`, n x n, symmetric, in CSC or CSR storage (only one triangle is read).
    ///
    /// # Errors
    /// [`Error::Singular`] if the analysis runs out of memory or index range.
    pub fn new(matrix: &CsMat<f64>) -> Result<Self, Error> {
        Self::with_order(matrix, SymmetricOrdering::Amd, CholeskySymbolicParams::default())
    }

    /// The same for a matrix of dense blocks, `block` x `block` each: the order is found on the far smaller pattern of blocks.
    ///
    /// - `starts`, `rows`: that pattern, lower triangle with its diagonal, CSC.
    ///
    /// # Errors
    /// As [`SymbolicCholesky::new`].
    pub(super) fn of_blocks(
        matrix: &CsMat<f64>,
        block: usize,
        starts: &[usize],
        rows: &[usize],
    ) -> Result<Self, Error> {
        let count = starts.len() - 1;
        let fail = || Error::Singular { what: "symbolic analysis", size: matrix.cols() };
        let pattern = SymbolicSparseColMatRef::new_checked(count, count, starts, None, rows);
        let (mut order, mut places) = (vec![0; count], vec![0; count]);
        let scratch = amd::order_maybe_unsorted_scratch::<usize>(count, rows.len());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| fail())?;
        let stack = MemStack::new(&mut memory);
        amd::order_maybe_unsorted(&mut order, &mut places, pattern, amd::Control::default(), stack)
            .map_err(|_| fail())?;
        let expand = |list: &[usize]| -> Vec<usize> {
            list.iter().flat_map(|&k| (0..block).map(move |a| block * k + a)).collect()
        };
        let order = expand(&order);
        let mut places = vec![0; order.len()];
        order.iter().enumerate().for_each(|(place, &k)| places[k] = place);
        // Columns of a block share their pattern: there is always something for dense kernels.
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..CholeskySymbolicParams::default()
        };
        let order = PermRef::new_checked(&order, &places, matrix.cols());
        Self::with_order(matrix, SymmetricOrdering::Custom(order), params)
    }

    fn with_order(
        matrix: &CsMat<f64>,
        order: SymmetricOrdering<'_, usize>,
        params: CholeskySymbolicParams<'_>,
    ) -> Result<Self, Error> {
        let column_starts = matrix.indptr().to_proper().to_vec();
        let rows = matrix.indices().to_vec();
        let size = matrix.cols();
        let pattern = SymbolicSparseColMatRef::new_checked(size, size, &column_starts, None, &rows);
        let inner = factorize_symbolic_cholesky(pattern, Side::Lower, order, params)
            .map_err(|_| Error::Singular { what: "symbolic analysis", size })?;
        Ok(Self { inner: Arc::new(inner), column_starts, rows })
    }

    /// Factorizes `matrix`, which has the pattern that was analysed.
    ///
    /// `what` names the system in the error message.
    ///
    /// # Errors
    /// [`Error::Singular`] if the matrix is not positive definite or has another pattern.
    pub fn factorize(&self, matrix: &CsMat<f64>, what: &'static str) -> Result<Cholesky, Error> {
        let size = matrix.cols();
        if matrix.indptr().to_proper() != self.column_starts.as_slice() || matrix.indices() != self.rows.as_slice() {
            return Err(Error::Singular { what, size });
        }
        let pattern = SymbolicSparseColMatRef::new_checked(size, size, &self.column_starts, None, &self.rows);
        let view = SparseColMatRef::new(pattern, matrix.data());
        let mut values = vec![0.0; self.inner.len_val()];
        let scratch = self.inner.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| Error::Singular { what, size })?;
        let stack = MemStack::new(&mut memory);
        let regularization = LltRegularization::default();
        self.inner
            .factorize_numeric_llt(&mut values, view, Side::Lower, regularization, Par::Seq, stack, Default::default())
            .map_err(|_| Error::Singular { what, size })?;
        Ok(Cholesky { symbolic: Arc::clone(&self.inner), values, size })
    }
}

impl Cholesky {
    /// Analyses and factorizes in one go, for a matrix whose pattern occurs once.
    ///
    /// # Errors
    /// [`Error::Singular`] if the matrix is not positive definite.
    pub fn new(matrix: &CsMat<f64>, what: &'static str) -> Result<Self, Error> {
        SymbolicCholesky::new(matrix)?.factorize(matrix, what)
    }

    /// Solves A X = B in place; `columns` holds the columns of B one after another, each n long.
    ///
    /// # Panics
    /// If the length is not a multiple of n.
    pub fn solve(&self, columns: &mut [f64]) {
        assert!(self.size > 0 && columns.len().is_multiple_of(self.size), "right-hand side of another size");
        let count = columns.len() / self.size;
        let mut memory = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(count, Par::Seq));
        let right = MatMut::from_column_major_slice_mut(columns, self.size, count);
        let factor = LltRef::new(&self.symbolic, &self.values);
        factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut memory));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::LeastSquares;

    #[test]
    fn solves_several_right_hand_sides() {
        let n = 50;
        let mut rows = LeastSquares::new(n);
        for i in 0..n {
            rows.push(&[(i, 0.1)], 0.0);
            if i > 0 {
                rows.push(&[(i - 1, -1.0), (i, 1.0)], 0.0);
            }
        }
        let (matrix, _) = rows.normal_equations();
        let truth: Vec<f64> = (0..2 * n).map(|i| (i as f64 * 0.7).sin()).collect();
        let mut columns = vec![0.0; 2 * n];
        for c in 0..2 {
            for (value, (row, column)) in matrix.iter() {
                columns[c * n + row] += value * truth[c * n + column];
            }
        }
        let symbolic = SymbolicCholesky::new(&matrix).unwrap();
        symbolic.factorize(&matrix, "test").unwrap().solve(&mut columns);
        for (a, b) in columns.iter().zip(&truth) {
            assert!((a - b).abs() < 1e-10);
        }
    }

    #[test]
    fn an_indefinite_matrix_is_an_error() {
        let matrix = CsMat::new_csc((2, 2), vec![0, 1, 2], vec![0, 1], vec![1.0, -1.0]);
        assert!(matches!(Cholesky::new(&matrix, "test"), Err(Error::Singular { .. })));
    }
}
