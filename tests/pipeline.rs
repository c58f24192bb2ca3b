//! The three calls together: frames, placement, several patches, a host's own surface, feature lines, cancel,
//! determinism.

use nalgebra::Point3;
use sketch2pq::Error;
use sketch2pq::infer::BackendChoice;
use sketch2pq::mesh::{BorderMode, border_vertices};
use sketch2pq::pipeline::{
    FeatureCurve, FieldOptions, FixedSingularity, MeshOptions, Session, SessionOptions, SharedSession, SurfaceOptions,
    SurfacePlace, SurfaceResult, extract_pq_mesh, sketch_to_cdf, sketch_to_surface, surface_to_cdf,
};
use sketch2pq::sketch::{DepthSample, Layer, Sketch, Stroke, StrokeKind, View};
use sketch2pq::surface::{KnotVector, NurbsSurface, SurfaceProjector};
use std::sync::{Arc, mpsc};

fn session() -> Session {
    let options = SessionOptions { backend: BackendChoice::Embedded, threads: 1, ..SessionOptions::default() };
    Session::new(&options).unwrap()
}

/// A sheet of four border strokes, canvas y down, scaled and then moved.
fn sheet(scale: f64, [dx, dy]: [f64; 2]) -> Sketch {
    let lines: [&[[f64; 2]]; 4] = [
        &[[30.0, 190.0], [80.0, 215.0], [130.0, 222.0], [180.0, 214.0], [228.0, 192.0]],
        &[[228.0, 192.0], [222.0, 150.0], [214.0, 108.0], [204.0, 70.0]],
        &[[204.0, 70.0], [165.0, 48.0], [125.0, 42.0], [88.0, 50.0], [52.0, 72.0]],
        &[[52.0, 72.0], [44.0, 110.0], [37.0, 150.0], [30.0, 190.0]],
    ];
    let place = |p: &[f64; 2]| [p[0] * scale + dx, p[1] * scale + dy];
    let stroke =
        |line: &&[[f64; 2]]| Stroke { kind: StrokeKind::VisibleBoundary, points: line.iter().map(place).collect() };
    Sketch {
        name: String::new(),
        canvas_size: [256.0; 2],
        view: View::default(),
        strokes: lines.iter().map(stroke).collect(),
        depth_samples: vec![],
    }
}

fn surface(session: &mut Session, sketch: &Sketch) -> SurfaceResult {
    sketch_to_surface(session, sketch, &SurfaceOptions::default()).unwrap()
}

fn lowest(surface: &NurbsSurface) -> f64 {
    let fractions: Vec<f64> = (0..=400).map(|i| f64::from(i) / 400.0).collect();
    let z = |s: f64, t: f64| {
        let [u, v] = surface.at_fraction(s, t);
        surface.point(u, v).z
    };
    fractions
        .iter()
        .flat_map(|&s| fractions.iter().map(move |&t| (s, t)))
        .map(|(s, t)| z(s, t))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn moving_and_scaling_the_strokes_moves_and_scales_everything() {
    let mut session = session();
    let mut run = |scale, offset| {
        let sketch = sheet(scale, offset);
        let surface = surface(&mut session, &sketch);
        let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &FieldOptions::default()).unwrap();
        let options = MeshOptions { faces: 120, ..MeshOptions::default() };
        let mesh = extract_pq_mesh(&mut session, &field, &options).unwrap();
        (surface.patches[0].surface.control_points().to_vec(), mesh.patches[0].mesh.clone())
    };
    let (net, mesh) = run(1.0, [0.0, 0.0]);
    // Scaling by a power of two is exact in floating point.
    let (scaled_net, scaled_mesh) = run(4.0, [0.0, 0.0]);
    assert!(net.iter().zip(&scaled_net).all(|(p, q)| (p.coords * 4.0 - q.coords).norm() <= 1e-12 * q.coords.norm()));
    assert_eq!((&mesh.starts, &mesh.indices), (&scaled_mesh.starts, &scaled_mesh.indices));
    for (p, q) in mesh.vertices.iter().zip(&scaled_mesh.vertices) {
        assert!((p.coords * 4.0 - q.coords).norm() <= 1e-12 * (1.0 + q.coords.norm()));
    }
    // Moving rounds the strokes a little; the ground stays at z = 0, so the surface moves horizontally only.
    let (moved_net, _) = run(1.0, [1000.0, -512.0]);
    let shift = moved_net[0] - net[0];
    assert!(shift.z.abs() < 1e-6 && shift.norm() > 1000.0);
    for (p, q) in net.iter().zip(&moved_net) {
        assert!((p + shift - q).norm() < 1e-4, "{p} {q}");
    }
}

