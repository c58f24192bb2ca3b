//! The maps that the networks read and write, and where their pixels lie; the contract with `training/`.
//!
//! A map is n x n, row-major, row 0 at the top, and covers the canonical square [-H, H]^2 of the raster. Pixel (r, c) has its
//! centre at x = -H + (c + 0.5) 2H/n, y = H - (r + 0.5) 2H/n.

/// Rows and columns of a network map.
pub const MAP_SIZE: usize = 64;

/// Pixels of a network map.
pub const MAP_PIXELS: usize = MAP_SIZE * MAP_SIZE;

/// Channels of strokes and regions: proximity to the four kinds of stroke, coverage of the four kinds of region, feature
/// direction.
pub const STROKE_CHANNELS: usize = 10;

/// Channel of the proximity to contours.
pub(super) const CONTOUR_CHANNEL: usize = 2;

/// First of the coverage channels: visible front, visible back, occluded front, occluded back.
pub(super) const COVERAGE_CHANNEL: usize = 4;

/// Half the side of the square that a map covers, canonical units: 256 pixels with a margin of 12 on each side of 8 units.
pub const MAP_HALF: f64 = 4.0 * 256.0 / 232.0;

/// One channel of channel-major maps.
pub(super) fn channel(maps: &[f32], index: usize) -> &[f32] {
    &maps[index * MAP_PIXELS..(index + 1) * MAP_PIXELS]
}

/// Centre of pixel `index` (row-major), canonical x, y.
pub fn pixel_center(index: usize) -> [f64; 2] {
    let step = 2.0 * MAP_HALF / MAP_SIZE as f64;
    let (row, column) = (index / MAP_SIZE, index % MAP_SIZE);
    [-MAP_HALF + (column as f64 + 0.5) * step, MAP_HALF - (row as f64 + 0.5) * step]
}

/// The four pixels around a canonical point and their bilinear weights, which sum to 1.
///
/// Points beyond the outermost pixel centres take the values at the border of the map (PyTorch's `grid_sample` with
/// `align_corners=False, padding_mode="border"`).
pub fn bilinear(x: f64, y: f64) -> [(usize, f64); 4] {
    let place = |t: f64| (t * MAP_SIZE as f64 / (2.0 * MAP_HALF) - 0.5).clamp(0.0, (MAP_SIZE - 1) as f64);
    let (column, row) = (place(x + MAP_HALF), place(MAP_HALF - y));
    // The last pixel is reached with weight 1 from the one before it.
    let (c, r) = [column, row].map(|t| (t as usize).min(MAP_SIZE - 2)).into();
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
        let map: Vec<f32> = (0..MAP_PIXELS)
            .map(|p| {
                let [x, y] = pixel_center(p);
                (0.3 * x - 0.7 * y + 0.2) as f32
            })
            .collect();
        for [x, y] in [[0.0, 0.0], [1.234, -3.21], [-4.1, 4.2], pixel_center(0), pixel_center(MAP_PIXELS - 1)] {
            assert!((sample(&map, &bilinear(x, y)) - (0.3 * x - 0.7 * y + 0.2)).abs() < 1e-5, "{x} {y}");
        }
        assert_eq!(sample(&map, &bilinear(-99.0, 99.0)) as f32, map[0]);
        assert_eq!(sample(&map, &bilinear(99.0, -99.0)) as f32, map[MAP_PIXELS - 1]);
        let total: f64 = bilinear(0.77, -1.3).iter().map(|w| w.1).sum();
        assert!((total - 1.0).abs() < 1e-15);
    }

    #[test]
    fn the_strokes_fill_the_map_but_for_the_margin() {
        // 12 of 256 pixels on each side of a sketch of 8 units.
        let margin = MAP_HALF - 4.0;
        assert!((margin / (2.0 * MAP_HALF) * 256.0 - 12.0).abs() < 1e-12);
        let [x, y] = pixel_center(MAP_SIZE - 1);
        assert!(x > 0.0 && y > 0.0 && (x - y).abs() < 1e-12);
    }
}
