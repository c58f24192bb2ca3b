//! Conjugate direction fields: the second call, and views.

use super::guard::guard;
use super::handle::{Handle, free, get, lend};
use super::options::{Sized32, fill, read, write};
use super::session::S2pqSession;
use super::sketch::S2pqSketch;
use super::surface::S2pqSurface;
use super::{S2pqStatus, flag, lend_array, lend_text, lent_text, output, slice};
use crate::error::Error;
use crate::pipeline::{self, FeatureCurve, FieldOptions, FieldResult, FixedSingularity, SurfacePlace};
use nalgebra::Point3;
use std::ffi::{CString, c_char};

/// Options of sketch_to_cdf and surface_to_cdf. Fill them by s2pq_field_options_init, then change what you need.
///
/// `singularities` is read during the call and stays the host's.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqFieldOptions {
    /// sizeof(S2pqFieldOptions)
    pub struct_size: u32,
    /// 1: the network's guess steers the field where the sketch has an outline, the default; 0: feature lines and
    /// smoothness alone.
    pub use_network: u32,
    /// 0, the default: the directions may cross the border; 1: one family follows it; else the sum of the sides that
    /// it follows: 2 for u = min, 4 for u = max, 8 for v = min, 16 for v = max.
    pub align_border: u32,
    /// Cells of the triangulation along the longer side of a patch; 0, the default: chosen by the library. 8 to 256.
    pub resolution: u32,
    /// Smallest crossing angle of the two families, degrees, in (0, 80]. Default 20.
    pub crossing_floor_deg: f64,
    /// The singularities that the field shall have, and no others: a count of 0 asks for none. NULL, the default: the solver places
    /// what it needs.
    pub singularities: *const S2pqSingularities,
    /// Edge length that the mesh will be asked for, canvas unit; 0, the default: that of the wanted number of faces. Where an aligned border
    /// turns by more than 45 degrees within it the panels have a corner; nothing else depends on it.
    pub edge_length: f64,
    /// Faces over all patches that the mesh will be asked for, where edge_length is 0. Default 500.
    pub faces: u32,
    /// Not used; 0.
    pub reserved: u32,
}

// SAFETY: repr(C), size first, four u32, an f64, a pointer, an f64 and two u32: no padding, and any bits are a valid raw pointer.
unsafe impl Sized32 for S2pqFieldOptions {
    const NAME: &'static str = "S2pqFieldOptions";
    const DEFAULT: Self = Self {
        struct_size: 0,
        use_network: DEFAULTS.use_network as u32,
        align_border: 0,
        resolution: DEFAULTS.resolution as u32,
        crossing_floor_deg: DEFAULTS.crossing_floor_deg,
        singularities: std::ptr::null(),
        edge_length: DEFAULTS.edge_length,
        faces: DEFAULTS.faces as u32,
        reserved: 0,
    };
}

const DEFAULTS: &FieldOptions = &FieldOptions::DEFAULT;

impl S2pqFieldOptions {
    /// What the host asks for, with what it lends copied.
    ///
    /// # Safety
    /// `singularities` is NULL or valid as its `struct_size` and count say.
    unsafe fn checked(&self) -> Result<FieldOptions, Error> {
        // SAFETY: the host's promise.
        let singularities =
            if self.singularities.is_null() { None } else { Some(unsafe { read(self.singularities)?.copied() }?) };
        let bits = self.align_border;
        if bits > 1 && (bits & 1 == 1 || bits > 0b11110) {
            let expected = "0, 1, or a sum of 2, 4, 8 and 16";
            return Err(Error::Argument { name: "align_border", value: bits.to_string(), expected });
        }
        Ok(FieldOptions {
            use_network: flag("use_network", self.use_network)?,
            aligned_sides: [2, 4, 8, 16].map(|side| bits == 1 || bits & side != 0),
            resolution: self.resolution as usize,
            crossing_floor_deg: self.crossing_floor_deg,
            singularities,
            faces: self.faces as usize,
            edge_length: self.edge_length,
        })
    }
}

