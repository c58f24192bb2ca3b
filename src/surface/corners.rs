//! The four corners of a surface's border.

use crate::error::Error;
use crate::sketch::{Layer, Orientation, PatchSketch};

/// The border of a surface as a closed polyline in the canonical frame: x right, y up, seen along the view.
///
/// Runs counter-clockwise seen from the surface's front; the last point connects to the first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BorderLoop {
    /// Points (x, y), canonical units, dense: neighbours lie within about one pixel of the 256 canvas.
    pub points: Vec<[f64; 2]>,
    /// For each point whether it is drawn as occluded boundary, so that it lies on the occluded layer.
    pub occluded: Vec<bool>,
    /// For each point whether the sheet that ends there shows its front, so that it lies on the left of the loop, else on the right.
    pub front: Vec<bool>,
}

/// Windows for the turning angle, as shares of the loop's length: about 20 pixels for a loop that fills the canvas, so
/// that the noise of a hand does not count, and half of it, which tells a corner from a bend.
const WINDOWS: [f64; 2] = [0.025, 0.0125];
/// Turning angles below this are bends, not corners.
const SHARP_RAD: f64 = 0.45;
/// Places that can become corners where nothing is sharp.
const EVEN_CANDIDATES: usize = 32;
/// Sharp places that are considered, sharpest first.
const SHARP_CANDIDATES: usize = 16;
/// Sides shorter than this share of the loop are penalized.
const SHORT_SIDE: f64 = 0.14;

