//! Combing: the field's four directions named consistently on the surface cut open along seams, and what happens to map
//! coordinates across a seam.

// Half-edges, corners and families are numbers that index several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::conjugate_field::ConjugateField;
use super::topology::NO_TRIANGLE;
use super::visit::Visit;
use std::collections::BinaryHeap;

/// Stands for a missing half-edge.
pub(crate) const NONE: u32 = u32::MAX;

/// A Gaussian integer x + iy: a map translation, or a coefficient of one.
pub(crate) type Gauss = [i64; 2];

/// i^k z
pub(crate) fn turned(z: Gauss, k: u8) -> Gauss {
    match k % 4 {
        0 => z,
        1 => [-z[1], z[0]],
        2 => [-z[0], -z[1]],
        _ => [z[1], -z[0]],
    }
}

/// Sum of Gaussian coefficients times the map positions of singularities; sorted by singularity.
pub(crate) type Translation = Vec<(u32, Gauss)>;

/// `to` += i^k `from`
fn add_turned(to: &mut Translation, from: &Translation, k: u8) {
    for &(s, c) in from {
        let c = turned(c, k);
        match to.binary_search_by_key(&s, |e| e.0) {
            Ok(i) => {
                to[i].1 = [to[i].1[0] + c[0], to[i].1[1] + c[1]];
                if to[i].1 == [0, 0] {
                    to.remove(i);
                }
            }
            Err(i) => to.insert(i, (s, c)),
        }
    }
}

/// A field combed on its surface cut open along seams, a forest of edge paths from the singularities to the border.
///
/// Half-edge 3 t + k runs from corner k of triangle t to corner k + 1. The map coordinate z = a + ib grows by its real part along
/// direction `name[t]` of triangle t, and by its imaginary part along the next direction. Across half-edge h of triangle t,
/// whose other side is triangle s, z_s = i^`turn[h]` z_t + T(h); both are trivial off the seams. T is determined by the
/// positions p of the singularities, since crossing all seams around a singularity must leave it where it is; so the p are all the
/// freedom that seams have, and seamlessness needs no constraint.
#[derive(Clone, Debug)]
pub(crate) struct Seams {
    /// Half-edge on the other side, [`NONE`] on the border.
    pub twin: Vec<u32>,
    /// For each vertex, the first half-edge that leaves it, counter-clockwise; on the border the one that has no twin.
    pub outgoing: Vec<u32>,
    /// For each triangle the direction (0 to 3 of u, v, -u, -v) that the real part follows.
    pub name: Vec<u8>,
    /// Quarter turns across each half-edge.
    pub turn: Vec<u8>,
    /// For each half-edge, its translation's place in `translations`; 0 is none.
    pub translation: Vec<u32>,
    /// Translations as sums over singularities.
    pub translations: Vec<Translation>,
    /// Singular vertices, in the order that translations count them.
    pub singular: Vec<u32>,
    /// For each corner 3 t + k of vertex w: z = i^r z_w + T with this (r, place in `translations`).
    pub corner: Vec<(u8, u32)>,
}

