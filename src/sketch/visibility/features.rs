//! Feature lines on the visible surface.

use super::super::arrange::{Arrangement, Curve};
use super::super::polyline::{Point, SegmentGrid, inside, length, lerp, meet, middle};
use super::super::stroke::StrokeKind;

/// Pieces of feature lines shorter than this say nothing, px.
pub(super) const MIN_FEATURE_PX: f64 = 4.0;
/// Features are cut off this far from the origin before anything is computed, px.
const FEATURE_BOX_PX: f64 = 140.0;

/// The parts of a polyline inside the box in which features can matter.
pub(super) fn clip_to_box(points: impl Iterator<Item = Point>) -> Vec<Vec<Point>> {
    let mut parts: Vec<Vec<Point>> = vec![];
    let mut previous: Option<Point> = None;
    let mut open = false;
    for p in points {
        if let Some(q) = previous {
            let mut range = (0.0f64, 1.0f64);
            for k in 0..2 {
                let d = p[k] - q[k];
                if d == 0.0 {
                    if q[k].abs() > FEATURE_BOX_PX {
                        range.1 = -1.0;
                    }
                    continue;
                }
                let (a, b) = ((-FEATURE_BOX_PX - q[k]) / d, (FEATURE_BOX_PX - q[k]) / d);
                range = (range.0.max(a.min(b)), range.1.min(a.max(b)));
            }
            if range.0 < range.1 {
                if !open || range.0 > 0.0 {
                    parts.push(vec![lerp(q, p, range.0)]);
                }
                let part = parts.last_mut().expect("a part was opened");
                part.push(lerp(q, p, range.1));
                open = range.1 >= 1.0;
            } else {
                open = false;
            }
        }
        previous = Some(p);
    }
    parts
}

/// The parts of the features on the visible surface, split where they pass from one sheet to another.
pub(super) fn clip_features(arrangement: &Arrangement, features: &[Curve]) -> Vec<Curve> {
    let mut segments = vec![];
    for (e, edge) in arrangement.edges.iter().enumerate() {
        let outside = arrangement.face_of[2 * e] == 0 || arrangement.face_of[2 * e + 1] == 0;
        // Behind an occluded boundary the visible sheet goes on.
        if outside || edge.kind == StrokeKind::VisibleBoundary {
            segments.extend(edge.points.windows(2).map(|w| [w[0], w[1]]));
        }
    }
    let grid = SegmentGrid::new(&segments, 4.0);
    let rings: Vec<Vec<Point>> = arrangement.faces[0].cycles.iter().map(|c| arrangement.ring(c)).collect();
    let mut found = vec![];
    let mut result = vec![];
    for feature in features {
        let mut parts = vec![vec![feature.points[0]]];
        for w in feature.points.windows(2) {
            grid.near(&[w[0], w[1]], &mut found);
            let mut cuts: Vec<f64> =
                found.iter().filter_map(|&s| meet([w[0], w[1]], segments[s as usize]).map(|(t, _)| t)).collect();
            cuts.sort_by(f64::total_cmp);
            for t in cuts {
                let p = lerp(w[0], w[1], t);
                parts.last_mut().expect("there is an open part").push(p);
                parts.push(vec![p]);
            }
            parts.last_mut().expect("there is an open part").push(w[1]);
        }
        for points in parts {
            if points.len() > 1 && length(&points) >= MIN_FEATURE_PX && inside(&rings, middle(&points)) {
                result.push(Curve { kind: feature.kind, points, source: feature.source });
            }
        }
    }
    result
}
