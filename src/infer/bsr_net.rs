//! BSR-Net: the control net of the surface (paper, Sec. 3.2.3).
//!
//! The paper's network reads images and answers with a whole net. Ours works in the parameter domain: it starts at the Coons
//! net of the border curves and predicts what to add, from what the depth maps say around each control point.

use super::SketchMaps;
use super::backend::{Backend, Engine};
use super::layers::{DepthPrediction, LayerPrediction};
use super::maps::{CONTOUR_CHANNEL, bilinear, channel, sample};
use super::models::{Models, Network};
use crate::error::Error;

/// Control points along one side of the net.
pub const NET_SIZE: usize = 30;

/// Control points of the net.
pub const NET_POINTS: usize = NET_SIZE * NET_SIZE;

const CHANNELS: usize = 17;

/// The loaded network.
pub(super) struct BsrNet(Box<dyn Engine>);

impl BsrNet {
    pub fn load(models: &Models, backend: &Backend) -> Result<Self, Error> {
        models.load(Network::Bsr, backend).map(Self)
    }

    /// See [`super::Networks::net_offsets`].
    pub fn offsets(
        &mut self,
        maps: &SketchMaps,
        depths: &DepthPrediction,
        coons: &[[f64; 3]],
    ) -> Result<Vec<[f64; 3]>, Error> {
        if coons.len() != NET_POINTS {
            let value = coons.len().to_string();
            return Err(Error::Argument { name: "length of the Coons net", value, expected: "30 x 30 control points" });
        }
        if let Some(index) = coons.iter().position(|point| point.iter().any(|x| !x.is_finite())) {
            return Err(Error::NotFinite { what: "Coons control point", index });
        }
        let output = self.0.run(&assemble(maps.contours(), depths, coons))?;
        Ok((0..NET_POINTS).map(|k| [0, 1, 2].map(|axis| f64::from(output[axis * NET_POINTS + k]))).collect())
    }
}

/// Input of the network, 17 x 30 x 30; see the manifest for the channels.
fn assemble(contours: &[f32], depths: &DepthPrediction, coons: &[[f64; 3]]) -> Vec<f32> {
    let mask = |layer: &LayerPrediction| -> Vec<f32> {
        layer.mask().into_iter().map(|seen| f32::from(u8::from(seen))).collect()
    };
    let visible = (mask(&depths.visible), &depths.visible);
    let occluded = depths.occluded.as_ref().map(|layer| (mask(layer), layer));
    let mut input = vec![0.0f32; CHANNELS * NET_POINTS];
    for (k, &[x, y, h]) in coons.iter().enumerate() {
        let weights = bilinear(x, y);
        let mut set = |channel: usize, value: f64| input[channel * NET_POINTS + k] = value as f32;
        // Offsets and normals are 0 where a layer is not, so their interpolation is already weighted by coverage.
        let mut layer = |first: usize, first_normal: usize, (seen, layer): &(Vec<f32>, &LayerPrediction)| {
            let coverage = sample(seen, &weights);
            set(first, coverage);
            set(first + 1, sample(&layer.depth_offset, &weights) - coverage * h);
            for axis in 0..3 {
                let normal = weights.iter().map(|&(p, weight)| weight * f64::from(layer.normals[p][axis])).sum();
                set(first_normal + axis, normal);
            }
        };
        layer(3, 7, &visible);
        if let Some(occluded) = &occluded {
            layer(10, 12, occluded);
        }
        for (axis, value) in [x, y, h].into_iter().enumerate() {
            set(axis, value);
        }
        let (seen, layer) = &visible;
        let side = |front: bool| -> f64 {
            weights
                .iter()
                .filter(|&&(p, _)| layer.front(p) == front)
                .map(|&(p, weight)| weight * f64::from(seen[p]))
                .sum()
        };
        set(5, side(true));
        set(6, side(false));
        set(15, sample(contours, &weights));
        let on_border = [k / NET_SIZE, k % NET_SIZE].iter().any(|&i| i == 0 || i == NET_SIZE - 1);
        set(16, f64::from(u8::from(on_border)));
    }
    input
}

impl SketchMaps<'_> {
    fn contours(&self) -> &[f32] {
        channel(self.strokes, CONTOUR_CHANNEL)
    }
}
