//! Gauss-Newton refinement of a control net until its surface obeys the sketch.
//!
//! Everything is in the canonical frame: x right, y up, z towards the viewer, depth = -z.

use super::knots::{Basis, KnotVector};
use super::layer_map::{EXTRAPOLATED_RINGS, MapSample, MapSide};
use super::nurbs::NurbsSurface;
use super::silhouette::{self, Polyline};
use super::targets::{Correction, LayerSample, SurfaceTargets};
use super::tensor::{Banded, FastDiagonal, GridAxis, GridPlanes, TensorGrid, gram};
use crate::control::Control;
use crate::error::Error;
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};

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

/// How well the refined surface obeys the sketch. Pixels are those of the 256 canvas.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RefineReport {
    /// Gauss-Newton steps taken.
    pub iterations: usize,
    /// Energy of the start and of the result; the second is never larger.
    pub energy: [f64; 2],
    /// Distance from the border strokes to the surface's projected border: mean and largest, pixels.
    pub border_px: [f64; 2],
    /// Distance from the contour strokes to the surface's silhouette, or, where a border stroke runs within a pixel of the contour, to
    /// the nearer of silhouette and border: mean and largest, pixels; zero without contours.
    pub contour_px: [f64; 2],
    /// Distance from the surface's silhouette to the nearest contour or border stroke: mean and largest, pixels; zero
    /// without silhouette. Large where the surface folds, or bulges over a stroke, without the sketch drawing it.
    pub silhouette_px: [f64; 2],
    /// Largest depth difference at a depth sample, canonical units.
    pub sample_residual: f64,
    /// Depth samples whose line of sight misses their layer.
    pub samples_missed: usize,
    /// Places where the surface turns from front to back, or back again, and the sketch draws no contour: counted along 40
    /// parameter lines in each direction, six pixels and more from the contour strokes, where both sides are clearly seen.
    pub folds: usize,
    /// Share of the surface whose side facing the viewer is not drawn there, by the regions of the sketch.
    pub misfacing: f64,
    /// Root mean square tangent-plane distance to the depth maps, canonical units.
    pub depth_rms: f64,
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
/// Pull along the stroke, as a share of the border's weight.
const SLIDING_WEIGHT: f64 = 0.005;
/// Pull back from beyond the end of a stroke, as a share of the border's weight.
const BEYOND_WEIGHT: f64 = 0.03;
/// Each corner.
const CORNER_WEIGHT: f64 = 5.0;
/// Silhouette to contour strokes, mean over the silhouette: takes away what the strokes do not show. More makes matters
/// worse: a strong pull on the few rows of control points at the fold bunches up their parameter lines.
const CONTOUR_WEIGHT: f64 = 0.5;
/// Contour strokes to silhouette, mean over the strokes: every part of a stroke is there. On 40 held-out folds 8 leaves
/// 0.36 px, 2 leaves 0.57.
const COVERING_WEIGHT: f64 = 8.0;
/// A contour this near to the border, in map pixels, one pixel of the 256 canvas: what lies between is too thin to be seen, so that
/// the border is the outline there as well as a silhouette would be. Pulling silhouettes there tore them from where they belong.
const ALONG_BORDER: f64 = 0.25;
/// Distance of the places that are looked at, map pixels.
const COVERING_STEP: f64 = 0.5;
/// Each depth sample.
const SAMPLE_WEIGHT: f64 = 5.0;
/// Parts of the surface that project outside the regions of their orientation, squared distance.
const OUTSIDE_WEIGHT: f64 = 0.3;
/// Fairness: integrals of S_uuu^2 + S_vvv^2 over the unit square. The third derivative does not flatten domes as the
/// second does. Waves beyond about five a side are damped: 1 / (2 pi 4.5)^6 = 2e-9.
const FAIRNESS_WEIGHT: f64 = 2e-9;
/// Evenness of the parametrization: integrals of the squared slopes of the displacement from the start, in x and y.
const EVENNESS_WEIGHT: f64 = 3e-3;
/// The same in z, only against drift where no map is valid.
const EVENNESS_DEPTH_WEIGHT: f64 = 1e-5;
/// Closeness to the start, mean squared displacement.
const CLOSENESS_WEIGHT: f64 = 1e-4;
/// Depth against another guess of the surface, at the same parameters, mean squared: as much as the maps' depth. Where the errors of two
/// guesses have little to do with each other, the middle is better than both.
const GUESS_WEIGHT: f64 = 1.0;
/// Depth residuals r beyond this, s, count less and less, 2 s^2 (1 - (1 + r^2 / s^2)^(-1/2)): maps are wrong by whole layers at
/// occlusions.
const ROBUST_DEPTH: f64 = 0.7;
/// Silhouette points farther than this from the contour strokes count less and less (Cauchy), canonical units: they may be
/// ripples of an unfinished surface.
const ROBUST_CONTOUR: f64 = 0.2;
/// Surface points whose unit normal has |z| below this may belong to a front or a back region.
const UNDECIDED: f64 = 0.15;
/// Share of a side by which a foot on its stroke may run ahead of, or lag behind, its arc length.
const FOOT_WINDOW: f64 = 0.12;
/// A silhouette row must not be steeper than this in depth.
const SAMPLE_STEEPEST: f64 = 0.2;
/// Factor on the evenness in the first step; each later step divides it by 8.
const FIRST_STIFFNESS: f64 = 64.0;
/// Gauss-Newton steps beyond the host's number that are taken where folds remain.
const UNFOLDING_ROUNDS: usize = 8;
/// Conjugate gradient steps for one of these: what unfolds is stiff, and the preconditioner does not know it.
const UNFOLDING_CG_STEPS: usize = 40;
/// Conjugate gradient steps for one Gauss-Newton step, and the share of the preconditioned residual that remains.
const CG_STEPS: usize = 14;
const CG_TOLERANCE: f64 = 0.1;
/// Samples whose (S_u x S_v).z / (|S_u| |S_v|) is nearer to 0 show neither side: they are seen edge-on, or a corner of the patch
/// lies where the outline is smooth, so that S_u and S_v are nearly parallel and the sign is noise.
const DECIDED: f64 = 0.05;
/// A turn from front to back this near to a contour stroke, in map pixels, is the crease that the stroke draws.
const CREASE_REACH: f64 = 1.5;
/// Parts of the surface whose side facing the viewer is not drawn there: square of what their facing lacks.
const FACING_WEIGHT: f64 = 1.0;
/// Factor on it in each step that begins with folds after the rest has converged, and the highest.
const FACING_GROWTH: f64 = 8.0;
const HIGHEST_FACING: f64 = 512.0;
/// The same for border samples beside a contour, where the sheet between the two may be too thin for the maps: the mean over the border
/// samples, so that a turn there costs more than smoothness saves.
const RIM_FACING_WEIGHT: f64 = 4.0;
/// A contour nearer than this, in map pixels, ends at the border.
const SLIVER_END: f64 = 0.1;
/// Facing that is asked for where one side alone is drawn: (S_u x S_v).z / (|S_u| |S_v|). Just enough that rounding and the
/// samples' distance leave no turn between them; steep places are no mistake.
const LEAST_FACING: f64 = 0.03;
/// Of two layers that show different sides the one tells the side that is nearer by this factor.
const NEARER: f64 = 0.3;
/// Marks map pixels where the sketch draws both sides, each on its layer.
const BOTH: f64 = 2.0;
/// A relative decrease of the energy below this ends the iteration.
const CONVERGED: f64 = 2e-2;

/// Moves the control net of `start` until the surface obeys `targets`.
///
/// Minimizes, by Gauss-Newton with footpoints and layers found anew at every step:
/// tangent-plane distance to the depth maps (orientation decides the layer), angles to their normals, the side that faces the
/// viewer where the sketch draws one side alone, distance of the
/// border to its strokes and corners, distance of the silhouette to the contour strokes, depth samples on their lines of
/// sight, the depth of another guess if there is one, the third derivatives of the surface, unevenness of the parametrization, and the distance from the start.
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
    /// The other guess: z of its net, corrected to the depth samples.
    guess: Option<Vec<f64>>,
    guessed: [Banded; 2],
    /// Factor on evenness: high in the first steps, and where the parametrization would fold.
    stiffness: f64,
    /// Factor on the weight of facing: high where folds remain.
    facing: f64,
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

