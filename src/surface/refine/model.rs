//! The energy of a control net and its quadratic model.

use super::super::knots::Basis;
use super::super::nurbs::NurbsSurface;
use super::super::tensor::GridPlanes;
use super::Refiner;
use super::grid_sample::Turn;
use super::solve::dot;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// The energy at one net and its quadratic model: half the gradient, and what its Gauss-Newton Hessian is made of.
pub(super) struct Model {
    pub(super) energy: f64,
    /// Energy and half its gradient without fairness, evenness and closeness.
    pub(super) data: (f64, Vec<f64>),
    pub(super) folds: usize,
    pub(super) depth_squared: f64,
    pub(super) gradient: Vec<f64>,
    /// Upper triangles xx, xy, xz, yy, yz, zz of the weight matrices on dS at the grid samples.
    pub(super) weights: Vec<[f64; 6]>,
    /// Map normal and weights on N . dS_u, N . dS_v.
    pub(super) tangents: Vec<(Vector3<f64>, f64, f64)>,
    pub(super) turns: Vec<Turn>,
    pub(super) rows: Vec<Row>,
}

/// One residual at a scattered parameter: direction . S(u, v) moves it.
pub(super) struct Row {
    pub(super) bases: [Basis; 2],
    pub(super) direction: Vector3<f64>,
    pub(super) weight: f64,
    pub(super) residual: f64,
}

impl Refiner<'_> {
    /// Energy and quadratic model at `net`.
    pub(super) fn linearize(&self, net: &[f64]) -> Model {
        let n = net.len() / 3;
        let planes = self.planes(net);
        let columns = self.grid.axes[1].len();
        let (samples, (scattered, rows)) = rayon::join(
            || {
                let (layers, facing) = self.border_layers(&planes);
                let at = |k| self.grid_sample(k, &planes, layers[k], facing[k]);
                let mut samples = vec![];
                (0..self.grid.len()).into_par_iter().with_min_len(columns).map(at).collect_into_vec(&mut samples);
                self.border_term(&planes, &mut samples);
                samples
            },
            || {
                let mut rows = vec![];
                let energy = self.surface_or_none(net).map_or(f64::INFINITY, |surface| {
                    self.contour_term(&surface, &planes, &mut rows) + self.sample_term(&surface, &planes, &mut rows)
                });
                (energy, rows)
            },
        );
        let energy = scattered + samples.iter().map(|sample| sample.energy).sum::<f64>();
        let facings: Vec<f64> = samples.iter().map(|sample| sample.facing).collect();
        let mut gradient = vec![0.0; 3 * n];
        gradient.par_chunks_exact_mut(n).enumerate().for_each(|(c, gradient)| {
            let [value, du, dv] = [0, 1, 2].map(|of| samples.iter().map(|sample| sample.slope[of][c]).collect());
            self.grid.add_adjoint(&GridPlanes { value, du, dv }, gradient);
        });
        for row in &rows {
            self.add_row_adjoint(row, row.weight * row.residual, &mut gradient);
        }
        let mut model = Model {
            energy,
            data: (energy, gradient),
            folds: self.count_folds(&facings, &planes),
            depth_squared: samples.iter().map(|sample| sample.depth_squared).sum(),
            gradient: vec![],
            weights: samples.iter().map(|sample| sample.weights).collect(),
            tangents: samples.iter().map(|sample| sample.tangent).collect(),
            turns: samples.into_iter().filter_map(|sample| sample.turn).collect(),
            rows,
        };
        self.regularize(net, &mut model);
        model
    }

    /// Sets energy and gradient of `model`, made at `net`, from those of its data and the present stiffness.
    pub(super) fn regularize(&self, net: &[f64], model: &mut Model) {
        let n = net.len() / 3;
        let (mut energy, mut gradient) = model.data.clone();
        let mut product = vec![0.0; n];
        let mut scratch = vec![0.0; n];
        let mut difference = vec![0.0; n];
        for c in 0..3 {
            let part = &net[c * n..(c + 1) * n];
            product.fill(0.0);
            self.add_tensor(&self.fairness, part, &mut product, &mut scratch);
            energy += dot(part, &product);
            add(&mut gradient[c * n..(c + 1) * n], &product);
            for (d, (now, before)) in difference.iter_mut().zip(part.iter().zip(&self.start[c * n..])) {
                *d = now - before;
            }
            product.fill(0.0);
            self.add_tensor(&self.evenness[c / 2], &difference, &mut product, &mut scratch);
            product.iter_mut().for_each(|x| *x *= self.stiffness);
            energy += dot(&difference, &product);
            add(&mut gradient[c * n..(c + 1) * n], &product);
        }
        if let Some(guess) = &self.guess {
            for c in 0..3 {
                let part = c * n..(c + 1) * n;
                for (d, (now, guess)) in difference.iter_mut().zip(net[part.clone()].iter().zip(&guess[part.clone()])) {
                    *d = now - guess;
                }
                product.fill(0.0);
                self.add_tensor(&self.guessed, &difference, &mut product, &mut scratch);
                energy += dot(&difference, &product);
                add(&mut gradient[part], &product);
            }
        }
        model.energy = if energy.is_nan() { f64::INFINITY } else { energy };
        model.gradient = gradient;
    }

    fn surface_or_none(&self, net: &[f64]) -> Option<NurbsSurface> {
        let n = net.len() / 3;
        let points = (0..n).map(|k| Point3::new(net[k], net[n + k], net[2 * n + k])).collect();
        NurbsSurface::new(self.knots.clone(), points, None).ok()
    }
}

fn add(a: &mut [f64], b: &[f64]) {
    for (x, y) in a.iter_mut().zip(b) {
        *x += y;
    }
}
