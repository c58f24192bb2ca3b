//! How well a refined surface obeys the sketch.

use super::super::nurbs::NurbsSurface;
use super::super::silhouette::{self, Polyline};
use super::Refiner;
use super::model::Model;

/// How well the refined surface obeys the sketch. Pixels are those of the 256 canvas.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RefineReport {
    /// Gauss-Newton steps taken.
    pub iterations: usize,
    /// Energy of the start and of the result; the second is never larger.
    pub energy: [f64; 2],
    /// Distance from the border strokes to the surface's projected border: mean and largest, pixels.
    pub border_px: [f64; 2],
    /// Distance from the contour strokes to the surface's silhouette, or, where a border stroke runs within a pixel of the contour, to
    /// the nearer of silhouette and border: mean and largest, pixels; zero without contours.
    pub contour_px: [f64; 2],
    /// Distance from the surface's silhouette to the nearest contour or border stroke: mean and largest, pixels; zero
    /// without silhouette. Large where the surface folds, or bulges over a stroke, without the sketch drawing it.
    pub silhouette_px: [f64; 2],
    /// Largest depth difference at a depth sample, canonical units.
    pub sample_residual: f64,
    /// Depth samples whose line of sight misses their layer.
    pub samples_missed: usize,
    /// Places where the surface turns from front to back, or back again, and the sketch draws no contour: counted along 40
    /// parameter lines in each direction, six pixels and more from the contour strokes, where both sides are clearly seen.
    pub folds: usize,
    /// Share of the surface whose side facing the viewer is not drawn there, by the regions of the sketch.
    pub misfacing: f64,
    /// Root mean square tangent-plane distance to the depth maps, canonical units.
    pub depth_rms: f64,
}

impl Refiner<'_> {
    pub(super) fn report(
        &self,
        surface: &NurbsSurface,
        net: &[f64],
        model: &Model,
        first_energy: f64,
        iterations: usize,
    ) -> RefineReport {
        let pixel = 2.0 * self.targets.maps.visible.half_extent / 256.0;
        let planes = self.planes(net);
        let whole = [0.0, f64::INFINITY];
        let summarize = |distances: &[f64]| {
            let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
            [mean / pixel, distances.iter().copied().fold(0.0, f64::max) / pixel]
        };

        let curves = [0, 1, 2, 3].map(|side: usize| {
            Polyline::new((0..=200).map(|i| {
                let t = i as f64 / 200.0;
                let [s, t] = [[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]][side];
                let [u, v] = surface.at_fraction(s, t);
                let p = surface.point(u, v);
                [p.x, p.y]
            }))
        });
        let mut distances = vec![];
        for (stroke, curve) in self.strokes.iter().zip(&curves) {
            let feet = stroke.points.iter().filter_map(|&p| curve.nearest(p, whole));
            distances.extend(feet.map(|foot| foot.distance));
        }
        let border_px = summarize(&distances);

        let facing = silhouette::facing(&planes);
        let points = silhouette::crossings(surface, &self.grid, &facing);
        let pieces = silhouette::pieces(&points, &self.grid);
        let mut distances = vec![];
        // No silhouette at all: as far as the canvas is wide.
        let widest = 2.0 * self.targets.maps.visible.half_extent;
        for &p in self.contours.iter().flat_map(|contour| &contour.line.points) {
            let silhouette = Self::nearest_piece(p, &points, &pieces).map_or(widest, |(_, distance)| distance);
            let border = if self.along_border(p) {
                let feet = curves.iter().filter_map(|curve| curve.nearest(p, whole));
                feet.map(|foot| foot.distance).fold(widest, f64::min)
            } else {
                widest
            };
            distances.push(silhouette.min(border));
        }
        let contour_px = summarize(&distances);
        let lines = || self.contours.iter().map(|contour| &contour.line).chain(&self.strokes);
        let to_strokes = |point: &silhouette::SilhouettePoint| {
            let feet = lines().filter_map(|line| line.nearest(point.position, whole));
            feet.map(|foot| foot.distance).fold(f64::INFINITY, f64::min)
        };
        let silhouette_px = summarize(&points.iter().map(to_strokes).collect::<Vec<f64>>());

        let (mut sample_residual, mut samples_missed) = (0f64, 0);
        for sample in &self.targets.samples {
            match self.sight(surface, &planes, sample) {
                Some([u, v]) => sample_residual = sample_residual.max((surface.point(u, v).z + sample.depth).abs()),
                None => samples_missed += 1,
            }
        }

        // One and a half map pixels: masks are decided by half a pixel, silhouettes lie on their rim.
        let mut misfacing = 0.0;
        let mv = self.grid.axes[1].len();
        for (k, facing) in facing.iter().enumerate() {
            let p = [planes[0].value[k], planes[1].value[k]];
            let drawn = (0..4)
                .filter(|&side: &usize| side.is_multiple_of(2) == (*facing > 0.0))
                .filter_map(|side| self.map_sides[side].outside(p))
                .any(|(_, pixels)| pixels <= 1.5);
            if !drawn {
                misfacing += self.quadrature[0][k / mv] * self.quadrature[1][k % mv];
            }
        }
        RefineReport {
            iterations,
            energy: [first_energy, model.energy],
            border_px,
            contour_px,
            silhouette_px,
            sample_residual,
            samples_missed,
            folds: model.folds,
            misfacing,
            depth_rms: model.depth_squared.sqrt(),
        }
    }
}
