//! The search for a planar mesh that is sound and close: which rounds, with which weights, and what to give up where there is none.

use super::newton::{LONGEST_STEP, Phase, Step};
use super::soundness::Spoiled;
use super::state::{STALE, State};
use crate::control::Control;
use crate::error::Error;
use crate::mesh::border_trace::BorderTrace;
use nalgebra::Point3;

/// A step shorter than this, in mean edge lengths, ends the search for the best compromise of the soft terms.
const STEP_TOLERANCE: f64 = 2e-3;

/// The same of four of five vertices, in widths of the mesh: from then on only the others and those that strain the limits move, with what is around
/// them.
const TYPICAL_STEP: f64 = 2e-4;

/// Faces around those that move with them, and as many more with each attempt.
const RINGS: usize = 6;

/// Bound of closeness and border weights where they grow; stiffer ones slow the multipliers down.
const LARGEST_WEIGHT: f64 = 1e5;

/// Bound of the factor on the anchor weight of vertices on the border.
const LARGEST_HOLD: f64 = 1e5;

/// Step, in mean edge lengths, below which weights may grow before the search has settled.
const GROWTH_STEP: f64 = 0.3;

/// The same of four of five vertices.
const TYPICAL_GROWTH_STEP: f64 = 0.1;

/// Share of the largest strain before one round that is left after it where it falls by itself.
const FALLING: f64 = 0.8;

/// Rounds in a row that are kept from going their way by the same face, after which the next attempt has to do something about it.
const STUCK_ROUNDS: usize = 5;

/// Most steps towards planarity with one factorization.
const CORRECTIONS: usize = 4;

/// How often weights may grow in one search.
const GROWTHS: usize = 8;

/// Most attempts at a planar mesh that turns no face over and collapses no edge.
const ATTEMPTS: usize = 9;

/// Newton rounds of the first attempt in search of the best compromise of the soft terms, and of each later one, which goes on from there.
const BALANCE_ROUNDS: [usize; 2] = [40, 12];

/// Planarity that the projection reaches wherever nothing is in its way.
const PLANAR: f64 = 1e-10;

/// How often a step that would spoil the mesh is halved where it does, before it is left out there.
const HALVINGS: usize = 2;

/// How often a step is shortened in all, each time where it still would spoil the mesh, before it is left out everywhere.
const SHORTENINGS: usize = 12;

/// Attempts that answer a turned face or a collapsed edge by stiffer edges; later ones give up the planarity of faces there.
const STIFFENINGS: usize = 1;

/// Attempts to draw in a planar mesh that strays too far; all but the first let faces be split.
const DRAWN_IN: usize = 5;

/// Of these, how many pass before any face there is let off, where that is allowed.
const RESORT: usize = 3;

/// Factor on the stretch weight of all edges, for each attempt that failed.
const STIFFENING: f64 = 2.0;

