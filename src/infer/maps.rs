//! How the networks' maps are read between their pixels; [`crate::sketch::Raster`] says where those lie.

use crate::sketch::{MAP_SIZE, map_coordinates, map_position};

/// Pixels of a network map.
pub const MAP_PIXELS: usize = MAP_SIZE * MAP_SIZE;

/// Channel of [`crate::sketch::Raster`] with the proximity to contours.
pub(super) const CONTOUR_CHANNEL: usize = 2;

/// First of its coverage channels: visible front, visible back, occluded front, occluded back.
pub(super) const COVERAGE_CHANNEL: usize = 4;

/// One channel of channel-major maps.
pub(super) fn channel(maps: &[f32], index: usize) -> &[f32] {
    &maps[index * MAP_PIXELS..(index + 1) * MAP_PIXELS]
}

/// Canonical x, y of the centre of pixel `index` (row-major).
pub fn pixel_center(index: usize) -> [f64; 2] {
    map_position(index / MAP_SIZE, index % MAP_SIZE, MAP_SIZE)
}

/// The four pixels around a canonical point and their bilinear weights, which sum to 1.
///
/// Points beyond the outermost pixel centres take the values at the border of the map (PyTorch's `grid_sample` with
/// `align_corners=False, padding_mode="border"`).
pub fn bilinear(x: f64, y: f64) -> [(usize, f64); 4] {
    let [row, column] = map_coordinates([x, y], MAP_SIZE).map(|t| t.clamp(0.0, (MAP_SIZE - 1) as f64));
    // The last pixel is reached with weight 1 from the one before it.
    let [r, c] = [row, column].map(|t| (t as usize).min(MAP_SIZE - 2));
    let (u, v) = (column - c as f64, row - r as f64);
    let index = r * MAP_SIZE + c;
    [
        (index, (1.0 - u) * (1.0 - v)),
        (index + 1, u * (1.0 - v)),
        (index + MAP_SIZE, (1.0 - u) * v),
        (index + MAP_SIZE + 1, u * v),
    ]
}

/// Value of a map at weighted pixels.
pub(super) fn sample(map: &[f32], weights: &[(usize, f64)]) -> f64 {
    weights.iter().map(|&(pixel, weight)| weight * f64::from(map[pixel])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bilinear_reproduces_linear_maps_and_clamps_outside() {
        let linear = |[x, y]: [f64; 2]| 0.3 * x - 0.7 * y + 0.2;
        let map: Vec<f32> = (0..MAP_PIXELS).map(|pixel| linear(pixel_center(pixel)) as f32).collect();
        for p in [[0.0, 0.0], [1.234, -3.21], [-4.1, 4.2], pixel_center(0), pixel_center(MAP_PIXELS - 1)] {
            assert!((sample(&map, &bilinear(p[0], p[1])) - linear(p)).abs() < 1e-5, "{p:?}");
        }
        assert_eq!(sample(&map, &bilinear(-99.0, 99.0)) as f32, map[0]);
        assert_eq!(sample(&map, &bilinear(99.0, -99.0)) as f32, map[MAP_PIXELS - 1]);
        let total: f64 = bilinear(0.77, -1.3).iter().map(|w| w.1).sum();
        assert!((total - 1.0).abs() < 1e-15);
    }
}
