//! From a field to a seamless map: two functions whose isolines follow the two families, continuous up to quarter turns and
//! integer shifts across seams.

// Half-edges, corners and families are numbers that index several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::conjugate_field::ConjugateField;
use super::map_elements::{Element, elements};
use super::map_sizes::Sizes;
use super::map_system::System;
use super::map_unknowns::{Form, Unknowns, singularity_variable};
use super::relations::Relations;
use super::rounding::Reduced;
use super::seamless_map::{MAP_UNIT, MapDiagnostics, SeamlessMap, Transition};
use super::seams::{Gauss, Seams, turned};
use super::untangle::Tangle;
use crate::control::Control;
use crate::error::Error;

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
    /// Rounds in which each place's target size is adapted to what the directions allow, and stretched places are made stiffer; 0 asks for equal
    /// sizes.
    pub size_rounds: usize,
    /// Sides that become isolines.
    pub sides: SideFit,
    /// Singularities of opposite index that are closer than this cancel, in edge lengths of the `density`, and so do those at the ends of
    /// one edge of the triangulation: the grid could not tell them apart, or no triangle would be left to hold a cell between them.
    pub pair_distance: f64,
    /// Singularities closer than this to the border are moved over it, in edge lengths.
    pub rim_distance: f64,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self {
            density: Density::CellCount(500.0),
            size_weight: 0.05,
            size_rounds: 2,
            sides: SideFit::Within(6f64.to_radians()),
            pair_distance: 1.0,
            rim_distance: 0.5,
        }
    }
}

