//! The isolines of a seamless map at integers, as a subdivision of the parameter domain.

// Half-edges, corners and families are numbers that index several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::planar_map::{Course, NONE, Node, Place, PlanarMap};
use crate::field::{MAP_UNIT, SeamlessMap, Transition};
use std::cmp::Ordering;

/// A point where an isoline crosses an edge of the triangulation.
struct Crossing {
    /// 0 where a, 1 where b is an integer.
    family: u8,
    /// That integer, in the sheet of the edge's first triangle.
    value: i64,
    /// Place along the edge's first half-edge, in [0, 1].
    at: f64,
    half_edge: u32,
}

/// An isoline's way through one triangle, between two places on the triangle's outline.
struct Chord {
    value: i64,
    ends: [End; 2],
    /// Crossings with the other family: place on the outline of the other chord's end between this chord's ends, the node's
    /// arms towards this chord's ends, and the other chord's value.
    crossings: Vec<(u32, [u32; 2], i64)>,
}

/// A place on a triangle's outline where an isoline enters or leaves.
#[derive(Clone, Copy)]
struct End {
    place: u32,
    /// The other map coordinate there, in cells.
    other: f64,
    /// Arm of the node there; [`NONE`] until a singular vertex gets one.
    arm: u32,
    /// Corner of the triangle, for a singular vertex.
    corner: u8,
}

/// Cuts the domain along all isolines at integers.
///
/// Every isoline enters and leaves a triangle at places whose order on the triangle's outline is decided once per edge, with exact arithmetic; two
/// isolines cross in a triangle if and only if their ends alternate there. So the result is a subdivision whatever the map does, and where it
/// turns no triangle over the cells away from border and singularities are quads.
pub(crate) fn arrange(map: &SeamlessMap) -> PlanarMap {
    Arrangement::new(map).finish()
}

struct Arrangement<'a> {
    map: &'a SeamlessMap,
    crossings: Vec<Crossing>,
    /// Range of crossings of each half-edge that is the first of its edge.
    crossing_starts: Vec<u32>,
    nodes: Vec<Node>,
    /// For each node its arms, counter-clockwise; those of inner crossings of edges are 2 i and 2 i + 1.
    rotations: Vec<Vec<u32>>,
    arm_node: Vec<u32>,
    link: Vec<u32>,
    length: Vec<f64>,
    course: Vec<Course>,
    outer: Vec<bool>,
    /// For singular vertices: the node, else [`NONE`].
    singular_node: Vec<u32>,
    /// Place of each corner's triangle in the fan of its (singular) vertex.
    fan_place: Vec<u32>,
    /// Arms of singular nodes: (node, place in the fan, place on the triangle's outline seen from the vertex, arm).
    singular_arms: Vec<(u32, u32, u32, u32)>,
}

impl<'a> Arrangement<'a> {
    fn new(map: &'a SeamlessMap) -> Self {
        let mut arrangement = Self {
            map,
            crossings: vec![],
            crossing_starts: vec![0],
            nodes: vec![],
            rotations: vec![],
            arm_node: vec![],
            link: vec![],
            length: vec![],
            course: vec![],
            outer: vec![],
            singular_node: vec![NONE; map.mesh.points.len()],
            fan_place: vec![0; map.twin.len()],
            singular_arms: vec![],
        };
        arrangement.cross_edges();
        arrangement.place_singular_nodes();
        for t in 0..map.corners.len() {
            arrangement.cross_triangle(t);
        }
        arrangement.walk_border();
        arrangement
    }

