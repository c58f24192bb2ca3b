//! The smoothest conjugate field under constraints.

use super::border::{Corner, corners, followed, inner_angle};
use super::cancel::{inward, paths};
use super::coarse::Coarse;
use super::conjugate::{SecondForm, middle_forms, second_forms};
use super::conjugate_field::{ConjugateField, FieldDiagnostics, Singularity};
use super::matching::{Cross, match_edges, matching};
use super::parallel::{Parallel, parallels};
use super::polyvector::PolyVector;
use super::prescribe;
use super::system::TriangleSystem;
use super::topology::{EdgeTopology, TriangleFrames, wrap};
use crate::control::Control;
use crate::error::Error;
use crate::surface::SurfaceMesh;
use nalgebra::{Complex, Vector3};
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

/// One of the two families follows a direction on a triangle; the solver decides which.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionConstraint {
    /// The triangle.
    pub triangle: u32,
    /// The direction; only its tangential part counts, neither its length nor its sign.
    pub direction: Vector3<f64>,
    /// Weight of the squared angle, where the smoothness across an edge between equilateral triangles weighs about 1. Infinite: the
    /// direction is met exactly. 0 or less: ignored.
    pub weight: f64,
}

/// How a field is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOptions {
    /// Smallest angle between the two families, degrees, in (0, 80].
    pub crossing_floor_deg: f64,
    /// Pull towards the guess: the field leaves it over a distance of about sqrt(area / weight).
    pub guess_weight: f64,
    /// Pull towards the principal directions where they are distinct, in the same unit; used where there is no guess, and a
    /// hundredth of it where there are constraints, so that what they leave open is defined.
    pub principal_weight: f64,
    /// Pull of the crossing angle towards 90 degrees, in the same unit.
    pub orthogonality_weight: f64,
    /// A triangle is flat, and conjugacy ignored there, where |II| is below this share of its root mean square over the surface (or below
    /// this share of 1 / sqrt(area)); radii of curvature below the size of a triangle count as that size.
    pub flatness: f64,
    /// Weight of the integral of II(u, v)^2 in the layout, four times as much once its topology is settled: where curvature is k, the
    /// field gives way to conjugacy over a distance of about 1 / (k sqrt(weight)).
    pub conjugacy_weight: f64,
    /// Pull towards running parallel to the constraints beside them, in the unit of the guess' weight; 0: constraints count on their own
    /// triangles alone, and panels, which are larger, turn away from them. In the layout it weighs on meshes of more than 24 cells, once
    /// the topology is settled.
    pub parallel_weight: f64,
    /// Distance at which that pull has faded out, in square roots of the area.
    pub parallel_reach: f64,
    /// Whether a family follows the border along the sides u = min, u = max, v = min, v = max, as a hard constraint.
    pub aligned_sides: [bool; 4],
    /// Length of the edges of the panels that are to come, in the unit of the mesh: where such a side turns by more than 45 degrees between the
    /// chords of that length before and after a vertex, panels have a corner there. 0: the square root of a 500th of the area.
    pub panel_length: f64,
    /// Most Gauss-Newton iterations.
    pub iterations: usize,
}

impl Default for FieldOptions {
    fn default() -> Self {
        Self {
            crossing_floor_deg: 20.0,
            guess_weight: 30.0,
            principal_weight: 20.0,
            orthogonality_weight: 0.5,
            flatness: 0.02,
            conjugacy_weight: 100.0,
            parallel_weight: 0.0,
            parallel_reach: 0.075,
            aligned_sides: [false; 4],
            panel_length: 0.0,
            iterations: 30,
        }
    }
}

impl FieldOptions {
    fn check(&self) -> Result<(), Error> {
        let fail = |name, value: f64, expected| Err(Error::Argument { name, value: value.to_string(), expected });
        if !(self.crossing_floor_deg > 0.0 && self.crossing_floor_deg <= 80.0) {
            return fail("crossing_floor_deg", self.crossing_floor_deg, "an angle in (0, 80]");
        }
        for (name, value) in [
            ("guess_weight", self.guess_weight),
            ("principal_weight", self.principal_weight),
            ("orthogonality_weight", self.orthogonality_weight),
            ("flatness", self.flatness),
            ("conjugacy_weight", self.conjugacy_weight),
            ("parallel_weight", self.parallel_weight),
            ("parallel_reach", self.parallel_reach),
            ("panel_length", self.panel_length),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return fail(name, value, "a finite number that is not negative");
            }
        }
        Ok(())
    }
}

/// The smoothest conjugate field on `mesh` that follows the constraints.
///
/// - `guess`: two directions for each triangle, e.g. from the network; their tangential parts count, up to length, sign and
///   order. Triangles with a zero or non-finite vector have no guess.
/// - `constraints`: directions that one family follows. On one triangle the heaviest wins; a second hard one there counts as soft.
///
/// The field is conjugate to rounding on every curved triangle, in the second form of the surface at its middle where the mesh knows it
/// ([`SurfaceMesh::with_middles`]), and crosses at no less than the floor everywhere. The exceptions are
/// triangles with a hard constraint along a direction whose conjugate is within the floor of it, as on a saddle along an asymptotic
/// direction: there the floor wins, and `diagnostics.floor_triangles` lists them.
///
/// # Errors
/// [`Error::Argument`] for options out of range or a guess of another length, [`Error::VertexOutOfRange`] or [`Error::Degenerate`]
/// for a bad mesh or a constraint on a triangle that does not exist, [`Error::Singular`] if a system cannot be solved, [`Error::Cancelled`].
///
/// # Source
/// The topology comes from the smoothest PolyVector coefficient p (Diamanti et al. 2014), attracted by what conjugacy, guess and constraints
/// ask for. From there we depart: Gauss-Newton on the angles finds the layout, in which the integral of II(u, v)^2 is traded against
/// smoothness: a panel sees the mean of II over its own size, so that bumps smaller than panels leave no singularities. The field itself starts
/// from the nearest conjugate crosses, and instead of alternating with a soft projection Gauss-Newton moves it along the curve of
/// conjugate crosses of each triangle ([`SecondForm`]), so that conjugacy is exact, with the layout's matching.
pub fn conjugate_field(
    mesh: SurfaceMesh,
    guess: Option<&[[Vector3<f64>; 2]]>,
    constraints: &[DirectionConstraint],
    options: &FieldOptions,
    control: &Control,
) -> Result<ConjugateField, Error> {
    solve(mesh, guess, constraints, None, options, control)
}

