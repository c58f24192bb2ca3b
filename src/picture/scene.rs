//! The picture of a whole run: sketch, surface and panels.

use super::canvas::{Frame, Picture, bounds};
use super::lettering::{draw_text, text_width};
use super::mesh::{MeshPart, draw_legend, mesh_picture};
use super::sketch::{camera_points, draw_sketch};
use super::surface::surface_picture;
use crate::mesh::PanelMesh;
use crate::sketch::{Sketch, View};
use crate::surface::SurfaceMesh;

/// One patch of a result.
#[derive(Clone, Debug, Default)]
pub struct ScenePatch {
    /// Tessellated surface, world frame.
    pub surface: Option<SurfaceMesh>,
    /// Panels, world frame.
    pub mesh: Option<PanelMesh>,
    /// Planarity of each panel, see [`crate::mesh::planarity`].
    pub planarity: Vec<f64>,
    /// Vertices of `mesh` to mark as irregular.
    pub irregular: Vec<u32>,
}

/// What [`scene_picture`] shows.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The sketch, if there is one.
    pub sketch: Option<Sketch>,
    /// Direction in which the sketch was drawn.
    pub view: View,
    /// Results.
    pub patches: Vec<ScenePatch>,
    /// Lines of text, such as counts and errors; letters outside of printable ASCII are left blank.
    pub notes: Vec<String>,
}

const TEXT: [u8; 3] = [52, 58, 68];
const CAPTION_HEIGHT: usize = 44;
const MARGIN: f64 = 26.0;
/// Height of the notes' capitals and distance of their lines, pixels.
const NOTE_SIZE: f64 = 12.0;
const NOTE_STEP: f64 = 27.0;

/// A view from the other side: turned by 130 degrees about the vertical, a little lower.
pub fn other_view(view: &View) -> View {
    let toward = view.toward();
    let azimuth = if toward.x.hypot(toward.y) > 1e-9 { toward.y.atan2(toward.x).to_degrees() } else { 45.0 };
    View::from_angles(azimuth + 130.0, 30.0, view.y_down).unwrap_or(*view)
}

/// Three columns, `width` pixels in all: the sketch, the surface, the panels. The upper row is seen as the sketch is, all at the same
/// scale and place, so that outlines can be compared with strokes; the lower row shows surface and panels from the other side, with
/// the notes and the colour scale of planarity beside them. The height follows from what is shown.
pub fn scene_picture(scene: &Scene, width: usize) -> Picture {
    let column = (width / 3).max(60);
    let surfaces: Vec<&SurfaceMesh> = scene.patches.iter().filter_map(|p| p.surface.as_ref()).collect();
    let parts: Vec<MeshPart> = scene
        .patches
        .iter()
        .filter_map(|p| Some(MeshPart { mesh: p.mesh.as_ref()?, planarity: &p.planarity, irregular: &p.irregular }))
        .collect();
    let back = other_view(&scene.view);
    let geometry = |view: &View| -> Vec<[f64; 2]> {
        let on_surfaces = surfaces.iter().flat_map(|s| &s.points).map(|p| p.position);
        let on_meshes = parts.iter().flat_map(|p| &p.mesh.vertices).copied();
        on_surfaces.chain(on_meshes).map(|p| view.world_to_camera(&p)).map(|p| [p.x, p.y]).collect()
    };
    let mut upper_points = geometry(&scene.view);
    upper_points.extend(scene.sketch.iter().flat_map(camera_points));
    let upper = fitted(&upper_points, column);
    let lower = fitted(&geometry(&back), column);

    let row = upper.size[1] + CAPTION_HEIGHT;
    let lines: usize = scene.notes.iter().map(|note| wrapped(note, column as f64 - 2.5 * MARGIN).len()).sum();
    let notes_height = 110 + (lines as f64 * NOTE_STEP) as usize;
    let mut whole = Picture::new(3 * column, row + lower.size[1].max(notes_height) + CAPTION_HEIGHT);
    if let Some(sketch) = &scene.sketch {
        whole.paste(&draw_sketch(sketch, &upper), 0, CAPTION_HEIGHT);
    }
    for (place, view, frame) in [(CAPTION_HEIGHT, &scene.view, &upper), (row + CAPTION_HEIGHT, &back, &lower)] {
        whole.paste(&surface_picture(&surfaces, view, frame), column, place);
        whole.paste(&mesh_picture(&parts, view, frame), 2 * column, place);
    }
    whole.draw(|brush| {
        let mut caption = |text: &str, place: usize, y: usize| {
            let x = (place * column) as f64 + 0.5 * (column as f64 - text_width(text, 15.0));
            draw_text(brush, text, [x, (y + 32) as f64], 15.0, TEXT);
        };
        if scene.sketch.is_some() {
            caption("Sketch", 0, 0);
        }
        caption("Surface", 1, 0);
        caption("Panels", 2, 0);
        caption("from the other side", 1, row);
        caption("from the other side", 2, row);
        let mut y = (row + CAPTION_HEIGHT) as f64 + 24.0;
        for note in scene.notes.iter().flat_map(|note| wrapped(note, column as f64 - 2.5 * MARGIN)) {
            draw_text(brush, &note, [2.0 * MARGIN, y], NOTE_SIZE, TEXT);
            y += NOTE_STEP;
        }
        draw_text(brush, "Planarity of panels", [2.0 * MARGIN, y + 18.0], NOTE_SIZE, TEXT);
        draw_legend(brush, [2.0 * MARGIN, y + 32.0], (column as f64 - 4.0 * MARGIN).clamp(120.0, 320.0));
    });
    whole
}

