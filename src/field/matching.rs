//! Which direction continues as which across an edge, and what that sums to around a vertex.

use super::conjugate_field::Singularity;
use super::topology::{EdgeTopology, TriangleFrames, wrap};
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// The cross u, v, -u, -v of a triangle, by the bisector of u and v and half the angle between them.
///
/// u is at `bisector - half_crossing`, v at `bisector + half_crossing`, in the triangle's frame. Renaming (u, v) to (v, -u) adds
/// a quarter turn to the bisector and reflects `half_crossing` to pi/2 - `half_crossing`: the same cross.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cross {
    /// Angle of the bisector of u and v, radians.
    pub bisector: f64,
    /// Half the angle from u to v, radians, in (0, pi/2).
    pub half_crossing: f64,
}

impl Cross {
    /// The cross of two directions given by their angles; v is turned by half a turn where needed to lie left of u.
    pub fn from_angles(u: f64, v: f64) -> Self {
        let mut opening = wrap(v - u, TAU);
        if opening < 0.0 {
            opening += std::f64::consts::PI;
        }
        Self { bisector: u + 0.5 * opening, half_crossing: 0.5 * opening }
    }

    /// Angle of u.
    pub fn u(&self) -> f64 {
        self.bisector - self.half_crossing
    }

    /// Angle of v.
    pub fn v(&self) -> f64 {
        self.bisector + self.half_crossing
    }

    /// The same cross renamed: (u, v) becomes the directions number `k` and `k + 1` of (u, v, -u, -v).
    pub fn renamed(&self, k: i32) -> Self {
        let half_crossing = if k.rem_euclid(2) == 1 { FRAC_PI_2 - self.half_crossing } else { self.half_crossing };
        Self { bisector: self.bisector + f64::from(k) * FRAC_PI_2, half_crossing }
    }

    /// Smaller angle between the lines of u and v, radians, in (0, pi/2].
    pub fn crossing(&self) -> f64 {
        let opening = 2.0 * self.half_crossing;
        opening.min(std::f64::consts::PI - opening)
    }
}

/// How the cross `g` continues the cross `f`, the frame of g being turned by `turn` against that of f.
///
/// Returns (k, r, d): direction i of f continues as direction (i + k) mod 4 of g; r is the rotation of the bisector beyond the
/// unfolding, in (-pi/4, pi/4] or close to it, and d the change of the half crossing angle. Among the four order-preserving choices it minimizes
/// r^2 + d^2, which is half the sum of the squared rotations of u and of v.
pub fn matching(f: &Cross, g: &Cross, turn: f64) -> (u8, f64, f64) {
    let plain = wrap(g.bisector - f.bisector - turn, TAU);
    // Of k and k + 2, which differ by half a turn, the one that turns less; the margins make ties fall to the smaller k whatever the rounding.
    let nearer = |k: u8, rotation: f64| {
        let opposite = rotation - PI.copysign(rotation);
        if rotation.abs() > opposite.abs() + 1e-12 { (k + 2, opposite) } else { (k, rotation) }
    };
    let (even, even_rotation) = nearer(0, plain);
    let quarter = plain + FRAC_PI_2;
    let (odd, odd_rotation) = nearer(1, if quarter > PI { quarter - TAU } else { quarter });
    let [even_change, odd_change] = [g.half_crossing, FRAC_PI_2 - g.half_crossing].map(|c| c - f.half_crossing);
    let cost = |rotation: f64, change: f64| rotation * rotation + change * change;
    let gain = cost(even_rotation, even_change) - cost(odd_rotation, odd_change);
    if gain > 1e-12 || (gain > -1e-12 && odd < even) {
        (odd, odd_rotation, odd_change)
    } else {
        (even, even_rotation, even_change)
    }
}

/// Matching of every edge (0 on the border) and the singular vertices, by the smallest rotations; as [`match_edges`].
pub fn match_field(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    frames: &TriangleFrames,
    crosses: &[Cross],
) -> (Vec<u8>, Vec<Singularity>) {
    match_edges(mesh, edges, |e| {
        let [f, g] = edges.triangles[e].map(|t| t as usize);
        let (k, rotation, _) = matching(&crosses[f], &crosses[g], frames.turns[e]);
        (k, rotation)
    })
}

/// Matching of every edge (0 on the border) and the singular vertices.
///
/// - `across`: matching and rotation of the bisector across an inner edge, as [`matching`] gives them.
///
/// The index of an inner vertex, in quarter turns, is (sum of the bisectors' rotations around it, counter-clockwise, plus the angle that
/// the triangles around it lack to a full turn) / (pi/2): an integer, and congruent mod 4 to the sum of the matchings.
pub(super) fn match_edges(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    across: impl Fn(usize) -> (u8, f64),
) -> (Vec<u8>, Vec<Singularity>) {
    let mut k = vec![0; edges.len()];
    let mut rotation = vec![0.0; edges.len()];
    for e in 0..edges.len() {
        if !edges.is_border(e) {
            (k[e], rotation[e]) = across(e);
        }
    }
    let mut singularities = vec![];
    for vertex in 0..mesh.points.len() as u32 {
        if edges.is_border_vertex(vertex) {
            continue;
        }
        let fan = edges.fan(vertex);
        let mut sum = TAU;
        for (i, &t) in fan.iter().enumerate() {
            sum -= corner_angle(mesh, t, vertex);
            let next = fan[(i + 1) % fan.len()];
            let e = edges.between(t, next).expect("neighbours in a fan share an edge") as usize;
            sum += if edges.triangles[e][0] == t { rotation[e] } else { -rotation[e] };
        }
        let index = (sum / FRAC_PI_2).round() as i32;
        if index != 0 {
            singularities.push(Singularity { vertex, index });
        }
    }
    (k, singularities)
}

/// Angle of `triangle` at `vertex`, radians.
fn corner_angle(mesh: &SurfaceMesh, triangle: u32, vertex: u32) -> f64 {
    let corners = mesh.triangles[triangle as usize];
    let k = corners.iter().position(|&v| v == vertex).expect("the triangle has the vertex");
    let [p, q, r] = [0, 1, 2].map(|i| mesh.position(corners[(k + i) % 3]));
    let (a, b): (Vector3<f64>, Vector3<f64>) = (q - p, r - p);
    a.cross(&b).norm().atan2(a.dot(&b))
}