/// Singularities that a field shall have, lent to sketch_to_cdf and surface_to_cdf by their options. Set struct_size before the call, and
/// clear the rest.
///
/// The field has each of them at the nearest inner vertex of its triangulation. Where a side of the patch is not aligned, any will do;
/// where all sides are, the indices have to sum to 4 less one for each corner of the border of about 90 degrees, 0 with four such corners.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqSingularities {
    /// sizeof(S2pqSingularities)
    pub struct_size: u32,
    /// Not used; 0.
    pub reserved: u32,
    /// Number of singularities.
    pub count: u64,
    /// x, y, z of each, world frame; they are brought to the nearest points of the surface, at most a tenth of its size away. NULL where
    /// `parameters` are given.
    pub points: *const f64,
    /// u, v of each; NULL where `points` are given.
    pub parameters: *const f64,
    /// For each the patch of its `parameters`; NULL: all on patch 0.
    pub patches: *const u32,
    /// For each its index in quarter turns: 1 where three, -1 where five quads meet.
    pub indices: *const i32,
}

// SAFETY: repr(C), size first, two u32, a u64, four pointers: no padding, and any bits are valid raw pointers.
unsafe impl Sized32 for S2pqSingularities {
    const NAME: &'static str = "S2pqSingularities";
    const DEFAULT: Self = Self {
        struct_size: 0,
        reserved: 0,
        count: 0,
        points: std::ptr::null(),
        parameters: std::ptr::null(),
        patches: std::ptr::null(),
        indices: std::ptr::null(),
    };
}

impl S2pqSingularities {
    /// Copies what the host lends.
    ///
    /// # Safety
    /// The arrays are as long as the count says.
    unsafe fn copied(&self) -> Result<Vec<FixedSingularity>, Error> {
        let count = usize::try_from(self.count).unwrap_or(usize::MAX);
        if count == 0 {
            return Ok(vec![]);
        }
        if self.points.is_null() == self.parameters.is_null() {
            let value = if self.points.is_null() { "neither" } else { "both" }.into();
            return Err(Error::Argument { name: "points and parameters", value, expected: "one of them" });
        }
        // SAFETY: the host's promise.
        let indices = unsafe { slice("indices", self.indices, count) }?;
        let places: Vec<SurfacePlace> = if self.parameters.is_null() {
            // SAFETY: the host's promise.
            let points = unsafe { slice("points", self.points, count.saturating_mul(3)) }?;
            points.chunks_exact(3).map(|p| SurfacePlace::Point(Point3::new(p[0], p[1], p[2]))).collect()
        } else {
            // SAFETY: the host's promise.
            let uv = unsafe { slice("parameters", self.parameters, count.saturating_mul(2)) }?;
            // SAFETY: the host's promise.
            let patches = if self.patches.is_null() { &[] } else { unsafe { slice("patches", self.patches, count) }? };
            let patch = |k: usize| patches.get(k).map_or(0, |&patch| patch as usize);
            let place = |(k, uv): (usize, &[f64])| SurfacePlace::Parameters { patch: patch(k), uv: [uv[0], uv[1]] };
            uv.chunks_exact(2).enumerate().map(place).collect()
        };
        Ok(places.into_iter().zip(indices).map(|(place, &index)| FixedSingularity { place, index }).collect())
    }
}

/// Curves on or near a surface, lent to surface_to_cdf. Set struct_size before the call, and clear the rest.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqCurves {
    /// sizeof(S2pqCurves)
    pub struct_size: u32,
    /// Not used; 0.
    pub reserved: u32,
    /// Number of curves.
    pub curve_count: u64,
    /// First point of each curve and, last, the number of points: curve_count + 1 entries, each curve two points or more.
    pub starts: *const u32,
    /// x, y, z of all points, world frame; they are brought to the nearest points of the surface, at most a tenth of its
    /// size away.
    pub points: *const f64,
    /// For each curve 1: one family follows it exactly, or 0: it yields where curves contradict each other; NULL: all 0.
    pub hard: *const u8,
}