/// The note broken at blanks into lines of at most `room` pixels, as far as its words allow.
fn wrapped(note: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = vec![];
    for word in note.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(&format!("{line} {word}"), NOTE_SIZE) <= room => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_string()),
        }
    }
    lines
}

/// A frame of the given width around the points, its height between half and one and a quarter of the width.
fn fitted(points: &[[f64; 2]], width: usize) -> Frame {
    let aspect = match bounds(points.iter().copied()) {
        Some((low, high)) if high[0] > low[0] => (high[1] - low[1]) / (high[0] - low[0]),
        _ => 0.75,
    };
    let inner = width as f64 - 2.0 * MARGIN;
    let height = (inner * aspect + 2.0 * MARGIN).clamp(0.5 * width as f64, 1.1 * width as f64);
    Frame::fitting(points.iter().copied(), [width, height as usize], MARGIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::planarity;
    use crate::sketch::{DepthSample, Layer, Stroke, StrokeKind};
    use crate::surface::NurbsSurface;
    use nalgebra::Point3;

    /// An arch that leans over, swept along a sagging line: translational, so its grid is planar.
    fn arch(s: f64, t: f64) -> Point3<f64> {
        let angle = (1.2 * s - 0.12) * std::f64::consts::PI;
        Point3::new(
            -3.0 * angle.cos() * (1.0 + 0.15 * s),
            7.0 * t - 3.5,
            3.2 * angle.sin() + 1.2 * (2.0 * t - 1.0).powi(2),
        )
    }

    fn example() -> Scene {
        let view = View::default();
        let control = (0..900).map(|k| arch((k / 30) as f64 / 29.0, (k % 30) as f64 / 29.0)).collect();
        let surface = NurbsSurface::uniform(3, [30, 30], control).unwrap();
        let tessellation = SurfaceMesh::new(&surface, [80, 60]).unwrap();
        let (nu, nv) = (22u32, 16u32);
        let vertices: Vec<_> = (0..=nu)
            .flat_map(|i| (0..=nv).map(move |j| (i as f64 / nu as f64, j as f64 / nv as f64)))
            .map(|(s, t)| {
                let bump = 10f64.powf(-7.0 + 6.0 * t);
                arch(s, t) + nalgebra::Vector3::new(0.0, 0.0, bump * (s * 191.0).sin())
            })
            .collect();
        let faces: Vec<[u32; 4]> = (0..nu * nv)
            .map(|k| {
                let a = k / nv * (nv + 1) + k % nv;
                [a, a + nv + 1, a + nv + 2, a + 1]
            })
            .collect();
        let mesh = PanelMesh::new(vertices, &faces).unwrap();
        let line = |kind, at: &dyn Fn(f64) -> Point3<f64>, from: f64, to: f64| Stroke {
            kind,
            points: (0..=40)
                .map(|k| view.world_to_camera(&at(from + (to - from) * k as f64 / 40.0)))
                .map(|p| view.camera_to_canvas([p.x, p.y]))
                .collect(),
        };
        use StrokeKind::{Feature, OccludedBoundary, VisibleBoundary};
        let sketch = Sketch {
            name: "arch".into(),
            canvas_size: [256.0; 2],
            view,
            strokes: vec![
                line(VisibleBoundary, &|t| arch(1.0, t), 0.0, 1.0),
                line(VisibleBoundary, &|t| arch(t, 1.0), 0.0, 1.0),
                line(OccludedBoundary, &|t| arch(t, 0.0), 0.0, 1.0),
                line(OccludedBoundary, &|t| arch(0.0, t), 0.0, 1.0),
                line(Feature, &|t| arch(0.7, t), 0.1, 0.8),
                line(Feature, &|t| arch(t, 0.6), 0.4, 0.9),
            ],
            depth_samples: vec![DepthSample { position: [0.0, 0.0], layer: Layer::Visible, depth: 1.0 }],
        };
        let planarity = planarity(&mesh);
        let patch = ScenePatch { surface: Some(tessellation), mesh: Some(mesh), planarity, irregular: vec![200, 90] };
        let notes = ["352 panels, mean edge 0.42", "planarity max 8.1e-2, mean 4.2e-4", "sketch to mesh in 61 ms"];
        Scene { sketch: Some(sketch), view, patches: vec![patch], notes: notes.map(String::from).to_vec() }
    }

    #[test]
    fn a_scene_shows_sketch_surface_and_panels() {
        let scene = example();
        let picture = scene_picture(&scene, 1200);
        assert_eq!(picture, scene_picture(&scene, 1200));
        if let Some(folder) = std::env::var_os("SKETCH2PQ_PICTURES") {
            let folder = std::path::Path::new(&folder);
            std::fs::write(folder.join("scene.png"), scene_picture(&scene, 1800).to_png().unwrap()).unwrap();
        }
        // Each column shows its colours: strokes, front side, panels.
        let count = |column: usize, wanted: &dyn Fn([u8; 3]) -> bool| {
            (0..picture.height / 2)
                .flat_map(|row| (400 * column..400 * (column + 1)).map(move |c| (c, row)))
                .filter(|&(c, row)| wanted(picture.color(c, row)))
                .count()
        };
        assert!(count(0, &|c| c[1] > 180 && c[0] < 30) > 200);
        assert!(count(1, &|c| c[2] > c[0].saturating_add(30)) > 5_000);
        assert!(count(2, &|c| c[1] > c[2].saturating_add(20)) > 5_000);
        assert!(picture.to_png().unwrap().len() > 10_000);
    }

    #[test]
    fn strange_scenes_give_a_picture() {
        let scene = example();
        let empty = Scene { sketch: None, patches: vec![], ..scene.clone() };
        assert_eq!(scene_picture(&empty, 300).width, 300);
        let mut broken = scene;
        if let Some(mesh) = &mut broken.patches[0].mesh {
            mesh.vertices[3].x = f64::NAN;
            mesh.vertices[4].y = 1e300;
        }
        broken.patches[0].planarity.truncate(3);
        scene_picture(&broken, 200);
    }
}
