//! Structural strokes to a planar arrangement: ends snapped, crossings cut, half-edges and faces.
//!
//! Pixels of the 256 x 256 canvas, y up. The arrangement works on the curves, never on a raster: a contour and the border
//! that it ends in stay within 3 px for some 15 px, where pixels would merge or cut regions.

use super::fit::{move_end, smooth_joint};
use super::polyline::{
    Point, SegmentGrid, arc_lengths, closest, cross, distance, dot, length, lerp, meet, part, point_at, signed_area,
    sub,
};
use super::stroke::StrokeKind;
use std::collections::BTreeMap;

/// Ends of strokes that miss each other, or another stroke, by at most this belong together, px (3 % of the canvas).
pub(crate) const SNAP_PX: f64 = 8.0;
/// Wider gaps and overlaps, px, are closed only where nothing nearer is left to join and the junction becomes complete.
const FAR_PX: f64 = 16.0;
/// Over how much of a stroke the displacement of its end is spread, px.
const SPREAD_PX: f64 = 15.0;
/// Free ends shorter than this beyond a crossing are overshoots, px.
const OVERSHOOT_PX: f64 = 12.0;
/// Two strokes that leave a node together and meet again within this length are joined up to there, px.
const WELD_PX: f64 = 20.0;
/// Areas between two lines with the same ends below this are drawing noise, px^2.
const SLIVER_PX2: f64 = 6.0;
/// Loops of a line with itself below this length and area are drawing noise, px and px^2.
const LOBE_PX: f64 = 80.0;
const LOBE_PX2: f64 = 40.0;
/// Edges shorter than this are contracted, px.
const TINY_PX: f64 = 0.6;
/// Crossings closer than this are one, px.
const MERGE_PX: f64 = 0.05;

/// A smooth structural curve with its kind and the index of the stroke it came from.
#[derive(Clone, Debug)]
pub(crate) struct Curve {
    pub kind: StrokeKind,
    pub points: Vec<Point>,
    pub source: usize,
}

/// What is wrong with the strokes, in pixels; the caller knows the canvas.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Flaw {
    /// A stroke ends in the open.
    Open { stroke: usize, position: Point, gap: f64 },
    /// The strokes contradict each other.
    Contradiction { position: Point, reason: String },
    /// There is no closed outline.
    NoOutline,
    /// More crossings or strokes than a sketch can have.
    TooLarge { what: &'static str, count: usize, limit: usize },
}

/// An edge of the arrangement: a piece of a curve between two nodes.
#[derive(Clone, Debug)]
pub(crate) struct Edge {
    pub kind: StrokeKind,
    pub points: Vec<Point>,
    pub source: usize,
    pub nodes: [usize; 2],
}

/// A face: half-edge cycles with the face on their left.
#[derive(Clone, Debug, Default)]
pub(crate) struct Face {
    /// Outer cycle (empty for the unbounded face), then holes.
    pub cycles: Vec<Vec<usize>>,
    /// Area without the holes, px^2; 0 for the unbounded face.
    pub area: f64,
}

/// Nodes, edges and faces. Half-edge `2 e` runs along edge `e`, `2 e + 1` against it; face 0 is the unbounded one.
#[derive(Clone, Debug)]
pub(crate) struct Arrangement {
    pub nodes: Vec<Point>,
    pub edges: Vec<Edge>,
    /// Half-edges leaving each node, counter-clockwise.
    pub leaving: Vec<Vec<usize>>,
    /// The face to the left of each half-edge.
    pub face_of: Vec<usize>,
    pub faces: Vec<Face>,
    /// Connected component of each edge, and the face that each component lies in.
    pub component_of: Vec<usize>,
    pub component_face: Vec<usize>,
}

impl Arrangement {
    /// Points along a half-edge.
    pub(crate) fn half_edge_points(&self, h: usize) -> Vec<Point> {
        let mut points = self.edges[h / 2].points.clone();
        if h % 2 == 1 {
            points.reverse();
        }
        points
    }

    /// Node that a half-edge leaves.
    pub(crate) fn origin(&self, h: usize) -> usize {
        self.edges[h / 2].nodes[h % 2]
    }

    /// The closed ring of a cycle, first point not repeated.
    pub(crate) fn ring(&self, cycle: &[usize]) -> Vec<Point> {
        let mut ring = vec![];
        for &h in cycle {
            let points = self.half_edge_points(h);
            ring.extend_from_slice(&points[..points.len() - 1]);
        }
        ring
    }
}

/// A curve between two nodes, before it is cut at crossings.
#[derive(Clone, Debug)]
struct Piece {
    kind: StrokeKind,
    points: Vec<Point>,
    source: usize,
    nodes: [usize; 2],
}

/// Number of branches of visible boundary, occluded boundary and contour at a node.
type Branches = [usize; 3];

fn kind_index(kind: StrokeKind) -> usize {
    match kind {
        StrokeKind::VisibleBoundary => 0,
        StrokeKind::OccludedBoundary => 1,
        StrokeKind::Contour | StrokeKind::Feature => 2,
    }
}

/// Whether a node with these branches is complete: the border goes on, and changes visibility only behind something.
fn is_complete(branches: Branches) -> bool {
    matches!(branches, [2, 0, 0] | [0, 2, 0] | [0, 0, 2] | [1, 1, 1] | [2, 0, 1] | [3, 1, 0])
}

/// Builds the arrangement of the structural curves.
pub(crate) fn arrange(curves: &[Curve]) -> Result<Arrangement, Flaw> {
    let curves = join_pieces(curves);
    let mut nodes = vec![];
    let mut pieces = snap(&curves, &mut nodes);
    weld(&mut pieces, &mut nodes);
    let edges = cut(&pieces, &mut nodes)?;
    let edges = prune(contract(edges, &nodes), &nodes)?;
    if edges.is_empty() {
        return Err(Flaw::NoOutline);
    }
    let mut arrangement = faces(edges, nodes);
    untangle(&mut arrangement);
    Ok(arrangement)
}

