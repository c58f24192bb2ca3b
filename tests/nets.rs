//! Surfaces whose conjugate nets are known in closed form come out as those nets when a few curves say so: translational surfaces
//! as their two families of translated curves, surfaces of revolution as meridians and parallels.

use nalgebra::{Point3, Vector3};
use sketch2pq::infer::BackendChoice;
use sketch2pq::mesh::PanelMesh;
use sketch2pq::pipeline::{
    FeatureCurve, FieldOptions, FieldResult, MeshOptions, MeshResult, Session, SessionOptions, SurfaceResult,
    extract_pq_mesh, surface_to_cdf,
};
use sketch2pq::surface::{KnotVector, NurbsSurface};

fn panels(surface: NurbsSurface, curves: &[Vec<Point3<f64>>]) -> (FieldResult, MeshResult) {
    let options = SessionOptions { backend: BackendChoice::Embedded, threads: 1, ..SessionOptions::default() };
    let mut session = Session::new(&options).unwrap();
    let curves: Vec<FeatureCurve> =
        curves.iter().map(|points| FeatureCurve { points: points.clone(), hard: false }).collect();
    let surface = SurfaceResult::from_nurbs(vec![surface]).unwrap();
    let field = surface_to_cdf(&mut session, &surface, &curves, &FieldOptions::default()).unwrap();
    let mesh = extract_pq_mesh(&mut session, &field, &MeshOptions::default()).unwrap();
    (field, mesh)
}

fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b).abs()).to_degrees()
}

/// Angles between the sides of whole quads away from the border and the nearer direction of the net there.
fn side_angles(mesh: &PanelMesh, border: &[bool], net: impl Fn(&Point3<f64>) -> [Vector3<f64>; 2]) -> Vec<f64> {
    let inside = |face: &&[u32]| face.len() == 4 && face.iter().all(|&v| !border[v as usize]);
    let mut angles = vec![];
    for face in mesh.faces().filter(inside) {
        for k in 0..4 {
            let (a, b) = (mesh.vertices[face[k] as usize], mesh.vertices[face[(k + 1) % 4] as usize]);
            let side = b - a;
            angles.push(net(&nalgebra::center(&a, &b)).iter().map(|d| angle(&side, d)).fold(90.0, f64::min));
        }
    }
    angles
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Of all triangles of the field: the larger angle of its pair to the net's, better of the two orders.
fn field_angles(field: &FieldResult, net: impl Fn(&Point3<f64>) -> [Vector3<f64>; 2]) -> Vec<f64> {
    let patch = &field.patches[0];
    let points: Vec<Point3<f64>> = patch.vertices().collect();
    let triangles = &patch.field.mesh.triangles;
    let pairs = patch.directions().zip(triangles).map(|([u, v], t)| {
        let middle = t.iter().map(|&k| points[k as usize].coords).sum::<Vector3<f64>>() / 3.0;
        let [a, b] = net(&Point3::from(middle));
        let straight = angle(&u, &a).max(angle(&v, &b));
        straight.min(angle(&u, &b).max(angle(&v, &a)))
    });
    pairs.collect()
}

/// Asserts that field and panels are those of a conjugate net, given by its two directions at a point: within a degree, regular and planar.
fn assert_is_net(field: &FieldResult, mesh: &MeshResult, net: impl Fn(&Point3<f64>) -> [Vector3<f64>; 2] + Copy) {
    let off = field_angles(field, net);
    assert!(mean(&off) < 1.0, "field: {} degrees on the mean", mean(&off));
    let patch = &mesh.patches[0];
    let sides = side_angles(&patch.mesh, &patch.on_border, net);
    assert!(sides.len() > 1000 && mean(&sides) < 1.0, "panels: {} degrees on the mean", mean(&sides));
    assert!(patch.irregular.is_empty() && mesh.measures().planarity_max < 1e-9);
}

#[test]
fn a_translational_surface_comes_out_as_its_translated_curves() {
    // z = 0.15 x^2 + 0.1 y^2 over a square that is turned by 25 degrees, so that no side and no parameter line is in the net.
    let (s, c) = 25f64.to_radians().sin_cos();
    let height = |x: f64, y: f64| 0.15 * x * x + 0.1 * y * y;
    // Blossoms of p and p^2 on [-2, 2].
    let (linear, square) = ([-2.0, 0.0, 2.0], [4.0, -4.0, 4.0]);
    let net = (0..9).map(|k| {
        let (p, q, pp, qq) = (linear[k / 3], linear[k % 3], square[k / 3], square[k % 3]);
        let (xx, yy) = (c * c * pp - 2.0 * c * s * p * q + s * s * qq, s * s * pp + 2.0 * c * s * p * q + c * c * qq);
        Point3::new(c * p - s * q, s * p + c * q, 0.15 * xx + 0.1 * yy)
    });
    let knots = [KnotVector::uniform(2, 3), KnotVector::uniform(2, 3)];
    let surface = NurbsSurface::new(knots, net.collect(), None).unwrap();
    let curve = |point: &dyn Fn(f64) -> [f64; 2]| -> Vec<Point3<f64>> {
        (0..=20).map(|i| point(0.1 * i as f64 - 1.0)).map(|[x, y]| Point3::new(x, y, height(x, y))).collect()
    };
    let curves = [curve(&|t| [t, 0.3]), curve(&|t| [-0.4, t]), curve(&|t| [t, -0.8])];
    let (field, mesh) = panels(surface, &curves);
    let truth = |p: &Point3<f64>| [Vector3::new(1.0, 0.0, 0.3 * p.x), Vector3::new(0.0, 1.0, 0.2 * p.y)];
    assert_is_net(&field, &mesh, truth);
    assert!(mesh.report.d_f_deg.unwrap() < 1.0, "{:?}", mesh.report.d_f_deg);
}

#[test]
fn a_surface_of_revolution_comes_out_as_meridians_and_parallels() {
    // A quarter turn of a parabola that bulges: radius 2 + t (1 - t), height 3 t.
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let arc = [(1.0, 0.0, 1.0), (1.0, 1.0, h), (0.0, 1.0, 1.0)];
    let profile = [(2.0, 0.0), (2.5, 1.5), (2.0, 3.0)];
    let net = arc.iter().flat_map(|&(x, y, _)| profile.map(|(r, z)| Point3::new(x * r, y * r, z))).collect();
    let weights = arc.iter().flat_map(|&(_, _, w)| [w; 3]).collect();
    let knots = [KnotVector::uniform(2, 3), KnotVector::uniform(2, 3)];
    let surface = NurbsSurface::new(knots, net, Some(weights)).unwrap();
    let point = |turn: f64, t: f64| {
        let r = 2.0 + t * (1.0 - t);
        Point3::new(r * turn.cos(), r * turn.sin(), 3.0 * t)
    };
    let meridian = |turn: f64| -> Vec<_> { (0..=10).map(|i| point(turn, 0.1 + 0.08 * i as f64)).collect() };
    let parallel = |t: f64| -> Vec<_> { (0..=10).map(|i| point(0.2 + 0.1 * i as f64, t)).collect() };
    let curves = [meridian(0.3), meridian(1.2), parallel(0.2), parallel(0.8)];
    let (field, mesh) = panels(surface, &curves);
    let truth = |p: &Point3<f64>| {
        let r = p.x.hypot(p.y);
        let t = p.z / 3.0;
        let slope = 1.0 - 2.0 * t;
        [Vector3::new(-p.y, p.x, 0.0), Vector3::new(slope * p.x / r, slope * p.y / r, 3.0)]
    };
    assert_is_net(&field, &mesh, truth);
}
