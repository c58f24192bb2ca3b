//! Meshes of planar panels: the third call, and views.

use super::field::S2pqField;
use super::guard::guard;
use super::handle::{Handle, free, get, lend};
use super::options::{Sized32, fill, read, write};
use super::session::S2pqSession;
use super::{S2pqStatus, choice, lend_array, lend_text, lent_text, output};
use crate::error::Error;
use crate::mesh::{BorderMode, OffsetKind};
use crate::pipeline::{self, BorderHold, MeshOptions, MeshResult};
use std::ffi::{CString, c_char};

/// What becomes of the cells at the border; passed as uint32_t.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum S2pqBorder {
    /// Cells cut by the border become planar polygons whose border vertices lie on the surface's border.
    Trimmed = 0,
    /// The field follows the border, and so do edge loops. Asks for a field made with align_border = 1 to do it well.
    Aligned = 1,
    /// Whole quads only; the mesh ends inside the border.
    Interior = 2,
}

/// In the order of [`S2pqBorder`].
const BORDERS: [BorderMode; 3] = [BorderMode::Trimmed, BorderMode::Aligned, BorderMode::Interior];

/// What vertices on the border of a mesh may do while its faces become planar; passed as uint32_t.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum S2pqHold {
    /// Move along the border of the surface, or of the mesh as it is given.
    Slide = 0,
    /// Not move at all.
    Pinned = 1,
    /// Move like any other vertex.
    Free = 2,
}

/// In the order of [`S2pqHold`].
const HOLDS: [BorderHold; 3] = [BorderHold::Slide, BorderHold::Pinned, BorderHold::Free];

/// Offsets that a mesh should have, as far as planarity and closeness allow; passed as uint32_t.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum S2pqOffsets {
    /// Any.
    Any = 0,
    /// Each quad has a circumscribed circle: offsets at constant distance between vertices.
    Circular = 1,
    /// The panels around each vertex touch a cone: offsets at constant distance between panels.
    Conical = 2,
}

/// In the order of [`S2pqOffsets`].
const OFFSETS: [OffsetKind; 3] = [OffsetKind::Any, OffsetKind::Circular, OffsetKind::Conical];

/// `number` as an S2pqHold.
pub(super) fn hold(number: u32) -> Result<BorderHold, Error> {
    choice("hold", number, &HOLDS, "an S2pqHold")
}

/// `number` as an S2pqOffsets.
pub(super) fn offsets(number: u32) -> Result<OffsetKind, Error> {
    choice("offsets", number, &OFFSETS, "an S2pqOffsets")
}

/// Options of extract_pq_mesh. Fill them by s2pq_mesh_options_init, then change what you need.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqMeshOptions {
    /// sizeof(S2pqMeshOptions)
    pub struct_size: u32,
    /// An S2pqBorder. Default: S2PQ_BORDER_TRIMMED.
    pub border: u32,
    /// Wanted number of faces over all patches, where edge_length is 0. Default 500.
    pub faces: u32,
    /// 1: a mesh whose planarity misses the target is S2PQ_STATUS_NOT_REACHED; 0, the default: it is given with its
    /// measures.
    pub strict: u32,
    /// Wanted edge length, canvas unit; 0, the default: chosen to give the wanted number of faces.
    pub edge_length: f64,
    /// Wanted planarity of the worst face: distance of the diagonals over the mean edge length. Default 1e-6.
    pub planarity: f64,
    /// An S2pqOffsets. Default: S2PQ_OFFSETS_ANY.
    pub offsets: u32,
    /// An S2pqHold. Default: S2PQ_HOLD_SLIDE.
    pub hold: u32,
}

// SAFETY: repr(C), size first, four u32, two f64 and two u32: no padding, all bits valid.
unsafe impl Sized32 for S2pqMeshOptions {
    const NAME: &'static str = "S2pqMeshOptions";
    const DEFAULT: Self = Self {
        struct_size: 0,
        border: 0,
        faces: MeshOptions::DEFAULT.faces as u32,
        strict: MeshOptions::DEFAULT.strict as u32,
        edge_length: MeshOptions::DEFAULT.edge_length,
        planarity: MeshOptions::DEFAULT.planarity,
        offsets: 0,
        hold: 0,
    };
}

/// Measures of a mesh, over all its patches. Set struct_size before the call.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct S2pqMeshReport {
    /// sizeof(S2pqMeshReport)
    pub struct_size: u32,
    /// Number of faces.
    pub faces: u32,
    /// Number of faces with four corners.
    pub quads: u32,
    /// Number of inner vertices where another number than four edges meets.
    pub irregular_vertices: u32,
    /// Planarity of the worst face: distance of the diagonals over the mean edge length.
    pub planarity_max: f64,
    /// Mean planarity.
    pub planarity_mean: f64,
    /// Largest distance between a vertex and the surface, canvas unit.
    pub deviation_max: f64,
    /// The same over the mean edge length.
    pub deviation_max_edges: f64,
    /// Mean edge length, canvas unit.
    pub edge_length_mean: f64,
    /// Share of the surface's border, by length, that lies within a tenth of the mean edge length of the mesh's border,
    /// in [0, 1]; 0 without a surface.
    pub border_covered: f64,
    /// Milliseconds of all stages together, from the sketch on.
    pub time_ms: f64,
    /// Largest distance between a vertex and the surface over what was allowed: 2 % of the patch's width or a fifth of its mean edge length,
    /// whichever is smaller, unless the host said otherwise. Above 1 planarity and closeness contradict each other.
    pub deviation_over_limit: f64,
    /// Largest distance between a border vertex and the surface's border over the patch's width; 0 where border vertices are free.
    pub border_deviation_widths: f64,
}

