//! The four networks together.

use super::backend::{Backend, BackendChoice, BackendInfo, BackendOptions};
use super::bsr_net::BsrNet;
use super::cdf_net::{CdfNet, DirectionPrediction};
use super::layers::DepthPrediction;
use super::maps::{COVERAGE_CHANNEL, MAP_PIXELS};
use super::models::Models;
use super::od_net::OdNet;
use super::vd_net::VdNet;
use crate::control::Control;
use crate::error::Error;
use crate::sketch::{CanonicalSample, Layer, PatchSketch, Raster, STROKE_CHANNELS, horizontal_slope};

/// What the networks read of a sketch, canonical frame.
#[derive(Clone, Copy, Debug)]
pub struct SketchMaps<'a> {
    /// Strokes and regions.
    pub raster: &'a Raster,
    /// Known depths on either layer.
    pub samples: &'a [CanonicalSample],
    /// Depth that a horizontal plane gains per unit of y, see [`horizontal_slope`].
    pub slope: f64,
}

impl<'a> SketchMaps<'a> {
    /// The maps of `patch`, which `raster` was drawn from.
    pub fn new(patch: &'a PatchSketch, raster: &'a Raster) -> Self {
        Self { raster, samples: &patch.depth_samples, slope: horizontal_slope(&patch.view) }
    }

    /// # Errors
    /// [`Error::Argument`] for maps of another size, [`Error::NotFinite`] for a number that is none.
    fn check(&self) -> Result<(), Error> {
        let data = &self.raster.data;
        if data.len() != STROKE_CHANNELS * MAP_PIXELS {
            let value = data.len().to_string();
            return Err(Error::Argument { name: "length of the raster", value, expected: "10 x 64 x 64 values" });
        }
        if let Some(index) = data.iter().position(|value| !value.is_finite()) {
            return Err(Error::NotFinite { what: "raster value", index });
        }
        let finite =
            |sample: &CanonicalSample| sample.position.iter().all(|x| x.is_finite()) && sample.depth.is_finite();
        if let Some(index) = self.samples.iter().position(|sample| !finite(sample)) {
            return Err(Error::NotFinite { what: "depth sample", index });
        }
        if !self.slope.is_finite() {
            return Err(Error::NotFinite { what: "slope", index: 0 });
        }
        Ok(())
    }

    /// Coverage by visible-front, visible-back, occluded-front, occluded-back regions.
    pub(super) fn coverage(&self, region: usize) -> &'a [f32] {
        self.raster.channel(COVERAGE_CHANNEL + region)
    }

    /// What tells the depth networks the view: the slope less that of 45 degrees, constant over the map.
    pub(super) fn view_channel(&self) -> [f32; MAP_PIXELS] {
        [(self.slope - 1.0) as f32; MAP_PIXELS]
    }

    fn has_occluded_layer(&self) -> bool {
        (0..MAP_PIXELS).any(|pixel| self.raster.occluded_coverage(pixel) > 0.0)
    }

    /// The samples of a layer as x, y and offset from the horizontal plane whose depth is `reference` at y = 0.
    fn offsets(&self, layer: Layer, reference: f64) -> Vec<[f64; 3]> {
        let samples = self.samples.iter().filter(|sample| sample.layer == layer);
        let offset = |sample: &CanonicalSample| {
            let [x, y] = sample.position;
            [x, y, sample.depth - y * self.slope - reference]
        };
        samples.map(offset).collect()
    }
}

/// The four networks, loaded. One handle, one thread at a time.
pub struct Networks {
    vd: VdNet,
    od: OdNet,
    bsr: BsrNet,
    cdf: CdfNet,
    info: BackendInfo,
}

impl Networks {
    /// Loads the networks into the backend that `options` choose.
    ///
    /// With [`BackendChoice::Auto`], an ONNX Runtime that refuses the networks gives way to the embedded engine.
    ///
    /// # Errors
    /// [`Error::Backend`] if the backend asked for cannot be used, [`Error::Model`] if a network cannot be loaded.
    pub fn load(models: &Models, options: &BackendOptions) -> Result<Self, Error> {
        let backend = Backend::open(options)?;
        let error = match Self::load_into(models, &backend) {
            Err(error) if options.choice == BackendChoice::Auto && !backend.is_embedded() => error,
            result => return result,
        };
        let why = format!("{} failed: {error}", backend.info());
        Self::load_into(models, &Backend::embedded(options.effective_threads(), why))
    }

