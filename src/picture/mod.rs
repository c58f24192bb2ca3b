//! Pictures of sketches, surfaces and panel meshes, drawn in software.

mod canvas;
mod cases;
mod lettering;
mod mesh;
#[cfg(test)]
mod panel_tests;
mod scene;
mod sketch;
mod surface;
mod svg;

pub use canvas::{Frame, Picture, compose};
pub use cases::{CaseRow, case_sheet};
pub use mesh::{MeshPart, mesh_picture, planarity_color};
pub use scene::{Scene, ScenePatch, other_view, scene_picture};
pub use sketch::{overlay_sketch, sketch_picture};
pub use surface::surface_picture;
pub use svg::{mesh_svg, sketch_svg};