/// The smoothest conjugate field that has the given singularities, and no others.
///
/// - `singularities`: inner vertices with an index of 1 or -1, in any order; none is a field without singularities.
///
/// Where all four sides are aligned the indices have to sum to 4 quarter turns less one for each corner of the border, of about 90 degrees:
/// 0 for a patch with four corners. Where a side is free, any singularities will do. Hard constraints bind as ever: a line that
/// asks for another singularity gets a crack where the cross turns at once.
///
/// # Errors
/// [`Error::Argument`] for an index other than 1 and -1, a vertex on the border or none, or two singularities on one vertex;
/// [`Error::SingularityCount`] for indices that aligned sides leave no room for; and as [`conjugate_field`].
///
/// # Source
/// Trivial connections (Crane et al. 2010) fix the rotation of a field by its singularities; here they fix the quarter turns across
/// edges, which are moved along paths from where a free field would have its singularities, and the energy stays that of
/// [`conjugate_field`]. The paper has no such entry.
pub fn conjugate_field_with_singularities(
    mesh: SurfaceMesh,
    guess: Option<&[[Vector3<f64>; 2]]>,
    constraints: &[DirectionConstraint],
    singularities: &[Singularity],
    options: &FieldOptions,
    control: &Control,
) -> Result<ConjugateField, Error> {
    solve(mesh, guess, constraints, Some(singularities), options, control)
}

fn solve(
    mesh: SurfaceMesh,
    guess: Option<&[[Vector3<f64>; 2]]>,
    constraints: &[DirectionConstraint],
    fixed: Option<&[Singularity]>,
    options: &FieldOptions,
    control: &Control,
) -> Result<ConjugateField, Error> {
    options.check()?;
    let count = mesh.triangles.len();
    if let Some(guess) = guess
        && guess.len() != count
    {
        let value = format!("a list of {}", guess.len());
        return Err(Error::Argument { name: "guess", value, expected: "one pair of directions for each triangle" });
    }
    control.step("field", 0.0)?;
    let edges = EdgeTopology::new(mesh.points.len(), &mesh.triangles)?;
    let window = match options.panel_length {
        0.0 => (mesh.area() / DEFAULT_PANELS).sqrt(),
        length => length,
    };
    let corners = corners(&mesh, &edges, &options.aligned_sides, window);
    if let Some(fixed) = fixed {
        prescribe::check(&mesh, &edges, &options.aligned_sides, &corners, fixed)?;
    }
    let frames = TriangleFrames::new(&mesh, &edges)?;
    let mut constraints = constraints.to_vec();
    border_constraints(&mesh, &edges, &options.aligned_sides, &mut constraints);
    let forms = second_forms(&mesh, &frames);
    let weights = edge_weights(&mesh, &edges);
    let patch =
        Patch { mesh: &mesh, edges: &edges, frames: &frames, forms: &forms, corners: &corners, weights: &weights };
    let Layout { crosses, jumps, iterations, .. } = layout(&patch, guess, &constraints, fixed, options, control)?;
    control.step("field", 0.8)?;
    let layout = directions(&frames, &crosses);
    // Panels see the mean of II over their size, the field itself the surface.
    let forms = middle_forms(&mesh, &frames, &forms);
    let patch = Patch { forms: &forms, ..patch };
    let problem = Problem::new(&patch, Conjugacy::Exact, guess, &constraints, options)?;
    let start: Vec<Cross> = (0..crosses.len()).map(|t| problem.allowed(t, &crosses[t])).collect();
    let (crosses, more) = problem.optimize(&mut problem.system()?, start, Some(&jumps), EXACT_ITERATIONS, control)?;
    let iterations = iterations + more;
    control.step("field", 0.95)?;
    let Finished { directions, matching, singularities, diagnostics } = problem.finish(&crosses, &jumps, iterations);
    control.step("field", 1.0)?;
    let tangential = |c: &DirectionConstraint| {
        let normal = frames.normals[c.triangle as usize];
        let direction = (c.direction - normal * normal.dot(&c.direction)).try_normalize(1e-12)?;
        Some(DirectionConstraint { direction, ..*c })
    };
    let lines = constraints.iter().filter_map(tangential).collect();
    let parallels = problem.parallels;
    let fixed_singularities = fixed.is_some();
    Ok(ConjugateField {
        mesh,
        directions,
        layout,
        edges,
        matching,
        singularities,
        fixed_singularities,
        aligned_sides: options.aligned_sides,
        lines,
        parallels,
        diagnostics,
    })
}

/// Dirichlet energy of the PolyVector coefficients of a field of unit directions: the sum over inner edges of
/// w (|s_g - s_f|^2 + |p_g - p_f|^2), the coefficients of f carried to the frame of g.
///
/// w = 2 / (cot a + cot b), the edge's length over that of its dual, a and b being the opposite angles (at least 0.1 below the line): so
/// the sum approximates the integral of |grad s|^2 + |grad p|^2, which is dimensionless and does not change with scale.
///
/// # Source
/// Sketch2PQ, Sec. 5 (E_smooth), with the energy of Diamanti et al. 2015; the paper gives no weights.
pub fn smoothness_energy(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    frames: &TriangleFrames,
    directions: &[[Vector3<f64>; 2]],
) -> f64 {
    weighted_energy(edges, frames, directions, &edge_weights(mesh, edges))
}

/// [`smoothness_energy`] with the edges' weights at hand.
fn weighted_energy(
    edges: &EdgeTopology,
    frames: &TriangleFrames,
    directions: &[[Vector3<f64>; 2]],
    weights: &[f64],
) -> f64 {
    let poly: Vec<PolyVector> = directions
        .iter()
        .enumerate()
        .map(|(t, d)| PolyVector::from_directions(frames.components(t, &d[0]), frames.components(t, &d[1])))
        .collect();
    (0..edges.len())
        .filter(|&e| !edges.is_border(e))
        .map(|e| {
            let [f, g] = edges.triangles[e].map(|t| t as usize);
            let carried = poly[f].rotated(frames.turns[e]);
            weights[e] * ((poly[g].s - carried.s).norm_sqr() + (poly[g].p - carried.p).norm_sqr())
        })
        .sum()
}

