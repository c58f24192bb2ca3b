//! The sides of a mesh's faces.

use sketch2pq::mesh::PanelMesh;
use std::collections::BTreeMap;

/// Undirected sides with the number of their faces.
pub fn sides(mesh: &PanelMesh) -> BTreeMap<[u32; 2], usize> {
    let mut sides = BTreeMap::new();
    for face in mesh.faces() {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            *sides.entry([a.min(b), a.max(b)]).or_default() += 1;
        }
    }
    sides
}
