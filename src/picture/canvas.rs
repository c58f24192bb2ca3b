//! Pixels: pictures, where the model lies on them, and a triangle rasterizer with a depth buffer.

use crate::error::Error;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use nalgebra::{Point3, Vector3};
use tiny_skia::{FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};

/// Samples a pixel in each direction.
const SAMPLES: usize = 3;

/// An opaque picture, RGBA, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 4 * width * height bytes: red, green, blue, alpha, row by row.
    pub pixels: Vec<u8>,
}

impl Picture {
    /// A white picture.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![255; 4 * width * height] }
    }

    /// Red, green and blue of a pixel.
    pub fn color(&self, column: usize, row: usize) -> [u8; 3] {
        let start = 4 * (row * self.width + column);
        [self.pixels[start], self.pixels[start + 1], self.pixels[start + 2]]
    }

    /// The picture as PNG file content.
    ///
    /// # Errors
    /// [`Error::Format`] if the encoder refuses it, as for a picture without pixels.
    pub fn to_png(&self) -> Result<Vec<u8>, Error> {
        let mut bytes = vec![];
        PngEncoder::new(&mut bytes)
            .write_image(&self.pixels, self.width as u32, self.height as u32, ExtendedColorType::Rgba8)
            .map_err(|error| Error::Format { what: "PNG", reason: error.to_string() })?;
        Ok(bytes)
    }

    /// Copies `other` to the place whose upper left corner is (column, row); what sticks out is cut off.
    pub fn paste(&mut self, other: &Picture, column: usize, row: usize) {
        let columns = other.width.min(self.width.saturating_sub(column));
        for r in 0..other.height.min(self.height.saturating_sub(row)) {
            let (from, to) = (4 * r * other.width, 4 * ((row + r) * self.width + column));
            self.pixels[to..to + 4 * columns].copy_from_slice(&other.pixels[from..from + 4 * columns]);
        }
    }

    /// Draws with anti-aliased lines and shapes.
    pub(crate) fn draw(&mut self, body: impl FnOnce(&mut Brush)) {
        let size = (self.width as u32, self.height as u32);
        let Some(mut pixmap) = Pixmap::new(size.0, size.1) else { return };
        // Opaque, so that premultiplied and plain colours agree.
        pixmap.data_mut().copy_from_slice(&self.pixels);
        body(&mut Brush { pixmap: &mut pixmap });
        self.pixels.copy_from_slice(pixmap.data());
    }
}

/// Anti-aliased drawing on a picture, in pixels.
pub(crate) struct Brush<'a> {
    pixmap: &'a mut Pixmap,
}

impl Brush<'_> {
    fn paint(color: [u8; 3]) -> Paint<'static> {
        let mut paint = Paint { anti_alias: true, ..Paint::default() };
        paint.set_color_rgba8(color[0], color[1], color[2], 255);
        paint
    }

    /// Strokes a path with round caps and joins.
    pub fn stroke(&mut self, path: &Path, width: f32, color: [u8; 3]) {
        let stroke = Stroke { width, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
        self.pixmap.stroke_path(path, &Self::paint(color), &stroke, Transform::identity(), None);
    }

    /// Strokes a polyline.
    pub fn polyline(&mut self, points: &[[f64; 2]], width: f32, color: [u8; 3]) {
        let mut builder = PathBuilder::new();
        for (k, p) in points.iter().enumerate() {
            let (x, y) = (p[0] as f32, p[1] as f32);
            if k == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
        }
        // A lone point is a dot.
        if let [p] = points {
            builder.line_to(p[0] as f32 + 0.01, p[1] as f32);
        }
        if let Some(path) = builder.finish() {
            self.stroke(&path, width, color);
        }
    }

    /// Fills a circle.
    pub fn dot(&mut self, center: [f64; 2], radius: f64, color: [u8; 3]) {
        if let Some(path) = PathBuilder::from_circle(center[0] as f32, center[1] as f32, radius as f32) {
            self.pixmap.fill_path(&path, &Self::paint(color), FillRule::Winding, Transform::identity(), None);
        }
    }

    /// Fills an upright rectangle from (x, y), its upper left corner.
    pub fn rectangle(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], color: [u8; 3]) {
        if let Some(rect) = tiny_skia::Rect::from_xywh(x as f32, y as f32, width as f32, height as f32) {
            self.pixmap.fill_rect(rect, &Self::paint(color), Transform::identity(), None);
        }
    }
}

/// Where camera x, y lie on a picture: pixel = size / 2 + scale * (x - center.x, center.y - y).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Width and height of the picture, pixels.
    pub size: [usize; 2],
    /// Camera point in the middle of the picture.
    pub center: [f64; 2],
    /// Pixels per camera unit.
    pub scale: f64,
}

