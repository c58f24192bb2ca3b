use super::face_equations::FaceEquations;
use super::newton::Phase;
use super::outline::border_sides;
use super::state::BORDER_GAP;
use super::*;
use crate::mesh::border_trace::BorderTrace;
use crate::mesh::grid_triples;
use crate::mesh::reference::Foot;
use nalgebra::{Rotation3, Translation3, Vector3};

/// A grid of (nu + 1) x (nv + 1) vertices over [0, 1]^2.
fn grid(nu: u32, nv: u32, at: impl Fn(f64, f64) -> [f64; 3]) -> PanelMesh {
    let vertices = (0..=nu)
        .flat_map(|i| (0..=nv).map(move |j| (i as f64 / nu as f64, j as f64 / nv as f64)))
        .map(|(s, t)| Point3::from(at(s, t)))
        .collect();
    let faces: Vec<[u32; 4]> = (0..nu * nv)
        .map(|k| {
            let a = k / nv * (nv + 1) + k % nv;
            [a, a + nv + 1, a + nv + 2, a + 1]
        })
        .collect();
    PanelMesh::new(vertices, &faces).unwrap()
}

/// A repeatable perturbation of size `size`.
fn shaken(mesh: &PanelMesh, size: f64) -> PanelMesh {
    let noise = |k: f64| (k * 12.9898).sin() * 43758.5453 % 1.0;
    let vertices = mesh
        .vertices
        .iter()
        .enumerate()
        .map(|(i, p)| p + Vector3::from_fn(|a, _| noise((3 * i + a + 1) as f64)) * size)
        .collect();
    PanelMesh { vertices, ..mesh.clone() }
}

struct Implicit<F: Fn(&Point3<f64>) -> (Point3<f64>, Vector3<f64>)>(F);

impl<F: Fn(&Point3<f64>) -> (Point3<f64>, Vector3<f64>)> Reference for Implicit<F> {
    fn closest(&self, point: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
        let (point, direction) = (self.0)(point);
        Foot { point, direction, parameters: [0.0; 2] }
    }
    fn closest_on_border(&self, _: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
        None
    }
}

/// What to planarize as a host would ask for it: the border held, grid lines fair.
struct Case<'a> {
    mesh: &'a PanelMesh,
    reference: Option<&'a dyn Reference>,
    border: Vec<u32>,
    pins: &'a [u32],
    polylines: Vec<[u32; 3]>,
    splittable: &'a [u32],
    feature_lines: &'a [Vec<Point3<f64>>],
    options: PlanarizeOptions,
}

impl<'a> Case<'a> {
    fn new(mesh: &'a PanelMesh) -> Self {
        Self {
            mesh,
            reference: None,
            border: border_vertices(mesh),
            pins: &[],
            polylines: grid_triples(mesh, |_| false),
            splittable: &[],
            feature_lines: &[],
            options: PlanarizeOptions::default(),
        }
    }

    fn on(mesh: &'a PanelMesh, reference: &'a dyn Reference) -> Self {
        Self { reference: Some(reference), ..Self::new(mesh) }
    }

    /// Nothing held or fair.
    fn bare(mesh: &'a PanelMesh) -> Self {
        Self { border: vec![], polylines: vec![], ..Self::new(mesh) }
    }

    fn input(&self) -> PlanarizeInput<'_> {
        PlanarizeInput {
            mesh: self.mesh,
            reference: self.reference,
            border: &self.border,
            pins: self.pins,
            polylines: &self.polylines,
            splittable: self.splittable,
            feature_lines: self.feature_lines,
            parameters: None,
        }
    }

    fn attempt(&self) -> Result<Planarized, Error> {
        planarize(&self.input(), &self.options, &Control::default())
    }

    fn run(&self) -> Planarized {
        self.attempt().unwrap()
    }
}

/// The state that a search on `reference` within a tenth starts from.
fn state<'a>(input: &'a PlanarizeInput<'a>, reference: &'a dyn Reference) -> State<'a> {
    State::new(input, reference, &PlanarizeOptions::DEFAULT, mean_edge_length(input.mesh), 0.1).unwrap()
}

