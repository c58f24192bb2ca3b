//! Silhouettes: where a surface turns away from the viewer, seen along -z.

use super::knots::Basis;
use super::nurbs::NurbsSurface;
use super::tensor::{GridPlanes, TensorGrid};

/// A point of the silhouette: S_u x S_v has no z component.
#[derive(Clone, Copy, Debug)]
pub struct SilhouettePoint {
    /// The grid line that it lies on: twice the sample at its beginning, plus 1 if it runs along u.
    pub edge: usize,
    /// Basis functions there, in u and v.
    pub bases: [Basis; 2],
    /// Projected position (x, y).
    pub position: [f64; 2],
    /// Direction (x, y) to which the surface lies, seen from its apparent contour: the normal, or its opposite.
    pub inward: [f64; 2],
}

/// Newton and secant steps for one root; the grid brackets it well.
const ROOT_STEPS: usize = 4;

/// z component of S_u x S_v at each grid sample: positive where the front faces the viewer.
pub fn facing(planes: &[GridPlanes; 3]) -> Vec<f64> {
    let [x, y, _] = planes;
    (0..x.value.len()).map(|k| x.du[k] * y.dv[k] - x.dv[k] * y.du[k]).collect()
}

/// The silhouette's crossings with the lines of a parameter grid, in the order of the grid.
pub fn crossings(surface: &NurbsSurface, grid: &TensorGrid, facing: &[f64]) -> Vec<SilhouettePoint> {
    let [au, av] = &grid.axes;
    let (mu, mv) = (au.len(), av.len());
    let mut result = vec![];
    for a in 0..mu {
        for b in 0..mv {
            let k = a * mv + b;
            if b + 1 < mv && facing[k] * facing[k + 1] < 0.0 {
                let range = [av.parameters[b], av.parameters[b + 1]];
                result.push(root(surface, 2 * k, au.parameters[a], range, [facing[k], facing[k + 1]]));
            }
            if a + 1 < mu && facing[k] * facing[k + mv] < 0.0 {
                let range = [au.parameters[a], au.parameters[a + 1]];
                result.push(root(surface, 2 * k + 1, av.parameters[b], range, [facing[k], facing[k + mv]]));
            }
        }
    }
    result
}

/// The pieces of the silhouette within the cells of the grid, as pairs of indices of crossings.
pub fn pieces(points: &[SilhouettePoint], grid: &TensorGrid) -> Vec<[usize; 2]> {
    let (mu, mv) = (grid.axes[0].len(), grid.axes[1].len());
    let find = |edge: usize| points.binary_search_by_key(&edge, |p| p.edge).ok();
    let mut result = vec![];
    for point in points {
        // Each cell is looked at from its first crossing: with its corner k, or from above or the left of it.
        let (k, along_u) = (point.edge / 2, point.edge % 2 == 1);
        let before = if along_u { (k % mv > 0).then(|| k - 1) } else { (k / mv > 0).then(|| k - mv) };
        for cell in [Some(k), before].into_iter().flatten() {
            if cell / mv + 1 >= mu || cell % mv + 1 >= mv {
                continue;
            }
            // Around the cell, so that where four edges are crossed neighbours are joined.
            let edges = [2 * cell, 2 * (cell + 1) + 1, 2 * (cell + mv), 2 * cell + 1];
            let crossed: Vec<usize> = edges.iter().filter_map(|&edge| find(edge)).collect();
            let first = edges.iter().find(|&&edge| find(edge).is_some());
            if first == Some(&point.edge) {
                result.extend(crossed.chunks_exact(2).map(|pair| [pair[0], pair[1]]));
            }
        }
    }
    result
}