// --- snapping -----------------------------------------------------------------------------------------------------------

/// An end of a curve close to something it may belong to.
struct Contact {
    distance: f64,
    end: usize,
    /// Another end, or an arc length on a curve.
    target: Target,
}

#[derive(Clone, Copy)]
enum Target {
    End(usize),
    Interior { curve: usize, s: f64 },
}

/// How hard ends are brought together, in this order.
#[derive(Clone, Copy, PartialEq)]
enum Search {
    /// Ends that need each other, within [`SNAP_PX`].
    Complete,
    /// What makes a junction complete, within [`FAR_PX`].
    Far,
    /// Whatever lies within [`SNAP_PX`].
    Near,
}

/// Ends that meet in one node, possibly in the interior of a curve.
#[derive(Clone, Default)]
struct Cluster {
    ends: Vec<usize>,
    /// Curves passing close by, the one that counts first: curve, and arc lengths nearest to the ends.
    hits: Vec<(usize, Vec<f64>)>,
}

impl Cluster {
    fn hit(&self) -> Option<&(usize, Vec<f64>)> {
        self.hits.first()
    }

    fn branches(&self, curves: &[Curve]) -> Branches {
        let mut branches = [0; 3];
        for &e in &self.ends {
            branches[kind_index(curves[e / 2].kind)] += 1;
        }
        if let Some(&(curve, _)) = self.hit() {
            branches[kind_index(curves[curve].kind)] += 2;
        }
        branches
    }

    fn is_complete(&self, curves: &[Curve]) -> bool {
        is_complete(self.branches(curves))
    }

    /// Adds a passing curve, unless the same stretch of it is known.
    fn add_hit(&mut self, curve: usize, s: &[f64]) {
        let same = |h: &&mut (usize, Vec<f64>)| h.0 == curve && (h.1[0] - s[0]).abs() < 3.0 * SNAP_PX;
        match self.hits.iter_mut().find(same) {
            Some(hit) => hit.1.extend(s),
            None => self.hits.push((curve, s.to_vec())),
        }
    }

    /// The two together; `None` if different curves pass through them. Ends that overlap lie on each other's lines, so a
    /// curve that passes only where it ends in this very cluster counts as an end.
    fn joined(&self, other: &Self, curves: &[Curve], total: &impl Fn(usize) -> f64) -> Option<Self> {
        let ends: Vec<usize> = self.ends.iter().chain(&other.ends).copied().collect();
        let alone = Self { ends: ends.clone(), hits: vec![] };
        if alone.is_complete(curves) {
            return Some(alone);
        }
        let passes = |hit: &(usize, Vec<f64>)| {
            !ends.iter().any(|&e| {
                let along = if e.is_multiple_of(2) { hit.1[0] } else { total(hit.0) - hit.1[0] };
                e / 2 == hit.0 && along < 1.5 * SNAP_PX
            })
        };
        let kept = |c: &Self| -> Vec<(usize, Vec<f64>)> { c.hits.iter().filter(|h| passes(h)).cloned().collect() };
        let (mine, theirs) = (kept(self), kept(other));
        let near = |a: &(usize, Vec<f64>), b: &(usize, Vec<f64>)| a.0 == b.0 && (a.1[0] - b.1[0]).abs() < 3.0 * SNAP_PX;
        // The curve that counts for one must at least pass by the other.
        let first = match (mine.first(), theirs.first()) {
            (Some(a), Some(_)) if theirs.iter().any(|b| near(a, b)) => mine.clone(),
            (Some(_), Some(b)) if mine.iter().any(|a| near(a, b)) => theirs.clone(),
            (Some(_), Some(_)) => return None,
            (Some(_), None) => mine.clone(),
            (None, _) => theirs.clone(),
        };
        let mut joined = Self { ends, hits: vec![] };
        for (curve, s) in first.iter().chain(&mine).chain(&theirs) {
            if !joined.hits.iter().any(|(c, t)| c == curve && t.contains(&s[0])) {
                joined.add_hit(*curve, s);
            }
        }
        Some(joined)
    }
}

/// Where the curves end: their starts (even) and ends (odd).
fn curve_ends(curves: &[Curve]) -> Vec<Point> {
    curves.iter().flat_map(|c| [c.points[0], c.points[c.points.len() - 1]]).collect()
}

/// Which ends belong together.
fn clusters(curves: &[Curve], arcs: &[Vec<f64>], ends: &[Point]) -> Vec<Cluster> {
    let total = |c: usize| arcs[c][arcs[c].len() - 1];
    let contacts = contacts(curves, arcs, ends);

    let mut cluster_of: Vec<usize> = (0..ends.len()).collect();
    let mut clusters: Vec<Cluster> = (0..ends.len()).map(|e| Cluster { ends: vec![e], hits: vec![] }).collect();
    // A border line does not end on a contour; the contour ends on the visible border.
    let sound = |contact: &Contact| match contact.target {
        Target::End(_) => true,
        Target::Interior { curve, .. } => match curves[curve].kind {
            StrokeKind::VisibleBoundary => true,
            StrokeKind::OccludedBoundary => curves[contact.end / 2].kind != StrokeKind::Contour,
            StrokeKind::Contour | StrokeKind::Feature => false,
        },
    };
    let mut open: Vec<&Contact> = contacts.iter().filter(|c| sound(c)).collect();
    // Nearest contacts first. A cluster that is complete takes part only if the other one needs it: at first only where both
    // together are complete, then in any case. After each step nearer contacts may have become possible.
    let patience = 4_000_000 / (open.len() + 1);
    for _ in 0..patience {
        let step = [Search::Complete, Search::Far, Search::Near].into_iter().find_map(|search| {
            (0..open.len()).find_map(|k| {
                let a = cluster_of[open[k].end];
                if search != Search::Far && open[k].distance > SNAP_PX {
                    return None;
                }
                match open[k].target {
                    Target::Interior { curve, s } => (!clusters[a].is_complete(curves)).then(|| {
                        let mut cluster = clusters[a].clone();
                        cluster.add_hit(curve, &[s]);
                        (k, a, cluster)
                    }),
                    Target::End(other) => {
                        let b = cluster_of[other];
                        if a == b || joins_both_ends(&clusters[a], &clusters[b], &total) {
                            return None;
                        }
                        let complete = [a, b].map(|c| clusters[c].is_complete(curves));
                        if complete == [true, true] {
                            return None;
                        }
                        let joined = clusters[a].joined(&clusters[b], curves, &total)?;
                        let wanted = joined.is_complete(curves)
                            || search == Search::Near
                            || (search == Search::Complete && complete == [false, false]);
                        wanted.then_some((k, a, joined))
                    }
                }
            })
        });
        let Some((k, a, cluster)) = step else { break };
        if let Target::End(other) = open[k].target {
            clusters[cluster_of[other]] = Cluster::default();
        }
        for &e in &cluster.ends {
            cluster_of[e] = a;
        }
        clusters[a] = cluster;
        open.remove(k);
    }
    clusters.retain(|c| !c.ends.is_empty());
    clusters
}