#[test]
fn without_depth_samples_the_lowest_point_has_height_zero() {
    let mut session = session();
    for elevation in [45.0, 20.0, 90.0, -30.0] {
        let mut sketch = sheet(1.0, [0.0, 0.0]);
        sketch.view = View::from_angles(30.0, elevation, true).unwrap();
        let surface = surface(&mut session, &sketch);
        let z = lowest(&surface.patches[0].surface);
        assert!((0.0..2e-2).contains(&(z + 1e-9)), "{elevation}: {z}");
    }
}

#[test]
fn with_depth_samples_the_surface_passes_through_them() {
    let mut session = session();
    let mut sketch = sheet(1.0, [0.0, 0.0]);
    let samples = [([130.0, 130.0], 800.0), ([90.0, 90.0], 820.0), ([170.0, 180.0], 770.0)];
    sketch.depth_samples =
        samples.iter().map(|&(position, depth)| DepthSample { position, layer: Layer::Visible, depth }).collect();
    let surface = surface(&mut session, &sketch);
    let residual = surface.report.sample_residual.unwrap();
    let projector = SurfaceProjector::new(&surface.patches[0].surface);
    for sample in &sketch.depth_samples {
        let [x, y] = sketch.view.canvas_to_camera(sample.position);
        let point = sketch.view.camera_to_world(&Point3::new(x, y, -sample.depth));
        // A hundredth of the sketch's size.
        let distance = (projector.closest(&point).position - point).norm();
        assert!(distance <= residual + 1e-6 && distance < 2.0, "{distance} {residual}");
    }
}

#[test]
fn each_outline_becomes_a_patch() {
    let mut session = session();
    let mut sketch = sheet(1.0, [0.0, 0.0]);
    sketch.strokes.extend(sheet(0.5, [400.0, 50.0]).strokes);
    let surface = surface(&mut session, &sketch);
    assert_eq!(surface.patches.len(), 2);
    let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &FieldOptions::default()).unwrap();
    let mesh = extract_pq_mesh(&mut session, &field, &MeshOptions { faces: 250, ..MeshOptions::default() }).unwrap();
    assert_eq!(mesh.patches.len(), 2);
    let [large, small] = [0, 1].map(|k| mesh.patches[k].mesh.face_count());
    assert!(large > 2 * small && (200..310).contains(&(large + small)), "{large} {small}");
    assert_eq!(mesh.report.faces, Some(large + small));
    // Both stand on the ground.
    for patch in &surface.patches {
        assert!(lowest(&patch.surface).abs() < 1e-2);
    }
    let corners = Some([[0.0; 2]; 4]);
    let options = SurfaceOptions { corners, ..SurfaceOptions::default() };
    assert!(matches!(sketch_to_surface(&mut session, &sketch, &options), Err(Error::Argument { name: "corners", .. })));
}

#[test]
fn corners_can_be_given() {
    let mut session = session();
    let sketch = sheet(1.0, [0.0, 0.0]);
    let places = [[130.0, 225.0], [215.0, 110.0], [125.0, 40.0], [40.0, 110.0]];
    let options = SurfaceOptions { corners: Some(places), ..SurfaceOptions::default() };
    let surface = sketch_to_surface(&mut session, &sketch, &options).unwrap();
    let net = surface.patches[0].surface.control_points();
    for corner in [net[0], net[29], net[870], net[899]] {
        let camera = sketch.view.world_to_camera(&corner);
        let [x, y] = sketch.view.camera_to_canvas([camera.x, camera.y]);
        let nearest = places.iter().map(|p| (p[0] - x).hypot(p[1] - y)).fold(f64::INFINITY, f64::min);
        assert!(nearest < 6.0, "{nearest}");
    }
}