/// Regula falsi (Illinois) along a line of the grid, the other parameter fixed.
fn root(surface: &NurbsSurface, edge: usize, fixed: f64, range: [f64; 2], values: [f64; 2]) -> SilhouettePoint {
    let at = |t: f64| if edge % 2 == 1 { [t, fixed] } else { [fixed, t] };
    let ([mut a, mut b], [mut fa, mut fb]) = (range, values);
    let mut t = 0.5 * (a + b);
    for _ in 0..ROOT_STEPS {
        t = (a * fb - b * fa) / (fb - fa);
        let [u, v] = at(t);
        let p = surface.evaluate(u, v);
        let f = p.du.x * p.dv.y - p.dv.x * p.du.y;
        if f.abs() <= 1e-9 * (values[0].abs() + values[1].abs()) {
            break;
        }
        if f * fb < 0.0 {
            (a, fa) = (b, fb);
        } else {
            fa *= 0.5;
        }
        (b, fb) = (t, f);
    }
    let parameters = at(t);
    let bases = [0, 1].map(|k| surface.knots()[k].basis(parameters[k]));
    let p = surface.evaluate_with(&bases[0], &bases[1]);
    // The tangent along the line of sight, a S_u + b S_v, and the curvature of the surface in that direction.
    let (a, b) =
        if p.du.x.abs() + p.dv.x.abs() > p.du.y.abs() + p.dv.y.abs() { (p.dv.x, -p.du.x) } else { (p.dv.y, -p.du.y) };
    let normal = p.du.cross(&p.dv);
    let bend = normal.dot(&(p.duu * (a * a) + p.duv * (2.0 * a * b) + p.dvv * (b * b)));
    let inward = [normal.x, normal.y].map(|n| n * bend.signum() / normal.x.hypot(normal.y).max(f64::MIN_POSITIVE));
    SilhouettePoint { edge, bases, position: [p.position.x, p.position.y], inward }
}

/// The point nearest to `p` on the line from `a` to `b`: the share of the way, and the distance.
pub fn nearest_on_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> (f64, f64) {
    let d = [b[0] - a[0], b[1] - a[1]];
    let squared = d[0] * d[0] + d[1] * d[1];
    let along = (p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1];
    let t = if squared > 0.0 { (along / squared).clamp(0.0, 1.0) } else { 0.0 };
    (t, (p[0] - a[0] - t * d[0]).hypot(p[1] - a[1] - t * d[1]))
}

/// An open polyline in the canvas plane, and the nearest point on it.
#[derive(Clone, Debug)]
pub struct Polyline {
    /// Vertices.
    pub points: Vec<[f64; 2]>,
    /// Arc length from the start to each vertex.
    pub lengths: Vec<f64>,
    /// Low and high corner of each run of [`RUN`] segments.
    boxes: Vec<[[f64; 2]; 2]>,
}

/// Segments that are looked at together in the search for the nearest one.
const RUN: usize = 8;

/// The point of a polyline nearest to another point.
#[derive(Clone, Copy, Debug)]
pub struct PolylineFoot {
    /// Its position.
    pub position: [f64; 2],
    /// Unit normal of the polyline there.
    pub normal: [f64; 2],
    /// Distance.
    pub distance: f64,
}

