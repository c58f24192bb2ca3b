//! The parametrization that inference can know: from the drawn border alone, and from the shape.
//!
//! A control net says more than its surface: where the corners lie on the border and how parameters run. At inference the
//! corners are chosen on the drawn loop and the border runs by chord length in space. A network that learned nets with other
//! corners or speeds would have to guess them; so every ground truth net is brought into that form: corners as chosen on the
//! loop, border by chord length, interior by the surface's own harmonic map to the square.

use super::project::border_uv;
use super::surfaces::{greville, interpolate_samples};
use super::{NET, Reason, Rejection};
use crate::numeric::SymbolicCholesky;
use crate::sketch::PatchSketch;
use crate::surface::{BorderLoop, NurbsSurface};
use nalgebra::{Point3, Vector2};
use sprs::TriMat;
use std::sync::OnceLock;

/// Cells of the grid on which the harmonic map is computed.
const CELLS: usize = 32;
/// Samples of the border on each side.
const BORDER_SAMPLES: usize = 96;
/// Corners of the surface's own border this close to a chosen corner are meant, canonical units (8 pixels).
const SNAP: f64 = 0.27;
/// The net may leave the border by this, canonical units (2.6 pixels): a kink between the corners is rounded over a knot span.
const MAX_DEVIATION: f64 = 0.09;

/// The net of `surface` with the corners that the sketch code chooses on the patch's border.
///
/// - `surface`: canonical frame of `patch`.
/// - `hidden`: whether the border at position t in [0, 4) is occluded.
///
/// # Errors
/// [`Reason::Corners`] if the chosen corners do not follow each other on the surface's border, or the net cannot follow the
/// surface.
pub(super) fn natural_net(
    surface: &NurbsSurface,
    patch: &PatchSketch,
    hidden: impl Fn(f64) -> bool,
) -> Result<Vec<Point3<f64>>, Rejection> {
    let fail = Rejection(Reason::Corners);
    let border = BorderLoop::drawn(patch).map_err(|_| fail)?;
    let chosen = border.choose_corners().map_err(|_| fail)?;

    let count = 4 * BORDER_SAMPLES;
    let at = |t: f64| {
        let [u, v] = border_uv(t);
        surface.point(u, v)
    };
    let samples: Vec<(f64, Point3<f64>)> =
        (0..count).map(|k| k as f64 / BORDER_SAMPLES as f64).map(|t| (t, at(t))).collect();
    let mut corners = [0.0; 4];
    for (slot, &index) in corners.iter_mut().zip(&chosen) {
        let [x, y] = border.points[index];
        let cost = |(t, p): &(f64, Point3<f64>)| {
            let other_layer = if hidden(*t) == border.occluded[index] { 0.0 } else { 0.25 };
            (p.x - x).hypot(p.y - y) + other_layer
        };
        let best = samples.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).ok_or(fail)?;
        *slot = best.0;
        let own = best.0.round();
        let apart = (at(own) - best.1).xy().norm();
        if apart < SNAP && is_sharp(surface, own) {
            *slot = own.rem_euclid(4.0);
        }
    }
    // Positions of the four corners, growing by less than one turn.
    let mut positions = [corners[0]; 5];
    for k in 1..4 {
        positions[k] = positions[k - 1] + (corners[k] - corners[k - 1]).rem_euclid(4.0);
    }
    positions[4] = corners[0] + 4.0;
    if positions.windows(2).any(|w| w[1] - w[0] < 0.1) {
        return Err(fail);
    }
    let sides = [0, 1, 2, 3].map(|k| chord_length_side(&at, positions[k], positions[k + 1]));
    let uv = harmonic_parameters(surface, &sides).ok_or(fail)?;
    let points: Vec<Point3<f64>> = uv.iter().map(|p| surface.point(p.x, p.y)).collect();
    let net = interpolate_samples(&points);
    let result = NurbsSurface::uniform(3, [NET, NET], net).map_err(|_| fail)?;
    check_deviation(&result, &at, &sides)?;
    Ok(result.control_points().to_vec())
}

