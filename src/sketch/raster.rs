//! Regions and strokes to the maps that the networks read; the contract with `training/`.
//!
//! The maps cover the canonical square [-H, H]^2, row 0 at the top, and are stored channel after channel, row after row.

use super::polyline::{Point, closest_fraction, distance, lerp, sub};
use super::stroke::StrokeKind;
use super::view::View;
use super::visibility::{CANONICAL_PER_PX, Orientation, PatchSketch, Region};

/// Half the side of the square that the canvas covers: 128 pixels, canonical units; the strokes fill 116 of them.
pub const CANVAS_HALF_WIDTH: f64 = 128.0 * CANONICAL_PER_PX;
/// Pixels per side of the canvas in which stroke widths and distances are meant.
pub const CANVAS_SIZE: usize = 256;
/// Pixels per side of the networks' maps.
pub const MAP_SIZE: usize = 64;
/// Channels of [`rasterize`].
pub const STROKE_CHANNELS: usize = 10;
/// Distance at which the proximity channels have fallen to one half, pixels of the 256 canvas.
const PROXIMITY_PX: f64 = 8.0;

/// Canonical x, y of the centre of pixel (`row`, `column`) in an `n` x `n` map.
pub fn map_position(row: usize, column: usize, n: usize) -> [f64; 2] {
    let step = 2.0 * CANVAS_HALF_WIDTH / n as f64;
    [-CANVAS_HALF_WIDTH + (column as f64 + 0.5) * step, CANVAS_HALF_WIDTH - (row as f64 + 0.5) * step]
}

/// Row and column of an `n` x `n` map, as fractions, where pixel centres have whole numbers; inverse of [`map_position`].
pub fn map_coordinates(position: [f64; 2], n: usize) -> [f64; 2] {
    let step = 2.0 * CANVAS_HALF_WIDTH / n as f64;
    [(CANVAS_HALF_WIDTH - position[1]) / step - 0.5, (position[0] + CANVAS_HALF_WIDTH) / step - 0.5]
}

/// Depth that a horizontal plane gains per unit of canonical y: the cotangent of the elevation.
///
/// Elevations below 10 degrees count as 10, where the horizontal plane stops being a useful reference.
pub fn horizontal_slope(view: &View) -> f64 {
    let elevation = view.elevation_rad();
    let limit = 10f64.to_radians();
    1.0 / if elevation < 0.0 { elevation.min(-limit) } else { elevation.max(limit) }.tan()
}

/// The stroke channels of the networks' input: [`STROKE_CHANNELS`] maps of [`MAP_SIZE`] x [`MAP_SIZE`].
///
/// - 0-3: proximity 8 / (8 + d) to visible boundary, occluded boundary, contour and feature strokes; d is the distance in
///   pixels of the 256 canvas from the pixel's centre to the nearest stroke of the kind, 0 where there is none.
/// - 4-7: coverage in [0, 1] by visible-front, visible-back, occluded-front and occluded-back regions, over the 4 x 4
///   canvas pixels of the map pixel.
/// - 8-9: channel 3 times (cos 2t, sin 2t), t the angle of the nearest feature line's tangent there.
///
/// # Source
/// Instead of the paper's RGB rendering and four binary masks (Sec. 3.2), which [`paper_raster`] and the coverage give.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    /// The values, channel, row, column.
    pub data: Vec<f32>,
}

impl Raster {
    /// One channel, row after row.
    pub fn channel(&self, channel: usize) -> &[f32] {
        &self.data[channel * MAP_SIZE * MAP_SIZE..][..MAP_SIZE * MAP_SIZE]
    }

    /// Share of map pixel `index` (row * [`MAP_SIZE`] + column) that the visible surface covers.
    pub fn visible_coverage(&self, index: usize) -> f32 {
        self.channel(4)[index] + self.channel(5)[index]
    }

    /// Share of map pixel `index` that the occluded surface covers.
    pub fn occluded_coverage(&self, index: usize) -> f32 {
        self.channel(6)[index] + self.channel(7)[index]
    }

    /// Side of the visible surface at map pixel `index`, the larger share deciding; `None` outside the surface.
    pub fn visible_at(&self, index: usize) -> Option<Orientation> {
        side(self.channel(4)[index], self.channel(5)[index])
    }

    /// Side of the occluded surface at map pixel `index`, the larger share deciding; `None` where there is none.
    pub fn occluded_at(&self, index: usize) -> Option<Orientation> {
        side(self.channel(6)[index], self.channel(7)[index])
    }
}

fn side(front: f32, back: f32) -> Option<Orientation> {
    (front + back > 0.0).then_some(if front >= back { Orientation::Front } else { Orientation::Back })
}