impl Polyline {
    /// Takes the vertices, without repeated ones.
    pub fn new(points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut kept: Vec<[f64; 2]> = vec![];
        let mut lengths: Vec<f64> = vec![];
        for p in points {
            let step = kept.last().map_or(0.0, |q: &[f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]));
            if kept.is_empty() || step > 0.0 {
                lengths.push(lengths.last().copied().unwrap_or(0.0) + step);
                kept.push(p);
            }
        }
        let boxes = (0..kept.len().saturating_sub(1))
            .step_by(RUN)
            .map(|first| {
                let run = &kept[first..=(first + RUN).min(kept.len() - 1)];
                let extreme = |f: fn(f64, f64) -> f64| [0, 1].map(|c| run.iter().map(|p| p[c]).fold(run[0][c], f));
                [extreme(f64::min), extreme(f64::max)]
            })
            .collect();
        Self { points: kept, lengths, boxes }
    }

    /// Whole length.
    pub fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    /// The point at arc length `s`, clamped.
    pub fn at(&self, s: f64) -> [f64; 2] {
        let i = self.lengths.partition_point(|&l| l <= s).clamp(1, self.points.len() - 1);
        let (a, b) = (self.points[i - 1], self.points[i]);
        let t = ((s - self.lengths[i - 1]) / (self.lengths[i] - self.lengths[i - 1])).clamp(0.0, 1.0);
        [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
    }

    /// Whether the polyline comes nearer to `p` than `reach`.
    pub fn passes(&self, p: [f64; 2], reach: f64) -> bool {
        let within = |run: usize| {
            let ends = self.points[run * RUN..].windows(2).take(RUN);
            ends.into_iter().any(|ends| nearest_on_segment(p, ends[0], ends[1]).1 < reach)
        };
        (0..self.boxes.len()).any(|run| self.box_distance_squared(run, p) < reach * reach && within(run))
    }

    /// Squared distance of `p` from the box of a run: none of its points is nearer.
    fn box_distance_squared(&self, run: usize, p: [f64; 2]) -> f64 {
        let [low, high] = self.boxes[run];
        let apart = |c: usize| (low[c] - p[c]).max(p[c] - high[c]).max(0.0);
        apart(0).powi(2) + apart(1).powi(2)
    }

    /// The nearest point among those with arc length in `window`; `None` for fewer than two vertices.
    pub fn nearest(&self, p: [f64; 2], window: [f64; 2]) -> Option<PolylineFoot> {
        let segments = self.points.len().checked_sub(1).filter(|&s| s > 0)?;
        let first = self.lengths.partition_point(|&l| l < window[0]).saturating_sub(1).min(segments - 1);
        let last = self.lengths.partition_point(|&l| l <= window[1]).clamp(first + 1, segments);
        let mut best = (f64::INFINITY, first, 0.0);
        let look_at = |run: usize, best: &mut (f64, usize, f64)| {
            for i in (run * RUN).max(first)..(run * RUN + RUN).min(last) {
                let (a, b) = (self.points[i], self.points[i + 1]);
                let d = [b[0] - a[0], b[1] - a[1]];
                let e = [p[0] - a[0], p[1] - a[1]];
                let t = ((d[0] * e[0] + d[1] * e[1]) / (d[0] * d[0] + d[1] * d[1])).clamp(0.0, 1.0);
                let squared = (e[0] - t * d[0]).powi(2) + (e[1] - t * d[1]).powi(2);
                if squared < best.0 {
                    *best = (squared, i, t);
                }
            }
        };
        let runs = first / RUN..(last - 1) / RUN + 1;
        let least = |run: usize| self.box_distance_squared(run, p);
        // The run that may be nearest tells of most others that they are not.
        let likely = runs.clone().min_by(|&a, &b| least(a).total_cmp(&least(b)))?;
        look_at(likely, &mut best);
        for run in runs.filter(|&run| run != likely) {
            if least(run) < best.0 {
                look_at(run, &mut best);
            }
        }
        let (squared, i, t) = best;
        if !squared.is_finite() {
            return None;
        }
        let (a, b) = (self.points[i], self.points[i + 1]);
        let d = [b[0] - a[0], b[1] - a[1]];
        let length = d[0].hypot(d[1]);
        let position = [a[0] + t * d[0], a[1] + t * d[1]];
        Some(PolylineFoot { position, normal: [-d[1] / length, d[0] / length], distance: squared.sqrt() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_nearest_point_is_that_of_all_segments() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut place = |reach: f64| [0, 1].map(|_| reach * (random.random::<f64>() - 0.5));
        for count in [2, 3, 9, 10, 100] {
            let mut at = [0.0; 2];
            let points = (0..count).map(|_| {
                let step = place(1.0);
                at = [at[0] + step[0], at[1] + step[1]];
                at
            });
            let line = Polyline::new(points.collect::<Vec<_>>());
            for _ in 0..50 {
                let p = place(8.0);
                let whole = line.nearest(p, [0.0, f64::INFINITY]).unwrap().distance;
                assert!(line.passes(p, whole * 1.001 + 1e-9) && !line.passes(p, whole * 0.999));
                let [low, high] = [0, 1].map(|_| place(1.0)[0] + 0.5).map(|share| share * line.length());
                let window = [low.min(high), low.max(high)];
                for window in [[0.0, f64::INFINITY], window] {
                    // Whole segments count, those that the window touches.
                    let touched = (0..line.points.len() - 1)
                        .filter(|&i| line.lengths[i + 1] >= window[0] && line.lengths[i] <= window[1]);
                    let distances = touched.map(|i| nearest_on_segment(p, line.points[i], line.points[i + 1]).1);
                    let nearest = distances.fold(f64::INFINITY, f64::min);
                    let foot = line.nearest(p, window).unwrap();
                    assert!((foot.distance - nearest).abs() < 1e-12);
                    assert!(((foot.position[0] - p[0]).hypot(foot.position[1] - p[1]) - nearest).abs() < 1e-12);
                }
            }
        }
        assert!(Polyline::new([[1.0, 2.0]]).nearest([0.0; 2], [0.0, 1.0]).is_none());
    }
}
