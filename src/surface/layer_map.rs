//! Depth and normals of one layer as maps, and how they are read between and beyond their pixels.

use crate::error::Error;
use nalgebra::Vector3;

/// Rings of pixels by which a map is continued beyond its mask.
pub const EXTRAPOLATED_RINGS: usize = 3;
/// Steepest slope that is extrapolated: 80 degrees; near a contour the true slope is infinite.
const STEEPEST: f64 = 5.7;

/// Depth and normals of one layer (visible or occluded) on a square raster over the canonical square [-H, H]^2.
///
/// Pixel (row, column) of an n x n map has its centre at x = -H + (column + 0.5) 2H / n, y = H - (row + 0.5) 2H / n. Rows
/// one after another, from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMap {
    /// Pixels along a side, n.
    pub size: usize,
    /// Half the side of the square, H, canonical units.
    pub half_extent: f64,
    /// Depth -z, canonical units; only read where `valid`.
    pub depth: Vec<f64>,
    /// Unit front-side normal in the camera frame: z > 0 where the front faces the viewer; only read where `valid`.
    pub normal: Vec<Vector3<f64>>,
    /// Whether the layer has a surface at the pixel.
    pub valid: Vec<bool>,
    /// Whether its front faces the viewer there.
    pub front: Vec<bool>,
}

/// A map read at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapSample {
    /// Depth -z.
    pub depth: f64,
    /// Its derivatives in x and y.
    pub gradient: [f64; 2],
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Rings of pixels beyond the mask, 0 inside, up to [`EXTRAPOLATED_RINGS`].
    pub beyond: f64,
}

impl LayerMap {
    /// Checks and takes a map; a pixel is valid where the two coverages sum to at least one half.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if lengths disagree, [`Error::NotFinite`] for a bad value at a valid pixel.
    pub fn new(
        half_extent: f64,
        depth: Vec<f64>,
        normal: Vec<Vector3<f64>>,
        front_coverage: &[f64],
        back_coverage: &[f64],
    ) -> Result<Self, Error> {
        let size = depth.len().isqrt();
        let count = size * size;
        let lengths = [depth.len(), normal.len(), front_coverage.len(), back_coverage.len()];
        if lengths.iter().any(|&l| l != count) || count == 0 || half_extent.is_nan() || half_extent <= 0.0 {
            return Err(Error::Degenerate { reason: format!("layer maps of {lengths:?} pixels over {half_extent}") });
        }
        let valid: Vec<bool> = front_coverage.iter().zip(back_coverage).map(|(f, b)| f + b >= 0.5).collect();
        let front = front_coverage.iter().zip(back_coverage).map(|(f, b)| f >= b).collect();
        let finite = |k: usize| depth[k].is_finite() && normal[k].iter().all(|x| x.is_finite());
        if let Some(index) = (0..count).find(|&k| valid[k] && !finite(k)) {
            return Err(Error::NotFinite { what: "layer map pixel", index });
        }
        Ok(Self { size, half_extent, depth, normal, valid, front })
    }

    /// A map without any surface.
    pub fn empty(size: usize, half_extent: f64) -> Self {
        let count = size * size;
        Self {
            size,
            half_extent,
            depth: vec![0.0; count],
            normal: vec![Vector3::z(); count],
            valid: vec![false; count],
            front: vec![true; count],
        }
    }

    /// Side of a pixel, canonical units.
    pub fn pixel(&self) -> f64 {
        2.0 * self.half_extent / self.size as f64
    }

    /// Centre (x, y) of the pixel with index `k`.
    pub fn center(&self, k: usize) -> [f64; 2] {
        let (row, column, pixel) = (k / self.size, k % self.size, self.pixel());
        [-self.half_extent + (column as f64 + 0.5) * pixel, self.half_extent - (row as f64 + 0.5) * pixel]
    }