impl Seams {
    /// Cuts and combs `field`; opposite singularities closer than `pair`, or on one edge, cancel unless `pair` is 0, and those closer than `rim`
    /// to a border that the field does not follow leave over it.
    pub fn new(field: &ConjugateField, pair: f64, rim: f64) -> Self {
        let triangles = &field.mesh.triangles;
        let count = triangles.len();
        let vertex_count = field.mesh.points.len();
        let mut twin = vec![NONE; 3 * count];
        let mut outgoing = vec![NONE; vertex_count];
        let mut matching = vec![0u8; 3 * count];
        let edges = &field.edges;
        let mut first_side = vec![NONE; edges.len()];
        for t in 0..count {
            for k in 0..3 {
                let h = 3 * t + k;
                let e = edges.triangle_edges[t][k] as usize;
                matching[h] = match edges.triangles[e] {
                    [_, NO_TRIANGLE] => 0,
                    [f, _] if f as usize == t => field.matching[e],
                    _ => (4 - field.matching[e]) % 4,
                };
                if first_side[e] == NONE {
                    first_side[e] = h as u32;
                } else {
                    twin[h] = first_side[e];
                    twin[first_side[e] as usize] = h as u32;
                }
            }
        }
        for t in 0..count {
            for k in 0..3 {
                let (h, v) = (3 * t + k, triangles[t][k] as usize);
                if outgoing[v] == NONE || twin[h] == NONE {
                    outgoing[v] = h as u32;
                }
            }
        }
        let mut seams = Self {
            twin,
            outgoing,
            name: vec![0; count],
            turn: matching,
            translation: vec![0; 3 * count],
            translations: vec![vec![]],
            singular: vec![],
            corner: vec![(0, 0); 3 * count],
        };
        let mut border = vec![false; vertex_count];
        for v in 0..vertex_count {
            let start = seams.outgoing[v];
            border[v] = start == NONE || seams.twin[start as usize] == NONE;
        }
        let followed = super::border::followed(&field.mesh, edges, &field.aligned_sides);
        let on_followed = |v: usize| followed.contains_key(&(v as u32)) && border[v];
        let held: Vec<bool> = (0..vertex_count).map(on_followed).collect();
        seams.cancel(field, &border, &held, pair, rim);
        for v in (0..vertex_count).filter(|&v| !border[v]) {
            if seams.turns_around(v) != 0 {
                seams.singular.push(v as u32);
            }
        }
        let (order, parent) = seams.cut(field, &border);
        let mut cut = vec![false; 3 * count];
        for &h in parent.iter().filter(|&&h| h != NONE) {
            cut[h as usize] = true;
            cut[seams.twin[h as usize] as usize] = true;
        }
        seams.comb(&cut);
        seams.translate(&order, &parent, &cut, vertex_count);
        seams
    }

