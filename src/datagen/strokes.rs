//! From exact lines to strokes on the canvas, clean or as a hand draws them.

use super::layers::HALF;
use super::project::Structure;
use crate::sketch::{Stroke, StrokeKind};
use nalgebra::Point3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Pixels of the canvas per canonical unit.
pub(super) const PIXELS_PER_UNIT: f64 = 128.0 / HALF;

/// Canonical x, y to the 256 x 256 canvas, y down.
pub(super) fn to_canvas(p: [f64; 2]) -> [f64; 2] {
    [128.0 + p[0] * PIXELS_PER_UNIT, 128.0 - p[1] * PIXELS_PER_UNIT]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Points at least `spacing` pixels apart; both ends are kept.
fn thinned(points: impl IntoIterator<Item = [f64; 2]>, spacing: f64) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = vec![];
    let mut last = None;
    for p in points {
        if kept.last().is_none_or(|&q| distance(p, q) >= spacing) {
            kept.push(p);
        }
        last = Some(p);
    }
    if let (Some(end), Some(&kept_last)) = (last, kept.last())
        && kept_last != end
    {
        if kept.len() > 1 && distance(kept_last, end) < 0.5 * spacing {
            kept.pop();
        }
        kept.push(end);
    }
    kept
}

fn project(points: &[Point3<f64>]) -> impl Iterator<Item = [f64; 2]> {
    points.iter().map(|p| to_canvas([p.x, p.y]))
}

/// Angle by which a polyline that goes through `before` and then `after` turns at their common point, radians.
fn turn(before: &[[f64; 2]], after: &[[f64; 2]]) -> f64 {
    // Directions over some pixels, so that short segments do not matter.
    let reach = |p: &&[f64; 2], origin: [f64; 2]| distance(**p, origin) > 4.0;
    let Some(&corner) = after.first() else { return 0.0 };
    let (Some(a), Some(b)) = (before.iter().rev().find(|p| reach(p, corner)), after.iter().find(|p| reach(p, corner)))
    else {
        return 0.0;
    };
    let [a, b] = [a, b].map(|p| [p[0] - corner[0], p[1] - corner[1]]);
    let (cross, dot) = (-a[0] * b[1] + a[1] * b[0], -a[0] * b[0] - a[1] * b[1]);
    cross.atan2(dot).abs()
}

/// The structural strokes of a projected surface, cut at corners and where the kind changes.
pub(super) fn structural(structure: &Structure) -> Vec<Stroke> {
    const SPACING: f64 = 1.2;
    /// Turn of the border at which a drawer lifts the pen, radians.
    const CORNER: f64 = 0.5;
    let mut strokes: Vec<Stroke> = vec![];
    for piece in &structure.border {
        let kind = if piece.hidden { StrokeKind::OccludedBoundary } else { StrokeKind::VisibleBoundary };
        let points = thinned(project(&piece.points), SPACING);
        match strokes.last_mut() {
            Some(last) if last.kind == kind && turn(&last.points, &points) < CORNER => {
                last.points.extend_from_slice(&points[1..]);
            }
            _ => strokes.push(Stroke { kind, points }),
        }
    }
    if strokes.len() > 1 {
        let (first, last) = (&strokes[0], &strokes[strokes.len() - 1]);
        if first.kind == last.kind && turn(&last.points, &first.points) < CORNER {
            let mut joined = strokes.pop().expect("more than one stroke");
            joined.points.extend_from_slice(&strokes[0].points[1..]);
            strokes[0] = joined;
        }
    }
    for contour in &structure.contours {
        strokes.push(Stroke { kind: StrokeKind::Contour, points: thinned(project(contour), SPACING) });
    }
    strokes
}

/// A feature line through surface points.
pub(super) fn feature(points: &[Point3<f64>]) -> Stroke {
    Stroke { kind: StrokeKind::Feature, points: thinned(project(points), 1.2) }
}

/// Length of a polyline.
pub(super) fn length(points: &[[f64; 2]]) -> f64 {
    points.windows(2).map(|w| distance(w[0], w[1])).sum()
}

