//! Ends that belong together are brought together: pieces of one line joined, ends put on other lines.

use super::super::fit::{move_end, smooth_joint};
use super::super::polyline::{
    Point, SegmentGrid, arc_lengths, closest, closest_fraction, cross, distance, dot, length, lerp, part, point_at, sub,
};
use super::super::stroke::StrokeKind;
use super::{Branches, Curve, Piece, SNAP_PX, SPREAD_PX, is_complete, kind_index};

/// Wider gaps and overlaps, px, are closed only where nothing nearer is left to join and the junction becomes complete.
const FAR_PX: f64 = 16.0;

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
pub(super) fn join_pieces(curves: &[Curve]) -> Vec<Curve> {
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
pub(super) fn snap(curves: &[Curve], nodes: &mut Vec<Point>) -> Vec<Piece> {
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
            let t = closest_fraction(a, b, p);
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
