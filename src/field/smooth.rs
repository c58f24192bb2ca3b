//! The smoothest conjugate field under constraints.

use super::border::{corners, followed};
use super::conjugate::{middle_forms, second_forms};
use super::conjugate_field::{ConjugateField, Singularity};
use super::finish::Finished;
use super::layout::{Layout, Patch, directions, layout};
use super::matching::Cross;
use super::prescribe;
use super::problem::{Conjugacy, Problem};
use super::smoothness::edge_weights;
use super::topology::{EdgeTopology, TriangleFrames};
use crate::control::Control;
use crate::error::Error;
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;

/// Panels of a mesh, unless the options give their length.
const DEFAULT_PANELS: f64 = 500.0;
/// Most Gauss-Newton iterations of the exactly conjugate field.
const EXACT_ITERATIONS: usize = 3;

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
/// conjugate crosses of each triangle ([`SecondForm`](super::SecondForm)), so that conjugacy is exact, with the layout's matching.
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
}
