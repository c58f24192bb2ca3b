//! Contact sheets of measured cases: what was drawn, what came out, what was meant.

use super::canvas::{Frame, Picture};
use super::lettering::draw_text;
use super::mesh::{MeshPart, mesh_picture};
use super::scene::other_view;
use super::sketch::{camera_points, overlay_sketch};
use super::surface::surface_picture;
use crate::mesh::PanelMesh;
use crate::sketch::{Sketch, View};
use crate::surface::SurfaceMesh;

/// One row of a sheet.
#[derive(Clone, Debug)]
pub struct CaseRow {
    /// What to write above the row.
    pub label: String,
    /// The sketch; its view is that of the first two pictures.
    pub sketch: Sketch,
    /// Recovered surface, world frame.
    pub surface: SurfaceMesh,
    /// Panels, world frame.
    pub mesh: PanelMesh,
    /// Planarity of each panel.
    pub planarity: Vec<f64>,
    /// Vertices of `mesh` to mark as irregular.
    pub irregular: Vec<u32>,
    /// The surface that the sketch was made from, world frame.
    pub truth: SurfaceMesh,
}

const TEXT: [u8; 3] = [52, 58, 68];
const LABEL_HEIGHT: usize = 26;
const COLUMNS: usize = 4;

/// One row for each case, `width` pixels wide: the strokes over the recovered surface; the panels in the same view; the recovered
/// surface from the other side; the true surface from there, at the same scale.
pub fn case_sheet(rows: &[CaseRow], width: usize) -> Picture {
    let tile = (width / COLUMNS).max(40);
    let height = tile * 4 / 5;
    let mut sheet = Picture::new(COLUMNS * tile, rows.len().max(1) * (height + LABEL_HEIGHT));
    for (k, row) in rows.iter().enumerate() {
        let top = k * (height + LABEL_HEIGHT);
        let (front, back) = (row.sketch.view, other_view(&row.sketch.view));
        let outline = |surface: &SurfaceMesh, view: &View| -> Vec<[f64; 2]> {
            surface.points.iter().map(|p| view.world_to_camera(&p.position)).map(|p| [p.x, p.y]).collect()
        };
        let fit = |points: Vec<[f64; 2]>| Frame::fitting(points, [tile, height], 0.05 * tile as f64);
        let seen = fit([camera_points(&row.sketch), outline(&row.surface, &front)].concat());
        // Depth is free up to a constant without depth samples, so each surface lies in the middle of its own tile, at one scale.
        let mut behind = [fit(outline(&row.surface, &back)), fit(outline(&row.truth, &back))];
        let scale = behind[0].scale.min(behind[1].scale);
        behind.iter_mut().for_each(|frame| frame.scale = scale);
        let mut first = surface_picture(&[&row.surface], &front, &seen);
        overlay_sketch(&mut first, &row.sketch, &seen);
        let part = MeshPart { mesh: &row.mesh, planarity: &row.planarity, irregular: &row.irregular };
        let pictures = [
            first,
            mesh_picture(&[part], &front, &seen),
            surface_picture(&[&row.surface], &back, &behind[0]),
            surface_picture(&[&row.truth], &back, &behind[1]),
        ];
        for (column, picture) in pictures.iter().enumerate() {
            sheet.paste(picture, column * tile, top + LABEL_HEIGHT);
        }
        sheet.draw(|brush| draw_text(brush, &row.label, [10.0, (top + 19) as f64], 11.0, TEXT));
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::NurbsSurface;
    use nalgebra::Point3;

    #[test]
    fn a_row_holds_four_pictures() {
        let point = |k: usize| Point3::new((k / 5) as f64, (k % 5) as f64, 0.3 * ((k / 5) as f64 - 2.0).powi(2));
        let surface = NurbsSurface::uniform(3, [5, 5], (0..25).map(point).collect()).unwrap();
        let mesh = SurfaceMesh::new(&surface, [10; 2]).unwrap();
        let row = CaseRow {
            label: "one".into(),
            sketch: Sketch {
                name: String::new(),
                canvas_size: [256.0; 2],
                view: View::default(),
                strokes: vec![],
                depth_samples: vec![],
            },
            surface: mesh.clone(),
            mesh: PanelMesh { vertices: vec![], starts: vec![0], indices: vec![] },
            planarity: vec![],
            irregular: vec![],
            truth: mesh,
        };
        let sheet = case_sheet(&[row.clone(), row], 400);
        assert_eq!((sheet.width, sheet.height), (400, 2 * (80 + LABEL_HEIGHT)));
        let colored = |column: usize| {
            (0..80 * 100).filter(|k| sheet.color(column * 100 + k % 100, LABEL_HEIGHT + k / 100) != [255; 3]).count()
        };
        assert!(colored(0) > 500 && colored(1) == 0 && colored(2) > 500);
        assert_eq!(colored(2), colored(3));
    }
}