    fn metric(&self, t: usize) -> [f64; 3] {
        let p = self.map.mesh.triangles[t].map(|v| self.map.mesh.parameters[v as usize]);
        let z = self.map.corners[t].map(|c| c.map(|x| x as f64 / MAP_UNIT as f64));
        let side = |q: &[[f64; 2]; 3], k: usize| [q[k][0] - q[0][0], q[k][1] - q[0][1]];
        let (p1, p2, z1, z2) = (side(&p, 1), side(&p, 2), side(&z, 1), side(&z, 2));
        let det = p1[0] * p2[1] - p1[1] * p2[0];
        // Columns of the Jacobian dz/d(u, v).
        let du = [0, 1].map(|i| (z1[i] * p2[1] - z2[i] * p1[1]) / det);
        let dv = [0, 1].map(|i| (z2[i] * p1[0] - z1[i] * p2[0]) / det);
        [du[0] * du[0] + du[1] * du[1], du[0] * dv[0] + du[1] * dv[1], dv[0] * dv[0] + dv[1] * dv[1]]
    }

    fn add_node(&mut self, parameter: [f64; 2], place: Place, metric: [f64; 3], arms: usize) -> (u32, u32) {
        let node = self.nodes.len() as u32;
        let first = self.link.len() as u32;
        self.nodes.push(Node { parameter, place, metric });
        self.rotations.push((first..first + arms as u32).collect());
        for _ in 0..arms {
            self.add_arm(node);
        }
        (node, first)
    }

    fn add_arm(&mut self, node: u32) -> u32 {
        self.arm_node.push(node);
        self.link.push(NONE);
        self.length.push(0.0);
        self.course.push(Course::Border);
        self.outer.push(false);
        self.link.len() as u32 - 1
    }

    fn join(&mut self, a: u32, b: u32, length: f64, course: Course) {
        for (x, y) in [(a, b), (b, a)] {
            self.link[x as usize] = y;
            self.length[x as usize] = length;
            self.course[x as usize] = course;
        }
    }

    /// Crossings of isolines with the edges: nodes 0, 1, ..., each with two arms, one for each side.
    fn cross_edges(&mut self) {
        let map = self.map;
        let mut found: Vec<(i128, i128, u8, i64)> = vec![];
        for h in 0..map.twin.len() {
            let (t, k) = (h / 3, h % 3);
            let other = map.twin[h];
            if other == NONE || h < other as usize {
                found.clear();
                let (p, q) = (map.corners[t][k], map.corners[t][(k + 1) % 3]);
                for family in 0..2 {
                    let (from, to) = (p[family], q[family]);
                    let (low, high) = (from.min(to), from.max(to));
                    let mut value = low.div_euclid(MAP_UNIT) + 1;
                    while value * MAP_UNIT < high {
                        let distance = i128::from((value * MAP_UNIT - from).abs());
                        found.push((distance, i128::from(high - low), family as u8, value));
                        value += 1;
                    }
                }
                // Exact order along the edge; a tie is decided here once for both triangles.
                found.sort_by(|x, y| (x.0 * y.1).cmp(&(y.0 * x.1)).then(x.2.cmp(&y.2)));
                let ends = [map.mesh.triangles[t][k], map.mesh.triangles[t][(k + 1) % 3]];
                let [a, b] = ends.map(|v| map.mesh.parameters[v as usize]);
                let mut metric = self.metric(t);
                if other != NONE && !found.is_empty() {
                    let there = self.metric(other as usize / 3);
                    metric = [0, 1, 2].map(|i| 0.5 * (metric[i] + there[i]));
                }
                for &(distance, span, family, value) in &found {
                    let at = distance as f64 / span as f64;
                    let parameter = [0, 1].map(|i| if a[i] == b[i] { a[i] } else { a[i] + (b[i] - a[i]) * at });
                    self.crossings.push(Crossing { family, value, at, half_edge: h as u32 });
                    self.add_node(parameter, Place::Inner, metric, 2);
                }
            }
            self.crossing_starts.push(self.crossings.len() as u32);
        }
    }

    fn place_singular_nodes(&mut self) {
        let map = self.map;
        for &v in &map.singular {
            let start = map.outgoing[v as usize];
            let metric = self.metric(start as usize / 3);
            let (node, _) = self.add_node(map.mesh.parameters[v as usize], Place::Singular, metric, 0);
            self.singular_node[v as usize] = node;
            let (mut h, mut place) = (start, 0);
            loop {
                self.fan_place[h as usize] = place;
                place += 1;
                h = map.twin[h as usize / 3 * 3 + (h as usize + 2) % 3];
                if h == start || h == NONE {
                    break;
                }
            }
        }
    }

