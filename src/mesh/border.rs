//! What happens to cells at the border, and to cells that a turned-over map leaves behind.

use super::planar_map::{Course, NONE, Place, PlanarMap};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// How the border of the panel mesh comes about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BorderMode {
    /// Cells cut by the border become polygons that end on it: the whole surface is covered.
    #[default]
    Trimmed,
    /// Only whole quads, as in the paper: the outline is a saw-tooth line of isolines.
    Interior,
    /// The field follows the border, and so do rows of quads; where it does not, as `Trimmed`.
    Aligned,
}

/// What the clean-up did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repairs {
    /// Edges of no map length that were contracted: traces of turned-over triangles.
    pub folds: usize,
    /// Short edges at the border that were contracted.
    pub snapped: usize,
    /// Slivers united with a neighbour.
    pub united: usize,
    /// Cells cut in two because the border bends out of their plane.
    pub cut: usize,
    /// Faces that were left out.
    pub dropped: usize,
}

/// Contracts what a fold of the map doubled: links between two copies of one grid point.
pub(crate) fn unfold(map: &mut PlanarMap, repairs: &mut Repairs) {
    loop {
        let mut changed = false;
        for h in 0..map.origin.len() as u32 {
            if !map.alive[h as usize] || h > map.twin[h as usize] || map.is_border(h) {
                continue;
            }
            let (u, v) = (map.origin[h as usize], map.end(h));
            let inner = [u, v].iter().all(|&n| !map.nodes[n as usize].place.on_border());
            if inner && map.traced[h as usize].abs() < 0.5 && map.can_contract(h) {
                merge(map, h);
                repairs.folds += 1;
                changed = true;
            }
        }
        for h in map.faces() {
            changed |= map.alive[h as usize] && map.drop_two_gon(h);
        }
        if !changed {
            break;
        }
    }
    simplify(map, repairs);
}

/// Removes inner edges until every face is a polygon that meets each of its nodes once, and no two edges join the same nodes.
///
/// Nothing to do where the map turns no triangle over. Each removal unites two faces, so the domain stays covered.
pub(crate) fn simplify(map: &mut PlanarMap, repairs: &mut Repairs) {
    loop {
        drop_dangling(map);
        let Some(h) = superfluous(map) else { return };
        let ends = [map.origin[h as usize], map.end(h)];
        map.remove(h);
        ends.iter().for_each(|&n| drop_straight(map, n));
        repairs.united += 1;
    }
}

/// An inner edge that keeps the map from being a mesh.
fn superfluous(map: &PlanarMap) -> Option<u32> {
    for node in 0..map.nodes.len() as u32 {
        // Parallel edges and loops.
        let arms: Vec<u32> = map.arms(node).collect();
        for (i, &h) in arms.iter().enumerate() {
            let parallel = arms[..i].iter().find(|&&g| map.end(g) == map.end(h));
            if let Some(&g) = parallel.filter(|_| map.end(h) >= node)
                && let Some(&which) = [h, g].iter().find(|&&e| !map.is_border(e))
            {
                return Some(which);
            }
        }
    }
    for h in map.faces() {
        let face: Vec<u32> = map.face(h).collect();
        for i in 0..face.len() {
            let node = map.origin[face[i] as usize];
            let Some(j) = (i + 1..face.len()).find(|&j| map.origin[face[j] as usize] == node) else { continue };
            // The shorter way from the node back to itself surrounds what hangs on it.
            let (inner, rest) = (&face[i..j], [&face[j..], &face[..i]].concat());
            let ways = if inner.len() <= rest.len() { [inner.to_vec(), rest] } else { [rest, inner.to_vec()] };
            if let Some(&h) = ways.iter().flatten().find(|&&g| !map.is_border(g)) {
                return Some(h);
            }
        }
    }
    None
}

/// Removes edges that end nowhere, again and again.
fn drop_dangling(map: &mut PlanarMap) {
    let mut stack: Vec<u32> = (0..map.nodes.len() as u32).filter(|&n| map.degree(n) == 1).collect();
    while let Some(node) = stack.pop() {
        if map.degree(node) == 1 {
            let h = map.first[node as usize];
            let other = map.end(h);
            map.remove(h);
            drop_straight(map, other);
            stack.push(other);
        }
    }
}

