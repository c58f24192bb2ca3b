//! Vector pictures of sketches and meshes.

use super::canvas::Frame;
use super::mesh::{MeshPart, planarity_color};
use super::sketch::{camera_points, stroke_color, stroke_width};
use crate::sketch::{Sketch, View};
use std::fmt::Write;

fn head(frame: &Frame) -> String {
    let [width, height] = frame.size;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n"
    )
}

fn points_text(points: impl Iterator<Item = [f64; 2]>) -> String {
    points.map(|[x, y]| format!("{x:.2},{y:.2}")).collect::<Vec<_>>().join(" ")
}

fn color_text([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// The sketch as SVG, one polyline for each stroke, in the colours of [`super::sketch_picture`].
pub fn sketch_svg(sketch: &Sketch, width: usize, height: usize) -> String {
    let frame = Frame::fitting(camera_points(sketch), [width, height], 0.06 * width.min(height) as f64);
    let mut text = head(&frame);
    for stroke in &sketch.strokes {
        let points = stroke.points.iter().map(|p| sketch.view.canvas_to_camera(*p)).map(|[x, y]| frame.place(x, y));
        let _ = writeln!(
            text,
            "<polyline class=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{:.2}\" stroke-linecap=\"round\" \
             stroke-linejoin=\"round\" points=\"{}\"/>",
            stroke.kind.name(),
            color_text(stroke_color(stroke.kind)),
            stroke_width(stroke.kind, &frame),
            points_text(points)
        );
    }
    text.push_str("</svg>\n");
    text
}

/// Panel meshes as SVG: one polygon for each panel in the colour of its planarity, the farthest first.
pub fn mesh_svg(parts: &[MeshPart], view: &View, frame: &Frame) -> String {
    let mut panels = vec![];
    for (p, part) in parts.iter().enumerate() {
        for (f, face) in part.mesh.faces().enumerate() {
            let corners: Vec<_> = face.iter().map(|&v| view.world_to_camera(&part.mesh.vertices[v as usize])).collect();
            let depth = corners.iter().map(|c| c.z).sum::<f64>() / corners.len() as f64;
            panels.push((depth, p, f, corners));
        }
    }
    panels.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut text = head(frame);
    text.push_str("<g stroke=\"#262e38\" stroke-width=\"1\" stroke-linejoin=\"round\">\n");
    for (_, p, f, corners) in panels {
        let color = planarity_color(parts[p].planarity.get(f).copied().unwrap_or(0.0));
        let points = points_text(corners.iter().map(|c| frame.place(c.x, c.y)));
        let _ = writeln!(text, "<polygon fill=\"{}\" points=\"{points}\"/>", color_text(color));
    }
    text.push_str("</g>\n</svg>\n");
    text
}