/// A quarter of a cylinder of radius `radius`, height 2 radius.
fn cylinder(radius: f64) -> NurbsSurface {
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let arc = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let net =
        arc.iter().flat_map(|&(x, y)| [0.0, 2.0].map(|z| Point3::new(x * radius, y * radius, z * radius))).collect();
    let knots = [KnotVector::uniform(2, 3), KnotVector::uniform(1, 2)];
    NurbsSurface::new(knots, net, Some(vec![1.0, 1.0, h, h, 1.0, 1.0])).unwrap()
}

#[test]
fn a_hosts_surface_enters_at_the_field_in_any_unit() {
    let mut session = session();
    for radius in [1.0, 5000.0, 1e-4] {
        let surface = SurfaceResult::from_nurbs(vec![cylinder(radius)]).unwrap();
        let field = sketch_to_cdf(&mut session, None, &surface, &FieldOptions::default()).unwrap();
        for border in [BorderMode::Trimmed, BorderMode::Aligned, BorderMode::Interior] {
            let options = MeshOptions { border, faces: 100, ..MeshOptions::default() };
            let mesh = extract_pq_mesh(&mut session, &field, &options).unwrap();
            let patch = &mesh.patches[0];
            assert!(mesh.measures().planarity_max < 1e-6, "{radius} {border:?}");
            for (p, d) in patch.mesh.vertices.iter().zip(&patch.deviation) {
                assert!((p.x.hypot(p.y) - radius).abs() <= d + 1e-9 * radius && *d < 0.05 * radius);
            }
            let outline = border_vertices(&patch.mesh);
            assert!(patch.on_border.iter().enumerate().all(|(v, b)| outline.contains(&(v as u32)) == *b));
            let covered = mesh.measures().border_covered.unwrap();
            assert!(border == BorderMode::Interior || covered > 0.98, "{radius} {border:?} {covered}");
        }
        let length = MeshOptions { edge_length: radius * 0.2, ..MeshOptions::default() };
        let mesh = extract_pq_mesh(&mut session, &field, &length).unwrap();
        let mean = mesh.measures().edge_length_mean / radius;
        assert!((0.14..0.26).contains(&mean), "{radius} {mean}");
    }
    let point = cylinder(1.0).mapped(|_| Point3::origin());
    assert!(matches!(SurfaceResult::from_nurbs(vec![point]), Err(Error::Degenerate { .. })));
    assert!(matches!(SurfaceResult::from_nurbs(vec![]), Err(Error::Degenerate { .. })));
}

#[test]
fn feature_lines_steer_the_field_on_a_hosts_surface() {
    let mut session = session();
    let surface = SurfaceResult::from_nurbs(vec![cylinder(10.0)]).unwrap();
    let view = View::from_angles(45.0, 20.0, false).unwrap();
    // A helix of 35 degrees, drawn where the view shows it.
    let line = (0..=40).map(|i| {
        let angle = 0.4 + 0.02 * f64::from(i);
        let p = Point3::new(10.0 * angle.cos(), 10.0 * angle.sin(), 6.0 + 7.0 * (angle - 0.4));
        let camera = view.world_to_camera(&p);
        view.camera_to_canvas([camera.x, camera.y])
    });
    let strokes = vec![Stroke { kind: StrokeKind::Feature, points: line.collect() }];
    let sketch = Sketch { name: String::new(), canvas_size: [1.0; 2], view, strokes, depth_samples: vec![] };
    let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &FieldOptions::default()).unwrap();
    let patch = &field.patches[0];
    assert_eq!(patch.feature_lines.len(), 1);
    for p in &patch.feature_lines[0] {
        let world = patch.placement.to_world(p);
        assert!((world.x.hypot(world.y) - 10.0).abs() < 0.02, "{world}");
    }
    let angle = field.report.field_d_f_deg.unwrap();
    assert!(angle < 3.0, "{angle}");
    // Lines and triangles are in the world's directions.
    let vertices: Vec<_> = patch.vertices().collect();
    for ([u, v], t) in patch.directions().zip(&patch.field.mesh.triangles) {
        let [a, b, c] = t.map(|k| vertices[k as usize]);
        let normal = (b - a).cross(&(c - a)).normalize();
        assert!(normal.dot(&u).abs() < 1e-9 && normal.dot(&v).abs() < 1e-9);
    }
    assert!(field.report.backend.is_none());
}

