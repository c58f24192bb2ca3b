//! Half-edges around nodes, cycles, nested components.

use super::super::polyline::{Point, distance, inside, length, lerp, signed_area, sub};
use super::super::stroke::StrokeKind;
use super::{Arrangement, Edge, Face};
use std::collections::BTreeMap;

/// Orders the half-edges around the nodes, follows the cycles, and nests the components.
pub(super) fn faces(edges: Vec<Edge>, nodes: Vec<Point>) -> Arrangement {
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
                    && inside([&rings[c]], p)
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
pub(super) fn untangle(arrangement: &mut Arrangement) {
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
