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

/// Most multiplier updates for each factorization; each gains a factor of about `PENALTY` over the stiffest soft weight.
const UPDATES: usize = 3;

/// Change of the step, as a share of its length, by a multiplier update below which no other follows.
const SETTLED: f64 = 1e-2;

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
    /// Of each vertex; 0 for those that are held.
    pub(super) lengths: Vec<f64>,
}

impl Step {
    /// What four of five of the given vertices stay below.
    pub(super) fn typical(&self, vertices: &[u32]) -> f64 {
        let mut lengths: Vec<f64> = vertices.iter().map(|&v| self.lengths[v as usize]).collect();
        let place = lengths.len() * 4 / 5;
        if lengths.is_empty() { 0.0 } else { *lengths.select_nth_unstable_by(place, f64::total_cmp).1 }
    }
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
        let mut step = vec![Vector3::zeros(); self.vertices.len()];
        for (face, equation) in self.input.mesh.faces().zip(&system.equations) {
            let Some(equation) = equation else { continue };
            let corners: Vec<_> = face.iter().map(|&v| self.vertices[v as usize].coords / self.edge).collect();
            let Some(now) = FaceEquations::new(&corners) else { continue };
            for (&v, residual) in face.iter().zip(&now.residual) {
                step[v as usize] -= equation.normal * (PENALTY * residual * now.normal.dot(&equation.normal).signum());
            }
        }
        self.unknowns.solve(&system.factor, &mut step);
        for (point, s) in self.vertices.iter_mut().zip(step) {
            *point += s * self.edge;
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
        let gradient = self.soft_terms(phase);

        let penalty = if let Phase::Penalty(penalty) = phase { penalty } else { PENALTY };
        let mut equations = Vec::with_capacity(mesh.face_count());
        for (f, face) in mesh.faces().enumerate() {
            if self.freed[f] || !self.unknowns.moves_any(face) {
                equations.push(None);
                continue;
            }
            let corners: Vec<_> = face.iter().map(|&v| self.vertices[v as usize].coords / self.edge).collect();
            let equation = FaceEquations::new(&corners);
            if let Some(equation) = &equation {
                let block = equation.normal * equation.normal.transpose() * penalty;
                for i in 0..face.len() {
                    for j in 0..=i {
                        self.unknowns.add(face[i], face[j], &(block * equation.projector[i * face.len() + j]));
                    }
                }
                // Only what the present equations can transmit.
                self.multipliers[f] = product(&equation.projector, &self.multipliers[f]);
            }
            equations.push(equation);
        }
        let factor = self.unknowns.factorize()?;

        let mut step = vec![Vector3::zeros(); self.vertices.len()];
        for update in 0..UPDATES {
            let before = step;
            step = gradient.iter().map(|g| -g).collect();
            for (f, face) in mesh.faces().enumerate() {
                let Some(equation) = &equations[f] else { continue };
                for (k, &v) in face.iter().enumerate() {
                    step[v as usize] -= equation.normal * (self.multipliers[f][k] + penalty * equation.residual[k]);
                }
            }
            self.unknowns.solve(&factor, &mut step);
            if matches!(phase, Phase::Penalty(_)) {
                break;
            }
            for (f, face) in mesh.faces().enumerate() {
                let Some(equation) = &equations[f] else { continue };
                let moved: Vec<f64> = face.iter().map(|&v| equation.normal.dot(&step[v as usize])).collect();
                for (k, change) in product(&equation.projector, &moved).into_iter().enumerate() {
                    self.multipliers[f][k] += penalty * (equation.residual[k] + change);
                }
            }
            if update > 0 && is_settled(&before, &step) {
                break;
            }
        }

        let longest = step.iter().map(|s| s.norm()).fold(0.0, f64::max);
        if !longest.is_finite() {
            return Err(Error::Degenerate { reason: "a planarization step is not finite".into() });
        }
        // Neighbours that move together keep their panels' shapes, and may move farther.
        let strain = self.edges.iter().map(|&[a, b]| (step[a as usize] - step[b as usize]).norm()).fold(0.0, f64::max);
        let scale = self.edge * (LONGEST_STEP / longest.min(strain.max(longest * JOINT_STEP))).min(1.0);
        for (point, s) in self.vertices.iter_mut().zip(&step) {
            *point += s * scale;
        }
        Ok((Step { longest, lengths: step.iter().map(|s| s.norm()).collect() }, System { factor, equations }))
    }