    /// Links everything inside one triangle.
    fn cross_triangle(&mut self, t: usize) {
        let map = self.map;
        let corners = map.corners[t];
        let mut entries: Vec<(u8, i64, End)> = vec![];
        let mut place = 0u32;
        let mut corner_places = [0u32; 3];
        for k in 0..3 {
            corner_places[k] = place;
            if self.singular_node[map.mesh.triangles[t][k] as usize] != NONE {
                for family in 0..2 {
                    let other = corners[k][1 - family] as f64 / MAP_UNIT as f64;
                    let value = corners[k][family] / MAP_UNIT;
                    entries.push((family as u8, value, End { place, other, arm: NONE, corner: k as u8 }));
                }
            }
            place += 1;
            let h = 3 * t + k;
            let twin = map.twin[h];
            let own = twin == NONE || h < twin as usize;
            let first = if own { h } else { twin as usize };
            let range = self.crossing_starts[first]..self.crossing_starts[first + 1];
            let (p, q) = (corners[k], corners[(k + 1) % 3]);
            for step in 0..range.len() as u32 {
                let i = if own { range.start + step } else { range.end - 1 - step };
                let crossing = &self.crossings[i as usize];
                let (family, value, at) = if own {
                    (crossing.family, crossing.value, crossing.at)
                } else {
                    let (family, value) = carried(crossing.family, crossing.value, map.transitions[first]);
                    (family, value, 1.0 - crossing.at)
                };
                let other = 1 - family as usize;
                let other = (p[other] as f64 + (q[other] - p[other]) as f64 * at) / MAP_UNIT as f64;
                let arm = 2 * i + u32::from(!own);
                entries.push((family, value, End { place, other, arm, corner: 3 }));
                place += 1;
            }
        }
        if entries.len() < 2 {
            return;
        }
        entries.sort_by_key(|e| (e.0, e.1, e.2.place));
        let mut chords: [Vec<Chord>; 2] = [vec![], vec![]];
        let mut i = 0;
        while i + 1 < entries.len() {
            let (first, second) = (&entries[i], &entries[i + 1]);
            if (first.0, first.1) == (second.0, second.1) {
                let ends = [first.2, second.2];
                chords[first.0 as usize].push(Chord { value: first.1, ends, crossings: vec![] });
                i += 2;
            } else {
                i += 1;
            }
        }
        let parameters = map.mesh.triangles[t].map(|v| map.mesh.parameters[v as usize]);
        let metric = self.metric(t);
        let side = |k: usize| [0, 1].map(|i| i128::from(corners[k][i] - corners[0][i]));
        let (s1, s2) = (side(1), side(2));
        let det = s1[0] * s2[1] - s1[1] * s2[0];
        let [a_chords, b_chords] = &mut chords;
        for a in a_chords.iter_mut() {
            let [a0, a1] = a.ends.map(|e| e.place);
            for b in b_chords.iter_mut() {
                let [b0, b1] = b.ends.map(|e| e.place);
                let a_first = a0 < b0 && b0 < a1 && a1 < b1;
                let b_first = b0 < a0 && a0 < b1 && b1 < a1;
                if !a_first && !b_first {
                    continue;
                }
                let parameter = locate(&corners, det, &parameters, [a.value, b.value]);
                let (_, arm) = self.add_node(parameter, Place::Inner, metric, 4);
                // Arms point at the ends in the order of the ends on the outline, counter-clockwise.
                let (a_arms, b_arms) =
                    if a_first { ([arm, arm + 2], [arm + 1, arm + 3]) } else { ([arm + 1, arm + 3], [arm, arm + 2]) };
                a.crossings.push((if a_first { b0 } else { b1 }, a_arms, b.value));
                b.crossings.push((if a_first { a1 } else { a0 }, b_arms, a.value));
            }
        }
        let sign = match det.cmp(&0) {
            Ordering::Less => -1.0,
            _ => 1.0,
        };
        for family in 0..2 {
            // Isolines of a run along v of the combed field.
            let course = if family == 0 { Course::V } else { Course::U };
            for chord in &mut chords[family] {
                chord.crossings.sort_by_key(|c| c.0);
                let mut ends = chord.ends;
                for end in ends.iter_mut().filter(|e| e.corner < 3) {
                    let k = end.corner as usize;
                    let node = self.singular_node[map.mesh.triangles[t][k] as usize];
                    end.arm = self.add_arm(node);
                    let other_end = chord.ends.iter().map(|e| e.place).find(|&p| p != end.place).unwrap_or(0);
                    let seen = (other_end + place - corner_places[k]) % place;
                    self.singular_arms.push((node, self.fan_place[3 * t + k], seen, end.arm));
                }
                let mut last = (ends[0].arm, ends[0].other);
                for &(_, arms, value) in &chord.crossings {
                    let value = value as f64;
                    self.join(last.0, arms[0], sign * (value - last.1).abs(), course);
                    last = (arms[1], value);
                }
                self.join(last.0, ends[1].arm, sign * (ends[1].other - last.1).abs(), course);
            }
        }
    }

