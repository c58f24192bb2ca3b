//! Conjugacy of two directions, and the conjugate crosses nearest to a given one.

use super::matching::Cross;
use super::topology::{TriangleFrames, wrap};
use crate::surface::{FundamentalForms, SurfaceMesh, SurfacePoint};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// The second fundamental form of a triangle in its orthonormal frame: II = [[h + a, b], [b, h - a]], 1 / length.
///
/// For the cross with bisector m and half crossing angle c, II(u, v) = h cos 2c + a cos 2m + b sin 2m. Everything in this file
/// follows from that: the conjugate crosses form one curve in the (m, c) plane, given by m where the surface is elliptic
/// (any bisector has its crossing angle) and by c where it is hyperbolic (any crossing angle has its bisector).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SecondForm {
    /// Mean curvature.
    pub h: f64,
    /// Half the difference of II(x, x) and II(y, y).
    pub a: f64,
    /// II(x, y)
    pub b: f64,
}

impl SecondForm {
    /// II in the plane of the orthonormal `x` and `y`, of a symmetric tensor in space.
    pub fn of_tensor(tensor: &Matrix3<f64>, x: &Vector3<f64>, y: &Vector3<f64>) -> Self {
        let [xx, xy, yy] = [(x, x), (x, y), (y, y)].map(|(p, q)| p.dot(&(tensor * q)));
        Self { h: 0.5 * (xx + yy), a: 0.5 * (xx - yy), b: xy }
    }

    /// The symmetric tensor in space that is II in the plane of `x` and `y` and zero along their normal.
    pub fn tensor(&self, x: &Vector3<f64>, y: &Vector3<f64>) -> Matrix3<f64> {
        let mixed = x * y.transpose() + y * x.transpose();
        x * x.transpose() * (self.h + self.a) + mixed * self.b + y * y.transpose() * (self.h - self.a)
    }

    /// Frobenius norm |II| = sqrt(k1^2 + k2^2).
    pub fn norm(&self) -> f64 {
        (2.0 * (self.h * self.h + self.a * self.a + self.b * self.b)).sqrt()
    }

    /// Half the difference of the principal curvatures, >= 0.
    pub fn deviator(&self) -> f64 {
        self.a.hypot(self.b)
    }

    /// Angle of the direction of the larger principal curvature, in (-pi/2, pi/2]; arbitrary at umbilics.
    pub fn principal_angle(&self) -> f64 {
        0.5 * self.b.atan2(self.a)
    }

    /// II(u, v) for the unit vectors of `cross`.
    pub fn value(&self, cross: &Cross) -> f64 {
        let (sin, cos) = (2.0 * cross.bisector).sin_cos();
        self.h * (2.0 * cross.half_crossing).cos() + self.a * cos + self.b * sin
    }

    /// Derivatives of [`SecondForm::value`] by bisector and half crossing angle.
    pub fn slopes(&self, cross: &Cross) -> [f64; 2] {
        let (sin, cos) = (2.0 * cross.bisector).sin_cos();
        [2.0 * (self.b * cos - self.a * sin), -2.0 * self.h * (2.0 * cross.half_crossing).sin()]
    }

    /// II(u, v) / |II| for the unit vectors of `cross`, in [-1/sqrt 2, 1/sqrt 2]; 0 where II = 0.
    pub fn residual(&self, cross: &Cross) -> f64 {
        let norm = self.norm();
        if norm == 0.0 { 0.0 } else { self.value(cross) / norm }
    }

    /// Angle of the direction conjugate to the one at `angle`; `None` where every direction is (a ruling of a developable, II = 0).
    ///
    /// At asymptotic directions it is the direction itself.
    pub fn conjugate(&self, angle: f64) -> Option<f64> {
        let (sin, cos) = angle.sin_cos();
        let (x, y) = ((self.h + self.a) * cos + self.b * sin, self.b * cos + (self.h - self.a) * sin);
        (x.hypot(y) > 1e-6 * self.norm()).then(|| x.atan2(-y))
    }

    /// Whether bisectors parametrize the conjugate crosses (elliptic points), rather than crossing angles (hyperbolic ones).
    pub fn by_bisector(&self) -> bool {
        self.h.abs() >= self.deviator()
    }

    /// The half crossing angle of the conjugate cross with this bisector, and its derivative; for elliptic points.
    ///
    /// Crossing angles below `floor` are raised to it, with derivative 0.
    pub fn half_crossing_at(&self, bisector: f64, floor: f64) -> (f64, f64) {
        let ratio = if self.h == 0.0 { 0.0 } else { self.deviator() / self.h };
        let (sin, cos) = (2.0 * (bisector - self.principal_angle())).sin_cos();
        let limit = floor.cos();
        let q = -ratio * cos;
        if q.abs() >= limit {
            return (0.5 * limit.copysign(q).acos(), 0.0);
        }
        (0.5 * q.acos(), -ratio * sin / (1.0 - q * q).sqrt())
    }

