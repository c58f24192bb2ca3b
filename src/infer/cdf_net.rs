//! CDF-Net: conjugate directions in the canvas plane (paper, Sec. 3.2.4).

use super::SketchMaps;
use super::backend::{Backend, Engine};
use super::layers::{DepthPrediction, LayerPrediction};
use super::maps::{MAP_PIXELS, channel};
use super::models::{Models, Network};
use crate::error::Error;

/// Conjugate directions as PolyVector coefficients, one per map pixel.
///
/// The directions u and v, unit complex numbers in the canvas plane (x right, y up), are the square roots of the roots of
/// z^2 - s z + p, that is s = u^2 + v^2 and p = u^2 v^2; signs and order do not matter (Diamanti et al. 2014). Lift them to
/// the tangent plane along the view direction.
#[derive(Clone, Debug, PartialEq)]
pub struct DirectionPrediction {
    /// Re s, Im s, Re p, Im p on the visible layer; meaningful where that layer is seen.
    pub visible: Vec<[f32; 4]>,
    /// The same on the occluded layer, if the sketch has one.
    pub occluded: Option<Vec<[f32; 4]>>,
}

/// The loaded network.
pub(super) struct CdfNet(Box<dyn Engine>);

impl CdfNet {
    pub fn load(models: &Models, backend: &Backend) -> Result<Self, Error> {
        models.load(Network::Cdf, backend).map(Self)
    }

    /// See [`super::Networks::predict_directions`].
    pub fn predict(&mut self, maps: &SketchMaps, depths: &DepthPrediction) -> Result<DirectionPrediction, Error> {
        let mut input = maps.raster.data.clone();
        for layer in [Some(&depths.visible), depths.occluded.as_ref()] {
            // Normals are 0 where the layer is not.
            for k in 0..3 {
                input.extend(
                    (0..MAP_PIXELS).map(|pixel| layer.map_or(0.0, |layer: &LayerPrediction| layer.normals[pixel][k])),
                );
            }
        }
        let output = self.0.run(&input)?;
        let coefficients = |first: usize| -> Vec<[f32; 4]> {
            (0..MAP_PIXELS).map(|pixel| [0, 1, 2, 3].map(|k| channel(&output, first + k)[pixel])).collect()
        };
        Ok(DirectionPrediction {
            visible: coefficients(0),
            occluded: depths.occluded.is_some().then(|| coefficients(4)),
        })
    }
}
