//! First and second fundamental forms.

use super::nurbs::SurfacePoint;
use nalgebra::{Matrix2, Vector2, Vector3};

/// First and second fundamental forms at a surface point, in the basis (S_u, S_v).
#[derive(Clone, Copy, Debug)]
pub struct FundamentalForms {
    /// Unit normal S_u x S_v / |S_u x S_v|.
    pub normal: Vector3<f64>,
    /// I = [[E, F], [F, G]].
    pub first: Matrix2<f64>,
    /// II = [[L, M], [M, N]], with L = S_uu . n, M = S_uv . n, N = S_vv . n.
    pub second: Matrix2<f64>,
}

impl FundamentalForms {
    /// The forms at `point`; `None` where the parametrization is degenerate (S_u parallel to S_v).
    pub fn new(point: &SurfacePoint) -> Option<Self> {
        let cross = point.du.cross(&point.dv);
        let area = cross.norm();
        if area.is_nan() || area <= 1e-12 * (point.du.norm_squared() + point.dv.norm_squared()) {
            return None;
        }
        let normal = cross / area;
        let (e, f, g) = (point.du.norm_squared(), point.du.dot(&point.dv), point.dv.norm_squared());
        let (l, m, n) = (point.duu.dot(&normal), point.duv.dot(&normal), point.dvv.dot(&normal));
        Some(Self { normal, first: Matrix2::new(e, f, f, g), second: Matrix2::new(l, m, m, n) })
    }

    /// Gaussian curvature K = det II / det I, 1 / length^2.
    pub fn gaussian_curvature(&self) -> f64 {
        self.second.determinant() / self.first.determinant()
    }

    /// Mean curvature H, 1 / length; positive where the surface bends towards its normal.
    pub fn mean_curvature(&self) -> f64 {
        let (i, ii) = (&self.first, &self.second);
        let numerator = i[(0, 0)] * ii[(1, 1)] - 2.0 * i[(0, 1)] * ii[(0, 1)] + i[(1, 1)] * ii[(0, 0)];
        numerator / (2.0 * i.determinant())
    }

    /// Components in the basis (S_u, S_v) of the tangential part of the 3D vector `direction`.
    pub fn components(&self, point: &SurfacePoint, direction: &Vector3<f64>) -> Vector2<f64> {
        let right = Vector2::new(point.du.dot(direction), point.dv.dot(direction));
        let determinant = self.first.determinant();
        Vector2::new(
            self.first[(1, 1)] * right.x - self.first[(0, 1)] * right.y,
            self.first[(0, 0)] * right.y - self.first[(0, 1)] * right.x,
        ) / determinant
    }

    /// The second form in an orthonormal tangent basis: II(e_i, e_j) for the 3D tangent vectors `e1`, `e2`.
    pub fn second_in(&self, point: &SurfacePoint, e1: &Vector3<f64>, e2: &Vector3<f64>) -> Matrix2<f64> {
        let (a, b) = (self.components(point, e1), self.components(point, e2));
        let (aa, ab, bb) = ((self.second * a).dot(&a), (self.second * a).dot(&b), (self.second * b).dot(&b));
        Matrix2::new(aa, ab, ab, bb)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{KnotVector, NurbsSurface};
    use nalgebra::Point3;

    #[test]
    fn sphere_curvature_is_one_over_radius() {
        // Exact rational octant of a sphere of radius 3.
        let r = 3.0;
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let profile = [(r, 0.0, 1.0), (r, r, h), (0.0, r, 1.0)];
        let mut points = vec![];
        let mut weights = vec![];
        for (cx, cy, cw) in [(1.0, 0.0, 1.0), (1.0, 1.0, h), (0.0, 1.0, 1.0)] {
            for (rho, z, w) in profile {
                points.push(Point3::new(cx * rho, cy * rho, z));
                weights.push(cw * w);
            }
        }
        let knots = [KnotVector::uniform(2, 3), KnotVector::uniform(2, 3)];
        let sphere = NurbsSurface::new(knots, points, Some(weights)).unwrap();
        for (u, v) in [(0.2, 0.3), (0.5, 0.6), (0.9, 0.1)] {
            let forms = FundamentalForms::new(&sphere.evaluate(u, v)).unwrap();
            assert!((forms.gaussian_curvature() - 1.0 / (r * r)).abs() < 1e-12);
            assert!((forms.mean_curvature().abs() - 1.0 / r).abs() < 1e-12);
        }
    }
}
