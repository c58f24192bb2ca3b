//! Gauss-Newton on the angles of the crosses.

use super::matching::{Cross, matching};
use super::problem::{Freedom, Problem, nearest_direction};
use super::system::TriangleSystem;
use crate::control::Control;
use crate::error::Error;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// Share of the energy that an iteration has to gain for another one.
const GAIN: f64 = 3e-3;
/// Damping at which no step is to be hoped for.
const MOST_DAMPING: f64 = 1e4;
/// Largest change of an angle in one Gauss-Newton step, radians.
const MAX_STEP: f64 = 0.4;

impl Problem<'_> {
    /// Derivatives of (bisector, half crossing) by the unknowns of a triangle.
    fn tangents(&self, t: usize, cross: &Cross) -> [[f64; 2]; 2] {
        match self.freedom[t] {
            Freedom::Fixed => [[0.0; 2]; 2],
            Freedom::Free => [[1.0, 0.0], [0.0, 1.0]],
            Freedom::AboutU => [[1.0, 1.0], [0.0; 2]],
            Freedom::Bisector => [[1.0, self.forms[t].half_crossing_at(cross.bisector, self.floor).1], [0.0; 2]],
            Freedom::Crossing => [[self.forms[t].bisector_at(cross.half_crossing, cross.bisector).1, 1.0], [0.0; 2]],
        }
    }

    /// The cross of a triangle moved by its unknowns, kept conjugate and above the floor.
    fn moved(&self, t: usize, cross: &Cross, step: &[f64]) -> Cross {
        let form = &self.forms[t];
        let clamp = |c: f64| c.clamp(0.5 * self.floor, FRAC_PI_2 - 0.5 * self.floor);
        match self.freedom[t] {
            Freedom::Fixed => *cross,
            Freedom::Free => {
                Cross { bisector: cross.bisector + step[0], half_crossing: clamp(cross.half_crossing + step[1]) }
            }
            Freedom::AboutU => {
                let half_crossing = clamp(cross.half_crossing + step[0]);
                Cross { bisector: cross.u() + half_crossing, half_crossing }
            }
            Freedom::Bisector => {
                let [low, high] = form.bisector_range(cross.bisector, self.floor);
                let bisector = (cross.bisector + step[0]).clamp(low, high);
                Cross { bisector, half_crossing: form.half_crossing_at(bisector, self.floor).0 }
            }
            Freedom::Crossing => {
                let half_crossing = clamp(cross.half_crossing + step[0]);
                Cross { bisector: form.bisector_at(half_crossing, cross.bisector).0, half_crossing }
            }
        }
    }

    /// Whether unknown `i` of a triangle is stopped by the floor in the direction of `sign`.
    fn stopped(&self, t: usize, i: usize, cross: &Cross, sign: f64) -> bool {
        let slack = 1e-9;
        let [value, low, high] = match (self.freedom[t], i) {
            (Freedom::Fixed, _) => return true,
            (Freedom::Free, 0) => return false,
            (Freedom::Bisector, _) => {
                let [low, high] = self.forms[t].bisector_range(cross.bisector, self.floor);
                [cross.bisector, low, high]
            }
            _ => [cross.half_crossing, 0.5 * self.floor, FRAC_PI_2 - 0.5 * self.floor],
        };
        if sign < 0.0 { value <= low + slack } else { value >= high - slack }
    }

    /// Gauss-Newton with damping along the conjugate crosses, and the iterations spent; `jumps` as in [`Problem::across`].
    pub fn optimize(
        &self,
        system: &mut TriangleSystem,
        mut crosses: Vec<Cross>,
        jumps: Option<&[i32]>,
        most: usize,
        control: &Control,
    ) -> Result<(Vec<Cross>, usize), Error> {
        let count = crosses.len();
        if system.vector.is_empty() {
            return Ok((crosses, 0));
        }
        let mut energy = self.energy(&crosses, jumps);
        let mut damping = 1e-3;
        for iteration in 0..most {
            control.step("field", 0.3 + 0.6 * iteration as f64 / most as f64)?;
            let tangents: Vec<_> = (0..count).map(|t| self.tangents(t, &crosses[t])).collect();
            self.assemble(system, &crosses, jumps, &tangents);
            let gradient = system.vector.clone();
            for (t, cross) in crosses.iter().enumerate() {
                for i in 0..system.unknowns(t) {
                    // What the floor stops on the way down does not take part.
                    let stopped = self.stopped(t, i, cross, gradient[system.starts[t] + i]);
                    system.add_diagonal(t, i, i, if stopped { 1e9 } else { damping });
                }
            }
            let factor = match system.factorize("conjugate field") {
                Ok(factor) => factor,
                // Rounding may leave a nearly flat direction: more damping, as after a step uphill.
                Err(error) if damping > MOST_DAMPING || gradient.iter().any(|g| !g.is_finite()) => return Err(error),
                Err(_) => {
                    damping = (damping * 10.0).max(1e-2);
                    continue;
                }
            };
            let mut step = gradient.clone();
            factor.solve(&mut step);
            step.iter_mut().for_each(|s| *s = s.clamp(-MAX_STEP, MAX_STEP));
            let largest = step.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
            let trial: Vec<Cross> =
                (0..count).map(|t| self.moved(t, &crosses[t], &step[system.starts[t]..system.starts[t + 1]])).collect();
            let next = self.energy(&trial, jumps);
            if next <= energy {
                let gain = energy - next;
                crosses = trial;
                energy = next;
                damping = (0.2 * damping).max(1e-9);
                if largest < 1e-4 || gain <= GAIN * energy {
                    return Ok((crosses, iteration + 1));
                }
            } else {
                if largest < 1e-4 || damping > MOST_DAMPING {
                    return Ok((crosses, iteration + 1));
                }
                damping = (damping * 10.0).max(1e-2);
            }
        }
        Ok((crosses, most))
    }

    /// Gauss-Newton matrix and minus half the gradient at `crosses`.
    fn assemble(
        &self,
        system: &mut TriangleSystem,
        crosses: &[Cross],
        jumps: Option<&[i32]>,
        tangents: &[[[f64; 2]; 2]],
    ) {
        system.clear();
        // Adds weight * (row . angles - value)^2, row acting on (bisector, half crossing) of one triangle.
        let add = |system: &mut TriangleSystem, t: usize, row: [f64; 2], residual: f64, weight: f64| {
            let n = system.unknowns(t);
            let slope = [0, 1].map(|i| row[0] * tangents[t][i][0] + row[1] * tangents[t][i][1]);
            for i in 0..n {
                let start = system.starts[t];
                system.vector[start + i] -= weight * slope[i] * residual;
                for j in 0..=i {
                    system.add_diagonal(t, i, j, weight * slope[i] * slope[j]);
                }
            }
        };
        for e in self.inner_edges() {
            let pair = self.edges.triangles[e];
            let [f, g] = pair.map(|t| t as usize);
            let (k, rotation, change) = self.across(e, crosses, jumps);
            // An odd matching reflects the half crossing angle of g.
            let side = if k % 2 == 1 { -1.0 } else { 1.0 };
            let w = self.edge_weights[e];
            add(system, f, [-1.0, 0.0], rotation, w);
            add(system, f, [0.0, -1.0], change, w);
            add(system, g, [1.0, 0.0], rotation, w);
            add(system, g, [0.0, side], change, w);
            for i in 0..system.unknowns(f) {
                for j in 0..system.unknowns(g) {
                    let (a, b) = (tangents[f][i], tangents[g][j]);
                    system.add_off_diagonal(e, pair, i, j, -w * (a[0] * b[0] + side * a[1] * b[1]));
                }
            }
        }
        for (t, cross) in crosses.iter().enumerate() {
            let (target, weight) = &self.target[t];
            if *weight > 0.0 {
                let (k, rotation, change) = matching(target, cross, 0.0);
                let side = if k % 2 == 1 { -1.0 } else { 1.0 };
                add(system, t, [1.0, 0.0], rotation, *weight);
                add(system, t, [0.0, side], change, *weight);
            }
            add(system, t, [0.0, 1.0], cross.half_crossing - FRAC_PI_4, self.orthogonality[t]);
            if self.conjugacy[t] > 0.0 {
                let form = &self.forms[t];
                add(system, t, form.slopes(cross), form.value(cross), self.conjugacy[t]);
            }
        }
        for &(t, angle, weight) in &self.soft {
            let (i, residual) = nearest_direction(&crosses[t], angle);
            add(system, t, [1.0, if i % 2 == 0 { -1.0 } else { 1.0 }], residual, weight);
        }
    }
}