/// Mean position of some of the ends.
fn mean(ends: &[Point], list: &[usize]) -> Point {
    let sum = list.iter().fold([0.0; 2], |sum, &e| [sum[0] + ends[e][0], sum[1] + ends[e][1]]);
    sum.map(|x| x / list.len() as f64)
}

/// Puts curves together that continue each other, being of the same kind with nothing else ending there.
fn join_pieces(curves: &[Curve]) -> Vec<Curve> {
    let arcs: Vec<Vec<f64>> = curves.iter().map(|c| arc_lengths(&c.points)).collect();
    let ends = curve_ends(curves);
    let mut partner = vec![usize::MAX; ends.len()];
    let mut curves = curves.to_vec();
    for cluster in clusters(&curves, &arcs, &ends) {
        let [e, f] = cluster.ends[..] else { continue };
        if !cluster.hits.is_empty() || curves[e / 2].kind != curves[f / 2].kind {
            continue;
        }
        let target = mean(&ends, &cluster.ends);
        for end in [e, f] {
            move_end(&mut curves[end / 2].points, end % 2 == 0, target, SPREAD_PX);
        }
        partner[e] = f;
        partner[f] = e;
    }
    let mut used = vec![false; curves.len()];
    let mut joined = vec![];
    // Chains from their free ends first; what remains is closed.
    let free = (0..ends.len()).filter(|&e| partner[e] == usize::MAX);
    for start in free.chain(0..ends.len()) {
        if used[start / 2] {
            continue;
        }
        let mut chain = Curve { kind: curves[start / 2].kind, points: vec![], source: usize::MAX };
        let mut joints = vec![];
        let mut end = start;
        let mut closed = false;
        loop {
            used[end / 2] = true;
            let mut points = curves[end / 2].points.clone();
            if end % 2 == 1 {
                points.reverse();
            }
            if let Some(last) = chain.points.pop() {
                joints.push(chain.points.len());
                points[0] = last;
            }
            chain.points.extend(points);
            chain.source = chain.source.min(curves[end / 2].source);
            let following = partner[end ^ 1];
            if following == usize::MAX {
                break;
            }
            if used[following / 2] {
                closed = following == start;
                break;
            }
            end = following;
        }
        for joint in joints {
            chain.points = smooth_joint(&chain.points, joint, SPREAD_PX);
        }
        if closed {
            // A closed line starts anywhere but where it was closed, so that this place can be smoothed as well.
            let count = chain.points.len() - 1;
            chain.points[count] = chain.points[0];
            let half = count / 2;
            let mut turned = chain.points[half..].to_vec();
            turned.extend_from_slice(&chain.points[1..=half]);
            chain.points = smooth_joint(&turned, count - half, SPREAD_PX);
        }
        joined.push(chain);
    }
    joined
}

/// Brings the ends together and splits the curves where others end on them.
fn snap(curves: &[Curve], nodes: &mut Vec<Point>) -> Vec<Piece> {
    let mut points: Vec<Vec<Point>> = curves.iter().map(|c| c.points.clone()).collect();
    let arcs: Vec<Vec<f64>> = points.iter().map(|p| arc_lengths(p)).collect();
    let total = |c: usize| arcs[c][arcs[c].len() - 1];
    let ends = curve_ends(curves);
    let clusters = clusters(curves, &arcs, &ends);
    let mut node_of_end = vec![usize::MAX; ends.len()];
    for cluster in clusters.iter().filter(|c| c.hits.is_empty()) {
        let target = mean(&ends, &cluster.ends);
        for &e in &cluster.ends {
            node_of_end[e] = nodes.len();
            if ends[e] != target {
                move_end(&mut points[e / 2], e % 2 == 0, target, SPREAD_PX);
            }
        }
        nodes.push(target);
    }
    // Where ends meet the interior of a curve that itself moves, a few rounds settle; the last position is exact.
    let mut hits: Vec<(usize, Point, usize, [f64; 2])> = vec![];
    for round in 0..4 {
        for cluster in &clusters {
            let Some((curve, s)) = cluster.hit() else { continue };
            let s = s.iter().sum::<f64>() / s.len() as f64;
            let near = point_at(&curves[*curve].points, &arcs[*curve], s);
            let arc = arc_lengths(&points[*curve]);
            let expected = s / total(*curve) * arc[arc.len() - 1];
            let reach = hit_reach(cluster, *curve, expected, arc[arc.len() - 1]);
            let (from, to) = (expected - reach, expected + reach);
            let Some((_, _, target)) = closest(&points[*curve], &arc, near, from, to) else { continue };
            for &e in &cluster.ends {
                move_end(&mut points[e / 2], e % 2 == 0, target, SPREAD_PX);
            }
            if round == 3 {
                for &e in &cluster.ends {
                    node_of_end[e] = nodes.len();
                }
                hits.push((*curve, target, nodes.len(), [from, to]));
                nodes.push(target);
            }
        }
    }

    let mut pieces = vec![];
    for (c, curve) in curves.iter().enumerate() {
        for end in [2 * c, 2 * c + 1] {
            if node_of_end[end] == usize::MAX {
                node_of_end[end] = nodes.len();
                nodes.push(if end % 2 == 0 { points[c][0] } else { points[c][points[c].len() - 1] });
            }
        }
        let arc = arc_lengths(&points[c]);
        let whole = arc[arc.len() - 1];
        let mut stops: Vec<(f64, usize)> = vec![];
        for &(hit, position, node, [from, to]) in &hits {
            if hit == c
                && let Some((_, s, _)) = closest(&points[c], &arc, position, from.max(0.01), to.min(whole - 0.01))
            {
                stops.push((s, node));
            }
        }
        stops.push((0.0, node_of_end[2 * c]));
        stops.push((whole, node_of_end[2 * c + 1]));
        stops.sort_by(|a, b| a.0.total_cmp(&b.0));
        for w in stops.windows(2) {
            let mut points = part(&points[c], &arc, w[0].0, w[1].0);
            let last = points.len() - 1;
            points[0] = nodes[w[0].1];
            points[last] = nodes[w[1].1];
            if w[0].1 != w[1].1 || length(&points) > SNAP_PX {
                pieces.push(Piece { kind: curve.kind, points, source: curve.source, nodes: [w[0].1, w[1].1] });
            }
        }
    }
    pieces
}

