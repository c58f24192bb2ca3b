//! A sketch in its colours.

use super::canvas::{Frame, Picture};
use crate::sketch::{Sketch, StrokeKind};

/// Colour of depth samples.
const SAMPLE_COLOR: [u8; 3] = [240, 140, 20];

/// Draws the strokes in their colours on white, feature lines thinner, depth samples as orange dots; the whole sketch fits
/// with a margin.
pub fn sketch_picture(sketch: &Sketch, width: usize, height: usize) -> Picture {
    let margin = 0.06 * width.min(height) as f64;
    draw_sketch(sketch, &Frame::fitting(camera_points(sketch), [width, height], margin))
}

/// All points of the strokes, camera x, y.
pub(crate) fn camera_points(sketch: &Sketch) -> Vec<[f64; 2]> {
    sketch.strokes.iter().flat_map(|s| &s.points).map(|p| sketch.view.canvas_to_camera(*p)).collect()
}

/// Width of a stroke in pixels; the structural lines are bolder.
pub(crate) fn stroke_width(kind: StrokeKind, frame: &Frame) -> f64 {
    let unit = frame.size[0].min(frame.size[1]) as f64 / 100.0;
    if kind.is_structural() { (0.95 * unit).max(1.5) } else { (0.65 * unit).max(1.0) }
}

/// Colours a little calmer than the networks' pure ones.
pub(crate) fn stroke_color(kind: StrokeKind) -> [u8; 3] {
    match kind {
        StrokeKind::VisibleBoundary => [0, 190, 40],
        StrokeKind::OccludedBoundary => [40, 70, 255],
        StrokeKind::Contour => [235, 30, 30],
        StrokeKind::Feature => [25, 25, 30],
    }
}

pub(crate) fn draw_sketch(sketch: &Sketch, frame: &Frame) -> Picture {
    let mut picture = Picture::new(frame.size[0], frame.size[1]);
    overlay_sketch(&mut picture, sketch, frame);
    picture
}

/// Draws the sketch over what the picture shows.
pub fn overlay_sketch(picture: &mut Picture, sketch: &Sketch, frame: &Frame) {
    let place = |p: [f64; 2]| {
        let [x, y] = sketch.view.canvas_to_camera(p);
        frame.place(x, y)
    };
    picture.draw(|brush| {
        // Hidden lines below, features on top.
        for kind in
            [StrokeKind::OccludedBoundary, StrokeKind::VisibleBoundary, StrokeKind::Contour, StrokeKind::Feature]
        {
            for stroke in sketch.strokes.iter().filter(|s| s.kind == kind) {
                let points: Vec<[f64; 2]> =
                    stroke.points.iter().map(|p| place(*p)).filter(|p| p.iter().all(|x| x.is_finite())).collect();
                brush.polyline(&points, stroke_width(kind, frame) as f32, stroke_color(kind));
            }
        }
        let radius = 1.1 * stroke_width(StrokeKind::VisibleBoundary, frame);
        for sample in &sketch.depth_samples {
            let center = place(sample.position);
            if center.iter().all(|x| x.is_finite()) {
                brush.dot(center, radius + 1.5, [255; 3]);
                brush.dot(center, radius, SAMPLE_COLOR);
            }
        }
    });
}