/// Where the joint node of a contraction goes.
fn joint(map: &PlanarMap, h: u32) -> ([f64; 2], Place, [f64; 3]) {
    let (u, v) = (map.nodes[map.origin[h as usize] as usize], map.nodes[map.end(h) as usize]);
    let rank = |p: Place| match p {
        Place::Inner => 0,
        Place::Singular => 1,
        Place::Border(_) => 2,
        Place::Corner(_) => 3,
    };
    match rank(u.place).cmp(&rank(v.place)) {
        Ordering::Greater => (u.parameter, u.place, u.metric),
        Ordering::Less => (v.parameter, v.place, v.metric),
        Ordering::Equal => {
            let middle = [0, 1].map(|i| 0.5 * (u.parameter[i] + v.parameter[i]));
            (middle, u.place, [0, 1, 2].map(|i| 0.5 * (u.metric[i] + v.metric[i])))
        }
    }
}

fn merge(map: &mut PlanarMap, h: u32) {
    merge_at(map, h, joint(map, h));
}

fn merge_at(map: &mut PlanarMap, h: u32, (parameter, place, metric): ([f64; 2], Place, [f64; 3])) {
    let node = map.origin[h as usize] as usize;
    map.contract(h);
    map.nodes[node].parameter = parameter;
    map.nodes[node].place = place;
    map.nodes[node].metric = metric;
}

/// Where a contraction at the border goes, and a border node that has no other purpose after it.
///
/// A grid point x whose two lines meet the border on either side of it, in a triangle (x, b, c), goes to its foot on the border
/// between b and c; everything else as [`joint`] says.
fn border_joint(map: &PlanarMap, h: u32) -> (([f64; 2], Place, [f64; 3]), Option<u32>) {
    let plain = joint(map, h);
    let (u, v) = (map.origin[h as usize], map.end(h));
    let (x, b) = if map.nodes[u as usize].place.on_border() { (v, u) } else { (u, v) };
    let Place::Border(side) = map.nodes[b as usize].place else { return (plain, None) };
    if map.nodes[x as usize].place.on_border() {
        return (plain, None);
    }
    for g in [h, map.twin[h as usize]] {
        let triangle: Vec<u32> = map.face(g).collect();
        let Some(&third) = triangle.iter().find(|&&e| map.origin[e as usize] != u && map.origin[e as usize] != v)
        else {
            continue;
        };
        let c = map.origin[third as usize];
        let border_edge = triangle.iter().any(|&e| map.is_border(e) && map.origin[e as usize] != x && map.end(e) != x);
        if triangle.len() != 3 || !border_edge || map.nodes[c as usize].place != Place::Border(side) {
            continue;
        }
        let [px, pb, pc] = [x, b, c].map(|n| map.nodes[n as usize].parameter);
        let m = map.nodes[x as usize].metric;
        let product =
            |p: [f64; 2], q: [f64; 2]| m[0] * p[0] * q[0] + m[1] * (p[0] * q[1] + p[1] * q[0]) + m[2] * p[1] * q[1];
        let along = [pc[0] - pb[0], pc[1] - pb[1]];
        let from = [px[0] - pb[0], px[1] - pb[1]];
        let t = product(along, from) / product(along, along);
        if t.is_finite() {
            let t = t.clamp(0.0, 1.0);
            let foot = [0, 1].map(|i| if along[i] == 0.0 { pb[i] } else { pb[i] + t * along[i] });
            return ((foot, Place::Border(side), plain.2), Some(c));
        }
    }
    (plain, None)
}

/// A candidate for contraction; the shortest first.
struct Candidate(f64, u32);

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Candidate {}
impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
    }
}

/// Contracts edges at the border that are shorter than `shortest` cells, the shortest first: grid points close to the border move onto
/// it, crossings close to each other or to a corner become one.
pub(crate) fn snap(map: &mut PlanarMap, shortest: f64, repairs: &mut Repairs) {
    let at_border = |map: &PlanarMap, h: u32| {
        [map.origin[h as usize], map.end(h)].iter().any(|&n| map.nodes[n as usize].place.on_border())
    };
    let length = |map: &PlanarMap, h: u32| map.distance(map.origin[h as usize], map.end(h));
    let mut queue = BinaryHeap::new();
    for h in 0..map.origin.len() as u32 {
        if map.alive[h as usize] && h < map.twin[h as usize] && at_border(map, h) && length(map, h) < shortest {
            queue.push(Candidate(length(map, h), h));
        }
    }
    while let Some(Candidate(was, h)) = queue.pop() {
        if !map.alive[h as usize] || !at_border(map, h) {
            continue;
        }
        let now = length(map, h);
        if now >= shortest {
            continue;
        }
        if now > was + 1e-9 {
            queue.push(Candidate(now, h));
            continue;
        }
        if !may_merge(map, h) {
            continue;
        }
        let node = map.origin[h as usize];
        snap_edge(map, h);
        repairs.snapped += 1;
        let arms: Vec<u32> = map.arms(node).collect();
        for arm in arms {
            if at_border(map, arm) && length(map, arm) < shortest {
                queue.push(Candidate(length(map, arm), arm.min(map.twin[arm as usize])));
            }
        }
    }
}

