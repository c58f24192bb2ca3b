//! Gauss-Newton refinement of a control net until its surface obeys the sketch.
//!
//! Everything is in the canonical frame: x right, y up, z towards the viewer, depth = -z.

mod facing;
mod grid_sample;
mod model;
mod report;
mod samples;
mod solve;
mod strokes;
#[cfg(test)]
mod tests;

pub use report::RefineReport;

use super::knots::KnotVector;
use super::layer_map::MapSide;
use super::nurbs::NurbsSurface;
use super::silhouette::Polyline;
use super::targets::SurfaceTargets;
use super::tensor::{Banded, FastDiagonal, GridAxis, GridPlanes, TensorGrid, gram};
use crate::control::Control;
use crate::error::Error;
use nalgebra::{DMatrix, Point3};
use rayon::prelude::*;

/// What the host can choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineOptions {
    /// Smoothness against detail: 1 is balanced, 10 irons out small waves, 0.1 follows the depth maps closely.
    pub fairness: f64,
    /// How strongly the result stays at the start where nothing else is known: 1 is weak, 100 moves only what it must.
    pub closeness: f64,
    /// Gauss-Newton steps, at most, and up to eight more while the surface folds over; 0 leaves the start as it is.
    pub iterations: usize,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { fairness: 1.0, closeness: 1.0, iterations: 12 }
    }
}

/// A refined surface and its diagnostics.
#[derive(Clone, Debug)]
pub struct Refined {
    /// Same knots as the start.
    pub surface: NurbsSurface,
    /// How well it obeys.
    pub report: RefineReport,
}

/// Samples in each direction: 1.5 a knot span for 30 control points, enough since fairness ties neighbours; 48 gave the same
/// surfaces a third slower.
const GRID: usize = 40;

// Weights. All data terms are means over the patch or over a stroke, in canonical units squared, so that they do not
// depend on the sampling; depth is the unit.

/// Normals: sine of the angle to the map's normal, squared. A degree counts like 0.5 % of a unit of depth: normals tell the
/// shape within a few pixels, depth over longer distances.
const NORMAL_WEIGHT: f64 = 0.1;
/// Border strokes, mean over each side: they are what the architect drew, the maps are guesses. With map errors near 0.05
/// this leaves about a tenth of that at the border, a fifth of a pixel.
const BORDER_WEIGHT: f64 = 20.0;
/// Distance of the places that are looked at, map pixels.
const COVERING_STEP: f64 = 0.5;
/// Fairness: integrals of S_uuu^2 + S_vvv^2 over the unit square. The third derivative does not flatten domes as the
/// second does. Waves beyond about five a side are damped: 1 / (2 pi 4.5)^6 = 2e-9.
const FAIRNESS_WEIGHT: f64 = 2e-9;
/// Evenness of the parametrization: integrals of the squared slopes of the displacement from the start, in x and y.
const EVENNESS_WEIGHT: f64 = 3e-3;
/// The same in z, only against drift where no map is valid.
const EVENNESS_DEPTH_WEIGHT: f64 = 1e-5;
/// Closeness to the start, mean squared displacement.
const CLOSENESS_WEIGHT: f64 = 1e-4;
/// Another guess of the surface, at the same parameters: mean squared distance, as much as the maps' depth. On 300 held-out sketches the
/// errors of BSR-Net's surface and of the refined one (guess at its depth alone) correlate by 0.99 in level, tilt and scale and by 0.91 in the
/// rest: their best mixture would lower D_c by 1.5 %, and what a guess gains is that few cases get worse.
const GUESS_WEIGHT: f64 = 1.0;
/// The same for its tangents, integrals of the squared slopes of the difference over the unit square: about twice what the maps' normals count.
const GUESS_SLOPE_WEIGHT: f64 = 3e-3;
/// Factor on the evenness in the first step; each later step divides it by 8.
const FIRST_STIFFNESS: f64 = 64.0;
/// Gauss-Newton steps beyond the host's number that are taken where folds remain.
const UNFOLDING_ROUNDS: usize = 8;
/// Factor on the weight of facing in each step that begins with folds after the rest has converged, and the highest.
const FACING_GROWTH: f64 = 8.0;
const HIGHEST_FACING: f64 = 512.0;
/// A relative decrease of the energy below this ends the iteration.
const CONVERGED: f64 = 2e-2;

