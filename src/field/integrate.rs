//! From a field to a seamless map: two functions whose isolines follow the two families, continuous up to quarter turns and
//! integer shifts across seams.

// Half-edges, corners and families are numbers that index several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::conjugate_field::ConjugateField;
use super::relations::{Relations, Terms, add};
use super::seams::{Gauss, NONE, Seams, turned};
use crate::control::Control;
use crate::error::Error;
use crate::numeric::{Cholesky, SymbolicCholesky};
use crate::surface::SurfaceMesh;
use nalgebra::{DMatrix, DVector, Vector3};
use sprs::CsMat;

/// One cell of the integer grid, in the fixed-point units of [`SeamlessMap::corners`]: 2^40.
pub const MAP_UNIT: i64 = 1 << 40;

/// How dense the map's integer grid shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Density {
    /// Side of a square with the mean cell's area, model units.
    EdgeLength(f64),
    /// Number of cells: the surface's area over the mean cell's area.
    CellCount(f64),
}

/// Whether sides of the patch become isolines at integers, so that no cell is cut there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SideFit {
    /// Never.
    Off,
    /// Those that the field was asked to follow, with a corner wherever the border turns against it; others where the same family follows
    /// the whole side within this angle, radians.
    Within(f64),
}

/// How [`integrate`] shapes the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapOptions {
    /// Cells per area.
    pub density: Density,
    /// Weight of equal cell sizes against following the field's directions, in (0, 1]; small, because sizes may give.
    pub size_weight: f64,
    /// Rounds in which each place's target size is adapted to what the directions allow; 0 asks for equal sizes.
    pub size_rounds: usize,
    /// Sides that become isolines.
    pub sides: SideFit,
    /// Most rounds of raising weights where the map is turned over.
    pub stiffening_rounds: usize,
    /// Singularities of opposite index that are closer than this cancel, in edge lengths of the `density`: the grid could not tell
    /// them apart.
    pub pair_distance: f64,
    /// Singularities closer than this to the border are moved over it, in edge lengths.
    pub rim_distance: f64,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self {
            density: Density::CellCount(500.0),
            size_weight: 0.05,
            size_rounds: 1,
            sides: SideFit::Within(6f64.to_radians()),
            stiffening_rounds: 6,
            pair_distance: 1.0,
            rim_distance: 0.5,
        }
    }
}

/// What happens to map coordinates across a half-edge: z becomes i^turn z + shift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transition {
    /// Quarter turns, 0 to 3.
    pub turn: u8,
    /// Integer shift, in cells.
    pub shift: [i64; 2],
}

/// A seamless integer-grid map of a patch: on each triangle linear coordinates (a, b).
///
/// Isolines of a follow the field's v and those of b its u. Half-edge 3 t + k runs from corner k of triangle t to the next corner.
/// All coordinates are exact multiples of 1 / [`MAP_UNIT`], so both sides of a seam agree exactly. Those of singular vertices are integers; no
/// other vertex has an integer coordinate (they are moved off by one unit), so that no isoline of an integer meets a vertex elsewhere.
#[derive(Clone, Debug)]
pub struct SeamlessMap {
    /// The triangulated patch.
    pub mesh: SurfaceMesh,
    /// Coordinates of the three corners of each triangle, in 1 / [`MAP_UNIT`].
    pub corners: Vec<[[i64; 2]; 3]>,
    /// Half-edge on the other side of each half-edge, `u32::MAX` on the border.
    pub twin: Vec<u32>,
    /// For each vertex the first half-edge that leaves it, counter-clockwise; on the border the one without twin.
    pub outgoing: Vec<u32>,
    /// Transition across each half-edge from its triangle to the other one.
    pub transitions: Vec<Transition>,
    /// Singular vertices; integer coordinates in every triangle around them.
    pub singular: Vec<u32>,
    /// For each triangle, which direction (0 to 3 of u, v, -u, -v) a grows along.
    pub name: Vec<u8>,
    /// Sides of the patch (v = min, u = max, v = max, u = min) that are isolines at integers.
    pub fitted_sides: [bool; 4],
    /// Quality.
    pub diagnostics: MapDiagnostics,
}

/// Quality of a [`SeamlessMap`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapDiagnostics {
    /// Triangles turned over by the map.
    pub flipped: usize,
    /// Total signed area in cells.
    pub cells: f64,
    /// Mean angle between isolines and the field, over area and both families, degrees.
    pub direction_mean_deg: f64,
    /// Rounds of stiffening used.
    pub stiffening_rounds: usize,
}

/// Integrates `field` to a seamless map.
///
/// # Errors
/// [`Error::Argument`] for options outside their range, [`Error::Singular`] if the linear system cannot be factorized,
/// [`Error::Degenerate`] for a field without area, [`Error::Cancelled`].
///
/// # Source
/// Sketch2PQ, Sec. 3.2.4 leaves this to Liu et al. 2011; the mixed-integer formulation is that of Bommes et al. 2009, with
/// three departures: directions weigh more than sizes and the sizes adapt, seams are eliminated exactly instead of penalized, and
/// integers are rounded one after another on the small dense Schur complement of a single factorization.
pub fn integrate(field: &ConjugateField, options: &MapOptions, control: &Control) -> Result<SeamlessMap, Error> {
    Integrator::new(field, options, control)?.map(options.density, control)
}

/// A field prepared for maps of several densities: combed, cut, factorized.
pub struct Integrator<'a> {
    field: &'a ConjugateField,
    options: MapOptions,
    seams: Seams,
    triangles: Vec<Element>,
    system: System,
    vertex_forms: Vec<[Form; 2]>,
    relations: Relations,
    /// Side from which the domain lies on fitted coordinates: the sign of one unit off the integer.
    inward: Vec<[i8; 2]>,
    fitted_sides: [bool; 4],
    sizes: Vec<[f64; 2]>,
    base: Reduced,
    relaxed_cells: f64,
}