    fn load_into(models: &Models, backend: &Backend) -> Result<Self, Error> {
        Ok(Self {
            vd: VdNet::load(models, backend)?,
            od: OdNet::load(models, backend)?,
            bsr: BsrNet::load(models, backend)?,
            cdf: CdfNet::load(models, backend)?,
            info: backend.info().clone(),
        })
    }

    /// The backend in use.
    pub fn backend(&self) -> &BackendInfo {
        &self.info
    }

    /// Predicts depth and normals of both layers (VD-Net, then OD-Net where the sketch has an occluded layer).
    ///
    /// Offsets are counted from the horizontal plane through the mean of the visible samples; without those, from the one
    /// on which the mean of the occluded samples meets the prediction; without any, from the plane of depth 0 at y = 0.
    /// The samples are met within a thousandth of a canonical unit by a smooth correction of the networks' answer.
    /// Looks for a cancel between networks.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Argument`] and [`Error::NotFinite`] for bad maps; [`Error::Backend`] and
    /// [`Error::Model`] if the engine fails.
    pub fn predict_depths(&mut self, maps: &SketchMaps, control: &Control) -> Result<DepthPrediction, Error> {
        maps.check()?;
        control.check()?;
        let level = |offsets: &[[f64; 3]]| offsets.iter().map(|s| s[2]).sum::<f64>() / offsets.len().max(1) as f64;
        let mut reference = level(&maps.offsets(Layer::Visible, 0.0));
        let samples = maps.offsets(Layer::Visible, reference);
        let mut behind = maps.offsets(Layer::Occluded, reference);
        let visible = self.vd.predict(maps, &samples, if samples.is_empty() { &[] } else { &behind })?;
        control.check()?;
        let mut occluded = None;
        if maps.has_occluded_layer() {
            if samples.is_empty() && !behind.is_empty() {
                // Nothing ties the visible layer to the samples yet: let the unconstrained prediction do so.
                let free = self.od.predict(maps, &visible, &[])?;
                control.check()?;
                for [x, y, h] in &mut behind {
                    *h -= free.at(*x, *y).map_or(0.0, |(h, _)| h);
                }
                reference = level(&behind);
                behind = maps.offsets(Layer::Occluded, reference);
            }
            occluded = Some(self.od.predict(maps, &visible, &behind)?);
            control.check()?;
        }
        Ok(DepthPrediction { visible, occluded, reference, slope: maps.slope })
    }

    /// Predicts what to add to the Coons net of the border curves (BSR-Net).
    ///
    /// - `coons`: 30 x 30 control points, u index times 30 plus v index: canonical x, y and h = -z - plane depth at y, see
    ///   [`DepthPrediction::plane_depth`].
    /// - returns as many offsets of x, y, h, canonical units.
    ///
    /// # Errors
    /// As [`Self::predict_depths`]; [`Error::Argument`] for a net of another size.
    pub fn net_offsets(
        &mut self,
        maps: &SketchMaps,
        depths: &DepthPrediction,
        coons: &[[f64; 3]],
        control: &Control,
    ) -> Result<Vec<[f64; 3]>, Error> {
        maps.check()?;
        control.check()?;
        self.bsr.offsets(maps, depths, coons)
    }

    /// Predicts conjugate directions in the canvas plane (CDF-Net).
    ///
    /// # Errors
    /// As [`Self::predict_depths`].
    pub fn predict_directions(
        &mut self,
        maps: &SketchMaps,
        depths: &DepthPrediction,
        control: &Control,
    ) -> Result<DirectionPrediction, Error> {
        maps.check()?;
        control.check()?;
        self.cdf.predict(maps, depths)
    }
}

#[cfg(test)]
mod tests {
    use super::super::NET_POINTS;
    use super::super::layers::LayerPrediction;
    use super::super::maps::pixel_center;
    use super::super::models::Network;
    use super::super::{od_net, vd_net};
    use super::*;
    use crate::sketch::MAP_SIZE;

    fn networks() -> Networks {
        let options = BackendOptions { choice: BackendChoice::Embedded, threads: 1, ..Default::default() };
        Networks::load(&Models::embedded().unwrap(), &options).unwrap()
    }

    /// A disk of radius 3 in front; with `occluded`, another behind its right half.
    fn disk(occluded: bool) -> Raster {
        let mut data = vec![0.0; STROKE_CHANNELS * MAP_PIXELS];
        for pixel in 0..MAP_PIXELS {
            let [x, y] = pixel_center(pixel);
            let distance = (x.hypot(y) - 3.0).abs() * 29.0;
            data[pixel] = (8.0 / (8.0 + distance)) as f32;
            let inside = f32::from(u8::from(x.hypot(y) < 3.0));
            data[COVERAGE_CHANNEL * MAP_PIXELS + pixel] = inside;
            if occluded && x > 0.0 {
                data[(COVERAGE_CHANNEL + 3) * MAP_PIXELS + pixel] = inside;
            }
        }
        Raster { data }
    }