// SAFETY: repr(C), size first, two u32, a u64, three pointers: no padding, and any bits are valid raw pointers.
unsafe impl Sized32 for S2pqCurves {
    const NAME: &'static str = "S2pqCurves";
    const DEFAULT: Self = Self {
        struct_size: 0,
        reserved: 0,
        curve_count: 0,
        starts: std::ptr::null(),
        points: std::ptr::null(),
        hard: std::ptr::null(),
    };
}

impl S2pqCurves {
    /// Copies what the host lends.
    ///
    /// # Safety
    /// The arrays are as long as the counts say.
    unsafe fn copied(&self) -> Result<Vec<FeatureCurve>, Error> {
        let count = usize::try_from(self.curve_count).unwrap_or(usize::MAX);
        if count == 0 {
            return Ok(vec![]);
        }
        // SAFETY: the host's promise.
        let starts = unsafe { slice("starts", self.starts, count.saturating_add(1)) }?;
        if starts[0] != 0 || starts.windows(2).any(|pair| pair[1] < pair[0]) {
            let value = "not ascending from 0".into();
            return Err(Error::Argument { name: "starts", value, expected: "the first point of each curve" });
        }
        // SAFETY: the host's promise.
        let points = unsafe { slice("points", self.points, 3 * starts[count] as usize) }?;
        // SAFETY: the host's promise.
        let hard = if self.hard.is_null() { &[] } else { unsafe { slice("hard", self.hard, count) }? };
        let curve = |k: usize| {
            let xyz = &points[3 * starts[k] as usize..3 * starts[k + 1] as usize];
            let points = xyz.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect();
            Ok(FeatureCurve { points, hard: flag("hard", hard.get(k).copied().unwrap_or(0).into())? })
        };
        (0..count).map(curve).collect()
    }
}

/// How good a field is, over all its patches. Set struct_size before the call.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct S2pqFieldDiagnostics {
    /// sizeof(S2pqFieldDiagnostics)
    pub struct_size: u32,
    /// Number of singular vertices.
    pub singularities: u32,
    /// Mean over the curved triangles of |II(u, v)| / (|II| |u| |v|), in [0, 1/sqrt 2].
    pub conjugacy_mean: f64,
    /// Largest of the same.
    pub conjugacy_max: f64,
    /// Smallest angle between the two families, degrees.
    pub crossing_min_deg: f64,
    /// Mean angle between the feature lines and the nearer family, degrees; 0 without feature lines.
    pub feature_angle_deg: f64,
}

// SAFETY: repr(C), size first, two u32 and four f64: no padding, all bits valid.
unsafe impl Sized32 for S2pqFieldDiagnostics {
    const NAME: &'static str = "S2pqFieldDiagnostics";
    const DEFAULT: Self = Self {
        struct_size: 0,
        singularities: 0,
        conjugacy_mean: 0.0,
        conjugacy_max: 0.0,
        crossing_min_deg: 0.0,
        feature_angle_deg: 0.0,
    };
}

/// A conjugate pair of directions on every triangle of a surface. Made by sketch_to_cdf or surface_to_cdf; independent of the surface's
/// handle.
pub struct S2pqField {
    pub(super) result: FieldResult,
    vertices: Vec<f64>,
    triangles: Vec<u32>,
    directions: Vec<f64>,
    singular_vertices: Vec<u32>,
    singular_indices: Vec<i32>,
    floor_triangles: Vec<u32>,
    vertex_starts: Vec<u32>,
    triangle_starts: Vec<u32>,
    report: CString,
}

impl Handle for S2pqField {
    const NAME: &'static str = "S2pqField";
}

