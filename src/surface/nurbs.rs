//! NURBS surfaces: control net, evaluation, derivatives.

use super::knots::KnotVector;
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
        self.evaluate(u, v).position
    }

    /// S and its derivatives up to second order at (u, v); parameters are clamped to the domain.
    pub fn evaluate(&self, u: f64, v: f64) -> SurfacePoint {
        let (bu, bv) = (self.knots[0].basis(u), self.knots[1].basis(v));
        let count_v = self.knots[1].count();
        let orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];
        // Homogeneous sums A = sum w_i N_i p_i and W = sum w_i N_i for each order of derivative.
        let mut a = [Vector3::zeros(); 6];
        let mut w = [0.0; 6];
        for i in 0..=self.knots[0].degree() {
            for j in 0..=self.knots[1].degree() {
                let index = (bu.first + i) * count_v + bv.first + j;
                let weight = self.weights.as_ref().map_or(1.0, |w| w[index]);
                let point = self.control_points[index].coords;
                for (k, &(du, dv)) in orders.iter().enumerate() {
                    let value = weight * bu.values[du][i] * bv.values[dv][j];
                    a[k] += point * value;
                    w[k] += value;
                }
            }
        }
        if self.weights.is_none() {
            return SurfacePoint { position: Point3::from(a[0]), du: a[1], dv: a[2], duu: a[3], duv: a[4], dvv: a[5] };
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
}

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