impl BorderLoop {
    /// Checks and takes a loop.
    ///
    /// # Errors
    /// [`Error::Degenerate`] with fewer than 8 points, another number of flags, or no length; [`Error::NotFinite`].
    pub fn new(points: Vec<[f64; 2]>, occluded: Vec<bool>, front: Vec<bool>) -> Result<Self, Error> {
        if let Some(index) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(Error::NotFinite { what: "border point", index });
        }
        let result = Self { points, occluded, front };
        let (count, flags) = (result.points.len(), [result.occluded.len(), result.front.len()]);
        if count < 8 || flags != [count; 2] {
            return Err(Error::Degenerate { reason: format!("a border of {count} points with {flags:?} flags") });
        }
        if result.arc_lengths()[count] <= 0.0 {
            return Err(Error::Degenerate { reason: "the border has no length".into() });
        }
        Ok(result)
    }

    /// The border of a drawn patch.
    ///
    /// # Errors
    /// As [`BorderLoop::new`].
    pub fn drawn(patch: &PatchSketch) -> Result<Self, Error> {
        let points = patch.border.iter().map(|b| b.position).collect();
        let occluded = patch.border.iter().map(|b| b.layer == Layer::Occluded).collect();
        let front = patch.border.iter().map(|b| b.side == Orientation::Front).collect();
        Self::new(points, occluded, front)
    }

    /// Arc length (x, y) from point 0 to each point; one more entry, the whole length, at the end.
    pub fn arc_lengths(&self) -> Vec<f64> {
        let n = self.points.len();
        let mut lengths = Vec::with_capacity(n + 1);
        let mut sum = 0.0;
        lengths.push(0.0);
        for i in 0..n {
            let (a, b) = (self.points[i], self.points[(i + 1) % n]);
            sum += (b[0] - a[0]).hypot(b[1] - a[1]);
            lengths.push(sum);
        }
        lengths
    }

    /// The point at arc length `s`, taken modulo the whole length.
    fn at(&self, lengths: &[f64], s: f64) -> [f64; 2] {
        let n = self.points.len();
        let s = s.rem_euclid(lengths[n]);
        let i = lengths[1..n].partition_point(|&l| l <= s);
        let (a, b, width) = (self.points[i], self.points[(i + 1) % n], lengths[i + 1] - lengths[i]);
        let t = if width > 0.0 { (s - lengths[i]) / width } else { 0.0 };
        [0, 1].map(|k| a[k] + (b[k] - a[k]) * t)
    }

    /// Indices of the loop points nearest to four places named by the host, brought into loop order, upper left first.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if two places share a loop point.
    pub fn corners_near(&self, places: [[f64; 2]; 4]) -> Result<[usize; 4], Error> {
        let mut corners = places.map(|place| {
            let squared = |p: &[f64; 2]| (p[0] - place[0]).powi(2) + (p[1] - place[1]).powi(2);
            (0..self.points.len())
                .min_by(|&a, &b| squared(&self.points[a]).total_cmp(&squared(&self.points[b])))
                .unwrap_or(0)
        });
        corners.sort_unstable();
        if corners.windows(2).any(|w| w[0] == w[1]) {
            return Err(Error::Degenerate { reason: format!("two of the four corners {places:?} are the same") });
        }
        Ok(self.upper_left_first(corners))
    }

    /// Chooses the four corners of the patch on the loop.
    ///
    /// A B-spline patch has four sides, many outlines have three sharp corners, five, or none. The choice minimizes, over
    /// all quadruples of candidates (the sharpest places, and evenly spread ones),
    /// sum of (1 - sharpness) + 0.8 (|l0 - l2| + |l1 - l3|) + 0.15 sum of |l - 1/4| + penalty for sides below 14 % of the loop,
    /// l being the sides' shares of the loop's length: sharp turns win, balance decides between equals.
    ///
    /// - returns indices into `points` in loop order; the first is the most upper left one (largest y - x).
    ///
    /// # Errors
    /// [`Error::Degenerate`] if the loop has fewer than four different places.
    pub fn choose_corners(&self) -> Result<[usize; 4], Error> {
        let n = self.points.len();
        let lengths = self.arc_lengths();
        let total = lengths[n];
        let turning = |i: usize, window: f64| {
            let w = window * total;
            let (before, here, after) =
                (self.at(&lengths, lengths[i] - w), self.points[i], self.at(&lengths, lengths[i] + w));
            let a = [here[0] - before[0], here[1] - before[1]];
            let b = [after[0] - here[0], after[1] - here[1]];
            (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]).abs()
        };
        // A bend turns in proportion to the window, a corner keeps its angle.
        let angles: Vec<f64> = (0..n).map(|i| turning(i, WINDOWS[0]).min(1.5 * turning(i, WINDOWS[1]))).collect();
        let sharpness = |i: usize| {
            let angle = angles[i];
            let corner = ((angle - SHARP_RAD) / (std::f64::consts::FRAC_PI_2 - SHARP_RAD)).clamp(0.0, 1.2);
            corner + 0.1 * (angle / SHARP_RAD).min(1.0)
        };
        let apart = |i: usize, j: usize| {
            let d = (lengths[i] - lengths[j]).abs();
            d.min(total - d)
        };

        let mut order: Vec<usize> = (0..n).filter(|&i| angles[i] > SHARP_RAD).collect();
        order.sort_by(|&a, &b| angles[b].total_cmp(&angles[a]).then(a.cmp(&b)));
        let mut candidates: Vec<usize> = vec![];
        for i in order {
            if candidates.len() < SHARP_CANDIDATES && candidates.iter().all(|&j| apart(i, j) > WINDOWS[0] * total) {
                candidates.push(i);
            }
        }
        for k in 0..EVEN_CANDIDATES {
            let s = total * k as f64 / EVEN_CANDIDATES as f64;
            let i = lengths[..n].partition_point(|&l| l < s).min(n - 1);
            if candidates.iter().all(|&j| apart(i, j) > 0.5 * total / EVEN_CANDIDATES as f64) {
                candidates.push(i);
            }
        }
        candidates.sort_unstable();
        let count = candidates.len();
        if count < 4 {
            return Err(Error::Degenerate { reason: format!("the border has only {count} different places") });
        }

        let places: Vec<(f64, f64)> = candidates.iter().map(|&i| (lengths[i] / total, 1.0 - sharpness(i))).collect();
        let short = |l: f64| ((SHORT_SIDE - l) / SHORT_SIDE).max(0.0) * 2.0;
        let mut best = (f64::INFINITY, [0; 4]);
        for a in 0..count {
            for b in a + 1..count {
                for c in b + 1..count {
                    let (l0, l1) = (places[b].0 - places[a].0, places[c].0 - places[b].0);
                    let partial = places[a].1 + places[b].1 + places[c].1 + short(l0) + short(l1);
                    for d in c + 1..count {
                        let (l2, l3) = (places[d].0 - places[c].0, 1.0 - places[d].0 + places[a].0);
                        let spread: f64 = [l0, l1, l2, l3].iter().map(|l| (l - 0.25).abs()).sum();
                        let balance = 0.8 * ((l0 - l2).abs() + (l1 - l3).abs()) + 0.15 * spread;
                        let cost = partial + places[d].1 + short(l2) + short(l3) + balance;
                        if cost < best.0 {
                            best = (cost, [a, b, c, d]);
                        }
                    }
                }
            }
        }
        Ok(self.upper_left_first(best.1.map(|k| candidates[k])))
    }

    fn upper_left_first(&self, mut corners: [usize; 4]) -> [usize; 4] {
        let key = |i: usize| self.points[i][1] - self.points[i][0];
        let first = (0..4).max_by(|&a, &b| key(corners[a]).total_cmp(&key(corners[b])).then(b.cmp(&a))).unwrap_or(0);
        corners.rotate_left(first);
        corners
    }

    /// The point indices of side `side` of the loop cut at `corners`, both corners included.
    pub fn side(&self, corners: [usize; 4], side: usize) -> Vec<usize> {
        let n = self.points.len();
        let (start, end) = (corners[side % 4], corners[(side + 1) % 4]);
        let steps = (end + n - start) % n;
        (0..=steps).map(|k| (start + k) % n).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn visible(points: Vec<[f64; 2]>) -> BorderLoop {
        let count = points.len();
        BorderLoop::new(points, vec![false; count], vec![true; count]).unwrap()
    }

    fn polygon(vertices: &[[f64; 2]], per_side: usize) -> BorderLoop {
        let n = vertices.len();
        let points: Vec<[f64; 2]> = (0..n * per_side)
            .map(|k| {
                let (a, b, t) =
                    (vertices[k / per_side], vertices[(k / per_side + 1) % n], (k % per_side) as f64 / per_side as f64);
                [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
            })
            .collect();
        visible(points)
    }

    #[test]
    fn a_quadrilaterals_corners_are_found_upper_left_first() {
        let vertices = [[3.0, -2.0], [4.0, 3.0], [-3.0, 2.0], [-4.0, -3.0]];
        let border = polygon(&vertices, 100);
        assert_eq!(border.choose_corners().unwrap(), [200, 300, 0, 100]);
        assert_eq!(border.corners_near(vertices).unwrap(), [200, 300, 0, 100]);
        assert_eq!(border.side([200, 300, 0, 100], 1).len(), 101);
    }

    #[test]
    fn corners_survive_the_noise_of_a_hand() {
        let mut border = polygon(&[[3.0, -2.0], [4.0, 3.0], [-3.0, 2.0], [-4.0, -3.0]], 200);
        for (i, p) in border.points.iter_mut().enumerate() {
            // About a pixel of tremor.
            p[0] += 0.03 * (i as f64 * 0.31).sin() * (i as f64 * 0.017).cos();
            p[1] += 0.03 * (i as f64 * 0.23).cos();
        }
        let corners = border.choose_corners().unwrap();
        for (found, expected) in corners.iter().zip([400usize, 600, 0, 200]) {
            let distance = found.abs_diff(expected).min(800 - found.abs_diff(expected));
            assert!(distance <= 4, "{corners:?}");
        }
    }

    #[test]
    fn a_circle_is_cut_into_equal_sides() {
        let points =
            (0..400).map(|k| (k as f64 * std::f64::consts::TAU / 400.0).sin_cos()).map(|(s, c)| [c, s]).collect();
        let border = visible(points);
        let corners = border.choose_corners().unwrap();
        for side in 0..4 {
            assert!(border.side(corners, side).len().abs_diff(101) <= 3);
        }
    }

    #[test]
    fn a_triangle_keeps_its_three_corners() {
        let border = polygon(&[[-4.0, -3.0], [4.0, -3.0], [0.0, 4.0]], 120);
        let corners = border.choose_corners().unwrap();
        assert!([0, 120, 240].iter().all(|corner| corners.contains(corner)), "{corners:?}");
    }

    #[test]
    fn corners_follow_a_move_and_a_scaling() {
        let vertices = [[3.0, -2.0], [4.5, 1.0], [3.5, 3.0], [-3.0, 2.0], [-4.0, -3.0]];
        let border = polygon(&vertices, 90);
        let moved: Vec<[f64; 2]> = border.points.iter().map(|p| [7.0 * p[0] + 100.0, 7.0 * p[1] - 40.0]).collect();
        let moved = visible(moved);
        assert_eq!(border.choose_corners().unwrap(), moved.choose_corners().unwrap());
    }
}