    fn at(layer: Layer, x: f64, y: f64, depth: f64) -> CanonicalSample {
        CanonicalSample { position: [x, y], layer, depth }
    }

    fn maps<'a>(raster: &'a Raster, samples: &'a [CanonicalSample]) -> SketchMaps<'a> {
        SketchMaps { raster, samples, slope: 1.0 }
    }

    #[test]
    fn depth_samples_are_met() {
        let raster = disk(true);
        let all = [
            at(Layer::Visible, 0.5, 0.25, 9.0),
            at(Layer::Visible, -1.5, 1.0, 10.5),
            at(Layer::Occluded, 1.0, 0.5, 11.0),
            at(Layer::Occluded, 2.0, -1.5, 9.0),
        ];
        for samples in [&all[..], &all[..1], &all[1..3], &all[2..], &all[3..]] {
            let prediction = networks().predict_depths(&maps(&raster, samples), &Control::default()).unwrap();
            for sample in samples {
                let [x, y] = sample.position;
                let (found, _) = prediction.depth_at(sample.layer, x, y).unwrap();
                assert!((found - sample.depth).abs() < 1e-3, "{sample:?} {found}");
            }
        }
    }

    #[test]
    fn moving_the_samples_in_depth_moves_the_prediction() {
        let raster = disk(true);
        let both = [at(Layer::Visible, 0.5, 0.25, 9.0), at(Layer::Occluded, 1.5, 1.0, 12.5)];
        let mut networks = networks();
        let mut depths = |samples: &[CanonicalSample]| {
            let prediction = networks.predict_depths(&maps(&raster, samples), &Control::default()).unwrap();
            Layer::ALL.map(|layer| prediction.depths(layer).unwrap()).concat()
        };
        for samples in [&both[..], &both[..1], &both[1..]] {
            let moved: Vec<_> = samples.iter().map(|s| CanonicalSample { depth: s.depth + 3.5, ..*s }).collect();
            for (a, b) in depths(samples).into_iter().zip(depths(&moved)) {
                assert!((a + 3.5 - b).abs() < 1e-5);
            }
        }
    }

    /// The contract with `training/`: see `depth_case` in its `golden.py`.
    #[test]
    fn the_inputs_are_what_training_makes_of_the_same_maps() {
        let golden = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/contract/training.json"));
        let golden: serde_json::Value = serde_json::from_str(golden).unwrap();
        let case = &golden["depth_inputs"];
        let wave = |c: usize, pixel: usize| {
            let (row, column) = (pixel / MAP_SIZE, pixel % MAP_SIZE);
            (0.3 * c as f64 + 0.11 * row as f64 + 0.07 * column as f64).sin() as f32
        };
        let data = (0..STROKE_CHANNELS * MAP_PIXELS).map(|k| wave(k / MAP_PIXELS, k % MAP_PIXELS)).collect();
        let raster = Raster { data };
        let maps = SketchMaps { raster: &raster, samples: &[], slope: 1.7 };
        let samples: Vec<[f64; 3]> = serde_json::from_value(case["samples"].clone()).unwrap();
        let visible = LayerPrediction {
            depth_offset: (0..MAP_PIXELS).map(|pixel| wave(20, pixel)).collect(),
            normals: (0..MAP_PIXELS).map(|pixel| [21, 22, 23].map(|c| wave(c, pixel))).collect(),
            coverage_front: vec![1.0; MAP_PIXELS],
            coverage_back: vec![0.0; MAP_PIXELS],
        };
        let (_, vd) = vd_net::assemble(&maps, &samples[..2], &samples[2..]);
        let (_, od) = od_net::assemble(&maps, &visible, &samples[2..]);
        for (name, input, network) in [("vd", vd, Network::Vd), ("od", od, Network::Od)] {
            assert_eq!(input.len(), network.input_shape().iter().product::<usize>());
            let values = case[name]["values"].as_array().unwrap();
            assert_eq!(values.len() * MAP_PIXELS, input.len());
            for (place, value) in case[name]["places"].as_array().unwrap().iter().zip(values) {
                let [c, row, column] = [0, 1, 2].map(|k| place[k].as_u64().unwrap() as usize);
                let (found, expected) =
                    (input[c * MAP_PIXELS + row * MAP_SIZE + column], value.as_f64().unwrap() as f32);
                assert!((found - expected).abs() < 1e-4, "{name}, channel {c}: {found}, training has {expected}");
            }
        }
    }

