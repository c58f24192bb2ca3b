//! A host's own polygons made planar: the last stage alone.

use super::guard::guard;
use super::handle::{get, lend};
use super::mesh::{S2pqMesh, hold, offsets};
use super::options::{Sized32, read, write};
use super::session::S2pqSession;
use super::surface::S2pqSurface;
use super::{S2pqStatus, flag, output, slice};
use crate::error::Error;
use crate::mesh::{PanelMesh, PlanarizeOptions};
use crate::pipeline::{self, PanelOptions};
use nalgebra::Point3;

/// A host's own polygon mesh, lent for a call. Set struct_size first.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqPolygons {
    /// sizeof(S2pqPolygons)
    pub struct_size: u32,
    /// Zero.
    pub reserved: u32,
    /// Number of vertices.
    pub vertex_count: u64,
    /// Number of faces.
    pub face_count: u64,
    /// Number of vertices that do not move at all.
    pub pin_count: u64,
    /// vertex_count times x, y, z; world frame, any unit.
    pub vertices: *const f64,
    /// face_count + 1 entries: face f has the vertices `indices[starts[f]]` to `indices[starts[f + 1] - 1]`.
    pub starts: *const u32,
    /// `starts[face_count]` entries.
    pub indices: *const u32,
    /// pin_count vertices, in any order; NULL if there is none.
    pub pins: *const u32,
}

// SAFETY: repr(C), size first, two u32, three u64, four pointers: no padding, and any bits are valid raw pointers.
unsafe impl Sized32 for S2pqPolygons {
    const NAME: &'static str = "S2pqPolygons";
    const DEFAULT: Self = Self {
        struct_size: 0,
        reserved: 0,
        vertex_count: 0,
        face_count: 0,
        pin_count: 0,
        vertices: std::ptr::null(),
        starts: std::ptr::null(),
        indices: std::ptr::null(),
        pins: std::ptr::null(),
    };
}

/// Options of s2pq_planarize. Fill them by s2pq_planarize_options_init, then change what you need.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqPlanarizeOptions {
    /// sizeof(S2pqPlanarizeOptions)
    pub struct_size: u32,
    /// An S2pqOffsets. Default: S2PQ_OFFSETS_ANY.
    pub offsets: u32,
    /// An S2pqHold. Default: S2PQ_HOLD_SLIDE.
    pub hold: u32,
    /// 1: a mesh whose planarity misses the target is S2PQ_STATUS_NOT_REACHED; 0, the default: it is given with its
    /// measures.
    pub strict: u32,
    /// Wanted planarity of the worst face: distance of the diagonals over the mean edge length. Default 1e-6.
    pub planarity: f64,
    /// Distance to the surface that no vertex should exceed, the mesh's unit; 0, the default: 2 % of the mesh's width or
    /// a fifth of its mean edge length, whichever is smaller.
    pub deviation: f64,
    /// Weight of the squared distance to the surface, in mean edge lengths. Default 1.
    pub closeness: f64,
    /// Weight of the change of the second differences along the polylines. Default 0.5.
    pub fairness: f64,
    /// Weight of the squared distance from where each vertex started; above 0. Default 0.01: vertices slide within the surface. 1 and more, with
    /// little fairness: each stays near its place.
    pub anchor: f64,
}

// SAFETY: repr(C), size first, four u32 and five f64: no padding, all bits valid.
unsafe impl Sized32 for S2pqPlanarizeOptions {
    const NAME: &'static str = "S2pqPlanarizeOptions";
    const DEFAULT: Self = Self {
        struct_size: 0,
        offsets: 0,
        hold: 0,
        strict: 0,
        planarity: PlanarizeOptions::DEFAULT.target,
        deviation: 0.0,
        closeness: PlanarizeOptions::DEFAULT.closeness,
        fairness: PlanarizeOptions::DEFAULT.fairness,
        anchor: PlanarizeOptions::DEFAULT.anchor,
    };
}