    /// The point (x, y) in pixels from the centre of pixel 0: [column, row].
    pub fn to_pixels(&self, p: [f64; 2]) -> [f64; 2] {
        let pixel = self.pixel();
        [(p[0] + self.half_extent) / pixel - 0.5, (self.half_extent - p[1]) / pixel - 0.5]
    }

    /// The part of the map whose front (or back) faces the viewer, continued by [`EXTRAPOLATED_RINGS`] pixels.
    pub fn side(&self, front: bool) -> MapSide {
        MapSide::new(self, front)
    }
}

/// The pixels of a [`LayerMap`] with one orientation, continued beyond their mask by the local gradient.
#[derive(Clone, Debug)]
pub struct MapSide {
    size: usize,
    half_extent: f64,
    pixel: f64,
    depth: Vec<f64>,
    normal: Vec<Vector3<f64>>,
    /// 0 inside the mask, 1.. for the rings around it, `u8::MAX` beyond.
    ring: Vec<u8>,
    /// For each pixel the nearest pixel of the mask; empty if the mask is.
    nearest: Vec<u32>,
}

impl MapSide {
    fn new(map: &LayerMap, front: bool) -> Self {
        let n = map.size;
        let count = n * n;
        let pixel = map.pixel();
        let mut ring: Vec<u8> =
            (0..count).map(|k| if map.valid[k] && map.front[k] == front { 0 } else { u8::MAX }).collect();
        if ring.iter().all(|&level| level > 0) {
            let (depth, normal, nearest) = (vec![], vec![], vec![]);
            return Self { size: n, half_extent: map.half_extent, pixel, depth, normal, ring, nearest };
        }
        let mut depth = map.depth.clone();
        let mut normal = map.normal.clone();

        // Slopes inside by differences, one-sided at the rim.
        let mut slope = vec![[0.0; 2]; count];
        for k in (0..count).filter(|&k| ring[k] == 0) {
            let (row, column) = (k / n, k % n);
            let difference = |low: Option<usize>, high: Option<usize>| {
                let inside = |q: Option<usize>| q.filter(|&q| ring[q] == 0);
                match (inside(low), inside(high)) {
                    (Some(a), Some(b)) => (map.depth[b] - map.depth[a]) / (2.0 * pixel),
                    (Some(a), None) => (map.depth[k] - map.depth[a]) / pixel,
                    (None, Some(b)) => (map.depth[b] - map.depth[k]) / pixel,
                    (None, None) => 0.0,
                }
            };
            let horizontal = difference((column > 0).then(|| k - 1), (column + 1 < n).then_some(k + 1));
            let vertical = difference((row + 1 < n).then_some(k + n), (row > 0).then(|| k - n));
            slope[k] = clamped([horizontal, vertical]);
        }

        let neighbours = |k: usize| {
            let (row, column) = ((k / n) as isize, (k % n) as isize);
            (-1..=1).flat_map(move |dr: isize| (-1..=1).map(move |dc: isize| (dr, dc))).filter_map(move |(dr, dc)| {
                let (r, c) = (row + dr, column + dc);
                let inside = (0..n as isize).contains(&r) && (0..n as isize).contains(&c) && (dr, dc) != (0, 0);
                inside.then(|| ((r * n as isize + c) as usize, dc as f64, -dr as f64))
            })
        };
        for level in 1..=EXTRAPOLATED_RINGS as u8 {
            let mut found = vec![];
            for k in (0..count).filter(|&k| ring[k] == u8::MAX) {
                let (mut total, mut value, mut gradient, mut direction) = (0.0, 0.0, [0.0; 2], Vector3::zeros());
                for (q, dx, dy) in neighbours(k).filter(|&(q, ..)| ring[q] < level) {
                    let weight = if dx * dy == 0.0 { 1.0 } else { 0.5 };
                    total += weight;
                    value += weight * (depth[q] - (slope[q][0] * dx + slope[q][1] * dy) * pixel);
                    gradient[0] += weight * slope[q][0];
                    gradient[1] += weight * slope[q][1];
                    direction += normal[q] * weight;
                }
                if total > 0.0 {
                    found.push((k, value / total, gradient.map(|g| g / total), direction));
                }
            }
            for (k, value, gradient, direction) in found {
                ring[k] = level;
                depth[k] = value;
                slope[k] = gradient;
                normal[k] = direction.try_normalize(1e-9).unwrap_or(Vector3::z());
            }
        }
        let nearest = nearest_inside(n, &ring);
        Self { size: n, half_extent: map.half_extent, pixel, depth, normal, ring, nearest }
    }