    /// Links the crossings and corners on the border, and gives all nodes their rotations.
    fn walk_border(&mut self) {
        let map = self.map;
        let [nu, nv] = map.mesh.cells;
        let vertex = |i: usize, j: usize| (i * (nv + 1) + j) as u32;
        let patch_corners = [vertex(0, 0), vertex(nu, 0), vertex(nu, nv), vertex(0, nv)];
        let start = patch_corners[0];
        let mut v = start;
        let mut side = 0u8;
        // (arm forward, arm backward, node) along the border.
        let mut loop_arms: Vec<(u32, u32, u32)> = vec![];
        loop {
            let h = map.outgoing[v as usize] as usize;
            if let Some(corner) = patch_corners.iter().position(|&c| c == v) {
                side = corner as u8;
                let metric = self.metric(h / 3);
                let (node, arm) = self.add_node(map.mesh.parameters[v as usize], Place::Corner(side), metric, 2);
                loop_arms.push((arm, arm + 1, node));
            }
            for node in self.crossing_starts[h]..self.crossing_starts[h + 1] {
                debug_assert_eq!(self.crossings[node as usize].half_edge as usize, h);
                let (forward, backward) = (self.add_arm(node), self.add_arm(node));
                self.nodes[node as usize].place = Place::Border(side);
                self.rotations[node as usize] = vec![forward, 2 * node, backward];
                loop_arms.push((forward, backward, node));
            }
            v = map.mesh.triangles[h / 3][(h % 3 + 1) % 3];
            if v == start {
                break;
            }
        }
        for i in 0..loop_arms.len() {
            let (here, there) = (loop_arms[i], loop_arms[(i + 1) % loop_arms.len()]);
            self.join(here.0, there.1, f64::INFINITY, Course::Border);
            self.outer[there.1 as usize] = true;
        }
        self.singular_arms.sort_unstable();
        for &(node, _, _, arm) in &self.singular_arms {
            self.rotations[node as usize].push(arm);
        }
    }

