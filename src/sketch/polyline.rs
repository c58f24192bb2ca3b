//! Polylines in the plane: lengths, closest points, areas.

/// A point of the plane.
pub(crate) type Point = [f64; 2];

pub(crate) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

pub(crate) fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

pub(crate) fn distance(a: Point, b: Point) -> f64 {
    let d = sub(a, b);
    d[0].hypot(d[1])
}

pub(crate) fn lerp(a: Point, b: Point, t: f64) -> Point {
    [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
}

/// Total length.
pub(crate) fn length(points: &[Point]) -> f64 {
    points.windows(2).map(|w| distance(w[0], w[1])).sum()
}

/// Arc length at each point, starting with 0.
pub(crate) fn arc_lengths(points: &[Point]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut lengths = Vec::with_capacity(points.len());
    for (i, p) in points.iter().enumerate() {
        if i > 0 {
            sum += distance(points[i - 1], *p);
        }
        lengths.push(sum);
    }
    lengths
}

/// Point at arc length `s` (clamped), given the polyline's own `arc_lengths`.
pub(crate) fn point_at(points: &[Point], arc: &[f64], s: f64) -> Point {
    let i = arc.partition_point(|&a| a < s).clamp(1, points.len() - 1);
    let span = arc[i] - arc[i - 1];
    let t = if span > 0.0 { ((s - arc[i - 1]) / span).clamp(0.0, 1.0) } else { 0.0 };
    lerp(points[i - 1], points[i], t)
}

/// Equally spaced points, at most `step` apart; the first and the last are kept as they are.
pub(crate) fn resample(points: &[Point], step: f64) -> Vec<Point> {
    let arc = arc_lengths(points);
    let total = arc[arc.len() - 1];
    let count = ((total / step).ceil() as usize).max(1);
    let mut result = Vec::with_capacity(count + 1);
    result.push(points[0]);
    let mut i = 1;
    for k in 1..count {
        let s = total * k as f64 / count as f64;
        while arc[i] < s && i + 1 < arc.len() {
            i += 1;
        }
        let span = arc[i] - arc[i - 1];
        result.push(lerp(points[i - 1], points[i], if span > 0.0 { (s - arc[i - 1]) / span } else { 0.0 }));
    }
    result.push(points[points.len() - 1]);
    result
}

/// Fraction along the segment from `a` to `b` of its point closest to `p`.
pub(crate) fn closest_fraction(a: Point, b: Point, p: Point) -> f64 {
    let d = sub(b, a);
    let square = dot(d, d);
    if square > 0.0 { (dot(sub(p, a), d) / square).clamp(0.0, 1.0) } else { 0.0 }
}

/// Distance, arc length and position of the polyline's point closest to `p`, within the arc length range `[from, to]`.
pub(crate) fn closest(points: &[Point], arc: &[f64], p: Point, from: f64, to: f64) -> Option<(f64, f64, Point)> {
    let mut best: Option<(f64, f64, Point)> = None;
    for i in 1..points.len() {
        let span = arc[i] - arc[i - 1];
        if arc[i] < from || arc[i - 1] > to || span <= 0.0 {
            continue;
        }
        let (low, high) = (((from - arc[i - 1]) / span).max(0.0), ((to - arc[i - 1]) / span).min(1.0));
        let t = closest_fraction(points[i - 1], points[i], p).clamp(low, high.max(low));
        let q = lerp(points[i - 1], points[i], t);
        let d = distance(p, q);
        if best.is_none_or(|(b, _, _)| d < b) {
            best = Some((d, arc[i - 1] + t * span, q));
        }
    }
    best
}

/// Part of the polyline between two arc lengths, ends included.
pub(crate) fn part(points: &[Point], arc: &[f64], from: f64, to: f64) -> Vec<Point> {
    let mut result = vec![point_at(points, arc, from)];
    for (p, &s) in points.iter().zip(arc) {
        if s > from && s < to && distance(*p, result[result.len() - 1]) > 1e-9 {
            result.push(*p);
        }
    }
    let end = point_at(points, arc, to);
    if result.len() > 1 && distance(end, result[result.len() - 1]) <= 1e-9 {
        result.pop();
    }
    result.push(end);
    result
}

/// Signed area of a closed ring (first point not repeated), positive counter-clockwise.
pub(crate) fn signed_area(ring: &[Point]) -> f64 {
    let origin = ring.first().copied().unwrap_or([0.0; 2]);
    let mut sum = 0.0;
    for i in 0..ring.len() {
        sum += cross(sub(ring[i], origin), sub(ring[(i + 1) % ring.len()], origin));
    }
    0.5 * sum
}

/// Whether `p` lies inside the rings, by the even-odd rule.
pub(crate) fn inside<'a>(rings: impl IntoIterator<Item = &'a Vec<Point>>, p: Point) -> bool {
    let mut odd = false;
    for ring in rings {
        let mut b = ring[ring.len() - 1];
        for &a in ring {
            if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
                odd = !odd;
            }
            b = a;
        }
    }
    odd
}