fn farthest(a: &PanelMesh, b: &PanelMesh) -> f64 {
    a.vertices.iter().zip(&b.vertices).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

fn translational(s: f64, t: f64) -> [f64; 3] {
    [8.0 * s, 6.0 * t, (3.0 * s).sin() + 1.5 * (2.0 * t).cos()]
}

/// Quads on a sphere of radius 5 that are not planar.
fn skew_sphere(n: u32) -> PanelMesh {
    grid(n, n, |s, t| {
        let (a, b) = (1.6 * (s - 0.5), 1.4 * (t - 0.5));
        (Vector3::new(a.tan(), b.tan() + 0.2 * a, 1.0).normalize() * 5.0).into()
    })
}

fn sphere() -> impl Reference {
    Implicit(|p: &Point3<f64>| {
        let n = p.coords.normalize();
        (Point3::from(n * 5.0), n)
    })
}

/// The saddle z = (x^2 - y^2) / 8 over a square, on a net turned by `degrees` from its principal net.
fn saddle(degrees: f64) -> PanelMesh {
    let (sin, cos) = degrees.to_radians().sin_cos();
    grid(16, 16, move |s, t| {
        let (x, y) = (6.0 * (s - 0.5), 6.0 * (t - 0.5));
        let (x, y) = (x * cos - y * sin, x * sin + y * cos);
        [x, y, (x * x - y * y) / 8.0]
    })
}

#[test]
fn a_translational_net_is_left_alone() {
    let mesh = grid(16, 12, translational);
    let result = Case::new(&mesh).run();
    assert!(farthest(&mesh, &result.mesh) < 1e-9 && result.is_planar && result.is_close);
}

#[test]
fn a_shaken_translational_net_becomes_planar() {
    let mesh = shaken(&grid(16, 12, translational), 0.02);
    let result = Case::new(&mesh).run();
    assert!(result.planarity_max() < 1e-10 && result.is_close && result.rounds < 20, "{}", result.rounds);
}

#[test]
fn nets_on_curved_surfaces_become_planar_and_stay_close() {
    let mesh = skew_sphere(16);
    let result = Case::on(&mesh, &sphere()).run();
    assert!(planarity(&mesh).into_iter().fold(0.0, f64::max) > 1e-2);
    assert!(result.planarity_max() < 1e-10 && result.is_close && result.rounds < 20);

    for degrees in [5.0, 10.0, 20.0] {
        let mesh = saddle(degrees);
        let reference = MeshReference::from_panels(&mesh);
        let result = Case::on(&mesh, &reference).run();
        assert!(result.planarity_max() < 1e-8 && result.is_close, "{degrees}: {}", result.deviation_max());
    }
}

#[test]
fn rulings_of_a_saddle_are_given_up_with_numbers() {
    // All edges asymptotic: no planar net close to the surface has this layout.
    let mesh = saddle(45.0);
    let result = Case::new(&mesh).run();
    let before = planarity(&mesh).into_iter().fold(0.0, f64::max);
    assert!(result.planarity_max() <= before && result.deviation_max() <= 3.0 * result.deviation_limit);
    assert_eq!(result.is_planar, result.planarity_max() <= 1e-6);
    assert!(!result.is_planar || !result.is_close);
}

#[test]
fn newton_converges_quadratically() {
    let mesh = skew_sphere(12);
    let (case, reference) = (Case::new(&mesh), sphere());
    let input = case.input();
    let mut state = state(&input, &reference);
    let mut trace = vec![state.worst_planarity()];
    for _ in 0..8 {
        state.round(Phase::Project, &Control::default()).unwrap();
        trace.push(state.worst_planarity());
    }
    let fast = trace.windows(2).any(|w| w[0] < 1e-3 && w[0] > 1e-6 && w[1] < 30.0 * w[0] * w[0]);
    assert!(fast && trace[8] < 1e-12, "{trace:?}");
}

#[test]
fn a_patch_becomes_planar_alone() {
    let mesh = skew_sphere(16);
    let (case, reference, control) = (Case::new(&mesh), sphere(), Control::default());
    let input = case.input();
    let mut state = state(&input, &reference);
    (0..6).for_each(|_| _ = state.round(Phase::Project, &control).unwrap());
    let middle = 8 * 17 + 8;
    state.vertices[middle] += Vector3::new(0.01, 0.02, -0.03);
    let before = state.vertices.clone();
    let mut seeds = vec![false; before.len()];
    seeds[middle] = true;
    // Within three faces of it are 7 x 7 vertices; all of the mesh is no patch.
    assert!(!state.focus(seeds.clone(), 9).unwrap() && state.focus(seeds, 3).unwrap());
    assert_eq!(state.unknowns.vertices().len(), 49);
    (0..6).for_each(|_| _ = state.round(Phase::Project, &control).unwrap());
    for (v, (p, q)) in before.iter().zip(&state.vertices).enumerate() {
        assert_eq!(p == q, !state.unknowns.moves(v as u32), "{v}");
    }
    state.widen();
    assert!(state.unknowns.vertices().len() == 17 * 17 && state.worst_planarity() < 1e-12);
}

#[test]
fn the_search_ends_as_fair_as_a_hundred_rounds_do() {
    let place = |s: f64, t: f64| [8.0 * s, 8.0 * t, (3.0 * s).sin() + 0.8 * (4.0 * s * t).cos()];
    let mesh = grid(8, 8, place);
    // As far from the surface as it likes: no weight grows.
    let options = PlanarizeOptions { deviation: Some(8.0), ..PlanarizeOptions::default() };
    let case = Case { border: vec![], options, ..Case::new(&mesh) };
    let (input, reference, control) = (case.input(), MeshReference::from_panels(&mesh), Control::default());
    let mut longest = state(&input, &reference);
    (0..100).for_each(|_| _ = longest.round(Phase::Balance, &control).unwrap());
    let bends = |vertices: &[Point3<f64>]| -> f64 {
        let change = |v: u32| vertices[v as usize] - mesh.vertices[v as usize];
        case.polylines.iter().map(|&[a, b, c]| (change(a) - change(b) * 2.0 + change(c)).norm_squared()).sum()
    };
    let (before, after) = (bends(&longest.vertices), bends(&case.run().mesh.vertices));
    assert!(before > 1e-3 && after < 1.1 * before, "{before} {after}");
}

#[test]
fn face_equations_match_finite_differences_on_planar_faces() {
    let flat = [[0.0, 0.0], [1.1, -0.2], [1.7, 0.8], [0.9, 1.6], [-0.3, 0.9]];
    let frame = Rotation3::from_euler_angles(0.4, -1.1, 2.0);
    for count in [4, 5] {
        let corners: Vec<Vector3<f64>> = flat[..count].iter().map(|p| frame * Vector3::new(p[0], p[1], 0.3)).collect();
        let equation = FaceEquations::new(&corners).unwrap();
        let h = 1e-6;
        for corner in 0..count {
            for axis in 0..3 {
                let value = |sign: f64| {
                    let mut moved = corners.clone();
                    moved[corner][axis] += sign * h;
                    FaceEquations::new(&moved).unwrap().residual
                };
                for (k, (a, b)) in value(1.0).iter().zip(value(-1.0)).enumerate() {
                    let expected = equation.projector[k * count + corner] * equation.normal[axis];
                    assert!(((a - b) / (2.0 * h) - expected).abs() < 1e-8);
                }
            }
        }
    }
}

#[test]
fn soft_gradient_matches_finite_differences() {
    let mesh = grid(4, 3, translational);
    let lines = [[0.2, 0.45, 0.8].map(|s| Point3::from(translational(s, 0.3 + 0.2 * s))).to_vec()];
    let case = Case { pins: &[7], feature_lines: &lines, ..Case::new(&mesh) };
    let (input, options, reference) = (case.input(), &case.options, MeshReference::from_panels(&mesh));
    let edge = mean_edge_length(&mesh);
    let mut state = state(&input, &reference);
    assert_eq!(state.feature_terms.len(), 2);
    state.vertices = shaken(&mesh, 0.05).vertices;
    state.vertices[7] = mesh.vertices[7];
    // Feet held where they were asked for.
    let energy = |state: &State| {
        let mut sum = 0.0;
        for v in 0..state.vertices.len() {
            let offset = (state.vertices[v] - state.feet[v].point) / edge;
            let along = state.feet[v].direction.dot(&offset);
            sum += if state.on_border[v] {
                options.border * (offset.norm_squared() - along * along)
            } else {
                options.closeness * along * along
            };
            sum += state.anchors[v] * ((state.vertices[v] - mesh.vertices[v]) / edge).norm_squared();
        }
        let change = |v: u32| (state.vertices[v as usize] - mesh.vertices[v as usize]) / edge;
        for &[a, b] in &state.edges {
            let length = (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm() / edge;
            sum += options.stretch * ((change(b) - change(a)) / length.min(1.0)).norm_squared();
        }
        for &[a, b, c] in &case.polylines {
            sum += options.fairness * (change(a) - change(b) * 2.0 + change(c)).norm_squared();
        }
        for term in &state.feature_terms {
            let part = |k: usize| state.vertices[term.corners[k] as usize].coords * (term.factors[k] / edge);
            let direction: Vector3<f64> = (0..4).map(part).sum();
            sum += term.weight * term.across.dot(&direction).powi(2);
        }
        sum
    };
    let gradient = state.soft_terms(Phase::Balance);
    for v in (0..state.vertices.len()).filter(|&v| v != 7) {
        for axis in 0..3 {
            let h = 1e-5;
            let start = state.vertices[v];
            state.vertices[v][axis] = start[axis] + h;
            let above = energy(&state);
            state.vertices[v][axis] = start[axis] - h;
            let below = energy(&state);
            state.vertices[v] = start;
            // The energy is a sum of squares without the factor one half, its unit is the mean edge.
            let difference = (above - below) / (2.0 * h) * edge / 2.0;
            assert!((difference - gradient[v][axis]).abs() < 1e-6 * (1.0 + difference.abs()));
        }
    }
}

#[test]
fn a_single_quad_ends_on_its_best_plane() {
    let h = 0.1;
    let vertices = [[1.0, 0.0, h], [0.0, 1.0, -h], [-1.0, 0.0, h], [0.0, -1.0, -h]].map(Point3::from).to_vec();
    let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
    let options = PlanarizeOptions { closeness: 0.0, deviation: Some(1.0), ..PlanarizeOptions::default() };
    let result = Case { options, ..Case::bare(&mesh) }.run();
    assert!(result.mesh.vertices.iter().all(|p| p.z.abs() < 1e-9 && (p.coords.xy().norm() - 1.0).abs() < 1e-3));
}

#[test]
fn the_answer_follows_motion_scale_and_renumbering() {
    let mesh = skew_sphere(6);
    let expected = Case::on(&mesh, &sphere()).run().mesh;

    let motion = Translation3::new(30.0, -7.0, 2.0) * Rotation3::from_euler_angles(0.3, 1.0, -2.0);
    let count = mesh.vertices.len() as u32;
    let moved = mesh.vertices.iter().rev().map(|p| motion * (p * 40.0)).collect();
    let faces: Vec<Vec<u32>> = mesh.faces().map(|f| f.iter().map(|v| count - 1 - v).collect()).collect();
    let center = motion * Point3::origin();
    let moved_sphere = Implicit(|p: &Point3<f64>| {
        let n = (p - center).normalize();
        (center + n * 200.0, n)
    });
    let result = Case::on(&PanelMesh::new(moved, &faces).unwrap(), &moved_sphere).run().mesh;
    for (p, q) in expected.vertices.iter().rev().zip(&result.vertices) {
        assert!((motion * (p * 40.0) - q).norm() < 40.0 * 1e-6, "{}", (motion * (p * 40.0) - q).norm());
    }
}

#[test]
fn offsets_are_approached_without_giving_up_planarity() {
    use crate::mesh::{circularity, conicality};
    // Parallels and meridians of a waisted surface, shaken: the circular and conical net is near.
    let mesh = grid(10, 10, |s, t| {
        let radius = 2.0 - 1.4 * t * (1.2 - t);
        [radius * (1.5 * s).cos(), radius * (1.5 * s).sin(), 3.0 * t]
    });
    let reference = MeshReference::from_panels(&mesh);
    let mesh = shaken(&mesh, 0.01);
    let try_with = |offsets| {
        let options = PlanarizeOptions { offsets, ..PlanarizeOptions::default() };
        Case { options, ..Case::on(&mesh, &reference) }.run()
    };
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let (any, circular, conical) =
        (try_with(OffsetKind::Any), try_with(OffsetKind::Circular), try_with(OffsetKind::Conical));
    for result in [&any, &circular, &conical] {
        let (p, d) = (result.planarity_max(), result.deviation_max() / result.deviation_limit);
        assert!(p < 1e-10 && result.is_close, "{p:.1e} {d}");
    }
    assert!(mean(circularity(&circular.mesh)) < 0.1 * mean(circularity(&any.mesh)));
    assert!(mean(conicality(&conical.mesh)) < 0.1 * mean(conicality(&any.mesh)));
}

#[test]
fn pins_hold_exactly() {
    let mesh = skew_sphere(8);
    let pins = [0, 8, 40, 72, 80];
    let result = Case { pins: &pins, ..Case::on(&mesh, &sphere()) }.run();
    assert!(result.planarity_max() < 1e-10);
    for v in pins {
        assert_eq!(mesh.vertices[v as usize], result.mesh.vertices[v as usize]);
    }
}

#[test]
fn border_vertices_stay_on_the_border() {
    let mesh = saddle(10.0);
    let result = Case::new(&mesh).run();
    assert!(result.is_planar && result.is_close);
    let reference = MeshReference::from_panels(&mesh);
    for v in border_vertices(&mesh) {
        let p = result.mesh.vertices[v as usize];
        let off = (reference.closest_on_border(&p, None).unwrap().point - p).norm();
        let deviation = result.deviation[v as usize];
        assert!(deviation < 5e-3 * 6.0, "{deviation}");
        // Those at corners are held against the corner, which may be farther than the nearest point of the border.
        let is_corner = [0, 16, 272, 288].contains(&v);
        assert!((off - deviation).abs() < 1e-12 || is_corner && deviation > off, "{off} {deviation}");
    }
}

#[test]
fn larger_polygons_become_planar() {
    // A honeycomb on a sphere.
    let place = |x: f64, y: f64| Point3::new(x, y, (25.0 - x * x - y * y).sqrt());
    let (n, side) = (6, 0.35);
    let mut vertices: Vec<Point3<f64>> = vec![];
    let mut faces = vec![];
    for row in 0..n {
        for column in 0..n {
            let x = (column as f64 + 0.5 * (row % 2) as f64 - 2.7) * side * 3f64.sqrt();
            let y = (row as f64 - 2.5) * side * 1.5;
            let mut face = vec![];
            for k in 0..6 {
                let angle = (k as f64 + 0.5) * std::f64::consts::FRAC_PI_3;
                let p = place(x + side * angle.cos(), y + side * angle.sin());
                let index = vertices.iter().position(|q| (q - p).norm() < 1e-6).unwrap_or_else(|| {
                    vertices.push(p);
                    vertices.len() - 1
                });
                face.push(index as u32);
            }
            faces.push(face);
        }
    }
    let mesh = shaken(&PanelMesh::new(vertices, &faces).unwrap(), 0.01);
    let result = Case::on(&mesh, &sphere()).run();
    assert!(planarity(&mesh).into_iter().fold(0.0, f64::max) > 1e-2);
    assert!(result.planarity_max() < 1e-10 && result.is_close, "{:?}", result.planarity_max());
}

#[test]
fn hopeless_pins_give_a_result_with_numbers() {
    let vertices = [[1.0, 0.0, 0.3], [0.0, 1.0, -0.3], [-1.0, 0.0, 0.3], [0.0, -1.0, -0.3]];
    let mesh = PanelMesh::new(vertices.map(Point3::from).to_vec(), &[[0u32, 1, 2, 3]]).unwrap();
    let pinned = Case { pins: &[0, 1, 2, 3], ..Case::bare(&mesh) };
    let result = pinned.run();
    assert!(!result.is_planar && result.mesh == mesh);
    // As a last resort it may become triangles.
    let options = PlanarizeOptions { split_beyond: Some(1e-4), ..PlanarizeOptions::default() };
    let result = Case { options, ..pinned }.run();
    assert!(result.is_planar && result.mesh.face_count() == 2 && result.split == [0]);
    assert_eq!(result.mesh.vertices, mesh.vertices);
}

#[test]
fn edges_turn_along_feature_lines() {
    use crate::mesh::feature_angle;
    let mesh = grid(10, 10, |s, t| [s, t, 0.2 * s * s]);
    let line = (0..=40).map(|k| 0.1 + 0.02 * f64::from(k));
    let lines = [line.map(|s| Point3::new(s, 0.4 + 0.12 * s, 0.2 * s * s)).collect::<Vec<_>>()];
    let reference = MeshReference::from_panels(&mesh);
    let result = Case { feature_lines: &lines, ..Case::on(&mesh, &reference) }.run();
    let angle = |mesh: &PanelMesh| {
        let [sum, length] = feature_angle(&lines, mesh);
        sum / length
    };
    assert!(angle(&mesh) > 5.0 && angle(&result.mesh) < 0.5 * angle(&mesh), "{}", angle(&result.mesh));
    assert!(result.planarity_max() < 1e-10 && result.is_close);
}

/// The plane z = 0 with a border that falls from a corner at (0, 0, 0.3) along x, reaching the plane at (0.5, 0, 0), and
/// runs level along y.
struct FallingCorner;

impl Reference for FallingCorner {
    fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
        Foot { point: Point3::new(p.x, p.y, 0.0), direction: Vector3::z(), parameters: [0.0; 2] }
    }
    fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
        let corner = Point3::new(0.0, 0.0, 0.3);
        let feet = [Vector3::new(1.0, 0.0, -0.6).normalize(), Vector3::y()].map(|along| {
            let t = along.dot(&(p - corner)).max(0.0);
            let direction = if t > 0.0 { along } else { Vector3::zeros() };
            Foot { point: corner + along * t, direction, parameters: [0.0; 2] }
        });
        feet.into_iter().min_by(|a, b| (a.point - p).norm().total_cmp(&(b.point - p).norm()))
    }
}

