//! Linear algebra of tensor-product B-splines: evaluation on parameter grids and its adjoint, energies, and a fast solver.
//!
//! Everything here treats one coordinate of the control net as a matrix of count_u rows and count_v columns, stored row by
//! row ("plane"); three planes, one after another, are a control net. Because grids and energies are tensor products, their
//! matrices are never built: one product with a 30 x 30 net costs tens of microseconds.

use super::knots::{Basis, KnotVector};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use nalgebra::{DMatrix, SymmetricEigen};

/// Basis functions at the parameters of one direction.
#[derive(Clone, Debug)]
pub struct GridAxis {
    /// The parameters.
    pub parameters: Vec<f64>,
    /// Basis functions at each.
    pub bases: Vec<Basis>,
    count: usize,
    degree: usize,
}

impl GridAxis {
    /// Evaluates the basis once.
    pub fn new(knots: &KnotVector, parameters: Vec<f64>) -> Self {
        let bases = parameters.iter().map(|&t| knots.basis(t)).collect();
        Self { parameters, bases, count: knots.count(), degree: knots.degree() }
    }

    /// `count` evenly spaced parameters over the whole domain, ends included.
    pub fn even(knots: &KnotVector, count: usize) -> Self {
        let last = (count.max(2) - 1) as f64;
        Self::new(knots, (0..count.max(2)).map(|i| knots.at_fraction(i as f64 / last)).collect())
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.parameters.len()
    }
}

/// Values of S, S_u and S_v on a grid, or any three planes of samples: index a * len_v + b.
#[derive(Clone, Debug, Default)]
pub struct GridPlanes {
    /// S
    pub value: Vec<f64>,
    /// S_u
    pub du: Vec<f64>,
    /// S_v
    pub dv: Vec<f64>,
}

/// A parameter grid of a tensor-product spline.
#[derive(Clone, Debug)]
pub struct TensorGrid {
    /// Parameters in u and v.
    pub axes: [GridAxis; 2],
}

impl TensorGrid {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.axes[0].len() * self.axes[1].len()
    }

    /// S, S_u, S_v of one plane of control values.
    pub fn forward(&self, plane: &[f64], out: &mut GridPlanes) {
        let [au, av] = &self.axes;
        let (nu, nv, mv) = (au.count, av.count, av.len());
        for samples in [&mut out.value, &mut out.du, &mut out.dv] {
            samples.clear();
            samples.resize(self.len(), 0.0);
        }
        // Along v first, on the few control rows; then whole rows are summed along u, several samples at a time.
        let mut rows = vec![0.0; nu * mv];
        let mut rows_dv = vec![0.0; nu * mv];
        for (i, control) in plane.chunks_exact(nv).enumerate() {
            for (b, bv) in av.bases.iter().enumerate() {
                let (mut value, mut slope) = (0.0, 0.0);
                for (j, x) in control[bv.first..=bv.first + av.degree].iter().enumerate() {
                    value += bv.values[0][j] * x;
                    slope += bv.values[1][j] * x;
                }
                (rows[i * mv + b], rows_dv[i * mv + b]) = (value, slope);
            }
        }
        for (a, bu) in au.bases.iter().enumerate() {
            let range = a * mv..(a + 1) * mv;
            let (value, du, dv) = (&mut out.value[range.clone()], &mut out.du[range.clone()], &mut out.dv[range]);
            for i in 0..=au.degree {
                let range = (bu.first + i) * mv..(bu.first + i + 1) * mv;
                let (weight, slope) = (bu.values[0][i], bu.values[1][i]);
                let sums = value.iter_mut().zip(du.iter_mut()).zip(dv.iter_mut());
                for (((s, s_u), s_v), (row, row_dv)) in sums.zip(rows[range.clone()].iter().zip(&rows_dv[range])) {
                    *s += weight * row;
                    *s_u += slope * row;
                    *s_v += weight * row_dv;
                }
            }
        }
    }

    /// The adjoint of [`TensorGrid::forward`], added to `plane`.
    pub fn add_adjoint(&self, samples: &GridPlanes, plane: &mut [f64]) {
        let [au, av] = &self.axes;
        let (nu, nv, mv) = (au.count, av.count, av.len());
        let mut rows = vec![0.0; nu * mv];
        let mut rows_dv = vec![0.0; nu * mv];
        for (a, bu) in au.bases.iter().enumerate() {
            let range = a * mv..(a + 1) * mv;
            let (value, du, dv) = (&samples.value[range.clone()], &samples.du[range.clone()], &samples.dv[range]);
            for i in 0..=au.degree {
                let range = (bu.first + i) * mv..(bu.first + i + 1) * mv;
                let (weight, slope) = (bu.values[0][i], bu.values[1][i]);
                let sums = rows[range.clone()].iter_mut().zip(&mut rows_dv[range]);
                for ((row, row_dv), ((s, s_u), s_v)) in sums.zip(value.iter().zip(du).zip(dv)) {
                    *row += weight * s + slope * s_u;
                    *row_dv += weight * s_v;
                }
            }
        }
        for (i, control) in plane.chunks_exact_mut(nv).enumerate() {
            for (b, bv) in av.bases.iter().enumerate() {
                let (row, row_dv) = (rows[i * mv + b], rows_dv[i * mv + b]);
                for (j, x) in control[bv.first..=bv.first + av.degree].iter_mut().enumerate() {
                    *x += bv.values[0][j] * row + bv.values[1][j] * row_dv;
                }
            }
        }
    }
}