    /// The bisector, nearest to `near`, of the conjugate crosses with this half crossing angle, and its derivative; for hyperbolic points.
    pub fn bisector_at(&self, half_crossing: f64, near: f64) -> (f64, f64) {
        let ratio = self.h / self.deviator();
        let (sin, cos) = (2.0 * half_crossing).sin_cos();
        let q = (-ratio * cos).clamp(-1.0, 1.0);
        let principal = self.principal_angle();
        let offset = wrap(2.0 * (near - principal), TAU);
        let side = if offset < 0.0 { -1.0 } else { 1.0 };
        let x = side * q.acos();
        let slope = -side * ratio * sin / (1.0 - q * q).sqrt().max(1e-9);
        (near + 0.5 * (x - offset), slope)
    }

    /// The interval of bisectors around `near` whose conjugate crosses respect the `floor`; elliptic points. Infinite if all do.
    pub fn bisector_range(&self, near: f64, floor: f64) -> [f64; 2] {
        let deviator = self.deviator();
        let limit = floor.cos() * self.h.abs();
        if deviator <= limit {
            return [f64::NEG_INFINITY, f64::INFINITY];
        }
        // |cos 2 (m - m0)| <= limit / deviator: a quarter turn less a margin on both sides of a principal direction.
        let margin = 0.5 * (limit / deviator).acos();
        let start = self.principal_angle();
        let quarter = ((near - start) / FRAC_PI_2).floor();
        let low = start + quarter * FRAC_PI_2;
        [low + margin, low + FRAC_PI_2 - margin]
    }

    /// The conjugate cross nearest to `cross` (squared change of bisector plus squared change of half crossing) whose crossing angle is
    /// at least `floor`, radians, at most pi/2.
    ///
    /// Exists everywhere, since the principal directions are conjugate and orthogonal. Where II = 0 only the floor acts.
    pub fn project(&self, cross: &Cross, floor: f64) -> Cross {
        let clamp = |c: f64| c.clamp(0.5 * floor, FRAC_PI_2 - 0.5 * floor);
        if self.norm() == 0.0 {
            return Cross { bisector: cross.bisector, half_crossing: clamp(cross.half_crossing) };
        }
        // t: the parameter of the curve; value(t): the other coordinate and its slope, |slope| <= 1.
        let elliptic = self.by_bisector();
        let (target, other, low, high) = if elliptic {
            let [low, high] = self.bisector_range(cross.bisector, floor);
            let span = 0.25 * PI;
            let (low, high) = (low.max(cross.bisector - span), high.min(cross.bisector + span));
            (cross.bisector, cross.half_crossing, low.min(high), high)
        } else {
            (cross.half_crossing, cross.bisector, 0.5 * floor, FRAC_PI_2 - 0.5 * floor)
        };
        let value = |t: f64| {
            if elliptic { self.half_crossing_at(t, floor) } else { self.bisector_at(t, cross.bisector) }
        };
        let cost = |t: f64| {
            let (y, _) = value(t);
            (t - target).powi(2) + (y - other).powi(2)
        };
        const SAMPLES: usize = 8;
        let step = (high - low) / SAMPLES as f64;
        let (mut best, mut least) = (target.clamp(low, high), f64::INFINITY);
        for t in (0..=SAMPLES).map(|i| low + step * i as f64).chain([best]) {
            let c = cost(t);
            if c < least {
                (best, least) = (t, c);
            }
        }
        // Zero of the derivative between the neighbours of the best sample; the cost is convex at this scale.
        let (mut from, mut to) = ((best - step).max(low), (best + step).min(high));
        let slope = |t: f64| {
            let (y, dy) = value(t);
            (t - target) + (y - other) * dy
        };
        let mut t = best;
        for _ in 0..30 {
            let d = slope(t);
            if d > 0.0 {
                to = t
            } else {
                from = t
            }
            if d.abs() < 1e-10 || to - from < 1e-10 {
                break;
            }
            // Gauss-Newton with the bracket as a safeguard.
            let (_, dy) = value(t);
            let next = t - d / (1.0 + dy * dy);
            t = if next > from && next < to { next } else { 0.5 * (from + to) };
        }
        let t = if cost(t) <= least { t } else { best };
        let (y, _) = value(t);
        if elliptic { Cross { bisector: t, half_crossing: y } } else { Cross { bisector: y, half_crossing: t } }
    }
}

/// Second form of each triangle: the mean of its vertices' analytic forms as tensors in space, restricted to the triangle's plane.
///
/// Vertices without a normal (collapsed sides) are left out; a triangle of only such vertices gets II = 0.
pub fn second_forms(mesh: &SurfaceMesh, frames: &TriangleFrames) -> Vec<SecondForm> {
    let tensors: Vec<Option<Matrix3<f64>>> = mesh.points.iter().map(tensor).collect();
    (0..mesh.triangles.len())
        .map(|t| {
            let mut sum = Matrix3::zeros();
            let mut count = 0.0;
            for tensor in mesh.triangles[t].iter().filter_map(|&v| tensors[v as usize].as_ref()) {
                sum += tensor;
                count += 1.0;
            }
            if count == 0.0 {
                return SecondForm::default();
            }
            SecondForm::of_tensor(&(sum / count), &frames.x[t], &frames.y[t])
        })
        .collect()
}