/// The energy at one net and its quadratic model: half the gradient, and what its Gauss-Newton Hessian is made of.
struct Model {
    energy: f64,
    /// Energy and half its gradient without fairness, evenness and closeness.
    data: (f64, Vec<f64>),
    folds: usize,
    depth_squared: f64,
    gradient: Vec<f64>,
    /// Upper triangles xx, xy, xz, yy, yz, zz of the weight matrices on dS at the grid samples.
    weights: Vec<[f64; 6]>,
    /// Map normal and weights on N . dS_u, N . dS_v.
    tangents: Vec<(Vector3<f64>, f64, f64)>,
    turns: Vec<Turn>,
    rows: Vec<Row>,
}

/// A grid sample that shows a side that is not drawn there, or nearly so.
struct Turn {
    sample: usize,
    /// Derivative of the residual by x_u, y_u, x_v, y_v.
    slope: [f64; 4],
    weight: f64,
}

/// One residual at a scattered parameter: direction . S(u, v) moves it.
struct Row {
    bases: [Basis; 2],
    direction: Vector3<f64>,
    weight: f64,
    residual: f64,
}

/// Distance to a region, and which; see [`Refiner::associate`].
enum Association {
    /// Tangent plane of a map.
    Plane {
        /// The map's normal.
        normal: Vector3<f64>,
        /// Signed distance of the point from the plane.
        residual: f64,
        /// 1 on the map, falling to 0 where its extrapolation ends.
        confidence: f64,
        /// Vector back to the mask.
        outside: [f64; 2],
    },
    /// Vector to the region that the point should project into.
    Outside([f64; 2]),
    /// Nothing known.
    None,
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
        let share = if targets.guess.is_some() { 0.5 * GUESS_WEIGHT } else { 0.0 };
        let guessed = mass.each_ref().map(|mass| mass * share);
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
                let level = &guessed[axis] * part as f64;
                &fairness[axis] + &evenness[part][axis] + level + &slope[axis] * (NORMAL_WEIGHT * normal * 0.02)
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
        refiner.guess = targets.guess.as_ref().map(|guess| refiner.heights(guess)).transpose()?;
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
                smooth.plus(&self.guessed[axis], part as f64)
            })
        });
    }

    /// z of the net of another guess, moved smoothly to the depth samples that it shows.
    fn heights(&self, guess: &NurbsSurface) -> Result<Vec<f64>, Error> {
        if guess.knots() != &self.knots || guess.weights().is_some() {
            return Err(Error::Nurbs {
                reason: "another guess of the surface is on other knots than the start".into(),
            });
        }
        let planes = self.planes(&planes_of(guess));
        let known = self.targets.samples.iter().filter_map(|sample| {
            let [u, v] = self.sight(guess, &planes, sample)?;
            Some((sample.position, -sample.depth - guess.point(u, v).z))
        });
        let correction = Correction::new(&known.collect::<Vec<_>>());
        Ok(guess.control_points().iter().map(|p| p.z + correction.at([p.x, p.y])).collect())
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
        let n = net.len() / 3;
        [0, 1, 2].map(|c| {
            let mut planes = GridPlanes::default();
            self.grid.forward(&net[c * n..(c + 1) * n], &mut planes);
            planes
        })
    }

    /// The side that the sketch draws at each map pixel, and around it.
    fn draw_facing(&self) -> Vec<f64> {
        let map = &self.targets.maps.visible;
        (0..map.size * map.size)
            .map(|pixel| {
                let p = map.center(pixel);
                if self.beside_contour(p) {
                    return 0.0;
                }
                let distance = |sides: [usize; 2]| {
                    let pixels = sides.iter().filter_map(|&side| Some(self.map_sides[side].outside(p)?.1));
                    pixels.fold(f64::INFINITY, f64::min)
                };
                let (front, back) = (distance([0, 2]), distance([1, 3]));
                let unclear = (front - back).abs() < CREASE_REACH || front.min(back).is_infinite();
                if front.max(back) <= 0.5 {
                    BOTH
                } else if unclear {
                    0.0
                } else {
                    (back - front).signum()
                }
            })
            .collect()
    }

    /// The side that the border shows at each point of a side: 1 for the front, -1 for the back, 0 beside the end of a contour, where the
    /// surface turns.
    fn facing_along(&self, stroke: &Polyline, front: &[bool]) -> Vec<f64> {
        let reach = SLIVER_END * self.targets.maps.visible.pixel();
        let at = |(&p, &front): (&[f64; 2], &bool)| {
            if self.contours.iter().any(|contour| contour.line.passes(p, reach)) {
                0.0
            } else if front {
                1.0
            } else {
                -1.0
            }
        };
        stroke.points.iter().zip(front).map(at).collect()
    }

    /// Whether a border stroke is so near that it is the outline as well as a contour here.
    fn along_border(&self, p: [f64; 2]) -> bool {
        let reach = ALONG_BORDER * self.targets.maps.visible.pixel();
        self.strokes.iter().any(|stroke| stroke.passes(p, reach))
    }

    /// Whether a contour stroke is so near that the surface may turn here.
    fn beside_contour(&self, p: [f64; 2]) -> bool {
        let reach = CREASE_REACH * self.targets.maps.visible.pixel();
        self.contours.iter().any(|contour| contour.line.passes(p, reach))
    }

    /// 1 or -1 where the sketch draws the front or the back alone, or, where it draws both, one of them is much nearer; else 0.
    fn facing_at(&self, p: Vector3<f64>) -> f64 {
        let map = &self.targets.maps.visible;
        let [column, row] = map.to_pixels([p.x, p.y]).map(|x| x.round().clamp(0.0, (map.size - 1) as f64) as usize);
        let drawn = self.drawn_facing[row * map.size + column];
        if drawn < BOTH {
            return drawn;
        }
        if self.facing == 1.0 {
            return 0.0;
        }
        let off = |sides: [usize; 2]| {
            let samples = sides.iter().filter_map(|&side| self.map_sides[side].sample([p.x, p.y]));
            samples.map(|sample| (p.z + sample.depth).abs()).fold(f64::INFINITY, f64::min)
        };
        let (front, back) = (off([0, 2]), off([1, 3]));
        if front < NEARER * back {
            1.0
        } else if back < NEARER * front {
            -1.0
        } else {
            0.0
        }
    }

    /// Where the maps want a surface point: the tangent plane of the nearest layer that shows its side.
    ///
    /// - `facing`: z of the unit normal. `occluded`: the layer, where the sketch says it (border points).
    fn associate(&self, p: Vector3<f64>, facing: f64, occluded: Option<bool>) -> Association {
        let allowed = |side: usize| {
            let front = side.is_multiple_of(2);
            let layer = occluded.is_none_or(|occluded| occluded == (side >= 2));
            layer && if front { facing > -UNDECIDED } else { facing < UNDECIDED }
        };
        let mut best: Option<(f64, usize, MapSample)> = None;
        for side in (0..4).filter(|&side| allowed(side)) {
            if let Some(sample) = self.map_sides[side].sample([p.x, p.y]) {
                // Along the normal of the map, not of its differences: these are infinite at a contour.
                let residual = sample.normal.z * (p.z + sample.depth);
                if best.as_ref().is_none_or(|(shortest, ..)| residual.abs() < shortest.abs()) {
                    best = Some((residual, side, sample));
                }
            }
        }
        if let Some((residual, side, sample)) = best {
            let confidence = (1.0 - sample.beyond / EXTRAPOLATED_RINGS as f64).max(0.0).powi(2);
            let outside = if sample.beyond > 0.0 { self.map_sides[side].outside([p.x, p.y]) } else { None };
            let outside = outside.map_or([0.0; 2], |(vector, _)| vector);
            return Association::Plane { normal: sample.normal, residual, confidence, outside };
        }
        if occluded.is_some() {
            return self.associate(p, facing, None);
        }
        let nearest = (0..4)
            .filter(|&side| allowed(side))
            .filter_map(|side| self.map_sides[side].outside([p.x, p.y]))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((vector, _)) => Association::Outside(vector),
            None => Association::None,
        }
    }

    /// Energy and quadratic model at `net`.
    fn linearize(&self, net: &[f64]) -> Model {
        let n = net.len() / 3;
        let planes = self.planes(net);
        let [x, y, z] = &planes;
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        let count = mu * mv;
        let mut weights = vec![[0.0; 6]; count];
        let mut tangents = vec![(Vector3::zeros(), 0.0, 0.0); count];
        let mut slopes: [GridPlanes; 3] =
            [0, 1, 2].map(|_| GridPlanes { value: vec![0.0; count], du: vec![0.0; count], dv: vec![0.0; count] });
        let (mut energy, mut depth_squared) = (0.0, 0.0);
        let mut facings = Vec::with_capacity(count);
        let mut turns = vec![];
        let (border_layers, border_facing) = self.border_layers(&planes);

        for a in 0..mu {
            for b in 0..mv {
                let k = a * mv + b;
                let full = self.quadrature[0][a] * self.quadrature[1][b];
                let p = Vector3::new(x.value[k], y.value[k], z.value[k]);
                let du = Vector3::new(x.du[k], y.du[k], z.du[k]);
                let dv = Vector3::new(x.dv[k], y.dv[k], z.dv[k]);
                let cross = du.cross(&dv);
                let normal = cross / cross.norm().max(f64::MIN_POSITIVE);
                let area = (du.norm() * dv.norm()).max(f64::MIN_POSITIVE);
                facings.push(cross.z / area);
                let drawn = self.facing_at(p);
                let even = FACING_WEIGHT * self.facing / ((mu - 1) * (mv - 1)) as f64;
                let (asked, weight) = if border_facing[k] == 0.0 {
                    (drawn, even)
                } else {
                    (border_facing[k], even.max(RIM_FACING_WEIGHT / (2 * (mu + mv)) as f64))
                };
                let lack = LEAST_FACING - asked * cross.z / area;
                if asked != 0.0 && lack > 0.0 {
                    energy += weight * lack * lack;
                    let slope = [-dv.y, dv.x, du.y, -du.x].map(|s| s * asked / area);
                    for (c, by_u, by_v) in [(0, slope[0], slope[2]), (1, slope[1], slope[3])] {
                        slopes[c].du[k] += weight * lack * by_u;
                        slopes[c].dv[k] += weight * lack * by_v;
                    }
                    turns.push(Turn { sample: k, slope, weight });
                }
                let facing = if drawn == 0.0 { normal.z } else { drawn };
                match self.associate(p, facing, border_layers[k]) {
                    Association::Plane { normal: target, residual, confidence, outside } => {
                        let ratio = (residual / ROBUST_DEPTH).powi(2);
                        let area = full * confidence;
                        let root = (1.0 + ratio).sqrt();
                        energy += area * ROBUST_DEPTH * ROBUST_DEPTH * 2.0 * (1.0 - 1.0 / root);
                        depth_squared += area * residual * residual;
                        let weight = area / (root * root * root);
                        add_row(&mut weights[k], &mut slopes, k, target, weight, residual);
                        let weight = weight * NORMAL_WEIGHT;
                        let (wu, wv) = (
                            weight / du.norm_squared().max(f64::MIN_POSITIVE),
                            weight / dv.norm_squared().max(f64::MIN_POSITIVE),
                        );
                        let (ru, rv) = (target.dot(&du), target.dot(&dv));
                        energy += wu * ru * ru + wv * rv * rv;
                        tangents[k] = (target, wu, wv);
                        for (c, slope) in slopes.iter_mut().enumerate() {
                            slope.du[k] += target[c] * wu * ru;
                            slope.dv[k] += target[c] * wv * rv;
                        }
                        if outside != [0.0; 2] {
                            energy += pull(&mut weights[k], &mut slopes, k, outside, full * OUTSIDE_WEIGHT);
                        }
                    }
                    Association::Outside(outside) => {
                        energy += pull(&mut weights[k], &mut slopes, k, outside, full * OUTSIDE_WEIGHT);
                    }
                    Association::None => {}
                }
            }
        }
        energy += self.border_term(&planes, &mut weights, &mut slopes);
        let folds = self.count_folds(&facings, &planes);

        let surface = self.surface_or_none(net);
        let mut rows = vec![];
        if let Some(surface) = &surface {
            energy += self.contour_term(surface, &planes, &mut rows);
            energy += self.sample_term(surface, &planes, &mut rows);
        } else {
            energy = f64::INFINITY;
        }

        let mut gradient = vec![0.0; 3 * n];
        for (c, slope) in slopes.iter().enumerate() {
            self.grid.add_adjoint(slope, &mut gradient[c * n..(c + 1) * n]);
        }
        for row in &rows {
            self.add_row_adjoint(row, row.weight * row.residual, &mut gradient);
        }
        let data = (energy, gradient);
        let mut model = Model { energy, data, folds, depth_squared, gradient: vec![], weights, tangents, turns, rows };
        self.regularize(net, &mut model);
        model
    }

    /// Sets energy and gradient of `model`, made at `net`, from those of its data and the present stiffness.
    fn regularize(&self, net: &[f64], model: &mut Model) {
        let n = net.len() / 3;
        let (mut energy, mut gradient) = model.data.clone();
        let mut product = vec![0.0; n];
        let mut scratch = vec![0.0; n];
        let mut difference = vec![0.0; n];
        for c in 0..3 {
            let part = &net[c * n..(c + 1) * n];
            product.fill(0.0);
            self.add_tensor(&self.fairness, part, &mut product, &mut scratch);
            energy += dot(part, &product);
            add(&mut gradient[c * n..(c + 1) * n], &product);
            for (d, (now, before)) in difference.iter_mut().zip(part.iter().zip(&self.start[c * n..])) {
                *d = now - before;
            }
            product.fill(0.0);
            self.add_tensor(&self.evenness[c / 2], &difference, &mut product, &mut scratch);
            product.iter_mut().for_each(|x| *x *= self.stiffness);
            energy += dot(&difference, &product);
            add(&mut gradient[c * n..(c + 1) * n], &product);
        }
        if let Some(guess) = &self.guess {
            for (d, (now, guess)) in difference.iter_mut().zip(net[2 * n..].iter().zip(guess)) {
                *d = now - guess;
            }
            product.fill(0.0);
            self.add_tensor(&self.guessed, &difference, &mut product, &mut scratch);
            energy += dot(&difference, &product);
            add(&mut gradient[2 * n..], &product);
        }
        model.energy = if energy.is_nan() { f64::INFINITY } else { energy };
        model.gradient = gradient;
    }

    fn surface_or_none(&self, net: &[f64]) -> Option<NurbsSurface> {
        let n = net.len() / 3;
        let points = (0..n).map(|k| Point3::new(net[k], net[n + k], net[2 * n + k])).collect();
        NurbsSurface::new(self.knots.clone(), points, None).ok()
    }

    /// Adds (A_u x M_v + M_u x A_v) `plane` to `out`.
    fn add_tensor(&self, matrices: &[Banded; 2], plane: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        let columns = self.knots[1].count();
        self.mass[1].along_v(plane, scratch);
        matrices[0].add_along_u(scratch, columns, out);
        matrices[1].along_v(plane, scratch);
        self.mass[0].add_along_u(scratch, columns, out);
    }

    /// Grid indices of side `side`, in the direction of the loop.
    fn side_samples(&self, side: usize) -> Vec<usize> {
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        match side {
            0 => (0..mu).map(|a| a * mv).collect(),
            1 => (0..mv).map(|b| (mu - 1) * mv + b).collect(),
            2 => (0..mu).rev().map(|a| a * mv + mv - 1).collect(),
            _ => (0..mv).rev().collect(),
        }
    }

    /// For the samples of a side their shares of the side's projected arc length.
    fn arc_shares(planes: &[GridPlanes; 3], samples: &[usize]) -> Vec<f64> {
        let [x, y, _] = planes;
        let mut shares = vec![0.0];
        let mut sum = 0.0;
        for pair in samples.windows(2) {
            sum += (x.value[pair[1]] - x.value[pair[0]]).hypot(y.value[pair[1]] - y.value[pair[0]]);
            shares.push(sum);
        }
        shares.iter().map(|s| s / sum.max(f64::MIN_POSITIVE)).collect()
    }

    /// For border samples the layer on which the sketch draws them, and the side that they show, 0 where it is not known.
    fn border_layers(&self, planes: &[GridPlanes; 3]) -> (Vec<Option<bool>>, Vec<f64>) {
        let mut layers = vec![None; planes[0].value.len()];
        let mut facing = vec![0.0; layers.len()];
        for side in 0..4 {
            let samples = self.side_samples(side);
            let shares = Self::arc_shares(planes, &samples);
            let flags = &self.stroke_occluded[side];
            let stroke = &self.strokes[side];
            for (&k, share) in samples.iter().zip(shares) {
                let at = stroke.lengths.partition_point(|&l| l < share * stroke.length()).min(flags.len() - 1);
                layers[k] = Some(flags[at]);
                facing[k] = self.stroke_facing[side][at.min(self.stroke_facing[side].len() - 1)];
            }
        }
        (layers, facing)
    }

    /// Border samples project onto the line of their stroke, corners onto the corners.
    fn border_term(&self, planes: &[GridPlanes; 3], weights: &mut [[f64; 6]], slopes: &mut [GridPlanes; 3]) -> f64 {
        let mut energy = 0.0;
        for side in 0..4 {
            let samples = self.side_samples(side);
            let shares = Self::arc_shares(planes, &samples);
            let stroke = &self.strokes[side];
            let length = stroke.length();
            for (i, (&k, share)) in samples.iter().zip(shares).enumerate() {
                let p = [planes[0].value[k], planes[1].value[k]];
                if i == 0 {
                    let corner = stroke.points[0];
                    for c in 0..2 {
                        let residual = p[c] - corner[c];
                        energy += CORNER_WEIGHT * residual * residual;
                        add_row(&mut weights[k], slopes, k, axis(c), CORNER_WEIGHT, residual);
                    }
                    continue;
                }
                if i + 1 == samples.len() {
                    continue;
                }
                let window = [(share - FOOT_WINDOW) * length, (share + FOOT_WINDOW) * length];
                let Some(foot) = stroke.nearest(p, window) else { continue };
                let weight = BORDER_WEIGHT / (samples.len() - 1) as f64;
                let offset = [p[0] - foot.position[0], p[1] - foot.position[1]];
                // Along the stroke the border slides almost freely, past its end too: pulling hard there would bunch up the
                // samples beside a corner where the outline is smooth.
                let across = offset[0] * foot.normal[0] + offset[1] * foot.normal[1];
                energy += weight * across * across;
                let along = [offset[0] - across * foot.normal[0], offset[1] - across * foot.normal[1]];
                let direction = Vector3::new(foot.normal[0], foot.normal[1], 0.0);
                add_row(&mut weights[k], slopes, k, direction, weight, across);
                // A weak pull to the share of the stroke that the sample had at the start keeps neighbours apart.
                let place = stroke.at(self.shares[side][i] * length);
                let sliding = SLIDING_WEIGHT * weight;
                for c in 0..2 {
                    let residual = p[c] - place[c];
                    energy += sliding * residual * residual;
                    add_row(&mut weights[k], slopes, k, axis(c), sliding, residual);
                }
                let beyond = along[0].hypot(along[1]);
                if beyond > 1e-9 {
                    energy += BEYOND_WEIGHT * weight * beyond * beyond;
                    let direction = Vector3::new(along[0] / beyond, along[1] / beyond, 0.0);
                    add_row(&mut weights[k], slopes, k, direction, BEYOND_WEIGHT * weight, beyond);
                }
            }
        }
        energy
    }

    /// The side of a contour stroke on which the fold lies: where both a front and a back are drawn.
    fn inner_side(&self, line: &Polyline) -> f64 {
        let reach = 2.0 * self.targets.maps.visible.pixel();
        let mut votes = 0.0;
        for pair in line.points.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            let normal = [(a[1] - b[1]) / length, (b[0] - a[0]) / length];
            for sign in [1.0, -1.0] {
                let p = [0, 1].map(|c| middle[c] + sign * reach * normal[c]);
                let inside = |side: usize| self.map_sides[side].outside(p).is_some_and(|(_, pixels)| pixels <= 0.5);
                if (inside(0) || inside(2)) && (inside(1) || inside(3)) {
                    votes += sign * length;
                }
            }
        }
        if votes < 0.0 { -1.0 } else { 1.0 }
    }

    /// The silhouette's crossings with the grid lines project onto the contour strokes.
    fn contour_term(&self, surface: &NurbsSurface, planes: &[GridPlanes; 3], rows: &mut Vec<Row>) -> f64 {
        if self.contours.is_empty() {
            return 0.0;
        }
        let points = silhouette::crossings(surface, &self.grid, &silhouette::facing(planes));
        let weight = CONTOUR_WEIGHT / points.len().max(1) as f64;
        let mut energy = 0.0;
        for point in &points {
            let foot = self
                .contours
                .iter()
                .filter_map(|c| Some((c.line.nearest(point.position, [0.0, f64::INFINITY])?, c.side)))
                .min_by(|a, b| a.0.distance.total_cmp(&b.0.distance));
            let Some((foot, side)) = foot else { continue };
            // A ripple has two silhouettes; only one of them bends to the side where the sketch shows the fold.
            let [nx, ny] = point.inward;
            if side * (nx * foot.normal[0] + ny * foot.normal[1]) < 0.0 {
                continue;
            }
            let offset = [point.position[0] - foot.position[0], point.position[1] - foot.position[1]];
            // Beyond an end of the stroke only the distance from its line counts.
            let across = offset[0] * foot.normal[0] + offset[1] * foot.normal[1];
            let ratio = (across / ROBUST_CONTOUR).powi(2);
            energy += weight * ROBUST_CONTOUR * ROBUST_CONTOUR * ratio.ln_1p();
            let weight = weight / (1.0 + ratio);
            let direction = Vector3::new(foot.normal[0], foot.normal[1], 0.0);
            rows.push(Row { bases: point.bases, direction, weight, residual: across });
        }
        energy + self.covering_term(&points, rows)
    }

    /// Every place of the contour strokes has silhouette near it: a fold must not be ironed out, nor end early.
    fn covering_term(&self, points: &[silhouette::SilhouettePoint], rows: &mut Vec<Row>) -> f64 {
        let pieces = silhouette::pieces(points, &self.grid);
        let places = || self.contours.iter().flat_map(|contour| &contour.places);
        let weight = COVERING_WEIGHT / places().count().max(1) as f64;
        let mut energy = 0.0;
        for &p in places() {
            let (nearest, distance) = Self::nearest_piece(p, points, &pieces)
                .map_or((None, 2.0 * self.targets.maps.visible.half_extent), |(nearest, d)| (Some(nearest), d));
            let ratio = (distance / ROBUST_CONTOUR).powi(2);
            energy += weight * ROBUST_CONTOUR * ROBUST_CONTOUR * ratio.ln_1p();
            let Some(point) = nearest.map(|k| &points[k]) else { continue };
            // The silhouette moves along its projected normal only.
            let direction = Vector3::new(point.inward[0], point.inward[1], 0.0);
            let residual = direction.x * (point.position[0] - p[0]) + direction.y * (point.position[1] - p[1]);
            rows.push(Row { bases: point.bases, direction, weight: weight / (1.0 + ratio), residual });
        }
        energy
    }

    /// The surface meets each depth sample on its line of sight.
    fn sample_term(&self, surface: &NurbsSurface, planes: &[GridPlanes; 3], rows: &mut Vec<Row>) -> f64 {
        let mut energy = 0.0;
        for sample in &self.targets.samples {
            let Some([u, v]) = self.sight(surface, planes, sample) else { continue };
            let bases = [self.knots[0].basis(u), self.knots[1].basis(v)];
            let point = surface.evaluate_with(&bases[0], &bases[1]);
            let normal = point.du.cross(&point.dv);
            let Some(normal) = normal.try_normalize(1e-12) else { continue };
            // Depth on the line of sight changes by n . dS / n_z.
            let direction = normal / normal.z.abs().max(SAMPLE_STEEPEST);
            let residual = direction.z * (point.position.z + sample.depth);
            energy += SAMPLE_WEIGHT * residual * residual;
            rows.push(Row { bases, direction, weight: SAMPLE_WEIGHT, residual });
        }
        energy
    }

    /// Parameters where the line of sight of `sample` meets its layer: the first crossing, or the second.
    fn sight(&self, surface: &NurbsSurface, planes: &[GridPlanes; 3], sample: &LayerSample) -> Option<[f64; 2]> {
        let [x, y, z] = planes;
        let [us, vs] = self.grid.axes.each_ref().map(|axis| &axis.parameters);
        let (mu, mv) = (us.len(), vs.len());
        let [px, py] = sample.position;
        let mut hits: Vec<(f64, [f64; 2])> = vec![];
        for a in 0..mu - 1 {
            for b in 0..mv - 1 {
                let k = a * mv + b;
                let corners = [k, k + mv, k + mv + 1, k + 1];
                let outside = |values: &[f64], at: f64| {
                    corners.iter().all(|&q| values[q] < at) || corners.iter().all(|&q| values[q] > at)
                };
                if outside(&x.value, px) || outside(&y.value, py) {
                    continue;
                }
                for triangle in [[0, 1, 2], [0, 2, 3]] {
                    let [p, q, r] = triangle.map(|i| [x.value[corners[i]] - px, y.value[corners[i]] - py]);
                    let w = [q[0] * r[1] - q[1] * r[0], r[0] * p[1] - r[1] * p[0], p[0] * q[1] - p[1] * q[0]];
                    let total = w[0] + w[1] + w[2];
                    if total == 0.0 || w.iter().any(|value| value / total < -1e-9) {
                        continue;
                    }
                    let mix = |f: &dyn Fn(usize) -> f64| (0..3).map(|i| w[i] / total * f(triangle[i])).sum::<f64>();
                    let depth = -mix(&|i| z.value[corners[i]]);
                    let u = mix(&|i| us[a + usize::from(i == 1 || i == 2)]);
                    let v = mix(&|i| vs[b + usize::from(i >= 2)]);
                    hits.push((depth, [u, v]));
                }
            }
        }
        hits.sort_by(|a, b| a.0.total_cmp(&b.0));
        hits.dedup_by(|b, a| (a.1[0] - b.1[0]).abs() + (a.1[1] - b.1[1]).abs() < 1e-6);
        let [mut u, mut v] = hits.get(usize::from(sample.occluded))?.1;
        // Newton on S(u, v) = (px, py) from the triangle's point.
        for _ in 0..4 {
            let point = surface.evaluate(u, v);
            let (rx, ry) = (px - point.position.x, py - point.position.y);
            let determinant = point.du.x * point.dv.y - point.dv.x * point.du.y;
            if determinant.abs() < 1e-9 * point.du.norm() * point.dv.norm() {
                break;
            }
            u += (rx * point.dv.y - ry * point.dv.x) / determinant;
            v += (ry * point.du.x - rx * point.du.y) / determinant;
            let [[a, b], [c, d]] = self.knots.each_ref().map(KnotVector::domain);
            (u, v) = (u.clamp(a, b), v.clamp(c, d));
        }
        Some([u, v])
    }

    /// Turns from front to back along the grid lines, without those beside a contour stroke.
    ///
    /// - `facings`: (S_u x S_v).z / (|S_u| |S_v|) of each sample.
    fn count_folds(&self, facings: &[f64], planes: &[GridPlanes; 3]) -> usize {
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        let beside = |k: usize| self.beside_contour([planes[0].value[k], planes[1].value[k]]);
        // Along the samples first, first + stride, ...
        let turns = |first: usize, stride: usize, samples: usize| {
            let at = |i: usize| first + i * stride;
            let (mut last, mut count) = (None, 0);
            for i in (0..samples).filter(|&i| facings[at(i)].abs() >= DECIDED) {
                if let Some(j) = last.replace(i) {
                    let turned = facings[at(j)] * facings[at(i)] < 0.0;
                    count += usize::from(turned && !(j..=i).any(|between| beside(at(between))));
                }
            }
            count
        };
        let rows: usize = (0..mu).map(|a| turns(a * mv, 1, mv)).sum();
        let columns: usize = (0..mv).map(|b| turns(b, mv, mu)).sum();
        rows + columns
    }

    fn row_value(&self, row: &Row, net: &[f64]) -> f64 {
        let n = net.len() / 3;
        let columns = self.knots[1].count();
        let [bu, bv] = &row.bases;
        let mut sum = 0.0;
        for i in 0..4 {
            for j in 0..4 {
                let k = (bu.first + i) * columns + bv.first + j;
                let weight = bu.values[0][i] * bv.values[0][j];
                sum += weight
                    * (row.direction.x * net[k] + row.direction.y * net[n + k] + row.direction.z * net[2 * n + k]);
            }
        }
        sum
    }

    fn add_row_adjoint(&self, row: &Row, value: f64, out: &mut [f64]) {
        let n = out.len() / 3;
        let columns = self.knots[1].count();
        let [bu, bv] = &row.bases;
        for i in 0..4 {
            for j in 0..4 {
                let k = (bu.first + i) * columns + bv.first + j;
                let weight = bu.values[0][i] * bv.values[0][j] * value;
                out[k] += row.direction.x * weight;
                out[n + k] += row.direction.y * weight;
                out[2 * n + k] += row.direction.z * weight;
            }
        }
    }

    /// out = H x, H the Gauss-Newton Hessian (of half the energy).
    fn apply(&self, model: &Model, x: &[f64], out: &mut [f64], work: &mut Work) {
        let n = x.len() / 3;
        out.fill(0.0);
        for c in 0..3 {
            self.grid.forward(&x[c * n..(c + 1) * n], &mut work.planes[c]);
        }
        let [px, py, pz] = &mut work.planes;
        work.turned.clear();
        work.turned.extend(model.turns.iter().map(|turn| {
            let (k, [xu, yu, xv, yv]) = (turn.sample, turn.slope);
            turn.weight * (xu * px.du[k] + yu * py.du[k] + xv * px.dv[k] + yv * py.dv[k])
        }));
        for (k, w) in model.weights.iter().enumerate() {
            let (x, y, z) = (px.value[k], py.value[k], pz.value[k]);
            px.value[k] = w[0] * x + w[1] * y + w[2] * z;
            py.value[k] = w[1] * x + w[3] * y + w[4] * z;
            pz.value[k] = w[2] * x + w[4] * y + w[5] * z;
            let (normal, wu, wv) = &model.tangents[k];
            let du = wu * (normal.x * px.du[k] + normal.y * py.du[k] + normal.z * pz.du[k]);
            let dv = wv * (normal.x * px.dv[k] + normal.y * py.dv[k] + normal.z * pz.dv[k]);
            (px.du[k], py.du[k], pz.du[k]) = (normal.x * du, normal.y * du, normal.z * du);
            (px.dv[k], py.dv[k], pz.dv[k]) = (normal.x * dv, normal.y * dv, normal.z * dv);
        }
        for (turn, value) in model.turns.iter().zip(&work.turned) {
            let (k, [xu, yu, xv, yv]) = (turn.sample, turn.slope.map(|slope| slope * value));
            px.du[k] += xu;
            py.du[k] += yu;
            px.dv[k] += xv;
            py.dv[k] += yv;
        }
        for c in 0..3 {
            self.grid.add_adjoint(&work.planes[c], &mut out[c * n..(c + 1) * n]);
        }
        for row in &model.rows {
            self.add_row_adjoint(row, row.weight * self.row_value(row, x), out);
        }
        for c in 0..3 {
            let (part, target) = (&x[c * n..(c + 1) * n], &mut out[c * n..(c + 1) * n]);
            self.add_tensor(&self.regularity[c / 2], part, target, &mut work.scratch);
        }
    }

    /// The Gauss-Newton step: H step = -gradient, by preconditioned conjugate gradients, inexactly.
    ///
    /// - `unfolding`: whether folds are being smoothed out.
    fn solve(&self, model: &Model, unfolding: bool) -> Vec<f64> {
        let steps = if unfolding { UNFOLDING_CG_STEPS } else { CG_STEPS };
        let size = model.gradient.len();
        let n = size / 3;
        let mut work = Work { planes: Default::default(), turned: vec![], scratch: vec![0.0; n] };
        let mut step = vec![0.0; size];
        let mut residual: Vec<f64> = model.gradient.iter().map(|g| -g).collect();
        let precondition = |residual: &[f64], scratch: &mut [f64]| {
            let mut z = residual.to_vec();
            for c in 0..3 {
                self.preconditioner[c / 2].solve(&mut z[c * n..(c + 1) * n], scratch);
            }
            z
        };
        let mut z = precondition(&residual, &mut work.scratch);
        let mut direction = z.clone();
        let mut product = vec![0.0; size];
        let mut rho = dot(&residual, &z);
        let target = rho * CG_TOLERANCE * CG_TOLERANCE;
        for _ in 0..steps {
            if rho.is_nan() || rho <= target || rho == 0.0 {
                break;
            }
            self.apply(model, &direction, &mut product, &mut work);
            let alpha = rho / dot(&direction, &product);
            for k in 0..size {
                step[k] += alpha * direction[k];
                residual[k] -= alpha * product[k];
            }
            z = precondition(&residual, &mut work.scratch);
            let next = dot(&residual, &z);
            let beta = next / rho;
            for (d, z) in direction.iter_mut().zip(&z) {
                *d = z + beta * *d;
            }
            rho = next;
        }
        step
    }

    fn report(
        &self,
        surface: &NurbsSurface,
        net: &[f64],
        model: &Model,
        first_energy: f64,
        iterations: usize,
    ) -> RefineReport {
        let pixel = 2.0 * self.targets.maps.visible.half_extent / 256.0;
        let planes = self.planes(net);
        let whole = [0.0, f64::INFINITY];
        let summarize = |distances: &[f64]| {
            let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
            [mean / pixel, distances.iter().copied().fold(0.0, f64::max) / pixel]
        };

        let curves = [0, 1, 2, 3].map(|side: usize| {
            Polyline::new((0..=200).map(|i| {
                let t = i as f64 / 200.0;
                let [s, t] = [[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]][side];
                let [u, v] = surface.at_fraction(s, t);
                let p = surface.point(u, v);
                [p.x, p.y]
            }))
        });
        let mut distances = vec![];
        for (stroke, curve) in self.strokes.iter().zip(&curves) {
            let feet = stroke.points.iter().filter_map(|&p| curve.nearest(p, whole));
            distances.extend(feet.map(|foot| foot.distance));
        }
        let border_px = summarize(&distances);

        let facing = silhouette::facing(&planes);
        let points = silhouette::crossings(surface, &self.grid, &facing);
        let pieces = silhouette::pieces(&points, &self.grid);
        let mut distances = vec![];
        // No silhouette at all: as far as the canvas is wide.
        let widest = 2.0 * self.targets.maps.visible.half_extent;
        for &p in self.contours.iter().flat_map(|contour| &contour.line.points) {
            let silhouette = Self::nearest_piece(p, &points, &pieces).map_or(widest, |(_, distance)| distance);
            let border = if self.along_border(p) {
                let feet = curves.iter().filter_map(|curve| curve.nearest(p, whole));
                feet.map(|foot| foot.distance).fold(widest, f64::min)
            } else {
                widest
            };
            distances.push(silhouette.min(border));
        }
        let contour_px = summarize(&distances);
        let lines = || self.contours.iter().map(|contour| &contour.line).chain(&self.strokes);
        let to_strokes = |point: &silhouette::SilhouettePoint| {
            let feet = lines().filter_map(|line| line.nearest(point.position, whole));
            feet.map(|foot| foot.distance).fold(f64::INFINITY, f64::min)
        };
        let silhouette_px = summarize(&points.iter().map(to_strokes).collect::<Vec<f64>>());

        let (mut sample_residual, mut samples_missed) = (0f64, 0);
        for sample in &self.targets.samples {
            match self.sight(surface, &planes, sample) {
                Some([u, v]) => sample_residual = sample_residual.max((surface.point(u, v).z + sample.depth).abs()),
                None => samples_missed += 1,
            }
        }

        // One and a half map pixels: masks are decided by half a pixel, silhouettes lie on their rim.
        let mut misfacing = 0.0;
        let mv = self.grid.axes[1].len();
        for (k, facing) in facing.iter().enumerate() {
            let p = [planes[0].value[k], planes[1].value[k]];
            let drawn = (0..4)
                .filter(|&side: &usize| side.is_multiple_of(2) == (*facing > 0.0))
                .filter_map(|side| self.map_sides[side].outside(p))
                .any(|(_, pixels)| pixels <= 1.5);
            if !drawn {
                misfacing += self.quadrature[0][k / mv] * self.quadrature[1][k % mv];
            }
        }
        RefineReport {
            iterations,
            energy: [first_energy, model.energy],
            border_px,
            contour_px,
            silhouette_px,
            sample_residual,
            samples_missed,
            folds: model.folds,
            misfacing,
            depth_rms: model.depth_squared.sqrt(),
        }
    }

    /// The crossing nearest to `p` among the ends of the nearest piece of the silhouette, and the distance of the piece.
    fn nearest_piece(
        p: [f64; 2],
        points: &[silhouette::SilhouettePoint],
        pieces: &[[usize; 2]],
    ) -> Option<(usize, f64)> {
        let distances = pieces.iter().map(|&[a, b]| {
            let (t, distance) = silhouette::nearest_on_segment(p, points[a].position, points[b].position);
            (if t < 0.5 { a } else { b }, distance)
        });
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

struct Work {
    planes: [GridPlanes; 3],
    turned: Vec<f64>,
    scratch: Vec<f64>,
}

fn axis(c: usize) -> Vector3<f64> {
    Matrix3::identity().column(c).into_owned()
}

fn planes_of(surface: &NurbsSurface) -> Vec<f64> {
    let points = surface.control_points();
    (0..3).flat_map(|c| points.iter().map(move |p| p[c])).collect()
}

/// Adds weight (direction . dS + residual)^2 at grid sample `k`.
fn add_row(
    weights: &mut [f64; 6],
    slopes: &mut [GridPlanes; 3],
    k: usize,
    direction: Vector3<f64>,
    weight: f64,
    residual: f64,
) {
    let d = direction;
    for (slot, product) in weights.iter_mut().zip([d.x * d.x, d.x * d.y, d.x * d.z, d.y * d.y, d.y * d.z, d.z * d.z]) {
        *slot += weight * product;
    }
    for (c, slope) in slopes.iter_mut().enumerate() {
        slope.value[k] += weight * residual * d[c];
    }
}

/// Pulls grid sample `k` by `vector` in x, y; returns the energy.
fn pull(weights: &mut [f64; 6], slopes: &mut [GridPlanes; 3], k: usize, vector: [f64; 2], weight: f64) -> f64 {
    for (c, v) in vector.iter().enumerate() {
        add_row(weights, slopes, k, axis(c), weight, -v);
    }
    weight * (vector[0] * vector[0] + vector[1] * vector[1])
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn add(a: &mut [f64], b: &[f64]) {
    for (x, y) in a.iter_mut().zip(b) {
        *x += y;
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{self, Scene};
    use super::super::{BorderCurves, SurfaceProjector, coons_net, unfolded_net};
    use super::*;

    fn targets(scene: &Scene) -> SurfaceTargets {
        SurfaceTargets {
            border: scene.border.clone(),
            corners: scene.corners,
            contours: scene.contours.clone(),
            samples: vec![],
            maps: scene.maps.clone(),
            guess: None,
        }
    }

    fn coons(targets: &SurfaceTargets) -> NurbsSurface {
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
        NurbsSurface::new(curves.knots.clone(), coons_net(&curves), None).unwrap()
    }

    /// Root mean square and largest distance from samples of `surface` to `truth`.
    fn deviation(surface: &NurbsSurface, truth: &NurbsSurface) -> [f64; 2] {
        let projector = SurfaceProjector::new(truth);
        let (mut sum, mut largest, mut count) = (0.0, 0f64, 0);
        for i in 0..=30 {
            for j in 0..=30 {
                let [u, v] = surface.at_fraction(i as f64 / 30.0, j as f64 / 30.0);
                let distance = projector.closest(&surface.point(u, v)).distance;
                sum += distance * distance;
                largest = largest.max(distance);
                count += 1;
            }
        }
        [(sum / count as f64).sqrt(), largest]
    }

    fn start_of(scene: &Scene, size: f64) -> NurbsSurface {
        // A network's answer: the truth with smooth errors.
        let net = scene.truth.control_points().iter().map(|p| {
            let error = [0.5 * (p.y * 1.1).sin(), 0.5 * (p.x * 0.9).cos(), (p.x + p.y).sin()];
            p + Vector3::from(error) * size
        });
        NurbsSurface::uniform(3, [30, 30], net.collect()).unwrap()
    }

    fn run(start: &NurbsSurface, targets: &SurfaceTargets) -> Refined {
        refine(start, targets, &RefineOptions::default(), &Control::default()).unwrap()
    }

    #[test]
    fn open_surfaces_are_recovered_from_the_coons_patch() {
        for truth in [synthetic::dome(), synthetic::saddle()] {
            let scene = synthetic::scene(truth);
            let targets = targets(&scene);
            let start = coons(&targets);
            let refined = run(&start, &targets);
            let [rms, largest] = deviation(&refined.surface, &scene.truth);
            assert!(rms < 0.002 && largest < 0.02, "{rms} {largest}");
            assert!(rms < deviation(&start, &scene.truth)[0]);
            let report = refined.report;
            assert!(report.border_px[0] < 0.05 && report.border_px[1] < 0.3, "{report:?}");
            assert!(report.folds == 0 && report.misfacing == 0.0 && report.energy[1] <= report.energy[0]);
        }
    }

    #[test]
    fn a_folded_vault_is_recovered_from_a_bent_start_and_from_the_unfolded_maps() {
        let scene = synthetic::scene(synthetic::vault());
        let targets = targets(&scene);
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
        let net = unfolded_net(&targets.border, &curves, &targets.contours, &targets.maps, 1.0).unwrap();
        let unfolded = NurbsSurface::new(curves.knots, net, None).unwrap();
        // Rms and largest deviation, mean and largest miss of border and contours, pixels.
        let far = (start_of(&scene, 0.3), [0.03, 0.2], [0.3, 3.0]);
        let near = (unfolded, [0.015, 0.25], [0.1, 1.0]);
        // From far away the contour is still on its way after the usual twelve steps.
        let options = RefineOptions { iterations: 16, ..RefineOptions::default() };
        for (start, [most_rms, most], [mean_px, max_px]) in [far, near] {
            let refined = refine(&start, &targets, &options, &Control::default()).unwrap();
            let [rms, largest] = deviation(&refined.surface, &scene.truth);
            assert!(rms < most_rms && largest < most, "{rms} {largest}");
            assert!(rms < deviation(&start, &scene.truth)[0]);
            let report = refined.report;
            for [mean, max] in [report.border_px, report.contour_px] {
                assert!(mean < mean_px && max < max_px, "{report:?}");
            }
            assert!(report.folds == 0 && report.misfacing < 0.005, "{report:?}");
        }
    }

    #[test]
    fn a_start_that_folds_over_is_unfolded() {
        let scene = synthetic::scene(synthetic::dome());
        let targets = targets(&scene);
        // Parameter lines that run back in the middle of the patch, by more than their distance.
        let net = scene.truth.control_points().iter().map(|p| {
            let back = (-(p.x * p.x + p.y * p.y) / 0.5).exp();
            p + Vector3::new(-2.5 * p.x * back, 0.0, 0.0)
        });
        let start = NurbsSurface::uniform(3, [30, 30], net.collect()).unwrap();
        let unrefined = RefineOptions { iterations: 0, ..RefineOptions::default() };
        let before = refine(&start, &targets, &unrefined, &Control::default()).unwrap().report;
        let refined = run(&start, &targets);
        let after = refined.report;
        assert!(before.folds > 0 && before.misfacing > 0.005, "{before:?}");
        assert!(after.folds == 0 && after.misfacing == 0.0 && after.border_px[0] < 0.1, "{after:?}");
        assert!(deviation(&refined.surface, &scene.truth)[0] < 0.01);
    }

    #[test]
    fn strokes_win_over_maps_that_disagree() {
        let scene = synthetic::scene(synthetic::saddle());
        let mut targets = targets(&scene);
        for (k, depth) in targets.maps.visible.depth.iter_mut().enumerate() {
            *depth += 0.15 * (k as f64 * 0.37).sin() + 0.1 * ((k / 64) as f64 * 0.2).cos();
        }
        let refined = run(&coons(&targets), &targets);
        assert!(refined.report.border_px[0] < 0.1, "{:?}", refined.report);
        assert!(deviation(&refined.surface, &scene.truth)[0] < 0.12);
    }

    #[test]
    fn depth_samples_are_met_and_act_locally() {
        let scene = synthetic::scene(synthetic::vault());
        let mut targets = targets(&scene);
        let plain = run(&start_of(&scene, 0.1), &targets).surface;
        let mesh = crate::surface::SurfaceMesh::new(&scene.truth, [100, 100]).unwrap();
        let caster = crate::surface::RayCaster::new(&mesh, [Vector3::x(), Vector3::y(), Vector3::z()]);
        let visible = caster.hits(-2.0, -1.0)[0].depth;
        let occluded = caster.hits(2.0, 2.1)[1].depth;
        targets.samples = vec![
            LayerSample { position: [-2.0, -1.0], occluded: false, depth: visible + 0.4 },
            LayerSample { position: [2.0, 2.1], occluded: true, depth: occluded - 0.3 },
        ];
        let refined = run(&start_of(&scene, 0.1), &targets);
        let range = 6.0;
        assert!(refined.report.sample_residual < 0.01 * range, "{:?}", refined.report);
        assert_eq!(refined.report.samples_missed, 0);
        assert!(refined.report.border_px[0] < 0.3 && refined.report.folds == 0, "{:?}", refined.report);
        // The corner of the near side, far from both.
        let [u, v] = plain.at_fraction(0.97, 0.95);
        assert!((plain.point(u, v) - refined.surface.point(u, v)).norm() < 0.05);
    }

    #[test]
    fn moving_a_depth_sample_moves_the_surface_continuously() {
        let scene = synthetic::scene(synthetic::vault());
        let mut targets = targets(&scene);
        let mesh = crate::surface::SurfaceMesh::new(&scene.truth, [100, 100]).unwrap();
        let caster = crate::surface::RayCaster::new(&mesh, [Vector3::x(), Vector3::y(), Vector3::z()]);
        let visible = caster.hits(-2.0, -1.0)[0].depth;
        let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [30, 30]).unwrap();
        let mut at = |offset: f64| {
            targets.samples = vec![LayerSample { position: [-2.0, -1.0], occluded: false, depth: visible + offset }];
            let maps = targets.maps.meeting(&targets.samples);
            let net = unfolded_net(&targets.border, &curves, &targets.contours, &maps, 1.0).unwrap();
            run(&NurbsSurface::new(curves.knots.clone(), net, None).unwrap(), &targets).surface
        };
        // How far the surface moves, not its parameters, which no one sees.
        let moved = |a: &NurbsSurface, b: &NurbsSurface| deviation(a, b)[1];
        let (base, little, more) = (at(0.2), at(0.201), at(0.3));
        assert!(moved(&base, &little) < 0.01 && moved(&base, &more) > 0.05, "{}", moved(&base, &little));
        assert!(moved(&base, &more) < 0.4);
    }

    #[test]
    fn a_shift_in_depth_shifts_the_result() {
        let scene = synthetic::scene(synthetic::dome());
        let mut targets = targets(&scene);
        let start = start_of(&scene, 0.1);
        let before = run(&start, &targets).surface;
        for depth in &mut targets.maps.visible.depth {
            *depth -= 3.0;
        }
        let shift = Vector3::new(0.0, 0.0, 3.0);
        let after = run(&start.mapped(|p| p + shift), &targets).surface;
        for (a, b) in before.control_points().iter().zip(after.control_points()) {
            assert!((a + shift - b).norm() < 1e-6);
        }
    }

    #[test]
    fn the_gradient_is_that_of_the_energy() {
        // On a plane with exact linear maps the lagged directions and footpoints are exact too.
        let scene = synthetic::scene(synthetic::surface(|s, t| {
            let (x, y) = (7.0 * t - 3.5, 3.5 - 7.0 * s);
            [x, y, 0.3 * x - 0.2 * y - 4.0]
        }));
        let targets = targets(&scene);
        let start = start_of(&scene, 0.02);
        let mut refiner = Refiner::new(start.knots(), &targets, &RefineOptions::default()).unwrap();
        refiner.begin(&start);
        let net = refiner.start.clone();
        let model = refiner.linearize(&net);
        let h = 1e-6;
        for k in [0, 35, 435, 899, 900 + 14 * 30, 900 + 455, 1800, 1800 + 222, 1800 + 871] {
            let moved = |by: f64| {
                let mut net = net.clone();
                net[k] += by;
                refiner.linearize(&net).energy
            };
            let difference = (moved(h) - moved(-h)) / (4.0 * h);
            let scale = 1e-4 + difference.abs();
            assert!((difference - model.gradient[k]).abs() < 0.05 * scale, "{k}: {difference} {}", model.gradient[k]);
        }
    }

    #[test]
    fn the_silhouette_moves_by_the_projected_normal_displacement() {
        let scene = synthetic::scene(synthetic::vault());
        let surface = &scene.truth;
        let knots = surface.knots();
        let grid = TensorGrid { axes: [GridAxis::even(&knots[0], GRID), GridAxis::even(&knots[1], GRID)] };
        let contour = |surface: &NurbsSurface| {
            let net = planes_of(surface);
            let planes = [0, 1, 2].map(|c| {
                let mut planes = GridPlanes::default();
                grid.forward(&net[c * 900..(c + 1) * 900], &mut planes);
                planes
            });
            silhouette::crossings(surface, &grid, &silhouette::facing(&planes))
        };
        let before = contour(surface);
        let point = before[before.len() / 2];
        let (i, j) = (point.bases[0].first + 1, point.bases[1].first + 2);
        let d = surface.evaluate_with(&point.bases[0], &point.bases[1]);
        let normal = d.du.cross(&d.dv).normalize();
        let h = 1e-4;
        let mut net = surface.control_points().to_vec();
        net[i * 30 + j] += normal * h;
        let moved = NurbsSurface::uniform(3, [30, 30], net).unwrap();
        let line = Polyline::new(
            contour(&moved).iter().filter(|p| (p.position[0] - point.position[0]).abs() < 1.0).map(|p| p.position),
        );
        let expected = h * point.bases[0].values[0][1] * point.bases[1].values[0][2];
        // The new silhouette lies beyond the old point by the displacement along the normal.
        let mut sorted = line.points.clone();
        sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let foot = Polyline::new(sorted).nearest(point.position, [0.0, f64::INFINITY]).unwrap();
        let offset =
            (foot.position[0] - point.position[0]) * normal.x + (foot.position[1] - point.position[1]) * normal.y;
        assert!((offset - expected).abs() < 0.15 * expected, "{offset} {expected}");
    }

    #[test]
    fn fairness_irons_out_waves_and_closeness_keeps_the_start() {
        let scene = synthetic::scene(synthetic::dome());
        let mut targets = targets(&scene);
        // Eight waves a side, a twentieth of a unit high.
        for k in 0..targets.maps.visible.depth.len() {
            let [x, y] = targets.maps.visible.center(k);
            targets.maps.visible.depth[k] += 0.05 * (7.0 * x).sin() * (7.0 * y).cos();
        }
        let start = start_of(&scene, 0.05);
        let with = |fairness: f64, closeness: f64| {
            let options = RefineOptions { fairness, closeness, ..RefineOptions::default() };
            refine(&start, &targets, &options, &Control::default()).unwrap().surface
        };
        let off = |surface: &NurbsSurface| deviation(surface, &scene.truth)[0];
        let [rough, usual] = [0.01, 1.0].map(|fairness| off(&with(fairness, 1.0)));
        assert!(usual < 0.7 * rough, "{rough} {usual}");
        let moved = |surface: &NurbsSurface| {
            let pairs = surface.control_points().iter().zip(start.control_points());
            pairs.map(|(p, q)| (p - q).norm_squared()).sum::<f64>().sqrt()
        };
        let [free, held, fixed] = [0.0, 100.0, 1e9].map(|closeness| moved(&with(1.0, closeness)));
        assert!(held < free && fixed < 0.1 * free, "{free} {held} {fixed}");
    }

    #[test]
    fn another_guess_counts_as_much_as_the_maps() {
        let scene = synthetic::scene(synthetic::dome());
        let mut targets = targets(&scene);
        let depth = |surface: &NurbsSurface| {
            let [u, v] = surface.at_fraction(0.5, 0.5);
            -surface.point(u, v).z
        };
        let truth = depth(&scene.truth);
        targets.maps.visible.depth.iter_mut().for_each(|depth| *depth += 0.1);
        targets.guess = Some(scene.truth.mapped(|p| p + Vector3::new(0.0, 0.0, 0.1)));
        let between = depth(&run(&scene.truth, &targets).surface);
        assert!((between - truth).abs() < 0.03, "{between} {truth}");
        // Both are moved to a depth sample.
        let [u, v] = scene.truth.at_fraction(0.5, 0.5);
        let p = scene.truth.point(u, v);
        targets.samples = vec![LayerSample { position: [p.x, p.y], occluded: false, depth: truth + 0.5 }];
        let met = run(&scene.truth, &targets);
        assert!((depth(&met.surface) - truth - 0.5).abs() < 0.02, "{}", depth(&met.surface) - truth);
        targets.guess = Some(NurbsSurface::uniform(3, [10, 90], scene.truth.control_points().to_vec()).unwrap());
        let other = refine(&scene.truth, &targets, &RefineOptions::default(), &Control::default());
        assert!(matches!(other, Err(Error::Nurbs { .. })));
    }

    #[test]
    fn of_several_starts_the_nearest_is_taken() {
        let scene = synthetic::scene(synthetic::saddle());
        let targets = targets(&scene);
        let starts = [start_of(&scene, 0.8), start_of(&scene, 0.05)];
        let best =
            |starts: &[NurbsSurface]| refine_best(starts, &targets, &RefineOptions::default(), &Control::default());
        let alone = run(&starts[1], &targets);
        for order in [[0, 1], [1, 0]] {
            let refined = best(&order.map(|k| starts[k].clone())).unwrap();
            assert_eq!((refined.surface, refined.report), (alone.surface.clone(), alone.report));
        }
        assert!(matches!(best(&[]), Err(Error::Degenerate { .. })));
        let coarse = NurbsSurface::uniform(3, [10, 90], starts[0].control_points().to_vec()).unwrap();
        assert!(matches!(best(&[starts[0].clone(), coarse]), Err(Error::Nurbs { .. })));
    }

    #[test]
    fn cancelling_and_bad_input_are_errors() {
        let scene = synthetic::scene(synthetic::saddle());
        let targets = targets(&scene);
        let control = Control::default();
        control.cancel();
        let options = RefineOptions::default();
        assert_eq!(refine(&scene.truth, &targets, &options, &control).unwrap_err(), Error::Cancelled);
        let bad = RefineOptions { fairness: f64::NAN, ..options };
        assert!(matches!(refine(&scene.truth, &targets, &bad, &Control::default()), Err(Error::Argument { .. })));
        let flat = NurbsSurface::uniform(2, [30, 30], scene.truth.control_points().to_vec()).unwrap();
        assert!(matches!(refine(&flat, &targets, &options, &Control::default()), Err(Error::Nurbs { .. })));
    }
}
