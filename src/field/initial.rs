//! Where the field starts: the smoothest coefficient under everything that attracts it.

use super::matching::Cross;
use super::problem::{Freedom, HARD_WEIGHT, Problem, principal_cross};
use super::system::TriangleSystem;
use super::topology::wrap;
use crate::control::Control;
use crate::error::Error;
use nalgebra::Complex;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// Rounds of the initial system.
const INITIAL_ROUNDS: usize = 3;

impl Problem<'_> {
    /// The conjugate cross with the bisector `m`, or with the nearest one that has a conjugate cross above the floor.
    fn attach(&self, t: usize, m: f64) -> Cross {
        let form = &self.forms[t];
        match self.freedom[t] {
            Freedom::Fixed => self.hard[t].expect("fixed triangles have a cross"),
            Freedom::Free => Cross { bisector: m, half_crossing: FRAC_PI_4 },
            Freedom::AboutU => {
                let u = self.hard[t].expect("constrained triangles have a cross").u();
                let half_crossing = wrap(m - u, FRAC_PI_2).rem_euclid(FRAC_PI_2);
                let half_crossing = half_crossing.clamp(0.5 * self.floor, FRAC_PI_2 - 0.5 * self.floor);
                Cross { bisector: u + half_crossing, half_crossing }
            }
            Freedom::Bisector => {
                let [low, high] = form.bisector_range(m, self.floor);
                let bisector = m.clamp(low, high);
                Cross { bisector, half_crossing: form.half_crossing_at(bisector, self.floor).0 }
            }
            Freedom::Crossing => {
                // h cos 2c = -deviator cos 2 (m - m0)
                let right = -form.deviator() * (2.0 * (m - form.principal_angle())).cos();
                let limit = self.floor.cos();
                let q =
                    if form.h.abs() * limit <= right.abs() { limit.copysign(right * form.h) } else { right / form.h };
                let half_crossing = 0.5 * q.acos();
                Cross { bisector: form.bisector_at(half_crossing, m).0, half_crossing }
            }
        }
    }

    /// The smoothest coefficient p = exp(4 i bisector) under everything that attracts bisectors, then the conjugate crosses that have them.
    ///
    /// - `system`: empty, of two unknowns on each triangle.
    pub fn initial(&self, system: &mut TriangleSystem, control: &Control) -> Result<Vec<Cross>, Error> {
        let count = self.freedom.len();
        let fourfold = |m: f64| Complex::from_polar(1.0, 4.0 * m);
        // Weight and weighted sum of what attracts p, but for the pins; weight and place of the pins.
        let mut attraction: Vec<(f64, Complex<f64>)> =
            self.target.iter().map(|(cross, weight)| (*weight, fourfold(cross.bisector) * *weight)).collect();
        let mut pins = vec![(0.0, Complex::new(0.0, 0.0)); count];
        for t in 0..count {
            if let Some(cross) = &self.hard[t] {
                let weight = if self.freedom[t] == Freedom::Fixed { HARD_WEIGHT } else { 1.0 };
                attraction[t].0 += weight;
                attraction[t].1 += fourfold(cross.bisector) * weight;
            } else if self.conjugacy[t] > 0.0 && !self.forms[t].by_bisector() {
                // Only bisectors near those of the principal directions have conjugate crosses here.
                let form = &self.forms[t];
                let (h, d) = (form.h.powi(2), form.deviator().powi(2));
                let cross =
                    if self.has_guess { form.project(&self.target[t].0, self.floor) } else { principal_cross(form) };
                let weight = 0.25 * self.conjugacy[t] * (d - h);
                pins[t] = (weight, fourfold(cross.bisector));
            }
        }
        for &(t, angle, weight) in &self.soft {
            let conjugate = if self.flat[t] { None } else { self.forms[t].conjugate(angle) };
            let mut cross = Cross::from_angles(angle, conjugate.unwrap_or(angle + FRAC_PI_2));
            if cross.crossing() < self.floor {
                cross = Cross::from_angles(angle, angle + FRAC_PI_2);
            }
            attraction[t].0 += weight;
            attraction[t].1 += fourfold(cross.bisector) * weight;
        }
        for t in 0..count {
            // The tiny rest keeps a surface without any attraction (a plane) solvable.
            let weight = attraction[t].0 + pins[t].0 + 1e-9;
            system.add_diagonal(t, 0, 0, weight);
            system.add_diagonal(t, 1, 1, weight);
        }
        for e in self.inner_edges() {
            let pair = self.edges.triangles[e];
            let w = self.edge_weights[e];
            for t in pair {
                system.add_diagonal(t as usize, 0, 0, w);
                system.add_diagonal(t as usize, 1, 1, w);
            }
            // p_g = exp(4 i turn) p_f
            let (sin, cos) = (4.0 * self.frames.turns[e]).sin_cos();
            system.add_off_diagonal(e, pair, 0, 0, -w * cos);
            system.add_off_diagonal(e, pair, 0, 1, -w * sin);
            system.add_off_diagonal(e, pair, 1, 0, w * sin);
            system.add_off_diagonal(e, pair, 1, 1, -w * cos);
        }
        control.check()?;
        let factor = system.factorize("smooth field")?;
        let mut crosses = vec![];
        for _ in 0..INITIAL_ROUNDS {
            control.check()?;
            let mut p = Vec::with_capacity(2 * count);
            for t in 0..count {
                let sum = attraction[t].1 + pins[t].1 * pins[t].0;
                p.extend([sum.re, sum.im]);
            }
            // Without any attraction the smoothest field would be 0: one direction to spread.
            p[0] += 1e-9;
            factor.solve(&mut p);
            crosses = (0..count).map(|t| self.attach(t, 0.25 * p[2 * t + 1].atan2(p[2 * t]))).collect::<Vec<_>>();
            // The next pins sit where the field itself meets the conjugate crosses.
            for (pin, cross) in pins.iter_mut().zip(&crosses) {
                pin.1 = fourfold(cross.bisector);
            }
        }
        Ok(crosses)
    }
}