/// The n x n matrix of the integrals of N_i^(k) N_j^(k), order k = 0 to 3, for cubic or lower degrees.
pub fn gram(knots: &KnotVector, order: usize) -> DMatrix<f64> {
    // Four Gauss points are exact up to degree 7.
    const NODES: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
        (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
    ];
    let (n, p) = (knots.count(), knots.degree());
    let mut result = DMatrix::zeros(n, n);
    for span in knots.breaks().windows(2) {
        let (middle, half) = (0.5 * (span[0] + span[1]), 0.5 * (span[1] - span[0]));
        let bases = NODES.map(|(x, _)| knots.basis(middle + half * x));
        for (node, (_, weight)) in NODES.iter().enumerate() {
            let basis = &bases[node];
            let value = |i: usize| match order {
                0..=2 => basis.values[order][i],
                // The second derivative of a cubic is linear in each span.
                _ => (bases[3].values[2][i] - bases[0].values[2][i]) / (half * (NODES[3].0 - NODES[0].0)),
            };
            for i in 0..=p {
                for j in 0..=p {
                    result[(basis.first + i, basis.first + j)] += weight * half * value(i) * value(j);
                }
            }
        }
    }
    result
}

/// A banded n x n matrix, applied along one direction of a plane.
#[derive(Clone, Debug, Default)]
pub struct Banded {
    size: usize,
    width: usize,
    /// Diagonal d holds the entries (i, i + d - width), n each, zero outside the matrix.
    diagonals: Vec<f64>,
}

impl Banded {
    /// The band of `matrix` of half-width `width`.
    pub fn new(matrix: &DMatrix<f64>, width: usize) -> Self {
        let size = matrix.nrows();
        let mut diagonals = vec![0.0; size * (2 * width + 1)];
        for i in 0..size {
            for j in i.saturating_sub(width)..=(i + width).min(size - 1) {
                diagonals[(j + width - i) * size + i] = matrix[(i, j)];
            }
        }
        Self { size, width, diagonals }
    }

    /// This matrix plus `factor` times another one of the same band.
    pub fn plus(&self, other: &Self, factor: f64) -> Self {
        let diagonals = self.diagonals.iter().zip(&other.diagonals).map(|(a, b)| a + factor * b).collect();
        Self { diagonals, ..*self }
    }

