//! What a run says of itself: measures and times, carried from result to result.

use super::session::Times;
use serde::Serialize;

/// Measures of one run, under the keys of `report.json`; what a stage has not measured yet, or does not apply, is
/// `None` and left out.
///
/// Over several patches: means are weighted by what they are means of, worst values are the worst, counts are sums. The
/// words of each key are defined where it is measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Version of the library.
    pub version: &'static str,
    /// What ran the networks, with its version and path; `None` where no network ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
    /// Number of patches.
    pub patches: usize,
    /// Places in the sketch's list of strokes that played no part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unused_strokes: Option<Vec<usize>>,
    /// Mean distance between strokes and the projected surface's border and silhouette, pixels of the 256 canvas.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reprojection_mean_px: Option<f64>,
    /// The same: the largest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reprojection_max_px: Option<f64>,
    /// Largest distance along the view between a depth sample and the surface, canvas unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_residual: Option<f64>,
    /// Largest share of a patch whose side facing the viewer is not drawn there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub misfacing: Option<f64>,
    /// Places where the surface folds over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fold_overs: Option<usize>,
    /// Mean conjugacy residual |II(u, v)| / (|II| |u| |v|).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conjugacy_mean: Option<f64>,
    /// Smallest crossing angle of the two families.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crossing_min_deg: Option<f64>,
    /// Smoothness energy of the field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub e_smooth: Option<f64>,
    /// Mean angle between feature lines and the nearer family of the field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field_d_f_deg: Option<f64>,
    /// Number of singular vertices of the field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub singularities: Option<usize>,
    /// Mean angle between feature lines and the nearer family of the mesh's edges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d_f_deg: Option<f64>,
    /// Planarity of the worst face.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p_max: Option<f64>,
    /// Mean planarity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p_mean: Option<f64>,
    /// Largest distance of a vertex from the surface, canvas unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deviation_max: Option<f64>,
    /// The same over the mean edge length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deviation_max_edges: Option<f64>,
    /// Largest distance of a vertex from the surface over what was allowed; above 1 planarity and closeness contradict each other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deviation_over_limit: Option<f64>,
    /// Largest distance of a border vertex from the surface's border over the patch's width.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border_deviation_widths: Option<f64>,
    /// Share of the surface's border that the mesh's border follows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border_covered: Option<f64>,
    /// Inner vertices where another number than four faces meets.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub irregular_vertices: Option<usize>,
    /// Mean edge length, canvas unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_length_mean: Option<f64>,
    /// Faces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub faces: Option<usize>,
    /// Faces with four corners.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quads: Option<usize>,
    /// Faces that had to be left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dropped: Option<usize>,
    /// Cells at the border that were split into triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split: Option<usize>,
    /// Panels inside that were split into triangles as a last resort.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split_inside: Option<usize>,
    /// Wall-clock milliseconds of each stage.
    pub time_ms: Times,
}

impl Report {
    /// An empty report.
    pub fn new() -> Self {
        Self { version: env!("CARGO_PKG_VERSION"), ..Self::default() }
    }

    /// The report as indented JSON.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).expect("a tree of numbers and texts")
    }
}
