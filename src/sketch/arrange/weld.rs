//! Lines that leave a node together and cross again nearby are joined up to there.

use super::super::fit::move_end;
use super::super::polyline::{Point, arc_lengths, distance, length, lerp, meet, part};
use super::super::stroke::StrokeKind;
use super::{MERGE_PX, Piece, SPREAD_PX};
use std::collections::BTreeMap;

/// Two strokes that leave a node together and meet again within this length are joined up to there, px.
const WELD_PX: f64 = 20.0;

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
pub(super) fn weld(pieces: &mut Vec<Piece>, nodes: &mut Vec<Point>) {
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
