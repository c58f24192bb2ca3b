//! Smooth random conjugate fields on surfaces, and lines that follow them.
//!
//! A pair of tangent directions with angles a and b is described by its sum s = a + b and its difference d = a - b. With
//! mean curvature H, half difference of the principal curvatures D and angle g of the first principal direction,
//!
//!   II(a, b) = H cos d + D cos(s - 2 g),
//!
//! so that conjugate pairs are a curve in the (s, d) plane, and a pair is made conjugate by a few Newton steps in it.

use super::surfaces::greville;
use crate::surface::{FundamentalForms, KnotVector, NurbsSurface, SurfacePoint};
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI};

/// Control points of the field in each direction.
const NODES: usize = 15;
/// Curvature below which a point counts as flat and leaves the pair as it is, 1 / canonical unit.
const FLAT: f64 = 0.01;
/// Smallest crossing angle that the field aims at, radians.
const MIN_CROSSING: f64 = 28.0 * PI / 180.0;
/// Crossing angle below which a point has no usable pair, radians.
const REFUSED_CROSSING: f64 = 20.0 * PI / 180.0;

/// A field without singularities: cubic B-spline functions s and d over the parameter domain, made conjugate where read.
pub(super) struct Directions {
    knots: KnotVector,
    sum: Vec<f64>,
    difference: Vec<f64>,
}

/// The pair at one surface point.
#[derive(Clone, Copy)]
pub(super) struct Pair {
    /// Unit tangent directions, frame of the surface.
    pub vectors: [Vector3<f64>; 2],
    /// The same as parameter directions: S_u a + S_v b is the vector.
    pub parameters: [[f64; 2]; 2],
    /// |II(a, b)| over the norm of II, or over [`FLAT`] where that is larger.
    pub residual: f64,
}

/// Curvature at a point in the gauge frame (S_u / |S_u|, n x S_u / |S_u|).
struct Shape {
    mean: f64,
    half_difference: f64,
    /// Twice the angle of the principal direction.
    double_angle: f64,
    e1: Vector3<f64>,
    e2: Vector3<f64>,
}

impl Shape {
    fn new(point: &SurfacePoint) -> Option<(Self, FundamentalForms)> {
        let forms = FundamentalForms::new(point)?;
        let e1 = point.du.normalize();
        let e2 = forms.normal.cross(&e1);
        let m = forms.second_in(point, &e1, &e2);
        let mean = 0.5 * (m[(0, 0)] + m[(1, 1)]);
        let (x, y) = (0.5 * (m[(0, 0)] - m[(1, 1)]), m[(0, 1)]);
        Some((Self { mean, half_difference: x.hypot(y), double_angle: y.atan2(x), e1, e2 }, forms))
    }

    /// The conjugate pair next to (s, d), and its residual.
    fn conjugate(&self, mut s: f64, mut d: f64, rounds: usize) -> (f64, f64, f64) {
        let size = self.mean.hypot(self.half_difference).max(FLAT);
        let (h, k) = (self.mean / size, self.half_difference / size);
        let mut residual = 0.0;
        for round in 0..=rounds {
            let (sine_d, cosine_d) = d.sin_cos();
            let (sine_s, cosine_s) = (s - self.double_angle).sin_cos();
            residual = h * cosine_d + k * cosine_s;
            if round == rounds || residual.abs() < 1e-7 {
                break;
            }
            let (fs, fd) = (-k * sine_s, -h * sine_d);
            let square = fs * fs + fd * fd;
            // Flat points would throw the pair about: steps fade out with the curvature.
            let step = residual / (square + 1e-4);
            s -= (step * fs).clamp(-0.4, 0.4);
            let next = (d - (step * fd).clamp(-0.4, 0.4)).clamp(MIN_CROSSING, PI - MIN_CROSSING);
            if next == d && fs.abs() > 1e-3 {
                // The crossing angle is at its floor: the sum alone has to do it.
                s -= (residual / fs).clamp(-0.2, 0.2) * 0.5;
            }
            d = next;
        }
        (s, d, residual.abs())
    }
}

