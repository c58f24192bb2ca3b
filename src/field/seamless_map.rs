//! A seamless map: what extraction reads.

use crate::surface::SurfaceMesh;

/// One cell of the integer grid, in the fixed-point units of [`SeamlessMap::corners`]: 2^40.
pub const MAP_UNIT: i64 = 1 << 40;

/// What happens to map coordinates across a half-edge: z becomes i^turn z + shift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transition {
    /// Quarter turns, 0 to 3.
    pub turn: u8,
    /// Integer shift, in cells.
    pub shift: [i64; 2],
}

/// A seamless integer-grid map of a patch: on each triangle linear coordinates (a, b).
///
/// Isolines of a follow the field's v and those of b its u. Half-edge 3 t + k runs from corner k of triangle t to the next corner.
/// All coordinates are exact multiples of 1 / [`MAP_UNIT`], so both sides of a seam agree exactly. Those of singular vertices are integers; no
/// other vertex has an integer coordinate (they are moved off by one unit), so that no isoline of an integer meets a vertex elsewhere.
#[derive(Clone, Debug)]
pub struct SeamlessMap {
    /// The triangulated patch.
    pub mesh: SurfaceMesh,
    /// Coordinates of the three corners of each triangle, in 1 / [`MAP_UNIT`].
    pub corners: Vec<[[i64; 2]; 3]>,
    /// Half-edge on the other side of each half-edge, `u32::MAX` on the border.
    pub twin: Vec<u32>,
    /// For each vertex the first half-edge that leaves it, counter-clockwise; on the border the one without twin.
    pub outgoing: Vec<u32>,
    /// Transition across each half-edge from its triangle to the other one.
    pub transitions: Vec<Transition>,
    /// Singular vertices; integer coordinates in every triangle around them.
    pub singular: Vec<u32>,
    /// For each triangle, which direction (0 to 3 of u, v, -u, -v) a grows along.
    pub name: Vec<u8>,
    /// Sides of the patch (v = min, u = max, v = max, u = min) that are isolines at integers.
    pub fitted_sides: [bool; 4],
    /// Quality.
    pub diagnostics: MapDiagnostics,
}

/// Quality of a [`SeamlessMap`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapDiagnostics {
    /// Triangles turned over by the map.
    pub flipped: usize,
    /// Total signed area in cells.
    pub cells: f64,
    /// Mean angle between isolines and the field, over area and both families, degrees.
    pub direction_mean_deg: f64,
    /// The same before they were turned back.
    pub flipped_by_rounding: usize,
}
