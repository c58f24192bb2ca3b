//! The border of a panel mesh.

use crate::mesh::panel_mesh::PanelMesh;

/// The vertices on edges that belong to one face only, ascending.
pub fn border_vertices(mesh: &PanelMesh) -> Vec<u32> {
    let mut vertices = border_sides(mesh).into_flattened();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// The edges that belong to one face only.
pub(super) fn border_sides(mesh: &PanelMesh) -> Vec<[u32; 2]> {
    let mut sides = Vec::with_capacity(mesh.indices.len());
    for face in mesh.faces() {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            sides.push([a.min(b), a.max(b)]);
        }
    }
    sides.sort_unstable();
    sides.chunk_by(|a, b| a == b).filter(|group| group.len() == 1).map(|group| group[0]).collect()
}

/// The vertices with two border edges, and the angle by which the border turns at each, radians.
pub(super) fn border_turns(mesh: &PanelMesh) -> Vec<(u32, f64)> {
    let mut ends: Vec<(u32, u32)> = border_sides(mesh).into_iter().flat_map(|[a, b]| [(a, b), (b, a)]).collect();
    ends.sort_unstable();
    let at = |v: u32| mesh.vertices[v as usize];
    ends.chunk_by(|a, b| a.0 == b.0)
        .filter(|group| group.len() == 2)
        .map(|group| (group[0].0, (at(group[0].0) - at(group[0].1)).angle(&(at(group[1].1) - at(group[0].0)))))
        .collect()
}
