//! Sparse linear algebra; knows no geometry.

mod cholesky;
mod least_squares;

pub use cholesky::{Cholesky, SymbolicCholesky};
pub use least_squares::LeastSquares;