impl State<'_> {
    /// Answers to a spoiled mesh, the milder ones first: stiffer edges, there above all; then faces there that need not be
    /// planar because they may be split; where those do not help and any may be split, the spoiled ones.
    fn repair(&mut self, spoiled: &Spoiled, attempt: usize) {
        self.stiffen(spoiled, STIFFENING);
        if attempt >= STIFFENINGS {
            let mut faces = self.faces_at(&self.edges_of(spoiled));
            faces.retain(|&f| self.may_split[f]);
            if self.options.split_beyond.is_some() && faces.iter().all(|&f| self.freed[f]) {
                faces.clone_from(&spoiled.faces);
            }
            faces.iter().for_each(|&f| self.freed[f] = true);
        }
    }

    /// Lets faces off being planar that may be split, or any as a last resort, and have a corner farther from the reference than it should be.
    fn release_strained(&mut self, any: bool) {
        let strains = self.strains();
        let any = any && self.options.split_beyond.is_some();
        for (f, face) in self.input.mesh.faces().enumerate() {
            self.freed[f] |= (any || self.may_split[f]) && face.iter().any(|&v| strains[v as usize] > 1.0);
        }
    }

    fn restart(&mut self) {
        self.vertices.clone_from(&self.input.mesh.vertices);
        self.multipliers.iter_mut().for_each(|m| m.fill(0.0));
        self.emphasis.fill(1.0);
        self.drawn.fill(false);
        self.hold.fill(1.0);
        self.refresh(0.0);
    }

    /// Attempts at a planar mesh that covers its border; if none is sound or close enough, more cautious ones that may leave bends of the border
    /// behind; at last the compromise.
    pub(super) fn run(&mut self, control: &Control) -> Result<(), Error> {
        if self.unknowns.vertices().is_empty() || self.attempts(control)? {
            return Ok(());
        }
        self.border_trace = BorderTrace::default();
        self.is_cautious = true;
        self.stiffness.fill(1.0);
        self.freed.fill(false);
        self.restart();
        if self.attempts(control)? {
            return Ok(());
        }
        self.compromise(control)
    }

    /// Searches and projects, again with other weights where that spoils the mesh or strays too far. Whether the vertices are a planar mesh within the
    /// allowance now.
    fn attempts(&mut self, control: &Control) -> Result<bool, Error> {
        let end = self.rounds + self.options.rounds;
        // The planar mesh that strays least, how far it does, and the faces that need not be planar there.
        let mut best: Option<(f64, Vec<Point3<f64>>, Vec<bool>)> = None;
        let mut strayed = 0;
        for attempt in 0..ATTEMPTS {
            self.balance((self.rounds + BALANCE_ROUNDS[attempt.min(1)]).min(end), control)?;
            if attempt == 0 {
                self.widen();
            }
            let sound = self.vertices.clone();
            self.project(control)?;
            let spoiled = self.spoiled(self.options.target);
            let strains = self.strains();
            let strain = strains.iter().copied().fold(0.0, f64::max);
            if spoiled.is_empty() {
                self.widen();
                if self.worst_planarity() > PLANAR {
                    self.project(control)?;
                }
                if best.as_ref().is_none_or(|b| strain < b.0) {
                    best = Some((strain, self.vertices.clone(), self.freed.clone()));
                }
                if strain <= 1.0 || strayed >= DRAWN_IN {
                    break;
                }
                for v in 0..self.vertices.len() {
                    self.drawn[v] |= self.strain(v) > 1.0;
                }
                if strayed > 0 {
                    self.release_strained(strayed >= RESORT);
                }
                strayed += 1;
            } else {
                self.repair(&spoiled, attempt);
            }
            let mut seeds: Vec<bool> = strains.into_iter().map(|strain| strain > 1.0).collect();
            self.vertices_of(&spoiled).into_iter().for_each(|v| seeds[v] = true);
            self.widen();
            self.focus(seeds, RINGS * (attempt + 1))?;
            for &v in self.unknowns.vertices() {
                self.vertices[v as usize] = sound[v as usize];
            }
            self.refresh(0.0);
        }
        self.widen();
        if let Some((_, vertices, freed)) = best {
            (self.vertices, self.freed) = (vertices, freed);
            self.refresh(0.0);
            return Ok(self.largest_deviation() <= self.options.allowance);
        }
        Ok(false)
    }

    /// One round after which no face is turned over and no edge collapsed that was not before: vertices there go a part of their way only, and
    /// the edges there become stiffer. Returns the longest step, in mean edges, and the faces that stayed where they were.
    fn sound_round(&mut self, control: &Control) -> Result<(Step, Vec<usize>), Error> {
        let before = self.vertices.clone();
        let (step, _) = self.round(Phase::Balance, control)?;
        let mut stuck = vec![];
        for shortening in 0..SHORTENINGS {
            let spoiled = self.spoiled(f64::INFINITY);
            if spoiled.is_empty() {
                break;
            }
            let share = if shortening < HALVINGS { 0.5 } else { 0.0 };
            if shortening < HALVINGS {
                self.stiffen(&spoiled, 1.0);
            } else if shortening == HALVINGS {
                stuck.clone_from(&spoiled.faces);
            }
            let there = if self.is_cautious { (0..self.vertices.len()).collect() } else { self.vertices_of(&spoiled) };
            for v in there {
                self.vertices[v] = before[v] + (self.vertices[v] - before[v]) * share;
            }
            if shortening + 1 == SHORTENINGS && !self.spoiled(f64::INFINITY).is_empty() {
                self.vertices.clone_from(&before);
            }
        }
        Ok((step, stuck))
    }

    /// Minimum of the soft terms under the constraints; where vertices leave the allowed deviation, their weights grow.
    fn balance(&mut self, end: usize, control: &Control) -> Result<(), Error> {
        let (mut shortest, mut idle, mut growths) = (f64::INFINITY, 0, 0);
        let mut last_strain = 0.0;
        let near = TYPICAL_STEP * self.width / self.edge;
        // Faces that kept all rounds so far from going their way, and how many.
        let (mut stuck, mut stuck_for) = (vec![], 0);
        while self.rounds < end {
            let (step, faces) = self.sound_round(control)?;
            let (longest, typical) = (step.longest, step.typical(self.unknowns.vertices()));
            let same: Vec<usize> = faces.iter().copied().filter(|f| stuck.contains(f)).collect();
            (stuck, stuck_for) = if same.is_empty() { (faces, 0) } else { (same, stuck_for + 1) };
            if stuck_for >= STUCK_ROUNDS && !self.is_cautious {
                break;
            }
            // Closest points on a reference of flat triangles jump: then steps stay small without shrinking.
            idle = if longest > (0.9 * shortest).max(shortest - 0.3 * LONGEST_STEP) { idle + 1 } else { 0 };
            let is_settled =
                longest < STEP_TOLERANCE || (longest > 0.7 * shortest && longest < 50.0 * STEP_TOLERANCE) || idle > 3;
            shortest = shortest.min(longest);
            if !is_settled && longest > GROWTH_STEP && typical > TYPICAL_GROWTH_STEP {
                continue;
            }
            self.refresh(STALE);
            let strains = self.strains();
            if self.whole.is_none() && typical < near {
                let moves = step.lengths.iter().zip(&strains).map(|(step, strain)| *step > near || *strain > 0.9);
                if self.focus(moves.collect(), RINGS)? {
                    (shortest, idle, last_strain) = (f64::INFINITY, 0, 0.0);
                    continue;
                }
            }
            // A strain that still falls by itself needs no more weight.
            let strain = self.unknowns.vertices().iter().map(|&v| strains[v as usize]).fold(0.0, f64::max);
            let stays = strain > 0.9 && (is_settled || strain > FALLING * last_strain && last_strain > 0.0);
            last_strain = strain;
            if stays && growths < GROWTHS && self.rounds + 3 < end {
                self.grow();
                growths += 1;
            } else if is_settled || strain <= 0.9 && typical < near {
                break;
            }
        }
        self.refresh(STALE);
        Ok(())
    }

    /// More weight for vertices that strain the limits, so that they end within them.
    fn grow(&mut self) {
        let largest = [self.options.closeness, self.options.border].map(|w| (LARGEST_WEIGHT / w).max(1.0));
        let growth = |strain: f64| (strain / 0.7).powi(2).clamp(1.0, 30.0);
        let gaps = self.border_trace.strains(&self.vertices);
        for (v, gap) in gaps.into_iter().enumerate() {
            let bound = largest[usize::from(self.on_border[v])];
            self.emphasis[v] = (self.emphasis[v] * growth(self.strain(v))).min(bound);
            self.hold[v] = (self.hold[v] * growth(gap)).min(LARGEST_HOLD);
        }
    }

    /// Planar and close contradict each other: the stiffest penalty that keeps within the deviation.
    fn compromise(&mut self, control: &Control) -> Result<(), Error> {
        self.restart();
        self.freed.fill(false);
        let mut best = (self.vertices.clone(), self.worst_planarity());
        for penalty in [1.0, 1e1, 3e1, 1e2, 3e2, 1e3, 3e3, 1e4] {
            for _ in 0..6 {
                if self.round(Phase::Penalty(penalty), control)?.0.longest < STEP_TOLERANCE {
                    break;
                }
            }
            self.refresh(0.0);
            if self.largest_deviation() > 1.0 || !self.spoiled(f64::INFINITY).is_empty() {
                break;
            }
            let worst = self.worst_planarity();
            if worst < best.1 {
                best = (self.vertices.clone(), worst);
            }
        }
        self.vertices = best.0;
        self.refresh(0.0);
        Ok(())
    }

    /// Rounds of projection until the residuals are at rounding level.
    fn project(&mut self, control: &Control) -> Result<(), Error> {
        let mut best = (self.vertices.clone(), self.worst_planarity());
        // The soft terms' forces, which the multipliers hold up, are gone now.
        let multipliers = self.multipliers.clone();
        self.multipliers.iter_mut().for_each(|m| m.fill(0.0));
        for _ in 0..8 {
            if best.1 <= 1e-12 {
                break;
            }
            let (step, system) = self.round(Phase::Project, control)?;
            let worst = self.worst_planarity();
            if worst >= 0.5 * best.1 && step.longest < LONGEST_STEP {
                if worst < best.1 {
                    best = (self.vertices.clone(), worst);
                }
                break;
            }
            best = (self.vertices.clone(), worst);
            for _ in 0..CORRECTIONS {
                if best.1 <= 1e-12 || step.longest > LONGEST_STEP {
                    break;
                }
                self.correct(&system);
                let corrected = self.worst_planarity();
                let converges = corrected < 0.3 * best.1;
                if corrected < best.1 {
                    best = (self.vertices.clone(), corrected);
                }
                if !converges {
                    break;
                }
            }
            self.vertices.clone_from(&best.0);
        }
        self.multipliers = multipliers;
        self.vertices = best.0;
        self.refresh(0.0);
        Ok(())
    }
}
