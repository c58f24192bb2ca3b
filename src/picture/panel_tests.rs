//! From surfaces to planar panels, looked at: set SKETCH2PQ_PICTURES to a folder to get the pictures.

use super::{Scene, ScenePatch, scene_picture};
use crate::control::Control;
use crate::field::{FieldOptions, MapOptions, conjugate_field};
use crate::mesh::{
    ExtractOptions, PanelMesh, PanelTarget, PlanarizeInput, PlanarizeOptions, VertexKind, check, edge_lengths,
    mean_edge_length, panels, planarity, planarize,
};
use crate::sketch::View;
use crate::surface::{NurbsSurface, SurfaceMesh, SurfaceProjector};
use nalgebra::Point3;

fn graph(f: impl Fn(f64, f64) -> f64) -> NurbsSurface {
    let n = 14;
    let points = (0..n * n)
        .map(|k| [(k / n) as f64, (k % n) as f64].map(|t| 8.0 * t / (n - 1) as f64 - 4.0))
        .map(|[x, y]| Point3::new(x, y, f(x, y)))
        .collect();
    NurbsSurface::uniform(3, [n, n], points).unwrap()
}

/// From a surface to planar panels; claims what every surface should give, and shows it.
fn claim(name: &str, surface: &NurbsSurface, faces: usize) {
    let control = Control::default();
    let tessellation = SurfaceMesh::new(surface, [30; 2]).unwrap();
    let field = conjugate_field(tessellation.clone(), None, &[], &FieldOptions::default(), &control).unwrap();
    let target = PanelTarget::Faces(faces);
    let extracted =
        panels(&field, surface, target, &MapOptions::default(), &ExtractOptions::default(), &control).unwrap();
    let mesh = &extracted.mesh;
    let border: Vec<u32> = (0..mesh.vertices.len() as u32)
        .filter(|&v| extracted.origins[v as usize].kind != VertexKind::Interior)
        .collect();
    let polylines = extracted.strips();
    let parameters: Vec<[f64; 2]> = extracted.origins.iter().map(|o| o.parameter).collect();
    let projector = SurfaceProjector::new(surface);
    let input = PlanarizeInput {
        reference: Some(&projector),
        border: &border,
        polylines: &polylines,
        parameters: Some(&parameters),
        ..PlanarizeInput::new(mesh)
    };
    let result = planarize(&input, &PlanarizeOptions::default(), &control).unwrap();

    let before = planarity(mesh).into_iter().fold(0.0, f64::max);
    let notes = format!(
        "{name}: {} panels, {} irregular vertices, planarity {before:.1e} before and {:.1e} after {} rounds, \
         deviation {:.1e} of {:.1e}, mean edge {:.2}",
        mesh.face_count(),
        extracted.irregular.len(),
        result.planarity_max(),
        result.rounds,
        result.deviation_max(),
        result.deviation_limit,
        mean_edge_length(mesh)
    );
    assert!(before > 1e-3 && result.planarity_max() < 1e-8 && result.is_close, "{notes}");
    assert!(check(&result.mesh).is_manifold());
    // Corners stay at corners, the border within 1e-3 of the width.
    for (v, origin) in extracted.origins.iter().enumerate() {
        let moved = (result.mesh.vertices[v] - mesh.vertices[v]).norm();
        match origin.kind {
            VertexKind::Interior => {}
            VertexKind::Border { .. } => assert!(result.deviation[v] < 8e-3, "{notes}"),
            VertexKind::Corner { .. } => assert!(moved < 8e-3, "{notes}"),
        }
    }
    let shortest = |m: &PanelMesh| edge_lengths(m).into_iter().fold(f64::INFINITY, f64::min);
    assert!(shortest(&result.mesh) > 0.5 * shortest(mesh), "{notes}");

    if let Some(folder) = std::env::var_os("SKETCH2PQ_PICTURES") {
        let folder = std::path::Path::new(&folder);
        for (which, mesh) in [("before", mesh), ("after", &result.mesh)] {
            let patch = ScenePatch {
                surface: Some(tessellation.clone()),
                mesh: Some(mesh.clone()),
                planarity: planarity(mesh),
                irregular: extracted.irregular.clone(),
            };
            let scene = Scene { sketch: None, view: View::default(), patches: vec![patch], notes: vec![notes.clone()] };
            let png = scene_picture(&scene, 1800).to_png().unwrap();
            std::fs::write(folder.join(format!("{name}_{which}.png")), png).unwrap();
        }
    }
}

#[test]
fn waves_become_planar_panels() {
    claim(
        "waves",
        &graph(|x, y| 0.6 * (0.7 * x + 0.3 * y).sin() + 0.5 * (0.6 * y - 0.2 * x).cos() + 0.03 * x * y),
        160,
    );
}

#[test]
fn a_twisted_roof_becomes_planar_panels() {
    claim("twist", &graph(|x, y| 0.12 * x * y + 0.3 * (0.5 * x).sin()), 160);
}
