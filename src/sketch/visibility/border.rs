//! The border as one loop.

use super::super::arrange::{Arrangement, Flaw};
use super::super::polyline::{length, middle};
use super::super::stroke::StrokeKind;
use super::Orientation;
use super::meaning::{contradiction, describe};
use std::collections::BTreeSet;

/// The border as one loop of half-edges, counter-clockwise as seen from the front side.
pub(super) fn trace_border(
    arrangement: &Arrangement,
    layers: &[u8],
    visible: &[Orientation],
) -> Result<Vec<usize>, Flaw> {
    let is_border = |h: usize| arrangement.edges[h / 2].kind != StrokeKind::Contour;
    let total = arrangement.edges.iter().filter(|e| e.kind != StrokeKind::Contour).count();
    let Some(start) = (0..arrangement.edges.len()).map(|e| 2 * e).find(|&h| is_border(h)) else {
        return contradiction(
            middle(&arrangement.edges[0].points),
            "the outline consists of contours alone, which is a closed body; draw the surface's border",
        );
    };
    // The half-edge on which the border goes on after it arrived along `h`.
    let follow = |h: usize| {
        let node = arrangement.origin(h ^ 1);
        let branches: Vec<usize> = arrangement.leaving[node].iter().copied().filter(|&h| is_border(h)).collect();
        let k = branches.iter().position(|&b| b == (h ^ 1)).expect("a half-edge's twin leaves its target");
        match branches.len() {
            2 => Ok(branches[1 - k]),
            4 => {
                let occluded = |h: &&usize| arrangement.edges[**h / 2].kind == StrokeKind::OccludedBoundary;
                match branches.iter().filter(occluded).count() {
                    1 => Ok(branches[(k + 2) % 4]),
                    n => contradiction(
                        arrangement.nodes[node],
                        if n == 0 {
                            "two visible boundaries cross here; behind the front one the other one must go on as occluded \
                             boundary"
                        } else {
                            "where two border lines cross the front one stays visible, and exactly one piece of the other is \
                             occluded; check their kinds"
                        },
                    ),
                }
            }
            n => contradiction(arrangement.nodes[node], format!("{n} border lines meet here; let two cross at a time")),
        }
    };
    let mut border = vec![start];
    loop {
        let next = follow(border[border.len() - 1])?;
        if next == start {
            break;
        }
        if border.len() > total {
            return contradiction(arrangement.nodes[arrangement.origin(next)], "the border does not close here");
        }
        border.push(next);
    }
    if border.len() < total {
        let used: BTreeSet<usize> = border.iter().map(|h| h / 2).collect();
        let other = (0..arrangement.edges.len()).find(|e| is_border(2 * e) && !used.contains(e));
        return contradiction(
            middle(&arrangement.edges[other.unwrap_or(start / 2)].points),
            "the border consists of several closed lines; surfaces with holes are not supported, so leave the hole out, or \
             draw the second outline beside the first",
        );
    }
    // Which way round: the sheet that ends at the border lies to the left where its front is seen, else to the right.
    let mut vote = 0.0;
    let mut against: [(f64, usize); 2] = [(0.0, start); 2];
    for &h in &border {
        let (left, right) = (arrangement.face_of[h], arrangement.face_of[h ^ 1]);
        let surface = if layers[left] > layers[right] { left } else { right };
        let sheet = match arrangement.edges[h / 2].kind {
            StrokeKind::OccludedBoundary => visible[surface].flipped(),
            _ => visible[surface],
        };
        let agrees = (surface == left) == (sheet == Orientation::Front);
        let weight = length(&arrangement.edges[h / 2].points);
        vote += if agrees { weight } else { -weight };
        let slot = &mut against[usize::from(agrees)];
        if weight > slot.0 {
            *slot = (weight, h);
        }
    }
    let (disagreement, h) = against[usize::from(vote < 0.0)];
    if disagreement > 3.0 {
        let edge = &arrangement.edges[h / 2];
        return contradiction(
            middle(&edge.points),
            format!(
                "along this {} the surface would lie on the wrong side of its border; check its kind",
                describe(edge.kind)
            ),
        );
    }
    if vote < 0.0 {
        border.reverse();
        border.iter_mut().for_each(|h| *h ^= 1);
    }
    Ok(border)
}
