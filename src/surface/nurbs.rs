//! NURBS surfaces: control net, evaluation, derivatives.

use super::knots::{Basis, KnotVector};
use crate::error::Error;
use nalgebra::{Point3, Vector3};

/// A NURBS surface: two clamped knot vectors and a control net, weights optional.
#[derive(Clone, Debug, PartialEq)]
pub struct NurbsSurface {
    knots: [KnotVector; 2],
    control_points: Vec<Point3<f64>>,
    weights: Option<Vec<f64>>,
}

/// A surface point with its derivatives up to second order.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// S(u, v)
    pub position: Point3<f64>,
    /// S_u
    pub du: Vector3<f64>,
    /// S_v
    pub dv: Vector3<f64>,
    /// S_uu
    pub duu: Vector3<f64>,
    /// S_uv
    pub duv: Vector3<f64>,
    /// S_vv
    pub dvv: Vector3<f64>,
}

impl NurbsSurface {
    /// Checks and takes a surface.
    ///
    /// - `knots`: in u and in v.
    /// - `control_points`: count_u * count_v points, v running fastest: point (i, j) is at `i * count_v + j`.
    /// - `weights`: one positive weight for each point, or `None` for a polynomial surface.
    ///
    /// # Errors
    /// [`Error::Nurbs`] if counts disagree, a coordinate is not finite, or a weight is not positive.
    pub fn new(
        knots: [KnotVector; 2],
        control_points: Vec<Point3<f64>>,
        weights: Option<Vec<f64>>,
    ) -> Result<Self, Error> {
        let expected = knots[0].count() * knots[1].count();
        let fail = |reason: String| Err(Error::Nurbs { reason });
        if control_points.len() != expected {
            return fail(format!("{} control points, the knots ask for {expected}", control_points.len()));
        }
        if let Some(i) = control_points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return fail(format!("control point {i} is not finite"));
        }
        if let Some(weights) = &weights {
            if weights.len() != expected {
                return fail(format!("{} weights for {expected} control points", weights.len()));
            }
            if let Some(i) = weights.iter().position(|w| !w.is_finite() || *w <= 0.0) {
                return fail(format!("weight {i} is not positive"));
            }
        }
        Ok(Self { knots, control_points, weights })
    }

    /// A polynomial surface with uniform knots over [0, 1]^2.
    ///
    /// # Errors
    /// [`Error::Nurbs`] as [`NurbsSurface::new`].
    pub fn uniform(degree: usize, counts: [usize; 2], control_points: Vec<Point3<f64>>) -> Result<Self, Error> {
        if counts.iter().any(|&c| c <= degree) || degree == 0 || degree > super::MAX_DEGREE {
            return Err(Error::Nurbs { reason: format!("{counts:?} control points of degree {degree}") });
        }
        Self::new(counts.map(|c| KnotVector::uniform(degree, c)), control_points, None)
    }

    /// Knot vectors in u and v.
    pub fn knots(&self) -> &[KnotVector; 2] {
        &self.knots
    }

    /// Control points, v running fastest.
    pub fn control_points(&self) -> &[Point3<f64>] {
        &self.control_points
    }

    /// Weights in the order of the control points; `None` if all are 1.
    pub fn weights(&self) -> Option<&[f64]> {
        self.weights.as_deref()
    }

    /// Number of control points in u and v.
    pub fn counts(&self) -> [usize; 2] {
        [self.knots[0].count(), self.knots[1].count()]
    }

    /// The same surface with every control point mapped by an affine `map`.
    pub fn mapped(&self, map: impl Fn(&Point3<f64>) -> Point3<f64>) -> Self {
        Self { control_points: self.control_points.iter().map(map).collect(), ..self.clone() }
    }

    /// The parameters at the fractions `s`, `t` in [0, 1] of the two domains.
    pub fn at_fraction(&self, s: f64, t: f64) -> [f64; 2] {
        [self.knots[0].at_fraction(s), self.knots[1].at_fraction(t)]
    }

    /// S(u, v); parameters are clamped to the domain.
    pub fn point(&self, u: f64, v: f64) -> Point3<f64> {
        let (bu, bv) = (self.knots[0].basis(u), self.knots[1].basis(v));
        let count_v = self.knots[1].count();
        let (mut a, mut w) = (Vector3::zeros(), 0.0);
        for i in 0..=self.knots[0].degree() {
            for j in 0..=self.knots[1].degree() {
                let index = (bu.first + i) * count_v + bv.first + j;
                let weight = self.weights.as_ref().map_or(1.0, |w| w[index]);
                let value = weight * bu.values[0][i] * bv.values[0][j];
                a += self.control_points[index].coords * value;
                w += value;
            }
        }
        Point3::from(if self.weights.is_none() { a } else { a / w })
    }

    /// S and its derivatives up to second order at (u, v); parameters are clamped to the domain.
    pub fn evaluate(&self, u: f64, v: f64) -> SurfacePoint {
        self.evaluate_with(&self.knots[0].basis(u), &self.knots[1].basis(v))
    }

    /// S and its derivatives at the basis functions of `knots()[0]` and `knots()[1]` that the caller already has.
    ///
    /// Several times faster than [`NurbsSurface::evaluate`] where many points share a parameter.
    pub fn evaluate_with(&self, bu: &Basis, bv: &Basis) -> SurfacePoint {
        let count_v = self.knots[1].count();
        let (degree_u, degree_v) = (self.knots[0].degree(), self.knots[1].degree());
        if self.weights.is_none() {
            let mut a = [Vector3::zeros(); 6];
            for i in 0..=degree_u {
                let start = (bu.first + i) * count_v + bv.first;
                // The row's curve and its derivatives in v, then their sums over u.
                let mut row = [Vector3::zeros(); 3];
                for (j, point) in self.control_points[start..=start + degree_v].iter().enumerate() {
                    for (k, sum) in row.iter_mut().enumerate() {
                        *sum += point.coords * bv.values[k][j];
                    }
                }
                for (sum, (du, dv)) in a.iter_mut().zip(ORDERS) {
                    *sum += row[dv] * bu.values[du][i];
                }
            }
            return SurfacePoint { position: Point3::from(a[0]), du: a[1], dv: a[2], duu: a[3], duv: a[4], dvv: a[5] };
        }
        // Homogeneous sums A = sum w_i N_i p_i and W = sum w_i N_i for each order of derivative.
        let mut a = [Vector3::zeros(); 6];
        let mut w = [0.0; 6];
        for i in 0..=degree_u {
            for j in 0..=degree_v {
                let index = (bu.first + i) * count_v + bv.first + j;
                let weight = self.weights.as_ref().map_or(1.0, |w| w[index]);
                let point = self.control_points[index].coords;
                for (k, &(du, dv)) in ORDERS.iter().enumerate() {
                    let value = weight * bu.values[du][i] * bv.values[dv][j];
                    a[k] += point * value;
                    w[k] += value;
                }
            }
        }
        let s = a[0] / w[0];
        let du = (a[1] - s * w[1]) / w[0];
        let dv = (a[2] - s * w[2]) / w[0];
        SurfacePoint {
            position: Point3::from(s),
            du,
            dv,
            duu: (a[3] - du * (2.0 * w[1]) - s * w[3]) / w[0],
            duv: (a[4] - du * w[2] - dv * w[1] - s * w[4]) / w[0],
            dvv: (a[5] - dv * (2.0 * w[2]) - s * w[5]) / w[0],
        }
    }

    /// S and its derivatives on the grid of the parameters `us` times `vs`, v running fastest.
    pub fn evaluate_grid(&self, us: &[f64], vs: &[f64]) -> Vec<SurfacePoint> {
        let columns: Vec<Basis> = vs.iter().map(|&v| self.knots[1].basis(v)).collect();
        let mut points = Vec::with_capacity(us.len() * vs.len());
        for &u in us {
            let row = self.knots[0].basis(u);
            points.extend(columns.iter().map(|column| self.evaluate_with(&row, column)));
        }
        points
    }
}