#[test]
fn a_cancel_stops_one_call_and_the_next_runs() {
    let mut session = session();
    let sketch = sheet(1.0, [0.0, 0.0]);
    session.control().cancel();
    let options = SurfaceOptions::default();
    assert_eq!(sketch_to_surface(&mut session, &sketch, &options).unwrap_err(), Error::Cancelled);
    let surface = surface(&mut session, &sketch);
    for stop_at in ["field", "planarize"] {
        let control = session.control();
        session.set_progress(Some(Box::new(move |stage, _| {
            if stage == stop_at {
                control.cancel();
            }
        })));
        let result = sketch_to_cdf(&mut session, Some(&sketch), &surface, &FieldOptions::default())
            .and_then(|field| extract_pq_mesh(&mut session, &field, &MeshOptions::default()));
        assert_eq!(result.map(|_| ()).unwrap_err(), Error::Cancelled, "{stop_at}");
    }
    session.set_progress(None);
}

#[test]
fn the_same_input_gives_the_same_bytes_whatever_the_threads() {
    let sketch = sheet(1.0, [0.0, 0.0]);
    let run = |threads| {
        let options = SessionOptions { backend: BackendChoice::Embedded, threads, ..SessionOptions::default() };
        let mut session = Session::new(&options).unwrap();
        let surface = surface(&mut session, &sketch);
        let field = sketch_to_cdf(&mut session, Some(&sketch), &surface, &FieldOptions::default()).unwrap();
        let mesh = extract_pq_mesh(&mut session, &field, &MeshOptions::default()).unwrap();
        (surface.to_json(), mesh.obj())
    };
    let first = run(1);
    assert!(run(1) == first);
    assert!(run(2) == first);
}

#[test]
fn curves_in_space_lead_the_field_of_a_hosts_surface() {
    // On a cylinder every direction but the ruling has the ruling as its conjugate.
    let mut session = session();
    let helix = |radius: f64, slope: f64, shift: f64| -> Vec<Point3<f64>> {
        (0..=20)
            .map(|i| 0.1 + f64::from(i) * 0.067)
            .map(|a| Point3::new(a.cos(), a.sin(), slope * (a - 0.1) + shift) * radius)
            .collect()
    };
    for (radius, hard) in [(1.0, true), (1.0, false), (2e4, false)] {
        let surface = SurfaceResult::from_nurbs(vec![cylinder(radius)]).unwrap();
        let height = cylinder(1.0).control_points().iter().map(|p| p.z).fold(0.0, f64::max);
        let curves: Vec<FeatureCurve> = [0.05, 0.3, 0.55]
            .map(|shift| FeatureCurve { points: helix(radius, 0.25 * height, shift * height), hard })
            .to_vec();
        let field = surface_to_cdf(&mut session, &surface, &curves, &FieldOptions::default()).unwrap();
        assert!(field.measures().feature_angle_deg < 1.0, "{}", field.measures().feature_angle_deg);
        assert!(field.measures().conjugacy_max < 1e-2);
        let patch = &field.patches[0];
        assert!(patch.field.singularities.is_empty() && !patch.feature_lines.is_empty());
        for (t, [u, v]) in patch.directions().enumerate() {
            let ruling = u.z.abs().max(v.z.abs()).min(1.0).acos().to_degrees();
            assert!(ruling < 1.0, "{ruling} degrees on triangle {t}");
        }
    }
    let surface = SurfaceResult::from_nurbs(vec![cylinder(1.0)]).unwrap();
    for points in
        [vec![Point3::origin()], vec![Point3::new(9.0, 0.0, 0.0); 2], vec![Point3::new(f64::NAN, 0.0, 0.0); 2]]
    {
        let curves = [FeatureCurve { points, hard: false }];
        let result = surface_to_cdf(&mut session, &surface, &curves, &FieldOptions::default());
        assert!(matches!(result, Err(Error::Argument { name: "curves", .. })));
    }
}

