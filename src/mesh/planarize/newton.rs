//! One Newton round: the soft terms under the linearized planarity equations.

use super::face_equations::{FaceEquations, product};
use super::state::{STALE, State};
use crate::control::Control;
use crate::error::Error;
use crate::numeric::Cholesky;
use nalgebra::{Matrix3, Vector3};

/// Penalty on the squared constraint residuals, in units of the soft terms' weights; only the speed of the multiplier
/// updates depends on it. Smooth bends of a fine mesh hardly show in the residuals, by the fourth power of their length in
/// panels: 1e6 is too little for 30,000 faces.
const PENALTY: f64 = 1e8;

/// Multiplier updates for each factorization; each gains a factor of about `PENALTY` over the stiffest soft weight.
const UPDATES: usize = 3;

/// Longest step of a vertex against its neighbours in one round, in mean edge lengths.
pub(super) const LONGEST_STEP: f64 = 0.3;

/// How much less a step counts that a vertex makes together with its neighbours.
const JOINT_STEP: f64 = 0.15;

/// What a round aims at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Minimum of the soft terms under the constraints.
    Balance,
    /// The nearest planar mesh.
    Project,
    /// Minimum of soft terms plus this multiple of the squared residuals.
    Penalty(f64),
}

/// Lengths of the steps that the vertices asked for in one round, mean edges.
pub(super) struct Step {
    pub(super) longest: f64,
    /// Root mean square over all vertices.
    pub(super) typical: f64,
}

/// A factorized round: what small further steps towards planarity need.
pub(super) struct System {
    pub(super) factor: Cholesky,
    /// Those of each face that has any.
    pub(super) equations: Vec<Option<FaceEquations>>,
}

