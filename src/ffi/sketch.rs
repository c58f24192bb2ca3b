//! Sketches: strokes, depth samples, view.

use super::guard::guard;
use super::handle::{Handle, free, get, get_mut, lend};
use super::{S2pqStatus, choice, flag, output, slice};
use crate::error::Error;
use crate::sketch::{DepthSample, Layer, Sketch, Stroke, StrokeKind, View, parse_json, parse_svg};
use nalgebra::Vector3;

/// What a stroke stands for; passed as uint32_t.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum S2pqStrokeKind {
    /// Visible part of the surface's border; green in the paper.
    VisibleBoundary = 0,
    /// Occluded part of the surface's border; blue.
    OccludedBoundary = 1,
    /// Silhouette of the surface that is not its border: the surface folds over there; red.
    Contour = 2,
    /// Direction that the panels' edges follow; black.
    Feature = 3,
}

/// Which of the two surface layers on a line of sight; passed as uint32_t.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum S2pqLayer {
    /// First surface point.
    Visible = 0,
    /// Second surface point.
    Occluded = 1,
}

/// Strokes and depth samples on a canvas, and the view. Made by s2pq_sketch_new, s2pq_sketch_from_json or
/// s2pq_sketch_from_svg.
///
/// Canvas coordinates are the host's own, in any unit. The default view is azimuth 45, elevation 45 degrees, canvas y
/// down.
pub struct S2pqSketch {
    pub(super) sketch: Sketch,
    points: usize,
}

impl Handle for S2pqSketch {
    const NAME: &'static str = "S2pqSketch";
}

/// Most points and samples that a handle holds, against running out of memory; the library thins them out and has its
/// own limits.
const MAX_POINTS: usize = 10_000_000;

fn empty_sketch() -> Sketch {
    Sketch { name: String::new(), canvas_size: [0.0; 2], view: View::default(), strokes: vec![], depth_samples: vec![] }
}

/// Makes an empty sketch.
///
/// # Safety
/// `sketch` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_new(sketch: *mut *mut S2pqSketch) -> S2pqStatus {
    guard(|| {
        output("sketch", sketch)?.set(lend(S2pqSketch { sketch: empty_sketch(), points: 0 }));
        Ok(())
    })
}

/// Reads a sketch from JSON text, the form of the files in examples/sketches.
///
/// - `text`, `length`: UTF-8 without NUL, `length` bytes.
/// - `sketch`: takes the new sketch.
///
/// # Safety
/// `text` is valid for reading `length` bytes, `sketch` for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_from_json(
    text: *const u8,
    length: usize,
    sketch: *mut *mut S2pqSketch,
) -> S2pqStatus {
    // SAFETY: the host's promise.
    unsafe { from_text(text, length, sketch, parse_json) }
}

/// Reads a sketch from SVG text, as drawing programs write it; canvas y is down, the view is the default.
///
/// The kind of a stroke comes from the names of its layer, group, class or id (visible boundary, occluded, contour,
/// feature), else from its colour: the nearest of green, blue, red and black. Circles with a number in data-depth or in
/// their title are depth samples, of the occluded layer if their data-layer, class, id or group says so.
///
/// - `text`, `length`: UTF-8 without NUL, `length` bytes.
/// - `sketch`: takes the new sketch.
///
/// # Safety
/// `text` is valid for reading `length` bytes, `sketch` for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_from_svg(
    text: *const u8,
    length: usize,
    sketch: *mut *mut S2pqSketch,
) -> S2pqStatus {
    // SAFETY: the host's promise.
    unsafe { from_text(text, length, sketch, parse_svg) }
}

/// Puts into `sketch` what `parse` reads in the text.
///
/// # Safety
/// As [`s2pq_sketch_from_json`].
unsafe fn from_text(
    text: *const u8,
    length: usize,
    sketch: *mut *mut S2pqSketch,
    parse: fn(&str) -> Result<Sketch, Error>,
) -> S2pqStatus {
    guard(|| {
        let place = output("sketch", sketch)?;
        // SAFETY: the host's promise.
        let bytes = unsafe { slice("text", text, length) }?;
        let text = std::str::from_utf8(bytes).map_err(|e| Error::Format { what: "sketch", reason: e.to_string() })?;
        let sketch = parse(text)?;
        let points = sketch.strokes.iter().map(|s| s.points.len()).sum();
        place.set(lend(S2pqSketch { sketch, points }));
        Ok(())
    })
}