/// A map coordinate of a vertex.
#[derive(Clone, Debug, PartialEq)]
enum Form {
    /// A real unknown.
    Free(u32),
    /// An integer combination of integer unknowns.
    Integer(Terms),
}

/// What the energy needs of one triangle.
struct Element {
    area: f64,
    /// Derivatives of the three hat functions along the combed directions d_0, d_1.
    along: [[f64; 3]; 2],
    /// Gradients of the hat functions in an orthonormal frame.
    gradient: [[f64; 2]; 3],
    /// Sine of the crossing angle.
    crossing: f64,
    /// Lines on the triangle that the map follows.
    lines: Vec<Line>,
}

/// A line that one family of isolines follows on a triangle.
struct Line {
    /// Number of the combed direction that the line belongs to.
    family: usize,
    /// Derivatives of the three hat functions along the line.
    along: [f64; 3],
    /// Weight of the squared angle, the field weighing 1.
    weight: f64,
}

impl<'a> Integrator<'a> {
    /// Cuts and combs the field, adapts the sizes, and factorizes the final system.
    ///
    /// # Errors
    /// As [`integrate`].
    pub fn new(field: &'a ConjugateField, options: &MapOptions, control: &Control) -> Result<Self, Error> {
        if !(options.size_weight > 0.0 && options.size_weight <= 1.0) {
            let value = options.size_weight.to_string();
            return Err(Error::Argument { name: "size_weight", value, expected: "more than 0, at most 1" });
        }
        let area: f64 = (0..field.mesh.triangles.len()).map(|t| field.mesh.triangle_normal_area(t).1).sum();
        let edge = match options.density {
            Density::EdgeLength(edge) => edge,
            Density::CellCount(count) => (area / count).sqrt(),
        };
        // What a host fixed stays, even where the grid is too coarse to show it.
        let reach = if field.fixed_singularities { 0.0 } else { edge };
        let seams = Seams::new(field, options.pair_distance * reach, options.rim_distance * reach);
        let triangles = elements(field, &seams)?;
        let mut layout = Layout::new(field, &seams);
        layout.fit_border(field, &seams, options.sides);
        layout.pin(field, &seams);
        let Layout { forms: vertex_forms, inward, fitted_sides, free, integers, relations } = layout;
        let relations = Relations::new(integers, &relations);
        let system = System::new(field, &seams, &vertex_forms, free, &relations)?;
        let start = vec![[1.0, 1.0]; triangles.len()];
        // Sizes are in units of cells per length for a map of about 500 cells; only their ratios matter.
        let unit = (500.0 / area).sqrt();
        let mut integrator = Self {
            field,
            options: *options,
            seams,
            triangles,
            system,
            vertex_forms,
            relations,
            inward,
            fitted_sides,
            sizes: start.iter().map(|s| s.map(|x| x * unit)).collect(),
            base: Reduced::default(),
            relaxed_cells: 0.0,
        };
        let stiffness = vec![1.0; integrator.triangles.len()];
        for round in 0..=options.size_rounds {
            control.step("map", round as f64 / (options.size_rounds + 2) as f64)?;
            let (values, gradient) = integrator.assemble(&stiffness);
            integrator.base = integrator.system.reduce(values, gradient)?;
            let y = integrator.base.relaxed();
            let solution = integrator.base.solution(1.0, &y);
            let corners = integrator.system.corners(&solution);
            if round < options.size_rounds {
                integrator.adapt_sizes(&corners, unit);
            } else {
                integrator.relaxed_cells = corners.iter().map(signed_area).sum();
            }
        }
        Ok(integrator)
    }

    /// The map of this density.
    ///
    /// # Errors
    /// As [`integrate`].
    pub fn map(&self, density: Density, control: &Control) -> Result<SeamlessMap, Error> {
        let area: f64 = self.triangles.iter().map(|t| t.area).sum();
        let (name, value, cells) = match density {
            Density::EdgeLength(edge) => ("edge_length", edge, area / (edge * edge)),
            Density::CellCount(count) => ("cell_count", count, count),
        };
        if !(value > 0.0 && cells.is_finite() && cells <= 1e7) {
            return Err(Error::Argument {
                name,
                value: value.to_string(),
                expected: "positive, for at most 10^7 cells",
            });
        }
        if !(self.relaxed_cells > 0.0 && self.relaxed_cells.is_finite()) {
            return Err(Error::NoMesh { reason: "the field's map has no area".into() });
        }
        let scale = (cells / self.relaxed_cells).sqrt();
        let y = self.base.rounded(scale);
        let mut corners = self.system.corners(&self.base.solution(scale, &y));
        let mut solution = self.base.solution(scale, &y);
        let mut flipped = flipped(&corners);
        let mut rounds = 0;
        // Raise the weight of sizes around turned-over triangles until they turn back.
        let mut stiffness = vec![1.0; self.triangles.len()];
        while !flipped.is_empty() && rounds < self.options.stiffening_rounds {
            control.step("map", 0.8)?;
            rounds += 1;
            for &t in &flipped {
                for corner in self.field.mesh.triangles[t] {
                    for h in self.seams.fan(corner as usize) {
                        stiffness[h / 3] *= 1.6;
                    }
                }
            }
            let (values, gradient) = self.assemble(&stiffness);
            let next = self.system.solve(values, gradient, scale, &y)?;
            let next_corners = self.system.corners(&next);
            let next_flipped = self::flipped(&next_corners);
            if next_flipped.len() <= flipped.len() {
                (corners, solution) = (next_corners, next);
            }
            flipped = next_flipped;
        }
        let diagnostics = MapDiagnostics {
            flipped: self::flipped(&corners).len(),
            cells: corners.iter().map(signed_area).sum(),
            direction_mean_deg: self.direction_error(&corners),
            stiffening_rounds: rounds,
        };
        let (corners, transitions) =
            self.quantize(&solution, &self.relations.values(&y.iter().map(|&x| x as i64).collect::<Vec<_>>()));
        Ok(SeamlessMap {
            mesh: self.field.mesh.clone(),
            corners,
            twin: self.seams.twin.clone(),
            outgoing: self.seams.outgoing.clone(),
            transitions,
            singular: self.seams.singular.clone(),
            name: self.seams.name.clone(),
            fitted_sides: self.fitted_sides,
            diagnostics,
        })
    }

