//! Sketches: strokes and depth samples on a canvas, the view, and what they mean.

mod arrange;
mod fit;
mod polyline;
mod raster;
mod stroke;
mod view;
mod visibility;

pub use raster::{
    CANVAS_HALF_WIDTH, CANVAS_SIZE, MAP_SIZE, Raster, STROKE_CHANNELS, SampleBase, canvas_pixels, coverage,
    horizontal_slope, map_coordinates, map_position, paper_raster, rasterize, sample_base,
};
pub use stroke::{DepthSample, Layer, Sketch, Stroke, StrokeKind};
pub use view::{CANONICAL_LENGTH, CanonicalFrame, View};
pub use visibility::{
    BorderPoint, CANONICAL_PER_PX, CanonicalSample, CleanStroke, Orientation, PatchSketch, Region, Understanding,
    understand,
};
