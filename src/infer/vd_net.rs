//! VD-Net: depth and normals of the visible layer (paper, Sec. 3.2.1).

use super::SketchMaps;
use super::backend::{Backend, Engine};
use super::layers::LayerPrediction;
use super::models::{Models, Network};
use crate::error::Error;
use crate::sketch::{SampleBase, sample_base};

/// The loaded network.
pub(super) struct VdNet(Box<dyn Engine>);

impl VdNet {
    pub fn load(models: &Models, backend: &Backend) -> Result<Self, Error> {
        models.load(Network::Vd, backend).map(Self)
    }

    /// Predicts the visible layer and makes it meet the samples.
    ///
    /// - `samples`: x, y, h on the visible layer.
    pub fn predict(&mut self, maps: &SketchMaps, samples: &[[f64; 3]]) -> Result<LayerPrediction, Error> {
        let points: Vec<_> = samples.iter().map(|&[x, y, h]| ([x, y], h)).collect();
        let SampleBase { base, std } = sample_base(&points);
        let input = [maps.raster.data.as_slice(), &base, &std].concat();
        let output = self.0.run(&input)?;
        let mut layer = LayerPrediction::decode(&output, &base, &std, [maps.coverage(0), maps.coverage(1)]);
        layer.meet(samples)?;
        Ok(layer)
    }
}
