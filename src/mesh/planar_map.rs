//! A subdivision of the parameter domain into cells, and the local operations that keep it one.

/// Stands for a missing half-edge.
pub(crate) const NONE: u32 = u32::MAX;

/// Where a node of the subdivision lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Place {
    /// Where two isolines cross.
    Inner,
    /// On a singular vertex of the field.
    Singular,
    /// On this side of the patch (v = min, u = max, v = max, u = min).
    Border(u8),
    /// At this corner of the patch, the start of the side of that number.
    Corner(u8),
}

impl Place {
    pub fn on_border(self) -> bool {
        matches!(self, Place::Border(_) | Place::Corner(_))
    }
}

/// A node with its place in the parameter domain, and the metric of the map there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub parameter: [f64; 2],
    pub place: Place,
    /// (E, F, G): squared map lengths, in cells, of parameter steps. The same in every sheet of the map.
    pub metric: [f64; 3],
}

/// What a half-edge runs along.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Course {
    /// Along u of the combed field.
    U,
    /// Along v of the combed field.
    V,
    /// Along the patch's border.
    Border,
    /// Across a cell at the border, along nothing.
    Cut,
}

/// Half-edges around nodes. A face lies to the left of its half-edges; the outside counts as one.
///
/// The rotation of half-edges around each node is all there is, so that whatever is removed or contracted, the result is a subdivision of
/// the same domain: no holes, no overlaps.
#[derive(Clone, Debug, Default)]
pub(crate) struct PlanarMap {
    pub nodes: Vec<Node>,
    /// Some half-edge of each node, [`NONE`] when it has none.
    pub first: Vec<u32>,
    pub origin: Vec<u32>,
    pub twin: Vec<u32>,
    /// Next and previous half-edge counter-clockwise around the origin.
    pub ccw: Vec<u32>,
    pub cw: Vec<u32>,
    /// The outside lies to the left.
    pub outer: Vec<bool>,
    pub course: Vec<Course>,
    /// Signed length in the map as traced, in cells.
    pub traced: Vec<f64>,
    pub alive: Vec<bool>,
}

impl PlanarMap {
    /// Node at the end of `h`.
    pub fn end(&self, h: u32) -> u32 {
        self.origin[self.twin[h as usize] as usize]
    }

    /// Next half-edge along the face to the left of `h`.
    pub fn next(&self, h: u32) -> u32 {
        self.cw[self.twin[h as usize] as usize]
    }