impl S2pqField {
    fn new(result: FieldResult) -> Self {
        let report = lent_text(result.report.to_json());
        let mut field = Self {
            vertices: vec![],
            triangles: vec![],
            directions: vec![],
            singular_vertices: vec![],
            singular_indices: vec![],
            floor_triangles: vec![],
            vertex_starts: vec![0],
            triangle_starts: vec![0],
            report,
            result,
        };
        for patch in &field.result.patches {
            let first = (field.vertices.len() / 3) as u32;
            field.vertices.extend(patch.vertices().flat_map(|p| [p.x, p.y, p.z]));
            field.triangles.extend(patch.field.mesh.triangles.iter().flatten().map(|v| first + v));
            field.directions.extend(patch.directions().flat_map(|[u, v]| [u.x, u.y, u.z, v.x, v.y, v.z]));
            field.singular_vertices.extend(patch.field.singularities.iter().map(|s| first + s.vertex));
            field.singular_indices.extend(patch.field.singularities.iter().map(|s| s.index));
            let first = (field.triangles.len() / 3 - patch.field.mesh.triangles.len()) as u32;
            field.floor_triangles.extend(patch.field.diagnostics.floor_triangles.iter().map(|t| first + t));
            field.vertex_starts.push((field.vertices.len() / 3) as u32);
            field.triangle_starts.push((field.triangles.len() / 3) as u32);
        }
        field
    }
}

/// Gives every option its default.
///
/// - `size`: sizeof(S2pqFieldOptions) as the host compiled it.
///
/// # Safety
/// `options` is valid for writing `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_options_init(options: *mut S2pqFieldOptions, size: usize) -> S2pqStatus {
    // SAFETY: the host's promise.
    guard(|| unsafe { write(options, size, &S2pqFieldOptions::DEFAULT) })
}

/// Finds a conjugate direction field on a surface, aligned with the feature lines of a sketch.
///
/// - `sketch`: the sketch that the surface was made from, perhaps with other feature lines; or, for a host's own
///   surface, feature lines drawn over its picture in the sketch's view; or NULL: the surface alone decides.
/// - `surface`: read only.
/// - `options`: NULL for the defaults.
/// - `field`: takes the new field.
///
/// # Safety
/// `options`, and the singularities that it points to, are NULL or valid as their `struct_size` and count say; `field` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sketch_to_cdf(
    session: *mut S2pqSession,
    sketch: *const S2pqSketch,
    surface: *const S2pqSurface,
    options: *const S2pqFieldOptions,
    field: *mut *mut S2pqField,
) -> S2pqStatus {
    guard(|| {
        let place = output("field", field)?;
        // SAFETY: not freed during the call, as the header asks.
        let (session, surface) = unsafe { (get(session)?, get(surface)?) };
        // SAFETY: not freed during the call, as the header asks.
        let sketch = if sketch.is_null() { None } else { Some(&unsafe { get(sketch) }?.sketch) };
        // SAFETY: the host's promise.
        let options = unsafe { read(options)?.checked() }?;
        let result = pipeline::sketch_to_cdf(&mut *session.lock()?, sketch, &surface.result, &options)?;
        place.set(lend(S2pqField::new(result)));
        Ok(())
    })
}

/// Finds a conjugate direction field on a surface, e.g. a host's own from s2pq_surface_from_nurbs, aligned with curves in
/// space.
///
/// - `surface`: read only.
/// - `curves`: NULL for none; then, unless sides are aligned, the field is the smoothest one near the principal directions.
/// - `options`: NULL for the defaults; no network runs.
/// - `field`: takes the new field.
///
/// # Safety
/// `curves`, `options` and the singularities that it points to are NULL or valid as their `struct_size` and counts say; `field` is valid
/// for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn surface_to_cdf(
    session: *mut S2pqSession,
    surface: *const S2pqSurface,
    curves: *const S2pqCurves,
    options: *const S2pqFieldOptions,
    field: *mut *mut S2pqField,
) -> S2pqStatus {
    guard(|| {
        let place = output("field", field)?;
        // SAFETY: not freed during the call, as the header asks.
        let (session, surface) = unsafe { (get(session)?, get(surface)?) };
        // SAFETY: the host's promise.
        let (curves, options) = unsafe { (read(curves)?.copied()?, read(options)?.checked()?) };
        let result = pipeline::surface_to_cdf(&mut *session.lock()?, &surface.result, &curves, &options)?;
        place.set(lend(S2pqField::new(result)));
        Ok(())
    })
}

