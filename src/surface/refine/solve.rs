//! One Gauss-Newton step: conjugate gradients on the quadratic model, which is never built as a matrix.

use super::super::tensor::{Banded, GridPlanes};
use super::Refiner;
use super::model::{Model, Row};

/// Conjugate gradient steps for one of these: what unfolds is stiff, and the preconditioner does not know it.
const UNFOLDING_CG_STEPS: usize = 40;
/// Conjugate gradient steps for one Gauss-Newton step, and the share of the preconditioned residual that remains.
const CG_STEPS: usize = 14;
const CG_TOLERANCE: f64 = 0.1;

struct Work {
    planes: [GridPlanes; 3],
    turned: Vec<f64>,
    scratch: Vec<f64>,
}

impl Refiner<'_> {
    /// Adds (A_u x M_v + M_u x A_v) `plane` to `out`.
    pub(super) fn add_tensor(&self, matrices: &[Banded; 2], plane: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        let columns = self.knots[1].count();
        self.mass[1].along_v(plane, scratch);
        matrices[0].add_along_u(scratch, columns, out);
        matrices[1].along_v(plane, scratch);
        self.mass[0].add_along_u(scratch, columns, out);
    }

    fn row_value(&self, row: &Row, net: &[f64]) -> f64 {
        let n = net.len() / 3;
        let columns = self.knots[1].count();
        let [bu, bv] = &row.bases;
        let mut sum = 0.0;
        for i in 0..4 {
            for j in 0..4 {
                let k = (bu.first + i) * columns + bv.first + j;
                let weight = bu.values[0][i] * bv.values[0][j];
                sum += weight
                    * (row.direction.x * net[k] + row.direction.y * net[n + k] + row.direction.z * net[2 * n + k]);
            }
        }
        sum
    }

    pub(super) fn add_row_adjoint(&self, row: &Row, value: f64, out: &mut [f64]) {
        let n = out.len() / 3;
        let columns = self.knots[1].count();
        let [bu, bv] = &row.bases;
        for i in 0..4 {
            for j in 0..4 {
                let k = (bu.first + i) * columns + bv.first + j;
                let weight = bu.values[0][i] * bv.values[0][j] * value;
                out[k] += row.direction.x * weight;
                out[n + k] += row.direction.y * weight;
                out[2 * n + k] += row.direction.z * weight;
            }
        }
    }

    /// out = H x, H the Gauss-Newton Hessian (of half the energy).
    fn apply(&self, model: &Model, x: &[f64], out: &mut [f64], work: &mut Work) {
        let n = x.len() / 3;
        out.fill(0.0);
        for c in 0..3 {
            self.grid.forward(&x[c * n..(c + 1) * n], &mut work.planes[c]);
        }
        let [px, py, pz] = &mut work.planes;
        work.turned.clear();
        work.turned.extend(model.turns.iter().map(|turn| {
            let (k, [xu, yu, xv, yv]) = (turn.sample, turn.slope);
            turn.weight * (xu * px.du[k] + yu * py.du[k] + xv * px.dv[k] + yv * py.dv[k])
        }));
        for (k, w) in model.weights.iter().enumerate() {
            let (x, y, z) = (px.value[k], py.value[k], pz.value[k]);
            px.value[k] = w[0] * x + w[1] * y + w[2] * z;
            py.value[k] = w[1] * x + w[3] * y + w[4] * z;
            pz.value[k] = w[2] * x + w[4] * y + w[5] * z;
            let (normal, wu, wv) = &model.tangents[k];
            let du = wu * (normal.x * px.du[k] + normal.y * py.du[k] + normal.z * pz.du[k]);
            let dv = wv * (normal.x * px.dv[k] + normal.y * py.dv[k] + normal.z * pz.dv[k]);
            (px.du[k], py.du[k], pz.du[k]) = (normal.x * du, normal.y * du, normal.z * du);
            (px.dv[k], py.dv[k], pz.dv[k]) = (normal.x * dv, normal.y * dv, normal.z * dv);
        }
        for (turn, value) in model.turns.iter().zip(&work.turned) {
            let (k, [xu, yu, xv, yv]) = (turn.sample, turn.slope.map(|slope| slope * value));
            px.du[k] += xu;
            py.du[k] += yu;
            px.dv[k] += xv;
            py.dv[k] += yv;
        }
        for c in 0..3 {
            self.grid.add_adjoint(&work.planes[c], &mut out[c * n..(c + 1) * n]);
        }
        for row in &model.rows {
            self.add_row_adjoint(row, row.weight * self.row_value(row, x), out);
        }
        for c in 0..3 {
            let (part, target) = (&x[c * n..(c + 1) * n], &mut out[c * n..(c + 1) * n]);
            self.add_tensor(&self.regularity[c / 2], part, target, &mut work.scratch);
        }
    }

    /// The Gauss-Newton step: H step = -gradient, by preconditioned conjugate gradients, inexactly.
    ///
    /// - `unfolding`: whether folds are being smoothed out.
    pub(super) fn solve(&self, model: &Model, unfolding: bool) -> Vec<f64> {
        let steps = if unfolding { UNFOLDING_CG_STEPS } else { CG_STEPS };
        let size = model.gradient.len();
        let n = size / 3;
        let mut work = Work { planes: Default::default(), turned: vec![], scratch: vec![0.0; n] };
        let mut step = vec![0.0; size];
        let mut residual: Vec<f64> = model.gradient.iter().map(|g| -g).collect();
        let precondition = |residual: &[f64], scratch: &mut [f64]| {
            let mut z = residual.to_vec();
            for c in 0..3 {
                self.preconditioner[c / 2].solve(&mut z[c * n..(c + 1) * n], scratch);
            }
            z
        };
        let mut z = precondition(&residual, &mut work.scratch);
        let mut direction = z.clone();
        let mut product = vec![0.0; size];
        let mut rho = dot(&residual, &z);
        let target = rho * CG_TOLERANCE * CG_TOLERANCE;
        for _ in 0..steps {
            if rho.is_nan() || rho <= target || rho == 0.0 {
                break;
            }
            self.apply(model, &direction, &mut product, &mut work);
            let alpha = rho / dot(&direction, &product);
            for k in 0..size {
                step[k] += alpha * direction[k];
                residual[k] -= alpha * product[k];
            }
            z = precondition(&residual, &mut work.scratch);
            let next = dot(&residual, &z);
            let beta = next / rho;
            for (d, z) in direction.iter_mut().zip(&z) {
                *d = z + beta * *d;
            }
            rho = next;
        }
        step
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