    /// Assembles the energy
    /// sum over triangles and families of A (sin^2(crossing) (grad a . v)^2 / s^2 + w (grad a . u / s - 1)^2)
    /// as matrix values and gradient. The first term is about the squared angle between isoline and field; lines that the field follows add more
    /// of that along themselves.
    fn assemble(&self, stiffness: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut values = vec![0.0; self.system.slots];
        let mut gradient = vec![0.0; self.system.free + self.system.integers];
        for (t, element) in self.triangles.iter().enumerate() {
            let mut hessian = [0.0; 18];
            let mut right = [0.0; 6];
            let weight = element.area * stiffness[t].min(1e4);
            let size_weight = (self.options.size_weight * stiffness[t] * stiffness[t]).min(1.0) * weight;
            for family in 0..2 {
                let inverse = 1.0 / self.sizes[t][family];
                let (across, along) = (&element.along[1 - family], &element.along[family]);
                let direction_weight = weight * element.crossing * element.crossing;
                for i in 0..3 {
                    right[3 * family + i] = size_weight * along[i] * inverse;
                    for j in 0..3 {
                        hessian[9 * family + 3 * i + j] = inverse
                            * inverse
                            * (direction_weight * across[i] * across[j] + size_weight * along[i] * along[j]);
                    }
                }
            }
            for line in &element.lines {
                let family = 1 - line.family;
                let scale = weight * line.weight / (self.sizes[t][family] * self.sizes[t][family]);
                for i in 0..3 {
                    for j in 0..3 {
                        hessian[9 * family + 3 * i + j] += scale * line.along[i] * line.along[j];
                    }
                }
            }
            self.system.add(t, &hessian, &right, &mut values, &mut gradient);
        }
        (values, gradient)
    }

    /// Moves each triangle's target sizes to those of the map, smoothed over neighbours and bounded.
    fn adapt_sizes(&mut self, corners: &[[[f64; 2]; 3]], unit: f64) {
        let mut logs: Vec<[f64; 2]> = (0..self.triangles.len())
            .map(|t| {
                [0, 1].map(|family| {
                    let element = &self.triangles[t];
                    let slope: f64 = (0..3).map(|i| element.along[family][i] * corners[t][i][family]).sum();
                    (slope / unit).clamp(0.15, 6.0).ln()
                })
            })
            .collect();
        for _ in 0..3 {
            let before = logs.clone();
            for t in 0..logs.len() {
                let mut sum = before[t];
                let mut count = 1.0;
                for h in 3 * t..3 * t + 3 {
                    let other = self.seams.twin[h];
                    if other != NONE {
                        let there = before[other as usize / 3];
                        let odd = self.seams.turn[h] % 2 == 1;
                        sum[0] += there[usize::from(odd)];
                        sum[1] += there[usize::from(!odd)];
                        count += 1.0;
                    }
                }
                logs[t] = sum.map(|s| s / count);
            }
        }
        for (size, log) in self.sizes.iter_mut().zip(&logs) {
            *size = log.map(|l| unit * l.exp());
        }
    }

    /// Mean angle between isolines and field, degrees.
    fn direction_error(&self, corners: &[[[f64; 2]; 3]]) -> f64 {
        let (mut sum, mut area) = (0.0, 0.0);
        for (element, corners) in self.triangles.iter().zip(corners) {
            for family in 0..2 {
                let mut gradient = [0.0; 2];
                let mut across = 0.0;
                for (i, corner) in corners.iter().enumerate() {
                    let value = corner[family];
                    gradient[0] += element.gradient[i][0] * value;
                    gradient[1] += element.gradient[i][1] * value;
                    across += element.along[1 - family][i] * value;
                }
                let norm = gradient[0].hypot(gradient[1]);
                let sine: f64 = if norm > 0.0 { (across / norm).clamp(-1.0, 1.0) } else { 1.0 };
                sum += element.area * sine.abs().asin();
                area += element.area;
            }
        }
        (sum / area).to_degrees()
    }

    /// Exact coordinates and transitions for the integers `y`.
    fn quantize(&self, solution: &[f64], y: &[i64]) -> (Vec<[[i64; 2]; 3]>, Vec<Transition>) {
        let vertices: Vec<Gauss> = self
            .vertex_forms
            .iter()
            .zip(&self.inward)
            .map(|(forms, inward)| {
                [0, 1].map(|i| match &forms[i] {
                    Form::Free(x) => (solution[*x as usize] * (MAP_UNIT / 2) as f64).floor() as i64 * 2 + 1,
                    Form::Integer(terms) => integer_value(terms, y) * MAP_UNIT + i64::from(inward[i]),
                })
            })
            .collect();
        let position = |s: u32| [0, 1].map(|i| self.singularity_variable(s, i).map_or(0, |k| y[k]));
        let shifts: Vec<Gauss> = self
            .seams
            .translations
            .iter()
            .map(|terms| {
                terms.iter().fold([0, 0], |sum, &(s, c)| {
                    let p = position(s);
                    [sum[0] + c[0] * p[0] - c[1] * p[1], sum[1] + c[0] * p[1] + c[1] * p[0]]
                })
            })
            .collect();
        let corners = self
            .field
            .mesh
            .triangles
            .iter()
            .enumerate()
            .map(|(t, triangle)| {
                [0, 1, 2].map(|k| {
                    let (r, place) = self.seams.corner[3 * t + k];
                    let z = turned(vertices[triangle[k] as usize], r);
                    let shift = shifts[place as usize];
                    [z[0] + shift[0] * MAP_UNIT, z[1] + shift[1] * MAP_UNIT]
                })
            })
            .collect();
        let transitions = (0..self.seams.turn.len())
            .map(|h| Transition { turn: self.seams.turn[h], shift: shifts[self.seams.translation[h] as usize] })
            .collect();
        (corners, transitions)
    }