/// Length of each inner edge over that of its dual, at most 20; 0 on the border.
fn edge_weights(mesh: &SurfaceMesh, edges: &EdgeTopology) -> Vec<f64> {
    let mut cotangents = vec![0.0; edges.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|i| mesh.position(corners[(k + i) % 3]));
            let (p, q) = (a - c, b - c);
            let area = p.cross(&q).norm();
            // A triangle without area couples its neighbours as if it were not there.
            let cotangent = if area > 0.0 { p.dot(&q) / area } else { 0.0 };
            cotangents[edges.triangle_edges[t][k] as usize] += cotangent;
        }
    }
    (0..edges.len()).map(|e| if edges.is_border(e) { 0.0 } else { 2.0 / cotangents[e].clamp(0.1, 1e3) }).collect()
}

/// Hard constraints along the chosen sides, from the border edges of their triangles.
fn border_constraints(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    sides: &[bool; 4],
    constraints: &mut Vec<DirectionConstraint>,
) {
    for &e in followed(mesh, edges, sides).values() {
        let [a, b] = edges.vertices[e as usize].map(|v| mesh.position(v));
        let triangle = edges.triangles[e as usize][0];
        constraints.push(DirectionConstraint { triangle, direction: b - a, weight: f64::INFINITY });
    }
}

/// How conjugacy enters.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Conjugacy {
    /// Crosses move along the conjugate ones only.
    Exact,
    /// [`FieldOptions::conjugacy_weight`] times the integral of II(u, v)^2 is part of the energy.
    Soft,
}

/// A triangulated patch with what is derived from it.
struct Patch<'a> {
    mesh: &'a SurfaceMesh,
    edges: &'a EdgeTopology,
    frames: &'a TriangleFrames,
    forms: &'a [SecondForm],
    /// Corners of the border that the field follows.
    corners: &'a [Corner],
    /// See [`edge_weights`].
    weights: &'a [f64],
}

/// Crosses whose conjugacy is soft, and the quarter turns across edges that their topology consists of.
struct Layout {
    crosses: Vec<Cross>,
    jumps: Vec<i32>,
    singularities: Vec<Singularity>,
    iterations: usize,
}

/// The smoothest crosses with conjugacy as a soft term.
///
/// A mesh finer than [`BASE_CELLS`] starts from the layout on one of half the resolution, keeps its topology, and needs a few iterations only.
/// With `fixed` singularities the quarter turns are moved until the crosses have those.
fn layout(
    patch: &Patch,
    guess: Option<&[[Vector3<f64>; 2]]>,
    constraints: &[DirectionConstraint],
    fixed: Option<&[Singularity]>,
    options: &FieldOptions,
    control: &Control,
) -> Result<Layout, Error> {
    let base = patch.mesh.cells.iter().all(|&n| n <= BASE_CELLS);
    // Neither bumps nor parallels of lines shall make singularities: only with the topology settled does conjugacy weigh more, and do
    // parallels weigh at all.
    let weighed = if base {
        FieldOptions { parallel_weight: 0.0, ..*options }
    } else {
        FieldOptions { conjugacy_weight: FINE_CONJUGACY * options.conjugacy_weight, ..*options }
    };
    let problem = Problem::new(patch, Conjugacy::Soft, guess, constraints, &weighed)?;
    if base {
        let crosses = problem.initial(control)?;
        control.step("field", 0.3)?;
        let (crosses, jumps, iterations) = match fixed {
            Some(fixed) => {
                let jumps = problem.prescribed_jumps(&crosses, fixed);
                let most = options.iterations;
                let (crosses, spent) =
                    problem.optimize(&mut problem.system()?, crosses, Some(&jumps), most, control)?;
                (crosses, jumps, spent)
            }
            None => problem.settle(crosses, control)?,
        };
        let singularities = problem.singularities(&crosses, &jumps);
        return Ok(Layout { crosses, jumps, singularities, iterations });
    }
    let coarse = Coarse::new(patch.mesh, guess, constraints)?;
    let edges = EdgeTopology::new(coarse.mesh.points.len(), &coarse.mesh.triangles)?;
    let frames = TriangleFrames::new(&coarse.mesh, &edges)?;
    let forms = coarse.forms(patch.frames, patch.forms, &frames);
    let corners = coarse.corners(patch.mesh.cells, patch.corners);
    let weights = edge_weights(&coarse.mesh, &edges);
    let below = Patch {
        mesh: &coarse.mesh,
        edges: &edges,
        frames: &frames,
        forms: &forms,
        corners: &corners,
        weights: &weights,
    };
    let fixed_below = fixed.map(|fixed| coarse.singularities(patch.mesh.cells, fixed));
    let Layout { crosses, singularities, iterations, .. } =
        layout(&below, coarse.guess.as_deref(), &coarse.constraints, fixed_below.as_deref(), options, control)?;
    let start: Vec<Cross> = (0..patch.mesh.triangles.len())
        .map(|t| {
            let c = coarse.triangles[t] as usize;
            let angle = |a: f64| patch.frames.angle(t, &frames.direction(c, a));
            problem.allowed(t, &Cross::from_angles(angle(crosses[c].u()), angle(crosses[c].v())))
        })
        .collect();
    let mut system = problem.system()?;
    let (jumps, most) = match fixed {
        Some(fixed) => (problem.prescribed_jumps(&start, fixed), options.iterations),
        None => (problem.bordered_jumps(&start), FINE_ITERATIONS),
    };
    let kept = match fixed {
        None if !problem.followed.is_empty() => {
            problem.prescribed_jumps(&start, &coarse.refined(patch.mesh.cells, &singularities))
        }
        _ => jumps.clone(),
    };
    let (mut crosses, mut more) = problem.optimize(&mut system, start.clone(), Some(&jumps), most, control)?;
    let mut jumps = jumps;
    if kept != jumps {
        // Where the start turns at once into the border's direction the nearest quarter turns may be others than on the mesh below.
        let (trial, spent) = problem.optimize(&mut system, start, Some(&kept), most, control)?;
        more += spent;
        if problem.cost(&trial, &kept) <= problem.cost(&crosses, &jumps) {
            (crosses, jumps) = (trial, kept);
        }
    }
    let singularities = problem.singularities(&crosses, &jumps);
    Ok(Layout { crosses, jumps, singularities, iterations: iterations + more })
}

/// Unit vectors along u and v of each cross.
fn directions(frames: &TriangleFrames, crosses: &[Cross]) -> Vec<[Vector3<f64>; 2]> {
    crosses.iter().enumerate().map(|(t, c)| [c.u(), c.v()].map(|a| frames.direction(t, a))).collect()
}

