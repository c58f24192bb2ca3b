//! Border vertices where the straight edge between two others would cut the surface's border short.

use super::planar_map::{Node, Place, PlanarMap};
use crate::surface::NurbsSurface;
use nalgebra::{Point3, Vector3};

/// Points along a piece of border at which its distance from the edge is asked for.
const SAMPLES: usize = 16;

/// Shortest piece that is cut off an edge, in mean edge lengths.
const SHORTEST: f64 = 0.12;

/// Distance of a border node from the plane of its panel, in mean edge lengths, that planarization takes out without moving the node far.
const FLAT: f64 = 0.02;

/// Share of a cell that is left at least on either side of a cut.
const SMALLEST_PART: f64 = 0.1;

/// How far edges on the border may stray from it, in mean edge lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BorderSag {
    /// Where one more corner of the panel helps, because it lies almost in the panel's plane.
    pub in_plane: f64,
    /// Where the border leaves the panel's plane, so that the cell is cut in two.
    pub out_of_plane: f64,
}

/// Puts nodes onto border edges until none strays farther from the piece of border that it stands for than `sag` allows.
///
/// Each goes where the border is farthest from the edge. Where it would be out of its panel's plane, the cell is cut in two there. Returns the number of
/// cuts.
pub(crate) fn follow_border(map: &mut PlanarMap, surface: &NurbsSurface, sag: &BorderSag) -> usize {
    let position = |[u, v]: [f64; 2]| surface.point(u, v);
    let mut points: Vec<Point3<f64>> = map.nodes.iter().map(|n| position(n.parameter)).collect();
    let (mut length, mut count) = (0.0, 0usize);
    let mut stack = vec![];
    for h in 0..map.origin.len() as u32 {
        if map.alive[h as usize] {
            length += (points[map.origin[h as usize] as usize] - points[map.end(h) as usize]).norm();
            count += 1;
            if map.outer[map.twin[h as usize] as usize] && !map.outer[h as usize] {
                stack.push(h);
            }
        }
    }
    let edge = length / count.max(1) as f64;
    let mut cuts = 0;
    while let Some(h) = stack.pop() {
        let nodes = [map.origin[h as usize], map.end(h)];
        let ends = nodes.map(|n| map.nodes[n as usize]);
        let [a, b] = nodes.map(|n| points[n as usize]);
        let chord = b - a;
        let places = way(surface, &ends).into_iter().map(|(parameter, place)| {
            let to = position(parameter) - a;
            let along = (to.dot(&chord) / chord.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            (to - chord * along, to.norm().min((to - chord).norm()), parameter, place)
        });
        let farthest = places.max_by(|x, y| x.0.norm_squared().total_cmp(&y.0.norm_squared()));
        let Some((off, reach, parameter, place)) = farthest else { continue };
        let area: Vector3<f64> = map
            .face(h)
            .map(|g| (points[map.origin[g as usize] as usize] - a).cross(&(points[map.end(g) as usize] - a)))
            .sum();
        let is_flat = area.try_normalize(0.0).is_none_or(|normal| normal.dot(&off).abs() <= FLAT * edge);
        let allowed = if is_flat { sag.in_plane } else { sag.out_of_plane };
        if off.norm() <= allowed * edge || reach < SHORTEST * edge {
            continue;
        }
        let metric = [0, 1, 2].map(|i| 0.5 * (ends[0].metric[i] + ends[1].metric[i]));
        let rest = map.subdivide(h, Node { parameter, place, metric });
        points.push(position(parameter));
        cuts += usize::from(!is_flat && cut_at(map, rest));
        stack.extend([h, rest]);
    }
    cuts
}

/// Cuts the cell left of `h` in two where `h` starts, as evenly as its corners allow; not if a part would be tiny. Returns whether it did.
fn cut_at(map: &mut PlanarMap, h: u32) -> bool {
    let face: Vec<u32> = map.face(h).collect();
    let places: Vec<[f64; 2]> = face.iter().map(|&g| map.nodes[map.origin[g as usize] as usize].parameter).collect();
    // Twice the area of the fan over the corners 0 to k, in the parameter plane.
    let from = |k: usize| [places[k][0] - places[0][0], places[k][1] - places[0][1]];
    let mut fans = vec![0.0; face.len()];
    for k in 2..face.len() {
        let (p, q) = (from(k - 1), from(k));
        fans[k] = fans[k - 1] + p[0] * q[1] - p[1] * q[0];
    }
    let whole = fans[face.len() - 1];
    let part = |k: usize| fans[k].min(whole - fans[k]);
    let best = (2..face.len() - 1).max_by(|&i, &j| part(i).total_cmp(&part(j)).then(j.cmp(&i)));
    let best = best.filter(|&k| part(k) > SMALLEST_PART * whole);
    if let Some(k) = best {
        map.divide(h, face[k]);
    }
    best.is_some()
}

/// Places along the domain's border from one node to another, counter-clockwise, without the two.
///
/// They lie on one side, or on several where a corner of the patch was so straight that it is none of a panel.
fn way(surface: &NurbsSurface, [from, to]: &[Node; 2]) -> Vec<([f64; 2], Place)> {
    let (mut side, last) = match (from.place, to.place) {
        (Place::Border(i) | Place::Corner(i), Place::Border(j)) => (i, j),
        (Place::Border(i) | Place::Corner(i), Place::Corner(j)) => (i, (j + 3) % 4),
        _ => return vec![],
    };
    let mut places = vec![];
    let mut start = from.parameter;
    loop {
        let next = (side + 1) % 4;
        let [s, t] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]][next as usize];
        let end = if side == last { to.parameter } else { surface.at_fraction(s, t) };
        places.extend((1..SAMPLES).map(|k| {
            let at = k as f64 / SAMPLES as f64;
            // The coordinate that a side holds stays what it is.
            let between = |i: usize| if start[i] == end[i] { start[i] } else { start[i] + (end[i] - start[i]) * at };
            ([0, 1].map(between), Place::Border(side))
        }));
        if side == last {
            return places;
        }
        places.push((end, Place::Corner(next)));
        (start, side) = (end, next);
    }
}
