//! The structural lines of a projected surface: contours, and the border split into visible and occluded pieces.
//!
//! Visibility follows the border by its events instead of comparing depths: it can change only where the border's
//! projection passes under another piece of border, and where a contour ends in the border. Each event is a root found on
//! the B-spline itself.

use super::grid::Grid;
use super::{Reason, Rejection};
use crate::surface::{NurbsSurface, SurfacePoint};
use nalgebra::{Matrix2, Point3, Vector2, Vector3};

/// A piece of structural line: points with their parameters.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    /// Whether another layer lies in front.
    pub hidden: bool,
    /// Points in the frame of the surface.
    pub points: Vec<Point3<f64>>,
}

/// Structural lines of one surface in one view.
pub(super) struct Structure {
    /// The border, counter-clockwise in the parameter plane from an event or from corner (0, 0), cut where its visibility
    /// changes and at its four corners.
    pub border: Vec<Piece>,
    /// Contours; ends lie on the border.
    pub contours: Vec<Vec<Point3<f64>>>,
    /// Border positions where the visibility changes, in order, and whether the border is hidden from there on.
    changes: Vec<(f64, bool)>,
}

/// Where n . view = 0: S_u x S_v has no z component there.
fn facing(point: &SurfacePoint) -> f64 {
    point.du.x * point.dv.y - point.du.y * point.dv.x
}

/// Parameters at position t in [0, 4) of the border, counter-clockwise; integers are corners.
pub(super) fn border_uv(t: f64) -> [f64; 2] {
    let t = t.rem_euclid(4.0);
    let (side, s) = (t.floor(), t.fract());
    match side as usize {
        0 => [s, 0.0],
        1 => [1.0, s],
        2 => [1.0 - s, 1.0],
        _ => [0.0, 1.0 - s],
    }
}

/// Tangent of the border at t, and the direction into the surface, both as parameter directions.
fn border_directions(t: f64) -> [[f64; 2]; 2] {
    match t.rem_euclid(4.0).floor() as usize {
        0 => [[1.0, 0.0], [0.0, 1.0]],
        1 => [[0.0, 1.0], [-1.0, 0.0]],
        2 => [[-1.0, 0.0], [0.0, -1.0]],
        _ => [[0.0, -1.0], [1.0, 0.0]],
    }
}

/// Derivative of S along a parameter direction.
fn along(point: &SurfacePoint, direction: [f64; 2]) -> Vector3<f64> {
    point.du * direction[0] + point.dv * direction[1]
}

/// Root of `f` between `a` and `b`, whose signs differ: Illinois false position, to 1e-13 of the interval.
fn root(mut a: f64, mut b: f64, mut fa: f64, mut fb: f64, f: impl Fn(f64) -> f64) -> f64 {
    let scale = (b - a).abs();
    let mut side = 0;
    for _ in 0..40 {
        let c = (a * fb - b * fa) / (fb - fa);
        let fc = f(c);
        if fc == 0.0 || (b - a).abs() < 1e-13 * scale.max(1e-3) {
            return c;
        }
        if (fc < 0.0) == (fb < 0.0) {
            b = c;
            fb = fc;
            if side == 1 {
                fa *= 0.5;
            }
            side = 1;
        } else {
            a = c;
            fa = fc;
            if side == -1 {
                fb *= 0.5;
            }
            side = -1;
        }
        if fc.abs() < 1e-13 {
            return c;
        }
    }
    (a * fb - b * fa) / (fb - fa)
}

impl Structure {
    /// Finds the structural lines of `surface`, seen along -z, sampled on `grid`.
    ///
    /// # Errors
    /// The reason why the view breaks Assumption 1 of the paper.
    pub fn new(surface: &NurbsSurface, grid: &Grid) -> Result<Self, Rejection> {
        let folds = folds(surface, grid)?;
        let mut events: Vec<(f64, i32)> = vec![];
        for fold in &folds {
            events.extend(fold_events(surface, fold)?);
        }
        let polyline = border_polyline(grid);
        for [over, under] in crossings(surface, &polyline)? {
            let (upper, lower) = (evaluate(surface, over), evaluate(surface, under));
            let tangent = along(&upper, border_directions(over)[0]);
            let travel = along(&lower, border_directions(under)[0]);
            // Counter-clockwise, the surface lies left of its border, and right of it where it is seen from behind.
            let left = tangent.x * travel.y - tangent.y * travel.x > 0.0;
            let enters = left == (facing(&upper) > 0.0);
            events.push((under, if enters { 1 } else { -1 }));
        }
        events.sort_by(|a, b| a.0.total_cmp(&b.0));
        let hidden_from = quantitative_invisibility(&events)?;
        let border = cut_border(surface, grid.n, &events, &hidden_from);
        let contours = folds
            .iter()
            .map(|fold| fold.iter().map(|&[u, v]| surface.point(u, v)).collect::<Vec<Point3<f64>>>())
            .collect();
        let changes = events.iter().zip(hidden_from).map(|(e, hidden)| (e.0, hidden)).collect();
        Ok(Self { border, contours, changes })
    }