    fn singularity_variable(&self, s: u32, i: usize) -> Option<usize> {
        singularity_variable(s, i)
    }
}

/// The integer unknown of coordinate `i` of singularity `s`; the first singularity stays at the origin.
fn singularity_variable(s: u32, i: usize) -> Option<usize> {
    (s > 0).then(|| 2 * (s as usize - 1) + i)
}

fn integer_value(terms: &[(u32, i64)], y: &[i64]) -> i64 {
    terms.iter().map(|&(k, c)| c * y[k as usize]).sum()
}

fn signed_area(c: &[[f64; 2]; 3]) -> f64 {
    let side = |k: usize| [c[k][0] - c[0][0], c[k][1] - c[0][1]];
    let (p, q) = (side(1), side(2));
    0.5 * (p[0] * q[1] - p[1] * q[0])
}

fn flipped(corners: &[[[f64; 2]; 3]]) -> Vec<usize> {
    (0..corners.len()).filter(|&t| signed_area(&corners[t]) <= 0.0).collect()
}

fn elements(field: &ConjugateField, seams: &Seams) -> Result<Vec<Element>, Error> {
    let mesh = &field.mesh;
    let mut elements = Vec::with_capacity(mesh.triangles.len());
    let mut total = 0.0;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.triangles[t].map(|v| mesh.position(v));
        let sides = [c - b, a - c, b - a];
        let longest = sides.iter().map(|s| s.norm_squared()).fold(0.0, f64::max);
        let (mut normal, mut area) = mesh.triangle_normal_area(t);
        if area <= 1e-9 * longest {
            // Without area there is no gradient: such a triangle, at a collapsed side, gets next to no say.
            let [u, v] = field.layout[t];
            normal = u.cross(&v).try_normalize(1e-300).unwrap_or_else(Vector3::z);
            area = (1e-9 * longest).max(f64::MIN_POSITIVE);
        }
        total += area;
        let hats = sides.map(|s| normal.cross(&s) / (2.0 * area));
        let directions = [0, 1].map(|i| field.layout_direction(t as u32, (seams.name[t] + i) as usize));
        let x = directions[0].normalize();
        let y = normal.cross(&x);
        elements.push(Element {
            area,
            along: directions.map(|d| hats.map(|g| g.dot(&d))),
            gradient: hats.map(|g| [g.dot(&x), g.dot(&y)]),
            crossing: directions[0].cross(&directions[1]).norm().clamp(0.05, 1.0),
            lines: vec![],
        });
    }
    if !(total > 0.0 && total.is_finite()) {
        return Err(Error::Degenerate { reason: "the surface has no area".into() });
    }
    add_lines(field, seams, &mut elements);
    Ok(elements)
}

/// Weight of following a line that the field was asked to follow, the field itself weighing 1.
const LINE_WEIGHT: f64 = 10.0;
/// Weight of a constraint that counts half of that; hard ones count in full.
const HALF_WEIGHT: f64 = 30.0;

/// Gives each element the lines on its triangle.
fn add_lines(field: &ConjugateField, seams: &Seams, elements: &mut [Element]) {
    for line in field.lines.iter().chain(&field.parallels) {
        let t = line.triangle as usize;
        let along = [0, 1].map(|i| field.layout_direction(line.triangle, (seams.name[t] + i) as usize));
        let family = usize::from(along[1].dot(&line.direction).abs() > along[0].dot(&line.direction).abs());
        let share = if line.weight.is_finite() { line.weight / (line.weight + HALF_WEIGHT) } else { 1.0 };
        let [a, b, c] = field.mesh.triangles[t].map(|v| field.mesh.position(v));
        let normal = field.mesh.triangle_normal_area(t).0;
        let hats = [c - b, a - c, b - a].map(|s| normal.cross(&s) / (2.0 * elements[t].area));
        elements[t].lines.push(Line {
            family,
            along: hats.map(|g| g.dot(&line.direction)),
            weight: LINE_WEIGHT * share,
        });
    }
}

/// Which unknowns stand for the coordinates of which vertex.
struct Layout {
    forms: Vec<[Form; 2]>,
    inward: Vec<[i8; 2]>,
    fitted_sides: [bool; 4],
    free: usize,
    integers: usize,
    /// Sums of integers that have to vanish.
    relations: Vec<Terms>,
}

/// A border half-edge with the field's direction (0 to 3 of the combed directions) nearest to it, and the angle between.
#[derive(Clone, Copy)]
struct BorderStep {
    half_edge: usize,
    direction: u8,
    angle: f64,
    length: f64,
    /// Whether it becomes an isoline.
    fitted: bool,
}

impl BorderStep {
    /// Half-edge that ends where this one ends, seen from its triangle.
    fn head(&self) -> usize {
        self.half_edge / 3 * 3 + (self.half_edge + 1) % 3
    }

    /// Whether the same family, carried across the seams at the vertex between them, follows the next step.
    fn continues(&self, next: &Self, seams: &Seams) -> bool {
        let [before, after] = [self.head(), next.half_edge].map(|corner| seams.corner[corner].0);
        (self.direction + after + 4 - before) % 4 == next.direction
    }
}