    /// The rows i for which (i, i + d - width) lies in the matrix.
    fn rows(&self, d: usize) -> std::ops::Range<usize> {
        self.width.saturating_sub(d)..self.size - d.saturating_sub(self.width)
    }

    /// Adds this matrix times `plane` (along u) to `out`.
    pub fn add_along_u(&self, plane: &[f64], columns: usize, out: &mut [f64]) {
        for d in 0..=2 * self.width {
            for i in self.rows(d) {
                let value = self.diagonals[d * self.size + i];
                let source = &plane[(i + d - self.width) * columns..(i + d - self.width + 1) * columns];
                for (t, s) in out[i * columns..(i + 1) * columns].iter_mut().zip(source) {
                    *t += value * s;
                }
            }
        }
    }

    /// This matrix times each row of `plane` (along v), written to `out`.
    pub fn along_v(&self, plane: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for (source, target) in plane.chunks_exact(self.size).zip(out.chunks_exact_mut(self.size)) {
            for d in 0..=2 * self.width {
                let rows = self.rows(d);
                let shifted = rows.start + d - self.width..rows.end + d - self.width;
                let values = &self.diagonals[d * self.size + rows.start..d * self.size + rows.end];
                for ((t, value), s) in target[rows].iter_mut().zip(values).zip(&source[shifted]) {
                    *t += value * s;
                }
            }
        }
    }
}

/// Inverse of c (Mu x Mv) + Ku x Mv + Mu x Kv on a plane, by simultaneous diagonalization of each direction's pair (K, M).
///
/// Source: Lynch, Rice, Thomas, "Direct solution of partial difference equations by tensor product methods", 1964.
#[derive(Clone, Debug)]
pub struct FastDiagonal {
    /// Generalized eigenvectors of each direction as columns.
    vectors: [Mat<f64>; 2],
    inverse: Vec<f64>,
}

impl FastDiagonal {
    /// Diagonalizes; `None` if a mass matrix is not positive definite.
    ///
    /// - `stiffness`, `mass`: Ku and Kv, Mu and Mv; `constant`: c > 0.
    pub fn new(stiffness: [&DMatrix<f64>; 2], mass: [&DMatrix<f64>; 2], constant: f64) -> Option<Self> {
        let diagonalize = |k: &DMatrix<f64>, m: &DMatrix<f64>| {
            let lower = m.clone().cholesky()?.l();
            let half = lower.solve_lower_triangular(k)?;
            let reduced = lower.solve_lower_triangular(&half.transpose())?;
            let eigen = SymmetricEigen::new((&reduced + reduced.transpose()) * 0.5);
            let columns = lower.transpose().solve_upper_triangular(&eigen.eigenvectors)?;
            let vectors = Mat::from_fn(columns.nrows(), columns.ncols(), |i, j| columns[(i, j)]);
            Some((vectors, eigen.eigenvalues))
        };
        let (first, u) = diagonalize(stiffness[0], mass[0])?;
        // Most patches are square: the second direction is the first one again.
        let same = stiffness[0] == stiffness[1] && mass[0] == mass[1];
        let (second, v) = if same { (first.clone(), u.clone()) } else { diagonalize(stiffness[1], mass[1])? };
        let inverse =
            u.iter().flat_map(|a| v.iter().map(move |b| 1.0 / (constant + a.max(0.0) + b.max(0.0)))).collect();
        Some(Self { vectors: [first, second], inverse })
    }

