//! Between the world, in the host's unit, and the working frame, in which the stages see everything at one size.

use crate::sketch::{CanonicalFrame, View};
use crate::surface::NurbsSurface;
use nalgebra::{Matrix3, Point3, Vector3};

/// Longer side of a host's surface in the working frame; the canonical length of sketches.
const WORKING_LENGTH: f64 = crate::sketch::CANONICAL_LENGTH;

/// A similarity: world = origin + axes * working / scale.
///
/// For a surface from a sketch the working frame is the canonical frame. For a host's own surface it has the world's
/// axes, and the centre and size of the control net's bounding box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Columns: the working frame's axes in the world, orthonormal and right-handed.
    pub axes: Matrix3<f64>,
    /// Working units per world unit.
    pub scale: f64,
    /// The working frame's origin in the world.
    pub origin: Point3<f64>,
}

impl Placement {
    /// The canonical frame of a sketch, `lift` world units towards the viewer.
    pub fn of_sketch(view: &View, frame: &CanonicalFrame, lift: f64) -> Self {
        let axes = Matrix3::from_columns(&[view.right(), view.up(), view.toward()]);
        let origin = view.camera_to_world(&Point3::new(frame.center[0], frame.center[1], lift));
        Self { axes, scale: frame.scale, origin }
    }

    /// The frame that centres a surface's control net and gives its longest side the canonical length; `None` for a
    /// surface without extent, or so far away that its extent is lost in rounding.
    pub fn of_surface(surface: &NurbsSurface) -> Option<Self> {
        let points = surface.control_points();
        let (mut low, mut high) = (points[0], points[0]);
        for p in points {
            low = low.inf(p);
            high = high.sup(p);
        }
        let side = (high - low).max();
        let scale = WORKING_LENGTH / side;
        let reach = low.coords.amax().max(high.coords.amax());
        let origin = low + (high - low) * 0.5;
        let fits = scale.is_normal() && side > 1e-9 * reach && origin.iter().all(|x| x.is_finite());
        fits.then_some(Self { axes: Matrix3::identity(), scale, origin })
    }

    /// Working frame to world.
    pub fn to_world(&self, p: &Point3<f64>) -> Point3<f64> {
        self.origin + self.axes * (p.coords / self.scale)
    }

    /// World to working frame.
    pub fn from_world(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.axes.tr_mul(&(p - self.origin)) * self.scale)
    }

    /// A direction of the working frame in the world; lengths stay.
    pub fn direction_to_world(&self, d: &Vector3<f64>) -> Vector3<f64> {
        self.axes * d
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_is_the_identity_and_lengths_scale() {
        let view = View::from_angles(20.0, 35.0, true).unwrap();
        let frame = CanonicalFrame { center: [120.0, -90.0], scale: 8.0 / 200.0 };
        let placement = Placement::of_sketch(&view, &frame, 17.0);
        let (p, q) = (Point3::new(1.0, -2.0, 0.5), Point3::new(-0.25, 3.0, 1.0));
        assert!((placement.from_world(&placement.to_world(&p)) - p).norm() < 1e-12);
        let length = (placement.to_world(&p) - placement.to_world(&q)).norm();
        assert!((length - (p - q).norm() * 25.0).abs() < 1e-10);
        let camera = view.world_to_camera(&placement.to_world(&p));
        assert!((camera - frame.point_to_camera(&p) - Vector3::z() * 17.0).norm() < 1e-10);
    }
}