fn snap_edge(map: &mut PlanarMap, h: u32) {
    let (to, spare) = border_joint(map, h);
    merge_at(map, h, to);
    if let Some(node) = spare {
        drop_straight(map, node);
    }
}

/// Whether contracting `h` is sound, and turns no face over.
fn may_merge(map: &PlanarMap, h: u32) -> bool {
    let (u, v) = (map.origin[h as usize], map.end(h));
    let (p, q) = (map.nodes[u as usize].place, map.nodes[v as usize].place);
    if matches!((p, q), (Place::Corner(_), Place::Corner(_))) || !map.can_contract(h) {
        return false;
    }
    if p.on_border() && q.on_border() && !map.is_border(h) {
        return false;
    }
    // Two sides meet in a corner only.
    if let (Place::Border(i), Place::Border(j)) = (p, q)
        && i != j
    {
        return false;
    }
    let ((to, ..), _) = border_joint(map, h);
    let beside = [h, map.twin[h as usize]];
    for node in [u, v] {
        for arm in map.arms(node) {
            let mut face = map.face(arm);
            if map.outer[arm as usize] || face.any(|g| beside.contains(&g)) {
                continue;
            }
            let (before, after) = (map.area(arm), map.area_with(arm, Some((node, to))));
            if after < 0.2 * before.min(0.5) {
                return false;
            }
        }
    }
    true
}

/// Gets rid of faces of less than `least` cells: moves the inner corner of a triangle onto the border, or unites the face with the
/// neighbour across its longest inner edge, if that leaves no grid point with three edges or the face is tiny.
pub(crate) fn unite_slivers(map: &mut PlanarMap, least: f64, repairs: &mut Repairs) {
    let mut faces: Vec<(f64, u32)> = map.faces().into_iter().map(|h| (map.area(h), h)).collect();
    faces.retain(|f| f.0 < least);
    faces.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (_, h) in faces {
        if !map.alive[h as usize] || map.area(h) >= least {
            continue;
        }
        let mut edges: Vec<(f64, u32)> = map
            .face(h)
            .filter(|&g| !map.is_border(g))
            .map(|g| (map.distance(map.origin[g as usize], map.end(g)), g))
            .collect();
        edges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let on_border = |map: &PlanarMap, n: u32| map.nodes[n as usize].place.on_border();
        if map.face(h).count() == 3 {
            let stub = edges
                .iter()
                .map(|e| e.1)
                .find(|&g| on_border(map, map.origin[g as usize]) != on_border(map, map.end(g)) && may_merge(map, g));
            if let Some(g) = stub {
                snap_edge(map, g);
                repairs.snapped += 1;
                continue;
            }
        }
        let tiny = map.area(h) < 0.3 * least;
        for &(_, g) in edges.iter().rev() {
            let ends = [map.origin[g as usize], map.end(g)];
            let regular = ends.iter().all(|&n| on_border(map, n) || map.degree(n) > 4);
            if (regular || tiny) && can_unite(map, g) {
                map.remove(g);
                ends.iter().for_each(|&n| drop_straight(map, n));
                repairs.united += 1;
                break;
            }
        }
    }
}

/// Whether removing `h` leaves a simple polygon of at most six corners.
fn can_unite(map: &PlanarMap, h: u32) -> bool {
    let t = map.twin[h as usize];
    let left: Vec<u32> = map.face(h).map(|g| map.origin[g as usize]).collect();
    let right: Vec<u32> = map.face(t).map(|g| map.origin[g as usize]).collect();
    let shared = left.iter().filter(|n| right.contains(n)).count();
    shared == 2 && left.len() + right.len() - 2 <= 6
}

/// Joins the two edges at a node that needs not be one: of degree two, and no corner.
pub(crate) fn drop_straight(map: &mut PlanarMap, node: u32) {
    if map.first[node as usize] != NONE && !matches!(map.nodes[node as usize].place, Place::Corner(_)) {
        map.dissolve(node);
    }
}

/// Keeps only quads between grid points: removes everything at the border, and then what hangs on by a corner.
pub(crate) fn keep_interior(map: &PlanarMap) -> Vec<u32> {
    let whole = |h: u32| {
        let face: Vec<u32> = map.face(h).collect();
        face.len() == 4
            && face.iter().all(|&g| {
                !map.nodes[map.origin[g as usize] as usize].place.on_border()
                    && map.course[g as usize] != Course::Border
            })
    };
    map.faces().into_iter().filter(|&h| whole(h)).collect()
}
