//! Sketches: strokes and depth samples on a canvas, the view, and what they mean.

mod stroke;
mod view;

pub use stroke::{DepthSample, Layer, Sketch, Stroke, StrokeKind};
pub use view::{CANONICAL_LENGTH, CanonicalFrame, View};
