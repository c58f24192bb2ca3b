//! Surfaces: the first call, a host's own NURBS, and views.

use super::guard::guard;
use super::handle::{Handle, free, get, get_mut, lend};
use super::options::{Sized32, fill, read, write};
use super::session::S2pqSession;
use super::sketch::S2pqSketch;
use super::{S2pqStatus, lent_text, output, slice};
use crate::error::Error;
use crate::pipeline::{self, SurfaceOptions, SurfacePatch, SurfaceResult};
use crate::surface::{BezierPatches, KnotVector, NurbsSurface, RefineOptions, SurfaceGrid};
use nalgebra::Point3;
use std::ffi::{CString, c_char};
use std::sync::OnceLock;

/// Options of sketch_to_surface. Fill them by s2pq_surface_options_init, then change what you need.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqSurfaceOptions {
    /// sizeof(S2pqSurfaceOptions)
    pub struct_size: u32,
    /// Zero.
    pub reserved: u32,
    /// Four corners of the surface, x and y each, canvas frame, near the outline and in any order; NULL: they are
    /// found, the default. Lent for the call. Only for a sketch with one outline.
    pub corners: *const f64,
    /// Smoothness against detail: 1 is balanced, 10 irons out small waves, 0.1 follows the predicted depth closely.
    /// Default 1.
    pub fairness: f64,
}

// SAFETY: repr(C), size first, two u32, a pointer and an f64: no padding, and any bits are a valid raw pointer.
unsafe impl Sized32 for S2pqSurfaceOptions {
    const NAME: &'static str = "S2pqSurfaceOptions";
    const DEFAULT: Self = Self { struct_size: 0, reserved: 0, corners: std::ptr::null(), fairness: 1.0 };
}

/// One NURBS patch, in or out. Set struct_size before every use.
///
/// Knots are the textbook's: count + degree + 1, clamped. Rhino and openNURBS store the same vector without its first
/// and last entry, count + degree - 1: pass those as they are, and read them as `knots_u + 1` with `knot_count_u - 2`
/// entries.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqNurbs {
    /// sizeof(S2pqNurbs)
    pub struct_size: u32,
    /// Degree in u, 1 to 5.
    pub degree_u: u32,
    /// Degree in v, 1 to 5.
    pub degree_v: u32,
    /// Zero.
    pub reserved: u32,
    /// Number of control points in u.
    pub count_u: u64,
    /// Number of control points in v.
    pub count_v: u64,
    /// Number of knots in u: count_u + degree_u + 1, or in also count_u + degree_u - 1.
    pub knot_count_u: u64,
    /// Number of knots in v: count_v + degree_v + 1, or in also count_v + degree_v - 1.
    pub knot_count_v: u64,
    /// Knots in u.
    pub knots_u: *const f64,
    /// Knots in v.
    pub knots_v: *const f64,
    /// count_u * count_v times x, y, z, v running fastest; world frame (right-handed, z up). Not multiplied by the
    /// weights.
    pub control_points: *const f64,
    /// count_u * count_v positive weights in the same order; NULL if all are 1.
    pub weights: *const f64,
}

// SAFETY: repr(C), size first, four u32, four u64, four pointers: no padding, and any bits are valid raw pointers.
unsafe impl Sized32 for S2pqNurbs {
    const NAME: &'static str = "S2pqNurbs";
    const DEFAULT: Self = Self {
        struct_size: 0,
        degree_u: 0,
        degree_v: 0,
        reserved: 0,
        count_u: 0,
        count_v: 0,
        knot_count_u: 0,
        knot_count_v: 0,
        knots_u: std::ptr::null(),
        knots_v: std::ptr::null(),
        control_points: std::ptr::null(),
        weights: std::ptr::null(),
    };
}

/// How well a patch obeys the sketch. Set struct_size before the call. All zero for a host's own NURBS.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct S2pqSurfaceDiagnostics {
    /// sizeof(S2pqSurfaceDiagnostics)
    pub struct_size: u32,
    /// Places of a grid over the patch where it turns from front to back, seen along the view, and no contour is drawn.
    pub fold_overs: u32,
    /// Mean distance between the structural strokes and the projected border and silhouette, pixels of a 256 x 256
    /// canvas that the sketch fills.
    pub reprojection_mean_px: f64,
    /// Largest of the same.
    pub reprojection_max_px: f64,
    /// Largest distance along the view between a depth sample and the surface, canvas unit; 0 without samples.
    pub sample_residual: f64,
    /// Share of the patch whose side facing the viewer is not drawn there, in [0, 1].
    pub misfacing: f64,
    /// 1 if the surface began with that of the sketch before, in a live session; else 0.
    pub warm_start: u32,
    /// Zero.
    pub reserved: u32,
}