/// Draws the maps of [`Raster`].
pub fn rasterize(patch: &PatchSketch) -> Raster {
    let count = MAP_SIZE * MAP_SIZE;
    let mut data = vec![0f32; STROKE_CHANNELS * count];
    for (channel, kind) in StrokeKind::ALL.into_iter().enumerate() {
        let lines: Vec<&[Point]> =
            patch.strokes.iter().filter(|s| s.kind == kind).map(|s| s.points.as_slice()).collect();
        let Some(lines) = Lines::new(&lines) else { continue };
        let mut nearest = 0;
        for index in 0..count {
            // Along a row the last segment found is a good first guess; rows go back and forth.
            let (row, step) = (index / MAP_SIZE, index % MAP_SIZE);
            let column = if row % 2 == 0 { step } else { MAP_SIZE - 1 - step };
            let p = map_position(row, column, MAP_SIZE);
            let pixel = row * MAP_SIZE + column;
            let square;
            (nearest, square) = lines.nearest(p, nearest);
            let proximity = PROXIMITY_PX / (PROXIMITY_PX + square.sqrt() / CANONICAL_PER_PX);
            data[channel * count + pixel] = proximity as f32;
            if kind == StrokeKind::Feature {
                let [a, b] = lines.segments[nearest];
                let [x, y] = sub(b, a);
                let norm = (x * x + y * y).max(f64::MIN_POSITIVE);
                data[8 * count + pixel] = (proximity * (x * x - y * y) / norm) as f32;
                data[9 * count + pixel] = (proximity * 2.0 * x * y / norm) as f32;
            }
        }
    }
    for (channel, visible, side) in [
        (4, true, Orientation::Front),
        (5, true, Orientation::Back),
        (6, false, Orientation::Front),
        (7, false, Orientation::Back),
    ] {
        let chosen =
            patch.regions.iter().filter(|r| if visible { r.visible == side } else { r.occluded == Some(side) });
        data[channel * count..(channel + 1) * count].copy_from_slice(&coverage(chosen));
    }
    Raster { data }
}

/// Share of each of the [`MAP_SIZE`] x [`MAP_SIZE`] pixels that the regions cover, by the centres of 4 x 4 canvas pixels.
pub fn coverage<'a>(regions: impl IntoIterator<Item = &'a Region>) -> Vec<f32> {
    let mut result = vec![0f32; MAP_SIZE * MAP_SIZE];
    let share = CANVAS_SIZE / MAP_SIZE;
    for region in regions {
        for (row, column) in canvas_pixels(region) {
            result[row / share * MAP_SIZE + column / share] += 1.0 / (share * share) as f32;
        }
    }
    result
}

/// Canvas pixels (row, column) whose centres lie in the region.
pub fn canvas_pixels(region: &Region) -> Vec<(usize, usize)> {
    let mut crossings: Vec<Vec<f64>> = vec![vec![]; CANVAS_SIZE];
    for ring in &region.rings {
        let mut a = map_coordinates(ring[ring.len() - 1], CANVAS_SIZE);
        for &p in ring {
            let b = map_coordinates(p, CANVAS_SIZE);
            let (low, high) = (a[0].min(b[0]), a[0].max(b[0]));
            // Half-open, so that a vertex on a row counts once.
            let first = low.ceil().max(0.0) as usize;
            for row in (first..CANVAS_SIZE).take_while(|&r| (r as f64) < high) {
                let t = (row as f64 - a[0]) / (b[0] - a[0]);
                crossings[row].push(a[1] + t * (b[1] - a[1]));
            }
            a = b;
        }
    }
    let mut pixels = vec![];
    for (row, list) in crossings.iter_mut().enumerate() {
        list.sort_by(f64::total_cmp);
        for pair in list.chunks_exact(2) {
            let first = pair[0].ceil().max(0.0) as usize;
            pixels.extend((first..CANVAS_SIZE).take_while(|&c| (c as f64) < pair[1]).map(|c| (row, c)));
        }
    }
    pixels
}

/// Segments in chunks with bounding circles, for exact nearest queries.
struct Lines {
    segments: Vec<[Point; 2]>,
    chunks: Vec<Chunk>,
}

struct Chunk {
    center: Point,
    radius: f64,
    from: usize,
    to: usize,
}

/// Segments per chunk.
const CHUNK: usize = 12;
/// Straightening that no map can show, canonical units (a hundredth of a pixel).
const STRAIGHT: f64 = 0.01 * CANONICAL_PER_PX;

