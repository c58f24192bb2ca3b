//! Sparse linear algebra; knows no geometry.

mod block_matrix;
mod cholesky;
mod least_squares;

pub use block_matrix::BlockMatrix;
pub use cholesky::{Cholesky, SymbolicCholesky};
pub use least_squares::LeastSquares;