/// Where two segments meet, as fractions along each; `None` if they do not, or are parallel.
///
/// A crossing at a vertex is found on both sides of it, since rounding could else lose it between the two.
pub(crate) fn meet(a: [Point; 2], b: [Point; 2]) -> Option<(f64, f64)> {
    let (da, db, ab) = (sub(a[1], a[0]), sub(b[1], b[0]), sub(b[0], a[0]));
    let denominator = cross(da, db);
    if denominator == 0.0 {
        return None;
    }
    let (t, u) = (cross(ab, db) / denominator, cross(ab, da) / denominator);
    let range = -1e-9..=1.0 + 1e-9;
    (range.contains(&t) && range.contains(&u)).then_some((t.clamp(0.0, 1.0), u.clamp(0.0, 1.0)))
}

/// Buckets of segments on a uniform grid, to find those near a box.
pub(crate) struct SegmentGrid {
    low: Point,
    cell: f64,
    columns: usize,
    rows: usize,
    buckets: Vec<Vec<u32>>,
}

impl SegmentGrid {
    /// A grid over the bounding box of `segments`, with cells of side `cell` or larger.
    pub(crate) fn new(segments: &[[Point; 2]], cell: f64) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in segments.iter().flatten() {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        if segments.is_empty() {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        let cell = cell.max((high[0] - low[0]).max(high[1] - low[1]) / 512.0);
        let [columns, rows] = [0, 1].map(|k| ((high[k] - low[k]) / cell) as usize + 1);
        let mut grid = Self { low, cell, columns, rows, buckets: vec![vec![]; columns * rows] };
        for (i, s) in segments.iter().enumerate() {
            let (a, b) = grid.cells(s);
            for row in a[1]..=b[1] {
                for column in a[0]..=b[0] {
                    grid.buckets[row * columns + column].push(i as u32);
                }
            }
        }
        grid
    }

    fn cells(&self, box_corners: &[Point; 2]) -> ([usize; 2], [usize; 2]) {
        let count = [self.columns, self.rows];
        let index = |k: usize, x: f64| (((x - self.low[k]) / self.cell).max(0.0) as usize).min(count[k] - 1);
        let [p, q] = box_corners;
        ([0, 1].map(|k| index(k, p[k].min(q[k]))), [0, 1].map(|k| index(k, p[k].max(q[k]))))
    }

    /// Indices of the segments whose cells the box touches, ascending, each once.
    pub(crate) fn near(&self, box_corners: &[Point; 2], found: &mut Vec<u32>) {
        found.clear();
        let (a, b) = self.cells(box_corners);
        for row in a[1]..=b[1] {
            for column in a[0]..=b[0] {
                found.extend(&self.buckets[row * self.columns + column]);
            }
        }
        found.sort_unstable();
        found.dedup();
    }
}

/// The point half-way along.
pub(crate) fn middle(points: &[Point]) -> Point {
    let arc = arc_lengths(points);
    point_at(points, &arc, 0.5 * arc[arc.len() - 1])
}