/// First vertex and first triangle of each patch, `patch_count` + 1 entries each; lent until the field is freed.
///
/// The arrays of a field hold its patches one after another.
///
/// # Safety
/// `vertex_starts`, `triangle_starts` and `patch_count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_patches(
    field: *const S2pqField,
    vertex_starts: *mut *const u32,
    triangle_starts: *mut *const u32,
    patch_count: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let field = unsafe { get(field) }?;
        let (vertices, triangles) =
            (output("vertex_starts", vertex_starts)?, output("triangle_starts", triangle_starts)?);
        output("patch_count", patch_count)?.set(field.result.patches.len());
        vertices.set(field.vertex_starts.as_ptr());
        triangles.set(field.triangle_starts.as_ptr());
        Ok(())
    })
}

/// Vertices of the triangulation, `count` times x, y, z, world frame; lent until the field is freed.
///
/// # Safety
/// `xyz` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_vertices(
    field: *const S2pqField,
    xyz: *mut *const f64,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(field) }?.vertices, 3, xyz, count))
}

/// Triangles, `count` times three vertex indices, counter-clockwise about S_u x S_v; lent until the field is freed.
///
/// # Safety
/// `indices` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_triangles(
    field: *const S2pqField,
    indices: *mut *const u32,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(field) }?.triangles, 3, indices, count))
}

/// Directions, for each triangle u then v, unit vectors in its plane, world frame, `count` times six numbers; lent
/// until the field is freed.
///
/// u and v carry no sign and no order from one triangle to the next: the cross u, v, -u, -v is what continues.
///
/// # Safety
/// `uv` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_directions(
    field: *const S2pqField,
    uv: *mut *const f64,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(field) }?.directions, 6, uv, count))
}

/// Singular vertices and their indices in quarter turns: +1 where three, -1 where five quads meet; lent until the field
/// is freed.
///
/// # Safety
/// `vertices`, `indices` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_singularities(
    field: *const S2pqField,
    vertices: *mut *const u32,
    indices: *mut *const i32,
    count: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let field = unsafe { get(field) }?;
        let indices = output("indices", indices)?;
        lend_array(&field.singular_vertices, 1, vertices, count)?;
        indices.set(field.singular_indices.as_ptr());
        Ok(())
    })
}

/// Triangles where a hard curve or an aligned side left no conjugate pair above the smallest crossing angle, so that the
/// angle won and the pair is not conjugate; lent until the field is freed.
///
/// # Safety
/// `triangles` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_floor_triangles(
    field: *const S2pqField,
    triangles: *mut *const u32,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(field) }?.floor_triangles, 1, triangles, count))
}

/// How good a field is.
///
/// - `diagnostics`: set its struct_size first.
///
/// # Safety
/// `diagnostics` is valid for writing as many bytes as its `struct_size` says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_diagnostics(
    field: *const S2pqField,
    diagnostics: *mut S2pqFieldDiagnostics,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let field = unsafe { get(field) }?;
        let all = field.result.measures();
        let value = S2pqFieldDiagnostics {
            struct_size: 0,
            singularities: field.singular_vertices.len() as u32,
            conjugacy_mean: all.conjugacy_mean,
            conjugacy_max: all.conjugacy_max,
            crossing_min_deg: all.crossing_min_deg,
            feature_angle_deg: all.feature_angle_deg,
        };
        // SAFETY: the host's promise.
        unsafe { fill(diagnostics, &value) }
    })
}

/// Measures and times so far as JSON, UTF-8, NUL-terminated; lent until the field is freed.
///
/// # Safety
/// `json` and `length` are valid for writing; `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_report_json(
    field: *const S2pqField,
    json: *mut *const c_char,
    length: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_text(&unsafe { get(field) }?.report, json, length))
}

/// Frees a field; NULL is fine. Meshes made from it stay alive.
///
/// # Safety
/// No call uses the field or a view of it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_field_free(field: *mut S2pqField) {
    free(field);
}