impl Layout {
    fn new(field: &ConjugateField, seams: &Seams) -> Self {
        let count = field.mesh.points.len();
        // Numbers of free unknowns are given at the end, by `pin`.
        let mut forms = vec![[Form::Free(0), Form::Free(0)]; count];
        for (s, &v) in seams.singular.iter().enumerate() {
            forms[v as usize] = [0, 1]
                .map(|i| Form::Integer(singularity_variable(s as u32, i).map(|k| (k as u32, 1)).into_iter().collect()));
        }
        let integers = 2 * seams.singular.len().saturating_sub(1);
        let relations = vec![];
        Self { forms, inward: vec![[0; 2]; count], fitted_sides: [false; 4], free: 0, integers, relations }
    }

    /// Ties one coordinate of the vertices along each stretch of the border that `fit` admits to one integer: both where stretches meet.
    fn fit_border(&mut self, field: &ConjugateField, seams: &Seams, fit: SideFit) {
        let SideFit::Within(largest) = fit else { return };
        let mut steps = vec![];
        for (side, mut own) in border_sides(field, seams).into_iter().enumerate() {
            let followed = field.aligned_sides[FIELD_SIDES[side]];
            let near = own.iter().all(|s| s.angle <= largest) && own.windows(2).all(|s| s[0].continues(&s[1], seams));
            let fitted = !own.is_empty() && (followed || near);
            // A collapsed side is a point.
            own.iter_mut().for_each(|s| s.fitted = fitted && s.length > 0.0);
            self.fitted_sides[side] = own.iter().any(|s| s.fitted);
            steps.extend(own);
        }
        let count = steps.len();
        let joined = |i: usize| {
            let [last, next]: [&BorderStep; 2] = [&steps[(i + count - 1) % count], &steps[i % count]];
            last.fitted && next.fitted && last.continues(next, seams)
        };
        let start = (0..count).find(|&i| !joined(i)).unwrap_or(0);
        // The integer, as the sheet of the last triangle sees it.
        let mut value = Terms::new();
        for i in start..start + count {
            let step = &steps[i % count];
            if !step.fitted {
                continue;
            }
            if i > start && joined(i) {
                value = self.carried(value, &steps[(i - 1) % count], step, seams);
            } else {
                value = self.begun(step, field, seams);
            }
            for corner in [step.half_edge, step.head()] {
                self.tie(corner, step, &value, field, seams);
            }
        }
    }

    /// The coordinate that is constant along a step.
    fn constant(step: &BorderStep) -> usize {
        usize::from(step.direction.is_multiple_of(2))
    }

    /// The integer of a new stretch: what is known of its first vertex, or a new unknown.
    fn begun(&mut self, step: &BorderStep, field: &ConjugateField, seams: &Seams) -> Terms {
        let corner = step.half_edge;
        let (r, place) = seams.corner[corner];
        let (index, sign) = source_component(Self::constant(step), r);
        match &self.forms[field.mesh.triangles[corner / 3][corner % 3] as usize][index] {
            Form::Integer(terms) => {
                let mut value = component(&seams.translations[place as usize], Self::constant(step));
                add(&mut value, terms, sign);
                value
            }
            Form::Free(_) => {
                self.integers += 1;
                vec![(self.integers as u32 - 1, 1)]
            }
        }
    }

    /// The integer of a stretch in the sheet of the next step: the sheet may change at the vertex between the steps.
    fn carried(&self, mut value: Terms, last: &BorderStep, next: &BorderStep, seams: &Seams) -> Terms {
        let [before, after] = [last.head(), next.half_edge].map(|corner| seams.corner[corner]);
        if before == after {
            return value;
        }
        let was = Self::constant(last);
        add(&mut value, &component(&seams.translations[before.1 as usize], was), -1);
        let (index, sign) = turned_component(was, (after.0 + 4 - before.0) % 4);
        debug_assert_eq!(index, Self::constant(next));
        value.iter_mut().for_each(|t| t.1 *= sign);
        add(&mut value, &component(&seams.translations[after.1 as usize], index), 1);
        value
    }

    /// Gives the vertex at a corner of a step's triangle the integer `value` across the step.
    fn tie(&mut self, corner: usize, step: &BorderStep, value: &Terms, field: &ConjugateField, seams: &Seams) {
        let vertex = field.mesh.triangles[corner / 3][corner % 3] as usize;
        let constant = Self::constant(step);
        let (r, place) = seams.corner[corner];
        // Component `constant` of i^r z_v is sign times component `index` of z_v.
        let (index, sign) = source_component(constant, r);
        let mut terms = value.clone();
        add(&mut terms, &component(&seams.translations[place as usize], constant), -1);
        terms.iter_mut().for_each(|t| t.1 *= sign);
        match &self.forms[vertex][index] {
            Form::Free(_) => {
                // A border along direction j has the domain on its left, along direction j + 1.
                let inward = if matches!(step.direction, 1 | 2) { -1 } else { 1 };
                self.forms[vertex][index] = Form::Integer(terms);
                self.inward[vertex][index] = inward * sign as i8;
            }
            // Where the border closes on itself without a corner, or a vertex has an integer from elsewhere.
            Form::Integer(known) => {
                add(&mut terms, known, -1);
                if !terms.is_empty() {
                    self.relations.push(terms);
                }
            }
        }
    }