// SAFETY: repr(C), size first, two u32, four f64 and two u32: no padding, all bits valid.
unsafe impl Sized32 for S2pqSurfaceDiagnostics {
    const NAME: &'static str = "S2pqSurfaceDiagnostics";
    const DEFAULT: Self = Self {
        struct_size: 0,
        fold_overs: 0,
        reprojection_mean_px: 0.0,
        reprojection_max_px: 0.0,
        sample_residual: 0.0,
        misfacing: 0.0,
        warm_start: 0,
        reserved: 0,
    };
}

/// One or more NURBS patches, world frame (right-handed, z up), canvas unit. Made by sketch_to_surface or
/// s2pq_surface_from_nurbs.
pub struct S2pqSurface {
    pub(super) result: SurfaceResult,
    views: Vec<NurbsView>,
    unused_strokes: Vec<u32>,
    report: CString,
}

impl Handle for S2pqSurface {
    const NAME: &'static str = "S2pqSurface";
}

/// The control points of one patch as the ABI lends them; never moved while the handle lives.
struct NurbsView {
    control_points: Vec<f64>,
    /// Made when first asked for.
    bezier: OnceLock<BezierView>,
}

/// The Bezier patches of one patch as the ABI lends them.
struct BezierView {
    counts: [usize; 2],
    control_points: Vec<f64>,
}

fn coordinates(points: &[Point3<f64>]) -> Vec<f64> {
    points.iter().flat_map(|p| [p.x, p.y, p.z]).collect()
}

impl S2pqSurface {
    fn new(result: SurfaceResult) -> Self {
        let views = result.patches.iter().map(|p| NurbsView::new(&p.surface)).collect();
        let unused_strokes = result.unused_strokes.iter().map(|&i| i as u32).collect();
        let report = lent_text(result.report.to_json());
        Self { result, views, unused_strokes, report }
    }

    fn patch(&self, patch: usize) -> Result<(&SurfacePatch, &NurbsView), Error> {
        let found = self.result.patches.get(patch).zip(self.views.get(patch));
        found.ok_or_else(|| Error::Argument {
            name: "patch",
            value: patch.to_string(),
            expected: "less than the number of patches",
        })
    }
}

impl NurbsView {
    fn new(surface: &NurbsSurface) -> Self {
        Self { control_points: coordinates(surface.control_points()), bezier: OnceLock::new() }
    }
}

/// Gives every option its default.
///
/// - `size`: sizeof(S2pqSurfaceOptions) as the host compiled it.
///
/// # Safety
/// `options` is valid for writing `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_options_init(options: *mut S2pqSurfaceOptions, size: usize) -> S2pqStatus {
    // SAFETY: the host's promise.
    guard(|| unsafe { write(options, size, &S2pqSurfaceOptions::DEFAULT) })
}

/// Turns a sketch into a surface: one patch for each outline.
///
/// Without depth samples the surface's lowest point has z = 0; with depth samples it passes through them. Moving or
/// scaling the strokes moves or scales the result.
///
/// - `sketch`: read only.
/// - `options`: NULL for the defaults.
/// - `surface`: takes the new surface.
/// - S2PQ_STATUS_INVALID_SKETCH: the message names the place on the canvas and what to draw there.
/// - S2PQ_STATUS_CANCELLED: s2pq_cancel was called, or a newer sketch came to a live session.
///
/// # Safety
/// `options` is NULL or valid as its `struct_size` says; `surface` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sketch_to_surface(
    session: *mut S2pqSession,
    sketch: *const S2pqSketch,
    options: *const S2pqSurfaceOptions,
    surface: *mut *mut S2pqSurface,
) -> S2pqStatus {
    guard(|| {
        let place = output("surface", surface)?;
        // SAFETY: not freed during the call, as the header asks.
        let (session, sketch) = unsafe { (get(session)?, get(sketch)?) };
        // SAFETY: the host's promise.
        let options = unsafe { read(options) }?;
        let corners = if options.corners.is_null() {
            None
        } else {
            // SAFETY: the host's promise.
            let xy = unsafe { slice("corners", options.corners, 8) }?;
            Some([0, 1, 2, 3].map(|k| [xy[2 * k], xy[2 * k + 1]]))
        };
        let refine = RefineOptions { fairness: options.fairness, ..RefineOptions::default() };
        let options = SurfaceOptions { corners, refine };
        let result = pipeline::sketch_to_surface(&mut *session.lock_for_newest()?, &sketch.sketch, &options)?;
        place.set(lend(S2pqSurface::new(result)));
        Ok(())
    })
}