/// Orders of derivative in u and v of S, S_u, S_v, S_uu, S_uv, S_vv.
const ORDERS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];

#[cfg(test)]
mod tests {
    use super::*;

    fn wavy() -> NurbsSurface {
        let points = (0..6 * 7)
            .map(|k| {
                let (i, j) = ((k / 7) as f64, (k % 7) as f64);
                Point3::new(i, j, (i * 1.3 + j * 0.7).sin())
            })
            .collect();
        let weights = (0..42).map(|k| 1.0 + 0.5 * (k as f64).cos()).collect();
        let knots = [KnotVector::uniform(3, 6), KnotVector::uniform(2, 7)];
        NurbsSurface::new(knots, points, Some(weights)).unwrap()
    }

    #[test]
    fn derivatives_match_finite_differences() {
        let surface = wavy();
        let h = 1e-5;
        for (u, v) in [(0.31, 0.47), (0.11, 0.93), (0.77, 0.05)] {
            let at = |du: f64, dv: f64| surface.evaluate(u + du * h, v + dv * h);
            let here = at(0.0, 0.0);
            let central = |a: Vector3<f64>, b: Vector3<f64>| (a - b) / (2.0 * h);
            let pairs = [
                (here.du, central(at(1.0, 0.0).position.coords, at(-1.0, 0.0).position.coords)),
                (here.dv, central(at(0.0, 1.0).position.coords, at(0.0, -1.0).position.coords)),
                (here.duu, central(at(1.0, 0.0).du, at(-1.0, 0.0).du)),
                (here.duv, central(at(0.0, 1.0).du, at(0.0, -1.0).du)),
                (here.dvv, central(at(0.0, 1.0).dv, at(0.0, -1.0).dv)),
            ];
            for (exact, difference) in pairs {
                assert!((exact - difference).norm() < 1e-5 * (1.0 + exact.norm()));
            }
        }
    }

    #[test]
    fn points_and_grids_agree_with_single_evaluations() {
        let rational = wavy();
        let plain = NurbsSurface::new(rational.knots().clone(), rational.control_points().to_vec(), None).unwrap();
        for surface in [rational, plain] {
            let (us, vs) = ([0.0, 0.2, 0.55, 1.0], [0.0, 0.71, 1.0]);
            let grid = surface.evaluate_grid(&us, &vs);
            for (i, &u) in us.iter().enumerate() {
                for (j, &v) in vs.iter().enumerate() {
                    let (a, b) = (&grid[i * 3 + j], surface.evaluate(u, v));
                    assert!((a.position - b.position).norm() < 1e-14 && (a.duv - b.duv).norm() < 1e-12);
                    assert!((surface.point(u, v) - b.position).norm() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn a_rational_quarter_circle_is_round() {
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let points = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let net = points.iter().flat_map(|&(x, y)| [Point3::new(x, y, 0.0), Point3::new(x, y, 1.0)]).collect();
        let weights = vec![1.0, 1.0, h, h, 1.0, 1.0];
        let knots = [KnotVector::uniform(2, 3), KnotVector::uniform(1, 2)];
        let cylinder = NurbsSurface::new(knots, net, Some(weights)).unwrap();
        for i in 0..=10 {
            let p = cylinder.point(i as f64 / 10.0, 0.3);
            assert!((p.x.hypot(p.y) - 1.0).abs() < 1e-14);
        }
    }
}