    /// Drops the nodes where isolines merely pass an edge, and everything that is not connected with the border.
    fn finish(self) -> PlanarMap {
        let passing =
            |node: u32| (node as usize) < self.crossings.len() && self.nodes[node as usize].place == Place::Inner;
        let arms = self.link.len();
        let mut twin = vec![NONE; arms];
        let mut traced = vec![0.0; arms];
        for arm in 0..arms as u32 {
            if passing(self.arm_node[arm as usize]) {
                continue;
            }
            let (mut at, mut length) = (arm, 0.0);
            let end = loop {
                let next = self.link[at as usize];
                if next == NONE {
                    break NONE;
                }
                length += self.length[at as usize];
                if !passing(self.arm_node[next as usize]) {
                    break next;
                }
                at = next ^ 1;
            };
            twin[arm as usize] = end;
            traced[arm as usize] = length;
        }
        // Reached from the border.
        let mut reached = vec![false; self.nodes.len()];
        let mut stack: Vec<u32> = (0..self.nodes.len() as u32)
            .filter(|&n| matches!(self.nodes[n as usize].place, Place::Corner(_)))
            .collect();
        while let Some(node) = stack.pop() {
            if std::mem::replace(&mut reached[node as usize], true) {
                continue;
            }
            for &arm in &self.rotations[node as usize] {
                if twin[arm as usize] != NONE {
                    stack.push(self.arm_node[twin[arm as usize] as usize]);
                }
            }
        }
        let mut node_number = vec![NONE; self.nodes.len()];
        let mut arm_number = vec![NONE; arms];
        let mut result = PlanarMap::default();
        let mut kept_arms = vec![];
        for node in 0..self.nodes.len() {
            if !reached[node] || passing(node as u32) {
                continue;
            }
            node_number[node] = result.nodes.len() as u32;
            result.nodes.push(self.nodes[node]);
            result.first.push(NONE);
            for &arm in self.rotations[node].iter().filter(|&&a| twin[a as usize] != NONE) {
                arm_number[arm as usize] = kept_arms.len() as u32;
                kept_arms.push(arm);
            }
        }
        for &arm in &kept_arms {
            let node = node_number[self.arm_node[arm as usize] as usize];
            result.origin.push(node);
            result.twin.push(arm_number[twin[arm as usize] as usize]);
            result.outer.push(self.outer[arm as usize]);
            result.course.push(self.course[arm as usize]);
            result.traced.push(traced[arm as usize]);
            result.alive.push(true);
        }
        result.ccw = vec![NONE; kept_arms.len()];
        result.cw = vec![NONE; kept_arms.len()];
        let mut i = 0;
        while i < kept_arms.len() {
            let node = result.origin[i];
            let count = result.origin[i..].iter().take_while(|&&o| o == node).count();
            result.first[node as usize] = i as u32;
            for k in 0..count {
                let next = (i + (k + 1) % count) as u32;
                result.ccw[i + k] = next;
                result.cw[next as usize] = (i + k) as u32;
            }
            i += count;
        }
        result
    }
}

/// The isoline `value` of `family` in the sheet beyond a transition z -> i^turn z + shift.
fn carried(family: u8, value: i64, transition: Transition) -> (u8, i64) {
    let [x, y] = transition.shift;
    match (family, transition.turn % 4) {
        (0, 0) => (0, value + x),
        (0, 1) => (1, value + y),
        (0, 2) => (0, -value + x),
        (0, _) => (1, -value + y),
        (_, 0) => (1, value + y),
        (_, 1) => (0, -value + x),
        (_, 2) => (1, -value + y),
        (_, _) => (0, value + x),
    }
}

/// Parameter of the map point `value` in a triangle, moved into the triangle if rounding put it outside.
fn locate(corners: &[[i64; 2]; 3], det: i128, parameters: &[[f64; 2]; 3], value: [i64; 2]) -> [f64; 2] {
    let mut weights = [1.0 / 3.0; 3];
    if det != 0 {
        let d = |k: usize| [0, 1].map(|i| i128::from(corners[k][i] - value[i] * MAP_UNIT));
        for (k, weight) in weights.iter_mut().enumerate() {
            let (p, q) = (d((k + 1) % 3), d((k + 2) % 3));
            *weight = ((p[0] * q[1] - p[1] * q[0]) as f64 / det as f64).clamp(0.0, 1.0);
        }
        let sum: f64 = weights.iter().sum();
        weights = weights.map(|w| w / sum);
    }
    [0, 1].map(|i| (0..3).map(|k| weights[k] * parameters[k][i]).sum())
}