#[test]
fn panels_meet_irregularly_where_the_host_wants_them_to() {
    let mut session = session();
    let net = |size: f64| -> Vec<Point3<f64>> {
        (0..49)
            .map(|k| [f64::from(k / 7), f64::from(k % 7)].map(|x| x / 3.0 - 1.0))
            .map(|[x, y]| Point3::new(x + 2.0, y - 1.0, 0.6 - 0.3 * x * x - 0.4 * y * y) * size)
            .collect()
    };
    for size in [1.0, 3e3] {
        let surface = SurfaceResult::from_nurbs(vec![NurbsSurface::uniform(3, [7, 7], net(size)).unwrap()]).unwrap();
        let patch = &surface.patches[0].surface;
        let place = |s: f64, t: f64| patch.point(s, t);
        for fixed in [vec![], vec![([0.3, 0.35], 1), ([0.7, 0.6], -1)], vec![([0.5, 0.45], 1)]] {
            let in_space = |&([s, t], index): &([f64; 2], i32)| FixedSingularity {
                place: SurfacePlace::Point(place(s, t)),
                index,
            };
            let by_parameters = |&(uv, index): &([f64; 2], i32)| FixedSingularity {
                place: SurfacePlace::Parameters { patch: 0, uv },
                index,
            };
            let both = [fixed.iter().map(in_space).collect::<Vec<_>>(), fixed.iter().map(by_parameters).collect()];
            for singularities in both {
                let options = FieldOptions { singularities: Some(singularities), ..FieldOptions::default() };
                let field = surface_to_cdf(&mut session, &surface, &[], &options).unwrap();
                let found = &field.patches[0].field.singularities;
                assert_eq!(found.len(), fixed.len());
                assert_eq!(found.iter().map(|s| s.index).sum::<i32>(), fixed.iter().map(|f| f.1).sum::<i32>());
                let mesh = extract_pq_mesh(&mut session, &field, &MeshOptions::default()).unwrap();
                let edge = mesh.measures().edge_length_mean;
                let irregular: Vec<Point3<f64>> =
                    mesh.patches[0].irregular.iter().map(|&v| mesh.patches[0].mesh.vertices[v as usize]).collect();
                assert_eq!(irregular.len(), fixed.len());
                for ([s, t], _) in &fixed {
                    let off = irregular.iter().map(|p| (p - place(*s, *t)).norm()).fold(f64::INFINITY, f64::min);
                    assert!(off < edge, "{off} of {edge}");
                }
            }
        }
        let refused = |place: SurfacePlace, index: i32, aligned_sides: [bool; 4]| {
            let singularities = Some(vec![FixedSingularity { place, index }]);
            let options = FieldOptions { singularities, aligned_sides, ..FieldOptions::default() };
            surface_to_cdf(&mut Session::new(&SessionOptions::default()).unwrap(), &surface, &[], &options).unwrap_err()
        };
        let inside = SurfacePlace::Parameters { patch: 0, uv: [0.5, 0.5] };
        assert_eq!(refused(inside, 1, [true; 4]), Error::SingularityCount { sum: 1, room: 0 });
        for (place, index) in [
            (SurfacePlace::Parameters { patch: 1, uv: [0.5, 0.5] }, 1),
            (SurfacePlace::Parameters { patch: 0, uv: [0.5, 1.5] }, 1),
            (SurfacePlace::Parameters { patch: 0, uv: [0.5, f64::NAN] }, 1),
            (SurfacePlace::Point(Point3::new(9.0, 9.0, 9.0) * size), 1),
            (SurfacePlace::Point(Point3::new(f64::NAN, 0.0, 0.0)), 1),
            (inside, 4),
        ] {
            assert!(matches!(refused(place, index, [false; 4]), Error::Argument { name: "singularities", .. }));
        }
    }
}

#[test]
fn options_out_of_range_name_themselves() {
    let mut session = session();
    let surface = SurfaceResult::from_nurbs(vec![cylinder(1.0)]).unwrap();
    for options in [
        FieldOptions { resolution: 3, ..FieldOptions::default() },
        FieldOptions { crossing_floor_deg: 95.0, ..FieldOptions::default() },
        FieldOptions { faces: 0, ..FieldOptions::default() },
        FieldOptions { edge_length: f64::NAN, ..FieldOptions::default() },
    ] {
        let result = sketch_to_cdf(&mut session, None, &surface, &options);
        let Err(Error::Argument { name, .. }) = result else { panic!("{options:?}") };
        assert!(["resolution", "crossing_floor_deg", "faces", "edge_length"].contains(&name));
    }
    let field = sketch_to_cdf(&mut session, None, &surface, &FieldOptions::default()).unwrap();
    for options in [
        MeshOptions { faces: 0, ..MeshOptions::default() },
        MeshOptions { faces: 2_000_000, ..MeshOptions::default() },
        MeshOptions { edge_length: -1.0, ..MeshOptions::default() },
        MeshOptions { edge_length: 1e-9, ..MeshOptions::default() },
        MeshOptions { planarity: f64::NAN, ..MeshOptions::default() },
    ] {
        let result = extract_pq_mesh(&mut session, &field, &options);
        assert!(matches!(result, Err(Error::Argument { name: "faces" | "edge_length" | "planarity", .. })));
    }
}

