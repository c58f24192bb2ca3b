//! BSR-Net: the control net of the surface (paper, Sec. 3.2.3).
//!
//! The paper's network reads images and answers with a whole net. Ours works in the parameter domain: it starts at the Coons
//! net of the border curves and predicts what to add, from what the depth maps say around each control point.

use super::SketchMaps;
use super::backend::{Backend, Engine};
use super::layers::{DepthPrediction, LayerPrediction};
use super::maps::{CONTOUR_CHANNEL, MAP_PIXELS, bilinear, channel, sample};
use super::models::{Models, Network};
use crate::error::Error;

/// Control points along one side of the net.
pub const NET_SIZE: usize = 30;

/// Control points of the net.
pub const NET_POINTS: usize = NET_SIZE * NET_SIZE;

/// Input channels.
const CHANNELS: usize = 17;

/// Maps that the input is read from.
const LOOKED_AT: usize = 13;

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
        let output = self.0.run(&assemble(coons, &looked_at(maps.raster.channel(CONTOUR_CHANNEL), depths)))?;
        Ok((0..NET_POINTS).map(|k| [0, 1, 2].map(|axis| f64::from(output[axis * NET_POINTS + k]))).collect())
    }
}

/// What the control points look at, 13 x 64 x 64: visible coverage, offset, front, back, normal; occluded coverage, offset,
/// normal; proximity to contours. All but the last 0 where the layer is not.
fn looked_at(contours: &[f32], depths: &DepthPrediction) -> Vec<f32> {
    let mask = |layer: Option<&LayerPrediction>, chosen: &dyn Fn(&LayerPrediction, usize) -> bool| -> Vec<f32> {
        let value = |pixel| layer.is_some_and(|layer| layer.seen(pixel) && chosen(layer, pixel));
        (0..MAP_PIXELS).map(|pixel| f32::from(u8::from(value(pixel)))).collect()
    };
    let mut maps = Vec::with_capacity(LOOKED_AT * MAP_PIXELS);
    for layer in [Some(&depths.visible), depths.occluded.as_ref()] {
        maps.extend(mask(layer, &|_, _| true));
        maps.extend((0..MAP_PIXELS).map(|pixel| layer.map_or(0.0, |layer| layer.depth_offset[pixel])));
        if maps.len() == 2 * MAP_PIXELS {
            maps.extend(mask(layer, &|layer, pixel| layer.front(pixel)));
            maps.extend(mask(layer, &|layer, pixel| !layer.front(pixel)));
        }
        for axis in 0..3 {
            maps.extend((0..MAP_PIXELS).map(|pixel| layer.map_or(0.0, |layer| layer.normals[pixel][axis])));
        }
    }
    maps.extend(contours);
    maps
}