/// How far along a curve from where others end on it to look for that place again; not as far as the curve's own end, if
/// that end is there as well.
fn hit_reach(cluster: &Cluster, curve: usize, s: f64, whole: f64) -> f64 {
    let own = cluster.ends.iter().filter(|&&e| e / 2 == curve);
    own.map(|e| 0.6 * if e.is_multiple_of(2) { s } else { whole - s }).fold(2.0 * SNAP_PX, f64::min)
}

/// Whether joining would bring both ends of a short curve together.
fn joins_both_ends(a: &Cluster, b: &Cluster, total: &impl Fn(usize) -> f64) -> bool {
    a.ends.iter().any(|&e| b.ends.iter().any(|&f| e / 2 == f / 2 && total(e / 2) < 4.0 * SNAP_PX))
}

/// Whether two ends point at each other along one line, with a gap or an overlap.
fn faces_end(curves: &[Curve], e: usize, f: usize) -> bool {
    let ray = |end: usize| {
        let points = &curves[end / 2].points;
        let at = |i: usize| points[if end.is_multiple_of(2) { i } else { points.len() - 1 - i }];
        let back = at(10.min(points.len() - 1));
        let d = sub(at(0), back);
        let norm = d[0].hypot(d[1]).max(f64::MIN_POSITIVE);
        (at(0), d.map(|x| x / norm))
    };
    let ((p, u), (q, v)) = (ray(e), ray(f));
    dot(u, v) < -0.8 && cross(u, sub(q, p)).abs() < 0.5 * SNAP_PX
}

/// A stretch of a curve close to an end: its nearest point, and the arc length up to which it was followed.
struct Pass {
    curve: usize,
    distance: f64,
    s: f64,
    last: f64,
}

/// All contacts within [`FAR_PX`], nearest first.
fn contacts(curves: &[Curve], arcs: &[Vec<f64>], ends: &[Point]) -> Vec<Contact> {
    let mut segments = vec![];
    let mut owner = vec![];
    for (c, curve) in curves.iter().enumerate() {
        let p = &curve.points;
        for i in 1..p.len() {
            segments.push([p[i - 1], p[i]]);
            owner.push((c, i - 1));
        }
    }
    let grid = SegmentGrid::new(&segments, SNAP_PX);
    let mut found = vec![];
    let mut contacts = vec![];
    for (e, &p) in ends.iter().enumerate() {
        for (f, &q) in ends.iter().enumerate().skip(e + 1) {
            let d = distance(p, q);
            if d <= FAR_PX {
                // A line that goes on is likelier than one that stops at another.
                let d = if curves[e / 2].kind == curves[f / 2].kind && faces_end(curves, e, f) { 0.5 * d } else { d };
                contacts.push(Contact { distance: d, end: e, target: Target::End(f) });
            }
        }
        let reach = FAR_PX;
        grid.near(&[[p[0] - reach, p[1] - reach], [p[0] + reach, p[1] + reach]], &mut found);
        // A curve may pass several times.
        let mut passes: Vec<Pass> = vec![];
        for &i in &found {
            let (c, k) = owner[i as usize];
            let [a, b] = segments[i as usize];
            let t = super::polyline::closest_fraction(a, b, p);
            let (d, s) = (distance(lerp(a, b, t), p), arcs[c][k] + t * (arcs[c][k + 1] - arcs[c][k]));
            let whole = arcs[c][arcs[c].len() - 1];
            if c == e / 2 {
                // A curve may end in its own interior, but not right where it ends.
                let own = if e % 2 == 0 { s } else { whole - s };
                if own < 3.0 * SNAP_PX {
                    continue;
                }
            }
            // Near an end that is itself within reach, the ends belong together, unless the line itself is much nearer.
            let end_distance = |side: usize, along: f64| {
                let d = distance(p, ends[2 * c + side]);
                if along < 1.5 * SNAP_PX && d <= FAR_PX { d } else { f64::INFINITY }
            };
            let to_end = end_distance(0, s).min(end_distance(1, whole - s));
            if d > reach || d >= 0.5 * to_end.min(2.0 * reach + 1.0) {
                continue;
            }
            match passes.last_mut() {
                Some(pass) if pass.curve == c && s - pass.last < 1.5 * SNAP_PX => {
                    pass.last = s;
                    if d < pass.distance {
                        (pass.distance, pass.s) = (d, s);
                    }
                }
                _ => passes.push(Pass { curve: c, distance: d, s, last: s }),
            }
        }
        for pass in passes {
            let target = Target::Interior { curve: pass.curve, s: pass.s };
            contacts.push(Contact { distance: pass.distance, end: e, target });
        }
    }
    contacts.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    contacts
}

