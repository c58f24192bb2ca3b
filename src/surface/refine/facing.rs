//! Which side of the surface the sketch draws, and where the surface shows another one.

use super::super::silhouette::Polyline;
use super::super::tensor::GridPlanes;
use super::Refiner;
use nalgebra::Vector3;

/// A contour this near to the border, in map pixels, one pixel of the 256 canvas: what lies between is too thin to be seen, so that
/// the border is the outline there as well as a silhouette would be. Pulling silhouettes there tore them from where they belong.
const ALONG_BORDER: f64 = 0.25;
/// Samples whose (S_u x S_v).z / (|S_u| |S_v|) is nearer to 0 show neither side: they are seen edge-on, or a corner of the patch
/// lies where the outline is smooth, so that S_u and S_v are nearly parallel and the sign is noise.
const DECIDED: f64 = 0.05;
/// A turn from front to back this near to a contour stroke, in map pixels, is the crease that the stroke draws.
const CREASE_REACH: f64 = 1.5;
/// A contour nearer than this, in map pixels, ends at the border.
const SLIVER_END: f64 = 0.1;
/// Of two layers that show different sides the one tells the side that is nearer by this factor.
const NEARER: f64 = 0.3;
/// Marks map pixels where the sketch draws both sides, each on its layer.
const BOTH: f64 = 2.0;

impl Refiner<'_> {
    /// The side that the sketch draws at each map pixel, and around it.
    pub(super) fn draw_facing(&self) -> Vec<f64> {
        let map = &self.targets.maps.visible;
        (0..map.size * map.size)
            .map(|pixel| {
                let p = map.center(pixel);
                if self.beside_contour(p) {
                    return 0.0;
                }
                let distance = |sides: [usize; 2]| {
                    let pixels = sides.iter().filter_map(|&side| Some(self.map_sides[side].outside(p)?.1));
                    pixels.fold(f64::INFINITY, f64::min)
                };
                let (front, back) = (distance([0, 2]), distance([1, 3]));
                let unclear = (front - back).abs() < CREASE_REACH || front.min(back).is_infinite();
                if front.max(back) <= 0.5 {
                    BOTH
                } else if unclear {
                    0.0
                } else {
                    (back - front).signum()
                }
            })
            .collect()
    }

    /// The side that the border shows at each point of a side: 1 for the front, -1 for the back, 0 beside the end of a contour, where the
    /// surface turns.
    pub(super) fn facing_along(&self, stroke: &Polyline, front: &[bool]) -> Vec<f64> {
        let reach = SLIVER_END * self.targets.maps.visible.pixel();
        let at = |(&p, &front): (&[f64; 2], &bool)| {
            if self.contours.iter().any(|contour| contour.line.passes(p, reach)) {
                0.0
            } else if front {
                1.0
            } else {
                -1.0
            }
        };
        stroke.points.iter().zip(front).map(at).collect()
    }

    /// Whether a border stroke is so near that it is the outline as well as a contour here.
    pub(super) fn along_border(&self, p: [f64; 2]) -> bool {
        let reach = ALONG_BORDER * self.targets.maps.visible.pixel();
        self.strokes.iter().any(|stroke| stroke.passes(p, reach))
    }

    /// Whether a contour stroke is so near that the surface may turn here.
    pub(super) fn beside_contour(&self, p: [f64; 2]) -> bool {
        let reach = CREASE_REACH * self.targets.maps.visible.pixel();
        self.contours.iter().any(|contour| contour.line.passes(p, reach))
    }

    /// 1 or -1 where the sketch draws the front or the back alone, or, where it draws both, one of them is much nearer; else 0.
    pub(super) fn facing_at(&self, p: Vector3<f64>) -> f64 {
        let map = &self.targets.maps.visible;
        let [column, row] = map.to_pixels([p.x, p.y]).map(|x| x.round().clamp(0.0, (map.size - 1) as f64) as usize);
        let drawn = self.drawn_facing[row * map.size + column];
        if drawn < BOTH {
            return drawn;
        }
        if self.facing == 1.0 {
            return 0.0;
        }
        let off = |sides: [usize; 2]| {
            let samples = sides.iter().filter_map(|&side| self.map_sides[side].sample([p.x, p.y]));
            samples.map(|sample| (p.z + sample.depth).abs()).fold(f64::INFINITY, f64::min)
        };
        let (front, back) = (off([0, 2]), off([1, 3]));
        if front < NEARER * back {
            1.0
        } else if back < NEARER * front {
            -1.0
        } else {
            0.0
        }
    }

    /// The side of a contour stroke on which the fold lies: where both a front and a back are drawn.
    pub(super) fn inner_side(&self, line: &Polyline) -> f64 {
        let reach = 2.0 * self.targets.maps.visible.pixel();
        let mut votes = 0.0;
        for pair in line.points.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            let normal = [(a[1] - b[1]) / length, (b[0] - a[0]) / length];
            for sign in [1.0, -1.0] {
                let p = [0, 1].map(|c| middle[c] + sign * reach * normal[c]);
                let inside = |side: usize| self.map_sides[side].outside(p).is_some_and(|(_, pixels)| pixels <= 0.5);
                if (inside(0) || inside(2)) && (inside(1) || inside(3)) {
                    votes += sign * length;
                }
            }
        }
        if votes < 0.0 { -1.0 } else { 1.0 }
    }

    /// Turns from front to back along the grid lines, without those beside a contour stroke.
    ///
    /// - `facings`: (S_u x S_v).z / (|S_u| |S_v|) of each sample.
    pub(super) fn count_folds(&self, facings: &[f64], planes: &[GridPlanes; 3]) -> usize {
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        let beside = |k: usize| self.beside_contour([planes[0].value[k], planes[1].value[k]]);
        // Along the samples first, first + stride, ...
        let turns = |first: usize, stride: usize, samples: usize| {
            let at = |i: usize| first + i * stride;
            let (mut last, mut count) = (None, 0);
            for i in (0..samples).filter(|&i| facings[at(i)].abs() >= DECIDED) {
                if let Some(j) = last.replace(i) {
                    let turned = facings[at(j)] * facings[at(i)] < 0.0;
                    count += usize::from(turned && !(j..=i).any(|between| beside(at(between))));
                }
            }
            count
        };
        let rows: usize = (0..mu).map(|a| turns(a * mv, 1, mv)).sum();
        let columns: usize = (0..mv).map(|b| turns(b, mv, mu)).sum();
        rows + columns
    }
}