impl Frame {
    /// The frame in which `points` (camera x, y) fill the picture up to `margin` pixels; points that are not finite are skipped.
    pub fn fitting(points: impl IntoIterator<Item = [f64; 2]>, size: [usize; 2], margin: f64) -> Self {
        let ([left, bottom], [right, top]) = bounds(points).unwrap_or(([0.0; 2], [1.0; 2]));
        let room = size.map(|s| (s as f64 - 2.0 * margin).max(1.0));
        let scale = (room[0] / (right - left)).min(room[1] / (top - bottom));
        let scale = if scale.is_finite() && scale > 0.0 { scale } else { 1.0 };
        Self { size, center: [0.5 * (left + right), 0.5 * (bottom + top)], scale }
    }

    /// Camera x, y to pixels.
    pub fn place(&self, x: f64, y: f64) -> [f64; 2] {
        [
            0.5 * self.size[0] as f64 + (x - self.center[0]) * self.scale,
            0.5 * self.size[1] as f64 - (y - self.center[1]) * self.scale,
        ]
    }
}

/// Least and greatest coordinates of the finite points.
pub(crate) fn bounds(points: impl IntoIterator<Item = [f64; 2]>) -> Option<([f64; 2], [f64; 2])> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in points.into_iter().filter(|p| p.iter().all(|x| x.is_finite())) {
        for k in 0..2 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    (low[0] <= high[0]).then_some((low, high))
}

/// Pictures side by side on white, each at the middle of its row's height, `gap` pixels apart.
pub fn compose(pictures: &[Picture], gap: usize) -> Picture {
    let height = pictures.iter().map(|p| p.height).max().unwrap_or(0);
    let width = pictures.iter().map(|p| p.width).sum::<usize>() + gap * pictures.len().saturating_sub(1);
    let mut whole = Picture::new(width, height);
    let mut column = 0;
    for picture in pictures {
        whole.paste(picture, column, (height - picture.height) / 2);
        column += picture.width + gap;
    }
    whole
}

/// A corner handed to the rasterizer: camera frame, z towards the viewer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corner {
    pub position: Point3<f64>,
    pub normal: Vector3<f64>,
}

/// What a covered sample is coloured by.
pub(crate) struct Fragment {
    /// Sample position, in samples.
    pub place: [f64; 2],
    /// Interpolated normal, camera frame, not normalized.
    pub normal: Vector3<f64>,
}

/// Colour and depth of SAMPLES x SAMPLES samples a pixel, two layers deep.
pub(crate) struct DepthBuffer {
    pub frame: Frame,
    /// Samples a row and rows of samples.
    size: [usize; 2],
    /// Depth and colour of the nearest layer, and of the one behind it.
    layers: [Vec<(f32, [u8; 3])>; 2],
}

impl DepthBuffer {
    pub fn new(frame: &Frame) -> Self {
        let size = frame.size.map(|s| s * SAMPLES);
        let empty = vec![(f32::NEG_INFINITY, [255; 3]); size[0] * size[1]];
        Self { frame: *frame, size, layers: [empty.clone(), empty] }
    }

    /// Camera x, y to samples.
    pub fn place(&self, p: &Point3<f64>) -> [f64; 2] {
        self.frame.place(p.x, p.y).map(|x| x * SAMPLES as f64)
    }

    /// Samples per pixel along a line.
    pub fn samples_per_pixel(&self) -> f64 {
        SAMPLES as f64
    }