    /// Half-edges that leave vertex `v`, counter-clockwise.
    pub fn fan(&self, v: usize) -> impl Iterator<Item = usize> + '_ {
        let start = self.outgoing[v];
        let mut next = start;
        std::iter::from_fn(move || {
            let h = next;
            if h == NONE {
                return None;
            }
            next = self.twin[previous(h as usize)];
            if next == start {
                next = NONE;
            }
            Some(h as usize)
        })
    }

    /// Quarter turns of the matching around an inner vertex, 0 to 3.
    fn turns_around(&self, v: usize) -> u8 {
        (self.fan(v).map(|h| u32::from(self.turn[previous(h)])).sum::<u32>() % 4) as u8
    }

    /// Takes out singularities that no grid of this size can resolve, by turning the matching along the path between two of opposite
    /// index, or from one to the border where that is not `held` by the field.
    fn cancel(&mut self, field: &ConjugateField, border: &[bool], held: &[bool], pair: f64, rim: f64) {
        let singular: Vec<u32> =
            (0..border.len() as u32).filter(|&v| !border[v as usize] && self.turns_around(v as usize) != 0).collect();
        let origin = |h: u32| field.mesh.triangles[h as usize / 3][h as usize % 3];
        // (path length, start, end, half-edges from the end back to the start)
        let mut paths: Vec<(f64, u32, u32, Vec<u32>)> = vec![];
        let mut distance = vec![f64::INFINITY; border.len()];
        let mut towards = vec![NONE; border.len()];
        for &s in &singular {
            let mut queue = BinaryHeap::from([Visit { distance: 0.0, index: s }]);
            let mut touched = vec![s];
            distance[s as usize] = 0.0;
            while let Some(Visit { distance: d, index: v }) = queue.pop() {
                if d > distance[v as usize] {
                    continue;
                }
                let on_edge = pair > 0.0 && towards[v as usize] != NONE && origin(towards[v as usize]) == s;
                let ends_here = (border[v as usize] && !held[v as usize] && d < rim)
                    || (v > s && (d < pair || on_edge) && singular.contains(&v));
                if ends_here {
                    let (mut path, mut w) = (vec![], v);
                    while w != s {
                        let h = towards[w as usize];
                        path.push(h);
                        w = origin(h);
                    }
                    paths.push((d, s, v, path));
                }
                if border[v as usize] {
                    continue;
                }
                for h in self.fan(v as usize) {
                    let w = field.mesh.triangles[h / 3][(h + 1) % 3];
                    let further = d + (field.mesh.position(v) - field.mesh.position(w)).norm();
                    let near = further < pair.max(rim) || (v == s && pair > 0.0);
                    if further < distance[w as usize] && near {
                        distance[w as usize] = further;
                        towards[w as usize] = h as u32;
                        touched.push(w);
                        queue.push(Visit { distance: further, index: w });
                    }
                }
            }
            for v in touched {
                distance[v as usize] = f64::INFINITY;
                towards[v as usize] = NONE;
            }
        }
        paths.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        for (_, s, end, path) in paths {
            let turns = self.turns_around(s as usize);
            let opposite = border[end as usize] || (turns + self.turns_around(end as usize)).is_multiple_of(4);
            if turns == 0 || !opposite {
                continue;
            }
            // Around the end of h the step over h adds what is added to its turn, around its origin it takes that away.
            for h in path {
                let other = self.twin[h as usize] as usize;
                self.turn[h as usize] = (self.turn[h as usize] + turns) % 4;
                self.turn[other] = (self.turn[other] + 4 - turns) % 4;
            }
        }
    }

    /// Shortest paths over edges from the singularities to the border or an earlier path. Returns the vertices on paths, children
    /// before parents, and for each vertex on a path the half-edge towards its parent.
    fn cut(&self, field: &ConjugateField, border: &[bool]) -> (Vec<u32>, Vec<u32>) {
        let count = border.len();
        let mut parent = vec![NONE; count];
        if self.singular.is_empty() {
            return (vec![], parent);
        }
        // One shortest-path tree from the border: paths of different singularities join and never cross.
        let mut distance = vec![f64::INFINITY; count];
        let mut towards = vec![NONE; count];
        let mut queue = BinaryHeap::new();
        for v in (0..count).filter(|&v| border[v]) {
            distance[v] = 0.0;
            queue.push(Visit { distance: 0.0, index: v as u32 });
        }
        let mut settled = vec![];
        let mut done = vec![false; count];
        while let Some(Visit { distance: d, index: v }) = queue.pop() {
            if std::mem::replace(&mut done[v as usize], true) {
                continue;
            }
            settled.push(v);
            for h in self.fan(v as usize) {
                let w = field.mesh.triangles[h / 3][(h + 1) % 3];
                let further = d + (field.mesh.position(v) - field.mesh.position(w)).norm();
                if self.twin[h] != NONE && further < distance[w as usize] {
                    distance[w as usize] = further;
                    towards[w as usize] = self.twin[h];
                    queue.push(Visit { distance: further, index: w });
                }
            }
        }
        for &s in &self.singular {
            let mut v = s as usize;
            while towards[v] != NONE && parent[v] == NONE {
                parent[v] = towards[v];
                v = field.mesh.triangles[towards[v] as usize / 3][(towards[v] as usize + 1) % 3] as usize;
            }
        }
        // A child is farther from the border than its parent, so it was settled later.
        settled.reverse();
        settled.retain(|&v| parent[v as usize] != NONE);
        (settled, parent)
    }

    /// Names the directions so that nothing turns except across `cut` half-edges.
    fn comb(&mut self, cut: &[bool]) {
        let count = self.name.len();
        let mut seen = vec![false; count];
        let mut queue = std::collections::VecDeque::new();
        for seed in 0..count {
            if std::mem::replace(&mut seen[seed], true) {
                continue;
            }
            queue.push_back(seed);
            while let Some(t) = queue.pop_front() {
                for h in 3 * t..3 * t + 3 {
                    let other = self.twin[h];
                    if other == NONE || cut[h] {
                        continue;
                    }
                    let s = other as usize / 3;
                    if !std::mem::replace(&mut seen[s], true) {
                        self.name[s] = (self.name[t] + self.turn[h]) % 4;
                        queue.push_back(s);
                    }
                }
            }
        }
        for h in 0..3 * count {
            let other = self.twin[h];
            if other != NONE {
                self.turn[h] = (self.name[h / 3] + self.turn[h] + 4 - self.name[other as usize / 3]) % 4;
            }
        }
    }

    /// Finds the translations of all seams, from the leaves of the cut forest to its roots, and the coordinates of all corners.
    fn translate(&mut self, order: &[u32], parent: &[u32], cut: &[bool], vertex_count: usize) {
        let mut singularity = vec![NONE; vertex_count];
        for (i, &v) in self.singular.iter().enumerate() {
            singularity[v as usize] = i as u32;
        }
        let on_cut = |v: usize| parent[v] != NONE;
        for &v in order {
            let start = parent[v as usize] as usize;
            let mut h = start;
            let (mut r, mut sum) = (0u8, Translation::new());
            loop {
                self.set_corner(h, r, &sum);
                let back = previous(h);
                let forward = self.twin[back] as usize;
                if forward == start {
                    // z_c = i^k (i^r z_c + sum) + T where z_c is free, or the singularity's own position.
                    let k = self.turn[back];
                    let mut t = Translation::new();
                    let s = singularity[v as usize];
                    if s != NONE {
                        add_turned(&mut t, &vec![(s, [1, 0])], 0);
                        add_turned(&mut t, &vec![(s, [-1, 0])], (k + r) % 4);
                    }
                    add_turned(&mut t, &sum, (k + 2) % 4);
                    self.set_translation(back, t);
                    break;
                }
                (r, sum) = self.crossed(back, r, &sum, cut);
                h = forward;
            }
        }
        for v in 0..vertex_count {
            if on_cut(v) || self.outgoing[v] == NONE {
                continue;
            }
            let (mut r, mut sum) = (0u8, Translation::new());
            let fan: Vec<usize> = self.fan(v).collect();
            for (i, &h) in fan.iter().enumerate() {
                self.set_corner(h, r, &sum);
                if i + 1 < fan.len() && cut[previous(h)] {
                    (r, sum) = self.crossed(previous(h), r, &sum, cut);
                }
            }
        }
    }

    fn crossed(&self, h: usize, r: u8, sum: &Translation, cut: &[bool]) -> (u8, Translation) {
        if !cut[h] {
            return (r, sum.clone());
        }
        let mut after = self.translations[self.translation[h] as usize].clone();
        add_turned(&mut after, sum, self.turn[h]);
        ((r + self.turn[h]) % 4, after)
    }

    fn set_corner(&mut self, h: usize, r: u8, sum: &Translation) {
        let place = self.place(sum.clone());
        self.corner[h] = (r, place);
    }

    /// T of half-edge `h`, and -i^-k T of its twin.
    fn set_translation(&mut self, h: usize, t: Translation) {
        let other = self.twin[h] as usize;
        let mut back = Translation::new();
        add_turned(&mut back, &t, (6 - self.turn[h]) % 4);
        self.translation[h] = self.place(t);
        self.translation[other] = self.place(back);
    }

    fn place(&mut self, t: Translation) -> u32 {
        if t.is_empty() {
            return 0;
        }
        // Neighbours on a seam share theirs.
        let recent = self.translations.len().saturating_sub(8);
        if let Some(i) = self.translations[recent..].iter().rposition(|other| *other == t) {
            return (recent + i) as u32;
        }
        self.translations.push(t);
        self.translations.len() as u32 - 1
    }
}

/// The half-edge before `h` in its triangle.
pub(crate) fn previous(h: usize) -> usize {
    h / 3 * 3 + (h + 2) % 3
}