/// Gives every option its default.
///
/// - `size`: sizeof(S2pqPlanarizeOptions) as the host compiled it.
///
/// # Safety
/// `options` is valid for writing `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_planarize_options_init(options: *mut S2pqPlanarizeOptions, size: usize) -> S2pqStatus {
    // SAFETY: the host's promise.
    guard(|| unsafe { write(options, size, &S2pqPlanarizeOptions::DEFAULT) })
}

/// Moves the vertices of a host's own mesh until every face is planar; faces and numbering stay.
///
/// - `polygons`: quads or any polygons, of three and more corners.
/// - `surface`: a surface of one patch to stay on; NULL: the mesh stays close to itself as it is given.
/// - `options`: NULL for the defaults.
/// - `mesh`: takes the new mesh: one patch.
///
/// # Safety
/// `polygons` is valid as its fields say; `options` is NULL or valid as its `struct_size` says; `mesh` is valid for
/// writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_planarize(
    session: *mut S2pqSession,
    polygons: *const S2pqPolygons,
    surface: *const S2pqSurface,
    options: *const S2pqPlanarizeOptions,
    mesh: *mut *mut S2pqMesh,
) -> S2pqStatus {
    guard(|| {
        let place = output("mesh", mesh)?;
        // SAFETY: not freed during the call, as the header asks.
        let session = unsafe { get(session) }?;
        // SAFETY: as above.
        let surface = if surface.is_null() { None } else { Some(unsafe { get(surface) }?) };
        // SAFETY: the host's promise.
        let (given, options) = unsafe { (read(polygons)?, read(options)?) };
        // SAFETY: the host vouches for its arrays.
        let (polygons, pins) = unsafe { (panels(&given)?, slice("pins", given.pins, given.pin_count as usize)?) };
        let planarize = PlanarizeOptions {
            target: options.planarity,
            deviation: (options.deviation != 0.0).then_some(options.deviation),
            closeness: options.closeness,
            fairness: options.fairness,
            anchor: options.anchor,
            offsets: offsets(options.offsets)?,
            ..PlanarizeOptions::DEFAULT
        };
        let options = PanelOptions { hold: hold(options.hold)?, strict: flag("strict", options.strict)?, planarize };
        let surface = surface.map(|s| &s.result);
        let result = pipeline::planarize_panels(&mut *session.lock()?, &polygons, surface, pins, &options)?;
        place.set(lend(S2pqMesh::new(result)));
        Ok(())
    })
}

/// The mesh that a host lends.
///
/// # Safety
/// The pointers are valid as the counts and the last start say.
///
/// # Errors
/// [`Error::Argument`] for starts that do not ascend from 0, and for a coordinate that is not finite; as [`slice`] and [`PanelMesh::new`].
unsafe fn panels(given: &S2pqPolygons) -> Result<PanelMesh, Error> {
    let entries = given.face_count.saturating_add(1);
    let coordinates = given.vertex_count.saturating_mul(3);
    // SAFETY: the caller's promise.
    let (vertices, starts) = unsafe {
        (slice("vertices", given.vertices, coordinates as usize)?, slice("starts", given.starts, entries as usize)?)
    };
    if let Some(x) = vertices.iter().find(|x| !x.is_finite()) {
        return Err(Error::Argument { name: "vertices", value: x.to_string(), expected: "finite coordinates" });
    }
    let ascend = starts.first() == Some(&0) && starts.is_sorted();
    let Some(&end) = starts.last().filter(|_| ascend) else {
        let value = "not ascending from 0".into();
        return Err(Error::Argument { name: "starts", value, expected: "the start of each face, ascending from 0" });
    };
    // SAFETY: the caller's promise.
    let indices = unsafe { slice("indices", given.indices, end as usize) }?;
    let faces: Vec<&[u32]> = starts.windows(2).map(|w| &indices[w[0] as usize..w[1] as usize]).collect();
    let vertices = vertices.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect();
    PanelMesh::new(vertices, &faces)
}
