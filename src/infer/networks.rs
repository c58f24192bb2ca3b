//! The four networks together.

use super::backend::{Backend, BackendChoice, BackendInfo, BackendOptions};
use super::bsr_net::BsrNet;
use super::cdf_net::{CdfNet, DirectionPrediction};
use super::layers::{DepthPrediction, reference_slope};
use super::maps::{COVERAGE_CHANNEL, MAP_PIXELS, STROKE_CHANNELS, channel};
use super::models::Models;
use super::od_net::OdNet;
use super::vd_net::VdNet;
use crate::control::Control;
use crate::error::Error;

/// What the networks read of a sketch, canonical frame.
#[derive(Clone, Copy, Debug)]
pub struct SketchMaps<'a> {
    /// 10 x 64 x 64: proximity to visible boundary, occluded boundary, contour and feature strokes; coverage of visible-front,
    /// visible-back, occluded-front and occluded-back regions; feature direction.
    pub strokes: &'a [f32],
    /// Known depths on the visible layer: x, y, depth.
    pub visible_samples: &'a [[f64; 3]],
    /// Known depths on the occluded layer: x, y, depth.
    pub occluded_samples: &'a [[f64; 3]],
    /// Elevation of the view above the horizon.
    pub elevation_rad: f64,
}

impl SketchMaps<'_> {
    /// # Errors
    /// [`Error::Argument`] for maps of another size, [`Error::NotFinite`] for a number that is none.
    fn check(&self) -> Result<(), Error> {
        if self.strokes.len() != STROKE_CHANNELS * MAP_PIXELS {
            let value = self.strokes.len().to_string();
            return Err(Error::Argument { name: "length of the stroke maps", value, expected: "10 x 64 x 64 values" });
        }
        if let Some(index) = self.strokes.iter().position(|value| !value.is_finite()) {
            return Err(Error::NotFinite { what: "stroke map value", index });
        }
        for samples in [self.visible_samples, self.occluded_samples] {
            if let Some(index) = samples.iter().position(|sample| sample.iter().any(|value| !value.is_finite())) {
                return Err(Error::NotFinite { what: "depth sample", index });
            }
        }
        if !self.elevation_rad.is_finite() {
            return Err(Error::NotFinite { what: "elevation", index: 0 });
        }
        Ok(())
    }

    /// Coverage of visible-front, visible-back, occluded-front, occluded-back regions.
    pub(super) fn coverage(&self, region: usize) -> &[f32] {
        channel(self.strokes, COVERAGE_CHANNEL + region)
    }

    fn has_occluded_layer(&self) -> bool {
        (2..4).any(|region| self.coverage(region).iter().any(|&coverage| coverage > 0.0))
    }

    /// Samples as offsets from the horizontal plane whose depth is `reference` at y = 0.
    fn offsets(&self, samples: &[[f64; 3]], reference: f64) -> Vec<[f64; 3]> {
        let slope = reference_slope(self.elevation_rad);
        samples.iter().map(|&[x, y, depth]| [x, y, depth - y * slope - reference]).collect()
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
        let mean = |offsets: &[[f64; 3]]| offsets.iter().map(|s| s[2]).sum::<f64>() / offsets.len() as f64;
        let mut reference = match maps.visible_samples {
            [] => 0.0,
            samples => mean(&maps.offsets(samples, 0.0)),
        };
        let visible = self.vd.predict(maps, &maps.offsets(maps.visible_samples, reference))?;
        control.check()?;
        let mut occluded = None;
        if maps.has_occluded_layer() {
            if maps.visible_samples.is_empty() && !maps.occluded_samples.is_empty() {
                // Nothing ties the visible layer to the samples yet: let the unconstrained prediction do so.
                let free = self.od.predict(maps, &visible, &[])?;
                let mut offsets = maps.offsets(maps.occluded_samples, 0.0);
                for offset in &mut offsets {
                    offset[2] -= free.at(offset[0], offset[1]).map_or(0.0, |(h, _)| h);
                }
                reference = mean(&offsets);
                control.check()?;
            }
            occluded = Some(self.od.predict(maps, &visible, &maps.offsets(maps.occluded_samples, reference))?);
            control.check()?;
        }
        Ok(DepthPrediction { visible, occluded, reference, elevation_rad: maps.elevation_rad })
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
    use super::super::maps::pixel_center;
    use super::*;
    use crate::sketch::Layer;

    fn networks() -> Networks {
        let options = BackendOptions { choice: BackendChoice::Embedded, threads: 1, ..Default::default() };
        Networks::load(&Models::embedded().unwrap(), &options).unwrap()
    }

    /// A disk of radius 3 in front; with `occluded`, another behind its right half.
    fn strokes(occluded: bool) -> Vec<f32> {
        let mut strokes = vec![0.0; STROKE_CHANNELS * MAP_PIXELS];
        for pixel in 0..MAP_PIXELS {
            let [x, y] = pixel_center(pixel);
            let distance = (x.hypot(y) - 3.0).abs() * 29.0;
            strokes[pixel] = (8.0 / (8.0 + distance)) as f32;
            let inside = f32::from(u8::from(x.hypot(y) < 3.0));
            strokes[COVERAGE_CHANNEL * MAP_PIXELS + pixel] = inside;
            if occluded && x > 0.0 {
                strokes[(COVERAGE_CHANNEL + 3) * MAP_PIXELS + pixel] = inside;
            }
        }
        strokes
    }

    fn maps<'a>(strokes: &'a [f32], visible: &'a [[f64; 3]], occluded: &'a [[f64; 3]]) -> SketchMaps<'a> {
        let elevation_rad = std::f64::consts::FRAC_PI_4;
        SketchMaps { strokes, visible_samples: visible, occluded_samples: occluded, elevation_rad }
    }

    #[test]
    fn depth_samples_are_met() {
        let strokes = strokes(true);
        let (visible, occluded) = ([[0.5, 0.25, 9.0], [-1.5, 1.0, 10.5], [2.0, -2.0, 7.0]], [[1.0, 0.5, 11.0]]);
        for (visible, occluded) in [(&visible[..], &occluded[..]), (&visible[..1], &[]), (&[], &occluded[..])] {
            let prediction =
                networks().predict_depths(&maps(&strokes, visible, occluded), &Control::default()).unwrap();
            for (layer, samples) in [(Layer::Visible, visible), (Layer::Occluded, occluded)] {
                for &[x, y, depth] in samples {
                    let (found, _) = prediction.depth_at(layer, x, y).unwrap();
                    assert!((found - depth).abs() < 1e-3, "{layer:?} {found} {depth}");
                }
            }
        }
    }

    #[test]
    fn moving_the_samples_in_depth_moves_the_prediction() {
        let strokes = strokes(false);
        let samples = [[0.5, 0.25, 9.0], [-1.5, 1.0, 10.5]];
        let moved = samples.map(|[x, y, depth]| [x, y, depth + 3.5]);
        let mut networks = networks();
        let mut depths = |samples: &[[f64; 3]]| {
            let prediction = networks.predict_depths(&maps(&strokes, samples, &[]), &Control::default()).unwrap();
            prediction.depths(Layer::Visible).unwrap()
        };
        for (a, b) in depths(&samples).into_iter().zip(depths(&moved)) {
            assert!((a + 3.5 - b).abs() < 1e-5);
        }
    }

    #[test]
    fn the_occluded_layer_is_where_the_sketch_has_one() {
        let mut networks = networks();
        let without = strokes(false);
        let prediction = networks.predict_depths(&maps(&without, &[], &[]), &Control::default()).unwrap();
        assert!(prediction.occluded.is_none());
        let directions =
            networks.predict_directions(&maps(&without, &[], &[]), &prediction, &Control::default()).unwrap();
        assert!(directions.occluded.is_none() && directions.visible.iter().flatten().all(|c| c.is_finite()));
        let with = strokes(true);
        let prediction = networks.predict_depths(&maps(&with, &[], &[]), &Control::default()).unwrap();
        let occluded = prediction.occluded.unwrap();
        for pixel in 0..MAP_PIXELS {
            let [x, y] = pixel_center(pixel);
            assert_eq!(occluded.seen(pixel), x > 0.0 && x.hypot(y) < 3.0);
            assert!(!occluded.seen(pixel) || !occluded.front(pixel));
            let length = occluded.normals[pixel].iter().map(|n| n * n).sum::<f32>();
            assert!((length - f32::from(u8::from(occluded.seen(pixel)))).abs() < 1e-5);
        }
    }

    #[test]
    fn a_cancel_stops_between_networks() {
        let (strokes, control) = (strokes(false), Control::default());
        control.cancel();
        assert_eq!(networks().predict_depths(&maps(&strokes, &[], &[]), &control), Err(Error::Cancelled));
    }

    #[test]
    fn bad_input_is_an_error() {
        let mut networks = networks();
        let control = Control::default();
        let good = strokes(false);
        let mut bad = good.clone();
        bad[17] = f32::NAN;
        assert!(matches!(networks.predict_depths(&maps(&bad, &[], &[]), &control), Err(Error::NotFinite { .. })));
        let short = maps(&good[1..], &[], &[]);
        assert!(matches!(networks.predict_depths(&short, &control), Err(Error::Argument { .. })));
        let sample = [[0.0, f64::INFINITY, 1.0]];
        assert!(matches!(
            networks.predict_depths(&maps(&good, &sample, &[]), &control),
            Err(Error::NotFinite { what: "depth sample", index: 0 })
        ));
        let maps = maps(&good, &[], &[]);
        let depths = networks.predict_depths(&maps, &control).unwrap();
        assert!(matches!(networks.net_offsets(&maps, &depths, &[[0.0; 3]; 10], &control), Err(Error::Argument { .. })));
        let net = [[f64::NAN; 3]; super::super::NET_POINTS];
        assert!(matches!(networks.net_offsets(&maps, &depths, &net, &control), Err(Error::NotFinite { .. })));
    }
}