#[test]
fn corners_of_the_border_do_not_slide_along_a_side() {
    let vertices = [[0.0, 0.0, 0.3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].map(Point3::from).to_vec();
    let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
    let options = PlanarizeOptions { deviation: Some(1.0), ..PlanarizeOptions::default() };
    let (reference, border) = (Some(&FallingCorner as _), vec![0]);
    let result = Case { reference, border, pins: &[1, 2, 3], options, ..Case::bare(&mesh) }.run();
    let p = result.mesh.vertices[0];
    assert!(result.is_planar && p.coords.norm() < 0.05, "{p}");
}

#[test]
fn degenerate_input_gives_an_error_or_a_finite_mesh() {
    let try_on = |mesh: &PanelMesh| Case::new(mesh).attempt();
    let good = grid(3, 3, translational);
    let mut collapsed = good.clone();
    collapsed.vertices[5] = collapsed.vertices[6];
    let result = try_on(&collapsed).unwrap();
    assert!(result.mesh.vertices.iter().all(|p| p.iter().all(|x| x.is_finite())));

    let mut broken = good.clone();
    broken.vertices[2].x = f64::NAN;
    assert!(matches!(try_on(&broken), Err(Error::NotFinite { index: 2, .. })));
    let point = PanelMesh { vertices: vec![Point3::origin(); 16], ..good.clone() };
    assert!(matches!(try_on(&point), Err(Error::Degenerate { .. })));
    assert!(matches!(try_on(&PanelMesh::default()), Err(Error::Degenerate { .. })));

    let triangle = PanelMesh::new(good.vertices[..5].to_vec(), &[[0u32, 1, 4]]).unwrap();
    assert_eq!(try_on(&triangle).unwrap().mesh, triangle);
    let line = grid(3, 1, |s, t| [s, 0.5 * t, 0.0]);
    let flat = PanelMesh { vertices: line.vertices.iter().map(|p| Point3::new(p.x + p.y, 0.0, 0.0)).collect(), ..line };
    assert!(try_on(&flat).unwrap().mesh.vertices.iter().all(|p| p.iter().all(|x| x.is_finite())));

    let control = Control::default();
    control.cancel();
    let case = Case { pins: &[99], ..Case::new(&good) };
    assert!(matches!(case.attempt(), Err(Error::Degenerate { .. })));
    let input = PlanarizeInput { pins: &[], ..case.input() };
    assert_eq!(planarize(&input, &case.options, &control).unwrap_err(), Error::Cancelled);
}

/// A heightfield z = f(x, y) trimmed by the circle of radius `radius`, cells of a grid turned by `degrees`, cut off at the circle.
fn trimmed(f: impl Fn(f64, f64) -> f64, radius: f64, cell: f64, degrees: f64) -> (PanelMesh, Vec<u32>) {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let half = (radius / cell).ceil() as i64 + 1;
    let corner = |i: i64, j: i64| [(i as f64 + 0.37) * cell, (j as f64 + 0.21) * cell];
    let inside = |p: [f64; 2]| p[0].hypot(p[1]) < radius;
    let mut plane: Vec<[f64; 2]> = vec![];
    let mut faces = vec![];
    let mut index = |p: [f64; 2]| {
        plane.iter().position(|q| (q[0] - p[0]).hypot(q[1] - p[1]) < 1e-9).unwrap_or_else(|| {
            plane.push(p);
            plane.len() - 1
        }) as u32
    };
    for i in -half..half {
        for j in -half..half {
            let ring = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            let mut face = vec![];
            for k in 0..4 {
                let (a, b) = (ring[k], ring[(k + 1) % 4]);
                if inside(a) {
                    face.push(index(a));
                }
                if inside(a) != inside(b) {
                    let (mut low, mut high) = if inside(a) { (a, b) } else { (b, a) };
                    for _ in 0..60 {
                        let middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
                        if inside(middle) { low = middle } else { high = middle }
                    }
                    face.push(index(low));
                }
            }
            if face.len() >= 3 {
                faces.push(face);
            }
        }
    }
    let vertices: Vec<_> = plane
        .iter()
        .map(|p| {
            let (x, y) = (p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos);
            Point3::new(x, y, f(x, y))
        })
        .collect();
    let border = (0..plane.len() as u32).filter(|&v| plane[v as usize][0].hypot(plane[v as usize][1]) > radius - 1e-6);
    let border = border.collect();
    (PanelMesh::new(vertices, &faces).unwrap(), border)
}

/// Closest points, to first order, on a heightfield trimmed by a circle.
struct Trimmed<F: Fn(f64, f64) -> f64>(F, f64);

impl<F: Fn(f64, f64) -> f64> Reference for Trimmed<F> {
    fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
        let h = 1e-5;
        let (mut x, mut y) = (p.x, p.y);
        let mut normal = Vector3::z();
        for _ in 0..20 {
            let z = (self.0)(x, y);
            let (zx, zy) = (((self.0)(x + h, y) - z) / h, ((self.0)(x, y + h) - z) / h);
            normal = Vector3::new(-zx, -zy, 1.0).normalize();
            let foot = p.coords - normal * normal.dot(&(p.coords - Vector3::new(x, y, z)));
            (x, y) = (foot.x, foot.y);
        }
        Foot { point: Point3::new(x, y, (self.0)(x, y)), direction: normal, parameters: [0.0; 2] }
    }
    fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
        let at = |a: f64| {
            let (x, y) = (self.1 * a.cos(), self.1 * a.sin());
            Point3::new(x, y, (self.0)(x, y))
        };
        let mut angle = p.y.atan2(p.x);
        let h = 1e-5;
        for _ in 0..20 {
            let tangent = (at(angle + h) - at(angle - h)) / (2.0 * h);
            angle += (p - at(angle)).dot(&tangent) / tangent.norm_squared();
        }
        let tangent = (at(angle + h) - at(angle - h)).normalize();
        Some(Foot { point: at(angle), direction: tangent, parameters: [0.0; 2] })
    }
}