impl Directions {
    /// A random smooth field on `surface`.
    ///
    /// One to four points get a random conjugate pair, the rest follows by smoothing, as in the paper. With
    /// `by_parameters` the field follows the parameter lines instead.
    pub fn random(surface: &NurbsSurface, by_parameters: bool, rng: &mut ChaCha8Rng) -> Self {
        let knots = KnotVector::uniform(3, NODES);
        let greville = greville(NODES);
        let nodes: Vec<Option<(Shape, f64)>> = greville
            .iter()
            .flat_map(|&u| greville.iter().map(move |&v| [u, v]))
            .map(|[u, v]| {
                let point = surface.evaluate(u, v);
                let (shape, _) = Shape::new(&point)?;
                let across = point.dv.dot(&shape.e2).atan2(point.dv.dot(&shape.e1));
                Some((shape, across))
            })
            .collect();
        let turn = if by_parameters { 0.0 } else { rng.random_range(-0.8..0.8) };
        // Positive angle of the first direction minus the second: the first is the one nearer to S_v.
        let base = |k: usize| match &nodes[k] {
            Some((_, across)) if by_parameters => (*across, *across),
            Some((_, across)) => (across + 2.0 * turn, 0.5 * (across + FRAC_PI_2)),
            None => (FRAC_PI_2, FRAC_PI_2),
        };
        let (mut sum, mut difference): (Vec<f64>, Vec<f64>) = (0..NODES * NODES).map(base).unzip();
        let start = (sum.clone(), difference.clone());
        let mut fixed = vec![false; NODES * NODES];
        if !by_parameters {
            for _ in 0..rng.random_range(1..=4) {
                let k = rng.random_range(0..NODES * NODES);
                sum[k] += rng.random_range(-1.0..1.0);
                difference[k] = rng.random_range(0.38..0.62) * PI;
                if let Some((shape, _)) = &nodes[k] {
                    (sum[k], difference[k], _) = shape.conjugate(sum[k], difference[k], 8);
                }
                fixed[k] = true;
            }
        }
        let pull = if by_parameters { 4.0 } else { 0.02 };
        let sweeps = if by_parameters { 8 } else { 50 };
        for sweep in 0..sweeps {
            for step in 0..NODES * NODES {
                let k = if sweep % 2 == 0 { step } else { NODES * NODES - 1 - step };
                if fixed[k] {
                    continue;
                }
                let (i, j) = (k / NODES, k % NODES);
                let (mut total, mut weight) = ([pull * start.0[k], pull * start.1[k]], pull);
                let mut add = |n: usize| {
                    let w = if fixed[n] { 2.0 } else { 1.0 };
                    total[0] += w * sum[n];
                    total[1] += w * difference[n];
                    weight += w;
                };
                if i > 0 {
                    add(k - NODES);
                }
                if i + 1 < NODES {
                    add(k + NODES);
                }
                if j > 0 {
                    add(k - 1);
                }
                if j + 1 < NODES {
                    add(k + 1);
                }
                let mut next = (total[0] / weight, total[1] / weight);
                if let Some((shape, _)) = &nodes[k] {
                    let (s, d, _) = shape.conjugate(next.0, next.1, 2);
                    next = (s, d);
                }
                sum[k] = next.0;
                difference[k] = next.1;
            }
        }
        Self { knots, sum, difference }
    }

    /// The pair at (u, v); `None` where its directions cross at less than 20 degrees or cannot be made conjugate.
    pub fn at(&self, point: &SurfacePoint, uv: [f64; 2]) -> Option<Pair> {
        let (bu, bv) = (self.knots.basis(uv[0]), self.knots.basis(uv[1]));
        let (mut s, mut d) = (0.0, 0.0);
        for i in 0..4 {
            for j in 0..4 {
                let w = bu.values[0][i] * bv.values[0][j];
                let k = (bu.first + i) * NODES + bv.first + j;
                s += w * self.sum[k];
                d += w * self.difference[k];
            }
        }
        let (shape, forms) = Shape::new(point)?;
        let (s, d, residual) = shape.conjugate(s, d, 12);
        let crossing = d.rem_euclid(PI);
        if residual > 1e-3 || crossing.min(PI - crossing) < REFUSED_CROSSING {
            return None;
        }
        let angles = [0.5 * (s + d), 0.5 * (s - d)];
        let vectors = angles.map(|a| shape.e1 * a.cos() + shape.e2 * a.sin());
        let parameters = vectors.map(|v| {
            let c = forms.components(point, &v);
            [c.x, c.y]
        });
        Some(Pair { vectors, parameters, residual })
    }
}

/// Follows one family of the field from `start` in both directions for `length` of the surface.
///
/// `inside` says whether a surface point may be drawn; the line ends before the first that may not.
pub(super) fn trace(
    surface: &NurbsSurface,
    directions: &Directions,
    family: usize,
    start: [f64; 2],
    length: f64,
    inside: impl Fn([f64; 2], &SurfacePoint) -> bool,
) -> Vec<[f64; 2]> {
    const STEP: f64 = 0.08;
    let mut halves = [vec![], vec![]];
    for (half, sign) in halves.iter_mut().zip([1.0, -1.0]) {
        let mut uv = start;
        let velocity = |uv: [f64; 2]| {
            let point = surface.evaluate(uv[0], uv[1]);
            directions.at(&point, uv).map(|pair| pair.parameters[family].map(|x| x * sign))
        };
        for _ in 0..(0.5 * length / STEP) as usize {
            // Midpoint rule: the field has no singularity, signs stay.
            let Some(k) = velocity(uv) else { break };
            let Some(k) = velocity([uv[0] + 0.5 * STEP * k[0], uv[1] + 0.5 * STEP * k[1]]) else { break };
            let next = [uv[0] + STEP * k[0], uv[1] + STEP * k[1]];
            if next.iter().any(|&x| !(0.004..=0.996).contains(&x)) || !inside(next, &surface.evaluate(next[0], next[1]))
            {
                break;
            }
            half.push(next);
            uv = next;
        }
    }
    let [forward, backward] = halves;
    backward.into_iter().rev().chain(std::iter::once(start)).chain(forward).collect()
}