impl Lines {
    /// `None` without any segment.
    fn new(lines: &[&[Point]]) -> Option<Self> {
        let mut segments: Vec<[Point; 2]> = vec![];
        let mut chunks = vec![];
        for line in lines {
            let from = segments.len();
            let line = straighten(line);
            segments.extend(line.windows(2).map(|w| [w[0], w[1]]));
            for start in (from..segments.len()).step_by(CHUNK) {
                let to = (start + CHUNK).min(segments.len());
                let center = lerp(segments[start][0], segments[to - 1][1], 0.5);
                let points = segments[start..to].iter().flatten();
                let radius = points.map(|&p| distance(p, center)).fold(0.0, f64::max);
                chunks.push(Chunk { center, radius, from: start, to });
            }
        }
        (!segments.is_empty()).then_some(Self { segments, chunks })
    }

    /// Index of the segment nearest to `p`, and the squared distance; `guess` is any segment.
    fn nearest(&self, p: Point, guess: usize) -> (usize, f64) {
        let mut best = (guess, self.square(p, guess));
        let mut reach = best.1.sqrt();
        for chunk in &self.chunks {
            let d = sub(p, chunk.center);
            let far = reach + chunk.radius;
            if d[0] * d[0] + d[1] * d[1] >= far * far {
                continue;
            }
            for i in chunk.from..chunk.to {
                let square = self.square(p, i);
                if square < best.1 {
                    best = (i, square);
                }
            }
            reach = best.1.sqrt();
        }
        best
    }

    fn square(&self, p: Point, segment: usize) -> f64 {
        let [a, b] = self.segments[segment];
        let q = lerp(a, b, closest_fraction(a, b, p));
        let d = sub(p, q);
        d[0] * d[0] + d[1] * d[1]
    }
}

/// The polyline without points closer than [`STRAIGHT`] to the line between those that stay, at most 8 in a row.
fn straighten(points: &[Point]) -> Vec<Point> {
    let mut result = vec![points[0]];
    let mut from = 0;
    while from + 1 < points.len() {
        let mut to = from + 1;
        for candidate in from + 2..points.len().min(from + 9) {
            let (a, b) = (points[from], points[candidate]);
            let close = |&p: &Point| distance(p, lerp(a, b, closest_fraction(a, b, p))) < STRAIGHT;
            if !points[from + 1..candidate].iter().all(close) {
                break;
            }
            to = candidate;
        }
        result.push(points[to]);
        from = to;
    }
    result
}