    /// Takes out the freedom to translate the whole map, then numbers the free unknowns.
    fn pin(&mut self, field: &ConjugateField, seams: &Seams) {
        if seams.singular.is_empty() {
            for i in 0..2 {
                // Without singularities there are no seams, so each coordinate is one function.
                let first = self.forms.iter().find_map(|f| match &f[i] {
                    Form::Integer(terms) => terms.first().map(|t| t.0),
                    Form::Free(_) => None,
                });
                match first {
                    Some(pinned) => self.relations.push(vec![(pinned, 1)]),
                    None => {
                        let [nu, nv] = field.mesh.cells;
                        let center = nu / 2 * (nv + 1) + nv / 2;
                        self.forms[center][i] = Form::Integer(vec![]);
                        self.inward[center][i] = 1;
                    }
                }
            }
        }
        for form in self.forms.iter_mut().flatten() {
            if let Form::Free(number) = form {
                *number = self.free as u32;
                self.free += 1;
            }
        }
    }
}

/// Component `i` of a translation, in integer unknowns.
fn component(translation: &[(u32, Gauss)], i: usize) -> Terms {
    let mut terms = Terms::new();
    for &(s, c) in translation {
        // (x + iy)(p + iq) = xp - yq + i (xq + yp)
        let coefficients = if i == 0 { [c[0], -c[1]] } else { [c[1], c[0]] };
        for (k, &coefficient) in coefficients.iter().enumerate() {
            if let (Some(variable), true) = (singularity_variable(s, k), coefficient != 0) {
                add(&mut terms, &[(variable as u32, coefficient)], 1);
            }
        }
    }
    terms
}

/// Component `i` of i^r z is `sign` times component `index` of z: returns (index, sign).
fn source_component(i: usize, r: u8) -> (usize, i64) {
    match (i, r % 4) {
        (i, 0) => (i, 1),
        (i, 2) => (i, -1),
        (0, 1) => (1, -1),
        (0, _) => (1, 1),
        (_, 1) => (0, 1),
        (_, _) => (0, -1),
    }
}

/// Component `i` of z becomes, up to `sign`, component `index` of i^r z: returns (index, sign).
fn turned_component(i: usize, r: u8) -> (usize, i64) {
    let index = if r.is_multiple_of(2) { i } else { 1 - i };
    (index, source_component(index, r).1)
}

/// For each side, counter-clockwise from v = min, its number where u = min, u = max, v = min, v = max are 0 to 3.
const FIELD_SIDES: [usize; 4] = [2, 1, 3, 0];

/// The border half-edges of the sides v = min, u = max, v = max, u = min, each counter-clockwise around the domain.
fn border_sides(field: &ConjugateField, seams: &Seams) -> [Vec<BorderStep>; 4] {
    let [nu, nv] = field.mesh.cells;
    let vertex = |i: usize, j: usize| i * (nv + 1) + j;
    let starts: [Vec<usize>; 4] = [
        (0..nu).map(|i| vertex(i, 0)).collect(),
        (0..nv).map(|j| vertex(nu, j)).collect(),
        (0..nu).map(|i| vertex(nu - i, nv)).collect(),
        (0..nv).map(|j| vertex(0, nv - j)).collect(),
    ];
    starts.map(|vertices| {
        vertices
            .into_iter()
            .map(|v| {
                let h = seams.outgoing[v] as usize;
                let (t, k) = (h / 3, h % 3);
                let triangle = field.mesh.triangles[t];
                let along = field.mesh.position(triangle[(k + 1) % 3]) - field.mesh.position(triangle[k]);
                let length = along.norm();
                let cosine =
                    |j: u8| field.layout_direction(t as u32, (seams.name[t] + j) as usize).dot(&along) / length;
                let direction = (0..4).max_by(|&a, &b| cosine(a).total_cmp(&cosine(b))).expect("four directions");
                let angle = cosine(direction).clamp(-1.0, 1.0).acos();
                BorderStep { half_edge: h, direction, angle, length, fitted: false }
            })
            .collect()
    })
}

/// The energy's matrix as a sum over triangles into the slots of one fixed pattern: free unknowns first, then integers.
struct System {
    free: usize,
    integers: usize,
    /// Value slots: the free-free lower triangle in CSC order, then free-integer pairs, then integer-integer pairs.
    slots: usize,
    column_starts: Vec<usize>,
    rows: Vec<usize>,
    mixed: Vec<(u32, u32)>,
    dense: Vec<(u32, u32)>,
    symbolic: SymbolicCholesky,
    /// For each triangle: (slot, place in the element's Hessian, coefficient).
    contributions: Vec<(u32, u8, f64)>,
    contribution_starts: Vec<u32>,
    /// For each triangle's six coordinates (a of the corners, then b): (unknown, coefficient).
    terms: Vec<(u32, f64)>,
    term_starts: Vec<u32>,
}

