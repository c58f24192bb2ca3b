//! Panel meshes: extraction from a map, borders, planarity, planarization.

mod border;
mod border_trace;
mod chords;
mod extract;
mod feature_lines;
mod isolines;
mod obj;
mod offsets;
mod panel_mesh;
mod planar_map;
mod planarity;
mod planarize;
mod reference;
mod split;
mod topology;

pub use border::{BorderMode, Repairs};
pub use chords::BorderSag;
pub use extract::{
    EdgeFamily, ExtractOptions, ExtractedMesh, PanelTarget, VertexKind, VertexOrigin, extract, grid_triples, panels,
};
pub use feature_lines::{FeaturePiece, feature_angle, feature_pieces};
pub use obj::{read_obj, write_obj};
pub use offsets::{OffsetKind, circularity, conicality};
pub use panel_mesh::PanelMesh;
pub use planarity::{best_plane, deviation, edge_lengths, edges, mean_edge_length, planarity, width};
pub use planarize::{PlanarizeInput, PlanarizeOptions, Planarized, border_vertices, planarize};
pub use reference::{Foot, MeshReference, Reference};
pub use topology::{Topology, check};