/// A host's NURBS patch, checked.
///
/// # Safety
/// `nurbs` is NULL or valid as its `struct_size` and counts say.
unsafe fn nurbs_from_host(nurbs: *const S2pqNurbs) -> Result<NurbsSurface, Error> {
    if nurbs.is_null() {
        return Err(Error::Argument { name: "nurbs", value: "NULL".into(), expected: "an S2pqNurbs" });
    }
    // SAFETY: the host's promise.
    let nurbs = unsafe { read(nurbs) }?;
    let knots = |pointer: *const f64, knot_count: u64, count: u64, degree: u32| {
        // SAFETY: the host's promise.
        let knots = unsafe { slice("knots", pointer, usize::try_from(knot_count).unwrap_or(usize::MAX)) }?;
        let degree = degree as usize;
        if knot_count.checked_sub(count) == Some(degree as u64 + 1) {
            KnotVector::new(degree, knots.to_vec())
        } else if knot_count.checked_add(1) == count.checked_add(degree as u64) {
            KnotVector::from_rhino(degree, knots)
        } else {
            let reason = format!(
                "{knot_count} knots for {count} control points of degree {degree}: expected {} or {}",
                u128::from(count) + degree as u128 + 1,
                (u128::from(count) + degree as u128).saturating_sub(1)
            );
            Err(Error::Nurbs { reason })
        }
    };
    let u = knots(nurbs.knots_u, nurbs.knot_count_u, nurbs.count_u, nurbs.degree_u)?;
    let v = knots(nurbs.knots_v, nurbs.knot_count_v, nurbs.count_v, nurbs.degree_v)?;
    // The knots hold as many entries as slice() takes, so the counts are far from overflowing once limited again there.
    let count = u.count().saturating_mul(v.count());
    // SAFETY: the host's promise.
    let points = unsafe { slice("control_points", nurbs.control_points, count.saturating_mul(3)) }?;
    let points = points.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect();
    let weights = if nurbs.weights.is_null() {
        None
    } else {
        // SAFETY: the host's promise.
        Some(unsafe { slice("weights", nurbs.weights, count) }?.to_vec())
    };
    NurbsSurface::new([u, v], points, weights)
}

/// Makes a surface of a host's own NURBS patch, copied; it enters the pipeline at surface_to_cdf.
///
/// - `nurbs`: clamped, of degree 1 to 5, rational or not.
/// - `surface`: takes the new surface of one patch.
///
/// # Safety
/// `nurbs` is valid as its `struct_size` and counts say; `surface` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_from_nurbs(
    nurbs: *const S2pqNurbs,
    surface: *mut *mut S2pqSurface,
) -> S2pqStatus {
    guard(|| {
        let place = output("surface", surface)?;
        // SAFETY: the host's promise.
        let nurbs = unsafe { nurbs_from_host(nurbs) }?;
        place.set(lend(S2pqSurface::new(SurfaceResult::from_nurbs(vec![nurbs])?)));
        Ok(())
    })
}

/// Adds another NURBS patch to a surface made by s2pq_surface_from_nurbs. Views lent before become invalid.
///
/// # Safety
/// `nurbs` is valid as its `struct_size` and counts say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_add_nurbs(surface: *mut S2pqSurface, nurbs: *const S2pqNurbs) -> S2pqStatus {
    guard(|| {
        // SAFETY: one thread at a time, and valid as its sizes say, as the header asks.
        let (surface, nurbs) = unsafe { (get_mut(surface)?, nurbs_from_host(nurbs)?) };
        let mut all: Vec<_> = surface.result.patches.iter().map(|p| p.surface.clone()).collect();
        if surface.result.backend.is_some() {
            let expected = "a surface made by s2pq_surface_from_nurbs";
            return Err(Error::Argument { name: "surface", value: "made from a sketch".into(), expected });
        }
        all.push(nurbs);
        *surface = S2pqSurface::new(SurfaceResult::from_nurbs(all)?);
        Ok(())
    })
}