    /// Whether the side has no pixel at all.
    pub fn is_empty(&self) -> bool {
        self.nearest.is_empty()
    }

    /// Reads the map at (x, y), bilinear; `None` more than [`EXTRAPOLATED_RINGS`] pixels beyond the mask.
    pub fn sample(&self, p: [f64; 2]) -> Option<MapSample> {
        let n = self.size;
        let column = ((p[0] + self.half_extent) / self.pixel - 0.5).clamp(0.0, n as f64 - 1.0);
        let row = ((self.half_extent - p[1]) / self.pixel - 0.5).clamp(0.0, n as f64 - 1.0);
        if self.nearest.is_empty() || column.is_nan() || row.is_nan() {
            return None;
        }
        let (c, r) = ((column as usize).min(n - 2), (row as usize).min(n - 2));
        let (s, t) = (column - c as f64, row - r as f64);
        let k = r * n + c;
        let corners = [k, k + 1, k + n, k + n + 1];
        if corners.iter().any(|&q| self.ring[q] == u8::MAX) {
            return None;
        }
        let [a, b, e, f] = corners.map(|q| self.depth[q]);
        let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        let depth = weights[0] * a + weights[1] * b + weights[2] * e + weights[3] * f;
        let gradient =
            [((b - a) * (1.0 - t) + (f - e) * t) / self.pixel, -((e - a) * (1.0 - s) + (f - b) * s) / self.pixel];
        let direction: Vector3<f64> = (0..4).map(|i| self.normal[corners[i]] * weights[i]).sum();
        let normal = direction.try_normalize(1e-9).unwrap_or(self.normal[k]);
        let beyond = (0..4).map(|i| weights[i] * f64::from(self.ring[corners[i]])).sum();
        Some(MapSample { depth, gradient, normal, beyond })
    }

    /// Vector (x, y) from `p` to the mask and its length in pixels: zero within half a pixel of a mask pixel's centre.
    pub fn outside(&self, p: [f64; 2]) -> Option<([f64; 2], f64)> {
        let n = self.size;
        let column = ((p[0] + self.half_extent) / self.pixel).clamp(0.0, n as f64 - 1.0) as usize;
        let row = ((self.half_extent - p[1]) / self.pixel).clamp(0.0, n as f64 - 1.0) as usize;
        let nearest = *self.nearest.get(row * n + column)? as usize;
        let x = -self.half_extent + ((nearest % n) as f64 + 0.5) * self.pixel - p[0];
        let y = self.half_extent - ((nearest / n) as f64 + 0.5) * self.pixel - p[1];
        let length = x.hypot(y);
        let beyond = (length - 0.5 * self.pixel).max(0.0);
        Some(([x, y].map(|d| if length > 0.0 { d * beyond / length } else { 0.0 }), beyond / self.pixel))
    }
}

fn clamped(slope: [f64; 2]) -> [f64; 2] {
    let length = slope[0].hypot(slope[1]);
    if length > STEEPEST { slope.map(|s| s * STEEPEST / length) } else { slope }
}