    /// Rasterizes one triangle into layer 0, or into layer 1 behind layer 0 by at least `behind`.
    pub fn triangle(
        &mut self,
        corners: &[Corner; 3],
        layer: usize,
        behind: f64,
        mut shade: impl FnMut(&Fragment) -> [u8; 3],
    ) {
        let places = corners.map(|c| self.place(&c.position));
        if !places.iter().flatten().all(|x| x.is_finite()) {
            return;
        }
        let [a, b, c] = places;
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0.0 {
            return;
        }
        let range = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]) - 0.5;
            let high = a[k].max(b[k]).max(c[k]) + 0.5;
            (low.max(0.0) as usize, high.clamp(0.0, self.size[k] as f64) as usize)
        };
        let ((left, right), (top, bottom)) = (range(0), range(1));
        for row in top..bottom {
            for column in left..right {
                let p = [column as f64 + 0.5, row as f64 + 0.5];
                let weight =
                    |q: [f64; 2], r: [f64; 2]| ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])) / area;
                let w = [weight(b, c), weight(c, a), weight(a, b)];
                // A hair of overlap instead of gaps along shared edges.
                if w.iter().any(|w| *w < -1e-9) {
                    continue;
                }
                let z: f64 = (0..3).map(|k| w[k] * corners[k].position.z).sum();
                let index = row * self.size[0] + column;
                let nearer = z as f32 > self.layers[layer][index].0;
                let allowed = layer == 0 || (z + behind) < f64::from(self.layers[0][index].0);
                if nearer && allowed {
                    let normal = (0..3).map(|k| corners[k].normal * w[k]).sum();
                    self.layers[layer][index] = (z as f32, shade(&Fragment { place: p, normal }));
                }
            }
        }
    }

    /// Draws a line of `width` pixels: on layer 0 over what is not nearer by more than `tolerance`, on layer 1 where layer 0
    /// hides it and nothing else of layer 1 does.
    pub fn line(&mut self, ends: [Point3<f64>; 2], width: f64, color: [u8; 3], layer: usize, tolerance: f64) {
        let [a, b] = ends.map(|p| self.place(&p));
        if !a.iter().chain(&b).all(|x| x.is_finite()) {
            return;
        }
        let radius = 0.5 * width * SAMPLES as f64;
        let range = |k: usize| {
            let (low, high) = (a[k].min(b[k]) - radius, a[k].max(b[k]) + radius + 1.0);
            (low.max(0.0) as usize, high.clamp(0.0, self.size[k] as f64) as usize)
        };
        let ((left, right), (top, bottom)) = (range(0), range(1));
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
        for row in top..bottom {
            for column in left..right {
                let p = [column as f64 + 0.5 - a[0], row as f64 + 0.5 - a[1]];
                let t = ((p[0] * along[0] + p[1] * along[1]) / length).clamp(0.0, 1.0);
                let off = [p[0] - t * along[0], p[1] - t * along[1]];
                if off[0] * off[0] + off[1] * off[1] > radius * radius {
                    continue;
                }
                let z = ends[0].z + t * (ends[1].z - ends[0].z) + tolerance;
                let index = row * self.size[0] + column;
                let hidden = z < f64::from(self.layers[0][index].0);
                let sample = &mut self.layers[layer][index];
                if hidden == (layer == 1) && z >= f64::from(sample.0) {
                    sample.1 = color;
                    sample.0 = sample.0.max((z - tolerance) as f32);
                }
            }
        }
    }

    /// Averages the samples of each pixel; the front layer covers the one behind with `opacity`, both lie on white.
    pub fn resolve(&self, opacity: f64) -> Picture {
        let [width, height] = self.frame.size;
        let mut picture = Picture::new(width, height);
        for row in 0..height {
            for column in 0..width {
                let mut sum = [0u32; 3];
                for k in 0..SAMPLES * SAMPLES {
                    let index = (row * SAMPLES + k / SAMPLES) * self.size[0] + column * SAMPLES + k % SAMPLES;
                    let (front, back) = (self.layers[0][index], self.layers[1][index]);
                    let color = if back.0 > f32::NEG_INFINITY { mix(back.1, front.1, opacity) } else { front.1 };
                    (0..3).for_each(|c| sum[c] += u32::from(color[c]));
                }
                let count = (SAMPLES * SAMPLES) as u32;
                let start = 4 * (row * width + column);
                (0..3).for_each(|c| picture.pixels[start + c] = ((sum[c] + count / 2) / count) as u8);
            }
        }
        picture
    }
}

/// `a` and `b` mixed: `share` of b.
pub(crate) fn mix(a: [u8; 3], b: [u8; 3], share: f64) -> [u8; 3] {
    [0, 1, 2].map(|k| (f64::from(a[k]) + (f64::from(b[k]) - f64::from(a[k])) * share).round() as u8)
}

/// Light on a surface of colour `color`: key light from the upper left, soft light from the viewer, a faint highlight.
///
/// `normal` in the camera frame, either side, not necessarily of unit length; `relief` in [0, 1] is how dark the side away from the
/// light gets.
pub(crate) fn shaded(color: [u8; 3], normal: &Vector3<f64>, relief: f64, gloss: f64) -> [u8; 3] {
    let n = normal.try_normalize(0.0).unwrap_or_else(Vector3::z);
    let n = if n.z < 0.0 { -n } else { n };
    let key = Vector3::new(-0.45, 0.65, 0.62).normalize();
    let half = (key + Vector3::z()).normalize();
    let light = 0.72 * n.dot(&key).max(0.0) + 0.28 * n.z;
    let diffuse = 1.04 - relief * (1.0 - light);
    let highlight = gloss * n.dot(&half).max(0.0).powi(40);
    color.map(|c| (f64::from(c) * diffuse + 255.0 * highlight).clamp(0.0, 255.0).round() as u8)
}