    /// Fills the matrix with the soft terms' Hessian and returns their gradient, both in units of the mean edge.
    pub(super) fn soft_terms(&mut self, phase: Phase) -> Vec<Vector3<f64>> {
        let options = self.options;
        let mut gradient = vec![Vector3::zeros(); self.vertices.len()];
        self.unknowns.clear();
        let with_gradient = phase != Phase::Project;
        for k in 0..self.unknowns.vertices().len() {
            let vertex = self.unknowns.vertices()[k];
            let v = vertex as usize;
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
            self.unknowns.add(vertex, vertex, &(block + Matrix3::identity() * anchor));
            if with_gradient {
                let offset = (self.vertices[v] - foot.point) / self.edge;
                let drift = (self.vertices[v] - self.input.mesh.vertices[v]) / self.edge;
                gradient[v] += block * offset + drift * anchor;
            }
        }
        for (&[v, w], stiffness) in self.edges.iter().zip(&self.stiffness) {
            if !self.unknowns.moves_any(&[v, w]) {
                continue;
            }
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
            self.unknowns.add(v, v, &block);
            self.unknowns.add(w, w, &block);
            self.unknowns.add(w, v, &-block);
            if with_gradient {
                gradient[v as usize] -= change;
                gradient[w as usize] += change;
            }
        }
        for sum in &self.angle_sums {
            let corners = sum.angles.as_flattened();
            if !self.unknowns.moves_any(corners) {
                continue;
            }
            let Some((value, gradients)) = sum.evaluate(&self.vertices) else { continue };
            for (&v, g) in corners.iter().zip(gradients.as_flattened()) {
                let scaled = g * (options.offset_weight * self.edge);
                for (&w, h) in corners.iter().zip(gradients.as_flattened()).filter(|(w, _)| **w <= v) {
                    self.unknowns.add(v, w, &(scaled * (h * self.edge).transpose()));
                }
                if with_gradient {
                    gradient[v as usize] += scaled * value;
                }
            }
        }
        for term in &self.feature_terms {
            if !self.unknowns.moves_any(&term.corners) {
                continue;
            }
            let mut slip = 0.0;
            for (&v, c) in term.corners.iter().zip(term.factors) {
                slip += term.across.dot(&self.vertices[v as usize].coords) * c / self.edge;
            }
            let block = term.across * term.across.transpose();
            for (i, &v) in term.corners.iter().enumerate() {
                for (j, &w) in term.corners.iter().enumerate().filter(|(_, w)| **w <= v) {
                    self.unknowns.add(v, w, &(block * (term.weight * term.factors[i] * term.factors[j])));
                }
                if with_gradient {
                    gradient[v as usize] += term.across * (term.weight * term.factors[i] * slip);
                }
            }
        }
        for triple in self.input.polylines {
            if options.fairness == 0.0 || !self.unknowns.moves_any(triple) {
                continue;
            }
            let factors = [1.0, -2.0, 1.0];
            let mut change = Vector3::zeros();
            for (&v, c) in triple.iter().zip(factors) {
                change += (self.vertices[v as usize] - self.input.mesh.vertices[v as usize]) * (c / self.edge);
            }
            for (i, &v) in triple.iter().enumerate() {
                for (j, &w) in triple.iter().enumerate().take(i + 1) {
                    // A pair of places held by one vertex counts in both orders.
                    let twice = if i != j && v == w { 2.0 } else { 1.0 };
                    let block = Matrix3::identity() * (options.fairness * factors[i] * factors[j] * twice);
                    self.unknowns.add(v, w, &block);
                }
                if with_gradient {
                    gradient[v as usize] += change * (options.fairness * factors[i]);
                }
            }
        }
        gradient
    }
}

/// Whether the step of one solution is that of the one before.
fn is_settled(before: &[Vector3<f64>], after: &[Vector3<f64>]) -> bool {
    let largest = |lengths: &mut dyn Iterator<Item = f64>| lengths.fold(0.0, f64::max);
    let change = largest(&mut before.iter().zip(after).map(|(a, b)| (a - b).norm()));
    change <= SETTLED * largest(&mut after.iter().map(|s| s.norm()))
}