// --- welding ------------------------------------------------------------------------------------------------------------

/// First `reach` of a piece, seen from one of its ends.
fn beginning(piece: &Piece, at_start: bool, reach: f64) -> Vec<Point> {
    let mut points = vec![];
    let mut sum = 0.0;
    let n = piece.points.len();
    for i in 0..n {
        let p = piece.points[if at_start { i } else { n - 1 - i }];
        if let Some(&last) = points.last() {
            sum += distance(last, p);
        }
        if sum > reach {
            break;
        }
        points.push(p);
    }
    points
}

/// Farthest crossing of two curves that leave the same point: arc lengths and position.
fn farthest_crossing(a: &[Point], b: &[Point]) -> Option<(f64, f64, Point)> {
    let (arc_a, arc_b) = (arc_lengths(a), arc_lengths(b));
    for i in (1..a.len()).rev() {
        for j in (1..b.len()).rev() {
            if i == 1 && j == 1 {
                continue;
            }
            if let Some((t, u)) = meet([a[i - 1], a[i]], [b[j - 1], b[j]]) {
                let s = arc_a[i - 1] + t * (arc_a[i] - arc_a[i - 1]);
                let r = arc_b[j - 1] + u * (arc_b[j] - arc_b[j - 1]);
                if s > MERGE_PX && r > MERGE_PX {
                    return Some((s, r, lerp(a[i - 1], a[i], t)));
                }
            }
        }
    }
    None
}

/// Cuts the first `s` off a piece's end and puts it on `node`.
fn shorten(piece: &mut Piece, at_start: bool, s: f64, node: usize, position: Point) {
    if !at_start {
        piece.points.reverse();
    }
    let arc = arc_lengths(&piece.points);
    piece.points = part(&piece.points, &arc, s, arc[arc.len() - 1]);
    piece.points[0] = position;
    if !at_start {
        piece.points.reverse();
    }
    piece.nodes[if at_start { 0 } else { 1 }] = node;
}

/// Joins strokes that leave a node together and cross each other again nearby, as contours and the border they end in do.
fn weld(pieces: &mut Vec<Piece>, nodes: &mut Vec<Point>) {
    // Every weld shortens pieces, so this ends; the bound only keeps scribbles cheap.
    for _ in 0..4 * pieces.len() + 16 {
        let mut at_node: BTreeMap<usize, Vec<(usize, bool)>> = BTreeMap::new();
        for (i, piece) in pieces.iter().enumerate() {
            at_node.entry(piece.nodes[0]).or_default().push((i, true));
            at_node.entry(piece.nodes[1]).or_default().push((i, false));
        }
        let mut welded = false;
        'search: for branches in at_node.values() {
            for (x, &(i, i_start)) in branches.iter().enumerate() {
                for &(j, j_start) in &branches[x + 1..] {
                    let reach = |k: usize| WELD_PX.min(0.45 * length(&pieces[k].points));
                    let a = beginning(&pieces[i], i_start, reach(i));
                    let b = beginning(&pieces[j], j_start, reach(j));
                    let Some((s, r, position)) = farthest_crossing(&a, &b) else { continue };
                    let old = pieces[i].nodes[usize::from(!i_start)];
                    let node = nodes.len();
                    nodes.push(position);
                    join(pieces, branches, [(i, i_start, s), (j, j_start, r)], [old, node], position);
                    welded = true;
                    break 'search;
                }
            }
        }
        if !welded {
            return;
        }
    }
}

/// Moves the node where two branches leave to the place where they cross.
fn join(
    pieces: &mut Vec<Piece>,
    branches: &[(usize, bool)],
    crossing: [(usize, bool, f64); 2],
    [old, node]: [usize; 2],
    position: Point,
) {
    let [(i, i_start, s), (j, j_start, r)] = crossing;
    let is_contour = |k: usize| pieces[k].kind == StrokeKind::Contour;
    if i != j && is_contour(i) != is_contour(j) {
        // The contour begins at the crossing; the border up to there continues the border on the other side.
        let (contour, border) = if is_contour(i) { (i, j) } else { (j, i) };
        let (contour_start, contour_s) = if contour == i { (i_start, s) } else { (j_start, r) };
        let (border_start, border_s) = if contour == i { (j_start, r) } else { (i_start, s) };
        let other = branches.iter().find(|&&(k, _)| k != border && pieces[k].kind != StrokeKind::Contour);
        let kind = other.map_or(pieces[border].kind, |&(k, _)| pieces[k].kind);
        let mut points = pieces[border].points.clone();
        if !border_start {
            points.reverse();
        }
        let arc = arc_lengths(&points);
        let mut points = part(&points, &arc, 0.0, border_s);
        let last = points.len() - 1;
        points[last] = position;
        let source = pieces[border].source;
        shorten(&mut pieces[contour], contour_start, contour_s, node, position);
        shorten(&mut pieces[border], border_start, border_s, node, position);
        pieces.push(Piece { kind, points, source, nodes: [old, node] });
        return;
    }
    // Behind the crossing first, where one piece has both ends at the node.
    shorten(&mut pieces[i], i_start, s, node, position);
    shorten(&mut pieces[j], j_start, r, node, position);
    for &(k, k_start) in branches {
        if (k, k_start) != (i, i_start) && (k, k_start) != (j, j_start) {
            move_end(&mut pieces[k].points, k_start, position, SPREAD_PX);
            pieces[k].nodes[usize::from(!k_start)] = node;
        }
    }
}

// --- cutting ------------------------------------------------------------------------------------------------------------

/// More crossings than this are a scribble.
const MAX_CROSSINGS: usize = 20_000;