// SAFETY: repr(C), size first, four u32 and nine f64: no padding, all bits valid.
unsafe impl Sized32 for S2pqMeshReport {
    const NAME: &'static str = "S2pqMeshReport";
    const DEFAULT: Self = Self {
        struct_size: 0,
        faces: 0,
        quads: 0,
        irregular_vertices: 0,
        planarity_max: 0.0,
        planarity_mean: 0.0,
        deviation_max: 0.0,
        deviation_max_edges: 0.0,
        edge_length_mean: 0.0,
        border_covered: 0.0,
        time_ms: 0.0,
        deviation_over_limit: 0.0,
        border_deviation_widths: 0.0,
    };
}

/// Planar panels: vertices and polygons, world frame, canvas unit. Made by extract_pq_mesh or s2pq_planarize; independent
/// of the handles that it was made from.
pub struct S2pqMesh {
    result: MeshResult,
    vertices: Vec<f64>,
    starts: Vec<u32>,
    indices: Vec<u32>,
    planarity: Vec<f64>,
    deviation: Vec<f64>,
    on_border: Vec<u8>,
    irregular: Vec<u32>,
    vertex_starts: Vec<u32>,
    face_starts: Vec<u32>,
    obj: CString,
    report: CString,
}

impl Handle for S2pqMesh {
    const NAME: &'static str = "S2pqMesh";
}

impl S2pqMesh {
    pub(super) fn new(result: MeshResult) -> Self {
        let obj = lent_text(result.obj());
        let report = lent_text(result.report.to_json());
        let mut mesh = Self {
            vertices: vec![],
            starts: vec![0],
            indices: vec![],
            planarity: vec![],
            deviation: vec![],
            on_border: vec![],
            irregular: vec![],
            vertex_starts: vec![0],
            face_starts: vec![0],
            obj,
            report,
            result,
        };
        for patch in &mesh.result.patches {
            let first = (mesh.vertices.len() / 3) as u32;
            mesh.vertices.extend(patch.mesh.vertices.iter().flat_map(|p| [p.x, p.y, p.z]));
            for face in patch.mesh.faces() {
                mesh.indices.extend(face.iter().map(|v| first + v));
                mesh.starts.push(mesh.indices.len() as u32);
            }
            mesh.planarity.extend_from_slice(&patch.planarity);
            mesh.deviation.extend_from_slice(&patch.deviation);
            mesh.on_border.extend(patch.on_border.iter().map(|&b| u8::from(b)));
            mesh.irregular.extend(patch.irregular.iter().map(|v| first + v));
            mesh.vertex_starts.push((mesh.vertices.len() / 3) as u32);
            mesh.face_starts.push(mesh.starts.len() as u32 - 1);
        }
        mesh
    }
}

/// Gives every option its default.
///
/// - `size`: sizeof(S2pqMeshOptions) as the host compiled it.
///
/// # Safety
/// `options` is valid for writing `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_options_init(options: *mut S2pqMeshOptions, size: usize) -> S2pqStatus {
    // SAFETY: the host's promise.
    guard(|| unsafe { write(options, size, &S2pqMeshOptions::DEFAULT) })
}

/// Extracts panels along a field and moves their vertices until every panel is planar.
///
/// - `field`: read only.
/// - `options`: NULL for the defaults.
/// - `mesh`: takes the new mesh, all patches one after another.
///
/// # Safety
/// `options` is NULL or valid as its `struct_size` says; `mesh` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn extract_pq_mesh(
    session: *mut S2pqSession,
    field: *const S2pqField,
    options: *const S2pqMeshOptions,
    mesh: *mut *mut S2pqMesh,
) -> S2pqStatus {
    guard(|| {
        let place = output("mesh", mesh)?;
        // SAFETY: not freed during the call, as the header asks.
        let (session, field) = unsafe { (get(session)?, get(field)?) };
        // SAFETY: the host's promise.
        let options = unsafe { read(options) }?;
        let options = MeshOptions {
            border: choice("border", options.border, &BORDERS, "an S2pqBorder")?,
            faces: options.faces as usize,
            strict: super::flag("strict", options.strict)?,
            edge_length: options.edge_length,
            planarity: options.planarity,
            offsets: offsets(options.offsets)?,
            hold: hold(options.hold)?,
        };
        let result = pipeline::extract_pq_mesh(&mut *session.lock()?, &field.result, &options)?;
        place.set(lend(S2pqMesh::new(result)));
        Ok(())
    })
}

