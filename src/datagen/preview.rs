//! Contact sheets: what the generator drew, for human eyes.

use super::strokes::to_canvas;
use super::{MAP, NET, Sample};
use crate::error::Error;
use std::path::Path;
use tiny_skia::{Color, Paint, PathBuilder, Pixmap, Stroke, Transform};

const TILE: u32 = 256;
const COLUMNS: u32 = 4;

/// Writes one row of tiles for each sample, two samples side by side: the sketch; the visible layer's normals; the occluded
/// layer's; the conjugate directions over the depth of the visible layer.
///
/// # Errors
/// [`Error::File`] if the picture cannot be written.
pub(super) fn write_sheet(path: &Path, samples: &[Sample]) -> Result<(), Error> {
    let rows = (samples.len() as u32).div_ceil(2).max(1);
    let fail = |reason: String| Error::File { path: path.display().to_string(), reason };
    let mut sheet =
        Pixmap::new(2 * COLUMNS * TILE, rows * TILE).ok_or_else(|| fail("the sheet is too large".into()))?;
    sheet.fill(Color::WHITE);
    for (k, sample) in samples.iter().enumerate() {
        let (x, y) = ((k as u32 % 2) * COLUMNS * TILE, (k as u32 / 2) * TILE);
        for layer in 0..2 {
            normals(&mut sheet, sample, layer, x + (1 + layer as u32) * TILE, y);
        }
        net(&mut sheet, sample, (x + TILE) as f32, y as f32);
        depth(&mut sheet, sample, x + 3 * TILE, y);
        directions(&mut sheet, sample, (x + 3 * TILE) as f32, y as f32);
        strokes(&mut sheet, sample, x as f32, y as f32);
    }
    sheet.save_png(path).map_err(|e| fail(e.to_string()))
}

fn line(sheet: &mut Pixmap, points: &[[f32; 2]], color: [u8; 3], width: f32) {
    let mut builder = PathBuilder::new();
    for (k, p) in points.iter().enumerate() {
        if k == 0 {
            builder.move_to(p[0], p[1]);
        } else {
            builder.line_to(p[0], p[1]);
        }
    }
    let Some(path) = builder.finish() else { return };
    let mut paint = Paint::default();
    paint.set_color_rgba8(color[0], color[1], color[2], 255);
    paint.anti_alias = true;
    sheet.stroke_path(&path, &paint, &Stroke { width, ..Stroke::default() }, Transform::identity(), None);
}

fn strokes(sheet: &mut Pixmap, sample: &Sample, x: f32, y: f32) {
    for stroke in &sample.sketch.strokes {
        let points: Vec<[f32; 2]> = stroke.points.iter().map(|p| [x + p[0] as f32, y + p[1] as f32]).collect();
        line(sheet, &points, stroke.kind.color(), 2.0);
        for end in [points[0], points[points.len() - 1]] {
            line(sheet, &[[end[0] - 2.0, end[1]], [end[0] + 2.0, end[1]]], [90, 90, 90], 4.0);
        }
    }
}

/// Every third parameter line of the control net, and its first corner.
fn net(sheet: &mut Pixmap, sample: &Sample, x: f32, y: f32) {
    let at = |i: usize, j: usize| {
        let p = sample.surface.control_points()[i * NET + j];
        let [px, py] = to_canvas([p.x, p.y]);
        [x + px as f32, y + py as f32]
    };
    for k in [0, 3, 6, 9, 12, 14, 15, 17, 20, 23, 26, 29] {
        let lines: [Vec<[f32; 2]>; 2] = [(0..NET).map(|m| at(k, m)).collect(), (0..NET).map(|m| at(m, k)).collect()];
        lines.iter().for_each(|points| line(sheet, points, [255, 255, 255], 0.6));
    }
    let corner = at(0, 0);
    line(sheet, &[[corner[0] - 4.0, corner[1]], [corner[0] + 4.0, corner[1]]], [230, 0, 0], 8.0);
}

/// Fills one map pixel.
fn block(sheet: &mut Pixmap, x: u32, y: u32, pixel: usize, color: [u8; 3]) {
    let size = TILE / MAP as u32;
    let (row, column) = ((pixel / MAP) as u32, (pixel % MAP) as u32);
    let width = sheet.width();
    for r in 0..size {
        for c in 0..size {
            let index = ((y + row * size + r) * width + x + column * size + c) as usize * 4;
            sheet.data_mut()[index..index + 3].copy_from_slice(&color);
        }
    }
}

fn normals(sheet: &mut Pixmap, sample: &Sample, layer: usize, x: u32, y: u32) {
    const PIXELS: usize = MAP * MAP;
    let light = nalgebra::Vector3::new(-0.4, 0.6, 0.7).normalize();
    for pixel in 0..PIXELS {
        let valid = sample.maps.valid[layer * PIXELS + pixel];
        if valid == 0 {
            continue;
        }
        let n = nalgebra::Vector3::from_fn(|a, _| f64::from(sample.maps.normal[(layer * 3 + a) * PIXELS + pixel]));
        let n = if valid == 1 { n } else { -n };
        let shade = 0.25 + 0.75 * n.dot(&light).max(0.0);
        let base = if valid == 1 { [90.0, 190.0, 255.0] } else { [255.0, 170.0, 90.0] };
        block(sheet, x, y, pixel, base.map(|b: f64| (b * shade) as u8));
    }
}

fn depth(sheet: &mut Pixmap, sample: &Sample, x: u32, y: u32) {
    for pixel in 0..MAP * MAP {
        if sample.maps.valid[pixel] > 0 {
            let h = f64::from(sample.maps.depth[pixel]);
            let g = (150.0 - 30.0 * h).clamp(60.0, 240.0);
            // Bands make slopes visible.
            let band = if (h * 4.0).floor() as i64 % 2 == 0 { 12.0 } else { 0.0 };
            block(sheet, x, y, pixel, [(g - band) as u8, (g - band) as u8, (g - band) as u8]);
        }
    }
}

fn directions(sheet: &mut Pixmap, sample: &Sample, x: f32, y: f32) {
    const PIXELS: usize = MAP * MAP;
    let size = TILE as f32 / MAP as f32;
    for row in (1..MAP).step_by(3) {
        for column in (1..MAP).step_by(3) {
            let pixel = row * MAP + column;
            let center = [x + (column as f32 + 0.5) * size, y + (row as f32 + 0.5) * size];
            for (k, color) in [(0, [200, 30, 30]), (2, [30, 60, 200])] {
                let d = [0, 1].map(|a| sample.maps.directions[(k + a) * PIXELS + pixel]);
                let ends = [-5.0, 5.0].map(|s| [center[0] + s * d[0], center[1] - s * d[1]]);
                if d != [0.0; 2] {
                    line(sheet, &ends, color, 1.0);
                }
            }
        }
    }
}