fn cut(pieces: &[Piece], nodes: &mut Vec<Point>) -> Result<Vec<Edge>, Flaw> {
    let mut segments = vec![];
    let mut owner = vec![];
    for (i, piece) in pieces.iter().enumerate() {
        for (k, w) in piece.points.windows(2).enumerate() {
            segments.push([w[0], w[1]]);
            owner.push((i, k));
        }
    }
    let arcs: Vec<Vec<f64>> = pieces.iter().map(|p| arc_lengths(&p.points)).collect();
    let grid = SegmentGrid::new(&segments, 2.0);
    let mut stops: Vec<Vec<(f64, usize)>> =
        pieces.iter().zip(&arcs).map(|(p, arc)| vec![(0.0, p.nodes[0]), (arc[arc.len() - 1], p.nodes[1])]).collect();
    // Nodes by cell, so that crossings at the same place become one.
    let mut cells: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    let cell = |p: Point| ((p[0] / MERGE_PX).floor() as i64, (p[1] / MERGE_PX).floor() as i64);
    for (n, &p) in nodes.iter().enumerate() {
        cells.entry(cell(p)).or_default().push(n);
    }
    let mut crossings = 0;
    let mut found = vec![];
    for x in 0..segments.len() {
        grid.near(&segments[x], &mut found);
        for &y in found.iter().filter(|&&y| y as usize > x) {
            let y = y as usize;
            let ((i, k), (j, m)) = (owner[x], owner[y]);
            if i == j && k.abs_diff(m) <= 1 {
                continue;
            }
            let (a, b) = (segments[x], segments[y]);
            let Some((t, u)) = meet(a, b) else { continue };
            let p = lerp(a[0], a[1], t);
            crossings += 1;
            if crossings > MAX_CROSSINGS {
                return Err(Flaw::TooLarge { what: "crossings", count: crossings, limit: MAX_CROSSINGS });
            }
            let (cx, cy) = cell(p);
            let near = (cx - 1..=cx + 1)
                .flat_map(|cx| (cy - 1..=cy + 1).map(move |cy| (cx, cy)))
                .flat_map(|c| cells.get(&c).into_iter().flatten().copied())
                .find(|&n| distance(nodes[n], p) <= MERGE_PX);
            let node = near.unwrap_or_else(|| {
                nodes.push(p);
                cells.entry((cx, cy)).or_default().push(nodes.len() - 1);
                nodes.len() - 1
            });
            stops[i].push((arcs[i][k] + t * (arcs[i][k + 1] - arcs[i][k]), node));
            stops[j].push((arcs[j][m] + u * (arcs[j][m + 1] - arcs[j][m]), node));
        }
    }
    let mut edges = vec![];
    for (i, piece) in pieces.iter().enumerate() {
        stops[i].sort_by(|a, b| a.0.total_cmp(&b.0));
        for w in stops[i].windows(2) {
            if w[0].1 == w[1].1 && w[1].0 - w[0].0 < 4.0 * MERGE_PX {
                continue;
            }
            let mut points = part(&piece.points, &arcs[i], w[0].0, w[1].0);
            let last = points.len() - 1;
            points[0] = nodes[w[0].1];
            points[last] = nodes[w[1].1];
            edges.push(Edge { kind: piece.kind, points, source: piece.source, nodes: [w[0].1, w[1].1] });
        }
    }
    Ok(edges)
}

/// Lets nodes that a tiny edge connects fall together; such edges have no direction that could be trusted.
fn contract(edges: Vec<Edge>, nodes: &[Point]) -> Vec<Edge> {
    let mut target: BTreeMap<usize, usize> = BTreeMap::new();
    let find = |target: &BTreeMap<usize, usize>, mut n: usize| {
        while let Some(&t) = target.get(&n) {
            n = t;
        }
        n
    };
    let tiny = |e: &Edge| length(&e.points) < TINY_PX;
    for e in edges.iter().filter(|e| tiny(e)) {
        let [a, b] = e.nodes.map(|n| find(&target, n));
        if a != b {
            target.insert(a.max(b), a.min(b));
        }
    }
    let mut kept: Vec<Edge> = edges.into_iter().filter(|e| !tiny(e)).collect();
    for e in &mut kept {
        e.nodes = e.nodes.map(|n| find(&target, n));
        let last = e.points.len() - 1;
        e.points[0] = nodes[e.nodes[0]];
        e.points[last] = nodes[e.nodes[1]];
    }
    kept
}

// --- pruning ------------------------------------------------------------------------------------------------------------

/// Removes slivers, tiny loops and overshoots; what still ends in the open is a flaw.
fn prune(mut edges: Vec<Edge>, nodes: &[Point]) -> Result<Vec<Edge>, Flaw> {
    loop {
        let before = edges.len();
        edges.retain(|e| e.nodes[0] != e.nodes[1] || signed_area(&e.points[..e.points.len() - 1]).abs() >= SLIVER_PX2);
        remove_slivers(&mut edges);
        remove_lobes(&mut edges);
        trim_overshoots(&mut edges, nodes.len());
        if edges.len() == before {
            break;
        }
    }
    let mut degree = vec![0; nodes.len()];
    for e in &edges {
        degree[e.nodes[0]] += 1;
        degree[e.nodes[1]] += 1;
    }
    // The widest gap is the one to name.
    let mut worst: Option<Flaw> = None;
    let mut widest = -1.0;
    for (i, e) in edges.iter().enumerate() {
        for side in 0..2 {
            if degree[e.nodes[side]] > 1 {
                continue;
            }
            let position = nodes[e.nodes[side]];
            let gap = gap(&edges, i, side);
            if gap > widest {
                widest = gap;
                worst = Some(Flaw::Open { stroke: e.source, position, gap });
            }
        }
    }
    worst.map_or(Ok(edges), Err)
}

/// Distance from an open end to the nearest line, other than the run of the stroke up to that end.
fn gap(edges: &[Edge], edge: usize, side: usize) -> f64 {
    let points = &edges[edge].points;
    let p = if side == 0 { points[0] } else { points[points.len() - 1] };
    let mut best = f64::INFINITY;
    for (i, e) in edges.iter().enumerate() {
        let arc = arc_lengths(&e.points);
        let whole = arc[arc.len() - 1];
        for (q, s) in e.points.iter().zip(&arc) {
            let d = distance(*q, p);
            // On its own edge only what the stroke comes back to counts.
            if i != edge || (if side == 0 { *s } else { whole - s }) > 2.0 * d.max(SNAP_PX) {
                best = best.min(d);
            }
        }
    }
    best
}