fn turned_faces(before: &PanelMesh, after: &[Point3<f64>]) -> usize {
    let area = |vertices: &[Point3<f64>], face: &[u32]| -> Vector3<f64> {
        let at = |k: usize| vertices[face[k] as usize];
        (1..face.len() - 1).map(|k| (at(k) - at(0)).cross(&(at(k + 1) - at(0)))).sum()
    };
    before.faces().filter(|f| area(&before.vertices, f).dot(&area(after, f)) <= 0.0).count()
}

#[test]
fn a_net_near_the_rulings_of_a_saddle_becomes_planar_without_turning_faces() {
    let f = |x: f64, y: f64| (x * x - y * y) / 8.0;
    let (mesh, border) = trimmed(f, 4.0, 0.45, 40.0);
    let options = PlanarizeOptions { allowance: 10.0, ..PlanarizeOptions::default() };
    let result = Case { border, options, ..Case::on(&mesh, &Trimmed(f, 4.0)) }.run();
    assert!(result.planarity_max() < 1e-10, "{:.1e}", result.planarity_max());
    assert_eq!(turned_faces(&mesh, &result.mesh.vertices), 0);
}

/// The plane z = 0 with the line through (0, 1, 0.3) along (0, 1, 0.1) as its border.
struct SlantedBorder;