/// Number of patches.
///
/// # Safety
/// `count` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_patch_count(surface: *const S2pqSurface, count: *mut usize) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let surface = unsafe { get(surface) }?;
        output("count", count)?.set(surface.result.patches.len());
        Ok(())
    })
}

/// The NURBS data of a patch; its arrays are lent until the surface is freed.
///
/// - `nurbs`: set its struct_size first.
///
/// # Safety
/// `nurbs` is valid for writing as many bytes as its `struct_size` says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_nurbs(
    surface: *const S2pqSurface,
    patch: usize,
    nurbs: *mut S2pqNurbs,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let (patch, view) = unsafe { get(surface) }?.patch(patch)?;
        let [u, v] = patch.surface.knots();
        let value = S2pqNurbs {
            struct_size: 0,
            degree_u: u.degree() as u32,
            degree_v: v.degree() as u32,
            reserved: 0,
            count_u: u.count() as u64,
            count_v: v.count() as u64,
            knot_count_u: u.knots().len() as u64,
            knot_count_v: v.knots().len() as u64,
            knots_u: u.knots().as_ptr(),
            knots_v: v.knots().as_ptr(),
            control_points: view.control_points.as_ptr(),
            weights: patch.surface.weights().map_or(std::ptr::null(), <[f64]>::as_ptr),
        };
        // SAFETY: the host's promise.
        unsafe { fill(nurbs, &value) }
    })
}

/// Evaluates a patch at parameters, which are clamped to the domain of its knots.
///
/// - `uv`: `count` times u and v.
/// - `xyz`: takes `count` times x, y, z, world frame.
/// - `normals`: takes `count` unit normals S_u x S_v, zero where there is none; NULL if not wanted.
///
/// # Safety
/// `uv` is valid for reading 2 * `count` numbers, `xyz` and `normals`, unless NULL, for writing 3 * `count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_evaluate(
    surface: *const S2pqSurface,
    patch: usize,
    uv: *const f64,
    count: usize,
    xyz: *mut f64,
    normals: *mut f64,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let (patch, _) = unsafe { get(surface) }?.patch(patch)?;
        // SAFETY: the host's promise.
        let uv = unsafe { slice("uv", uv, count.saturating_mul(2)) }?;
        if count > 0 {
            output("xyz", xyz)?;
        }
        if let Some(index) = uv.iter().position(|x| !x.is_finite()) {
            return Err(Error::Argument {
                name: "uv",
                value: format!("not a number at {}", index / 2),
                expected: "finite parameters",
            });
        }
        for (k, uv) in uv.chunks_exact(2).enumerate() {
            let point = patch.surface.evaluate(uv[0], uv[1]);
            let normal = point.du.cross(&point.dv).try_normalize(0.0).unwrap_or_default();
            for i in 0..3 {
                // SAFETY: the host vouches for 3 * count numbers.
                unsafe {
                    xyz.add(3 * k + i).write(point.position[i]);
                    if !normals.is_null() {
                        normals.add(3 * k + i).write(normal[i]);
                    }
                }
            }
        }
        Ok(())
    })
}

/// A patch as bicubic Bezier patches, one for each span of its knots, exactly. Lent until the surface is freed.
///
/// - `xyz`: 16 points for each of count_u * count_v pieces, pieces and points with v running fastest: point (a, b) of piece (i, j) begins
///   at `3 * (16 * (i * count_v + j) + 4 * a + b)`. Degrees 1 and 2 are raised to 3.
/// - S2PQ_STATUS_INVALID_GEOMETRY: the patch is rational, or of a degree above 3, which no bicubic patches equal: use s2pq_surface_grid.
///
/// # Safety
/// `xyz`, `count_u` and `count_v` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_bezier(
    surface: *const S2pqSurface,
    patch: usize,
    xyz: *mut *const f64,
    count_u: *mut usize,
    count_v: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let (patch, view) = unsafe { get(surface) }?.patch(patch)?;
        let (xyz, count_u, count_v) = (output("xyz", xyz)?, output("count_u", count_u)?, output("count_v", count_v)?);
        let bezier = match view.bezier.get() {
            Some(bezier) => bezier,
            None => {
                let patches = BezierPatches::new(&patch.surface)?;
                let control_points = coordinates(&patches.control_points);
                view.bezier.get_or_init(|| BezierView { counts: patches.counts, control_points })
            }
        };
        xyz.set(bezier.control_points.as_ptr());
        count_u.set(bezier.counts[0]);
        count_v.set(bezier.counts[1]);
        Ok(())
    })
}

