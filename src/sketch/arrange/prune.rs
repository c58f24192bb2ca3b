//! Drawing noise among the edges: slivers, lobes, overshoots; and what still ends in the open.

use super::super::polyline::{Point, arc_lengths, distance, length, signed_area};
use super::super::stroke::StrokeKind;
use super::{Branches, Edge, Flaw, SNAP_PX, is_complete, kind_index};
use std::collections::BTreeMap;

/// Free ends shorter than this beyond a crossing are overshoots, px.
const OVERSHOOT_PX: f64 = 12.0;
/// Areas between two lines with the same ends below this are drawing noise, px^2.
const SLIVER_PX2: f64 = 6.0;
/// Loops of a line with itself below this length and area are drawing noise, px and px^2.
const LOBE_PX: f64 = 80.0;
const LOBE_PX2: f64 = 40.0;

/// Removes slivers, tiny loops and overshoots; what still ends in the open is a flaw.
pub(super) fn prune(mut edges: Vec<Edge>, nodes: &[Point]) -> Result<Vec<Edge>, Flaw> {
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
    drop_edges(edges, &removed);
}

/// Removes the edges that are marked.
fn drop_edges(edges: &mut Vec<Edge>, removed: &[bool]) {
    let mut marks = removed.iter();
    edges.retain(|_| !marks.next().is_some_and(|&removed| removed));
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
    drop_edges(edges, &removed);
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
