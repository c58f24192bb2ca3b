//! What VD-Net and OD-Net predict: depth and normals of the visible and the occluded layer.

use super::maps::{MAP_PIXELS, channel, pixel_center, sample};
use super::samples;
use crate::error::Error;
use crate::sketch::Layer;

/// Least share of a pixel that a layer covers where it counts as seen; the pixel's centre decides in training data.
const SEEN_COVERAGE: f32 = 0.5;

/// Divisor of shorter normals, as in training: a vector that short tells no direction.
const SHORTEST_NORMAL: f32 = 1e-3;

/// Depth offset and normals of one layer, one value per map pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerPrediction {
    /// h = depth - y slope - reference, canonical units; 0 where the layer is not.
    pub depth_offset: Vec<f32>,
    /// Outward unit normal, which points to the viewer where the front is seen; camera frame; 0 where the layer is not.
    pub normals: Vec<[f32; 3]>,
    /// Share of the pixel that shows the layer's front, in [0, 1].
    pub coverage_front: Vec<f32>,
    /// Share of the pixel that shows the layer's back, in [0, 1].
    pub coverage_back: Vec<f32>,
}

impl LayerPrediction {
    /// Whether the layer is at a pixel: it covers half of it or more.
    pub fn seen(&self, pixel: usize) -> bool {
        self.coverage_front[pixel] + self.coverage_back[pixel] >= SEEN_COVERAGE
    }

    /// [`Self::seen`] for all pixels.
    pub fn mask(&self) -> Vec<bool> {
        (0..MAP_PIXELS).map(|pixel| self.seen(pixel)).collect()
    }

    /// Whether a pixel shows the layer's front, where it shows the layer.
    pub fn front(&self, pixel: usize) -> bool {
        self.coverage_front[pixel] >= self.coverage_back[pixel]
    }

    /// The layer of `output`, as VD-Net and OD-Net write it: g and normal of the front and of the back, of which each pixel
    /// takes the side that it shows.
    ///
    /// - `output`: 8 x 64 x 64: g_front, g_back, n_front, n_back.
    /// - `under`: h = under + deviation * g.
    /// - `coverage`: front and back.
    pub(super) fn decode(output: &[f32], under: &[f32], deviation: &[f32], coverage: [&[f32]; 2]) -> Self {
        let [coverage_front, coverage_back] = coverage.map(<[f32]>::to_vec);
        let empty = (vec![0.0; MAP_PIXELS], vec![[0.0; 3]; MAP_PIXELS]);
        let mut layer = Self { depth_offset: empty.0, normals: empty.1, coverage_front, coverage_back };
        for pixel in (0..MAP_PIXELS).filter(|&pixel| layer.seen(pixel)).collect::<Vec<_>>() {
            let side = usize::from(!layer.front(pixel));
            let value = |index: usize| channel(output, index)[pixel];
            layer.depth_offset[pixel] = under[pixel] + deviation[pixel] * value(side);
            let normal = [0, 1, 2].map(|k| value(2 + 3 * side + k));
            let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
            layer.normals[pixel] = normal.map(|n| n / length.max(SHORTEST_NORMAL));
        }
        layer
    }

    /// Moves depth so that the samples (x, y, h) are met, see [`samples::meet`].
    pub(super) fn meet(&mut self, samples: &[[f64; 3]]) -> Result<(), Error> {
        let seen = self.mask();
        samples::meet(&mut self.depth_offset, &seen, samples)?;
        for (value, _) in self.depth_offset.iter_mut().zip(seen).filter(|(_, seen)| !seen) {
            *value = 0.0;
        }
        Ok(())
    }

    /// Depth offset and unit normal at a canonical point: bilinear among the pixels that show the layer, else the nearest's.
    ///
    /// `None` if the layer is nowhere.
    pub fn at(&self, x: f64, y: f64) -> Option<(f64, [f64; 3])> {
        let weights = samples::layer_weights(&self.mask(), x, y)?;
        let mut normal = [0.0; 3];
        for (pixel, weight) in weights {
            for (sum, component) in normal.iter_mut().zip(self.normals[pixel]) {
                *sum += weight * f64::from(component);
            }
        }
        let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        if length > 1e-9 {
            normal = normal.map(|n| n / length);
        }
        Some((sample(&self.depth_offset, &weights), normal))
    }
}

/// Depth and normals of a whole sketch.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthPrediction {
    /// The first surface along each view ray.
    pub visible: LayerPrediction,
    /// The second surface, if the sketch has one anywhere.
    pub occluded: Option<LayerPrediction>,
    /// Depth of the horizontal plane that offsets are counted from, at y = 0, canonical units.
    pub reference: f64,
    /// Depth that this plane gains per canonical unit of y, see [`crate::sketch::horizontal_slope`].
    pub slope: f64,
}

impl DepthPrediction {
    /// One layer.
    pub fn layer(&self, layer: Layer) -> Option<&LayerPrediction> {
        match layer {
            Layer::Visible => Some(&self.visible),
            Layer::Occluded => self.occluded.as_ref(),
        }
    }

    /// Depth of the horizontal reference plane at canonical y; depth = h + this.
    pub fn plane_depth(&self, y: f64) -> f64 {
        self.reference + y * self.slope
    }

    /// Canonical depth of a layer at each map pixel, growing away from the viewer; that of the reference plane where the layer
    /// is not. `None` if the layer is nowhere.
    pub fn depths(&self, layer: Layer) -> Option<Vec<f64>> {
        let offset = &self.layer(layer)?.depth_offset;
        Some((0..MAP_PIXELS).map(|k| f64::from(offset[k]) + self.plane_depth(pixel_center(k)[1])).collect())
    }

    /// Canonical depth and outward normal (camera frame) of a layer at a canonical point; `None` if the layer is nowhere.
    pub fn depth_at(&self, layer: Layer, x: f64, y: f64) -> Option<(f64, [f64; 3])> {
        let (h, normal) = self.layer(layer)?.at(x, y)?;
        Some((h + self.plane_depth(y), normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sketch::horizontal_slope;

    #[test]
    fn a_horizontal_plane_has_offset_zero() {
        // World plane z = 0 seen at 45 degrees: one unit up on the canvas is one unit further away.
        let view = crate::sketch::View::default();
        let prediction = DepthPrediction {
            visible: LayerPrediction {
                depth_offset: vec![0.0; MAP_PIXELS],
                normals: vec![[0.0, 0.5f32.sqrt(), 0.5f32.sqrt()]; MAP_PIXELS],
                coverage_front: vec![1.0; MAP_PIXELS],
                coverage_back: vec![0.0; MAP_PIXELS],
            },
            occluded: None,
            reference: 0.0,
            slope: horizontal_slope(&view),
        };
        for (pixel, depth) in prediction.depths(Layer::Visible).unwrap().into_iter().enumerate() {
            let [x, y] = pixel_center(pixel);
            let point = view.camera_to_world(&nalgebra::Point3::new(x, y, -depth));
            assert!(point.z.abs() < 1e-6);
        }
        let (depth, normal) = prediction.depth_at(Layer::Visible, 0.3, 1.5).unwrap();
        assert!((depth - 1.5).abs() < 1e-6);
        let up = view.camera_to_world(&nalgebra::Point3::from(normal));
        assert!((up.z - 1.0).abs() < 1e-6);
        assert!(prediction.depths(Layer::Occluded).is_none());
    }
}
