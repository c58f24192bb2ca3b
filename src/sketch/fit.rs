//! Hand-drawn polylines to smooth curves: cubic B-splines by penalized least squares, split at sharp corners.
//!
//! Everything here is in pixels of the 256 x 256 canvas.

use super::polyline::{Point, arc_lengths, cross, distance, dot, lerp, resample, sub};

/// Points closer than this to the last kept one add nothing, px.
const SPACING_PX: f64 = 0.25;
/// Length of the knot spans, px: short enough for a drawn bend, long enough to average a pixel of noise.
const KNOT_SPACING_PX: f64 = 8.0;
/// Weight of the squared third differences of the control points; halves a wave of 24 px, keeps those above 40 px.
const SMOOTHING: f64 = 0.2;
/// Weight of the ends of a span between corners, where the curve has to stay.
const END_WEIGHT: f64 = 20.0;
/// Turn within two windows that counts as a corner, radians.
const CORNER_RAD: f64 = 50.0 * std::f64::consts::PI / 180.0;
/// Points on each side over which the direction is taken when corners are sought, at 1 px spacing.
const CORNER_WINDOW: usize = 7;
/// Spacing of the resulting points, px.
pub(crate) const SAMPLE_PX: f64 = 0.9;

/// The points without those closer than [`SPACING_PX`] to the one kept before; the last one is kept.
pub(crate) fn thin(points: impl IntoIterator<Item = Point>) -> Vec<Point> {
    let mut result: Vec<Point> = vec![];
    let mut last = None;
    for p in points {
        if result.last().is_none_or(|&q| distance(p, q) >= SPACING_PX) {
            result.push(p);
        }
        last = Some(p);
    }
    if let Some(p) = last
        && result.len() > 1
        && result[result.len() - 1] != p
    {
        let end = result.len() - 1;
        result[end] = p;
    }
    result
}

/// The smooth curve through a drawn polyline, sampled at most [`SAMPLE_PX`] apart.
///
/// Sharp corners (more than 50 degrees) stay corners, and the ends stay where they are.
pub(crate) fn smooth(points: &[Point]) -> Vec<Point> {
    let dense = resample(points, 1.0);
    let mut stops = vec![0];
    stops.extend(corners(&dense));
    stops.push(dense.len() - 1);
    let mut result = vec![dense[0]];
    for w in stops.windows(2) {
        result.extend_from_slice(&fit_span(&dense[w[0]..=w[1]])[1..]);
    }
    result
}

/// Indices of the sharp corners of a polyline with 1 px spacing.
fn corners(points: &[Point]) -> Vec<usize> {
    let n = points.len();
    let window = CORNER_WINDOW;
    if n < 2 * window + 1 {
        return vec![];
    }
    let turn = |i: usize| {
        let before = sub(points[i], points[i - window]);
        let after = sub(points[i + window], points[i]);
        cross(before, after).atan2(dot(before, after)).abs()
    };
    let turns: Vec<f64> = (window..n - window).map(turn).collect();
    let mut found = vec![];
    for (k, &t) in turns.iter().enumerate() {
        let (low, high) = (k.saturating_sub(window), (k + window + 1).min(turns.len()));
        let before = turns[low..k].iter().all(|&x| x < t);
        let after = turns[k + 1..high].iter().all(|&x| x <= t);
        if t > CORNER_RAD && before && after {
            found.push(k + window);
        }
    }
    found
}