/// First vertex and first face of each patch, `patch_count` + 1 entries each; lent until the mesh is freed.
///
/// # Safety
/// `vertex_starts`, `face_starts` and `patch_count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_patches(
    mesh: *const S2pqMesh,
    vertex_starts: *mut *const u32,
    face_starts: *mut *const u32,
    patch_count: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let mesh = unsafe { get(mesh) }?;
        let (vertices, faces) = (output("vertex_starts", vertex_starts)?, output("face_starts", face_starts)?);
        output("patch_count", patch_count)?.set(mesh.result.patches.len());
        vertices.set(mesh.vertex_starts.as_ptr());
        faces.set(mesh.face_starts.as_ptr());
        Ok(())
    })
}

/// Vertices, `count` times x, y, z, world frame (right-handed, z up), canvas unit; lent until the mesh is freed.
///
/// # Safety
/// `xyz` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_vertices(
    mesh: *const S2pqMesh,
    xyz: *mut *const f64,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(mesh) }?.vertices, 3, xyz, count))
}

/// Faces: face f has the vertices `indices[starts[f]]` to `indices[starts[f + 1] - 1]`, counter-clockwise seen from the
/// surface's front; lent until the mesh is freed.
///
/// - `starts`: `count` + 1 entries.
/// - `indices`: `starts[count]` entries.
///
/// # Safety
/// `starts`, `indices` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_faces(
    mesh: *const S2pqMesh,
    starts: *mut *const u32,
    indices: *mut *const u32,
    count: *mut usize,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let mesh = unsafe { get(mesh) }?;
        let (starts, indices) = (output("starts", starts)?, output("indices", indices)?);
        output("count", count)?.set(mesh.starts.len() - 1);
        starts.set(mesh.starts.as_ptr());
        indices.set(mesh.indices.as_ptr());
        Ok(())
    })
}

/// Planarity of each face: distance of the diagonals' lines over the mesh's mean edge length; lent until the mesh is
/// freed.
///
/// # Safety
/// `values` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_planarity(
    mesh: *const S2pqMesh,
    values: *mut *const f64,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(mesh) }?.planarity, 1, values, count))
}

/// Distance of each vertex from the surface, of border vertices from the surface's border; canvas unit; lent until the
/// mesh is freed.
///
/// # Safety
/// `values` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_deviation(
    mesh: *const S2pqMesh,
    values: *mut *const f64,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(mesh) }?.deviation, 1, values, count))
}

/// For each vertex 1 if it lies on the mesh's border, else 0; lent until the mesh is freed.
///
/// # Safety
/// `flags` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_border(
    mesh: *const S2pqMesh,
    flags: *mut *const u8,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(mesh) }?.on_border, 1, flags, count))
}

/// Inner vertices where another number than four edges meets; lent until the mesh is freed.
///
/// # Safety
/// `vertices` and `count` are valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_irregular_vertices(
    mesh: *const S2pqMesh,
    vertices: *mut *const u32,
    count: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_array(&unsafe { get(mesh) }?.irregular, 1, vertices, count))
}

/// Measures of the whole mesh.
///
/// - `report`: set its struct_size first.
///
/// # Safety
/// `report` is valid for writing as many bytes as its `struct_size` says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_report(mesh: *const S2pqMesh, report: *mut S2pqMeshReport) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let mesh = unsafe { get(mesh) }?;
        let all = mesh.result.measures();
        let value = S2pqMeshReport {
            struct_size: 0,
            faces: all.faces as u32,
            quads: all.quads as u32,
            irregular_vertices: all.irregular_vertices as u32,
            planarity_max: all.planarity_max,
            planarity_mean: all.planarity_mean,
            deviation_max: all.deviation_max,
            deviation_max_edges: all.deviation_max_edges,
            edge_length_mean: all.edge_length_mean,
            border_covered: all.border_covered.unwrap_or(0.0),
            time_ms: mesh.result.report.time_ms.total(),
            deviation_over_limit: all.deviation_over_limit,
            border_deviation_widths: all.border_deviation_widths,
        };
        // SAFETY: the host's promise.
        unsafe { fill(report, &value) }
    })
}

/// The mesh as OBJ text, UTF-8, NUL-terminated; lent until the mesh is freed.
///
/// # Safety
/// `text` and `length` are valid for writing; `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_obj(
    mesh: *const S2pqMesh,
    text: *mut *const c_char,
    length: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_text(&unsafe { get(mesh) }?.obj, text, length))
}

/// Measures and times of all stages as JSON, UTF-8, NUL-terminated; lent until the mesh is freed.
///
/// # Safety
/// `json` and `length` are valid for writing; `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_report_json(
    mesh: *const S2pqMesh,
    json: *mut *const c_char,
    length: *mut usize,
) -> S2pqStatus {
    // SAFETY: not freed during the call, as the header asks.
    guard(|| lend_text(&unsafe { get(mesh) }?.report, json, length))
}

/// Frees a mesh; NULL is fine.
///
/// # Safety
/// No call uses the mesh or a view of it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_mesh_free(mesh: *mut S2pqMesh) {
    free(mesh);
}