    /// Half-edges of the face to the left of `h`, from `h` on.
    pub fn face(&self, h: u32) -> impl Iterator<Item = u32> + '_ {
        let mut next = Some(h);
        std::iter::from_fn(move || {
            let current = next?;
            let following = self.next(current);
            next = (following != h).then_some(following);
            Some(current)
        })
    }

    /// Half-edges that leave `node`, counter-clockwise.
    pub fn arms(&self, node: u32) -> impl Iterator<Item = u32> + '_ {
        let start = self.first[node as usize];
        let mut next = (start != NONE).then_some(start);
        std::iter::from_fn(move || {
            let current = next?;
            let following = self.ccw[current as usize];
            next = (following != start).then_some(following);
            Some(current)
        })
    }

    pub fn degree(&self, node: u32) -> usize {
        self.arms(node).count()
    }

    /// Whether `h` or its other side has the outside on its left.
    pub fn is_border(&self, h: u32) -> bool {
        self.outer[h as usize] || self.outer[self.twin[h as usize] as usize]
    }

    /// One half-edge of every face but the outside, in order.
    pub fn faces(&self) -> Vec<u32> {
        let mut seen = vec![false; self.origin.len()];
        let mut faces = vec![];
        for h in 0..self.origin.len() as u32 {
            if !self.alive[h as usize] || seen[h as usize] {
                continue;
            }
            self.face(h).for_each(|g| seen[g as usize] = true);
            if !self.outer[h as usize] {
                faces.push(h);
            }
        }
        faces
    }

    /// Length in cells of the straight step between two nodes.
    pub fn distance(&self, p: u32, q: u32) -> f64 {
        let (p, q) = (&self.nodes[p as usize], &self.nodes[q as usize]);
        let d = [q.parameter[0] - p.parameter[0], q.parameter[1] - p.parameter[1]];
        let m = [0, 1, 2].map(|i| 0.5 * (p.metric[i] + q.metric[i]));
        (m[0] * d[0] * d[0] + 2.0 * m[1] * d[0] * d[1] + m[2] * d[1] * d[1]).max(0.0).sqrt()
    }

    /// Signed area, in cells, of the face left of `h`, with `moved.0` at another parameter.
    pub fn area_with(&self, h: u32, moved: Option<(u32, [f64; 2])>) -> f64 {
        let (mut sum, mut density, mut count) = (0.0, 0.0, 0.0);
        let at = |node: u32| match moved {
            Some((m, parameter)) if m == node => parameter,
            _ => self.nodes[node as usize].parameter,
        };
        let o = at(self.origin[h as usize]);
        for g in self.face(h) {
            let (p, q) = (at(self.origin[g as usize]), at(self.end(g)));
            sum += (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
            let m = self.nodes[self.origin[g as usize] as usize].metric;
            density += (m[0] * m[2] - m[1] * m[1]).max(0.0).sqrt();
            count += 1.0;
        }
        0.5 * sum * density / count
    }

    /// Signed area, in cells, of the face left of `h`.
    pub fn area(&self, h: u32) -> f64 {
        self.area_with(h, None)
    }

    fn unlink(&mut self, h: u32) {
        let node = self.origin[h as usize] as usize;
        let (before, after) = (self.cw[h as usize], self.ccw[h as usize]);
        if after == h {
            self.first[node] = NONE;
        } else {
            self.ccw[before as usize] = after;
            self.cw[after as usize] = before;
            if self.first[node] == h {
                self.first[node] = after;
            }
        }
        self.alive[h as usize] = false;
    }

    /// Removes an edge: the faces on its two sides become one. If one of them is the outside, so is the result.
    pub fn remove(&mut self, h: u32) {
        let t = self.twin[h as usize];
        if self.outer[h as usize] != self.outer[t as usize] {
            let inner = if self.outer[h as usize] { t } else { h };
            let face: Vec<u32> = self.face(inner).collect();
            for g in face {
                self.outer[g as usize] = true;
            }
        }
        self.unlink(h);
        self.unlink(t);
    }

    /// Whether [`PlanarMap::contract`] of `h` keeps every face a simple polygon and the border a simple loop.
    pub fn can_contract(&self, h: u32) -> bool {
        let t = self.twin[h as usize];
        let (u, v) = (self.origin[h as usize], self.origin[t as usize]);
        if u == v {
            return false;
        }
        let (left, right): (Vec<u32>, Vec<u32>) = (self.face(h).collect(), self.face(t).collect());
        // The two faces beside the edge meet each end once.
        for side in [&left, &right] {
            for node in [u, v] {
                if side.iter().filter(|&&g| self.origin[g as usize] == node).count() != 1 {
                    return false;
                }
            }
        }
        if [(h, &left), (t, &right)].iter().any(|(g, side)| self.outer[*g as usize] && side.len() <= 3) {
            return false;
        }
        // No other face may hold both ends,
        for arm in self.arms(u) {
            if left.contains(&arm) || right.contains(&arm) {
                continue;
            }
            if self.face(arm).any(|g| self.origin[g as usize] == v) {
                return false;
            }
        }
        // and no third node may be a neighbour of both, except in a triangle beside the edge.
        let mut shared = 0;
        for arm in self.arms(u).filter(|&a| a != h) {
            let w = self.end(arm);
            shared += self.arms(v).filter(|&b| b != t && self.end(b) == w).count();
        }
        let triangles =
            [(h, &left), (t, &right)].iter().filter(|(g, side)| side.len() == 3 && !self.outer[*g as usize]).count();
        shared == triangles
    }

    /// Contracts an edge: its end joins its origin, and triangles beside it collapse to single edges.
    ///
    /// The caller has asked [`PlanarMap::can_contract`], and sets the joint node's place afterwards.
    pub fn contract(&mut self, h: u32) {
        let t = self.twin[h as usize];
        let (u, v) = (self.origin[h as usize], self.origin[t as usize]);
        let beside = [self.next(h), self.next(t)];
        let moved: Vec<u32> = self.arms(v).filter(|&g| g != t).collect();
        for &g in &moved {
            self.origin[g as usize] = u;
        }
        let (x, y) = (self.cw[h as usize], self.ccw[h as usize]);
        let (p, q) = (self.cw[t as usize], self.ccw[t as usize]);
        if q == t {
            self.unlink(h);
        } else if y == h {
            self.first[u as usize] = q;
            self.ccw[p as usize] = q;
            self.cw[q as usize] = p;
        } else {
            // In the rotation around u, the half-edges of v take the place of h.
            self.ccw[x as usize] = q;
            self.cw[q as usize] = x;
            self.ccw[p as usize] = y;
            self.cw[y as usize] = p;
            self.first[u as usize] = x;
        }
        self.alive[h as usize] = false;
        self.alive[t as usize] = false;
        self.first[v as usize] = NONE;
        for g in beside {
            if self.alive[g as usize] && !self.outer[g as usize] {
                self.drop_two_gon(g);
            }
        }
    }

    /// If the face left of `h` has two edges, removes one of them, never one on the border.
    pub fn drop_two_gon(&mut self, h: u32) -> bool {
        let g = self.next(h);
        if g == h || self.next(g) != h || g == self.twin[h as usize] {
            return false;
        }
        let Some(&which) = [h, g].iter().find(|&&e| !self.outer[self.twin[e as usize] as usize]) else { return false };
        self.remove(which);
        true
    }

    /// Puts a node onto an edge; `h` ends there now. Returns the half-edge from there to where `h` ended.
    pub fn subdivide(&mut self, h: u32, node: Node) -> u32 {
        let t = self.twin[h as usize];
        let number = self.nodes.len() as u32;
        let [onward, back] = [0, 1].map(|k| self.origin.len() as u32 + k);
        self.nodes.push(node);
        self.first.push(onward);
        for (twin, like) in [(t, h), (h, t)] {
            let half = 0.5 * self.traced[like as usize];
            self.traced[like as usize] = half;
            self.origin.push(number);
            self.twin.push(twin);
            self.outer.push(self.outer[like as usize]);
            self.course.push(self.course[like as usize]);
            self.traced.push(half);
            self.alive.push(true);
        }
        self.ccw.extend([back, onward]);
        self.cw.extend([back, onward]);
        self.twin[t as usize] = onward;
        self.twin[h as usize] = back;
        onward
    }

    /// Cuts a face in two by an edge between the origins of two of its half-edges. Returns the new half-edge that leaves the origin of `h`; the
    /// face of `h` is to the left of the other one.
    pub fn divide(&mut self, h: u32, g: u32) -> u32 {
        let [there, back] = [0, 1].map(|k| self.origin.len() as u32 + k);
        for (half, before, twin) in [(there, h, back), (back, g, there)] {
            let after = self.ccw[before as usize];
            self.origin.push(self.origin[before as usize]);
            self.twin.push(twin);
            self.outer.push(false);
            self.course.push(Course::Cut);
            self.traced.push(1.0);
            self.alive.push(true);
            self.ccw.push(after);
            self.cw.push(before);
            self.ccw[before as usize] = half;
            self.cw[after as usize] = half;
        }
        there
    }

    /// Joins the two edges at a node of degree two, unless a face would be left with fewer than three.
    pub fn dissolve(&mut self, node: u32) -> bool {
        let arms: Vec<u32> = self.arms(node).collect();
        let &[a, b] = arms.as_slice() else { return false };
        let (ta, tb) = (self.twin[a as usize], self.twin[b as usize]);
        if a == tb || self.end(a) == self.end(b) {
            return false;
        }
        if [a, b].iter().any(|&h| !self.outer[h as usize] && self.face(h).count() <= 3) {
            return false;
        }
        // The far halves stay and become each other's other side.
        self.twin[ta as usize] = tb;
        self.twin[tb as usize] = ta;
        let length = self.traced[ta as usize] + self.traced[b as usize];
        self.traced[ta as usize] = length;
        self.traced[tb as usize] = length;
        self.alive[a as usize] = false;
        self.alive[b as usize] = false;
        self.first[node as usize] = NONE;
        true
    }
}