impl Reference for SlantedBorder {
    fn closest(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Foot {
        Foot { point: Point3::new(p.x, p.y, 0.0), direction: Vector3::z(), parameters: [0.0; 2] }
    }
    fn closest_on_border(&self, p: &Point3<f64>, _: Option<[f64; 2]>) -> Option<Foot> {
        let (start, along) = (Point3::new(0.0, 1.0, 0.3), Vector3::new(0.0, 1.0, 0.1).normalize());
        Some(Foot { point: start + along * along.dot(&(p - start)), direction: along, parameters: [0.0; 2] })
    }
}

#[test]
fn a_cell_that_could_only_turn_over_is_split_where_it_may_be() {
    // Its last corner would have to slide down the border to (0, -2, 0).
    let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.3]].map(Point3::from).to_vec();
    let mesh = PanelMesh::new(vertices, &[[0u32, 1, 2, 3]]).unwrap();
    let options = PlanarizeOptions { border: 1e7, ..PlanarizeOptions::default() };
    let (reference, border) = (Some(&SlantedBorder as _), vec![3]);
    let case = Case { reference, border, pins: &[0, 1, 2], splittable: &[0], options, ..Case::bare(&mesh) };
    let result = case.run();
    assert_eq!((result.mesh.face_count(), result.split.as_slice()), (2, [0u32].as_slice()));
    assert!(result.is_planar && result.is_close && turned_faces(&mesh, &result.mesh.vertices) == 0);

    let whole = Case { splittable: &[], ..case }.run();
    assert!(whole.mesh.face_count() == 1 && !whole.is_planar && whole.planarity_max() > 0.1);
    assert_eq!(turned_faces(&mesh, &whole.mesh.vertices), 0);
}

