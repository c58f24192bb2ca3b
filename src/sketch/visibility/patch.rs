//! An outline with its meaning, in the canonical frame of the cleaned strokes.

use super::super::arrange::{Arrangement, Curve};
use super::super::polyline::Point;
use super::super::stroke::{Layer, StrokeKind};
use super::super::view::CanonicalFrame;
use super::meaning::Meaning;
use super::{BorderPoint, CANONICAL_PER_PX, CleanStroke, Orientation, PatchSketch, PixelFrame, Region};

/// Regions smaller than this are not listed, px^2.
const MIN_REGION_PX2: f64 = 0.1;

/// Chains of contour edges.
fn contour_chains(arrangement: &Arrangement) -> Vec<Vec<usize>> {
    let is_contour = |e: usize| arrangement.edges[e].kind == StrokeKind::Contour;
    let follow = |h: usize| {
        let branches: Vec<usize> =
            arrangement.leaving[arrangement.origin(h ^ 1)].iter().copied().filter(|&b| is_contour(b / 2)).collect();
        (branches.len() == 2).then(|| branches[usize::from(branches[0] == (h ^ 1))])
    };
    let mut used = vec![false; arrangement.edges.len()];
    let mut chains = vec![];
    for e in 0..arrangement.edges.len() {
        if !is_contour(e) || used[e] {
            continue;
        }
        let mut chain = vec![2 * e];
        used[e] = true;
        for _ in 0..2 {
            while let Some(next) = follow(chain[chain.len() - 1]) {
                if used[next / 2] {
                    break;
                }
                used[next / 2] = true;
                chain.push(next);
            }
            chain.reverse();
            chain.iter_mut().for_each(|h| *h ^= 1);
        }
        chains.push(chain);
    }
    chains
}

/// Points along consecutive half-edges.
fn chain_points(arrangement: &Arrangement, chain: &[usize]) -> Vec<Point> {
    let mut points: Vec<Point> = vec![];
    for &h in chain {
        points.pop();
        points.extend(arrangement.half_edge_points(h));
    }
    points
}

/// Collects everything in the canonical frame of the cleaned strokes.
pub(super) fn patch(
    frame: &PixelFrame,
    arrangement: &Arrangement,
    meaning: Meaning,
    features: Vec<Curve>,
) -> PatchSketch {
    let mut curves: Vec<Curve> = vec![];
    let add = |curves: &mut Vec<Curve>, chain: &[usize]| {
        let edges = chain.iter().map(|h| &arrangement.edges[h / 2]);
        let source = edges.clone().map(|e| e.source).min().unwrap_or(0);
        let kind = arrangement.edges[chain[0] / 2].kind;
        curves.push(Curve { kind, points: chain_points(arrangement, chain), source });
    };
    // Runs of the border with the same visibility.
    let kind = |h: usize| arrangement.edges[h / 2].kind;
    let mut border = meaning.border;
    let change = (0..border.len()).find(|&k| kind(border[k]) != kind(border[(k + border.len() - 1) % border.len()]));
    border.rotate_left(change.unwrap_or(0));
    for run in border.chunk_by(|&a, &b| kind(a) == kind(b)) {
        add(&mut curves, run);
    }
    for chain in contour_chains(arrangement) {
        add(&mut curves, &chain);
    }
    let structural = curves.iter().flat_map(|c| c.points.iter().map(|&p| frame.to_camera(p)));
    let canonical = CanonicalFrame::fitting(structural).unwrap_or(frame.frame);
    // Pixel to canonical by way of the camera would lose digits on canvases far from their origin.
    let scale = canonical.scale / frame.frame.scale * CANONICAL_PER_PX;
    let bounds = |k: usize| {
        let xs = curves.iter().flat_map(|c| c.points.iter().map(move |p| p[k]));
        xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let center = [0, 1].map(|k| 0.5 * (bounds(k).0 + bounds(k).1));
    let to_canonical = |p: Point| [0, 1].map(|k| (p[k] - center[k]) * scale);
    let convert = |points: &[Point]| -> Vec<Point> { points.iter().map(|&p| to_canonical(p)).collect() };

    let mut regions: Vec<Region> = (1..arrangement.faces.len())
        .map(|f| {
            let face = &arrangement.faces[f];
            let visible = meaning.visible[f];
            Region {
                rings: face.cycles.iter().map(|c| convert(&arrangement.ring(c))).collect(),
                visible,
                occluded: (meaning.layers[f] == 2).then(|| visible.flipped()),
                area: face.area * scale * scale,
            }
        })
        .collect();
    // Lines drawn exactly over each other may leave areas without extent.
    regions.retain(|r| r.area > MIN_REGION_PX2 * CANONICAL_PER_PX * CANONICAL_PER_PX);
    regions.sort_by(|a, b| b.area.total_cmp(&a.area));

    let mut loop_points: Vec<BorderPoint> = vec![];
    for &h in &border {
        let layer = if kind(h) == StrokeKind::OccludedBoundary { Layer::Occluded } else { Layer::Visible };
        let points = arrangement.half_edge_points(h);
        let [left, right] = [h, h ^ 1].map(|h| meaning.layers[arrangement.face_of[h]]);
        let side = if left > right { Orientation::Front } else { Orientation::Back };
        let point = |&p: &Point| BorderPoint { position: to_canonical(p), layer, side };
        loop_points.extend(points[..points.len() - 1].iter().map(point));
    }
    let lowest = (0..loop_points.len()).min_by(|&a, &b| {
        let (p, q) = (loop_points[a].position, loop_points[b].position);
        p[1].total_cmp(&q[1]).then(p[0].total_cmp(&q[0]))
    });
    loop_points.rotate_left(lowest.unwrap_or(0));

    curves.sort_by_key(|c| (c.kind, c.source));
    curves.extend(features);
    let strokes =
        curves.iter().map(|c| CleanStroke { kind: c.kind, points: convert(&c.points), source: c.source }).collect();
    PatchSketch { frame: canonical, view: *frame.view, strokes, regions, border: loop_points, depth_samples: vec![] }
}