impl System {
    fn new(
        field: &ConjugateField,
        seams: &Seams,
        forms: &[[Form; 2]],
        free: usize,
        relations: &Relations,
    ) -> Result<Self, Error> {
        let triangles = &field.mesh.triangles;
        let integers = relations.free;
        let shifts: Vec<[Terms; 2]> =
            seams.translations.iter().map(|t| [0, 1].map(|i| relations.expand(&component(t, i)))).collect();
        let mut terms: Vec<(u32, f64)> = Vec::with_capacity(6 * triangles.len());
        let mut term_starts = vec![0u32];
        for (t, triangle) in triangles.iter().enumerate() {
            for family in 0..2 {
                for k in 0..3 {
                    let (r, place) = seams.corner[3 * t + k];
                    let (index, sign) = source_component(family, r);
                    let shift = &shifts[place as usize][family];
                    match &forms[triangle[k] as usize][index] {
                        Form::Free(x) => {
                            terms.push((*x, sign as f64));
                            terms.extend(shift.iter().map(|&(k, c)| (free as u32 + k, c as f64)));
                        }
                        Form::Integer(own) => {
                            let mut sum = shift.clone();
                            add(&mut sum, &relations.expand(own), sign);
                            terms.extend(sum.iter().map(|&(k, c)| (free as u32 + k, c as f64)));
                        }
                    }
                    term_starts.push(terms.len() as u32);
                }
            }
        }
        // Every pair of unknowns that share a triangle and family, lower triangle only.
        let mut pairs: Vec<(u64, u32, u8, f64)> = Vec::with_capacity(12 * triangles.len());
        let mut contribution_starts = vec![0u32];
        let key = |p: u32, q: u32| {
            let class = u64::from(p >= free as u32) + u64::from(q >= free as u32);
            (class << 60) | (u64::from(q) << 30) | u64::from(p)
        };
        for t in 0..triangles.len() {
            for family in 0..2 {
                for i in 0..3 {
                    for j in 0..3 {
                        let list = |c: usize| {
                            let place = 6 * t + 3 * family + c;
                            &terms[term_starts[place] as usize..term_starts[place + 1] as usize]
                        };
                        for &(p, cp) in list(i) {
                            for &(q, cq) in list(j).iter().filter(|&&(q, _)| p >= q) {
                                pairs.push((key(p, q), t as u32, (9 * family + 3 * i + j) as u8, cp * cq));
                            }
                        }
                    }
                }
            }
            contribution_starts.push(pairs.len() as u32);
        }
        let mut keys: Vec<u64> = pairs.iter().map(|p| p.0).collect();
        // A full diagonal keeps the pattern valid whatever the weights.
        keys.extend((0..free as u32).map(|x| key(x, x)));
        keys.sort_unstable();
        keys.dedup();
        let mask = (1u64 << 30) - 1;
        let split = |k: u64| ((k & mask) as u32, ((k >> 30) & mask) as u32);
        let mut column_starts = vec![0usize; free + 1];
        let (mut rows, mut mixed, mut dense) = (vec![], vec![], vec![]);
        for &k in &keys {
            let (p, q) = split(k);
            match k >> 60 {
                0 => {
                    rows.push(p as usize);
                    column_starts[q as usize + 1] += 1;
                }
                1 => mixed.push((q, p - free as u32)),
                _ => dense.push((q - free as u32, p - free as u32)),
            }
        }
        for c in 0..free {
            column_starts[c + 1] += column_starts[c];
        }
        let contributions = pairs
            .iter()
            .map(|&(k, _, place, c)| (keys.binary_search(&k).expect("collected above") as u32, place, c))
            .collect();
        let pattern = CsMat::new_csc((free, free), column_starts.clone(), rows.clone(), vec![0.0; rows.len()]);
        let symbolic = SymbolicCholesky::new(&pattern)?;
        Ok(Self {
            free,
            integers,
            slots: keys.len(),
            column_starts,
            rows,
            mixed,
            dense,
            symbolic,
            contributions,
            contribution_starts,
            terms,
            term_starts,
        })
    }

    fn add(&self, t: usize, hessian: &[f64; 18], right: &[f64; 6], values: &mut [f64], gradient: &mut [f64]) {
        let range = self.contribution_starts[t] as usize..self.contribution_starts[t + 1] as usize;
        for &(slot, place, c) in &self.contributions[range] {
            values[slot as usize] += c * hessian[place as usize];
        }
        for (i, value) in right.iter().enumerate() {
            for &(unknown, c) in self.coordinate(t, i) {
                gradient[unknown as usize] += c * value;
            }
        }
    }

    fn coordinate(&self, t: usize, i: usize) -> &[(u32, f64)] {
        let place = 6 * t + i;
        &self.terms[self.term_starts[place] as usize..self.term_starts[place + 1] as usize]
    }

    fn corners(&self, solution: &[f64]) -> Vec<[[f64; 2]; 3]> {
        let value = |t: usize, i: usize| -> f64 {
            self.coordinate(t, i).iter().map(|&(unknown, c)| c * solution[unknown as usize]).sum()
        };
        (0..self.contribution_starts.len() - 1).map(|t| [0, 1, 2].map(|k| [value(t, k), value(t, 3 + k)])).collect()
    }

    /// The minimum over the free unknowns, y fixed; free unknowns, then y.
    fn solve(&self, values: Vec<f64>, gradient: Vec<f64>, scale: f64, y: &[f64]) -> Result<Vec<f64>, Error> {
        let n = self.free;
        let direct = self.rows.len();
        let factor = self.factorize(&values)?;
        let mut solution: Vec<f64> = gradient[..n].iter().map(|g| scale * g).collect();
        for (&(x, k), value) in self.mixed.iter().zip(&values[direct..]) {
            solution[x as usize] -= value * y[k as usize];
        }
        if n > 0 {
            factor.solve(&mut solution);
        }
        solution.extend_from_slice(y);
        Ok(solution)
    }

    fn factorize(&self, values: &[f64]) -> Result<Cholesky, Error> {
        let n = self.free;
        let values = values[..self.rows.len()].to_vec();
        let matrix = CsMat::new_csc((n, n), self.column_starts.clone(), self.rows.clone(), values);
        self.symbolic.factorize(&matrix, "seamless map")
    }

    /// Eliminates the free unknowns.
    fn reduce(&self, values: Vec<f64>, gradient: Vec<f64>) -> Result<Reduced, Error> {
        let (n, m) = (self.free, self.integers);
        let direct = self.rows.len();
        let factor = self.factorize(&values)?;
        let mut columns = vec![0.0; n * (m + 1)];
        columns[..n].copy_from_slice(&gradient[..n]);
        for (&(x, y), value) in self.mixed.iter().zip(&values[direct..]) {
            columns[n * (1 + y as usize) + x as usize] = *value;
        }
        if n > 0 {
            factor.solve(&mut columns);
        }
        let mut schur = DMatrix::zeros(m, m);
        let mut right = DVector::from_column_slice(&gradient[n..]);
        for (&(q, p), value) in self.dense.iter().zip(&values[direct + self.mixed.len()..]) {
            schur[(p as usize, q as usize)] = *value;
            schur[(q as usize, p as usize)] = *value;
        }
        for (&(x, y), value) in self.mixed.iter().zip(&values[direct..]) {
            right[y as usize] -= value * columns[x as usize];
            for k in 0..m {
                schur[(y as usize, k)] -= value * columns[n * (1 + k) + x as usize];
            }
        }
        Ok(Reduced { free: n, columns, schur, right })
    }
}

