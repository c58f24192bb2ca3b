//! Sketches: strokes and depth samples on a canvas, the view, and what they mean.

mod arrange;
mod fit;
mod json;
mod polyline;
mod raster;
mod sample_base;
mod stroke;
mod svg;
mod view;
mod visibility;

pub use json::{parse_json, write_json};
pub use raster::{
    CANVAS_HALF_WIDTH, CANVAS_SIZE, MAP_SIZE, Raster, STROKE_CHANNELS, canvas_pixels, coverage, horizontal_slope,
    map_coordinates, map_position, paper_raster, rasterize,
};
pub use sample_base::{SampleBase, offset_covariance, sample_base, spread_out};
pub use stroke::{DepthSample, Layer, Sketch, Stroke, StrokeKind};
pub use svg::{parse_svg, write_svg};
pub use view::{CANONICAL_LENGTH, CanonicalFrame, View};
pub use visibility::{
    BorderPoint, CANONICAL_PER_PX, CanonicalSample, CleanStroke, Orientation, PatchSketch, Region, Understanding,
    understand,
};

use crate::error::Error;
use std::path::Path;

/// Reads a sketch file: `.json` ([`parse_json`]) or `.svg` ([`parse_svg`]). A sketch without a name gets the file's.
///
/// # Errors
/// [`Error::File`] if it cannot be read or has another extension; else those of the parsers.
pub fn read_sketch(path: &Path) -> Result<Sketch, Error> {
    let file_error = |reason: String| Error::File { path: path.display().to_string(), reason };
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let parse = match extension.as_str() {
        "json" => parse_json,
        "svg" => parse_svg,
        _ => return Err(file_error("a sketch is a .json or .svg file".into())),
    };
    let text = std::fs::read_to_string(path).map_err(|e| file_error(e.to_string()))?;
    let mut sketch = parse(text.trim_start_matches('\u{feff}'))?;
    if sketch.name.is_empty() {
        sketch.name = path.file_stem().and_then(|s| s.to_str()).unwrap_or("").to_string();
    }
    Ok(sketch)
}
