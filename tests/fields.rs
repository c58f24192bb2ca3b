//! Fields on surfaces like those that sketches show, and along the whole border.

use nalgebra::Point3;
use sketch2pq::datagen::{Options, sample};
use sketch2pq::field::{TriangleFrames, second_forms};
use sketch2pq::mesh::BorderMode;
use sketch2pq::pipeline::{
    FieldOptions, MeshOptions, Placement, Session, SessionOptions, SurfaceResult, extract_pq_mesh, sketch_to_cdf,
    surface_to_cdf,
};
use sketch2pq::surface::{NurbsSurface, SurfaceProjector};

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
        let field = &field.patches[0].field;
        // Lines are soft constraints here: they give way, and the floor has nothing to win.
        assert!(field.diagnostics.floor_triangles.is_empty());
        let frames = TriangleFrames::new(&field.mesh, &field.edges).unwrap();
        let forms = second_forms(&field.mesh, &frames);
        let bending = |t: usize| {
            let square = forms[t].norm().powi(2);
            frames.areas[t] * square / (1.0 + frames.areas[t] * square)
        };
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
