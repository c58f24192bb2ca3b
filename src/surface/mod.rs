//! NURBS surfaces: evaluation, curvature, tessellation, and the refinement that makes them obey the sketch.

mod bezier;
mod border;
mod closest;
mod coons;
mod corners;
mod curvature;
mod fit;
mod grid;
mod knots;
mod layer_map;
mod nurbs;
mod ray;
mod reconcile;
mod refine;
mod sheet;
mod silhouette;
#[cfg(test)]
mod synthetic;
mod targets;
mod tensor;
mod tessellate;
mod unfold;

pub use bezier::BezierPatches;
pub use border::{BorderCurves, LayerMaps};
pub use closest::{SurfaceFoot, SurfaceProjector};
pub use coons::coons_net;
pub use corners::BorderLoop;
pub use curvature::FundamentalForms;
pub use fit::{fit, unfolded_surface};
pub use grid::SurfaceGrid;
pub use knots::{Basis, KnotVector, MAX_DEGREE};
pub use layer_map::{LayerMap, MapSample, MapSide};
pub use nurbs::{NurbsSurface, SurfacePoint};
pub use ray::{RayCaster, RayHit};
pub use reconcile::reconciled_maps;
pub use refine::{RefineOptions, RefineReport, Refined, refine, refine_best};
pub use targets::{LayerSample, SurfaceTargets};
pub use tessellate::SurfaceMesh;
pub use unfold::unfolded_net;
