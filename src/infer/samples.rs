//! Depth samples after the networks: what still differs from them is removed by a smooth change.
//!
//! Before, they enter as the posterior of a Gaussian process over the depth offset, [`crate::sketch::sample_base`]; VD-Net and
//! OD-Net predict in units of its deviation and so change least where a sample lies.

use super::maps::{MAP_PIXELS, bilinear, pixel_center, sample};
use crate::error::Error;
use crate::sketch::{offset_covariance, spread_out};
use nalgebra::{Cholesky, DMatrix, DVector};

/// Deviation of a sample's depth, canonical units: small enough to count as met, large enough for two samples at one place.
const NOISE: f64 = 1e-4;

/// Weights of the pixels that speak for a layer at a canonical point: bilinear among those where the layer is seen, else the
/// nearest such pixel.
///
/// `None` if the layer is seen nowhere.
pub fn layer_weights(seen: &[bool], x: f64, y: f64) -> Option<[(usize, f64); 4]> {
    let weights = bilinear(x, y).map(|(pixel, weight)| (pixel, if seen[pixel] { weight } else { 0.0 }));
    let total: f64 = weights.iter().map(|entry| entry.1).sum();
    if total > 1e-6 {
        return Some(weights.map(|(pixel, weight)| (pixel, weight / total)));
    }
    let squared = |pixel: usize| {
        let center = pixel_center(pixel);
        (center[0] - x).powi(2) + (center[1] - y).powi(2)
    };
    let nearest = (0..MAP_PIXELS).filter(|&pixel| seen[pixel]).min_by(|&a, &b| squared(a).total_cmp(&squared(b)))?;
    Some([(nearest, 1.0), (nearest, 0.0), (nearest, 0.0), (nearest, 0.0)])
}

/// Changes the map `h` by the smallest function of the prior such that it takes the samples' values.
///
/// With B the lookup of [`layer_weights`] and K the prior's covariance between pixels, h += K B^T (B K B^T)^-1 (s - B h).
/// Of more than 200 samples, 200 that lie far apart are met.
///
/// - `h`: depth offset of a layer, one value per map pixel.
/// - `seen`: where that layer is; nothing happens if that is nowhere.
/// - `samples`: x, y, h.
///
/// # Errors
/// [`Error::Singular`] if the samples' covariance is not positive definite, which its noise prevents.
pub fn meet(h: &mut [f32], seen: &[bool], samples: &[[f64; 3]]) -> Result<(), Error> {
    let samples = spread_out(&samples.iter().map(|&[x, y, h]| ([x, y], h)).collect::<Vec<_>>());
    let lookups: Option<Vec<_>> = samples.iter().map(|([x, y], _)| layer_weights(seen, *x, *y)).collect();
    let Some(lookups) = lookups.filter(|lookups| !lookups.is_empty()) else {
        return Ok(());
    };
    let covariance = |pixel: [f64; 2], lookup: &[(usize, f64); 4]| -> f64 {
        lookup.iter().map(|&(other, weight)| weight * offset_covariance(pixel, pixel_center(other))).sum()
    };
    let gram = DMatrix::from_fn(samples.len(), samples.len(), |i, j| {
        let sum: f64 =
            lookups[i].iter().map(|&(pixel, weight)| weight * covariance(pixel_center(pixel), &lookups[j])).sum();
        sum + if i == j { NOISE * NOISE } else { 0.0 }
    });
    let residual = samples.iter().zip(&lookups).map(|(s, lookup)| s.1 - sample(h, lookup));
    let weights = Cholesky::new(gram)
        .ok_or(Error::Singular { what: "depth samples", size: samples.len() })?
        .solve(&DVector::from_iterator(samples.len(), residual));
    for (pixel, value) in h.iter_mut().enumerate() {
        let center = pixel_center(pixel);
        let change: f64 =
            lookups.iter().zip(weights.iter()).map(|(lookup, weight)| weight * covariance(center, lookup)).sum();
        *value += change as f32;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_met_exactly_whatever_the_network_said() {
        let mut h: Vec<f32> = (0..MAP_PIXELS).map(|p| ((p * 37 % 101) as f32) * 0.01).collect();
        let mut seen = vec![true; MAP_PIXELS];
        seen[..MAP_PIXELS / 2].fill(false);
        let samples = [[0.5, -0.25, 0.7], [-2.0, -1.0, -0.4], [2.5, -3.0, 0.1], [2.4, -3.0, 0.12], [0.0, 0.0, 0.3]];
        let before = h.clone();
        meet(&mut h, &seen, &samples).unwrap();
        for [x, y, value] in samples {
            assert!((sample(&h, &layer_weights(&seen, x, y).unwrap()) - value).abs() < 1e-3);
        }
        assert_ne!(h, before);
        let met = h.clone();
        meet(&mut h, &seen, &[]).unwrap();
        meet(&mut h, &vec![false; MAP_PIXELS], &samples).unwrap();
        assert_eq!(h, met);
        let again = h.clone();
        meet(&mut h, &seen, &samples).unwrap();
        let change = h.iter().zip(&again).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(change < 2e-2, "a map that meets the samples stays: {change}");
    }

    #[test]
    fn two_samples_at_one_place_are_averaged() {
        let mut h = vec![0.0; MAP_PIXELS];
        let seen = vec![true; MAP_PIXELS];
        meet(&mut h, &seen, &[[1.0, 1.0, 0.2], [1.0, 1.0, 0.4]]).unwrap();
        assert!((sample(&h, &bilinear(1.0, 1.0)) - 0.3).abs() < 1e-3);
    }
}
