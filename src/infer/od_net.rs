//! OD-Net: depth and normals of the occluded layer, given the visible one (paper, Sec. 3.2.2).

use super::SketchMaps;
use super::backend::{Backend, Engine};
use super::layers::LayerPrediction;
use super::models::{Models, Network};
use crate::error::Error;
use crate::sketch::{SampleBase, sample_base};

/// The loaded network.
pub(super) struct OdNet(Box<dyn Engine>);

impl OdNet {
    pub fn load(models: &Models, backend: &Backend) -> Result<Self, Error> {
        models.load(Network::Od, backend).map(Self)
    }

    /// Predicts the occluded layer and makes it meet the samples.
    ///
    /// - `samples`: x, y, h on the occluded layer.
    pub fn predict(
        &mut self,
        maps: &SketchMaps,
        visible: &LayerPrediction,
        samples: &[[f64; 3]],
    ) -> Result<LayerPrediction, Error> {
        let (SampleBase { base, std }, input) = assemble(maps, visible, samples);
        let output = self.0.run(&input)?;
        let under: Vec<f32> = visible.depth_offset.iter().zip(&base).map(|(visible, base)| visible + base).collect();
        let mut layer = LayerPrediction::decode(&output, &under, &std, [maps.coverage(2), maps.coverage(3)]);
        layer.meet(samples)?;
        Ok(layer)
    }
}

/// The posterior of the distance between the layers, and the network's input.
pub(super) fn assemble(maps: &SketchMaps, visible: &LayerPrediction, samples: &[[f64; 3]]) -> (SampleBase, Vec<f32>) {
    // The prior is over the distance between the layers, not over the occluded layer itself.
    let between: Vec<_> =
        samples.iter().map(|&[x, y, h]| ([x, y], h - visible.at(x, y).map_or(0.0, |(visible, _)| visible))).collect();
    let between = sample_base(&between);
    let strokes = maps.raster.data.as_slice();
    let mut input = [strokes, &between.base, &between.std, &visible.depth_offset].concat();
    for k in 0..3 {
        input.extend(visible.normals.iter().map(|normal| normal[k]));
    }
    input.extend(maps.view_channel());
    (between, input)
}