/// Whether the projected border turns by more than 26 degrees at the corner at integer position `t`.
fn is_sharp(surface: &NurbsSurface, t: f64) -> bool {
    let step = 0.02;
    let at = |t: f64| {
        let [u, v] = border_uv(t);
        surface.point(u, v).xy()
    };
    let (before, here, after) = (at(t - step), at(t), at(t + step));
    let (a, b): (Vector2<f64>, Vector2<f64>) = (here - before, after - here);
    a.perp(&b).atan2(a.dot(&b)).abs() > 0.45
}

/// A side by chord length: from a parameter in [0, 1] to a position on the border, and back.
struct Side {
    positions: Vec<f64>,
    lengths: Vec<f64>,
}

fn chord_length_side(at: &impl Fn(f64) -> Point3<f64>, start: f64, end: f64) -> Side {
    let positions: Vec<f64> =
        (0..=BORDER_SAMPLES).map(|k| start + (end - start) * k as f64 / BORDER_SAMPLES as f64).collect();
    let mut lengths = vec![0.0];
    let mut previous = at(start);
    for &t in &positions[1..] {
        let p = at(t);
        lengths.push(lengths[lengths.len() - 1] + (p - previous).norm());
        previous = p;
    }
    let total = lengths[BORDER_SAMPLES];
    lengths.iter_mut().for_each(|l| *l /= total);
    Side { positions, lengths }
}