/// Second form of each triangle: that of the surface at its middle, restricted to the triangle's plane; where the mesh has no middles, or there
/// is no normal, that of `means`.
///
/// Directions in the plane of a triangle are conjugate in this form if and only if their projections to the tangent plane at the
/// middle are conjugate on the surface, however coarse the mesh is.
pub fn middle_forms(mesh: &SurfaceMesh, frames: &TriangleFrames, means: &[SecondForm]) -> Vec<SecondForm> {
    let own = |(t, mean): (usize, &SecondForm)| {
        let tensor = mesh.middles.get(t).and_then(tensor);
        tensor.map_or(*mean, |tensor| SecondForm::of_tensor(&tensor, &frames.x[t], &frames.y[t]))
    };
    means.iter().enumerate().map(own).collect()
}

/// II at a point as a tensor in space, zero along the normal.
fn tensor(point: &SurfacePoint) -> Option<Matrix3<f64>> {
    let forms = FundamentalForms::new(point)?;
    let x = point.du.normalize();
    let y = forms.normal.cross(&x);
    let m = forms.second_in(point, &x, &y);
    let form = SecondForm { h: 0.5 * (m[(0, 0)] + m[(1, 1)]), a: 0.5 * (m[(0, 0)] - m[(1, 1)]), b: m[(0, 1)] };
    let tensor = form.tensor(&x, &y);
    tensor.iter().all(|c| c.is_finite()).then_some(tensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forms() -> impl Iterator<Item = SecondForm> {
        (0..60).map(|i| {
            let t = f64::from(i);
            SecondForm { h: (1.3 * t).sin() * 2.0, a: (2.1 * t + 1.0).cos(), b: (0.7 * t).sin() }
        })
    }

    #[test]
    fn the_conjugate_direction_is_conjugate() {
        for form in forms() {
            for i in 0..20 {
                let u = 0.3 * f64::from(i);
                let v = form.conjugate(u).unwrap();
                assert!(form.residual(&Cross::from_angles(u, v)).abs() < 1e-12);
            }
        }
        let cylinder = SecondForm { h: 0.5, a: 0.5, b: 0.0 };
        assert!(cylinder.conjugate(FRAC_PI_2).is_none());
        assert!(wrap(cylinder.conjugate(0.4).unwrap() - FRAC_PI_2, PI).abs() < 1e-12);
    }

    #[test]
    fn projection_is_conjugate_above_the_floor_and_nearest() {
        let floor = 20f64.to_radians();
        let special = [
            SecondForm { h: 0.5, a: 0.5, b: 0.0 },
            SecondForm { h: -0.5, a: 0.3, b: 0.4 },
            SecondForm { h: 0.0, a: 0.0, b: 1.0 },
            SecondForm { h: 1.0, a: 0.0, b: 0.0 },
            SecondForm { h: 1.0, a: 0.97, b: 0.0 },
            SecondForm { h: 0.97, a: 0.0, b: -1.0 },
        ];
        for form in forms().chain(special) {
            for i in 0..40 {
                let cross = Cross { bisector: 0.37 * f64::from(i), half_crossing: 0.035 * f64::from(i) + 0.05 };
                let found = form.project(&cross, floor);
                assert!(form.residual(&found).abs() < 1e-9, "{form:?} {cross:?} {found:?}");
                assert!(found.crossing() >= floor - 1e-9);
                let distance = |c: &Cross| (c.bisector - cross.bisector).hypot(c.half_crossing - cross.half_crossing);
                let moved = distance(&found);
                // No sampled conjugate cross is nearer.
                for j in 0..400 {
                    let t = f64::from(j) / 400.0;
                    let other = if form.by_bisector() {
                        let bisector = cross.bisector + (t - 0.5) * PI;
                        Cross { bisector, half_crossing: form.half_crossing_at(bisector, 0.0).0 }
                    } else {
                        let half_crossing = 0.5 * floor + t * (FRAC_PI_2 - floor);
                        Cross { bisector: form.bisector_at(half_crossing, cross.bisector).0, half_crossing }
                    };
                    if other.crossing() >= floor {
                        assert!(distance(&other) >= moved - 1e-6, "{form:?} {cross:?} {found:?} {other:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn projection_follows_renaming() {
        for form in forms() {
            let cross = Cross { bisector: 0.9, half_crossing: 0.3 };
            let found = form.project(&cross, 0.3);
            for k in 1..4 {
                let other = form.project(&cross.renamed(k), 0.3).renamed(-k);
                assert!((other.bisector - found.bisector).abs() < 1e-7);
                assert!((other.half_crossing - found.half_crossing).abs() < 1e-7);
            }
        }
    }
}