/// How the cross of a triangle may move.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Freedom {
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
    fn unknowns(self) -> usize {
        match self {
            Self::Fixed => 0,
            Self::Bisector | Self::Crossing | Self::AboutU => 1,
            Self::Free => 2,
        }
    }
}

/// Everything the energy needs; angles are in the triangles' frames.
struct Problem<'a> {
    mesh: &'a SurfaceMesh,
    edges: &'a EdgeTopology,
    frames: &'a TriangleFrames,
    forms: &'a [SecondForm],
    conjugacy: Vec<f64>,
    edge_weights: &'a [f64],
    flat: Vec<bool>,
    freedom: Vec<Freedom>,
    /// The cross that a hard constraint asks for.
    hard: Vec<Option<Cross>>,
    floor_triangles: Vec<u32>,
    /// Triangle, angle, weight.
    soft: Vec<(usize, f64, f64)>,
    /// The cross to be near to, and the weight of that.
    target: Vec<(Cross, f64)>,
    orthogonality: Vec<f64>,
    constraint_angles: Vec<(usize, f64, f64)>,
    /// Directions beside the constraints, as constraints.
    parallels: Vec<DirectionConstraint>,
    has_guess: bool,
    floor: f64,
    options: &'a FieldOptions,
    /// The border that the field follows: edges by the vertex that they leave, and quarter turns of the border by vertex.
    followed: BTreeMap<u32, u32>,
    corners: BTreeMap<u32, i32>,
}

