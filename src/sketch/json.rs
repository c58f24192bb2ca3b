//! Sketches as JSON (the format of the examples, of the command line and of the data generator).

use super::stroke::{DepthSample, Layer, Sketch, Stroke, StrokeKind};
use super::view::View;
use crate::error::Error;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

#[derive(Deserialize)]
struct SketchText {
    #[serde(default)]
    name: String,
    #[serde(default)]
    canvas: CanvasText,
    #[serde(default)]
    view: ViewText,
    strokes: Vec<StrokeText>,
    #[serde(default)]
    depth_samples: Vec<SampleText>,
}

#[derive(Serialize, Deserialize)]
struct CanvasText {
    width: f64,
    height: f64,
    #[serde(default)]
    y: YDirection,
}

impl Default for CanvasText {
    fn default() -> Self {
        Self { width: 256.0, height: 256.0, y: YDirection::Down }
    }
}

#[derive(Serialize, Deserialize, Default, PartialEq)]
#[serde(rename_all = "snake_case")]
enum YDirection {
    #[default]
    Down,
    Up,
}

#[derive(Serialize, Deserialize, Default)]
struct ViewText {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    elevation_deg: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    azimuth_deg: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    right: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    up: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    toward: Option<[f64; 3]>,
}

#[derive(Serialize, Deserialize)]
struct StrokeText {
    kind: KindText,
    points: Vec<[f64; 2]>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum KindText {
    VisibleBoundary,
    OccludedBoundary,
    Contour,
    Feature,
}

#[derive(Serialize, Deserialize)]
struct SampleText {
    x: f64,
    y: f64,
    layer: LayerText,
    depth: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum LayerText {
    Visible,
    Occluded,
}

fn format(reason: impl Into<String>) -> Error {
    Error::Format { what: "sketch JSON", reason: reason.into() }
}

/// Reads a sketch from JSON text.
///
/// `canvas` may be missing (256 x 256, y down), `view` too (azimuth and elevation 45 degrees); a view is either
/// `{"elevation_deg", "azimuth_deg"}` or three axes `{"right", "up", "toward"}` in world coordinates. Unknown fields are
/// ignored.
///
/// # Errors
/// [`Error::Format`] names line and column; [`Error::Argument`] for a view outside its range.
pub fn parse_json(text: &str) -> Result<Sketch, Error> {
    let text: SketchText = serde_json::from_str(text).map_err(|e| format(e.to_string()))?;
    if !(text.canvas.width > 0.0 && text.canvas.height > 0.0) {
        return Err(format(format!("the canvas is {} x {}", text.canvas.width, text.canvas.height)));
    }
    let y_down = text.canvas.y == YDirection::Down;
    let v = &text.view;
    let view = match (v.right, v.up, v.toward) {
        (Some(right), Some(up), Some(toward)) => {
            View::from_axes(Vector3::from(right), Vector3::from(up), Vector3::from(toward), y_down)?
        }
        (None, None, None) => {
            View::from_angles(v.azimuth_deg.unwrap_or(45.0), v.elevation_deg.unwrap_or(45.0), y_down)?
        }
        _ => return Err(format("view has some of right, up and toward, but not all three")),
    };
    let strokes = text.strokes.into_iter().map(|s| Stroke {
        kind: match s.kind {
            KindText::VisibleBoundary => StrokeKind::VisibleBoundary,
            KindText::OccludedBoundary => StrokeKind::OccludedBoundary,
            KindText::Contour => StrokeKind::Contour,
            KindText::Feature => StrokeKind::Feature,
        },
        points: s.points,
    });
    let depth_samples = text.depth_samples.into_iter().map(|s| DepthSample {
        position: [s.x, s.y],
        layer: match s.layer {
            LayerText::Visible => Layer::Visible,
            LayerText::Occluded => Layer::Occluded,
        },
        depth: s.depth,
    });
    Ok(Sketch {
        name: text.name,
        canvas_size: [text.canvas.width, text.canvas.height],
        view,
        strokes: strokes.collect(),
        depth_samples: depth_samples.collect(),
    })
}

/// The view as angles where it has its horizon level, else as axes.
fn view_text(view: &View) -> ViewText {
    let (right, toward) = (view.right(), view.toward());
    let degrees = |rad: f64| (rad.to_degrees() * 1e9).round() / 1e9;
    let (azimuth, elevation) = (degrees((-right.x).atan2(right.y)), degrees(toward.z.clamp(-1.0, 1.0).asin()));
    if let Ok(same) = View::from_angles(azimuth, elevation, view.y_down)
        && (same.right() - right).norm() < 1e-9
        && (same.toward() - toward).norm() < 1e-9
    {
        return ViewText { elevation_deg: Some(elevation), azimuth_deg: Some(azimuth), ..ViewText::default() };
    }
    ViewText {
        right: Some(right.into()),
        up: Some(view.up().into()),
        toward: Some(toward.into()),
        ..ViewText::default()
    }
}

/// Writes a sketch as JSON text, one stroke a line; [`parse_json`] reads it back.
///
/// # Errors
/// [`Error::NotFinite`] for a coordinate that JSON cannot hold.
pub fn write_json(sketch: &Sketch) -> Result<String, Error> {
    fn text(value: &impl Serialize) -> String {
        serde_json::to_string(value).expect("plain data with string keys")
    }
    let mut out = String::new();
    let [width, height] = sketch.canvas_size;
    let y = if sketch.view.y_down { YDirection::Down } else { YDirection::Up };
    let name = text(&sketch.name);
    let (canvas, view) = (text(&CanvasText { width, height, y }), text(&view_text(&sketch.view)));
    // Writing to a string cannot fail.
    let _ = write!(out, "{{\n\"name\": {name},\n\"canvas\": {canvas},\n\"view\": {view},\n\"strokes\": [");
    for (index, stroke) in sketch.strokes.iter().enumerate() {
        if stroke.points.iter().flatten().any(|x| !x.is_finite()) {
            return Err(Error::NotFinite { what: "stroke", index });
        }
        let comma = if index > 0 { "," } else { "" };
        let _ = write!(out, "{comma}\n{{\"kind\": \"{}\", \"points\": {}}}", stroke.kind.name(), text(&stroke.points));
    }
    out.push_str("\n],\n\"depth_samples\": [");
    for (index, sample) in sketch.depth_samples.iter().enumerate() {
        let [x, y] = sample.position;
        if !(x.is_finite() && y.is_finite() && sample.depth.is_finite()) {
            return Err(Error::NotFinite { what: "depth sample", index });
        }
        let layer = match sample.layer {
            Layer::Visible => LayerText::Visible,
            Layer::Occluded => LayerText::Occluded,
        };
        let comma = if index > 0 { "," } else { "" };
        let _ = write!(out, "{comma}\n{}", text(&SampleText { x, y, layer, depth: sample.depth }));
    }
    out.push_str(if sketch.depth_samples.is_empty() { "]\n}\n" } else { "\n]\n}\n" });
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = r#"{"name": "a", "canvas": {"width": 300, "height": 200, "y": "up"}, "future": 1,
        "strokes": [{"kind": "contour", "points": [[0, 1], [2.5, -3e2]]}],
        "depth_samples": [{"x": 1, "y": 2, "layer": "occluded", "depth": 3}]}"#;