/// Draws the strokes again with a human hand: slow wobble, ends that miss or overshoot, pieces split and reversed.
///
/// `size` scales everything; 1 is a careful drawer: about one pixel of wobble, ends off by up to 4 pixels.
pub(super) fn draw_by_hand(strokes: &mut Vec<Stroke>, size: f64, rng: &mut ChaCha8Rng) {
    let mut drawn = vec![];
    for stroke in strokes.drain(..) {
        let total = length(&stroke.points);
        if stroke.kind.is_structural() && total > 60.0 && rng.random_bool(0.25) {
            // Two strokes with a small gap or overlap.
            let cut = rng.random_range(0.3..0.7) * total;
            let overlap = rng.random_range(-2.0..4.0) * size;
            let pieces =
                [part(&stroke.points, 0.0, cut + 0.5 * overlap), part(&stroke.points, cut - 0.5 * overlap, total)];
            drawn.extend(pieces.map(|points| Stroke { kind: stroke.kind, points }));
        } else {
            drawn.push(stroke);
        }
    }
    for stroke in &mut drawn {
        wobble(&mut stroke.points, size, rng);
        let total = length(&stroke.points);
        let closed = distance(stroke.points[0], stroke.points[stroke.points.len() - 1]) < 1.0;
        if stroke.kind.is_structural() && total > 25.0 && !closed {
            for end in 0..2 {
                // Gap below zero, overshoot above.
                let miss = (rng.random_range(-2.5..3.5) * size).clamp(-0.1 * total, 4.0);
                move_end(&mut stroke.points, end == 1, miss);
            }
        }
        if rng.random_bool(0.3) {
            stroke.points.reverse();
        }
    }
    *strokes = drawn;
}

/// The part of a polyline between two arc lengths.
fn part(points: &[[f64; 2]], from: f64, to: f64) -> Vec<[f64; 2]> {
    let mut kept = vec![];
    let mut s = 0.0;
    for w in points.windows(2) {
        let step = distance(w[0], w[1]);
        let at = |x: f64| [0, 1].map(|k| w[0][k] + (w[1][k] - w[0][k]) * ((x - s) / step).clamp(0.0, 1.0));
        if s + step > from && s < to {
            if kept.is_empty() {
                kept.push(at(from.max(s)));
            }
            kept.push(at(to.min(s + step)));
        }
        s += step;
    }
    kept
}

/// Slow displacement along the stroke.
fn wobble(points: &mut [[f64; 2]], size: f64, rng: &mut ChaCha8Rng) {
    let waves: Vec<([f64; 2], f64, f64)> = (0..3)
        .map(|_| {
            let angle = rng.random_range(0.0..TAU);
            let amplitude = size * rng.random_range(0.1..0.8);
            let wavelength = rng.random_range(45.0..160.0);
            ([amplitude * f64::cos(angle), amplitude * f64::sin(angle)], TAU / wavelength, rng.random_range(0.0..TAU))
        })
        .collect();
    let mut s = 0.0;
    let mut previous = points[0];
    for p in points.iter_mut() {
        s += distance(*p, previous);
        previous = *p;
        for (a, w, phase) in &waves {
            let sine = (w * s + phase).sin();
            p[0] += a[0] * sine;
            p[1] += a[1] * sine;
        }
    }
}

/// Lengthens (positive) or shortens (negative) a polyline at one end, in pixels.
fn move_end(points: &mut Vec<[f64; 2]>, last: bool, amount: f64) {
    if !last {
        points.reverse();
        move_end(points, true, amount);
        points.reverse();
        return;
    }
    if amount < 0.0 {
        let total = length(points);
        *points = part(points, 0.0, total + amount);
        return;
    }
    let end = points[points.len() - 1];
    if let Some(&back) = points.iter().rev().find(|p| distance(**p, end) > 3.0) {
        let d = distance(end, back);
        points.push([0, 1].map(|k| end[k] + (end[k] - back[k]) / d * amount));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_move_by_what_was_asked() {
        for amount in [-7.0, 3.0] {
            for last in [false, true] {
                let mut line: Vec<[f64; 2]> = (0..50).map(|i| [i as f64, 0.5 * i as f64]).collect();
                let before = length(&line);
                move_end(&mut line, last, amount);
                assert!((length(&line) - before - amount).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn thinning_keeps_the_ends() {
        let line: Vec<[f64; 2]> = (0..101).map(|i| [0.1 * i as f64, 0.0]).collect();
        let thin = thinned(line.iter().copied(), 1.2);
        assert_eq!((thin[0], thin[thin.len() - 1]), (line[0], line[100]));
        assert!(thin.len() < 11);
    }
}