/// Input of the network, 17 x 30 x 30, see the manifest for its channels.
///
/// - `maps`: as [`looked_at`] makes them; read bilinearly at each control point.
fn assemble(coons: &[[f64; 3]], maps: &[f32]) -> Vec<f32> {
    let mut input = vec![0.0f32; CHANNELS * NET_POINTS];
    for (k, &[x, y, h]) in coons.iter().enumerate() {
        let weights = bilinear(x, y);
        let m: [f64; LOOKED_AT] = std::array::from_fn(|index| sample(channel(maps, index), &weights));
        // Offsets are 0 where a layer is not, so their interpolation is already weighted by its coverage.
        let (visible, occluded) = (m[1] - m[0] * h, m[8] - m[7] * h);
        let on_border = [k / NET_SIZE, k % NET_SIZE].iter().any(|&i| i == 0 || i == NET_SIZE - 1);
        let border = f64::from(u8::from(on_border));
        let values = [&[x, y, h, m[0], visible], &m[2..8], &[occluded], &m[9..], &[border]].concat();
        for (index, value) in values.into_iter().enumerate() {
            input[index * NET_POINTS + k] = value as f32;
        }
    }
    input
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sketch::MAP_SIZE;

    /// Coons net of the border of a 30 x 30 net whose parameters are i/29 and j/29 apart from clamping: as in training.
    fn coons(net: impl Fn(usize, usize) -> [f64; 3]) -> Vec<[f64; 3]> {
        let spans = (NET_SIZE - 3) as f64;
        let knot = |i: usize| (i.saturating_sub(3) as f64).min(spans) / spans;
        let greville = |i: usize| (knot(i + 1) + knot(i + 2) + knot(i + 3)) / 3.0;
        let last = NET_SIZE - 1;
        let point = |i: usize, j: usize| {
            let (u, v) = (greville(i), greville(j));
            let mix = |t: f64, a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| (1.0 - t) * a[k] + t * b[k]);
            let rows = mix(u, net(0, j), net(last, j));
            let columns = mix(v, net(i, 0), net(i, last));
            let corners = mix(u, mix(v, net(0, 0), net(0, last)), mix(v, net(last, 0), net(last, last)));
            [0, 1, 2].map(|k| rows[k] + columns[k] - corners[k])
        };
        (0..NET_POINTS).map(|k| point(k / NET_SIZE, k % NET_SIZE)).collect()
    }

    #[test]
    fn the_input_is_what_training_makes_of_the_same_net() {
        let golden = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/contract/training.json"));
        let golden: serde_json::Value = serde_json::from_str(golden).unwrap();
        let net = coons(|i, j| {
            let (s, t) = (i as f64 / 29.0, j as f64 / 29.0);
            [
                3.0 * (2.0 * s - 1.0) + 0.4 * (5.0 * t).sin(),
                2.5 * (2.0 * t - 1.0) + 0.3 * (4.0 * s).cos(),
                0.8 * s * t + 0.2 * (6.0 * s).sin(),
            ]
        });
        let map = |k: usize| {
            let (c, row, column) = (k / MAP_PIXELS, k % MAP_PIXELS / MAP_SIZE, k % MAP_SIZE);
            (0.3 * c as f64 + 0.11 * row as f64 + 0.07 * column as f64).sin() as f32
        };
        let maps: Vec<f32> = (0..LOOKED_AT * MAP_PIXELS).map(map).collect();
        let input = assemble(&net, &maps);
        let case = &golden["bsr_input"];
        let places = case["places"].as_array().unwrap();
        assert!(places.len() > CHANNELS);
        for (place, value) in places.iter().zip(case["values"].as_array().unwrap()) {
            let [c, i, j] = [0, 1, 2].map(|k| place[k].as_u64().unwrap() as usize);
            let (found, expected) = (input[c * NET_POINTS + i * NET_SIZE + j], value.as_f64().unwrap() as f32);
            assert!((found - expected).abs() < 1e-4, "channel {c} at ({i}, {j}): {found}, training has {expected}");
        }
    }

    #[test]
    fn a_layer_that_is_nowhere_shows_nothing() {
        let nothing = LayerPrediction {
            depth_offset: vec![0.0; MAP_PIXELS],
            normals: vec![[0.0; 3]; MAP_PIXELS],
            coverage_front: vec![0.2; MAP_PIXELS],
            coverage_back: vec![0.2; MAP_PIXELS],
        };
        let mut depths = DepthPrediction { visible: nothing, occluded: None, reference: 1.0, slope: 1.0 };
        let contours = vec![0.25; MAP_PIXELS];
        let maps = looked_at(&contours, &depths);
        assert_eq!(maps.len(), LOOKED_AT * MAP_PIXELS);
        assert!(maps[..12 * MAP_PIXELS].iter().all(|&value| value == 0.0));
        assert_eq!(maps[12 * MAP_PIXELS..], contours);
        depths.visible.coverage_back.fill(0.8);
        depths.occluded = Some(depths.visible.clone());
        let maps = looked_at(&contours, &depths);
        let filled: Vec<f32> = (0..LOOKED_AT).map(|index| maps[index * MAP_PIXELS]).collect();
        assert_eq!(filled, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.25]);
    }
}
