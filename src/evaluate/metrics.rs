//! Every metric that needs the truth, defined once; those of a mesh alone are `crate::pipeline`'s. Lengths are canonical units unless a doc comment says otherwise.

use crate::surface::NurbsSurface;
use nalgebra::{DMatrix, DVector, Point3, Vector2, Vector3};
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Points of a surface with their unit normals.
pub struct SurfaceSamples {
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
}

impl SurfaceSamples {
    /// `side` x `side` points, regular in the parameter domain (the paper takes 100 x 100).
    pub fn new(surface: &NurbsSurface, side: usize) -> Self {
        let mut samples = Self { points: vec![], normals: vec![] };
        for i in 0..side {
            for j in 0..side {
                let fraction = |k: usize| k as f64 / (side - 1) as f64;
                let [u, v] = surface.at_fraction(fraction(i), fraction(j));
                let point = surface.evaluate(u, v);
                samples.points.push(point.position);
                samples.normals.push(point.du.cross(&point.dv).normalize());
            }
        }
        samples
    }

    /// Largest less smallest z.
    pub fn depth_range(&self) -> f64 {
        let [low, high] =
            self.points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p.z), high.max(p.z)]);
        high - low
    }

    /// Each point with the nearest of the other surface's points.
    pub fn nearest_in(&self, other: &Self) -> Vec<(Point3<f64>, Point3<f64>)> {
        let tree = other.tree();
        let nearest = |p: &Point3<f64>| tree.nearest_neighbor([p.x, p.y, p.z]).map(|q| (*p, other.points[q.data]));
        self.points.iter().filter_map(nearest).collect()
    }

    fn tree(&self) -> RTree<GeomWithData<[f64; 3], usize>> {
        let entries = self.points.iter().enumerate().map(|(i, p)| GeomWithData::new([p.x, p.y, p.z], i));
        RTree::bulk_load(entries.collect())
    }
}

/// D_c and D_n: two-sided Chamfer distance and normal angle between two sampled surfaces.
///
/// D_c = (sum |x - nearest y|^2 + sum |y - nearest x|^2) / (|X| + |Y|), squared length; D_n is the mean unsigned angle in
/// degrees between the normals of the same pairs. Paper, Eqs. (12) to (14).
pub fn chamfer(first: &SurfaceSamples, second: &SurfaceSamples) -> (f64, f64) {
    let one_way = |from: &SurfaceSamples, to: &SurfaceSamples| {
        let tree = to.tree();
        let (mut distance, mut angle) = (0.0, 0.0);
        for (p, n) in from.points.iter().zip(&from.normals) {
            if let Some(nearest) = tree.nearest_neighbor([p.x, p.y, p.z]) {
                distance += (to.points[nearest.data] - p).norm_squared();
                angle += n.dot(&to.normals[nearest.data]).abs().min(1.0).acos().to_degrees();
            }
        }
        (distance, angle)
    };
    let (there, back) = (one_way(first, second), one_way(second, first));
    let count = (first.points.len() + second.points.len()).max(1) as f64;
    ((there.0 + back.0) / count, (there.1 + back.1) / count)
}

/// Errors of a depth map on its valid pixels, squared length.
#[derive(Clone, Copy, Debug, Default)]
pub struct DepthErrors {
    /// D_v or D_o: mean squared difference (paper, Eq. (16)).
    pub direct: f64,
    /// With the four parameters that a sketch leaves open removed: the best truth ~ s depth + a x + b y + t.
    pub shear: f64,
    /// Of the best plane, which knows the answer but has no shape.
    pub plane: f64,
}

/// Compares depths at canvas positions; `None` with fewer than 12 pixels.
///
/// - `positions`: canonical x, y of the pixels.
/// - `depth`, `truth`: canonical depth or depth offset, any common reference.
pub fn depth_errors(positions: &[[f64; 2]], depth: &[f64], truth: &[f64]) -> Option<DepthErrors> {
    let n = positions.len();
    if n < 12 {
        return None;
    }
    let target = DVector::from_column_slice(truth);
    let residual = |with_depth: bool| {
        let columns = if with_depth { 4 } else { 3 };
        let basis = DMatrix::from_fn(n, columns, |i, j| match j {
            0 => positions[i][0],
            1 => positions[i][1],
            2 => 1.0,
            _ => depth[i],
        });
        let solution = basis.clone().svd(true, true).solve(&target, 1e-9).ok()?;
        Some((&target - basis * solution).norm_squared() / n as f64)
    };
    let direct = depth.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / n as f64;
    Some(DepthErrors { direct, shear: residual(true)?, plane: residual(false)? })
}

/// Mean angle in degrees between two pairs of lines in the plane, the better of the two assignments.
pub fn pair_angle_deg(first: [[f64; 2]; 2], second: [[f64; 2]; 2]) -> f64 {
    let angle = |a: [f64; 2], b: [f64; 2]| {
        let (a, b) = (Vector2::from(a), Vector2::from(b));
        a.perp(&b).abs().atan2(a.dot(&b).abs()).to_degrees()
    };
    let straight = angle(first[0], second[0]) + angle(first[1], second[1]);
    let crossed = angle(first[0], second[1]) + angle(first[1], second[0]);
    straight.min(crossed) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dome(height: f64, lift: f64) -> NurbsSurface {
        let net = (0..100)
            .map(|k| {
                let (x, y) = ((k / 10) as f64 / 4.5 - 1.0, (k % 10) as f64 / 4.5 - 1.0);
                Point3::new(x, y, lift - height * (x * x + y * y))
            })
            .collect();
        NurbsSurface::uniform(3, [10, 10], net).unwrap()
    }

    #[test]
    fn chamfer_of_parallel_planes_is_their_squared_distance() {
        let (a, b) = (SurfaceSamples::new(&dome(0.0, 0.0), 20), SurfaceSamples::new(&dome(0.0, 0.3), 20));
        let (distance, angle) = chamfer(&a, &b);
        assert!((distance - 0.09).abs() < 1e-12 && angle < 1e-5);
        assert_eq!(chamfer(&a, &a), (0.0, 0.0));
    }

    #[test]
    fn shear_error_ignores_the_four_free_parameters() {
        let positions: Vec<[f64; 2]> = (0..400).map(|k| [(k % 20) as f64 / 10.0, (k / 20) as f64 / 10.0]).collect();
        let truth: Vec<f64> = positions.iter().map(|[x, y]| (x * 2.0).sin() + y * y).collect();
        let depth: Vec<f64> =
            positions.iter().zip(&truth).map(|([x, y], d)| 0.7 * d - 0.3 * x + 0.2 * y + 5.0).collect();
        let errors = depth_errors(&positions, &depth, &truth).unwrap();
        assert!(errors.shear < 1e-16 && errors.direct > 1.0 && errors.plane > 1e-3);
    }

    #[test]
    fn pairs_of_lines_compare_without_order_or_sign() {
        let rotated = |t: f64| [t.cos(), t.sin()];
        let pair = [rotated(0.2), rotated(1.3)];
        assert!(pair_angle_deg(pair, [rotated(1.3 + std::f64::consts::PI), rotated(0.2)]) < 1e-6);
        assert!((pair_angle_deg(pair, [rotated(0.3), rotated(1.3)]) - 0.05f64.to_degrees()).abs() < 1e-9);
    }
}
