//! Panel meshes: extraction from a map, borders, planarity, planarization.

mod panel_mesh;

pub use panel_mesh::PanelMesh;