/// Sets the view by two angles in degrees.
///
/// - `azimuth_deg`: of the direction towards the viewer, from world x towards y.
/// - `elevation_deg`: of the same direction above the horizon, in [-90, 90]. World z is up.
/// - `y_down`: 1 if canvas y grows downwards, as in images, else 0.
///
/// # Safety
/// `sketch` is NULL or any pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_set_view_angles(
    sketch: *mut S2pqSketch,
    azimuth_deg: f64,
    elevation_deg: f64,
    y_down: u32,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, as the header asks.
        let sketch = unsafe { get_mut(sketch) }?;
        sketch.sketch.view = View::from_angles(azimuth_deg, elevation_deg, flag("y_down", y_down)?)?;
        Ok(())
    })
}

/// Sets the view by three orthonormal, right-handed axes in the world.
///
/// - `axes`: nine numbers: canvas right, canvas up, towards the viewer.
/// - `y_down`: 1 if canvas y grows downwards, as in images, else 0.
///
/// # Safety
/// `axes` is valid for reading nine numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_set_view_axes(
    sketch: *mut S2pqSketch,
    axes: *const f64,
    y_down: u32,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, and nine numbers, as the header asks.
        let (sketch, axes) = unsafe { (get_mut(sketch)?, slice("axes", axes, 9)?) };
        let axis = |k: usize| Vector3::new(axes[3 * k], axes[3 * k + 1], axes[3 * k + 2]);
        sketch.sketch.view = View::from_axes(axis(0), axis(1), axis(2), flag("y_down", y_down)?)?;
        Ok(())
    })
}

/// Adds a stroke. Strokes may come in any order and direction, with small gaps and overshoots.
///
/// - `kind`: an S2pqStrokeKind.
/// - `xy`: `point_count` times x and y, canvas frame.
/// - A number that is not finite is S2PQ_STATUS_INVALID_SKETCH, and so is a sketch of more points than the library
///   takes.
///
/// # Safety
/// `xy` is valid for reading 2 * `point_count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_add_stroke(
    sketch: *mut S2pqSketch,
    kind: u32,
    xy: *const f64,
    point_count: usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, as the header asks.
        let sketch = unsafe { get_mut(sketch) }?;
        let kind = choice("kind", kind, &StrokeKind::ALL, "an S2pqStrokeKind")?;
        let count = sketch.points.saturating_add(point_count);
        if count > MAX_POINTS {
            return Err(Error::TooLarge { what: "stroke points", count, limit: MAX_POINTS });
        }
        // SAFETY: the host's promise.
        let numbers = unsafe { slice("xy", xy, 2 * point_count) }?;
        if let Some(index) = numbers.iter().position(|x| !x.is_finite()) {
            return Err(Error::NotFinite { what: "stroke point", index: index / 2 });
        }
        let points = numbers.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
        sketch.sketch.strokes.push(Stroke { kind, points });
        sketch.points = count;
        Ok(())
    })
}

/// Adds a known depth.
///
/// - `layer`: an S2pqLayer.
/// - `x`, `y`: canvas point.
/// - `depth`: distance along the view direction from the plane through the world's origin, growing away from the
///   viewer, canvas unit.
///
/// # Safety
/// `sketch` is NULL or any pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_add_depth_sample(
    sketch: *mut S2pqSketch,
    layer: u32,
    x: f64,
    y: f64,
    depth: f64,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, as the header asks.
        let sketch = unsafe { get_mut(sketch) }?;
        let layer = choice("layer", layer, &Layer::ALL, "an S2pqLayer")?;
        let samples = &mut sketch.sketch.depth_samples;
        if ![x, y, depth].iter().all(|x| x.is_finite()) {
            return Err(Error::NotFinite { what: "depth sample", index: samples.len() });
        }
        if samples.len() >= MAX_POINTS {
            return Err(Error::TooLarge { what: "depth samples", count: samples.len() + 1, limit: MAX_POINTS });
        }
        samples.push(DepthSample { position: [x, y], layer, depth });
        Ok(())
    })
}

/// Removes all strokes and depth samples; the view stays.
///
/// # Safety
/// `sketch` is NULL or any pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_clear(sketch: *mut S2pqSketch) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, as the header asks.
        let sketch = unsafe { get_mut(sketch) }?;
        sketch.sketch.strokes.clear();
        sketch.sketch.depth_samples.clear();
        sketch.points = 0;
        Ok(())
    })
}

/// Counts what a sketch holds.
///
/// # Safety
/// `stroke_count` and `depth_sample_count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_counts(
    sketch: *const S2pqSketch,
    stroke_count: *mut usize,
    depth_sample_count: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, as the header asks.
        let sketch = unsafe { get(sketch) }?;
        let (strokes, samples) =
            (output("stroke_count", stroke_count)?, output("depth_sample_count", depth_sample_count)?);
        strokes.set(sketch.sketch.strokes.len());
        samples.set(sketch.sketch.depth_samples.len());
        Ok(())
    })
}

/// Frees a sketch; NULL is fine.
///
/// # Safety
/// No call uses the sketch.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_sketch_free(sketch: *mut S2pqSketch) {
    free(sketch);
}
