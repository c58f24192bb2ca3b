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

    /// Predicts the visible layer and makes it meet its samples.
    ///
    /// - `samples`: x, y, h on the visible layer.
    /// - `behind`: x, y, h on the occluded layer, which tell of the freedom of depth that both layers share.
    pub fn predict(
        &mut self,
        maps: &SketchMaps,
        samples: &[[f64; 3]],
        behind: &[[f64; 3]],
    ) -> Result<LayerPrediction, Error> {
        let (SampleBase { base, std }, input) = assemble(maps, samples, behind);
        let output = self.0.run(&input)?;
        let mut layer = LayerPrediction::decode(&output, &base, &std, [maps.coverage(0), maps.coverage(1)]);
        layer.meet(samples)?;
        Ok(layer)
    }
}

/// The posterior of the visible samples, and the network's input.
pub(super) fn assemble(maps: &SketchMaps, samples: &[[f64; 3]], behind: &[[f64; 3]]) -> (SampleBase, Vec<f32>) {
    let posterior =
        |samples: &[[f64; 3]]| sample_base(&samples.iter().map(|&[x, y, h]| ([x, y], h)).collect::<Vec<_>>());
    let (visible, hidden) = (posterior(samples), posterior(behind));
    let strokes = maps.raster.data.as_slice();
    let input = [strokes, &visible.base, &visible.std, &hidden.base, &hidden.std, &maps.view_channel()].concat();
    (visible, input)
}
