//! What a field shall be like: an energy of the crosses, and how each of them may move.

use super::border::followed;
use super::conjugate::SecondForm;
use super::layout::Patch;
use super::matching::{Cross, matching};
use super::parallel::{Parallel, parallels};
use super::polyvector::PolyVector;
use super::smooth::{DirectionConstraint, FieldOptions};
use super::system::TriangleSystem;
use super::topology::{EdgeTopology, TriangleFrames, wrap};
use crate::error::Error;
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Weight of a hard constraint in the initial system, edges weighing about 1.
pub(super) const HARD_WEIGHT: f64 = 1e3;

/// How conjugacy enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Conjugacy {
    /// Crosses move along the conjugate ones only.
    Exact,
    /// [`FieldOptions::conjugacy_weight`] times the integral of II(u, v)^2 is part of the energy.
    Soft,
}

/// How the cross of a triangle may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Freedom {
    /// Not at all: a hard constraint and its conjugate.
    Fixed,
    /// Elliptic: along the conjugate crosses, by the bisector.
    Bisector,
    /// Hyperbolic: along the conjugate crosses, by the half crossing angle.
    Crossing,
    /// v turns about the hard constraint u, since no conjugate of u is defined or allowed.
    AboutU,
    /// Flat: both angles.
    Free,
}

impl Freedom {
    pub fn unknowns(self) -> usize {
        match self {
            Self::Fixed => 0,
            Self::Bisector | Self::Crossing | Self::AboutU => 1,
            Self::Free => 2,
        }
    }
}

/// Everything the energy needs; angles are in the triangles' frames.
pub(super) struct Problem<'a> {
    pub mesh: &'a SurfaceMesh,
    pub edges: &'a EdgeTopology,
    pub frames: &'a TriangleFrames,
    pub forms: &'a [SecondForm],
    pub conjugacy: Vec<f64>,
    pub edge_weights: &'a [f64],
    pub flat: Vec<bool>,
    pub freedom: Vec<Freedom>,
    /// The cross that a hard constraint asks for.
    pub hard: Vec<Option<Cross>>,
    pub floor_triangles: Vec<u32>,
    /// Triangle, angle, weight.
    pub soft: Vec<(usize, f64, f64)>,
    /// The cross to be near to, and the weight of that.
    pub target: Vec<(Cross, f64)>,
    pub orthogonality: Vec<f64>,
    pub constraint_angles: Vec<(usize, f64, f64)>,
    /// Directions beside the constraints, as constraints.
    pub parallels: Vec<DirectionConstraint>,
    pub has_guess: bool,
    pub floor: f64,
    pub options: &'a FieldOptions,
    /// The border that the field follows: edges by the vertex that they leave, and quarter turns of the border by vertex.
    pub followed: BTreeMap<u32, u32>,
    pub corners: BTreeMap<u32, i32>,
}

