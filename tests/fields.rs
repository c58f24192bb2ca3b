//! Fields on surfaces like those that sketches show, and along the whole border.

use nalgebra::Point3;
use sides::sides;
use sketch2pq::control::Control;
use sketch2pq::datagen::{Options, sample};
use sketch2pq::field::{MapOptions, TriangleFrames, integrate, second_forms};
use sketch2pq::mesh::{BorderMode, border_vertices};
use sketch2pq::pipeline::{
    FeatureCurve, FieldOptions, MeshOptions, Placement, Session, SessionOptions, SurfaceOptions, SurfaceResult,
    extract_pq_mesh, sketch_to_cdf, sketch_to_surface, surface_to_cdf,
};
use sketch2pq::sketch::read_sketch;
use sketch2pq::surface::{FundamentalForms, NurbsSurface, SurfaceProjector};

#[path = "../examples/shared/sides.rs"]
mod sides;

fn session() -> Session {
    Session::new(&SessionOptions { threads: 1, ..SessionOptions::default() }).unwrap()
}

/// Most of the bending energy that may lie on triangles that count as flat.
const FLAT_SHARE: f64 = 1e-3;

#[test]
fn random_surfaces_have_conjugate_fields_along_their_feature_lines() {
    let mut session = session();
    // On 20, 21 and 23 the layout's system was not positive definite once; 9,000,001 to 9,000,005 have spikes of curvature at their
    // corners, beside which everything else counted as flat.
    for seed in [20, 21, 22, 23, 9_000_000, 9_000_001, 9_000_004, 9_000_005, 9_000_008, 9_000_010] {
        let Ok(truth) = sample(seed, &Options::default()) else { continue };
        let placement = Placement::of_sketch(&truth.sketch.view, &truth.patch.frame, 0.0);
        let surface = SurfaceResult::from_nurbs(vec![truth.surface.mapped(|p| placement.to_world(p))]).unwrap();
        let options = FieldOptions { use_network: false, ..FieldOptions::default() };
        let field = sketch_to_cdf(&mut session, Some(&truth.sketch), &surface, &options).unwrap();
        let all = field.measures();
        assert!(all.conjugacy_mean <= 1e-3, "seed {seed}: {}", all.conjugacy_mean);
        assert!(all.conjugacy_max <= 1e-2, "seed {seed}: {}", all.conjugacy_max);
        assert!(all.crossing_min_deg >= 20.0 - 1e-6, "seed {seed}: {}", all.crossing_min_deg);
        let patch = &field.patches[0];
        let field = &patch.field;
        // Lines are soft constraints here: they give way, and the floor has nothing to win.
        assert!(field.diagnostics.floor_triangles.is_empty());
        let frames = TriangleFrames::new(&field.mesh, &field.edges).unwrap();
        let forms = second_forms(&field.mesh, &frames);
        let bending = |t: usize| {
            let square = forms[t].norm().powi(2);
            frames.areas[t] * square / (1.0 + frames.areas[t] * square)
        };
        // Not only on triangles: on the surface itself, at their middles.
        for t in (0..forms.len() as u32).filter(|t| field.diagnostics.flat_triangles.binary_search(t).is_err()) {
            let corners = field.mesh.triangles[t as usize].map(|v| field.mesh.parameters[v as usize]);
            let [a, b] = [0, 1].map(|k| corners.iter().map(|p| p[k]).sum::<f64>() / 3.0);
            let point = patch.surface.evaluate(a, b);
            let Some(exact) = FundamentalForms::new(&point) else { continue };
            let x = point.du.normalize();
            let norm = exact.second_in(&point, &x, &exact.normal.cross(&x)).norm();
            let flat = |d: nalgebra::Vector3<f64>| (d - exact.normal * exact.normal.dot(&d)).normalize();
            let [u, v] = field.directions[t as usize].map(flat);
            let residual = exact.second_in(&point, &u, &v)[(0, 1)].abs();
            assert!(residual <= 1e-9 * norm, "seed {seed}, triangle {t}: {residual} of {norm}");
        }
        let flat: f64 = field.diagnostics.flat_triangles.iter().map(|&t| bending(t as usize)).sum();
        let total: f64 = (0..forms.len()).map(bending).sum();
        assert!(flat <= FLAT_SHARE * total, "seed {seed}: {flat} of {total}");
    }
}