    #[test]
    fn what_is_written_is_read_back() {
        let mut sketch = parse_json(SMALL).unwrap();
        assert_eq!(sketch.strokes[0].points[1], [2.5, -300.0]);
        assert!(!sketch.view.y_down);
        let again = parse_json(&write_json(&sketch).unwrap()).unwrap();
        assert_eq!(again.strokes, sketch.strokes);
        assert_eq!(again.depth_samples, sketch.depth_samples);
        assert!((again.view.toward() - sketch.view.toward()).norm() < 1e-9);
        let s = 0.5f64.sqrt();
        let axes = [Vector3::new(s, s, 0.0), Vector3::new(0.0, 0.0, 1.0), Vector3::new(s, -s, 0.0)];
        sketch.view = View::from_axes(axes[2], axes[0], axes[1], true).unwrap();
        let again = parse_json(&write_json(&sketch).unwrap()).unwrap();
        assert!((again.view.right() - axes[2]).norm() < 1e-9);
    }

    #[test]
    fn errors_name_the_place() {
        let reason = |text: &str| match parse_json(text).unwrap_err() {
            Error::Format { reason, .. } => reason,
            other => panic!("{other}"),
        };
        assert!(reason("").contains("line 1"));
        assert!(reason(&SMALL.replace("contour", "countour")).contains("unknown variant `countour`"));
        assert!(reason(&SMALL.replace("2.5", "NaN")).contains("line 2"));
        assert!(reason(&SMALL.replace("2.5", "1e999")).contains("out of range"));
        assert!(reason(&SMALL.replace("[0, 1]", "[0]")).contains("line 2"));
        assert!(reason(&SMALL.replace("\"depth\"", "\"height\"")).contains("missing field `depth`"));
        for end in 0..SMALL.len() {
            parse_json(&SMALL[..end]).unwrap_err();
        }
    }
}
