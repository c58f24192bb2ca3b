//! What a surface has to obey: strokes, depth samples, and the maps of both layers.

use super::border::LayerMaps;
use super::corners::BorderLoop;
use super::layer_map::LayerMap;
use super::nurbs::NurbsSurface;
use crate::error::Error;
use crate::sketch::{Layer, PatchSketch, StrokeKind, spread_out};
use nalgebra::{DMatrix, DVector};

/// A known depth on one layer, canonical frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerSample {
    /// Canvas-plane point (x, y).
    pub position: [f64; 2],
    /// Whether it belongs to the occluded layer.
    pub occluded: bool,
    /// Depth -z.
    pub depth: f64,
}

/// What a surface has to obey.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceTargets {
    /// Border strokes as one loop, counter-clockwise seen from the front.
    pub border: BorderLoop,
    /// Indices of the patch's corners in the loop; sides as in [`super::coons_net`].
    pub corners: [usize; 4],
    /// Contour strokes, polylines (x, y).
    pub contours: Vec<Vec<[f64; 2]>>,
    /// Depth samples.
    pub samples: Vec<LayerSample>,
    /// Depth and normals of both layers.
    pub maps: LayerMaps,
    /// Another guess of the whole surface, where there is one: on the knots of the start, its border by the same parameters. It
    /// counts beside the maps.
    pub guess: Option<NurbsSurface>,
}

impl SurfaceTargets {
    /// The strokes and samples of `patch`, with `maps`; canonical frame.
    ///
    /// - `corners`: places near the outline, camera frame, in any order; `None`: they are found.
    ///
    /// # Errors
    /// [`Error::Degenerate`] for an outline that spans no patch, and as [`BorderLoop::corners_near`].
    pub fn new(patch: &PatchSketch, corners: Option<[[f64; 2]; 4]>, maps: LayerMaps) -> Result<Self, Error> {
        let border = BorderLoop::drawn(patch)?;
        let corners = match corners {
            Some(places) => border.corners_near(places.map(|p| patch.frame.from_camera(p)))?,
            None => border.choose_corners()?,
        };
        let contours = patch.strokes.iter().filter(|s| s.kind == StrokeKind::Contour);
        let contours = contours.map(|s| s.points.clone()).collect();
        let samples = patch.depth_samples.iter().map(|s| LayerSample {
            position: s.position,
            occluded: s.layer == Layer::Occluded,
            depth: s.depth,
        });
        Ok(Self { border, corners, contours, samples: samples.collect(), maps, guess: None })
    }
}

/// Range of the correction that makes the maps meet the depth samples, canonical units (the networks' prior has the same).
const CORRECTION_RANGE: f64 = 2.0;

impl LayerMaps {
    /// The maps with their depth corrected to meet `samples`, smoothly: the differences at the samples are interpolated by
    /// exp(-r^2 / (2 * 2^2)) with a noise of 0.01, as a Gaussian process.
    ///
    /// Samples outside their layer's mask count where the extrapolated map still reaches, else not.
    pub fn meeting(&self, samples: &[LayerSample]) -> Self {
        let correct = |map: &LayerMap, occluded: bool| {
            if samples.iter().all(|sample| sample.occluded != occluded) {
                return map.clone();
            }
            let sides = [map.side(true), map.side(false)];
            let known: Vec<([f64; 2], f64)> = samples
                .iter()
                .filter(|sample| sample.occluded == occluded)
                .filter_map(|sample| {
                    let near = sides.iter().filter_map(|side| {
                        let value = side.sample(sample.position)?;
                        Some((side.outside(sample.position)?.1, sample.depth - value.depth))
                    });
                    let best = near.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.abs().total_cmp(&b.1.abs())))?;
                    Some((sample.position, best.1))
                })
                .collect();
            let mut result = map.clone();
            let correction = Correction::new(&known);
            for k in (0..map.depth.len()).filter(|&k| map.valid[k]) {
                result.depth[k] += correction.at(map.center(k));
            }
            result
        };
        Self { visible: correct(&self.visible, false), occluded: correct(&self.occluded, true) }
    }
}

/// Differences at a few places of the canvas, interpolated smoothly: by exp(-r^2 / (2 * 2^2)) with a noise of 0.01, as a Gaussian process. Of
/// more than 200 places 200 that lie far apart count.
struct Correction {
    places: Vec<[f64; 2]>,
    weights: Vec<f64>,
}

impl Correction {
    /// - `known`: places (x, y) and what is to be added there.
    fn new(known: &[([f64; 2], f64)]) -> Self {
        let known = spread_out(known);
        let places: Vec<[f64; 2]> = known.iter().map(|k| k.0).collect();
        let n = known.len();
        let noise = |i: usize, j: usize| if i == j { 1e-4 } else { 0.0 };
        let matrix = DMatrix::from_fn(n, n, |i, j| kernel(places[i], places[j]) + noise(i, j));
        let right = DVector::from_iterator(n, known.iter().map(|k| k.1));
        // Positive definite but for numbers that are none; those correct nothing.
        let weights = matrix.cholesky().map_or_else(|| vec![0.0; n], |factor| factor.solve(&right).data.into());
        Self { places, weights }
    }

    /// What is to be added at `p`.
    fn at(&self, p: [f64; 2]) -> f64 {
        self.places.iter().zip(&self.weights).map(|(q, weight)| weight * kernel(p, *q)).sum()
    }
}

fn kernel(p: [f64; 2], q: [f64; 2]) -> f64 {
    let squared = (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
    (-squared / (2.0 * CORRECTION_RANGE * CORRECTION_RANGE)).exp()
}
