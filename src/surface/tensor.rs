//! Linear algebra of tensor-product B-splines: evaluation on parameter grids and its adjoint, energies, and a fast solver.
//!
//! Everything here treats one coordinate of the control net as a matrix of count_u rows and count_v columns, stored row by
//! row ("plane"); three planes, one after another, are a control net. Because grids and energies are tensor products, their
//! matrices are never built: one product with a 30 x 30 net costs tens of microseconds.

use super::knots::{Basis, KnotVector};
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
        let (nv, mv) = (av.count, av.len());
        for samples in [&mut out.value, &mut out.du, &mut out.dv] {
            samples.resize(self.len(), 0.0);
        }
        let mut row = vec![0.0; nv];
        let mut row_du = vec![0.0; nv];
        for (a, bu) in au.bases.iter().enumerate() {
            row.fill(0.0);
            row_du.fill(0.0);
            for i in 0..=au.degree {
                let control = &plane[(bu.first + i) * nv..(bu.first + i + 1) * nv];
                let (value, slope) = (bu.values[0][i], bu.values[1][i]);
                for ((sum, sum_du), x) in row.iter_mut().zip(&mut row_du).zip(control) {
                    *sum += value * x;
                    *sum_du += slope * x;
                }
            }
            for (b, bv) in av.bases.iter().enumerate() {
                let range = bv.first..=bv.first + av.degree;
                let (mut s, mut s_u, mut s_v) = (0.0, 0.0, 0.0);
                for (j, (x, x_u)) in row[range.clone()].iter().zip(&row_du[range]).enumerate() {
                    s += bv.values[0][j] * x;
                    s_u += bv.values[0][j] * x_u;
                    s_v += bv.values[1][j] * x;
                }
                let k = a * mv + b;
                (out.value[k], out.du[k], out.dv[k]) = (s, s_u, s_v);
            }
        }
    }

    /// The adjoint of [`TensorGrid::forward`], added to `plane`.
    pub fn add_adjoint(&self, samples: &GridPlanes, plane: &mut [f64]) {
        let [au, av] = &self.axes;
        let (nv, mv) = (av.count, av.len());
        let mut row = vec![0.0; nv];
        let mut row_du = vec![0.0; nv];
        for (a, bu) in au.bases.iter().enumerate() {
            row.fill(0.0);
            row_du.fill(0.0);
            for (b, bv) in av.bases.iter().enumerate() {
                let k = a * mv + b;
                let (s, s_u, s_v) = (samples.value[k], samples.du[k], samples.dv[k]);
                let range = bv.first..=bv.first + av.degree;
                for (j, (sum, sum_du)) in row[range.clone()].iter_mut().zip(&mut row_du[range]).enumerate() {
                    *sum += bv.values[0][j] * s + bv.values[1][j] * s_v;
                    *sum_du += bv.values[0][j] * s_u;
                }
            }
            for i in 0..=au.degree {
                let control = &mut plane[(bu.first + i) * nv..(bu.first + i + 1) * nv];
                let (value, slope) = (bu.values[0][i], bu.values[1][i]);
                for ((x, sum), sum_du) in control.iter_mut().zip(&row).zip(&row_du) {
                    *x += value * sum + slope * sum_du;
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

/// A symmetric banded n x n matrix, applied along one direction of a plane.
#[derive(Clone, Debug)]
pub struct Banded {
    size: usize,
    width: usize,
    /// Row i holds columns i - width ..= i + width, zero outside the matrix.
    rows: Vec<f64>,
}

impl Banded {
    /// The band of `matrix` of half-width `width`.
    pub fn new(matrix: &DMatrix<f64>, width: usize) -> Self {
        let size = matrix.nrows();
        let mut rows = vec![0.0; size * (2 * width + 1)];
        for i in 0..size {
            for j in i.saturating_sub(width)..=(i + width).min(size - 1) {
                rows[i * (2 * width + 1) + j + width - i] = matrix[(i, j)];
            }
        }
        Self { size, width, rows }
    }

    fn row(&self, i: usize) -> (usize, &[f64]) {
        let start = i.saturating_sub(self.width);
        let end = (i + self.width).min(self.size - 1);
        let offset = i * (2 * self.width + 1) + self.width;
        (start, &self.rows[offset + start - i..=offset + end - i])
    }

    /// Adds this matrix times `plane` (along u) to `out`.
    pub fn add_along_u(&self, plane: &[f64], columns: usize, out: &mut [f64]) {
        for i in 0..self.size {
            let (start, row) = self.row(i);
            let target = &mut out[i * columns..(i + 1) * columns];
            for (k, value) in row.iter().enumerate() {
                let source = &plane[(start + k) * columns..(start + k + 1) * columns];
                for (t, s) in target.iter_mut().zip(source) {
                    *t += value * s;
                }
            }
        }
    }

    /// `plane` times this matrix (along v), written to `out`.
    pub fn along_v(&self, plane: &[f64], out: &mut [f64]) {
        for (source, target) in plane.chunks_exact(self.size).zip(out.chunks_exact_mut(self.size)) {
            for (j, t) in target.iter_mut().enumerate() {
                let (start, row) = self.row(j);
                *t = row.iter().zip(&source[start..]).map(|(a, b)| a * b).sum();
            }
        }
    }
}

/// Inverse of c (Mu x Mv) + Ku x Mv + Mu x Kv on a plane, by simultaneous diagonalization of each direction's pair (K, M).
///
/// Source: Lynch, Rice, Thomas, "Direct solution of partial difference equations by tensor product methods", 1964.
#[derive(Clone, Debug)]
pub struct FastDiagonal {
    /// Generalized eigenvectors of each direction as columns, row by row; and transposed.
    vectors: [Vec<f64>; 2],
    transposed: [Vec<f64>; 2],
    sizes: [usize; 2],
    inverse: Vec<f64>,
}

impl FastDiagonal {
    /// Diagonalizes; `None` if a mass matrix is not positive definite.
    ///
    /// - `stiffness`, `mass`: Ku and Kv, Mu and Mv; `constant`: c > 0.
    pub fn new(stiffness: [&DMatrix<f64>; 2], mass: [&DMatrix<f64>; 2], constant: f64) -> Option<Self> {
        let mut values = vec![];
        let (mut vectors, mut transposed) = (vec![], vec![]);
        for (k, m) in stiffness.into_iter().zip(mass) {
            let lower = m.clone().cholesky()?.l();
            let half = lower.solve_lower_triangular(k)?;
            let reduced = lower.solve_lower_triangular(&half.transpose())?;
            let eigen = SymmetricEigen::new((&reduced + reduced.transpose()) * 0.5);
            let columns = lower.transpose().solve_upper_triangular(&eigen.eigenvectors)?;
            // nalgebra stores columns one after another: its data is the transpose, row by row.
            transposed.push(columns.as_slice().to_vec());
            vectors.push(columns.transpose().as_slice().to_vec());
            values.push(eigen.eigenvalues);
        }
        let sizes = [values[0].len(), values[1].len()];
        let inverse = values[0]
            .iter()
            .flat_map(|a| values[1].iter().map(move |b| 1.0 / (constant + a.max(0.0) + b.max(0.0))))
            .collect();
        let [u, v] = [vectors.remove(0), vectors.remove(0)];
        let [tu, tv] = [transposed.remove(0), transposed.remove(0)];
        Some(Self { vectors: [u, v], transposed: [tu, tv], sizes, inverse })
    }

    /// Replaces `plane` by the solution for it; `scratch` is as long.
    pub fn solve(&self, plane: &mut [f64], scratch: &mut [f64]) {
        let [nu, nv] = self.sizes;
        // Phi_u^T R Phi_v, scaled, then Phi_u X Phi_v^T.
        multiply(&self.transposed[0], plane, scratch, nu, nu, nv);
        multiply(scratch, &self.vectors[1], plane, nu, nv, nv);
        for (x, factor) in plane.iter_mut().zip(&self.inverse) {
            *x *= factor;
        }
        multiply(&self.vectors[0], plane, scratch, nu, nu, nv);
        multiply(scratch, &self.transposed[1], plane, nu, nv, nv);
    }
}

/// out = a b, row by row; a is rows x inner, b is inner x columns.
fn multiply(a: &[f64], b: &[f64], out: &mut [f64], rows: usize, inner: usize, columns: usize) {
    for i in 0..rows {
        let target = &mut out[i * columns..(i + 1) * columns];
        target.fill(0.0);
        let mut pairs = a[i * inner..(i + 1) * inner].chunks_exact(2);
        let mut k = 0;
        // Two rows of b at a time: half the traffic through `target`.
        for pair in &mut pairs {
            let (first, second) = b[k * columns..(k + 2) * columns].split_at(columns);
            for ((t, x), y) in target.iter_mut().zip(first).zip(second) {
                *t += pair[0] * x + pair[1] * y;
            }
            k += 2;
        }
        for value in pairs.remainder() {
            for (t, x) in target.iter_mut().zip(&b[k * columns..(k + 1) * columns]) {
                *t += value * x;
            }
        }
    }
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