    #[test]
    fn the_occluded_layer_is_where_the_sketch_has_one() {
        let (mut networks, control) = (networks(), Control::default());
        let without = disk(false);
        let prediction = networks.predict_depths(&maps(&without, &[]), &control).unwrap();
        assert!(prediction.occluded.is_none());
        let directions = networks.predict_directions(&maps(&without, &[]), &prediction, &control).unwrap();
        assert!(directions.occluded.is_none() && directions.visible.iter().flatten().all(|c| c.is_finite()));
        let with = disk(true);
        let prediction = networks.predict_depths(&maps(&with, &[]), &control).unwrap();
        let occluded = prediction.occluded.unwrap();
        for pixel in 0..MAP_PIXELS {
            let [x, y] = pixel_center(pixel);
            assert_eq!(occluded.seen(pixel), x > 0.0 && x.hypot(y) < 3.0);
            assert!(!occluded.seen(pixel) || !occluded.front(pixel));
            let length = occluded.normals[pixel].iter().map(|n| n * n).sum::<f32>();
            assert!((length - f32::from(u8::from(occluded.seen(pixel)))).abs() < 1e-5);
        }
    }

    /// The exported networks of depth average their answers to a sketch and to its mirror image, which makes them symmetric.
    #[test]
    fn a_mirrored_sketch_has_the_mirrored_depth() {
        let image = |pixel: usize| pixel / MAP_SIZE * MAP_SIZE + MAP_SIZE - 1 - pixel % MAP_SIZE;
        let raster = disk(true);
        let flipped = Raster {
            data: (0..raster.data.len())
                .map(|k| raster.data[k / MAP_PIXELS * MAP_PIXELS + image(k % MAP_PIXELS)])
                .collect(),
        };
        let samples = [at(Layer::Visible, 0.5, 0.25, 9.0), at(Layer::Occluded, 1.5, 1.0, 12.5)];
        let others = samples.map(|s| CanonicalSample { position: [-s.position[0], s.position[1]], ..s });
        let mut networks = networks();
        let mut depths = |raster: &Raster, samples: &[CanonicalSample]| {
            networks.predict_depths(&maps(raster, samples), &Control::default()).unwrap()
        };
        let (depths, mirrored) = (depths(&raster, &samples), depths(&flipped, &others));
        let near = |a: f32, b: f32| (a - b).abs() < 1e-3;
        for layer in Layer::ALL {
            let (here, there) = (depths.layer(layer).unwrap(), mirrored.layer(layer).unwrap());
            for pixel in 0..MAP_PIXELS {
                assert!(near(here.depth_offset[pixel], there.depth_offset[image(pixel)]));
                let ([x, y, z], [a, b, c]) = (here.normals[pixel], there.normals[image(pixel)]);
                assert!(near(x, -a) && near(y, b) && near(z, c));
            }
        }
    }

    #[test]
    fn a_cancel_stops_between_networks() {
        let (raster, control) = (disk(false), Control::default());
        control.cancel();
        assert_eq!(networks().predict_depths(&maps(&raster, &[]), &control), Err(Error::Cancelled));
    }

    #[test]
    fn bad_input_is_an_error() {
        let (mut networks, control) = (networks(), Control::default());
        let good = disk(false);
        let mut bad = good.clone();
        bad.data[17] = f32::NAN;
        assert!(matches!(networks.predict_depths(&maps(&bad, &[]), &control), Err(Error::NotFinite { .. })));
        let short = Raster { data: vec![0.0; 10] };
        assert!(matches!(networks.predict_depths(&maps(&short, &[]), &control), Err(Error::Argument { .. })));
        let samples = [at(Layer::Visible, 0.0, f64::INFINITY, 1.0)];
        assert_eq!(
            networks.predict_depths(&maps(&good, &samples), &control),
            Err(Error::NotFinite { what: "depth sample", index: 0 })
        );
        let maps = maps(&good, &[]);
        let depths = networks.predict_depths(&maps, &control).unwrap();
        assert!(matches!(networks.net_offsets(&maps, &depths, &[[0.0; 3]; 10], &control), Err(Error::Argument { .. })));
        let net = [[f64::NAN; 3]; NET_POINTS];
        assert!(matches!(networks.net_offsets(&maps, &depths, &net, &control), Err(Error::NotFinite { .. })));
    }
}