/// Most integers that are moved after rounding.
const MOST_SHIFTS: usize = 4;

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
    sizes: Sizes,
    base: Reduced,
    relaxed_cells: f64,
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
        let area = field.mesh.area();
        let edge = match options.density {
            Density::EdgeLength(edge) => edge,
            Density::CellCount(count) => (area / count).sqrt(),
        };
        // What a host fixed stays, even where the grid is too coarse to show it.
        let reach = if field.fixed_singularities { 0.0 } else { edge };
        let seams = Seams::new(field, options.pair_distance * reach, options.rim_distance * reach);
        let triangles = elements(field, &seams)?;
        let mut unknowns = Unknowns::new(field, &seams);
        unknowns.fit_border(field, &seams, options.sides);
        unknowns.pin(field, &seams);
        let Unknowns { forms: vertex_forms, inward, fitted_sides, free, integers, relations } = unknowns;
        let relations = Relations::new(integers, &relations);
        let system = System::new(field, &seams, &vertex_forms, free, &relations)?;
        // Sizes are in units of cells per length for a map of about 500 cells; only their ratios matter.
        let (count, unit) = (triangles.len(), (500.0 / area).sqrt());
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
            sizes: Sizes::equal(count, unit),
            base: Reduced::default(),
            relaxed_cells: 0.0,
        };
        for round in 0..=options.size_rounds {
            control.step("map", round as f64 / (options.size_rounds + 2) as f64)?;
            let (values, gradient) = integrator.assemble();
            integrator.base = integrator.system.reduce(values, gradient)?;
            let y = integrator.base.relaxed();
            let solution = integrator.base.solution(1.0, &y);
            let corners = integrator.system.corners(&solution);
            if round < options.size_rounds {
                integrator.sizes.adapt(&integrator.triangles, &integrator.seams, &corners);
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
        let mut y = self.base.rounded(scale);
        let rounded = flipped(&self.system.corners(&self.base.solution(scale, &y)));
        control.step("map", 0.8)?;
        let tangle = self.tangle(scale);
        let untangled = |y: &[f64]| -> Result<(Vec<f64>, Vec<usize>), Error> {
            let mut solution = self.base.solution(scale, y);
            let turned = tangle.untangle(&mut solution, control)?;
            Ok((solution, turned))
        };
        let (mut solution, mut turned) = untangled(&y)?;
        // What cannot be turned back lies between integers that met: move one of them.
        for _ in 0..MOST_SHIFTS {
            let mut better = None;
            for k in tangle.integers_of(&turned) {
                for step in [-1.0, 1.0] {
                    let mut other = y.clone();
                    other[k] += step;
                    let (trial, left) = untangled(&other)?;
                    if left.len() < better.as_ref().map_or(turned.len(), |(_, _, left): &(_, _, Vec<_>)| left.len()) {
                        better = Some((other, trial, left));
                    }
                }
            }
            match better {
                Some(found) => (y, solution, turned) = found,
                None => break,
            }
        }
        let corners = self.system.corners(&solution);
        let diagnostics = MapDiagnostics {
            flipped: flipped(&corners),
            flipped_by_rounding: rounded,
            cells: corners.iter().map(signed_area).sum(),
            direction_mean_deg: self.direction_error(&corners),
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

    /// What turns triangles of the map at this scale back.
    fn tangle(&self, scale: f64) -> Tangle<'_> {
        let sizes = self.sizes.wanted.iter().map(|s| s.map(|x| x * scale)).collect();
        Tangle { field: self.field, seams: &self.seams, elements: &self.triangles, system: &self.system, sizes }
    }

    /// Assembles the energy
    /// sum over triangles and families of A (sin^2(crossing) (grad a . v)^2 / r^2 + w k (grad a . u / s - 1)^2)
    /// as matrix values and gradient, with the wanted sizes s, the reached ones r and the stiffness k of [`Sizes`]. The first term is about the
    /// squared angle between isoline and field; lines that the field follows add more of that along themselves.
    fn assemble(&self) -> (Vec<f64>, Vec<f64>) {
        let mut values = vec![0.0; self.system.slots];
        let mut gradient = vec![0.0; self.system.free + self.system.integers];
        for (t, element) in self.triangles.iter().enumerate() {
            let mut hessian = [0.0; 18];
            let mut right = [0.0; 6];
            let weight = element.area;
            for family in 0..2 {
                let inverse = 1.0 / self.sizes.wanted[t][family];
                let size_weight = self.options.size_weight * weight * self.sizes.stiffness[t][family];
                let (across, along) = (&element.along[1 - family], &element.along[family]);
                let direction_weight = weight * (element.crossing / self.sizes.reached[t][family]).powi(2);
                for i in 0..3 {
                    right[3 * family + i] = size_weight * along[i] * inverse;
                    for j in 0..3 {
                        hessian[9 * family + 3 * i + j] = direction_weight * across[i] * across[j]
                            + size_weight * inverse * inverse * along[i] * along[j];
                    }
                }
            }
            for line in &element.lines {
                let family = 1 - line.family;
                let scale = weight * line.weight / self.sizes.reached[t][family].powi(2);
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
        let position = |s: u32| [0, 1].map(|i| singularity_variable(s, i).map_or(0, |k| y[k]));
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
}

fn integer_value(terms: &[(u32, i64)], y: &[i64]) -> i64 {
    terms.iter().map(|&(k, c)| c * y[k as usize]).sum()
}

fn signed_area(c: &[[f64; 2]; 3]) -> f64 {
    let side = |k: usize| [c[k][0] - c[0][0], c[k][1] - c[0][1]];
    let (p, q) = (side(1), side(2));
    0.5 * (p[0] * q[1] - p[1] * q[0])
}

fn flipped(corners: &[[[f64; 2]; 3]]) -> usize {
    corners.iter().filter(|c| signed_area(c) <= 0.0).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::test_surfaces::graph;
    use crate::field::{DirectionConstraint, FieldOptions, conjugate_field};
    use crate::surface::SurfaceMesh;
    use nalgebra::Vector3;

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

    #[test]
    fn folds_are_turned_back_where_they_are_and_nothing_else_moves() {
        let control = Control::default();
        let mesh = SurfaceMesh::new(&graph(|x, y| 0.1 * x * x - 0.2 * y * y), [20, 20]).unwrap();
        let field = conjugate_field(mesh, None, &[], &FieldOptions::default(), &control).unwrap();
        let integrator = Integrator::new(&field, &MapOptions::default(), &control).unwrap();
        let scale = (500.0 / integrator.relaxed_cells).sqrt();
        let exact = integrator.base.solution(scale, &integrator.base.rounded(scale));
        assert_eq!(flipped(&integrator.system.corners(&exact)), 0);
        // Pull one inner vertex over its neighbours.
        let vertex = 7 * 21 + 9;
        let mut folded = exact.clone();
        for form in &integrator.vertex_forms[vertex] {
            let Form::Free(x) = form else { panic!("an inner vertex is free") };
            folded[*x as usize] += 2.5;
        }
        assert!(flipped(&integrator.system.corners(&folded)) > 0);
        let left = integrator.tangle(scale).untangle(&mut folded, &control).unwrap();
        assert!(left.is_empty() && flipped(&integrator.system.corners(&folded)) == 0);
        let moved = |v: usize| {
            integrator.vertex_forms[v]
                .iter()
                .any(|form| matches!(form, Form::Free(x) if (folded[*x as usize] - exact[*x as usize]).abs() > 0.0))
        };
        for v in (0..21 * 21).filter(|&v| moved(v)) {
            let steps = [v / 21, v % 21].iter().zip([7, 9]).map(|(&i, j): (&usize, usize)| i.abs_diff(j)).max();
            assert!(steps <= Some(5), "{v} is {steps:?} away");
        }
    }
}