fn live_session() -> Session {
    let options =
        SessionOptions { backend: BackendChoice::Embedded, threads: 1, live: true, ..SessionOptions::default() };
    Session::new(&options).unwrap()
}

/// Largest distance from samples of one surface to the other.
fn deviation(surface: &NurbsSurface, other: &NurbsSurface) -> f64 {
    let projector = SurfaceProjector::new(other);
    let places = (0..400).map(|k| [f64::from(k / 20) / 19.0, f64::from(k % 20) / 19.0]);
    let distances = places.map(|[s, t]| {
        let [u, v] = surface.at_fraction(s, t);
        projector.closest(&surface.point(u, v)).distance
    });
    distances.fold(0.0, f64::max)
}

#[test]
fn a_live_session_begins_with_the_last_surface_where_little_changed() {
    let (mut live, mut cold) = (live_session(), session());
    let first = surface(&mut live, &sheet(1.0, [0.0, 0.0]));
    assert!(!first.patches[0].diagnostics.warm_start);
    let mut moved = sheet(1.0, [0.0, 0.0]);
    for p in moved.strokes[0].points[1..4].iter_mut() {
        p[1] -= 3.0;
    }
    let warm = surface(&mut live, &moved);
    let diagnostics = warm.patches[0].diagnostics;
    assert!(diagnostics.warm_start && diagnostics.reprojection_mean_px < 0.5 && diagnostics.fold_overs == 0);
    // The sheet is some 250 wide; what the strokes leave open may differ a little.
    let anew = surface(&mut cold, &moved);
    assert!(!anew.patches[0].diagnostics.warm_start);
    let distance = deviation(&warm.patches[0].surface, &anew.patches[0].surface);
    assert!(distance < 8.0, "{distance}");
    // A stroke that moved far, another view, and another number of outlines begin anew.
    for p in moved.strokes[0].points[1..4].iter_mut() {
        p[1] -= 30.0;
    }
    assert!(!surface(&mut live, &moved).patches[0].diagnostics.warm_start);
    moved.view = View::from_angles(30.0, 50.0, true).unwrap();
    assert!(!surface(&mut live, &moved).patches[0].diagnostics.warm_start);
    moved.strokes.extend(sheet(0.5, [300.0, 0.0]).strokes);
    let two = surface(&mut live, &moved);
    assert!(two.patches.len() == 2 && two.patches.iter().all(|patch| !patch.diagnostics.warm_start));
}

#[test]
fn a_newer_sketch_stops_older_work_on_a_live_session() {
    let session = Arc::new(SharedSession::new(live_session()));
    let (started, has_started) = mpsc::channel();
    let (go_on, may_go_on) = mpsc::channel::<()>();
    session.get().unwrap().set_progress(Some(Box::new(move |_, _| {
        // The first step of the first call waits until the newer call has come.
        if started.send(()).is_ok() {
            let _ = may_go_on.recv();
        }
    })));
    let draw = |session: &Arc<SharedSession>| {
        let session = Arc::clone(session);
        std::thread::spawn(move || {
            let mut session = session.get_for_newest()?;
            sketch_to_surface(&mut session, &sheet(1.0, [0.0, 0.0]), &SurfaceOptions::default())
        })
    };
    let older = draw(&session);
    has_started.recv().unwrap();
    assert!(matches!(session.get().map(|_| ()), Err(Error::Argument { name: "S2pqSession", .. })));
    let newer = draw(&session);
    // The newer call does nothing before it waits but say that it has come.
    std::thread::sleep(std::time::Duration::from_millis(500));
    drop(go_on);
    drop(has_started);
    assert_eq!(older.join().unwrap().unwrap_err(), Error::Cancelled);
    assert!(newer.join().unwrap().is_ok());
    // Nothing of the cancel is left.
    assert!(
        sketch_to_surface(&mut session.get().unwrap(), &sheet(1.0, [0.0, 0.0]), &SurfaceOptions::default()).is_ok()
    );
}
