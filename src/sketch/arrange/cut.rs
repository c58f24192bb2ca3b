//! Pieces cut at their crossings into edges.

use super::super::polyline::{Point, SegmentGrid, arc_lengths, distance, length, lerp, meet, part};
use super::{Edge, Flaw, MERGE_PX, Piece};
use std::collections::BTreeMap;

/// Edges shorter than this are contracted, px.
const TINY_PX: f64 = 0.6;

/// More crossings than this are a scribble.
const MAX_CROSSINGS: usize = 20_000;

pub(super) fn cut(pieces: &[Piece], nodes: &mut Vec<Point>) -> Result<Vec<Edge>, Flaw> {
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
pub(super) fn contract(edges: Vec<Edge>, nodes: &[Point]) -> Vec<Edge> {
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