/// Values of the four uniform cubic B-splines at `t` in [0, 1] of a knot span.
fn basis(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [
        s * s * s / 6.0,
        (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
        (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
        t * t * t / 6.0,
    ]
}

/// Least-squares cubic B-spline through points with 1 px spacing, resampled; the ends are kept exactly.
fn fit_span(points: &[Point]) -> Vec<Point> {
    let n = points.len();
    if n < 4 {
        return resample(points, SAMPLE_PX);
    }
    let arc = arc_lengths(points);
    let total = arc[n - 1];
    let spans = ((total / KNOT_SPACING_PX).round() as usize).max(1);
    let unknowns = spans + 3;
    // Lower band of the normal matrix: band[i][k] couples unknowns i and i - k.
    let mut band = vec![[0.0; 4]; unknowns];
    let mut right = vec![[0.0; 2]; unknowns];
    let locate = |s: f64| {
        let x = s / total * spans as f64;
        let span = (x as usize).min(spans - 1);
        (span, basis(x - span as f64))
    };
    for (i, p) in points.iter().enumerate() {
        let weight = if i == 0 || i == n - 1 { END_WEIGHT } else { 1.0 };
        let (span, b) = locate(arc[i]);
        for r in 0..4 {
            for c in 0..=r {
                band[span + r][r - c] += weight * b[r] * b[c];
            }
            for k in 0..2 {
                right[span + r][k] += weight * b[r] * p[k];
            }
        }
    }
    const THIRD: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
    for i in 0..unknowns - 3 {
        for r in 0..4 {
            for c in 0..=r {
                band[i + r][r - c] += SMOOTHING * THIRD[r] * THIRD[c];
            }
        }
    }
    // Spans without enough points are held by the smoothing; this only guards the factorization against rounding.
    for row in &mut band {
        row[0] += 1e-9;
    }
    solve_banded(&mut band, &mut right);
    let count = ((total / (0.9 * SAMPLE_PX)).ceil() as usize).max(1);
    let mut result: Vec<Point> = (0..=count)
        .map(|k| {
            let (span, b) = locate(total * k as f64 / count as f64);
            [0, 1].map(|d| (0..4).map(|r| b[r] * right[span + r][d]).sum())
        })
        .collect();
    pin_end(&mut result, points[0]);
    result.reverse();
    pin_end(&mut result, points[n - 1]);
    result.reverse();
    resample(&result, SAMPLE_PX)
}

/// Moves the first point to `target` and its neighbourhood with it.
fn pin_end(points: &mut [Point], target: Point) {
    let shift = sub(target, points[0]);
    let reach = points.len().min(6) - 1;
    for (i, p) in points.iter_mut().take(reach).enumerate() {
        let w = 1.0 - i as f64 / reach as f64;
        *p = [p[0] + w * shift[0], p[1] + w * shift[1]];
    }
    points[0] = target;
}

/// Cholesky solve of a positive definite matrix with three lower off-diagonals; the solution replaces `right`.
fn solve_banded(band: &mut [[f64; 4]], right: &mut [Point]) {
    let n = band.len();
    for i in 0..n {
        for k in (1..4.min(i + 1)).rev() {
            let j = i - k;
            let mut value = band[i][k];
            for m in 1..4 - k {
                if j >= m {
                    value -= band[i][k + m] * band[j][m];
                }
            }
            band[i][k] = value / band[j][0];
        }
        let square: f64 = (1..4.min(i + 1)).map(|k| band[i][k] * band[i][k]).sum();
        band[i][0] = (band[i][0] - square).max(1e-12).sqrt();
    }
    for i in 0..n {
        right[i] = [0, 1].map(|d| {
            let sum: f64 = (1..4.min(i + 1)).map(|k| band[i][k] * right[i - k][d]).sum();
            (right[i][d] - sum) / band[i][0]
        });
    }
    for i in (0..n).rev() {
        right[i] = [0, 1].map(|d| {
            let sum: f64 = (1..4.min(n - i)).map(|k| band[i + k][k] * right[i + k][d]).sum();
            (right[i][d] - sum) / band[i][0]
        });
    }
}

/// Moves the end of a curve to `target`, spreading the displacement smoothly over `reach_px` (at most the whole curve).
///
/// `at_start` says which end. The other end stays. Spacing is restored afterwards.
pub(crate) fn move_end(points: &mut Vec<Point>, at_start: bool, target: Point, reach_px: f64) {
    if !at_start {
        points.reverse();
    }
    let shift = sub(target, points[0]);
    let arc = arc_lengths(points);
    let reach = reach_px.max(2.5 * shift[0].hypot(shift[1])).min(arc[arc.len() - 1]);
    if reach > 0.0 {
        for (p, s) in points.iter_mut().zip(&arc) {
            let t = s / reach;
            if t < 1.0 {
                let w = (1.0 - t) * (1.0 - t) * (1.0 + 2.0 * t);
                *p = [p[0] + w * shift[0], p[1] + w * shift[1]];
            }
        }
    }
    points[0] = target;
    *points = resample(points, SAMPLE_PX);
    if !at_start {
        points.reverse();
    }
}

/// Smooths a joint: refits the curve over `reach_px` on both sides of the point at index `joint`, unless it is a corner.
pub(crate) fn smooth_joint(points: &[Point], joint: usize, reach_px: f64) -> Vec<Point> {
    let arc = arc_lengths(points);
    let low = arc.partition_point(|&s| s < arc[joint] - reach_px);
    let high = arc.partition_point(|&s| s <= arc[joint] + reach_px) - 1;
    if high - low < 8 || low >= joint || high <= joint {
        return points.to_vec();
    }
    let before = sub(points[joint], points[joint.saturating_sub(8).max(low)]);
    let after = sub(points[(joint + 8).min(high)], points[joint]);
    if cross(before, after).atan2(dot(before, after)).abs() > CORNER_RAD {
        return points.to_vec();
    }
    let dense = resample(&points[low..=high], 1.0);
    let fitted = fit_span(&dense);
    // The refit fades in from the untouched curve, so that no new kink appears where it starts.
    let count = high - low;
    let fitted = resample(&fitted, crate::sketch::polyline::length(&fitted) / count as f64 * (1.0 + 1e-9));
    let mut result = points.to_vec();
    if fitted.len() == count + 1 {
        for i in 0..=count {
            let t = (2.0 * i as f64 / count as f64 - 1.0).abs();
            let fade = (2.0 - 2.0 * t).clamp(0.0, 1.0);
            result[low + i] = lerp(points[low + i], fitted[i], fade);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noisy_circle_is_smoothed_without_shrinking() {
        let circle = |i: usize| {
            let a = i as f64 / 300.0 * 5.0;
            let noise = 1.0 * ((i * 7919) as f64 * 0.37).sin();
            [(80.0 + noise) * a.cos(), (80.0 + noise) * a.sin()]
        };
        let points: Vec<Point> = (0..=300).map(circle).collect();
        let curve = smooth(&points);
        let radii: Vec<f64> = curve.iter().map(|p| p[0].hypot(p[1])).collect();
        assert!(radii[10..radii.len() - 10].iter().all(|r| (r - 80.0).abs() < 0.8), "{radii:?}");
        assert!(curve.windows(2).all(|w| distance(w[0], w[1]) <= 1.0));
        assert_eq!(curve[0], points[0]);
    }

    #[test]
    fn a_drawn_corner_stays_a_corner() {
        let curve = smooth(&[[0.0, 0.0], [60.0, 0.0], [60.0, 60.0]]);
        let closest = curve.iter().map(|p| distance(*p, [60.0, 0.0])).fold(f64::INFINITY, f64::min);
        assert!(closest < 0.2, "{closest}");
        assert!(curve.iter().all(|p| p[1].abs() < 0.2 || (p[0] - 60.0).abs() < 0.2));
    }
}
