//! Depth samples on their lines of sight.

use super::super::knots::KnotVector;
use super::super::nurbs::NurbsSurface;
use super::super::targets::LayerSample;
use super::super::tensor::GridPlanes;
use super::Refiner;
use super::model::Row;

/// Each depth sample.
const SAMPLE_WEIGHT: f64 = 5.0;
/// A silhouette row must not be steeper than this in depth.
const SAMPLE_STEEPEST: f64 = 0.2;

impl Refiner<'_> {
    /// The surface meets each depth sample on its line of sight.
    pub(super) fn sample_term(&self, surface: &NurbsSurface, planes: &[GridPlanes; 3], rows: &mut Vec<Row>) -> f64 {
        let mut energy = 0.0;
        for sample in &self.targets.samples {
            let Some([u, v]) = self.sight(surface, planes, sample) else { continue };
            let bases = [self.knots[0].basis(u), self.knots[1].basis(v)];
            let point = surface.evaluate_with(&bases[0], &bases[1]);
            let normal = point.du.cross(&point.dv);
            let Some(normal) = normal.try_normalize(1e-12) else { continue };
            // Depth on the line of sight changes by n . dS / n_z.
            let direction = normal / normal.z.abs().max(SAMPLE_STEEPEST);
            let residual = direction.z * (point.position.z + sample.depth);
            energy += SAMPLE_WEIGHT * residual * residual;
            rows.push(Row { bases, direction, weight: SAMPLE_WEIGHT, residual });
        }
        energy
    }

    /// Parameters where the line of sight of `sample` meets its layer: the first crossing, or the second.
    pub(super) fn sight(
        &self,
        surface: &NurbsSurface,
        planes: &[GridPlanes; 3],
        sample: &LayerSample,
    ) -> Option<[f64; 2]> {
        let [x, y, z] = planes;
        let [us, vs] = self.grid.axes.each_ref().map(|axis| &axis.parameters);
        let (mu, mv) = (us.len(), vs.len());
        let [px, py] = sample.position;
        let mut hits: Vec<(f64, [f64; 2])> = vec![];
        for a in 0..mu - 1 {
            for b in 0..mv - 1 {
                let k = a * mv + b;
                let corners = [k, k + mv, k + mv + 1, k + 1];
                let outside = |values: &[f64], at: f64| {
                    corners.iter().all(|&q| values[q] < at) || corners.iter().all(|&q| values[q] > at)
                };
                if outside(&x.value, px) || outside(&y.value, py) {
                    continue;
                }
                for triangle in [[0, 1, 2], [0, 2, 3]] {
                    let [p, q, r] = triangle.map(|i| [x.value[corners[i]] - px, y.value[corners[i]] - py]);
                    let w = [q[0] * r[1] - q[1] * r[0], r[0] * p[1] - r[1] * p[0], p[0] * q[1] - p[1] * q[0]];
                    let total = w[0] + w[1] + w[2];
                    if total == 0.0 || w.iter().any(|value| value / total < -1e-9) {
                        continue;
                    }
                    let mix = |f: &dyn Fn(usize) -> f64| (0..3).map(|i| w[i] / total * f(triangle[i])).sum::<f64>();
                    let depth = -mix(&|i| z.value[corners[i]]);
                    let u = mix(&|i| us[a + usize::from(i == 1 || i == 2)]);
                    let v = mix(&|i| vs[b + usize::from(i >= 2)]);
                    hits.push((depth, [u, v]));
                }
            }
        }
        hits.sort_by(|a, b| a.0.total_cmp(&b.0));
        hits.dedup_by(|b, a| (a.1[0] - b.1[0]).abs() + (a.1[1] - b.1[1]).abs() < 1e-6);
        let [mut u, mut v] = hits.get(usize::from(sample.occluded))?.1;
        // Newton on S(u, v) = (px, py) from the triangle's point.
        for _ in 0..4 {
            let point = surface.evaluate(u, v);
            let (rx, ry) = (px - point.position.x, py - point.position.y);
            let determinant = point.du.x * point.dv.y - point.dv.x * point.du.y;
            if determinant.abs() < 1e-9 * point.du.norm() * point.dv.norm() {
                break;
            }
            u += (rx * point.dv.y - ry * point.dv.x) / determinant;
            v += (ry * point.du.x - rx * point.du.y) / determinant;
            let [[a, b], [c, d]] = self.knots.each_ref().map(KnotVector::domain);
            (u, v) = (u.clamp(a, b), v.clamp(c, d));
        }
        Some([u, v])
    }
}
