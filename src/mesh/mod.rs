//! Panel meshes: extraction from a map, borders, planarity, planarization.

mod obj;
mod panel_mesh;
mod planarity;
mod planarize;
mod reference;

pub use obj::{read_obj, write_obj};
pub use panel_mesh::PanelMesh;
pub use planarity::{best_plane, deviation, edge_lengths, edges, mean_edge_length, planarity};
pub use planarize::{PlanarizeInput, PlanarizeOptions, Planarized, border_vertices, grid_polylines, planarize};
pub use reference::{Foot, MeshReference, Reference};