#[test]
fn trimmed_cells_become_planar_on_the_border_too() {
    type Height = fn(f64, f64) -> f64;
    let shapes: [(Height, f64); 4] = [
        (|x, y| 0.8 * (0.7 * x).sin() + 0.6 * (0.6 * y + 0.4).cos(), 0.0),
        (|x, y| (36.0 - x * x - y * y).sqrt(), 20.0),
        (|x, y| (x * x - y * y) / 8.0, 0.0),
        (|x, y| (x * x - y * y) / 8.0, 10.0),
    ];
    for (f, degrees) in shapes {
        let (mesh, border) = trimmed(f, 4.0, 0.45, degrees);
        assert!(mesh.faces().any(|f| f.len() == 5) && mesh.faces().any(|f| f.len() == 3));
        let reference = Trimmed(f, 4.0);
        let result = Case { border: border.clone(), ..Case::on(&mesh, &reference) }.run();
        assert!(result.planarity_max() < 1e-10 && result.is_close, "{:.1e}", result.planarity_max());
        // Border vertices within 1e-3 of the width.
        assert!(border.iter().all(|&v| result.deviation[v as usize] < 8e-3));
        // No edge on the border cuts a bend of it short.
        let edge = mean_edge_length(&mesh);
        let mut held = vec![false; mesh.vertices.len()];
        border.iter().for_each(|&v| held[v as usize] = true);
        let sides = border_sides(&mesh);
        let starts = vec![[0.0; 2]; held.len()];
        let trace = BorderTrace::new(&mesh.vertices, &sides, &held, &starts, &reference, edge, BORDER_GAP * edge);
        assert!(trace.strains(&result.mesh.vertices).into_iter().all(|strain| strain <= 1.0));
        // Slivers keep their shape.
        let shortest = |m: &PanelMesh| crate::mesh::edge_lengths(m).into_iter().fold(f64::INFINITY, f64::min);
        assert!(shortest(&result.mesh) > 0.5 * shortest(&mesh));
    }
}
