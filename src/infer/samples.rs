//! What depth samples tell before any network has looked: a Gaussian process over the depth offset.
//!
//! The prior of the offset h over canonical points p is a constant, a plane and a smooth bump, with covariance
//!
//! k(p, q) = 1.0^2 + 0.35^2 p . q + 0.8^2 exp(-|p - q|^2 / (2 * 2.0^2)).
//!
//! Its posterior given the samples goes into VD-Net and OD-Net, which predict in units of the posterior's deviation and so
//! change least where a sample lies. What still differs at a sample is removed afterwards, see [`meet`].

use super::maps::{MAP_PIXELS, bilinear, pixel_center, sample};
use crate::error::Error;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Deviation of a sample's depth, canonical units: people point, they do not measure.
const NOISE: f64 = 0.02;

/// As [`NOISE`], for [`meet`]: small enough to count as met, large enough for two samples at one place.
const MEET_NOISE: f64 = 1e-4;

/// Covariance of the prior.
fn kernel(p: [f64; 2], q: [f64; 2]) -> f64 {
    let squared = (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
    1.0 + 0.35 * 0.35 * (p[0] * q[0] + p[1] * q[1]) + 0.8 * 0.8 * (-squared / (2.0 * 2.0 * 2.0)).exp()
}

fn factorize(matrix: DMatrix<f64>) -> Result<Cholesky<f64, Dyn>, Error> {
    let size = matrix.nrows();
    Cholesky::new(matrix).ok_or(Error::Singular { what: "depth samples", size })
}

/// Posterior mean and deviation at each map pixel, canonical units.
///
/// - `samples`: x, y, h.
///
/// # Errors
/// [`Error::Singular`] if a sample is not finite.
pub fn posterior(samples: &[[f64; 3]]) -> Result<(Vec<f32>, Vec<f32>), Error> {
    let count = samples.len();
    let point = |i: usize| [samples[i][0], samples[i][1]];
    let gram =
        DMatrix::from_fn(count, count, |i, j| kernel(point(i), point(j)) + if i == j { NOISE * NOISE } else { 0.0 });
    let factor = factorize(gram)?;
    let weights = factor.solve(&DVector::from_iterator(count, samples.iter().map(|sample| sample[2])));
    let (mut mean, mut deviation) = (Vec::with_capacity(MAP_PIXELS), Vec::with_capacity(MAP_PIXELS));
    for pixel in 0..MAP_PIXELS {
        let center = pixel_center(pixel);
        let covariance = DVector::from_fn(count, |i, _| kernel(center, point(i)));
        mean.push(covariance.dot(&weights) as f32);
        let known = factor.l_dirty().solve_lower_triangular(&covariance).map_or(0.0, |half| half.norm_squared());
        deviation.push((kernel(center, center) - known).max(0.0).sqrt() as f32);
    }
    Ok((mean, deviation))
}

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
///
/// - `h`: depth offset of a layer, one value per map pixel.
/// - `seen`: where that layer is; nothing happens if that is nowhere.
/// - `samples`: x, y, h.
///
/// # Errors
/// [`Error::Singular`] if a sample is not finite.
pub fn meet(h: &mut [f32], seen: &[bool], samples: &[[f64; 3]]) -> Result<(), Error> {
    let lookups: Option<Vec<_>> = samples.iter().map(|sample| layer_weights(seen, sample[0], sample[1])).collect();
    let Some(lookups) = lookups.filter(|lookups| !lookups.is_empty()) else {
        return Ok(());
    };
    let covariance = |pixel: [f64; 2], lookup: &[(usize, f64); 4]| -> f64 {
        lookup.iter().map(|&(other, weight)| weight * kernel(pixel, pixel_center(other))).sum()
    };
    let gram = DMatrix::from_fn(samples.len(), samples.len(), |i, j| {
        let sum: f64 =
            lookups[i].iter().map(|&(pixel, weight)| weight * covariance(pixel_center(pixel), &lookups[j])).sum();
        sum + if i == j { MEET_NOISE * MEET_NOISE } else { 0.0 }
    });
    let residual = samples.iter().zip(&lookups).map(|(s, lookup)| s[2] - sample(h, lookup));
    let weights = factorize(gram)?.solve(&DVector::from_iterator(samples.len(), residual));
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
    fn without_samples_the_prior_remains() {
        let (mean, deviation) = posterior(&[]).unwrap();
        assert!(mean.iter().all(|&m| m == 0.0));
        for pixel in [0, 100, 2080, MAP_PIXELS - 1] {
            let p = pixel_center(pixel);
            let expected = (1.0 + 0.35 * 0.35 * (p[0] * p[0] + p[1] * p[1]) + 0.64).sqrt();
            assert!((f64::from(deviation[pixel]) - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn the_posterior_meets_samples_and_is_sure_of_itself_there() {
        let samples = [[0.5, 0.25, 0.7], [-2.0, 1.0, -0.4], [2.5, -3.0, 0.1]];
        let (mean, deviation) = posterior(&samples).unwrap();
        for [x, y, h] in samples {
            let weights = bilinear(x, y);
            assert!((sample(&mean, &weights) - h).abs() < 0.01);
            assert!(sample(&deviation, &weights) < 0.05);
        }
        let (_, prior) = posterior(&[]).unwrap();
        assert!(deviation.iter().zip(&prior).all(|(a, b)| a <= b));
    }

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
    fn two_samples_at_one_place_are_averaged_and_a_bad_one_is_an_error() {
        let mut h = vec![0.0; MAP_PIXELS];
        let seen = vec![true; MAP_PIXELS];
        meet(&mut h, &seen, &[[1.0, 1.0, 0.2], [1.0, 1.0, 0.4]]).unwrap();
        assert!((sample(&h, &bilinear(1.0, 1.0)) - 0.3).abs() < 1e-3);
        assert!(matches!(posterior(&[[f64::NAN, 0.0, 0.0]]), Err(Error::Singular { .. })));
    }
}
