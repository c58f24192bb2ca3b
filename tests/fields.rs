//! Fields on surfaces like those that sketches show.

use sketch2pq::datagen::{Options, sample};
use sketch2pq::field::{TriangleFrames, second_forms};
use sketch2pq::pipeline::{FieldOptions, Placement, Session, SessionOptions, SurfaceResult, sketch_to_cdf};

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