/// For each pixel the nearest one of ring 0, of which there is one, exactly, by two passes over rows and columns.
fn nearest_inside(n: usize, ring: &[u8]) -> Vec<u32> {
    // Nearest mask pixel within each row, then the best row for each column.
    let mut in_row = vec![u32::MAX; n * n];
    for r in 0..n {
        let mut last = None;
        for c in 0..n {
            if ring[r * n + c] == 0 {
                last = Some(c);
            }
            if let Some(q) = last {
                in_row[r * n + c] = q as u32;
            }
        }
        let mut next: Option<usize> = None;
        for c in (0..n).rev() {
            if ring[r * n + c] == 0 {
                next = Some(c);
            }
            if let Some(q) = next {
                let slot = &mut in_row[r * n + c];
                if *slot == u32::MAX || q - c < c.abs_diff(*slot as usize) {
                    *slot = q as u32;
                }
            }
        }
    }
    let mut nearest = vec![0; n * n];
    for c in 0..n {
        for r in 0..n {
            let mut best = usize::MAX;
            // Rows from here outwards, until they alone are farther than the best pixel.
            for offset in 0..n {
                if offset * offset >= best {
                    break;
                }
                for q in [r.checked_sub(offset), Some(r + offset).filter(|&q| q < n)].into_iter().flatten() {
                    let column = in_row[q * n + c];
                    if column == u32::MAX {
                        continue;
                    }
                    let squared = offset * offset + c.abs_diff(column as usize).pow(2);
                    if squared < best {
                        best = squared;
                        nearest[r * n + c] = (q * n) as u32 + column;
                    }
                }
            }
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disk() -> LayerMap {
        let (n, half) = (64, 4.4);
        let mut map = LayerMap::empty(n, half);
        for k in 0..n * n {
            let [x, y] = map.center(k);
            map.valid[k] = x.hypot(y) < 3.0;
            map.front[k] = true;
            map.depth[k] = if map.valid[k] { 1.0 + 0.5 * x - 0.25 * y } else { f64::NAN };
            map.normal[k] = Vector3::new(0.5, -0.25, 1.0).normalize();
        }
        map
    }

    #[test]
    fn a_plane_is_read_exactly_even_beyond_the_mask() {
        let map = disk();
        let side = map.side(true);
        for p in [[0.3, 0.7], [-2.1, 2.0], [3.2, 0.05], [0.0, -3.25], [2.3, 2.2]] {
            let sample = side.sample(p).unwrap();
            assert!((sample.depth - (1.0 + 0.5 * p[0] - 0.25 * p[1])).abs() < 1e-9, "{p:?} {}", sample.depth);
            assert!((sample.gradient[0] - 0.5).abs() < 1e-9 && (sample.gradient[1] + 0.25).abs() < 1e-9);
        }
        assert!(side.sample([4.0, 0.0]).is_none());
        assert!(map.side(false).is_empty() && map.side(false).sample([0.0, 0.0]).is_none());
    }

    #[test]
    fn the_way_back_to_the_mask_is_short() {
        let map = disk();
        let side = map.side(true);
        let ([x, y], pixels) = side.outside([4.0, 0.0]).unwrap();
        assert!((x + 1.0).abs() < 0.15 && y.abs() < 0.15 && (pixels * map.pixel() - x.hypot(y)).abs() < 1e-12);
        assert_eq!(side.outside([1.0, 1.0]).unwrap().1, 0.0);
    }

    #[test]
    fn gradients_are_the_derivatives_of_the_depth() {
        let mut map = disk();
        for k in 0..map.depth.len() {
            let [x, y] = map.center(k);
            map.depth[k] = (x * 0.9).sin() * (y * 0.7).cos();
        }
        let side = map.side(true);
        let h = 1e-6;
        for p in [[0.31, 0.72], [-2.1, 1.03]] {
            let at = |dx: f64, dy: f64| side.sample([p[0] + dx, p[1] + dy]).unwrap().depth;
            let gradient = side.sample(p).unwrap().gradient;
            assert!(((at(h, 0.0) - at(-h, 0.0)) / (2.0 * h) - gradient[0]).abs() < 1e-6);
            assert!(((at(0.0, h) - at(0.0, -h)) / (2.0 * h) - gradient[1]).abs() < 1e-6);
        }
    }
}