#[test]
fn aligned_panels_of_a_translational_patch_are_its_parameter_net() {
    let mut session = session();
    let n = 9;
    let a = |i: f64| [i, 0.2 * (0.7 * i).sin(), 0.14 * i * (8.0 - i)];
    let b = |j: f64| [0.15 * j, 0.9 * j, 0.1 * j * (8.0 - j)];
    let net = (0..n * n)
        .map(|k| [a((k / n) as f64), b((k % n) as f64)])
        .map(|[a, b]| Point3::new(a[0] + b[0], a[1] + b[1], a[2] + b[2]))
        .collect();
    let patch = NurbsSurface::uniform(3, [n, n], net).unwrap();
    let surface = SurfaceResult::from_nurbs(vec![patch.clone()]).unwrap();
    let options = FieldOptions { aligned_sides: [true; 4], ..FieldOptions::default() };
    let field = surface_to_cdf(&mut session, &surface, &[], &options).unwrap();
    assert!(field.patches[0].field.singularities.is_empty());
    let options = MeshOptions { border: BorderMode::Aligned, faces: 300, ..MeshOptions::default() };
    let mesh = extract_pq_mesh(&mut session, &field, &options).unwrap();
    let measures = mesh.measures();
    assert_eq!((measures.irregular_vertices, measures.quads), (0, measures.faces));
    assert!(measures.planarity_max < 1e-6 && measures.deviation_max_edges < 0.05, "{measures:?}");
    // Each edge runs along one parameter: the other one hardly changes.
    let projector = SurfaceProjector::new(&patch);
    let mesh = &mesh.patches[0].mesh;
    let parameters: Vec<[f64; 2]> = mesh.vertices.iter().map(|p| projector.closest(p).parameters).collect();
    let mut angles: Vec<f64> = mesh
        .faces()
        .flat_map(|face| (0..4).map(|k| [face[k], face[(k + 1) % 4]]))
        .map(|ends| {
            let [p, q] = ends.map(|v| parameters[v as usize]);
            let (du, dv) = ((p[0] - q[0]).abs(), (p[1] - q[1]).abs());
            du.min(dv).atan2(du.max(dv)).to_degrees()
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let mean = angles.iter().sum::<f64>() / angles.len() as f64;
    assert!(mean < 1.5 && angles[angles.len() - 1] < 8.0, "{mean} degrees, {} at most", angles[angles.len() - 1]);
}

/// A cap z = (1 - x^2 - y^2) / 3 over the unit disk, its net's corners on the circle.
fn cap() -> NurbsSurface {
    let n = 24;
    let point = |k: usize| {
        let [s, t] = [k / (n + 1), k % (n + 1)].map(|i| 2.0 * i as f64 / n as f64 - 1.0);
        let [x, y] = [s * (1.0 - 0.5 * t * t).sqrt(), t * (1.0 - 0.5 * s * s).sqrt()];
        Point3::new(x, y, (1.0 - x * x - y * y) / 3.0)
    };
    NurbsSurface::uniform(3, [n + 1, n + 1], (0..(n + 1) * (n + 1)).map(point).collect()).unwrap()
}

#[test]
fn a_round_border_that_is_followed_all_around_has_four_irregular_vertices_inside_and_none_on_it() {
    let mut session = session();
    let surface = SurfaceResult::from_nurbs(vec![cap()]).unwrap();
    let options = FieldOptions { aligned_sides: [true; 4], ..FieldOptions::default() };
    let field = surface_to_cdf(&mut session, &surface, &[], &options).unwrap();
    // Poincare and Hopf: the cross turns once with the circle, which has no corners.
    let indices: Vec<i32> = field.patches[0].field.singularities.iter().map(|s| s.index).collect();
    assert_eq!(indices, [1; 4]);
    // Cells whose border edge would stray too far from the circle are cut, where there are few.
    for (faces, cut) in [(100, 8), (400, 4), (1500, 0)] {
        let options = MeshOptions { border: BorderMode::Aligned, faces, ..MeshOptions::default() };
        let mesh = extract_pq_mesh(&mut session, &field, &options).unwrap();
        let all = mesh.measures();
        assert!(all.faces - all.quads <= cut && all.irregular_vertices == 4, "{all:?}");
        assert!(all.planarity_max < 1e-6 && all.deviation_max_edges < 0.1, "{all:?}");
        let mesh = &mesh.patches[0].mesh;
        let sides = sides(mesh);
        assert!(sides.values().all(|&n| n <= 2));
        let on_border = border_vertices(mesh);
        for &v in &on_border {
            let p = mesh.vertices[v as usize];
            assert!((p.x.hypot(p.y) - 1.0).abs() < 0.01 && p.z.abs() < 0.01, "{p}");
            // Two edges of the loop, and one that goes inside.
            assert!(cut > 0 || sides.keys().filter(|side| side.contains(&v)).count() == 3);
        }
    }
}

#[test]
fn each_side_is_followed_where_that_is_asked_for() {
    let mut session = session();
    // On a paraboloid any orthogonal pair in the plane is conjugate, so the curves decide, and they run aslant.
    let corner = |s: f64, t: f64| [4.0 * s + t, 3.0 * t + 0.5 * s];
    let n = 12;
    let point = |k: usize| {
        let [x, y] = corner((k / (n + 1)) as f64 / n as f64, (k % (n + 1)) as f64 / n as f64);
        Point3::new(x, y, 0.05 * (x * x + y * y))
    };
    let patch = NurbsSurface::uniform(3, [n + 1, n + 1], (0..(n + 1) * (n + 1)).map(point).collect()).unwrap();
    let surface = SurfaceResult::from_nurbs(vec![patch]).unwrap();
    let diagonal = [corner(0.1, 0.2), corner(0.9, 0.8)];
    let points = (0..=20).map(|i| f64::from(i) / 20.0).map(|t| {
        let [x, y] = [0, 1].map(|k| diagonal[0][k] + t * (diagonal[1][k] - diagonal[0][k]));
        Point3::new(x, y, 0.05 * (x * x + y * y))
    });
    let curves = [FeatureCurve { points: points.collect(), hard: false }];
    // u = min and v = max, each alone, and together.
    for aligned_sides in [[true, false, false, false], [false, false, false, true], [true, false, false, true]] {
        let options = FieldOptions { aligned_sides, ..FieldOptions::default() };
        let field = surface_to_cdf(&mut session, &surface, &curves, &options).unwrap();
        let field = &field.patches[0].field;
        let [nu, nv] = field.mesh.cells.map(|c| c as u32);
        let mut worst = [0.0f64; 4];
        for e in (0..field.edges.len()).filter(|&e| field.edges.is_border(e)) {
            let ends = field.edges.vertices[e];
            let along = field.mesh.position(ends[1]) - field.mesh.position(ends[0]);
            let angle = |d: &nalgebra::Vector3<f64>| d.cross(&along).norm().atan2(d.dot(&along).abs()).to_degrees();
            let off = field.directions[field.edges.triangles[e][0] as usize].iter().map(angle).fold(90.0, f64::min);
            let line = ends.map(|v| [v / (nv + 1), v % (nv + 1)]);
            let on = [[0, 0], [0, nu], [1, 0], [1, nv]].map(|[k, l]| line.iter().all(|g| g[k as usize] == l));
            (0..4).filter(|&k| on[k]).for_each(|k| worst[k] = worst[k].max(off));
        }
        for k in 0..4 {
            assert!(if aligned_sides[k] { worst[k] < 1e-6 } else { worst[k] > 5.0 }, "{aligned_sides:?}: {worst:?}");
        }
    }
}

#[test]
fn a_rounded_border_has_corners_where_panels_are_longer_than_its_arcs() {
    let mut session = session();
    // A shallow dome over x^8 + y^8 < 1, whose corners are rounded at radii of 0.18.
    let n = 40;
    let point = |k: usize| {
        let [s, t] = [k / (n + 1), k % (n + 1)].map(|i| 2.0 * i as f64 / n as f64 - 1.0);
        let share = s.abs().max(t.abs()) / (s.powi(8) + t.powi(8)).powf(0.125).max(f64::MIN_POSITIVE);
        let [x, y] = [s * share, t * share];
        Point3::new(x, y, -0.1 * (x * x + y * y))
    };
    let patch = NurbsSurface::uniform(1, [n + 1, n + 1], (0..(n + 1) * (n + 1)).map(point).collect()).unwrap();
    let surface = SurfaceResult::from_nurbs(vec![patch]).unwrap();
    // Poincare and Hopf: the cross turns once with the border, less a quarter at each corner.
    let aligned = FieldOptions { aligned_sides: [true; 4], ..FieldOptions::default() };
    for (options, sum) in [
        (FieldOptions { faces: 16, ..aligned.clone() }, 0),
        (FieldOptions { edge_length: 0.5, ..aligned.clone() }, 0),
        (FieldOptions { faces: 1000, ..aligned.clone() }, 4),
        (FieldOptions { edge_length: 0.06, ..aligned }, 4),
    ] {
        let field = surface_to_cdf(&mut session, &surface, &[], &options).unwrap();
        let indices = field.patches[0].field.singularities.iter().map(|s| s.index);
        assert_eq!(indices.sum::<i32>(), sum, "{options:?}");
    }
}

#[test]
fn aligned_sketches_become_planar_meshes_that_end_on_the_border() {
    let mut session = session();
    // What these outlines need: singularities of the field for their rounded corners, at most.
    for (name, most) in [("dome", 4), ("barrel_vault", 1), ("saddle", 0), ("rounded_corner", 6), ("results_left", 8)] {
        let sketch = read_sketch(format!("examples/sketches/{name}.json").as_ref()).unwrap();
        let surface = sketch_to_surface(&mut session, &sketch, &SurfaceOptions::default()).unwrap();
        let options = FieldOptions { aligned_sides: [true; 4], ..FieldOptions::default() };
        let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &options).unwrap();
        let options = MeshOptions { border: BorderMode::Aligned, ..MeshOptions::default() };
        let mesh = extract_pq_mesh(&mut session, &field, &options).unwrap();
        let all = mesh.measures();
        assert!(field.patches[0].field.singularities.len() <= most, "{name}");
        assert!(all.planarity_max <= 1e-6 && all.deviation_max_edges <= 0.2, "{name}: {all:?}");
        // A corner of the patch that is none of the panels leaves a triangle or a pentagon or two.
        assert!(all.faces - all.quads <= all.faces / 20, "{name}: {all:?}");
        let sides = sides(&mesh.patches[0].mesh);
        assert!(sides.values().all(|&n| n <= 2), "{name}");
        let border = border_points(&surface.patches[0].surface);
        for v in border_vertices(&mesh.patches[0].mesh) {
            let p = mesh.patches[0].mesh.vertices[v as usize];
            let off = border.iter().map(|q| (q - p).norm()).fold(f64::INFINITY, f64::min);
            assert!(off < 0.05 * all.edge_length_mean, "{name}: {off} of {}", all.edge_length_mean);
        }
    }
}

/// Points all along the border of a surface.
fn border_points(surface: &NurbsSurface) -> Vec<Point3<f64>> {
    let side = |i: u32| {
        let t = f64::from(i % 2000) / 2000.0;
        let [s, t] = [[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]][i as usize / 2000];
        let [u, v] = surface.at_fraction(s, t);
        surface.point(u, v)
    };
    (0..8000).map(side).collect()
}

#[test]
fn without_lines_the_field_of_a_rotational_surface_follows_its_meridians() {
    let mut session = session();
    // A quarter of a bell, its meridians along u; the principal directions are distinct all over.
    let n = 16;
    let point = |k: usize| {
        let [s, t] = [k / (n + 1), k % (n + 1)].map(|i| i as f64 / n as f64);
        let (radius, angle) = (1.0 + s + 0.3 * s * s, 1.5 * t);
        Point3::new(radius * angle.cos(), radius * angle.sin(), 1.5 - 1.2 * s * s)
    };
    let patch = NurbsSurface::uniform(3, [n + 1, n + 1], (0..(n + 1) * (n + 1)).map(point).collect()).unwrap();
    let surface = SurfaceResult::from_nurbs(vec![patch]).unwrap();
    let field = surface_to_cdf(&mut session, &surface, &[], &FieldOptions::default()).unwrap();
    let field = &field.patches[0].field;
    assert!(field.singularities.is_empty() && field.diagnostics.conjugacy_max < 1e-9);
    let mut sum = 0.0;
    for (t, directions) in field.directions.iter().enumerate() {
        let corners = field.mesh.triangles[t].map(|v| &field.mesh.points[v as usize]);
        let along: nalgebra::Vector3<f64> = corners.iter().map(|p| p.du).sum();
        let angle = |d: &nalgebra::Vector3<f64>| d.cross(&along).norm().atan2(d.dot(&along).abs()).to_degrees();
        sum += directions.iter().map(angle).fold(90.0, f64::min);
    }
    let mean = sum / field.directions.len() as f64;
    assert!(mean < 2.0, "{mean} degrees");
}

#[test]
fn field_map_and_mesh_are_the_same_bytes_on_any_number_of_threads() {
    let sketch = read_sketch("examples/sketches/rounded_corner.json".as_ref()).unwrap();
    let run = |threads: usize, aligned: bool| {
        let mut session = Session::new(&SessionOptions { threads, ..SessionOptions::default() }).unwrap();
        let surface = sketch_to_surface(&mut session, &sketch, &SurfaceOptions::default()).unwrap();
        let options = FieldOptions { aligned_sides: [aligned; 4], ..FieldOptions::default() };
        let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &options).unwrap();
        let map = integrate(&field.patches[0].field, &MapOptions::default(), &Control::default()).unwrap();
        let mesh = extract_pq_mesh(&mut session, &field, &MeshOptions::default()).unwrap();
        let field = &field.patches[0].field;
        let bits = |v: &nalgebra::Vector3<f64>| [v.x, v.y, v.z].map(f64::to_bits);
        let directions: Vec<_> = field.directions.iter().chain(&field.layout).flatten().map(bits).collect();
        let places: Vec<_> = mesh.patches[0].mesh.vertices.iter().map(|p| bits(&p.coords)).collect();
        let panels = (places, mesh.patches[0].mesh.indices.clone());
        (directions, field.matching.clone(), map.corners, map.transitions, panels)
    };
    for aligned in [false, true] {
        let one = run(1, aligned);
        assert!(run(2, aligned) == one && run(3, aligned) == one, "aligned: {aligned}");
    }
}