/// Piecewise linear function through (x, y), x increasing.
fn lookup(x: &[f64], y: &[f64], at: f64) -> f64 {
    let k = x.partition_point(|&v| v <= at).clamp(1, x.len() - 1);
    let width = x[k] - x[k - 1];
    let s = if width > 0.0 { ((at - x[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
    y[k - 1] + (y[k] - y[k - 1]) * s
}

impl Side {
    fn position(&self, parameter: f64) -> f64 {
        lookup(&self.lengths, &self.positions, parameter)
    }

    fn parameter(&self, position: f64) -> f64 {
        lookup(&self.positions, &self.lengths, position)
    }
}

/// New parameters of a border position.
fn border_parameters(sides: &[Side; 4], t: f64) -> [f64; 2] {
    for (k, side) in sides.iter().enumerate() {
        for t in [t, t + 4.0] {
            if t >= side.positions[0] && t <= side.positions[BORDER_SAMPLES] {
                return border_uv(k as f64 + side.parameter(t).min(1.0 - 1e-15));
            }
        }
    }
    [0.0; 2]
}

/// Old parameters at the 30 x 30 Greville points of the new square: the inverse of the harmonic map of the surface on it.
fn harmonic_parameters(surface: &NurbsSurface, sides: &[Side; 4]) -> Option<Vec<Vector2<f64>>> {
    const ROW: usize = CELLS + 1;
    const INNER: usize = CELLS - 1;
    let step = 1.0 / CELLS as f64;
    let positions: Vec<Point3<f64>> =
        (0..ROW * ROW).map(|k| surface.point((k / ROW) as f64 * step, (k % ROW) as f64 * step)).collect();
    let unknown = |k: usize| {
        let (i, j) = (k / ROW, k % ROW);
        ((1..CELLS).contains(&i) && (1..CELLS).contains(&j)).then(|| (i - 1) * INNER + j - 1)
    };
    let mut image = vec![Vector2::zeros(); ROW * ROW];
    for k in 0..4 * CELLS {
        let t = k as f64 * step;
        let (side, s) = (k / CELLS, k % CELLS);
        let (i, j) = match side {
            0 => (s, 0),
            1 => (CELLS, s),
            2 => (CELLS - s, CELLS),
            _ => (0, CELLS - s),
        };
        let [x, y] = border_parameters(sides, t);
        image[i * ROW + j] = Vector2::new(x, y);
    }
    // Cotangent weights, kept positive: then the map onto the convex square cannot fold (Tutte).
    let mut matrix = TriMat::with_capacity((INNER * INNER, INNER * INNER), 16 * INNER * INNER);
    let mut columns = vec![0.0; 2 * INNER * INNER];
    let mut weights: Vec<[(usize, f64); 3]> = vec![[(usize::MAX, 0.0); 3]; ROW * ROW];
    let slots = [ROW, 1, ROW + 1];
    for (k, slot) in weights.iter_mut().enumerate() {
        for (entry, offset) in slot.iter_mut().zip(slots) {
            entry.0 = k + offset;
        }
    }
    let mut add = |a: usize, b: usize, opposite: usize| {
        let (p, q) = (positions[a] - positions[opposite], positions[b] - positions[opposite]);
        let cotangent = p.dot(&q) / p.cross(&q).norm().max(1e-12);
        let (low, high) = (a.min(b), a.max(b));
        if let Some(entry) = weights[low].iter_mut().find(|e| e.0 == high) {
            entry.1 += 0.5 * cotangent;
        }
    };
    for i in 0..CELLS {
        for j in 0..CELLS {
            let [a, b, c, d] = [i * ROW + j, (i + 1) * ROW + j, (i + 1) * ROW + j + 1, i * ROW + j + 1];
            for [x, y, z] in [[a, b, c], [a, c, d]] {
                add(x, y, z);
                add(y, z, x);
                add(z, x, y);
            }
        }
    }
    for (a, list) in weights.iter().enumerate() {
        for &(b, weight) in list {
            if b >= ROW * ROW || (a % ROW == CELLS && b != a + ROW) {
                continue;
            }
            let weight = weight.clamp(0.02, 50.0);
            for (x, y) in [(a, b), (b, a)] {
                let Some(row) = unknown(x) else { continue };
                matrix.add_triplet(row, row, weight);
                match unknown(y) {
                    Some(column) => matrix.add_triplet(row, column, -weight),
                    None => {
                        columns[row] += weight * image[y].x;
                        columns[INNER * INNER + row] += weight * image[y].y;
                    }
                }
            }
        }
    }
    static SYMBOLIC: OnceLock<Option<SymbolicCholesky>> = OnceLock::new();
    let matrix = matrix.to_csc();
    let symbolic = SYMBOLIC.get_or_init(|| SymbolicCholesky::new(&matrix).ok()).as_ref()?;
    symbolic.factorize(&matrix, "harmonic map").ok()?.solve(&mut columns);
    for (k, p) in image.iter_mut().enumerate() {
        if let Some(row) = unknown(k) {
            *p = Vector2::new(columns[row], columns[INNER * INNER + row]);
        }
    }
    invert(&image, sides)
}

/// Where the map given by its `image` at the grid's vertices takes the values of the Greville points.
fn invert(image: &[Vector2<f64>], sides: &[Side; 4]) -> Option<Vec<Vector2<f64>>> {
    const ROW: usize = CELLS + 1;
    let targets = greville(NET);
    let mut result: Vec<Option<Vector2<f64>>> = vec![None; NET * NET];
    for i in 0..CELLS {
        for j in 0..CELLS {
            let cell = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
            for corners in [[cell[0], cell[1], cell[2]], [cell[0], cell[2], cell[3]]] {
                let [a, b, c] = corners.map(|(i, j)| image[i * ROW + j]);
                let area = (b - a).perp(&(c - a));
                let range = |k: usize| {
                    let low = a[k].min(b[k]).min(c[k]) - 1e-9;
                    let high = a[k].max(b[k]).max(c[k]) + 1e-9;
                    targets.partition_point(|&x| x < low)..targets.partition_point(|&x| x <= high)
                };
                for x in range(0) {
                    for y in range(1) {
                        let p = Vector2::new(targets[x], targets[y]);
                        let w = [(b - p).perp(&(c - p)), (c - p).perp(&(a - p)), (a - p).perp(&(b - p))];
                        if result[x * NET + y].is_none() && w.iter().all(|w| *w >= -1e-9 * area.abs()) && area > 0.0 {
                            let mut uv = Vector2::zeros();
                            for (w, (i, j)) in w.iter().zip(corners) {
                                uv += Vector2::new(i as f64, j as f64) * (w / area / CELLS as f64);
                            }
                            result[x * NET + y] = Some(smooth_inverse(image, uv, p));
                        }
                    }
                }
            }
        }
    }
    // The border needs no search.
    for (k, &t) in targets.iter().enumerate() {
        for (side, x, y, s) in [(0, k, 0, t), (1, NET - 1, k, t), (2, k, NET - 1, 1.0 - t), (3, 0, k, 1.0 - t)] {
            result[x * NET + y] = Some(Vector2::from(border_uv(sides[side].position(s))));
        }
    }
    result.into_iter().collect()
}

/// Newton steps on the cubic (Catmull-Rom) interpolant of the map, so that the inverse is smooth across cells.
fn smooth_inverse(image: &[Vector2<f64>], start: Vector2<f64>, target: Vector2<f64>) -> Vector2<f64> {
    const ROW: usize = CELLS + 1;
    let sample = |i: isize, j: isize| {
        // Beyond the border the map goes on linearly.
        let clamp = |k: isize| k.clamp(0, CELLS as isize);
        let inside = |i: isize, j: isize| image[(clamp(i) as usize) * ROW + clamp(j) as usize];
        let (ci, cj) = (clamp(i), clamp(j));
        inside(i, j) * 2.0 - inside(2 * ci - i, 2 * cj - j)
    };
    let weights = |s: f64| {
        let (s2, s3) = (s * s, s * s * s);
        (
            [-0.5 * s + s2 - 0.5 * s3, 1.0 - 2.5 * s2 + 1.5 * s3, 0.5 * s + 2.0 * s2 - 1.5 * s3, -0.5 * s2 + 0.5 * s3],
            [-0.5 + 2.0 * s - 1.5 * s2, -5.0 * s + 4.5 * s2, 0.5 + 4.0 * s - 4.5 * s2, -s + 1.5 * s2],
        )
    };
    let mut uv = start;
    for _ in 0..3 {
        let [x, y] = [uv.x, uv.y].map(|x| (x * CELLS as f64).clamp(0.0, CELLS as f64 - 1e-9));
        let (i, j) = (x.floor() as isize, y.floor() as isize);
        let ((wx, dx), (wy, dy)) = (weights(x.fract()), weights(y.fract()));
        let (mut value, mut du, mut dv) = (Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
        for a in 0..4 {
            for b in 0..4 {
                let p = sample(i + a as isize - 1, j + b as isize - 1);
                value += p * (wx[a] * wy[b]);
                du += p * (dx[a] * wy[b] * CELLS as f64);
                dv += p * (wx[a] * dy[b] * CELLS as f64);
            }
        }
        let miss = target - value;
        let determinant = du.perp(&dv);
        let step = Vector2::new(miss.perp(&dv), du.perp(&miss)) / determinant;
        if step.norm().is_nan() || step.norm() > 1.0 / CELLS as f64 {
            break;
        }
        uv = (uv + step).map(|x| x.clamp(0.0, 1.0));
    }
    uv
}

/// Checks that the new border follows the old one.
fn check_deviation(
    result: &NurbsSurface,
    at: &impl Fn(f64) -> Point3<f64>,
    sides: &[Side; 4],
) -> Result<(), Rejection> {
    for (k, side) in sides.iter().enumerate() {
        for i in 0..=80 {
            let s = (i as f64 / 80.0).min(1.0 - 1e-15);
            let [u, v] = border_uv(k as f64 + s);
            let p = result.point(u, v);
            // The nearest of some samples around, so that speed does not count.
            let miss = (-4..=4)
                .map(|d| side.position((s + 0.002 * f64::from(d)).clamp(0.0, 1.0)))
                .map(|t| (at(t) - p).norm())
                .fold(f64::MAX, f64::min);
            if miss > MAX_DEVIATION {
                return Err(Rejection(Reason::Corners));
            }
        }
    }
    Ok(())
}