/// A patch as a grid of points, normals and quads, for drawing: any degree, rational or not. The quads are not planar.
///
/// - `cells_u`, `cells_v`: number of equal cells of the parameter domain, at least 1 each, at most 2^24 vertices.
/// - `xyz`: takes (cells_u + 1) * (cells_v + 1) times x, y, z, world frame, v running fastest.
/// - `normals`: takes as many unit normals S_u x S_v, zero where there is none; NULL if not wanted.
/// - `quads`: takes cells_u * cells_v times four vertex indices, counter-clockwise seen from the side of the normals; NULL if not wanted.
///
/// # Safety
/// `xyz`, `normals` and `quads`, unless NULL, are valid for writing as many values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_grid(
    surface: *const S2pqSurface,
    patch: usize,
    cells_u: usize,
    cells_v: usize,
    xyz: *mut f64,
    normals: *mut f64,
    quads: *mut u32,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let (patch, _) = unsafe { get(surface) }?.patch(patch)?;
        output("xyz", xyz)?;
        let grid = SurfaceGrid::new(&patch.surface, [cells_u, cells_v])?;
        for (k, (point, normal)) in grid.points.iter().zip(&grid.normals).enumerate() {
            for i in 0..3 {
                // SAFETY: the host vouches for 3 numbers for each vertex.
                unsafe {
                    xyz.add(3 * k + i).write(point[i]);
                    if !normals.is_null() {
                        normals.add(3 * k + i).write(normal[i]);
                    }
                }
            }
        }
        if !quads.is_null() {
            for (k, index) in grid.quads.iter().flatten().enumerate() {
                // SAFETY: the host vouches for 4 indices for each cell.
                unsafe { quads.add(k).write(*index) };
            }
        }
        Ok(())
    })
}

/// How well a patch obeys the sketch.
///
/// - `diagnostics`: set its struct_size first.
///
/// # Safety
/// `diagnostics` is valid for writing as many bytes as its `struct_size` says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_diagnostics(
    surface: *const S2pqSurface,
    patch: usize,
    diagnostics: *mut S2pqSurfaceDiagnostics,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let (patch, _) = unsafe { get(surface) }?.patch(patch)?;
        let d = &patch.diagnostics;
        let value = S2pqSurfaceDiagnostics {
            struct_size: 0,
            fold_overs: d.fold_overs as u32,
            reprojection_mean_px: d.reprojection_mean_px,
            reprojection_max_px: d.reprojection_max_px,
            sample_residual: d.sample_residual,
            misfacing: d.misfacing,
            warm_start: u32::from(d.warm_start),
            reserved: 0,
        };
        // SAFETY: the host's promise.
        unsafe { fill(diagnostics, &value) }
    })
}

/// Strokes that played no part, by their place in the sketch: too short, or drawn twice. Lent until the surface is
/// freed.
///
/// # Safety
/// `strokes` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_unused_strokes(
    surface: *const S2pqSurface,
    strokes: *mut *const u32,
    count: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let surface = unsafe { get(surface) }?;
        let (strokes, count) = (output("strokes", strokes)?, output("count", count)?);
        strokes.set(surface.unused_strokes.as_ptr());
        count.set(surface.unused_strokes.len());
        Ok(())
    })
}

/// Measures and times as JSON, UTF-8, NUL-terminated; lent until the surface is freed.
///
/// # Safety
/// `json` and `length` are valid for writing; `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_report_json(
    surface: *const S2pqSurface,
    json: *mut *const c_char,
    length: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let surface = unsafe { get(surface) }?;
        super::lend_text(&surface.report, json, length)
    })
}

/// Frees a surface; NULL is fine. Fields made on it stay alive.
///
/// # Safety
/// No call uses the surface or a view of it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_surface_free(surface: *mut S2pqSurface) {
    free(surface);
}
