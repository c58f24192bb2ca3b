//! Smooth random conjugate fields on surfaces, and lines that follow them.
//!
//! The field is the library's own smoothest conjugate field under a few random constraints, solved on a coarse mesh and made
//! exactly conjugate where it is read. A pair of tangent directions with angles a and b is described by its sum s = a + b and
//! its difference d = a - b. With mean curvature H, half difference of the principal curvatures D and angle g of the first
//! principal direction,
//!
//!   II(a, b) = H cos d + D cos(s - 2 g),
//!
//! so that conjugate pairs are a curve in the (s, d) plane, and a pair is made conjugate by a few Newton steps in it.

use super::{Reason, Rejection};
use crate::control::Control;
use crate::field::{DirectionConstraint, FieldOptions, conjugate_field};
use crate::surface::{FundamentalForms, NurbsSurface, SurfaceMesh, SurfacePoint};
use nalgebra::{Complex, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI};

/// Cells of the mesh on which the field is solved, in each direction.
const CELLS: usize = 18;
/// Gauss-Newton iterations; the field is made conjugate again where it is read, so that few are enough.
const ITERATIONS: usize = 10;
/// Curvature below which a point counts as flat and leaves the pair as it is, 1 / canonical unit.
const FLAT: f64 = 0.01;
/// Smallest crossing angle that the field aims at, radians.
const MIN_CROSSING: f64 = 28.0 * PI / 180.0;
/// Crossing angle below which a point has no usable pair, radians.
const REFUSED_CROSSING: f64 = 20.0 * PI / 180.0;

/// A conjugate field over the parameter domain: PolyVector coefficients at the vertices of a regular grid, in the gauge frame
/// of each vertex, made conjugate where read.
pub(super) struct Directions {
    /// e^(2 i a) + e^(2 i b)
    sum: Vec<Complex<f64>>,
    /// e^(2 i (a + b))
    product: Vec<Complex<f64>>,
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
    /// A few points get a random direction, the rest follows by smoothness, as in the paper; the directions have something in
    /// common, as those of a designer do. With `by_parameters` the field follows the parameter lines instead.
    ///
    /// # Errors
    /// [`Reason::Field`] if there is no such field.
    pub fn random(surface: &NurbsSurface, by_parameters: bool, rng: &mut ChaCha8Rng) -> Result<Self, Rejection> {
        const ROW: usize = CELLS + 1;
        let fail = Rejection(Reason::Field);
        let mesh = SurfaceMesh::new(surface, [CELLS, CELLS]).map_err(|_| fail)?;
        let mut guess = vec![];
        let mut constraints = vec![];
        if by_parameters {
            guess = mesh
                .triangles
                .iter()
                .map(|t| {
                    let point = &mesh.points[t[0] as usize];
                    [point.dv, point.du]
                })
                .collect();
        } else {
            let base = rng.random_range(0.0..FRAC_PI_2);
            for _ in 0..rng.random_range(1..=5) {
                let triangle = rng.random_range(0..mesh.triangles.len());
                let point = &mesh.points[mesh.triangles[triangle][0] as usize];
                let normal = mesh.normals[mesh.triangles[triangle][0] as usize];
                let e1 = point.du.normalize();
                let angle = base + rng.random_range(-0.35..0.35);
                let direction = e1 * angle.cos() + normal.cross(&e1) * angle.sin();
                constraints.push(DirectionConstraint { triangle: triangle as u32, direction, weight: 40.0 });
            }
        }
        let options = FieldOptions {
            crossing_floor_deg: MIN_CROSSING.to_degrees(),
            iterations: ITERATIONS,
            ..FieldOptions::default()
        };
        let guess = by_parameters.then_some(guess.as_slice());
        let field = conjugate_field(mesh, guess, &constraints, &options, &Control::default()).map_err(|_| fail)?;

        let mesh = &field.mesh;
        let mut sum = vec![Complex::new(0.0, 0.0); ROW * ROW];
        let mut product = sum.clone();
        for (triangle, corners) in mesh.triangles.iter().enumerate() {
            let pair = [0, 1].map(|k| field.direction(triangle as u32, k));
            for &vertex in corners {
                let vertex = vertex as usize;
                let e1 = mesh.points[vertex].du.normalize();
                let e2 = mesh.normals[vertex].cross(&e1);
                let [a, b] = pair.map(|d| d.dot(&e2).atan2(d.dot(&e1)));
                sum[vertex] += Complex::from_polar(1.0, 2.0 * a) + Complex::from_polar(1.0, 2.0 * b);
                product[vertex] += Complex::from_polar(1.0, 2.0 * (a + b));
            }
        }
        // Means over the triangles about a vertex: one to six.
        for (s, p) in sum.iter_mut().zip(&mut product) {
            let size = p.norm().max(1e-9);
            *s /= size;
            *p /= size;
        }
        Ok(Self { sum, product })
    }