    /// Whether the border at position t is hidden.
    pub fn is_hidden(&self, t: f64) -> bool {
        let t = t.rem_euclid(4.0);
        let after = self.changes.partition_point(|c| c.0 <= t);
        let last = if after > 0 { self.changes.get(after - 1) } else { self.changes.last() };
        last.is_some_and(|c| c.1)
    }
}

fn evaluate(surface: &NurbsSurface, t: f64) -> SurfacePoint {
    let [u, v] = border_uv(t);
    surface.evaluate(u, v)
}

/// The border's samples at the grid's parameters: position t, point.
fn border_polyline(grid: &Grid) -> Vec<(f64, Point3<f64>)> {
    let n = grid.n;
    (0..4 * n)
        .map(|k| {
            let (side, i) = (k / n, k % n);
            let index = match side {
                0 => grid.index(i, 0),
                1 => grid.index(n, i),
                2 => grid.index(n - i, n),
                _ => grid.index(0, n - i),
            };
            (k as f64 / n as f64, grid.position[index])
        })
        .collect()
}

/// Level set n . view = 0 in the parameter domain: polylines from border to border.
///
/// Marching squares on the grid; each vertex is a root on its grid edge.
fn folds(surface: &NurbsSurface, grid: &Grid) -> Result<Vec<Vec<[f64; 2]>>, Rejection> {
    let n = grid.n;
    let step = 1.0 / n as f64;
    let value: Vec<f64> = (0..(n + 1).pow(2)).map(|k| grid.facing(k)).collect();
    let front = |i: usize, j: usize| value[grid.index(i, j)] > 0.0;
    // Edge ids: along u from (i, j): 2 * index; along v: 2 * index + 1.
    let mut ends: std::collections::BTreeMap<usize, [usize; 2]> = std::collections::BTreeMap::new();
    let mut link = |a: usize, b: usize| {
        for (from, to) in [(a, b), (b, a)] {
            let slot = ends.entry(from).or_insert([usize::MAX; 2]);
            if slot[0] == usize::MAX {
                slot[0] = to;
            } else {
                slot[1] = to;
            }
        }
    };
    for i in 0..n {
        for j in 0..n {
            let signs = [front(i, j), front(i + 1, j), front(i + 1, j + 1), front(i, j + 1)];
            let edges = [
                2 * grid.index(i, j),
                2 * grid.index(i + 1, j) + 1,
                2 * grid.index(i, j + 1),
                2 * grid.index(i, j) + 1,
            ];
            let cut: Vec<usize> = (0..4).filter(|&k| signs[k] != signs[(k + 1) % 4]).collect();
            match cut[..] {
                [a, b] => link(edges[a], edges[b]),
                [_, _, _, _] => {
                    let center = facing(&surface.evaluate((i as f64 + 0.5) * step, (j as f64 + 0.5) * step)) > 0.0;
                    // The two corners unlike the centre are cut off.
                    if center == signs[0] {
                        link(edges[0], edges[1]);
                        link(edges[2], edges[3]);
                    } else {
                        link(edges[3], edges[0]);
                        link(edges[1], edges[2]);
                    }
                }
                _ => {}
            }
        }
    }
    let point_on = |edge: usize| {
        let (index, vertical) = (edge / 2, edge % 2 == 1);
        let (i, j) = (index / (n + 1), index % (n + 1));
        let (u, v) = (i as f64 * step, j as f64 * step);
        let other = if vertical { grid.index(i, j + 1) } else { grid.index(i + 1, j) };
        let at = |s: f64| if vertical { [u, v + s * step] } else { [u + s * step, v] };
        let s = root(0.0, 1.0, value[index], value[other], |s| {
            let [u, v] = at(s);
            facing(&surface.evaluate(u, v))
        });
        at(s.clamp(0.0, 1.0))
    };
    let mut seen = std::collections::BTreeSet::new();
    let mut folds = vec![];
    for (&start, neighbours) in &ends {
        if neighbours[1] != usize::MAX || seen.contains(&start) {
            continue;
        }
        let mut fold = vec![];
        let (mut previous, mut here) = (usize::MAX, start);
        while here != usize::MAX {
            seen.insert(here);
            fold.push(point_on(here));
            let [a, b] = ends[&here];
            let next = if a == previous { b } else { a };
            previous = here;
            here = next;
        }
        folds.push(fold);
    }
    if seen.len() < ends.len() {
        return Err(Rejection(Reason::ClosedFold));
    }
    Ok(folds)
}

