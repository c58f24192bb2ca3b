//! The three calls that a host makes: sketch to surface, surface to field, field to mesh; with progress and cancel.
//!
//! Results hold one patch for each outline of the sketch, in the world frame and the canvas unit. Every stage works in
//! a frame in which the patch has one size (see [`Placement`]), so moving or scaling the strokes moves or scales the
//! results.

mod curves;
mod field;
mod lift;
mod live;
mod mesh;
mod placement;
mod planarize;
mod report;
mod session;
mod shared;
mod singularities;
mod start;
mod surface;

pub use curves::FeatureCurve;
pub use field::{FieldMeasures, FieldOptions, FieldPatch, FieldResult, sketch_to_cdf, surface_to_cdf};
pub use mesh::{BorderHold, MAX_FACES, MeshMeasures, MeshOptions, MeshPatch, MeshResult, extract_pq_mesh};
pub use placement::Placement;
pub use planarize::{PanelOptions, planarize_panels};
pub use report::Report;
pub use session::{MAX_THREADS, Progress, Session, SessionOptions, Times};
pub use shared::SharedSession;
pub use singularities::{FixedSingularity, SurfacePlace};
pub(crate) use start::unrefined_surfaces;
pub use surface::{SurfaceDiagnostics, SurfaceOptions, SurfacePatch, SurfaceResult, sketch_to_surface};