impl State<'_> {
    /// A step towards planarity with the factorization of a round before.
    pub(super) fn correct(&mut self, system: &System) {
        let mut step = vec![0.0; 3 * self.vertices.len()];
        for (face, equation) in self.input.mesh.faces().zip(&system.equations) {
            let Some(equation) = equation else { continue };
            let corners: Vec<_> = face.iter().map(|&v| self.vertices[v as usize].coords / self.edge).collect();
            let Some(now) = FaceEquations::new(&corners) else { continue };
            for (&v, residual) in face.iter().zip(&now.residual) {
                let force = equation.normal * (PENALTY * residual * now.normal.dot(&equation.normal).signum());
                (0..3).for_each(|a| step[3 * v as usize + a] -= force[a]);
            }
        }
        for v in (0..self.vertices.len()).filter(|&v| self.pinned[v]) {
            step[3 * v..3 * v + 3].fill(0.0);
        }
        system.factor.solve(&mut step);
        for (point, s) in self.vertices.iter_mut().zip(step.chunks_exact(3)) {
            *point += Vector3::from_row_slice(s) * self.edge;
        }
    }

    /// One Newton round; returns the step that it asked for and the system it solved.
    pub(super) fn round(&mut self, phase: Phase, control: &Control) -> Result<(Step, System), Error> {
        control.check()?;
        self.rounds += 1;
        if phase != Phase::Project {
            self.refresh(STALE);
        }
        let mesh = self.input.mesh;
        let count = self.vertices.len();
        let gradient = self.soft_terms(phase);

        let penalty = if let Phase::Penalty(penalty) = phase { penalty } else { PENALTY };
        let mut equations = Vec::with_capacity(mesh.face_count());
        for (f, face) in mesh.faces().enumerate() {
            let corners: Vec<_> = face.iter().map(|&v| self.vertices[v as usize].coords / self.edge).collect();
            let equation = if self.freed[f] { None } else { FaceEquations::new(&corners) };
            if let Some(equation) = &equation {
                let block = equation.normal * equation.normal.transpose() * penalty;
                for i in 0..face.len() {
                    for j in 0..=i {
                        if !self.pinned[face[i] as usize] && !self.pinned[face[j] as usize] {
                            self.matrix.add(face[i], face[j], &(block * equation.projector[i * face.len() + j]));
                        }
                    }
                }
                // Only what the present equations can transmit.
                self.multipliers[f] = product(&equation.projector, &self.multipliers[f]);
            }
            equations.push(equation);
        }
        let factor = self.symbolic.factorize(self.matrix.matrix(), "planarization")?;

        let mut step = vec![0.0; 3 * count];
        let updates = if matches!(phase, Phase::Penalty(_)) { 1 } else { UPDATES };
        for _ in 0..updates {
            step.iter_mut().zip(&gradient).for_each(|(s, g)| *s = -g);
            for (f, face) in mesh.faces().enumerate() {
                let Some(equation) = &equations[f] else { continue };
                for (k, &v) in face.iter().enumerate() {
                    let force = equation.normal * (self.multipliers[f][k] + penalty * equation.residual[k]);
                    (0..3).for_each(|a| step[3 * v as usize + a] -= force[a]);
                }
            }
            for v in (0..count).filter(|&v| self.pinned[v]) {
                step[3 * v..3 * v + 3].fill(0.0);
            }
            factor.solve(&mut step);
            if updates == 1 {
                break;
            }
            for (f, face) in mesh.faces().enumerate() {
                let Some(equation) = &equations[f] else { continue };
                let moved: Vec<f64> =
                    face.iter().map(|&v| (0..3).map(|a| equation.normal[a] * step[3 * v as usize + a]).sum()).collect();
                for (k, change) in product(&equation.projector, &moved).into_iter().enumerate() {
                    self.multipliers[f][k] += penalty * (equation.residual[k] + change);
                }
            }
        }

        let longest = step.chunks_exact(3).map(|s| Vector3::from_row_slice(s).norm()).fold(0.0, f64::max);
        if !longest.is_finite() {
            return Err(Error::Degenerate { reason: "a planarization step is not finite".into() });
        }
        // Neighbours that move together keep their panels' shapes, and may move farther.
        let at = |v: u32| Vector3::from_row_slice(&step[3 * v as usize..3 * v as usize + 3]);
        let strain = self.edges.iter().map(|&[a, b]| (at(a) - at(b)).norm()).fold(0.0, f64::max);
        let scale = self.edge * (LONGEST_STEP / longest.min(strain.max(longest * JOINT_STEP))).min(1.0);
        for (point, s) in self.vertices.iter_mut().zip(step.chunks_exact(3)) {
            *point += Vector3::from_row_slice(s) * scale;
        }
        let typical = (step.iter().map(|s| s * s).sum::<f64>() / count as f64).sqrt();
        Ok((Step { longest, typical }, System { factor, equations }))
    }

    /// Fills the matrix with the soft terms' Hessian and returns their gradient, both in units of the mean edge.
    pub(super) fn soft_terms(&mut self, phase: Phase) -> Vec<f64> {
        let options = self.options;
        let count = self.vertices.len();
        let mut gradient = vec![0.0; 3 * count];
        self.matrix.clear();
        let with_gradient = phase != Phase::Project;
        for v in 0..count {
            if self.pinned[v] {
                self.matrix.add(v as u32, v as u32, &Matrix3::identity());
                continue;
            }
            let foot = &self.feet[v];
            let d = foot.direction;
            let along = d * d.transpose();
            let block = if self.drawn[v] {
                let weight = if self.on_border[v] { options.border } else { options.closeness };
                Matrix3::identity() * (weight * self.emphasis[v])
            } else if self.on_border[v] {
                (Matrix3::identity() - along) * (options.border * self.emphasis[v])
            } else {
                along * (options.closeness * self.emphasis[v])
            };
            let anchor = self.anchors[v] * self.hold[v];
            self.matrix.add(v as u32, v as u32, &(block + Matrix3::identity() * anchor));
            if with_gradient {
                let offset = (self.vertices[v] - foot.point) / self.edge;
                let drift = (self.vertices[v] - self.input.mesh.vertices[v]) / self.edge;
                let g = block * offset + drift * anchor;
                (0..3).for_each(|a| gradient[3 * v + a] += g[a]);
            }
        }
        for (&[v, w], stiffness) in self.edges.iter().zip(&self.stiffness) {
            let (before, after) = (
                self.input.mesh.vertices[w as usize] - self.input.mesh.vertices[v as usize],
                self.vertices[w as usize] - self.vertices[v as usize],
            );
            // Strains count, so that slivers keep their shape. A collapsed edge would make its faces planar: shrinking edges are
            // held ever more firmly.
            let length = (before.norm() / self.edge).clamp(1e-2, 1.0);
            let left = (2.0 * after.norm() / before.norm().max(f64::MIN_POSITIVE)).clamp(1e-1, 1.0);
            let weight = options.stretch * stiffness / (length * left).powi(2);
            let change = (after - before) * (weight / self.edge);
            let block = Matrix3::identity() * weight;
            for (a, b, sign) in [(v, w, -1.0), (w, v, 1.0)] {
                if self.pinned[a as usize] {
                    continue;
                }
                self.matrix.add(a, a, &block);
                if a > b && !self.pinned[b as usize] {
                    self.matrix.add(a, b, &-block);
                }
                if with_gradient {
                    (0..3).for_each(|k| gradient[3 * a as usize + k] += sign * change[k]);
                }
            }
        }
        for sum in &self.angle_sums {
            let Some((value, gradients)) = sum.evaluate(&self.vertices) else { continue };
            for (&v, g) in sum.angles.as_flattened().iter().zip(gradients.as_flattened()) {
                if self.pinned[v as usize] {
                    continue;
                }
                let scaled = g * (options.offset_weight * self.edge);
                for (&w, h) in sum.angles.as_flattened().iter().zip(gradients.as_flattened()) {
                    if w <= v && !self.pinned[w as usize] {
                        self.matrix.add(v, w, &(scaled * (h * self.edge).transpose()));
                    }
                }
                if with_gradient {
                    (0..3).for_each(|a| gradient[3 * v as usize + a] += value * scaled[a]);
                }
            }
        }
        for term in &self.feature_terms {
            let mut slip = 0.0;
            for (&v, c) in term.corners.iter().zip(term.factors) {
                slip += term.across.dot(&self.vertices[v as usize].coords) * c / self.edge;
            }
            for (i, &v) in term.corners.iter().enumerate() {
                if self.pinned[v as usize] {
                    continue;
                }
                for (j, &w) in term.corners.iter().enumerate() {
                    if w <= v && !self.pinned[w as usize] {
                        let block = term.across * term.across.transpose();
                        self.matrix.add(v, w, &(block * (term.weight * term.factors[i] * term.factors[j])));
                    }
                }
                if with_gradient {
                    let g = term.across * (term.weight * term.factors[i] * slip);
                    (0..3).for_each(|a| gradient[3 * v as usize + a] += g[a]);
                }
            }
        }
        for triple in self.input.polylines {
            let factors = [1.0, -2.0, 1.0];
            let mut change = Vector3::zeros();
            for (&v, c) in triple.iter().zip(factors) {
                change += (self.vertices[v as usize] - self.input.mesh.vertices[v as usize]) * (c / self.edge);
            }
            for (i, &v) in triple.iter().enumerate().filter(|(_, v)| !self.pinned[**v as usize]) {
                for (j, &w) in triple.iter().enumerate().take(i + 1) {
                    if !self.pinned[w as usize] {
                        // A pair of places held by one vertex counts in both orders.
                        let twice = if i != j && v == w { 2.0 } else { 1.0 };
                        let block = Matrix3::identity() * (options.fairness * factors[i] * factors[j] * twice);
                        self.matrix.add(v, w, &block);
                    }
                }
            }
            if with_gradient {
                for (&v, c) in triple.iter().zip(factors).filter(|(v, _)| !self.pinned[**v as usize]) {
                    let g = change * (options.fairness * c);
                    (0..3).for_each(|a| gradient[3 * v as usize + a] += g[a]);
                }
            }
        }
        gradient
    }
}