/// Parameter direction that the view collapses, oriented towards the viewer, and S moved along it.
fn view_kernel(point: &SurfacePoint) -> Option<[f64; 2]> {
    // The null vector of the 2 x 2 Jacobian, from its larger row.
    let rows = [[point.du.x, point.dv.x], [point.du.y, point.dv.y]];
    let norm = |r: [f64; 2]| r[0].hypot(r[1]);
    let row = if norm(rows[0]) > norm(rows[1]) { rows[0] } else { rows[1] };
    let kernel = [-row[1], row[0]];
    let rise = point.du.z * kernel[0] + point.dv.z * kernel[1];
    (rise != 0.0).then(|| kernel.map(|k| k * rise.signum()))
}

/// Gradient of n . view (unnormalized) in the parameters.
fn facing_gradient(p: &SurfacePoint) -> [f64; 2] {
    let cross = |a: &Vector3<f64>, b: &Vector3<f64>| a.x * b.y - a.y * b.x;
    [cross(&p.duu, &p.dv) + cross(&p.du, &p.duv), cross(&p.duv, &p.dv) + cross(&p.du, &p.dvv)]
}

/// Checks a fold for cusps and returns the changes of visibility at its ends: border position, change along the border.
fn fold_events(surface: &NurbsSurface, fold: &[[f64; 2]]) -> Result<Vec<(f64, i32)>, Rejection> {
    let mut front_sign = 0.0;
    for &[u, v] in fold {
        let point = surface.evaluate(u, v);
        let kernel = view_kernel(&point).ok_or(Rejection(Reason::Cusp))?;
        let gradient = facing_gradient(&point);
        // Towards the viewer the surface turns to its front (+) or its back (-); a change of sign is a cusp.
        let sign = (gradient[0] * kernel[0] + gradient[1] * kernel[1]).signum();
        if front_sign == 0.0 {
            front_sign = sign;
        } else if sign != front_sign {
            return Err(Rejection(Reason::Cusp));
        }
    }
    let mut events = vec![];
    for &[u, v] in [fold.first(), fold.last()].into_iter().flatten() {
        let t = if v == 0.0 {
            u
        } else if u == 1.0 {
            1.0 + v
        } else if v == 1.0 {
            3.0 - u
        } else {
            4.0 - v
        };
        let point = surface.evaluate(u, v);
        let kernel = view_kernel(&point).ok_or(Rejection(Reason::Cusp))?;
        let [tangent, inward] = border_directions(t);
        if kernel[0] * inward[0] + kernel[1] * inward[1] <= 0.0 {
            // The front sheet ends before it reaches over the border: both pieces stay as they are.
            continue;
        }
        let gradient = facing_gradient(&point);
        let change = gradient[0] * tangent[0] + gradient[1] * tangent[1];
        // From the front sheet on to the sheet behind it, the border dives under.
        events.push((t, if change.signum() == front_sign { -1 } else { 1 }));
    }
    Ok(events)
}

/// Crossings of the border's projection with itself: positions of the upper and of the lower branch.
fn crossings(surface: &NurbsSurface, polyline: &[(f64, Point3<f64>)]) -> Result<Vec<[f64; 2]>, Rejection> {
    let count = polyline.len();
    let segment = |k: usize| [polyline[k].1, polyline[(k + 1) % count].1];
    // Blocks of segments with bounding boxes keep the pair search short.
    const BLOCK: usize = 16;
    let blocks: Vec<([f64; 2], [f64; 2])> = (0..count.div_ceil(BLOCK))
        .map(|b| {
            let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
            for k in b * BLOCK..((b + 1) * BLOCK).min(count) {
                for p in segment(k) {
                    for axis in 0..2 {
                        low[axis] = low[axis].min(p[axis]);
                        high[axis] = high[axis].max(p[axis]);
                    }
                }
            }
            (low, high)
        })
        .collect();
    let mut found = vec![];
    for a in 0..blocks.len() {
        for b in a..blocks.len() {
            let apart = |axis: usize| blocks[a].1[axis] < blocks[b].0[axis] || blocks[b].1[axis] < blocks[a].0[axis];
            if apart(0) || apart(1) {
                continue;
            }
            for i in a * BLOCK..((a + 1) * BLOCK).min(count) {
                for j in (b * BLOCK).max(i + 2)..((b + 1) * BLOCK).min(count) {
                    if i == 0 && j == count - 1 {
                        continue;
                    }
                    let ([p, q], [r, s]) = (segment(i), segment(j));
                    let Some([x, y]) = intersect([p, q], [r, s]) else { continue };
                    let width = 4.0 / count as f64;
                    let (ti, tj) = (polyline[i].0 + x * width, polyline[j].0 + y * width);
                    let [ti, tj] = refine_crossing(surface, ti, tj);
                    let (zi, zj) = (evaluate(surface, ti).position.z, evaluate(surface, tj).position.z);
                    if (zi - zj).abs() < 1e-3 {
                        return Err(Rejection(Reason::SelfIntersection));
                    }
                    found.push(if zi > zj { [ti, tj] } else { [tj, ti] });
                }
            }
        }
    }
    Ok(found)
}