impl<'a> Problem<'a> {
    pub fn new(
        &Patch { mesh, edges, frames, forms, corners, weights }: &Patch<'a>,
        conjugacy: Conjugacy,
        guess: Option<&[[Vector3<f64>; 2]]>,
        constraints: &[DirectionConstraint],
        options: &'a FieldOptions,
    ) -> Result<Self, Error> {
        let count = mesh.triangles.len();
        let floor = options.crossing_floor_deg.to_radians();
        let area: f64 = frames.areas.iter().sum();
        let share: Vec<f64> = frames.areas.iter().map(|a| a / area).collect();
        // A triangle cannot tell a radius of curvature below its own size: a spike at a nearly collapsed corner must neither weigh without
        // bound nor make the rest of the surface count as flat.
        let curvature = |t: usize| {
            let square = forms[t].norm().powi(2);
            square / (1.0 + frames.areas[t] * square)
        };
        let mean_square: f64 = share.iter().enumerate().map(|(t, a)| curvature(t) * a).sum();
        let least = options.flatness * mean_square.sqrt().max(area.sqrt().recip());
        let flat: Vec<bool> = forms.iter().map(|f| f.norm() <= least).collect();
        let soft = |t: usize| {
            if conjugacy == Conjugacy::Exact || flat[t] {
                0.0
            } else {
                options.conjugacy_weight * frames.areas[t] / (1.0 + frames.areas[t] * forms[t].norm().powi(2))
            }
        };
        let exact = conjugacy == Conjugacy::Exact;
        let mut problem = Self {
            mesh,
            edges,
            frames,
            forms,
            conjugacy: (0..count).map(soft).collect(),
            edge_weights: weights,
            freedom: vec![Freedom::Free; count],
            hard: vec![None; count],
            floor_triangles: vec![],
            soft: vec![],
            target: vec![(Cross { bisector: 0.0, half_crossing: FRAC_PI_4 }, 0.0); count],
            orthogonality: share.iter().map(|a| a * options.orthogonality_weight).collect(),
            constraint_angles: vec![],
            parallels: vec![],
            has_guess: guess.is_some(),
            floor,
            options,
            flat,
            followed: followed(mesh, edges, &options.aligned_sides),
            corners: corners.iter().map(|c| (c.vertex, c.turns)).collect(),
        };
        for t in 0..count {
            problem.freedom[t] = match (problem.flat[t] || !exact, problem.forms[t].by_bisector()) {
                (true, _) => Freedom::Free,
                (false, true) => Freedom::Bisector,
                (false, false) => Freedom::Crossing,
            };
        }
        problem.add_constraints(constraints, exact)?;
        if options.parallel_weight > 0.0 {
            let reach = options.parallel_reach * area.sqrt();
            for Parallel { triangle, angle, strength } in parallels(mesh, edges, frames, constraints, reach) {
                let weight = options.parallel_weight * share[triangle] * strength;
                problem.soft.push((triangle, angle, weight));
                let direction = frames.direction(triangle, angle);
                problem.parallels.push(DirectionConstraint { triangle: triangle as u32, direction, weight });
            }
        }
        problem.add_targets(guess, &share);
        Ok(problem)
    }

    fn add_constraints(&mut self, constraints: &[DirectionConstraint], exact: bool) -> Result<(), Error> {
        let count = self.freedom.len();
        for (i, constraint) in constraints.iter().enumerate() {
            let t = constraint.triangle as usize;
            if t >= count {
                let reason = format!("constraint {i} is on triangle {t} of {count}");
                return Err(Error::Degenerate { reason });
            }
            if !constraint.direction.iter().all(|c| c.is_finite()) {
                return Err(Error::NotFinite { what: "constraint", index: i });
            }
            let tangent = self.frames.components(t, &constraint.direction);
            if constraint.weight.is_nan()
                || constraint.weight <= 0.0
                || tangent.norm() <= 1e-9 * constraint.direction.norm()
            {
                continue;
            }
            let angle = tangent.y.atan2(tangent.x);
            let weight = if constraint.weight.is_finite() { constraint.weight } else { 1.0 };
            self.constraint_angles.push((t, angle, weight));
            if constraint.weight.is_finite() || self.hard[t].is_some() {
                let weight = if constraint.weight.is_finite() { constraint.weight } else { 10.0 };
                self.soft.push((t, angle, weight));
                continue;
            }
            let conjugate = if self.flat[t] { None } else { self.forms[t].conjugate(angle) };
            let conjugate = conjugate.map(|v| Cross::from_angles(angle, v));
            let (cross, freedom) = match conjugate {
                Some(cross) if cross.crossing() >= self.floor => {
                    (cross, if exact { Freedom::Fixed } else { Freedom::AboutU })
                }
                Some(_) => {
                    self.floor_triangles.push(t as u32);
                    (Cross::from_angles(angle, angle + FRAC_PI_2), Freedom::AboutU)
                }
                None => (Cross::from_angles(angle, angle + FRAC_PI_2), Freedom::AboutU),
            };
            self.hard[t] = Some(cross);
            self.freedom[t] = freedom;
        }
        self.floor_triangles.sort_unstable();
        Ok(())
    }

    fn add_targets(&mut self, guess: Option<&[[Vector3<f64>; 2]]>, share: &[f64]) {
        let constrained = !self.constraint_angles.is_empty() || guess.is_some();
        let principal_weight = self.options.principal_weight * if constrained { 0.01 } else { 1.0 };
        for t in 0..self.freedom.len() {
            let guessed = guess.and_then(|guess| {
                let [u, v] = guess[t].map(|d| self.frames.components(t, &d));
                PolyVector::from_directions(u.try_normalize(1e-12)?, v.try_normalize(1e-12)?).cross()
            });
            self.target[t] = match guessed {
                Some(cross) => (cross, self.options.guess_weight * share[t]),
                None => {
                    let weight = if self.flat[t] { 0.0 } else { principal_weight * distinctness(&self.forms[t]) };
                    (principal_cross(&self.forms[t]), weight * share[t])
                }
            };
        }
    }