    /// Replaces `plane` by the solution for it; `scratch` is as long.
    pub fn solve(&self, plane: &mut [f64], scratch: &mut [f64]) {
        let [u, v] = &self.vectors;
        let (nu, nv) = (u.nrows(), v.nrows());
        // Phi_u^T R Phi_v, scaled, then Phi_u X Phi_v^T.
        product(u.transpose(), MatRef::from_row_major_slice(plane, nu, nv), scratch);
        product(MatRef::from_row_major_slice(scratch, nu, nv), v.as_ref(), plane);
        for (x, factor) in plane.iter_mut().zip(&self.inverse) {
            *x *= factor;
        }
        product(u.as_ref(), MatRef::from_row_major_slice(plane, nu, nv), scratch);
        product(MatRef::from_row_major_slice(scratch, nu, nv), v.transpose(), plane);
    }
}

/// out = a b, row by row.
fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>, out: &mut [f64]) {
    let out = MatMut::from_row_major_slice_mut(out, a.nrows(), b.ncols());
    matmul(out, Accum::Replace, a, b, 1.0, Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize, seed: f64) -> Vec<f64> {
        (0..n).map(|i| ((i as f64 + seed) * 12.9898).sin() * 0.7).collect()
    }

    fn grid() -> (TensorGrid, [KnotVector; 2]) {
        let knots = [KnotVector::uniform(3, 9), KnotVector::uniform(3, 7)];
        (TensorGrid { axes: [GridAxis::even(&knots[0], 14), GridAxis::even(&knots[1], 11)] }, knots)
    }

    #[test]
    fn the_adjoint_is_the_transpose() {
        let (grid, _) = grid();
        let plane = noise(63, 0.0);
        let mut forward = GridPlanes::default();
        grid.forward(&plane, &mut forward);
        let n = grid.len();
        let samples = GridPlanes { value: noise(n, 1.0), du: noise(n, 2.0), dv: noise(n, 3.0) };
        let mut back = vec![0.0; 63];
        grid.add_adjoint(&samples, &mut back);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let left = dot(&forward.value, &samples.value) + dot(&forward.du, &samples.du) + dot(&forward.dv, &samples.dv);
        assert!((left - dot(&plane, &back)).abs() < 1e-10);
    }

    #[test]
    fn energies_of_a_parabola_are_exact() {
        let knots = KnotVector::uniform(3, 12);
        // Control values of t^2: mean of the products of pairs of inner knots.
        let control = nalgebra::DVector::from_iterator(
            12,
            (0..12).map(|i| {
                let k = &knots.knots()[i + 1..=i + 3];
                (k[0] * k[1] + k[1] * k[2] + k[0] * k[2]) / 3.0
            }),
        );
        // Integrals over [0, 1] of t^4, (2t)^2, 2^2, 0.
        for (order, expected) in [0.2, 4.0 / 3.0, 4.0, 0.0].into_iter().enumerate() {
            let energy = (control.transpose() * gram(&knots, order) * &control)[(0, 0)];
            assert!((energy - expected).abs() < 1e-8, "order {order}: {energy}");
        }
    }

    #[test]
    fn the_fast_solver_inverts_the_tensor_operator() {
        let (_, knots) = grid();
        let [m, k] = [0, 2].map(|order| [0, 1].map(|axis| gram(&knots[axis], order)));
        let solver = FastDiagonal::new([&k[0], &k[1]], [&m[0], &m[1]], 3.0).unwrap();
        let truth = noise(63, 5.0);
        let banded = |matrix: &DMatrix<f64>| Banded::new(matrix, 3);
        let mut right = vec![0.0; 63];
        let mut temporary = vec![0.0; 63];
        banded(&m[1]).along_v(&truth, &mut temporary);
        banded(&k[0]).add_along_u(&temporary, 7, &mut right);
        for x in &mut temporary {
            *x *= 3.0;
        }
        banded(&m[0]).add_along_u(&temporary, 7, &mut right);
        banded(&k[1]).along_v(&truth, &mut temporary);
        banded(&m[0]).add_along_u(&temporary, 7, &mut right);
        solver.solve(&mut right, &mut temporary);
        for (a, b) in right.iter().zip(&truth) {
            assert!((a - b).abs() < 1e-8);
        }
    }
}
