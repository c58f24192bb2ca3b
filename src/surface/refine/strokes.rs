//! Border and silhouette of the surface against the strokes.

use super::super::nurbs::NurbsSurface;
use super::super::silhouette::{self, SilhouettePoint};
use super::super::tensor::GridPlanes;
use super::grid_sample::GridSample;
use super::model::Row;
use super::{BORDER_WEIGHT, Refiner};
use nalgebra::Vector3;

/// Pull along the stroke, as a share of the border's weight.
const SLIDING_WEIGHT: f64 = 0.005;
/// Pull back from beyond the end of a stroke, as a share of the border's weight.
const BEYOND_WEIGHT: f64 = 0.03;
/// Each corner.
const CORNER_WEIGHT: f64 = 5.0;
/// Silhouette to contour strokes, mean over the silhouette: takes away what the strokes do not show. More makes matters
/// worse: a strong pull on the few rows of control points at the fold bunches up their parameter lines.
const CONTOUR_WEIGHT: f64 = 0.5;
/// Contour strokes to silhouette, mean over the strokes: every part of a stroke is there. On 40 held-out folds 8 leaves
/// 0.36 px, 2 leaves 0.57.
const COVERING_WEIGHT: f64 = 8.0;
/// Silhouette points farther than this from the contour strokes count less and less (Cauchy), canonical units: they may be
/// ripples of an unfinished surface.
const ROBUST_CONTOUR: f64 = 0.2;
/// Share of a side by which a foot on its stroke may run ahead of, or lag behind, its arc length.
const FOOT_WINDOW: f64 = 0.12;