/// The sketch as the paper renders it: 256 x 256 RGB, white, strokes 3 px wide in their colours, 3 x 3 Gaussian filter.
///
/// Row-major from the top, three bytes a pixel.
///
/// # Source
/// Sketch2PQ, Sec. 3.1. Lines are antialiased before the filter.
pub fn paper_raster(patch: &PatchSketch) -> Vec<u8> {
    use tiny_skia::{Color, Paint, PathBuilder, Pixmap, Stroke, Transform};
    let size = CANVAS_SIZE as u32;
    let mut pixmap = Pixmap::new(size, size).expect("the size is not zero");
    pixmap.fill(Color::WHITE);
    for stroke in &patch.strokes {
        let mut builder = PathBuilder::new();
        for (i, &p) in stroke.points.iter().enumerate() {
            let [row, column] = map_coordinates(p, CANVAS_SIZE).map(|x| (x + 0.5) as f32);
            if i == 0 { builder.move_to(column, row) } else { builder.line_to(column, row) }
        }
        let Some(path) = builder.finish() else { continue };
        let [r, g, b] = stroke.kind.color();
        let mut paint = Paint { anti_alias: true, ..Paint::default() };
        paint.set_color_rgba8(r, g, b, 255);
        let width = Stroke {
            width: 3.0,
            line_cap: tiny_skia::LineCap::Round,
            line_join: tiny_skia::LineJoin::Round,
            ..Stroke::default()
        };
        pixmap.stroke_path(&path, &paint, &width, Transform::identity(), None);
    }
    let rgba = pixmap.data();
    let at = |row: isize, column: isize, channel: usize| {
        let last = CANVAS_SIZE as isize - 1;
        u32::from(rgba[((row.clamp(0, last) * (last + 1) + column.clamp(0, last)) * 4) as usize + channel])
    };
    let mut rgb = Vec::with_capacity(CANVAS_SIZE * CANVAS_SIZE * 3);
    for row in 0..CANVAS_SIZE as isize {
        for column in 0..CANVAS_SIZE as isize {
            for channel in 0..3 {
                let mut sum = 0;
                for (dy, wy) in [(-1, 1), (0, 2), (1, 1)] {
                    for (dx, wx) in [(-1, 1), (0, 2), (1, 1)] {
                        sum += wy * wx * at(row + dy, column + dx, channel);
                    }
                }
                rgb.push(((sum + 8) / 16) as u8);
            }
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sketch::{CanonicalFrame, CleanStroke};

    fn patch(strokes: Vec<CleanStroke>, regions: Vec<Region>) -> PatchSketch {
        PatchSketch {
            frame: CanonicalFrame { center: [0.0; 2], scale: 1.0 },
            view: View::default(),
            strokes,
            regions,
            border: vec![],
            depth_samples: vec![],
        }
    }

    fn region(ring: Vec<Point>, visible: Orientation, occluded: Option<Orientation>) -> Region {
        let area = crate::sketch::polyline::signed_area(&ring);
        Region { rings: vec![ring], visible, occluded, area }
    }

    #[test]
    fn pixels_and_positions_are_inverse() {
        let p = map_position(3, 17, 64);
        let [row, column] = map_coordinates(p, 64);
        assert!((row - 3.0).abs() < 1e-12 && (column - 17.0).abs() < 1e-12);
        assert!(map_position(0, 0, 64)[1] > 0.0);
        assert!((CANVAS_HALF_WIDTH - 4.0 * 256.0 / 232.0).abs() < 1e-12);
    }

    #[test]
    fn proximity_to_a_straight_stroke_is_exact() {
        let line: Vec<Point> = (0..=200).map(|i| [-3.0 + 0.03 * f64::from(i), 1.0]).collect();
        let raster =
            rasterize(&patch(vec![CleanStroke { kind: StrokeKind::Feature, points: line, source: 0 }], vec![]));
        for row in 0..MAP_SIZE {
            for column in 0..MAP_SIZE {
                let [x, y] = map_position(row, column, MAP_SIZE);
                let d = (x - x.clamp(-3.0, 3.0)).hypot(y - 1.0) / CANONICAL_PER_PX;
                let expected = 8.0 / (8.0 + d);
                let index = row * MAP_SIZE + column;
                assert!((f64::from(raster.channel(3)[index]) - expected).abs() < 1e-5);
                assert!((f64::from(raster.channel(8)[index]) - expected).abs() < 1e-5);
                assert!(raster.channel(9)[index].abs() < 1e-5);
                assert_eq!(raster.channel(0)[index], 0.0);
            }
        }
    }

    #[test]
    fn nearest_agrees_with_looking_at_every_segment() {
        let spiral: Vec<Point> = (0..900)
            .map(|i| {
                let t = f64::from(i) * 0.02;
                [0.2 * t * t.cos(), 0.2 * t * t.sin()]
            })
            .collect();
        let lines = Lines::new(&[&spiral]).unwrap();
        let mut guess = 0;
        for i in 0..500 {
            let p = map_position((i * 7) % 64, (i * 13) % 64, 64);
            let square;
            (guess, square) = lines.nearest(p, guess);
            let expected = spiral
                .windows(2)
                .map(|w| distance(p, lerp(w[0], w[1], closest_fraction(w[0], w[1], p))))
                .fold(f64::INFINITY, f64::min);
            assert!((square.sqrt() - expected).abs() < STRAIGHT);
        }
    }

    #[test]
    fn coverage_of_a_half_plane_is_its_area() {
        // Slanted, so that every share occurs; each pixel is counted by 16 points.
        let ring = vec![[-9.0, -9.0], [9.0, -9.0], [9.0, 1.9], [-9.0, -1.7]];
        let regions = vec![region(ring, Orientation::Back, Some(Orientation::Front))];
        let raster = rasterize(&patch(vec![], regions));
        let (mut sum, mut area) = (0.0, 0.0);
        for column in 0..MAP_SIZE {
            let [x, _] = map_position(0, column, MAP_SIZE);
            let height = -1.7 + (x + 9.0) * 3.6 / 18.0 + CANVAS_HALF_WIDTH;
            area += height / (2.0 * CANVAS_HALF_WIDTH / 64.0);
            sum += (0..MAP_SIZE).map(|r| f64::from(raster.channel(5)[r * MAP_SIZE + column])).sum::<f64>();
        }
        assert!((sum - area).abs() < 0.5, "{sum} {area}");
        assert_eq!(raster.channel(5), raster.channel(6));
        assert_eq!(raster.visible_at(63 * 64), Some(Orientation::Back));
        assert_eq!(raster.occluded_at(63 * 64), Some(Orientation::Front));
        assert_eq!(raster.visible_at(0), None);
        assert_eq!(raster.visible_coverage(63 * 64), 1.0);
    }

    #[test]
    fn the_papers_picture_shows_strokes_in_their_colours() {
        let line: Vec<Point> = vec![[-3.0, 0.0], [3.0, 0.0]];
        let rgb =
            paper_raster(&patch(vec![CleanStroke { kind: StrokeKind::Contour, points: line, source: 0 }], vec![]));
        assert_eq!(rgb.len(), 256 * 256 * 3);
        let at = |row: usize, column: usize| [0, 1, 2].map(|k| rgb[(row * 256 + column) * 3 + k]);
        assert_eq!(at(10, 10), [255, 255, 255]);
        let [r, g, b] = at(128, 128);
        assert!(r == 255 && g < 100 && b < 100);
    }
}