/// Of two lines with the same ends and almost no area between them one stays: the border rather than the contour.
fn remove_slivers(edges: &mut Vec<Edge>) {
    let mut by_ends: BTreeMap<[usize; 2], Vec<usize>> = BTreeMap::new();
    for (i, e) in edges.iter().enumerate() {
        if e.nodes[0] != e.nodes[1] {
            by_ends.entry([e.nodes[0].min(e.nodes[1]), e.nodes[0].max(e.nodes[1])]).or_default().push(i);
        }
    }
    let mut branches: BTreeMap<usize, Branches> = BTreeMap::new();
    for e in edges.iter() {
        for n in e.nodes {
            branches.entry(n).or_default()[kind_index(e.kind)] += 1;
        }
    }
    let mut removed = vec![false; edges.len()];
    for group in by_ends.values().filter(|g| g.len() > 1) {
        for (x, &i) in group.iter().enumerate() {
            for &j in &group[x + 1..] {
                if removed[i] || removed[j] {
                    continue;
                }
                let mut ring = edges[i].points.clone();
                let back = &edges[j].points;
                if edges[j].nodes == edges[i].nodes {
                    ring.extend(back.iter().rev());
                } else {
                    ring.extend(back.iter());
                }
                if signed_area(&ring).abs() >= SLIVER_PX2 {
                    continue;
                }
                let (a, b) = (edges[i].kind, edges[j].kind);
                let drop = if a == StrokeKind::Contour && b != a { i } else { j };
                let keep = i + j - drop;
                // Without the fold between them nothing hides the border.
                let kind = if a == b { a } else { StrokeKind::VisibleBoundary };
                // A tiny region may be real: it is, if the lines around it do not add up without it.
                let after = edges[i].nodes.map(|n| {
                    let mut left = branches[&n];
                    left[kind_index(a)] -= 1;
                    left[kind_index(b)] -= 1;
                    left[kind_index(kind)] += 1;
                    (n, left)
                });
                if after.iter().any(|&(n, left)| is_complete(branches[&n]) && !is_complete(left)) {
                    continue;
                }
                branches.extend(after);
                removed[drop] = true;
                edges[keep].kind = kind;
            }
        }
    }
    let mut k = 0;
    edges.retain(|_| {
        k += 1;
        !removed[k - 1]
    });
}

/// Removes small loops that a line makes with itself, as at a narrow corner whose sides cross.
fn remove_lobes(edges: &mut Vec<Edge>) {
    let mut at_node: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, e) in edges.iter().enumerate() {
        at_node.entry(e.nodes[0]).or_default().push(2 * i);
        at_node.entry(e.nodes[1]).or_default().push(2 * i + 1);
    }
    let mut removed = vec![false; edges.len()];
    for (&node, leaving) in at_node.iter().filter(|(_, l)| l.len() >= 4) {
        for &start in leaving {
            let (mut h, mut ring, mut loop_edges) = (start, vec![], vec![]);
            let closed = loop {
                let edge = &edges[h / 2];
                if removed[h / 2] || edge.kind != edges[start / 2].kind || length(&ring) > LOBE_PX {
                    break false;
                }
                loop_edges.push(h / 2);
                ring.extend(
                    (0..edge.points.len()).map(|i| edge.points[if h % 2 == 0 { i } else { edge.points.len() - 1 - i }]),
                );
                let end = edge.nodes[1 - h % 2];
                if end == node {
                    break true;
                }
                match at_node[&end][..] {
                    [a, b] => h = if a == (h ^ 1) { b } else { a },
                    _ => break false,
                }
            };
            if closed && length(&ring) < LOBE_PX && signed_area(&ring).abs() < LOBE_PX2 {
                loop_edges.iter().for_each(|&e| removed[e] = true);
            }
        }
    }
    let mut k = 0;
    edges.retain(|_| {
        k += 1;
        !removed[k - 1]
    });
}

/// Removes short edges that end in the open beyond a crossing.
fn trim_overshoots(edges: &mut Vec<Edge>, node_count: usize) {
    let mut degree = vec![0; node_count];
    for e in edges.iter() {
        degree[e.nodes[0]] += 1;
        degree[e.nodes[1]] += 1;
    }
    edges.retain(|e| {
        let free = [0, 1].map(|k| degree[e.nodes[k]] == 1);
        !(free[0] != free[1] && length(&e.points) < OVERSHOOT_PX)
    });
}

// --- faces --------------------------------------------------------------------------------------------------------------