impl<'a> Problem<'a> {
    fn new(
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
    fn initial(&self, control: &Control) -> Result<Vec<Cross>, Error> {
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
        let mut system = TriangleSystem::new(self.edges, (0..count).map(|_| 2))?;
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

    /// The cross nearest to `cross` that this problem allows on triangle `t`.
    fn allowed(&self, t: usize, cross: &Cross) -> Cross {
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
    fn system(&self) -> Result<TriangleSystem, Error> {
        TriangleSystem::new(self.edges, self.freedom.iter().map(|f| f.unknowns()))
    }

    fn inner_edges(&self) -> impl Iterator<Item = usize> {
        (0..self.edges.len()).filter(|&e| !self.edges.is_border(e))
    }

    /// Matching, rotation and change across an edge, see [`matching`]; with `jumps`, for the given number of quarter turns instead of the
    /// nearest.
    fn across(&self, e: usize, crosses: &[Cross], jumps: Option<&[i32]>) -> (u8, f64, f64) {
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
    fn energy(&self, crosses: &[Cross], jumps: Option<&[i32]>) -> f64 {
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
    fn optimize(
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

    /// Gauss-Newton from `crosses`, then with the border where the field follows it, then without the singularities that nothing asks for; with
    /// the quarter turns across edges, and the iterations spent.
    ///
    /// Moving the charges of the singularities together, or over the border, by quarter turns across the edges of paths between them makes
    /// a field without them, cracked along the paths; Gauss-Newton closes the cracks where neither conjugacy nor constraints need
    /// them. The result counts if it has fewer singularities at little more energy: first all at once, then close pairs only.
    fn settle(&self, crosses: Vec<Cross>, control: &Control) -> Result<(Vec<Cross>, Vec<i32>, usize), Error> {
        let mut system = self.system()?;
        let (crosses, mut iterations) = self.optimize(&mut system, crosses, None, self.options.iterations, control)?;
        let jumps = self.bordered_jumps(&crosses);
        let (mut crosses, mut jumps, spent) = if jumps == self.nearest_jumps(&crosses) {
            (crosses, jumps, 0)
        } else {
            self.closed(&mut system, crosses, jumps, control)?
        };
        iterations += spent;
        let size = self.frames.areas.iter().sum::<f64>().sqrt();
        let rigidity = self.rigidity();
        let far = if self.followed.is_empty() { FAR_PAIR_ENERGY } else { ALIGNED_PAIR_ENERGY };
        for (reach, saving) in [(f64::INFINITY, far), (CLOSE_PAIR * size, CLOSE_PAIR_ENERGY)] {
            let singularities = self.singularities(&crosses, &jumps);
            let near = |a: u32, b: u32| (self.mesh.position(a) - self.mesh.position(b)).norm() <= reach;
            let leaves = |a: u32, v: u32| near(a, v) && !self.followed.contains_key(&v);
            let (turns, _) = paths(self.mesh, self.edges, &rigidity, &singularities, &near, &leaves);
            if turns.is_empty() {
                continue;
            }
            let mut turned = jumps.clone();
            turns.iter().for_each(|&(edge, quarters)| turned[edge as usize] += quarters);
            let (trial, turned, spent) = self.closed(&mut system, crosses.clone(), turned, control)?;
            iterations += spent;
            let left = self.singularities(&trial, &turned).len();
            let allowed = saving * (singularities.len() as f64 - left as f64);
            let energies = [(&trial, &turned), (&crosses, &jumps)].map(|(c, j)| self.energy(c, Some(j)));
            if left < singularities.len() && energies[0] <= energies[1] + allowed {
                (crosses, jumps) = (trial, turned);
            }
        }
        Ok((crosses, jumps, iterations))
    }

    /// Gauss-Newton with the cracks of `jumps`, then with the smallest rotations, so that singularities find their places. Where the field follows
    /// the border, that counts if none leaves over it, and if it costs no more than to keep to `jumps` on and on.
    fn closed(
        &self,
        system: &mut TriangleSystem,
        crosses: Vec<Cross>,
        jumps: Vec<i32>,
        control: &Control,
    ) -> Result<(Vec<Cross>, Vec<i32>, usize), Error> {
        let most = self.options.iterations.min(REMOVAL_ITERATIONS);
        let (crosses, spent) = self.optimize(system, crosses, Some(&jumps), most, control)?;
        let (free, more) = self.optimize(system, crosses.clone(), None, most, control)?;
        let nearest = self.nearest_jumps(&free);
        if self.followed.is_empty() {
            return Ok((free, nearest, spent + more));
        }
        let (held, last) = self.optimize(system, crosses, Some(&jumps), self.options.iterations, control)?;
        let spent = spent + more + last;
        let turns_with_border = self.border_charges(&free, &nearest).is_empty();
        if turns_with_border && self.cost(&free, &nearest) <= self.cost(&held, &jumps) {
            return Ok((free, nearest, spent));
        }
        Ok((held, jumps, spent))
    }

    /// Energy of crosses with these quarter turns, and what their singularities count for on a border that the field follows.
    fn cost(&self, crosses: &[Cross], jumps: &[i32]) -> f64 {
        let singularities = self.singularities(crosses, jumps).len();
        self.energy(crosses, Some(jumps)) + ALIGNED_PAIR_ENERGY * singularities as f64
    }

    /// Matching of the smallest rotations, and the singularities.
    fn matched(&self, crosses: &[Cross]) -> (Vec<u8>, Vec<Singularity>) {
        match_edges(self.mesh, self.edges, |e| {
            let (k, rotation, _) = self.across(e, crosses, None);
            (k, rotation)
        })
    }

    /// The singularities of crosses with these quarter turns.
    fn singularities(&self, crosses: &[Cross], jumps: &[i32]) -> Vec<Singularity> {
        let across = |e| {
            let (k, rotation, _) = self.across(e, crosses, Some(jumps));
            (k, rotation)
        };
        match_edges(self.mesh, self.edges, across).1
    }

    /// Quarter turns across each edge that make the rotation smallest.
    fn nearest_jumps(&self, crosses: &[Cross]) -> Vec<i32> {
        let mut jumps = vec![0; self.edges.len()];
        for e in self.inner_edges() {
            let [f, g] = self.edges.triangles[e].map(|t| t as usize);
            let (_, rotation, _) = self.across(e, crosses, None);
            let plain = crosses[g].bisector - crosses[f].bisector - self.frames.turns[e];
            jumps[e] = ((rotation - plain) / FRAC_PI_2).round() as i32;
        }
        jumps
    }

    /// Quarter turns across each edge with which `crosses` have the `fixed` singularities and no others, and turn with the border that they
    /// follow; what does not match leaves over the border where they do not.
    fn prescribed_jumps(&self, crosses: &[Cross], fixed: &[Singularity]) -> Vec<i32> {
        let mut jumps = self.nearest_jumps(crosses);
        let mut present = self.matched(crosses).1;
        present.extend(self.border_charges(crosses, &jumps));
        let charges = prescribe::charges(&present, fixed);
        let leaves = |_, v: u32| !self.followed.contains_key(&v);
        let (turns, _) = paths(self.mesh, self.edges, &self.crack_rigidity(), &charges, &|_, _| true, &leaves);
        turns.iter().for_each(|&(edge, quarters)| jumps[edge as usize] += quarters);
        jumps
    }

    /// Border vertices that the cross passes with other quarter turns than the border, both as it should: index 1 where a quad is missing, -1
    /// where there is one too many.
    fn border_charges(&self, crosses: &[Cross], jumps: &[i32]) -> Vec<Singularity> {
        let mut charges = vec![];
        let number = |t: u32, from: u32, to: u32| {
            let along = self.mesh.position(to) - self.mesh.position(from);
            let angle = self.frames.angle(t as usize, &along);
            let cross = &crosses[t as usize];
            let off = |i: i32| {
                let own = if i % 2 == 0 { cross.u() } else { cross.v() } + PI * f64::from(i / 2);
                wrap(own - angle, TAU).abs()
            };
            (0..4).min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0)
        };
        for &edge in self.followed.values() {
            let [before, vertex] = self.edges.vertices[edge as usize];
            let Some(&next) = self.followed.get(&vertex) else { continue };
            let fan = self.edges.fan(vertex);
            let turned: i32 = fan
                .windows(2)
                .filter_map(|pair| {
                    let e = self.edges.between(pair[0], pair[1])? as usize;
                    Some(if self.edges.triangles[e][0] == pair[0] { jumps[e] } else { -jumps[e] })
                })
                .sum();
            let out = number(fan[0], vertex, self.edges.vertices[next as usize][1]);
            let back = number(fan[fan.len() - 1], vertex, before);
            let wanted = 2 - self.corners.get(&vertex).copied().unwrap_or(0);
            // Quads are known up to four, by the angle at the vertex.
            let most = inner_angle(self.mesh, self.edges, vertex) / FRAC_PI_2 - f64::from(wanted);
            let index = (wanted - (back - out - turned)).rem_euclid(4);
            let index = if index > 2 || (index == 2 && most > 0.0) { index - 4 } else { index };
            if index != 0 {
                charges.push(Singularity { vertex, index });
            }
        }
        charges
    }

    /// The nearest quarter turns, but with the border where the field follows it: a charge of the border meets the nearest opposite one, or
    /// moves inside.
    fn bordered_jumps(&self, crosses: &[Cross]) -> Vec<i32> {
        let mut jumps = self.nearest_jumps(crosses);
        let border = self.border_charges(crosses, &jumps);
        if border.is_empty() {
            return jumps;
        }
        let mut charges = self.matched(crosses).1;
        charges.extend(&border);
        let on_border = |v: u32| self.edges.is_border_vertex(v);
        let meet = |a: u32, b: u32| on_border(a) || on_border(b);
        let leaves = |a: u32, v: u32| on_border(a) && !self.followed.contains_key(&v);
        let rigidity = self.crack_rigidity();
        let (turns, mut left) = paths(self.mesh, self.edges, &rigidity, &charges, &meet, &leaves);
        turns.iter().for_each(|&(edge, quarters)| jumps[edge as usize] += quarters);
        left.retain(|charge| on_border(charge.vertex));
        let depth = INWARD * self.frames.areas.iter().sum::<f64>().sqrt();
        let turns = inward(self.mesh, self.edges, &rigidity, &left, depth);
        turns.iter().for_each(|&(edge, quarters)| jumps[edge as usize] += quarters);
        jumps
    }

    /// How dear a crack is on each triangle, where it could not close across a line that the field follows.
    fn crack_rigidity(&self) -> Vec<f64> {
        let mut rigidity = self.rigidity();
        for &(t, _, weight) in &self.soft {
            rigidity[t] += weight;
        }
        for (rigid, hard) in rigidity.iter_mut().zip(&self.hard) {
            *rigid += if hard.is_some() { HARD_WEIGHT } else { 0.0 };
        }
        rigidity
    }

    /// How firmly each triangle holds its cross, from 0 (free to turn) to 1.
    fn rigidity(&self) -> Vec<f64> {
        let rigid = |t: usize| match self.freedom[t] {
            Freedom::Fixed => 1.0,
            Freedom::AboutU => 0.5,
            Freedom::Bisector | Freedom::Crossing | Freedom::Free => {
                let (h, d) = (self.forms[t].h.powi(2), self.forms[t].deviator().powi(2));
                if self.flat[t] { 0.0 } else { ((d - h) / (d + h)).max(0.0) }
            }
        };
        (0..self.freedom.len()).map(rigid).collect()
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

    /// Directions, matching, singularities and measures of the finished crosses.
    fn finish(&self, crosses: &[Cross], jumps: &[i32], iterations: usize) -> Finished {
        let directions = directions(self.frames, crosses);
        let (matching, singularities) = match_edges(self.mesh, self.edges, |e| {
            let (k, rotation, _) = self.across(e, crosses, Some(jumps));
            (k, rotation)
        });
        let mut diagnostics = FieldDiagnostics {
            crossing_min_deg: 90.0,
            smoothness_energy: weighted_energy(self.edges, self.frames, &directions, self.edge_weights),
            floor_triangles: self.floor_triangles.clone(),
            iterations,
            ..FieldDiagnostics::default()
        };
        let mut curved = 0.0;
        for (t, cross) in crosses.iter().enumerate() {
            diagnostics.crossing_min_deg = diagnostics.crossing_min_deg.min(cross.crossing().to_degrees());
            if self.flat[t] {
                diagnostics.flat_triangles.push(t as u32);
                continue;
            }
            let residual = self.forms[t].residual(cross).abs();
            diagnostics.conjugacy_mean += residual * self.frames.areas[t];
            diagnostics.conjugacy_max = diagnostics.conjugacy_max.max(residual);
            curved += self.frames.areas[t];
        }
        if curved > 0.0 {
            diagnostics.conjugacy_mean /= curved;
        }
        let total: f64 = self.constraint_angles.iter().map(|c| c.2).sum();
        for &(t, angle, weight) in &self.constraint_angles {
            let difference = nearest_direction(&crosses[t], angle).1.abs().to_degrees();
            diagnostics.constraint_angle_deg += difference * weight / total;
        }
        Finished { directions, matching, singularities, diagnostics }
    }
}

/// What [`Problem::finish`] adds to the mesh.
struct Finished {
    directions: Vec<[Vector3<f64>; 2]>,
    matching: Vec<u8>,
    singularities: Vec<Singularity>,
    diagnostics: FieldDiagnostics,
}

/// Panels of a mesh, unless the options give their length.
const DEFAULT_PANELS: f64 = 500.0;
/// Weight of a hard constraint in the initial system, edges weighing about 1.
const HARD_WEIGHT: f64 = 1e3;
/// Rounds of the initial system.
const INITIAL_ROUNDS: usize = 3;
/// What a singularity may save of the energy before its removal is refused. One of quarter index over n triangles across costs about
/// (pi / 2)^2 / (2 pi) log n, 1.4 for n = 40; far ones give the lines room to spread, close pairs no mesh can show.
const FAR_PAIR_ENERGY: f64 = 0.3;
const CLOSE_PAIR_ENERGY: f64 = 1.5;
/// The same for far ones where the field follows the border: a border that turns away from what conjugacy asks for makes singularities on its own.
const ALIGNED_PAIR_ENERGY: f64 = 0.6;
/// Most Gauss-Newton iterations with, and again without, the jumps of a removal.
const REMOVAL_ITERATIONS: usize = 4;
/// Most cells along a side of the mesh on which the layout finds its topology.
const BASE_CELLS: usize = 24;
/// How much more conjugacy weighs on finer meshes.
const FINE_CONJUGACY: f64 = 4.0;
/// Most Gauss-Newton iterations of the layout on each finer mesh, and of the exactly conjugate field.
const FINE_ITERATIONS: usize = 4;
const EXACT_ITERATIONS: usize = 3;
/// Share of the energy that an iteration has to gain for another one.
const GAIN: f64 = 3e-3;
/// Distance from the border to which a charge of it moves inside, in square roots of the area.
const INWARD: f64 = 0.12;
/// Distance of singularities that count as a close pair, in square roots of the area.
const CLOSE_PAIR: f64 = 0.15;
/// Damping at which no step is to be hoped for.
const MOST_DAMPING: f64 = 1e4;
/// Largest change of an angle in one Gauss-Newton step, radians.
const MAX_STEP: f64 = 0.4;

/// The cross of the principal directions.
fn principal_cross(form: &SecondForm) -> Cross {
    Cross { bisector: form.principal_angle() + FRAC_PI_4, half_crossing: FRAC_PI_4 }
}

/// How well the principal directions are defined: (k1 - k2)^2 / (k1^2 + k2^2), at most 1; 1 at hyperbolic points.
fn distinctness(form: &SecondForm) -> f64 {
    let (h, d) = (form.h.powi(2), form.deviator().powi(2));
    if h + d == 0.0 { 0.0 } else { (2.0 * d / (h + d)).min(1.0) }
}

/// The direction number of (u, v, -u, -v) nearest to `angle`, and its angle beyond.
fn nearest_direction(cross: &Cross, angle: f64) -> (usize, f64) {
    let u = wrap(cross.u() - angle, PI);
    let v = wrap(cross.v() - angle, PI);
    if u.abs() <= v.abs() { (0, u) } else { (1, v) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::test_surfaces::*;
    use nalgebra::{Point3, Rotation3};

    fn solve(mesh: SurfaceMesh, constraints: &[DirectionConstraint]) -> ConjugateField {
        conjugate_field(mesh, None, constraints, &FieldOptions::default(), &Control::default()).unwrap()
    }

    /// Smallest angle between the line of `direction` and the lines of the two families, degrees.
    fn angle_to(field: &ConjugateField, t: usize, direction: &Vector3<f64>) -> f64 {
        let cosine = field.directions[t].iter().map(|d| d.dot(direction).abs()).fold(0.0, f64::max);
        (cosine / direction.norm()).min(1.0).acos().to_degrees()
    }

    /// S_u and S_v at the middle of a triangle, as means over its vertices.
    fn parameter_directions(mesh: &SurfaceMesh, t: usize) -> [Vector3<f64>; 2] {
        let normal = mesh.triangle_normal_area(t).0;
        let points = mesh.triangles[t].map(|v| &mesh.points[v as usize]);
        [points.iter().map(|p| p.du).sum::<Vector3<f64>>(), points.iter().map(|p| p.dv).sum()]
            .map(|d| d - normal * normal.dot(&d))
    }

    fn follow_u(mesh: &SurfaceMesh, weight: f64) -> Vec<DirectionConstraint> {
        (0..mesh.triangles.len())
            .map(|t| DirectionConstraint { triangle: t as u32, direction: parameter_directions(mesh, t)[0], weight })
            .collect()
    }

    #[test]
    fn one_family_of_a_translational_or_rotational_surface_gives_the_other() {
        for surface in [translational(), rotational()] {
            for weight in [f64::INFINITY, 30.0] {
                let mesh = SurfaceMesh::new(&surface, [24, 24]).unwrap();
                let constraints = follow_u(&mesh, weight);
                let field = solve(mesh, &constraints);
                let mut worst = 0.0f64;
                for t in 0..field.directions.len() {
                    for d in parameter_directions(&field.mesh, t) {
                        worst = worst.max(angle_to(&field, t, &d));
                    }
                }
                assert!(worst < 1.5, "{worst} degrees at weight {weight}");
                assert!(field.singularities.is_empty());
                assert!(field.diagnostics.floor_triangles.is_empty());
                assert!(field.diagnostics.conjugacy_max < 1e-9);
            }
        }
    }

    #[test]
    fn an_ellipsoid_has_orthogonal_principal_directions() {
        let mesh = SurfaceMesh::new(&ellipsoid([3.0, 2.0, 1.5]), [20, 20]).unwrap();
        let options = FieldOptions { principal_weight: 1e5, ..FieldOptions::default() };
        let field = conjugate_field(mesh, None, &[], &options, &Control::default()).unwrap();
        assert!(field.diagnostics.conjugacy_max < 1e-9);
        for t in 0..field.directions.len() {
            let [u, v] = field.directions[t];
            let normal = field.mesh.triangle_normal_area(t).0;
            assert!(u.cross(&v).dot(&normal) > 0.0 && u.dot(&normal).abs() < 1e-12);
            assert!((u.norm() - 1.0).abs() < 1e-12 && (v.norm() - 1.0).abs() < 1e-12);
            assert!(u.dot(&v).abs() < 0.05, "{t}: {}", u.dot(&v));
        }
    }

    #[test]
    fn asymptotic_constraints_on_a_saddle_are_reported_and_keep_the_floor() {
        // z = x y: the parameter lines are rulings, hence asymptotic.
        let mesh = SurfaceMesh::new(&graph(|x, y| 0.5 * x * y), [16, 16]).unwrap();
        let hard = follow_u(&mesh, f64::INFINITY);
        let field = solve(mesh.clone(), &hard);
        assert_eq!(field.diagnostics.floor_triangles.len(), mesh.triangles.len());
        assert!(field.diagnostics.crossing_min_deg >= 20.0 - 1e-6);
        assert!(field.diagnostics.constraint_angle_deg < 1e-6);
        // A soft one gives way instead, and conjugacy stays.
        let soft = follow_u(&mesh, 10.0);
        let field = solve(mesh, &soft);
        assert!(field.diagnostics.floor_triangles.is_empty());
        assert!(field.diagnostics.conjugacy_max < 1e-9);
        assert!(field.diagnostics.crossing_min_deg >= 20.0 - 1e-6);
    }

    #[test]
    fn the_field_follows_rotation_and_scale() {
        let surface = wavy(3);
        let mesh = SurfaceMesh::new(&surface, [12, 14]).unwrap();
        let constraints = vec![
            DirectionConstraint { triangle: 100, direction: Vector3::new(1.0, 0.4, 0.2), weight: 20.0 },
            DirectionConstraint { triangle: 200, direction: Vector3::new(0.1, 1.0, 0.0), weight: f64::INFINITY },
        ];
        let field = solve(mesh, &constraints);
        let rotation = Rotation3::from_euler_angles(0.4, -1.1, 2.0);
        let moved = surface.mapped(|p| Point3::from(rotation * p.coords * 37.0 + Vector3::new(5.0, 6.0, 7.0)));
        let turned: Vec<_> =
            constraints.iter().map(|c| DirectionConstraint { direction: rotation * c.direction, ..*c }).collect();
        let other = solve(SurfaceMesh::new(&moved, [12, 14]).unwrap(), &turned);
        for t in 0..field.directions.len() {
            for d in field.directions[t] {
                assert!(angle_to(&other, t, &(rotation * d)) < 0.01);
            }
        }
        assert_eq!(field.singularities, other.singularities);
        let energies = [field.diagnostics.smoothness_energy, other.diagnostics.smoothness_energy];
        assert!((energies[0] - energies[1]).abs() < 1e-3 * energies[0]);
    }

    #[test]
    fn random_surfaces_with_random_constraints_are_conjugate_above_the_floor() {
        for seed in 0..12 {
            let mesh = SurfaceMesh::new(&wavy(seed), [16, 16]).unwrap();
            let constraints: Vec<_> = (0..(seed % 4) as usize * 3)
                .map(|i| {
                    let triangle = ((i * 7919 + seed as usize * 104_729) % mesh.triangles.len()) as u32;
                    let t = (i as f64 + 1.0) * 2.399 + seed as f64;
                    let weight = if i % 2 == 0 { f64::INFINITY } else { 20.0 };
                    DirectionConstraint { triangle, direction: Vector3::new(t.cos(), t.sin(), 0.0), weight }
                })
                .collect();
            let field = solve(mesh, &constraints);
            let d = &field.diagnostics;
            assert!(d.conjugacy_mean <= 1e-3, "seed {seed}: {}", d.conjugacy_mean);
            assert!(d.crossing_min_deg >= 20.0 - 1e-6, "seed {seed}: {}", d.crossing_min_deg);
            // Sum of matchings around each vertex agrees with its index modulo four.
            for vertex in 0..field.mesh.points.len() as u32 {
                if field.edges.is_border_vertex(vertex) {
                    continue;
                }
                let fan = field.edges.fan(vertex);
                let sum: u32 = (0..fan.len())
                    .map(|i| {
                        let (a, b) = (fan[i], fan[(i + 1) % fan.len()]);
                        let e = field.edges.between(a, b).unwrap();
                        u32::from(field.matching_across(e, a, b))
                    })
                    .sum();
                let index = field.singularities.iter().find(|s| s.vertex == vertex).map_or(0, |s| s.index);
                assert_eq!(sum as i32 % 4, index.rem_euclid(4), "vertex {vertex}");
            }
        }
    }

    #[test]
    fn bad_input_is_refused() {
        let mesh = SurfaceMesh::new(&wavy(1), [4, 4]).unwrap();
        let run = |guess: Option<&[[Vector3<f64>; 2]]>, constraints: &[DirectionConstraint], options: FieldOptions| {
            conjugate_field(mesh.clone(), guess, constraints, &options, &Control::default())
        };
        let options = FieldOptions::default();
        assert!(run(Some(&[]), &[], options).is_err());
        let far = DirectionConstraint { triangle: 32, direction: Vector3::x(), weight: 1.0 };
        assert!(run(None, &[far], options).is_err());
        let nan = DirectionConstraint { triangle: 0, direction: Vector3::new(f64::NAN, 0.0, 0.0), weight: 1.0 };
        assert!(run(None, &[nan], options).is_err());
        assert!(run(None, &[], FieldOptions { crossing_floor_deg: 90.0, ..options }).is_err());
        assert!(run(None, &[], FieldOptions { guess_weight: f64::NAN, ..options }).is_err());
        let control = Control::default();
        control.cancel();
        assert_eq!(conjugate_field(mesh.clone(), None, &[], &options, &control).err(), Some(Error::Cancelled));
    }

    #[test]
    fn bumps_smaller_than_panels_leave_no_singularities() {
        // Second differences of the noise are larger than those of the dome.
        let noise = |x: f64, y: f64| 0.012 * (37.0 * x + 11.0 * y).sin() * (29.0 * y - 17.0 * x).cos();
        let dome = |x: f64, y: f64| -0.3 * x * x - 0.15 * y * y;
        let mesh = SurfaceMesh::new(&graph(|x, y| dome(x, y) + noise(x, y)), [40, 40]).unwrap();
        let frames =
            TriangleFrames::new(&mesh, &EdgeTopology::new(mesh.points.len(), &mesh.triangles).unwrap()).unwrap();
        let saddles = second_forms(&mesh, &frames).iter().filter(|form| !form.by_bisector()).count();
        assert!(saddles > mesh.triangles.len() / 10, "{saddles}");
        let line = DirectionConstraint { triangle: 1600, direction: Vector3::x(), weight: 300.0 };
        let field = solve(mesh, &[line]);
        assert!(field.singularities.is_empty(), "{:?}", field.singularities);
        assert!(field.diagnostics.conjugacy_max < 1e-9);
    }

    #[test]
    fn a_plane_has_a_field_without_singularities() {
        let field = solve(SurfaceMesh::new(&graph(|_, _| 0.0), [8, 8]).unwrap(), &[]);
        assert!(field.singularities.is_empty());
        assert_eq!(field.diagnostics.flat_triangles.len(), 128);
        assert!(field.diagnostics.smoothness_energy < 1e-6);
        assert!(field.diagnostics.crossing_min_deg > 80.0);
    }

    #[test]
    fn a_pair_that_nothing_asks_for_is_removed() {
        let mesh = SurfaceMesh::new(&graph(|_, _| 0.0), [20, 20]).unwrap();
        let edges = EdgeTopology::new(mesh.points.len(), &mesh.triangles).unwrap();
        let frames = TriangleFrames::new(&mesh, &edges).unwrap();
        for distance in [0.13, 0.45] {
            let crosses: Vec<Cross> = (0..mesh.triangles.len())
                .map(|t| {
                    let p: Vector3<f64> = mesh.triangles[t].iter().map(|&v| mesh.position(v).coords / 3.0).sum();
                    let bisector = 0.25 * (p.y.atan2(p.x - distance) - p.y.atan2(p.x + distance));
                    Cross { bisector: bisector + frames.angle(t, &Vector3::x()), half_crossing: FRAC_PI_4 }
                })
                .collect();
            let options = FieldOptions::default();
            let forms = second_forms(&mesh, &frames);
            let weights = edge_weights(&mesh, &edges);
            let patch =
                Patch { mesh: &mesh, edges: &edges, frames: &frames, forms: &forms, corners: &[], weights: &weights };
            let problem = Problem::new(&patch, Conjugacy::Soft, None, &[], &options).unwrap();
            let indices: Vec<i32> = problem.matched(&crosses).1.iter().map(|s| s.index).collect();
            assert_eq!((indices.len(), indices.iter().sum::<i32>()), (2, 0));
            let (settled, ..) = problem.settle(crosses, &Control::default()).unwrap();
            assert!(problem.matched(&settled).1.is_empty());
            assert!(problem.energy(&settled, None) < 1e-3);
        }
    }

    #[test]
    #[ignore = "prints timings: run it in release"]
    fn timing() {
        for seed in 0..8 {
            let mesh = SurfaceMesh::new(&wavy(seed), [40, 40]).unwrap();
            let start = std::time::Instant::now();
            let field = solve(mesh, &[]);
            let ms = start.elapsed().as_secs_f64() * 1e3;
            println!("{ms:.1} ms, {} singular, {:?}", field.singularities.len(), {
                let mut d = field.diagnostics;
                d.flat_triangles.truncate(3);
                d
            });
        }
    }

    #[test]
    #[ignore = "draws to the file named by FIELD_PICTURE"]
    fn draw_fields() {
        use crate::field::test_picture::{SIDE, draw};
        let file = std::env::var("FIELD_PICTURE").unwrap();
        let mut sheet = tiny_skia::Pixmap::new(4 * SIDE as u32, 2 * SIDE as u32).unwrap();
        sheet.fill(tiny_skia::Color::WHITE);
        for seed in 0..8u64 {
            let mesh = SurfaceMesh::new(&wavy(seed), [40, 40]).unwrap();
            let mut constraints = vec![];
            if seed >= 4 {
                for i in 0..20 {
                    let triangle = 2 * (40 * (8 + i) + 10 + i / 2) as u32;
                    let direction = Vector3::new(1.0, 0.5, 0.0);
                    constraints.push(DirectionConstraint { triangle, direction, weight: 20.0 });
                }
            }
            let field = solve(mesh, &constraints);
            draw(&mut sheet, [(seed % 4) as f32, (seed / 4) as f32], &field, &constraints);
        }
        sheet.save_png(file).unwrap();
    }
}
