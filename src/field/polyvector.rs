//! PolyVectors: a cross as the coefficients of the polynomial that has its directions as roots.

use super::matching::Cross;
use nalgebra::{Complex, Vector2};

/// The coefficients of z^4 - s z^2 + p, whose roots are u, -u, v, -v as complex numbers of some plane.
///
/// s = u^2 + v^2, p = u^2 v^2. Neither depends on the names or signs of the directions, and both are smooth where the cross
/// is. For unit vectors with bisector m and half crossing angle h: s = 2 cos(2 h) exp(2 i m), p = exp(4 i m).
///
/// # Source
/// Diamanti et al. 2014; Sketch2PQ, Sec. 3.2.5, whose sign of s we share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolyVector {
    /// u^2 + v^2
    pub s: Complex<f64>,
    /// u^2 v^2
    pub p: Complex<f64>,
}

impl PolyVector {
    /// The coefficients of two directions of any length.
    pub fn from_directions(u: Vector2<f64>, v: Vector2<f64>) -> Self {
        let (u, v) = (Complex::new(u.x, u.y), Complex::new(v.x, v.y));
        let (uu, vv) = (u * u, v * v);
        Self { s: uu + vv, p: uu * vv }
    }

    /// The coefficients of a cross of unit vectors.
    pub fn from_cross(cross: &Cross) -> Self {
        let twice = Complex::from_polar(1.0, 2.0 * cross.bisector);
        Self { s: twice * (2.0 * (2.0 * cross.half_crossing).cos()), p: twice * twice }
    }

    /// From (Re s, Im s, Re p, Im p), the order of the network's channels.
    pub fn from_array(c: [f64; 4]) -> Self {
        Self { s: Complex::new(c[0], c[1]), p: Complex::new(c[2], c[3]) }
    }

    /// (Re s, Im s, Re p, Im p)
    pub fn to_array(self) -> [f64; 4] {
        [self.s.re, self.s.im, self.p.re, self.p.im]
    }

    /// The coefficients after turning the cross by `angle`, or the plane's axes by -`angle`.
    pub fn rotated(self, angle: f64) -> Self {
        let twice = Complex::from_polar(1.0, 2.0 * angle);
        Self { s: self.s * twice, p: self.p * twice * twice }
    }

    /// The roots u and v, each up to its sign; not unit in general.
    ///
    /// Any coefficients have roots, but two that are averages of several crosses may have parallel ones.
    pub fn directions(self) -> [Vector2<f64>; 2] {
        let root = (self.s * self.s - self.p * 4.0).sqrt();
        // The sum without cancellation first, the other root from the product.
        let sum = if (self.s.conj() * root).re >= 0.0 { self.s + root } else { self.s - root };
        let first = sum * 0.5;
        let second = if first.norm_sqr() > 0.0 { self.p / first } else { first };
        [first, second].map(|square| {
            let z = square.sqrt();
            Vector2::new(z.re, z.im)
        })
    }

    /// The cross of the roots' directions; `None` if a root is 0 or not finite.
    ///
    /// Parallel roots give a half crossing angle of 0 or close to it.
    pub fn cross(self) -> Option<Cross> {
        let [u, v] = self.directions();
        let usable = |d: &Vector2<f64>| d.norm_squared().is_finite() && d.norm_squared() > 1e-24;
        (usable(&u) && usable(&v)).then(|| Cross::from_angles(u.y.atan2(u.x), v.y.atan2(v.x)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_return_the_directions() {
        for i in 0..200 {
            let (a, b) = (0.31 * f64::from(i), 1.7 * f64::from(i) + 0.4);
            let (u, v) = (Vector2::new(a.cos(), a.sin()) * 1.3, Vector2::new(b.cos(), b.sin()) * 0.7);
            let [x, y] = PolyVector::from_directions(u, v).directions();
            let same = |p: &Vector2<f64>, q: &Vector2<f64>| (p - q).norm().min((p + q).norm()) < 1e-6;
            assert!((same(&x, &u) && same(&y, &v)) || (same(&x, &v) && same(&y, &u)));
        }
    }

    #[test]
    fn names_signs_and_rotations_follow() {
        let cross = Cross { bisector: 0.7, half_crossing: 0.4 };
        let poly = PolyVector::from_cross(&cross);
        for k in 0..4 {
            let again = PolyVector::from_cross(&cross.renamed(k));
            assert!((again.s - poly.s).norm() < 1e-12 && (again.p - poly.p).norm() < 1e-12);
        }
        let turned = PolyVector::from_cross(&Cross { bisector: 1.0, half_crossing: 0.4 });
        assert!((turned.s - poly.rotated(0.3).s).norm() < 1e-12 && (turned.p - poly.rotated(0.3).p).norm() < 1e-12);
        let back = poly.cross().unwrap();
        assert!((PolyVector::from_cross(&back).s - poly.s).norm() < 1e-12);
    }

    #[test]
    fn degenerate_coefficients_give_no_cross() {
        assert!(PolyVector::from_array([0.0; 4]).cross().is_none());
        assert!(PolyVector::from_array([f64::NAN, 0.0, 1.0, 0.0]).cross().is_none());
        assert!(PolyVector::from_array([1.0, 0.0, 0.0, 0.0]).cross().is_none());
    }
}
