//! What the host draws: strokes and depth samples on its canvas.

use super::view::View;

/// What a stroke stands for (paper, Sec. 3.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum StrokeKind {
    /// Visible part of the surface's border; green.
    VisibleBoundary,
    /// Occluded part of the surface's border; blue.
    OccludedBoundary,
    /// Silhouette of the surface that is not its border: the surface folds over there; red.
    Contour,
    /// Direction that the panels' edges follow; black.
    Feature,
}

impl StrokeKind {
    /// All kinds, in the order of their numbers in the ABI.
    pub const ALL: [Self; 4] = [Self::VisibleBoundary, Self::OccludedBoundary, Self::Contour, Self::Feature];

    /// Name in sketch files.
    pub fn name(self) -> &'static str {
        match self {
            Self::VisibleBoundary => "visible_boundary",
            Self::OccludedBoundary => "occluded_boundary",
            Self::Contour => "contour",
            Self::Feature => "feature",
        }
    }

    /// Colour in pictures and in the networks' raster, RGB (the paper's).
    pub fn color(self) -> [u8; 3] {
        match self {
            Self::VisibleBoundary => [0, 255, 0],
            Self::OccludedBoundary => [0, 0, 255],
            Self::Contour => [255, 0, 0],
            Self::Feature => [0, 0, 0],
        }
    }

    /// Whether strokes of this kind bound regions.
    pub fn is_structural(self) -> bool {
        self != Self::Feature
    }
}

/// One stroke: a polyline as drawn, canvas frame and unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroke {
    /// What it stands for.
    pub kind: StrokeKind,
    /// Points in drawing order, canvas frame.
    pub points: Vec<[f64; 2]>,
}

/// The part of the surface in front, or the part hidden behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Layer {
    /// First surface point along a view ray.
    Visible,
    /// Second surface point along a view ray.
    Occluded,
}

impl Layer {
    /// Both, in the order of their numbers in the ABI.
    pub const ALL: [Self; 2] = [Self::Visible, Self::Occluded];

    /// Name in sketch files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Visible => "visible",
            Self::Occluded => "occluded",
        }
    }
}

/// A known depth at a canvas point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSample {
    /// Canvas point.
    pub position: [f64; 2],
    /// Which of the two surface layers at that point.
    pub layer: Layer,
    /// Distance along the view direction, growing away from the viewer, canvas unit.
    pub depth: f64,
}

/// A whole sketch, as the host gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sketch {
    /// Name for files and messages; may be empty.
    pub name: String,
    /// Width and height of the canvas, for pictures and files; the result does not depend on it.
    pub canvas_size: [f64; 2],
    /// Direction of view and of the canvas' y axis.
    pub view: View,
    /// Strokes in any order and direction.
    pub strokes: Vec<Stroke>,
    /// Depth samples, may be empty.
    pub depth_samples: Vec<DepthSample>,
}