/// Moves the control net of `start` until the surface obeys `targets`.
///
/// Minimizes, by Gauss-Newton with footpoints and layers found anew at every step:
/// tangent-plane distance to the depth maps (orientation decides the layer), angles to their normals, the side that faces the
/// viewer where the sketch draws one side alone, distance of the
/// border to its strokes and corners, distance of the silhouette to the contour strokes, depth samples on their lines of
/// sight, another guess of the surface if there is one, the third derivatives of the surface, unevenness of the parametrization, and the distance from the start.
/// Steps are accepted only if the energy falls, and where folds remain the side that the sketch shows counts more and more:
/// of all steps the last with the fewest folds is the result, so it is never worse than the start.
///
/// The silhouette needs no equation for n . view = 0: it is found on the current surface, and moving the surface along
/// the projected normal m moves its silhouette by m . dS to first order, since the apparent contour is an envelope.
///
/// - `start`: cubic, not rational, canonical frame, S_u x S_v to the front, sides as [`super::coons_net`].
///
/// # Errors
/// [`Error::Nurbs`] if `start` is rational or not cubic, [`Error::Degenerate`] if corners are out of order or the maps are
/// empty, [`Error::Argument`] for bad options, [`Error::Cancelled`].
///
/// Feature lines have no term of their own; the networks read them. They are conjugate, and to be so is linear in the depth h over the
/// canvas, a^T H b = 0 with the second derivatives H of h, so that it could be asked for. At every pixel of 60 held-out depth maps it takes
/// away 12 % of the error (without the free parameters of depth) if a and b are the true directions, and 2 % if they are CDF-Net's. Feature
/// lines alone know them at 19 crossings on 14 of 60 sketches.
///
/// # Source
/// Sketch2PQ, Sec. 3.2.3, fits depth maps alone, with second differences of the inner control rows as fairness.
pub fn refine(
    start: &NurbsSurface,
    targets: &SurfaceTargets,
    options: &RefineOptions,
    control: &Control,
) -> Result<Refined, Error> {
    refine_best(std::slice::from_ref(start), targets, options, control)
}

/// [`refine`] from the one of several starts, all on the same knots, that has the least energy; the first of equals.
///
/// # Errors
/// As [`refine`]; [`Error::Degenerate`] without a start, [`Error::Nurbs`] for different knots.
pub fn refine_best(
    starts: &[NurbsSurface],
    targets: &SurfaceTargets,
    options: &RefineOptions,
    control: &Control,
) -> Result<Refined, Error> {
    let first = starts.first().ok_or_else(|| Error::Degenerate { reason: "refinement has no start".into() })?;
    Refiner::new(first.knots(), targets, options)?.run_best(starts, control)
}

/// What stays the same through the iterations.
pub(super) struct Refiner<'a> {
    targets: &'a SurfaceTargets,
    iterations: usize,
    knots: [KnotVector; 2],
    grid: TensorGrid,
    /// Trapezoid weights of the grid in u and v, each summing to 1.
    quadrature: [Vec<f64>; 2],
    /// Visible front, visible back, occluded front, occluded back.
    map_sides: [MapSide; 4],
    /// For each map pixel 1 where only the front is drawn, -1 where only the back is, 0 where both are or a contour is near.
    drawn_facing: Vec<f64>,
    strokes: [Polyline; 4],
    stroke_occluded: [Vec<bool>; 4],
    /// For each stroke point the side that the surface shows at the border, 1 or -1, where a contour beside it tells, else 0.
    stroke_facing: [Vec<f64>; 4],
    contours: Vec<Contour>,
    start: Vec<f64>,
    /// Arc-length shares of the start's border samples on each side.
    shares: [Vec<f64>; 4],
    mass: [Banded; 2],
    fairness: [Banded; 2],
    /// Evenness and closeness, for x and y, and for z.
    evenness: [[Banded; 2]; 2],
    /// The other guess: its net.
    guess: Option<Vec<f64>>,
    guessed: [Banded; 2],
    /// Factor on evenness: high in the first steps, and where the parametrization would fold.
    stiffness: f64,
    /// Factor on the weight of facing: high where folds remain.
    facing: f64,
    /// Factor on the weights of the contours.
    pub(super) insistence: f64,
    /// Fairness plus evenness times stiffness, for x and y, and for z.
    regularity: [[Banded; 2]; 2],
    preconditioner: [FastDiagonal; 2],
}