impl Refiner<'_> {
    /// Grid indices of side `side`, in the direction of the loop.
    pub(super) fn side_samples(&self, side: usize) -> Vec<usize> {
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        match side {
            0 => (0..mu).map(|a| a * mv).collect(),
            1 => (0..mv).map(|b| (mu - 1) * mv + b).collect(),
            2 => (0..mu).rev().map(|a| a * mv + mv - 1).collect(),
            _ => (0..mv).rev().collect(),
        }
    }

    /// For the samples of a side their shares of the side's projected arc length.
    pub(super) fn arc_shares(planes: &[GridPlanes; 3], samples: &[usize]) -> Vec<f64> {
        let [x, y, _] = planes;
        let mut shares = vec![0.0];
        let mut sum = 0.0;
        for pair in samples.windows(2) {
            sum += (x.value[pair[1]] - x.value[pair[0]]).hypot(y.value[pair[1]] - y.value[pair[0]]);
            shares.push(sum);
        }
        shares.iter().map(|s| s / sum.max(f64::MIN_POSITIVE)).collect()
    }

    /// For border samples the layer on which the sketch draws them, and the side that they show, 0 where it is not known.
    pub(super) fn border_layers(&self, planes: &[GridPlanes; 3]) -> (Vec<Option<bool>>, Vec<f64>) {
        let mut layers = vec![None; planes[0].value.len()];
        let mut facing = vec![0.0; layers.len()];
        for side in 0..4 {
            let samples = self.side_samples(side);
            let shares = Self::arc_shares(planes, &samples);
            let flags = &self.stroke_occluded[side];
            let stroke = &self.strokes[side];
            for (&k, share) in samples.iter().zip(shares) {
                let at = stroke.lengths.partition_point(|&l| l < share * stroke.length()).min(flags.len() - 1);
                layers[k] = Some(flags[at]);
                facing[k] = self.stroke_facing[side][at.min(self.stroke_facing[side].len() - 1)];
            }
        }
        (layers, facing)
    }

    /// Border samples project onto the line of their stroke, corners onto the corners.
    pub(super) fn border_term(&self, planes: &[GridPlanes; 3], grid: &mut [GridSample]) {
        for side in 0..4 {
            let samples = self.side_samples(side);
            let shares = Self::arc_shares(planes, &samples);
            let stroke = &self.strokes[side];
            let length = stroke.length();
            for (i, (&k, share)) in samples.iter().zip(shares).enumerate() {
                let p = [planes[0].value[k], planes[1].value[k]];
                if i == 0 {
                    let corner = stroke.points[0];
                    for c in 0..2 {
                        grid[k].add(Vector3::ith(c, 1.0), CORNER_WEIGHT, p[c] - corner[c]);
                    }
                    continue;
                }
                if i + 1 == samples.len() {
                    continue;
                }
                let window = [(share - FOOT_WINDOW) * length, (share + FOOT_WINDOW) * length];
                let Some(foot) = stroke.nearest(p, window) else { continue };
                let weight = BORDER_WEIGHT / (samples.len() - 1) as f64;
                let offset = [p[0] - foot.position[0], p[1] - foot.position[1]];
                // Along the stroke the border slides almost freely, past its end too: pulling hard there would bunch up the
                // samples beside a corner where the outline is smooth.
                let across = offset[0] * foot.normal[0] + offset[1] * foot.normal[1];
                let along = [offset[0] - across * foot.normal[0], offset[1] - across * foot.normal[1]];
                let direction = Vector3::new(foot.normal[0], foot.normal[1], 0.0);
                grid[k].add(direction, weight, across);
                // A weak pull to the share of the stroke that the sample had at the start keeps neighbours apart.
                let place = stroke.at(self.shares[side][i] * length);
                let sliding = SLIDING_WEIGHT * weight;
                for c in 0..2 {
                    grid[k].add(Vector3::ith(c, 1.0), sliding, p[c] - place[c]);
                }
                let beyond = along[0].hypot(along[1]);
                if beyond > 1e-9 {
                    let direction = Vector3::new(along[0] / beyond, along[1] / beyond, 0.0);
                    grid[k].add(direction, BEYOND_WEIGHT * weight, beyond);
                }
            }
        }
    }

    /// The silhouette's crossings with the grid lines project onto the contour strokes.
    pub(super) fn contour_term(&self, surface: &NurbsSurface, planes: &[GridPlanes; 3], rows: &mut Vec<Row>) -> f64 {
        if self.contours.is_empty() {
            return 0.0;
        }
        let points = silhouette::crossings(surface, &self.grid, &silhouette::facing(planes));
        let weight = self.insistence * CONTOUR_WEIGHT / points.len().max(1) as f64;
        let mut energy = 0.0;
        for point in &points {
            let foot = self
                .contours
                .iter()
                .filter_map(|c| Some((c.line.nearest(point.position, [0.0, f64::INFINITY])?, c.side)))
                .min_by(|a, b| a.0.distance.total_cmp(&b.0.distance));
            let Some((foot, side)) = foot else { continue };
            // A ripple has two silhouettes; only one of them bends to the side where the sketch shows the fold.
            let [nx, ny] = point.inward;
            if side * (nx * foot.normal[0] + ny * foot.normal[1]) < 0.0 {
                continue;
            }
            let offset = [point.position[0] - foot.position[0], point.position[1] - foot.position[1]];
            // Beyond an end of the stroke only the distance from its line counts.
            let across = offset[0] * foot.normal[0] + offset[1] * foot.normal[1];
            let ratio = (across / ROBUST_CONTOUR).powi(2);
            energy += weight * ROBUST_CONTOUR * ROBUST_CONTOUR * ratio.ln_1p();
            let weight = weight / (1.0 + ratio);
            let direction = Vector3::new(foot.normal[0], foot.normal[1], 0.0);
            rows.push(Row { bases: point.bases, direction, weight, residual: across });
        }
        energy + self.covering_term(&points, rows)
    }

    /// Every place of the contour strokes has silhouette near it: a fold must not be ironed out, nor end early.
    fn covering_term(&self, points: &[SilhouettePoint], rows: &mut Vec<Row>) -> f64 {
        let pieces = silhouette::pieces(points, &self.grid);
        let places = || self.contours.iter().flat_map(|contour| &contour.places);
        let weight = self.insistence * COVERING_WEIGHT / places().count().max(1) as f64;
        let mut energy = 0.0;
        for &p in places() {
            let (nearest, distance) = Self::nearest_piece(p, points, &pieces)
                .map_or((None, 2.0 * self.targets.maps.visible.half_extent), |(nearest, d)| (Some(nearest), d));
            let ratio = (distance / ROBUST_CONTOUR).powi(2);
            energy += weight * ROBUST_CONTOUR * ROBUST_CONTOUR * ratio.ln_1p();
            let Some(point) = nearest.map(|k| &points[k]) else { continue };
            // The silhouette moves along its projected normal only.
            let direction = Vector3::new(point.inward[0], point.inward[1], 0.0);
            let residual = direction.x * (point.position[0] - p[0]) + direction.y * (point.position[1] - p[1]);
            rows.push(Row { bases: point.bases, direction, weight: weight / (1.0 + ratio), residual });
        }
        energy
    }

    /// The crossing nearest to `p` among the ends of the nearest piece of the silhouette, and the distance of the piece.
    pub(super) fn nearest_piece(
        p: [f64; 2],
        points: &[SilhouettePoint],
        pieces: &[[usize; 2]],
    ) -> Option<(usize, f64)> {
        let distances = pieces.iter().map(|&[a, b]| {
            let (t, distance) = silhouette::nearest_on_segment(p, points[a].position, points[b].position);
            (if t < 0.5 { a } else { b }, distance)
        });
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    }
}
