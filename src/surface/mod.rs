//! NURBS surfaces: evaluation, curvature, tessellation, and the refinement that makes them obey the sketch.

mod closest;
mod curvature;
mod knots;
mod nurbs;
mod ray;
mod tessellate;

pub use closest::{SurfaceFoot, SurfaceProjector};
pub use curvature::FundamentalForms;
pub use knots::{Basis, KnotVector, MAX_DEGREE};
pub use nurbs::{NurbsSurface, SurfacePoint};
pub use ray::{RayCaster, RayHit};
pub use tessellate::SurfaceMesh;