/// A contour stroke.
struct Contour {
    line: Polyline,
    /// The side of its normals (1 or -1) on which the surface lies.
    side: f64,
    /// Places of the stroke, evenly spaced, that the silhouette should cover: not those along the border, see [`ALONG_BORDER`].
    places: Vec<[f64; 2]>,
}

impl<'a> Refiner<'a> {
    /// All that does not depend on the start; [`Refiner::run_best`] follows.
    pub(super) fn new(
        knots: &[KnotVector; 2],
        targets: &'a SurfaceTargets,
        options: &RefineOptions,
    ) -> Result<Self, Error> {
        for (name, value) in [("fairness", options.fairness), ("closeness", options.closeness)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::Argument {
                    name,
                    value: value.to_string(),
                    expected: "a finite number, at least 0",
                });
            }
        }
        let knots = knots.clone();
        if knots.iter().any(|k| k.degree() != 3) {
            return Err(Error::Nurbs { reason: "refinement takes a cubic surface".into() });
        }
        let border = &targets.border;
        let sides: [Vec<usize>; 4] = [0, 1, 2, 3].map(|k| border.side(targets.corners, k));
        if sides.iter().map(|side| side.len() - 1).sum::<usize>() != border.points.len() {
            return Err(Error::Degenerate { reason: format!("border corners {:?} are out of order", targets.corners) });
        }
        let strokes = sides.each_ref().map(|side| Polyline::new(side.iter().map(|&i| border.points[i])));
        if strokes.iter().any(|stroke| stroke.points.len() < 2) {
            return Err(Error::Degenerate { reason: "a side of the border has no length".into() });
        }
        let maps = targets.maps.meeting(&targets.samples);
        let map_sides =
            [maps.visible.side(true), maps.visible.side(false), maps.occluded.side(true), maps.occluded.side(false)];
        if map_sides.iter().all(MapSide::is_empty) {
            return Err(Error::Degenerate { reason: "the depth maps are empty".into() });
        }
        let stroke_occluded = sides.each_ref().map(|side| side.iter().map(|&i| border.occluded[i]).collect());
        let grid = TensorGrid { axes: [GridAxis::even(&knots[0], GRID), GridAxis::even(&knots[1], GRID)] };
        let quadrature = [0, 1].map(|axis| {
            let n = grid.axes[axis].len();
            (0..n).map(|i| if i == 0 || i + 1 == n { 0.5 } else { 1.0 } / (n - 1) as f64).collect()
        });

        let [mass, slope, third] = [0, 1, 3].map(|order| [0, 1].map(|axis| gram(&knots[axis], order)));
        // Parameters may run over any domain: scale the derivatives to the unit square.
        let lengths = [0, 1].map(|axis: usize| {
            let [a, b] = knots[axis].domain();
            b - a
        });
        let mass = [0, 1].map(|axis: usize| &mass[axis] / lengths[axis]);
        let slope = [0, 1].map(|axis: usize| &slope[axis] * lengths[axis]);
        let third = [0, 1].map(|axis: usize| &third[axis] * lengths[axis].powi(5));
        let fairness = [0, 1].map(|axis: usize| &third[axis] * (FAIRNESS_WEIGHT * options.fairness));
        let closeness = CLOSENESS_WEIGHT * options.closeness;
        let evenness = [EVENNESS_WEIGHT, EVENNESS_DEPTH_WEIGHT]
            .map(|weight| [0, 1].map(|axis: usize| &slope[axis] * weight + &mass[axis] * (0.5 * closeness)));
        let guessed = if targets.guess.is_some() {
            [0, 1].map(|axis: usize| &mass[axis] * (0.5 * GUESS_WEIGHT) + &slope[axis] * GUESS_SLOPE_WEIGHT)
        } else {
            mass.each_ref().map(|mass| mass * 0.0)
        };
        // The preconditioner sees mean directions: in x and y borders act half, depth a fifth; in z depth acts mostly.
        let preconditioner = [(0.2, 0.5 * BORDER_WEIGHT, 0.2), (0.6, 0.1, 0.6)].map(|(depth, border, normal)| {
            let part = usize::from(border < 1.0);
            let bordered = [0, 1].map(|axis: usize| {
                let mut matrix = mass[axis].clone();
                let last = matrix.nrows() - 1;
                matrix[(0, 0)] += border / depth;
                matrix[(last, last)] += border / depth;
                matrix
            });
            let stiffness = [0, 1].map(|axis: usize| {
                &fairness[axis]
                    + &evenness[part][axis]
                    + &guessed[axis]
                    + &slope[axis] * (NORMAL_WEIGHT * normal * 0.02)
            });
            FastDiagonal::new([&stiffness[0], &stiffness[1]], [&bordered[0], &bordered[1]], depth)
                .expect("mass matrices of B-splines are positive definite")
        });
        let banded = |matrices: &[DMatrix<f64>; 2]| matrices.each_ref().map(|matrix| Banded::new(matrix, 3));
        let mut refiner = Self {
            targets,
            iterations: options.iterations,
            shares: Default::default(),
            mass: banded(&mass),
            fairness: banded(&fairness),
            guess: None,
            guessed: banded(&guessed),
            stiffness: 1.0,
            facing: 1.0,
            insistence: 1.0,
            regularity: Default::default(),
            evenness: evenness.each_ref().map(banded),
            preconditioner,
            knots,
            grid,
            quadrature,
            map_sides,
            drawn_facing: vec![],
            strokes,
            stroke_occluded,
            stroke_facing: Default::default(),
            contours: vec![],
            start: vec![],
        };
        refiner.guess = targets.guess.as_ref().map(|guess| refiner.net_of(guess)).transpose()?;
        refiner.stiffen(1.0);
        refiner.contours = targets
            .contours
            .iter()
            .map(|line| Polyline::new(line.iter().copied()))
            .filter(|line| line.points.len() > 1)
            .map(|line| {
                let step = COVERING_STEP * targets.maps.visible.pixel();
                let count = (line.length() / step).ceil().max(1.0) as usize;
                let places = (0..=count).map(|i| line.at(line.length() * i as f64 / count as f64));
                let places = places.filter(|p| !refiner.along_border(*p)).collect();
                Contour { side: refiner.inner_side(&line), line, places }
            })
            .collect();
        refiner.drawn_facing = refiner.draw_facing();
        refiner.stroke_facing = [0, 1, 2, 3].map(|k: usize| {
            let front: Vec<bool> = sides[k].iter().map(|&i| border.front[i]).collect();
            refiner.facing_along(&refiner.strokes[k], &front)
        });
        Ok(refiner)
    }

    /// Refines the start with the least energy.
    pub(super) fn run_best(&mut self, starts: &[NurbsSurface], control: &Control) -> Result<Refined, Error> {
        if starts.iter().any(|start| start.knots() != &self.knots || start.weights().is_some()) {
            return Err(Error::Nurbs { reason: "a start has weights, or other knots than the first".into() });
        }
        let mut best = None;
        for start in starts {
            self.begin(start);
            if starts.len() > 1 {
                let energy = self.linearize(&self.start).energy;
                if best.is_none_or(|(least, _)| energy < least) {
                    best = Some((energy, start));
                }
            }
        }
        if let Some((_, start)) = best {
            self.begin(start);
        }
        self.run(control)
    }

    /// Takes another start with the same knots.
    fn begin(&mut self, start: &NurbsSurface) {
        self.start = planes_of(start);
        let planes = self.planes(&self.start);
        self.shares = [0, 1, 2, 3].map(|side| Self::arc_shares(&planes, &self.side_samples(side)));
    }

    fn stiffen(&mut self, stiffness: f64) {
        self.stiffness = stiffness;
        self.regularity = [0, 1].map(|part: usize| {
            [0, 1].map(|axis: usize| {
                let smooth = self.fairness[axis].plus(&self.evenness[part][axis], stiffness);
                smooth.plus(&self.guessed[axis], 1.0)
            })
        });
    }

    /// The net of another guess.
    ///
    /// Not moved to the depth samples: where two of them lie close together an interpolation of their differences swings out far.
    fn net_of(&self, guess: &NurbsSurface) -> Result<Vec<f64>, Error> {
        if guess.knots() != &self.knots || guess.weights().is_some() {
            return Err(Error::Nurbs {
                reason: "another guess of the surface is on other knots than the start".into(),
            });
        }
        Ok(planes_of(guess))
    }

    fn run(&mut self, control: &Control) -> Result<Refined, Error> {
        let iterations = self.iterations;
        let mut net = self.start.clone();
        let mut model = self.linearize(&net);
        let first_energy = model.energy;
        // Far from the goal, steps are large: parameter lines first move like a membrane.
        self.stiffen(FIRST_STIFFNESS);
        self.regularize(&net, &mut model);
        let mut unfolding = false;
        // The net with the fewest folds, the latest of these: large steps may fold for a moment, the result must not.
        let mut flattest = (model.folds, net.clone());
        let mut taken = 0;
        let rounds = if iterations == 0 { 0 } else { iterations + UNFOLDING_ROUNDS };
        for round in 0..rounds {
            control.step("refine", (round as f64 / iterations as f64).min(1.0))?;
            let step = self.solve(&model, unfolding);
            let mut scale = 1.0;
            let accepted = loop {
                let candidate: Vec<f64> = net.iter().zip(&step).map(|(x, d)| x + scale * d).collect();
                let next = self.linearize(&candidate);
                if next.energy < model.energy {
                    break Some((candidate, next));
                }
                scale *= 0.4;
                if scale < 0.05 {
                    break None;
                }
            };
            taken += 1;
            let mut converged = accepted.is_none();
            if let Some((candidate, next)) = accepted {
                converged = next.energy > (1.0 - CONVERGED) * model.energy;
                (net, model) = (candidate, next);
            }
            if model.folds <= flattest.0 {
                flattest = (model.folds, net.clone());
            }
            if !unfolding && self.stiffness > 1.0 {
                self.stiffen((self.stiffness / 8.0).max(1.0));
                self.regularize(&net, &mut model);
                continue;
            }
            let done = converged || round + 1 >= iterations;
            if done && (model.folds == 0 || (converged && self.facing >= HIGHEST_FACING)) {
                break;
            }
            unfolding |= done;
            if unfolding && model.folds > 0 && self.facing < HIGHEST_FACING {
                self.facing *= FACING_GROWTH;
                model = self.linearize(&net);
            }
        }
        if model.folds > flattest.0 {
            net = flattest.1;
        }
        if self.stiffness > 1.0 || self.facing > 1.0 || model.folds > flattest.0 {
            self.facing = 1.0;
            self.stiffen(1.0);
            model = self.linearize(&net);
            if model.energy > first_energy {
                net.clone_from(&self.start);
                model = self.linearize(&net);
            }
        }
        let surface = self.surface(&net);
        let report = self.report(&surface, &net, &model, first_energy, taken);
        Ok(Refined { surface, report })
    }

    fn surface(&self, net: &[f64]) -> NurbsSurface {
        let n = net.len() / 3;
        let points = (0..n).map(|k| Point3::new(net[k], net[n + k], net[2 * n + k])).collect();
        NurbsSurface::new(self.knots.clone(), points, None).expect("accepted nets have finite energy")
    }

    fn planes(&self, net: &[f64]) -> [GridPlanes; 3] {
        let mut planes: [GridPlanes; 3] = Default::default();
        let nets = net.par_chunks_exact(net.len() / 3);
        planes.par_iter_mut().zip(nets).for_each(|(plane, net)| self.grid.forward(net, plane));
        planes
    }
}

fn planes_of(surface: &NurbsSurface) -> Vec<f64> {
    let points = surface.control_points();
    (0..3).flat_map(|c| points.iter().map(move |p| p[c])).collect()
}