/// Orders the half-edges around the nodes, follows the cycles, and nests the components.
fn faces(edges: Vec<Edge>, nodes: Vec<Point>) -> Arrangement {
    let mut leaving: Vec<Vec<usize>> = vec![vec![]; nodes.len()];
    for (i, e) in edges.iter().enumerate() {
        leaving[e.nodes[0]].push(2 * i);
        leaving[e.nodes[1]].push(2 * i + 1);
    }
    for (n, list) in leaving.iter_mut().enumerate() {
        if list.len() < 2 {
            continue;
        }
        // Tangential branches have no useful first direction. Curves that do not cross leave every circle around the node
        // in the order in which they leave the node, so the largest circle that all of them reach decides.
        let reach = |h: usize| edges[h / 2].points.iter().map(|&p| distance(p, nodes[n])).fold(0.0, f64::max);
        let radius = list.iter().map(|&h| 0.9 * reach(h)).fold(10.0, f64::min);
        let mut keyed: Vec<(f64, usize)> = list
            .iter()
            .map(|&h| {
                let q = exit(&edges[h / 2].points, h % 2 == 1, nodes[n], radius);
                let d = sub(q, nodes[n]);
                (d[1].atan2(d[0]), h)
            })
            .collect();
        keyed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        *list = keyed.into_iter().map(|(_, h)| h).collect();
    }
    let mut place = vec![0; 2 * edges.len()];
    for list in &leaving {
        for (k, &h) in list.iter().enumerate() {
            place[h] = k;
        }
    }
    let next = |h: usize| {
        let twin = h ^ 1;
        let list = &leaving[edges[twin / 2].nodes[twin % 2]];
        list[(place[twin] + list.len() - 1) % list.len()]
    };
    let mut cycle_of = vec![usize::MAX; 2 * edges.len()];
    let mut cycles: Vec<Vec<usize>> = vec![];
    for start in 0..2 * edges.len() {
        if cycle_of[start] != usize::MAX {
            continue;
        }
        let mut cycle = vec![];
        let mut h = start;
        while cycle_of[h] == usize::MAX {
            cycle_of[h] = cycles.len();
            cycle.push(h);
            h = next(h);
        }
        cycles.push(cycle);
    }
    let component_of = components(&edges, nodes.len());
    let component_count = component_of.iter().max().map_or(0, |m| m + 1);
    let mut arrangement = Arrangement {
        nodes,
        edges,
        leaving,
        face_of: vec![0; cycle_of.len()],
        faces: vec![Face::default()],
        component_of,
        component_face: vec![0; component_count],
    };
    let rings: Vec<Vec<Point>> = cycles.iter().map(|c| arrangement.ring(c)).collect();
    let areas: Vec<f64> = rings.iter().map(|r| signed_area(r)).collect();
    // The outer cycle of a component is its most negative one; all others bound faces.
    let mut outer: Vec<Option<usize>> = vec![None; component_count];
    for (c, cycle) in cycles.iter().enumerate() {
        let slot = &mut outer[arrangement.component_of[cycle[0] / 2]];
        if slot.is_none_or(|o| areas[c] < areas[o]) {
            *slot = Some(c);
        }
    }
    let mut face_of_cycle = vec![0; cycles.len()];
    for c in 0..cycles.len() {
        if outer[arrangement.component_of[cycles[c][0] / 2]] != Some(c) {
            face_of_cycle[c] = arrangement.faces.len();
            arrangement.faces.push(Face { cycles: vec![cycles[c].clone()], area: areas[c] });
        }
    }
    for (component, &cycle) in outer.iter().enumerate() {
        let Some(cycle) = cycle else { continue };
        let p = rings[cycle][0];
        let containing = (0..cycles.len())
            .filter(|&c| {
                face_of_cycle[c] != 0
                    && arrangement.component_of[cycles[c][0] / 2] != component
                    && super::polyline::inside([&rings[c]], p)
            })
            .min_by(|&a, &b| areas[a].total_cmp(&areas[b]));
        let face = containing.map_or(0, |c| face_of_cycle[c]);
        arrangement.component_face[component] = face;
        face_of_cycle[cycle] = face;
        arrangement.faces[face].cycles.push(cycles[cycle].clone());
        if face != 0 {
            arrangement.faces[face].area += areas[cycle];
        }
    }
    for (h, &cycle) in cycle_of.iter().enumerate() {
        arrangement.face_of[h] = face_of_cycle[cycle];
    }
    arrangement
}

/// Widest area between two lines that run side by side in the wrong order, px.
const TANGLE_PX: f64 = 5.0;

/// Where a line crosses the one just in front of it by the unsteadiness of the hand, the outer one is that in front: contours
/// lie before visible boundaries, and those before occluded ones.
fn untangle(arrangement: &mut Arrangement) {
    for f in 1..arrangement.faces.len() {
        let [cycle] = &arrangement.faces[f].cycles[..] else { continue };
        let &[g, h] = &cycle[..] else { continue };
        let (outer, inner) = if arrangement.face_of[g ^ 1] == 0 { (g, h) } else { (h, g) };
        let outside = [outer, inner].map(|h| arrangement.face_of[h ^ 1] == 0);
        let rank = |h: usize| match arrangement.edges[h / 2].kind {
            StrokeKind::Contour => 2,
            StrokeKind::VisibleBoundary => 1,
            StrokeKind::OccludedBoundary | StrokeKind::Feature => 0,
        };
        let long = length(&arrangement.edges[inner / 2].points);
        if outside == [true, false] && rank(outer) < rank(inner) && arrangement.faces[f].area < TANGLE_PX * long {
            let kinds = [outer, inner].map(|h| arrangement.edges[h / 2].kind);
            arrangement.edges[outer / 2].kind = kinds[1];
            arrangement.edges[inner / 2].kind = kinds[0];
        }
    }
}

/// Where a curve first leaves the circle around its starting point.
fn exit(points: &[Point], reversed: bool, center: Point, radius: f64) -> Point {
    let n = points.len();
    let at = |i: usize| points[if reversed { n - 1 - i } else { i }];
    for i in 1..n {
        if distance(at(i), center) >= radius {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..40 {
                let t = 0.5 * (low + high);
                if distance(lerp(at(i - 1), at(i), t), center) < radius {
                    low = t;
                } else {
                    high = t;
                }
            }
            return lerp(at(i - 1), at(i), high);
        }
    }
    at(n - 1)
}

/// Connected component of each edge, numbered by first edge.
fn components(edges: &[Edge], node_count: usize) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..node_count).collect();
    fn root(parent: &mut [usize], mut n: usize) -> usize {
        while parent[n] != n {
            parent[n] = parent[parent[n]];
            n = parent[n];
        }
        n
    }
    for e in edges {
        let (a, b) = (root(&mut parent, e.nodes[0]), root(&mut parent, e.nodes[1]));
        parent[b] = a;
    }
    let mut number = BTreeMap::new();
    edges
        .iter()
        .map(|e| {
            let r = root(&mut parent, e.nodes[0]);
            let count = number.len();
            *number.entry(r).or_insert(count)
        })
        .collect()
}