/// The minimum over the free unknowns x as a function of the integers y: x = scale x_0 - W y, and the quadratic in y.
#[derive(Default)]
struct Reduced {
    free: usize,
    /// x_0, then the columns of W.
    columns: Vec<f64>,
    schur: DMatrix<f64>,
    right: DVector<f64>,
}

impl Reduced {
    /// The minimum over real y at scale 1.
    fn relaxed(&self) -> Vec<f64> {
        let all: Vec<usize> = (0..self.right.len()).collect();
        self.minimum(1.0, &all, &vec![0.0; all.len()])
    }

    /// The minimum over the `open` entries of y, the others kept.
    fn minimum(&self, scale: f64, open: &[usize], y: &[f64]) -> Vec<f64> {
        let mut y = y.to_vec();
        if open.is_empty() {
            return y;
        }
        let is_open: Vec<bool> = (0..y.len()).map(|i| open.contains(&i)).collect();
        let largest = self.schur.diagonal().iter().fold(0.0f64, |a, &b| a.max(b));
        let matrix = DMatrix::from_fn(open.len(), open.len(), |i, j| {
            // A trace of regularization, for integers that nothing determines.
            self.schur[(open[i], open[j])] + if i == j { 1e-13 * largest + f64::MIN_POSITIVE } else { 0.0 }
        });
        let right = DVector::from_fn(open.len(), |i, _| {
            let fixed: f64 = (0..y.len()).filter(|&k| !is_open[k]).map(|k| self.schur[(open[i], k)] * y[k]).sum();
            scale * self.right[open[i]] - fixed
        });
        let solved = matrix.clone().cholesky().map(|c| c.solve(&right)).or_else(|| matrix.lu().solve(&right));
        for (i, &k) in open.iter().enumerate() {
            y[k] = solved.as_ref().map_or(0.0, |s| s[i]);
        }
        y
    }

    /// Rounds one integer after another, the most certain first, the others following.
    fn rounded(&self, scale: f64) -> Vec<f64> {
        let mut open: Vec<usize> = (0..self.right.len()).collect();
        let mut y = vec![0.0; open.len()];
        while !open.is_empty() {
            y = self.minimum(scale, &open, &y);
            let off: Vec<f64> = y.iter().map(|x| (x - x.round()).abs()).collect();
            let best = open.iter().copied().min_by(|&a, &b| off[a].total_cmp(&off[b])).expect("some are open");
            // All that are certain enough go at once.
            open.retain(|&k| {
                let take = k == best || off[k] < 0.02;
                if take {
                    y[k] = y[k].round();
                }
                !take
            });
        }
        y
    }

    /// Free unknowns, then y.
    fn solution(&self, scale: f64, y: &[f64]) -> Vec<f64> {
        let n = self.free;
        let mut solution: Vec<f64> = self.columns[..n].iter().map(|x| scale * x).collect();
        for (k, &value) in y.iter().enumerate() {
            if value != 0.0 {
                let column = &self.columns[n * (k + 1)..n * (k + 2)];
                solution.iter_mut().zip(column).for_each(|(x, w)| *x -= w * value);
            }
        }
        solution.extend_from_slice(y);
        solution
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::test_surfaces::graph;
    use crate::field::{DirectionConstraint, FieldOptions, conjugate_field};

    /// Mean angle between the isolines of b and `direction` on the triangles of `lines`, degrees.
    fn angle_along(map: &SeamlessMap, lines: &[DirectionConstraint]) -> f64 {
        let angle = |line: &DirectionConstraint| {
            let t = line.triangle as usize;
            let [a, b, c] = map.mesh.triangles[t].map(|v| map.mesh.position(v));
            let normal = map.mesh.triangle_normal_area(t).0;
            let hats = [c - b, a - c, b - a].map(|s| normal.cross(&s));
            let isolines = [0, 1].map(|k| {
                let gradient: Vector3<f64> = (0..3).map(|i| hats[i] * map.corners[t][i][k] as f64).sum();
                normal.cross(&gradient.normalize())
            });
            let cosine = isolines.iter().map(|d| d.dot(&line.direction).abs()).fold(0.0, f64::max);
            cosine.min(1.0).acos().to_degrees()
        };
        lines.iter().map(angle).sum::<f64>() / lines.len() as f64
    }

    #[test]
    fn isolines_follow_lines_more_than_the_field() {
        let control = Control::default();
        let mesh = SurfaceMesh::new(&graph(|_, _| 0.0), [20, 20]).unwrap();
        let along = DirectionConstraint { triangle: 0, direction: Vector3::x(), weight: 100.0 };
        let mut field = conjugate_field(mesh, None, &[along], &FieldOptions::default(), &control).unwrap();
        let tilted = Vector3::new(12f64.to_radians().cos(), 12f64.to_radians().sin(), 0.0);
        let line =
            |i: usize| DirectionConstraint { triangle: 2 * (20 * i + 10) as u32, direction: tilted, weight: 300.0 };
        let lines: Vec<DirectionConstraint> = (5..15).map(line).collect();
        field.lines = vec![];
        let without = angle_along(&integrate(&field, &MapOptions::default(), &control).unwrap(), &lines);
        field.lines = lines.clone();
        let with = angle_along(&integrate(&field, &MapOptions::default(), &control).unwrap(), &lines);
        assert!((without - 12.0).abs() < 0.5 && with < 4.0, "{without} {with}");
    }
}
