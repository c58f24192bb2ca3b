//! NURBS surfaces: evaluation, curvature, tessellation, and the refinement that makes them obey the sketch.

mod curvature;
mod knots;
mod nurbs;
mod tessellate;

pub use curvature::FundamentalForms;
pub use knots::{Basis, KnotVector, MAX_DEGREE};
pub use nurbs::{NurbsSurface, SurfacePoint};
pub use tessellate::SurfaceMesh;