    /// The cross nearest to `cross` that this problem allows on triangle `t`.
    pub fn allowed(&self, t: usize, cross: &Cross) -> Cross {
        match self.freedom[t] {
            Freedom::Fixed => self.hard[t].expect("fixed triangles have a cross"),
            Freedom::AboutU => {
                let u = self.hard[t].expect("constrained triangles have a cross").u();
                let half_crossing = cross.half_crossing.clamp(0.5 * self.floor, FRAC_PI_2 - 0.5 * self.floor);
                Cross { bisector: u + half_crossing, half_crossing }
            }
            Freedom::Free => {
                let half_crossing = cross.half_crossing.clamp(0.5 * self.floor, FRAC_PI_2 - 0.5 * self.floor);
                Cross { half_crossing, ..*cross }
            }
            Freedom::Bisector | Freedom::Crossing => self.forms[t].project(cross, self.floor),
        }
    }

    /// The pattern of the Gauss-Newton systems.
    pub fn system(&self) -> Result<TriangleSystem, Error> {
        TriangleSystem::new(self.edges, self.freedom.iter().map(|f| f.unknowns()))
    }

    pub fn inner_edges(&self) -> impl Iterator<Item = usize> {
        (0..self.edges.len()).filter(|&e| !self.edges.is_border(e))
    }

    /// Matching, rotation and change across an edge, see [`matching`]; with `jumps`, for the given number of quarter turns instead of the
    /// nearest.
    pub fn across(&self, e: usize, crosses: &[Cross], jumps: Option<&[i32]>) -> (u8, f64, f64) {
        let [f, g] = self.edges.triangles[e].map(|t| t as usize);
        match jumps {
            None => matching(&crosses[f], &crosses[g], self.frames.turns[e]),
            Some(jumps) => {
                let renamed = crosses[g].renamed(jumps[e]);
                let rotation = renamed.bisector - crosses[f].bisector - self.frames.turns[e];
                (jumps[e].rem_euclid(4) as u8, rotation, renamed.half_crossing - crosses[f].half_crossing)
            }
        }
    }

    /// The energy: smoothness + targets + soft constraints + orthogonality; `jumps` as in [`Problem::across`].
    pub fn energy(&self, crosses: &[Cross], jumps: Option<&[i32]>) -> f64 {
        let mut sum = 0.0;
        for e in self.inner_edges() {
            let (_, rotation, change) = self.across(e, crosses, jumps);
            sum += self.edge_weights[e] * (rotation * rotation + change * change);
        }
        for (t, cross) in crosses.iter().enumerate() {
            let (target, weight) = &self.target[t];
            if *weight > 0.0 {
                let (_, rotation, change) = matching(cross, target, 0.0);
                sum += weight * (rotation * rotation + change * change);
            }
            sum += self.orthogonality[t] * (cross.half_crossing - FRAC_PI_4).powi(2);
            if self.conjugacy[t] > 0.0 {
                sum += self.conjugacy[t] * self.forms[t].value(cross).powi(2);
            }
        }
        for &(t, angle, weight) in &self.soft {
            sum += weight * nearest_direction(&crosses[t], angle).1.powi(2);
        }
        sum
    }
}

/// The cross of the principal directions.
pub(super) fn principal_cross(form: &SecondForm) -> Cross {
    Cross { bisector: form.principal_angle() + FRAC_PI_4, half_crossing: FRAC_PI_4 }
}

/// How well the principal directions are defined: (k1 - k2)^2 / (k1^2 + k2^2), at most 1; 1 at hyperbolic points.
fn distinctness(form: &SecondForm) -> f64 {
    let (h, d) = (form.h.powi(2), form.deviator().powi(2));
    if h + d == 0.0 { 0.0 } else { (2.0 * d / (h + d)).min(1.0) }
}

/// The direction number of (u, v, -u, -v) nearest to `angle`, and its angle beyond.
pub(super) fn nearest_direction(cross: &Cross, angle: f64) -> (usize, f64) {
    let u = wrap(cross.u() - angle, PI);
    let v = wrap(cross.v() - angle, PI);
    if u.abs() <= v.abs() { (0, u) } else { (1, v) }
}