    /// The coefficients at (u, v), smoothed over the neighbouring vertices by a uniform cubic B-spline.
    fn coefficients(&self, uv: [f64; 2]) -> [Complex<f64>; 2] {
        const ROW: usize = CELLS + 1;
        let place = |x: f64| {
            let x = (x * CELLS as f64).clamp(0.0, CELLS as f64 - 1e-9);
            let t = x.fract();
            let w = [
                (1.0 - t).powi(3),
                3.0 * t.powi(3) - 6.0 * t * t + 4.0,
                3.0 * (t + t * t - t.powi(3)) + 1.0,
                t.powi(3),
            ];
            (x.floor() as isize, w.map(|w| w / 6.0))
        };
        let clamp = |k: isize| k.clamp(0, CELLS as isize) as usize;
        let ((i, wu), (j, wv)) = (place(uv[0]), place(uv[1]));
        let mut result = [Complex::new(0.0, 0.0); 2];
        for (a, wu) in wu.iter().enumerate() {
            for (b, wv) in wv.iter().enumerate() {
                let k = clamp(i + a as isize - 1) * ROW + clamp(j + b as isize - 1);
                result[0] += self.sum[k] * (wu * wv);
                result[1] += self.product[k] * (wu * wv);
            }
        }
        result
    }

    /// The pair at (u, v); `None` at singularities, and where its directions cross at less than 20 degrees or cannot be made
    /// conjugate. Order and signs of the two are arbitrary.
    pub fn at(&self, point: &SurfacePoint, uv: [f64; 2]) -> Option<Pair> {
        let [sum, product] = self.coefficients(uv);
        if product.norm() < 0.2 {
            return None;
        }
        let s = 0.5 * product.arg();
        let d = (0.5 * (sum / product.norm() * Complex::from_polar(1.0, -s)).re).clamp(-0.95, 0.95).acos();
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
/// `inside` says whether a surface point may be drawn; the line ends before the first that may not, and at singularities.
pub(super) fn trace(
    surface: &NurbsSurface,
    directions: &Directions,
    family: usize,
    start: [f64; 2],
    length: f64,
    inside: impl Fn([f64; 2], &SurfacePoint) -> bool,
) -> Vec<[f64; 2]> {
    const STEP: f64 = 0.08;
    // The branch of the cross that continues a direction; a sharp turn is a place where the field is not smooth.
    let velocity = |uv: [f64; 2], heading: &Vector3<f64>| {
        let pair = directions.at(&surface.evaluate(uv[0], uv[1]), uv)?;
        let along = pair.vectors.map(|v| v.dot(heading));
        let k = usize::from(along[1].abs() > along[0].abs());
        (along[k].abs() > 0.9)
            .then(|| (pair.vectors[k] * along[k].signum(), pair.parameters[k].map(|x| x * along[k].signum())))
    };
    let Some(first) = directions.at(&surface.evaluate(start[0], start[1]), start) else { return vec![] };
    let mut halves = [vec![], vec![]];
    for (half, sign) in halves.iter_mut().zip([1.0, -1.0]) {
        let (mut uv, mut heading) = (start, first.vectors[family] * sign);
        for _ in 0..(0.5 * length / STEP) as usize {
            // Midpoint rule.
            let Some((direction, k)) = velocity(uv, &heading) else { break };
            let Some((direction, k)) = velocity([uv[0] + 0.5 * STEP * k[0], uv[1] + 0.5 * STEP * k[1]], &direction)
            else {
                break;
            };
            let next = [uv[0] + STEP * k[0], uv[1] + STEP * k[1]];
            if next.iter().any(|&x| !(0.004..=0.996).contains(&x)) || !inside(next, &surface.evaluate(next[0], next[1]))
            {
                break;
            }
            half.push(next);
            (uv, heading) = (next, direction);
        }
    }
    let [forward, backward] = halves;
    backward.into_iter().rev().chain(std::iter::once(start)).chain(forward).collect()
}