/// Fractions along two segments where their projections cross.
fn intersect([p, q]: [Point3<f64>; 2], [r, s]: [Point3<f64>; 2]) -> Option<[f64; 2]> {
    let (d, e, f) = ((q - p).xy(), (s - r).xy(), (r - p).xy());
    let denominator = d.perp(&e);
    let (x, y) = (f.perp(&e) / denominator, f.perp(&d) / denominator);
    let inside = |x: f64| (0.0..1.0).contains(&x);
    (inside(x) && inside(y)).then_some([x, y])
}

/// Newton steps on both border positions, kept on their sides.
fn refine_crossing(surface: &NurbsSurface, mut a: f64, mut b: f64) -> [f64; 2] {
    for _ in 0..3 {
        let (p, q) = (evaluate(surface, a), evaluate(surface, b));
        let (d, e) = (along(&p, border_directions(a)[0]), along(&q, border_directions(b)[0]));
        let gap = (q.position - p.position).xy();
        let Some(inverse) = Matrix2::new(d.x, -e.x, d.y, -e.y).try_inverse() else { break };
        let step: Vector2<f64> = inverse * gap;
        if step.norm() > 0.05 {
            break;
        }
        let keep = |t: f64, step: f64| (t + step).clamp(t.floor(), t.floor() + 1.0 - 1e-12);
        a = keep(a, step.x);
        b = keep(b, step.y);
    }
    [a, b]
}

/// Whether the border is hidden after each event; events sorted by position.
fn quantitative_invisibility(events: &[(f64, i32)]) -> Result<Vec<bool>, Rejection> {
    let mut level = 0;
    let levels: Vec<i32> = events
        .iter()
        .map(|(_, change)| {
            level += change;
            level
        })
        .collect();
    let low = levels.iter().copied().min().unwrap_or(0);
    let high = levels.iter().copied().max().unwrap_or(0);
    if level != 0 {
        return Err(Rejection(Reason::Inconsistent));
    }
    if high - low > 1 {
        return Err(Rejection(Reason::TooManyLayers));
    }
    Ok(levels.iter().map(|&l| l > low).collect())
}

/// Cuts the border at its events and corners; consecutive pieces share their ends.
fn cut_border(surface: &NurbsSurface, n: usize, events: &[(f64, i32)], hidden_after: &[bool]) -> Vec<Piece> {
    let mut cuts: Vec<(f64, bool)> = vec![];
    // Crossings under a border and contour ends always change visibility; corners keep it.
    for corner in 0..4 {
        let t = corner as f64;
        let before = events.iter().rposition(|e| e.0 <= t).or(events.len().checked_sub(1));
        cuts.push((t, before.is_some_and(|k| hidden_after[k])));
    }
    cuts.extend(events.iter().zip(hidden_after).map(|(e, &h)| (e.0, h)));
    cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
    cuts.dedup_by(|b, a| {
        (b.0 - a.0).abs() < 1e-9 && {
            a.1 = b.1;
            true
        }
    });
    let count = cuts.len();
    (0..count)
        .map(|k| {
            let (start, hidden) = cuts[k];
            let end = if k + 1 < count { cuts[k + 1].0 } else { cuts[0].0 + 4.0 };
            let inner = ((start * n as f64).floor() as usize + 1)..=((end * n as f64).ceil() as usize - 1);
            let gap = 0.15 / n as f64;
            let inner = inner.map(|i| i as f64 / n as f64).filter(|t| t - start > gap && end - t > gap);
            let points = std::iter::once(start)
                .chain(inner)
                .chain(std::iter::once(end))
                .map(|t| {
                    let [u, v] = border_uv(t);
                    surface.point(u, v)
                })
                .collect();
            Piece { hidden, points }
        })
        .collect()
}
