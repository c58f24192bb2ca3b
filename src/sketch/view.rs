//! Frames: canvas, camera, canonical, world.
//!
//! Camera frame: right-handed, x right, y up, z towards the viewer. Depth is -z. The canonical frame is the camera frame
//! moved and uniformly scaled, so that the structural strokes' bounding box is centred at the origin and its longer side is
//! [`CANONICAL_LENGTH`].

use crate::error::Error;
use nalgebra::{Point3, Vector3};

/// Longer side of the sketch's bounding box in the canonical frame; the paper's surfaces fill [-4, 4]^2.
pub const CANONICAL_LENGTH: f64 = 8.0;

/// An orthographic view: the camera's axes in the world, and the direction of the canvas' y axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    right: Vector3<f64>,
    up: Vector3<f64>,
    toward: Vector3<f64>,
    /// Whether canvas y grows downwards, as in images.
    pub y_down: bool,
}

impl View {
    /// A view from `azimuth_deg` (from world x towards y) and `elevation_deg` above the horizon; world z is up.
    ///
    /// The paper's camera in direction (1, 1, sqrt 2) is azimuth 45, elevation 45.
    ///
    /// # Errors
    /// [`Error::Argument`] if an angle is not finite or the elevation is not within [-90, 90].
    pub fn from_angles(azimuth_deg: f64, elevation_deg: f64, y_down: bool) -> Result<Self, Error> {
        if !azimuth_deg.is_finite() {
            let value = azimuth_deg.to_string();
            return Err(Error::Argument { name: "azimuth_deg", value, expected: "a finite angle" });
        }
        if !(-90.0..=90.0).contains(&elevation_deg) {
            let value = elevation_deg.to_string();
            return Err(Error::Argument { name: "elevation_deg", value, expected: "an angle within [-90, 90]" });
        }
        let (sa, ca) = azimuth_deg.to_radians().sin_cos();
        let (se, ce) = elevation_deg.to_radians().sin_cos();
        let right = Vector3::new(-sa, ca, 0.0);
        let toward = Vector3::new(ca * ce, sa * ce, se);
        Ok(Self { right, up: toward.cross(&right), toward, y_down })
    }

    /// A view from three axes in world coordinates: canvas right, canvas up, and towards the viewer.
    ///
    /// # Errors
    /// [`Error::Argument`] if the axes are not orthonormal to 1e-6 and right-handed.
    pub fn from_axes(right: Vector3<f64>, up: Vector3<f64>, toward: Vector3<f64>, y_down: bool) -> Result<Self, Error> {
        let gram = [
            right.norm() - 1.0,
            up.norm() - 1.0,
            toward.norm() - 1.0,
            right.dot(&up),
            right.dot(&toward),
            up.dot(&toward),
            right.cross(&up).dot(&toward) - 1.0,
        ];
        if gram.iter().all(|x| x.abs() < 1e-6) {
            Ok(Self { right, up, toward, y_down })
        } else {
            let value = format!("{right:?}, {up:?}, {toward:?}");
            Err(Error::Argument { name: "view axes", value, expected: "three orthonormal, right-handed axes" })
        }
    }

    /// Canvas right in the world.
    pub fn right(&self) -> Vector3<f64> {
        self.right
    }

    /// Canvas up in the world.
    pub fn up(&self) -> Vector3<f64> {
        self.up
    }

    /// Direction from the scene towards the viewer, in the world.
    pub fn toward(&self) -> Vector3<f64> {
        self.toward
    }

    /// Angle of the view direction above the horizon, radians.
    pub fn elevation_rad(&self) -> f64 {
        self.toward.z.clamp(-1.0, 1.0).asin()
    }

    /// Canvas point to camera x, y.
    pub fn canvas_to_camera(&self, p: [f64; 2]) -> [f64; 2] {
        [p[0], if self.y_down { -p[1] } else { p[1] }]
    }

    /// Camera x, y to canvas point.
    pub fn camera_to_canvas(&self, p: [f64; 2]) -> [f64; 2] {
        self.canvas_to_camera(p)
    }

    /// Camera frame to world.
    pub fn camera_to_world(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.right * p.x + self.up * p.y + self.toward * p.z)
    }

    /// World to camera frame.
    pub fn world_to_camera(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::new(self.right.dot(&p.coords), self.up.dot(&p.coords), self.toward.dot(&p.coords))
    }
}

impl Default for View {
    /// The paper's view, canvas y down.
    fn default() -> Self {
        Self::from_angles(45.0, 45.0, true).expect("the angles are in range")
    }
}

/// Where the canonical frame lies in the camera frame: canonical = (camera - center) * scale; z is scaled, not moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CanonicalFrame {
    /// Centre of the strokes' bounding box, camera x, y.
    pub center: [f64; 2],
    /// Canonical units per canvas unit.
    pub scale: f64,
}

impl CanonicalFrame {
    /// The frame that centres `points` (camera x, y) and gives their longer side [`CANONICAL_LENGTH`].
    ///
    /// `None` if the points have no extent or are not finite.
    pub fn fitting(points: impl IntoIterator<Item = [f64; 2]>) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in points {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let side = (high[0] - low[0]).max(high[1] - low[1]);
        let scale = CANONICAL_LENGTH / side;
        let center = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
        (side > 0.0 && scale.is_finite() && scale > 0.0 && center.iter().all(|c| c.is_finite()))
            .then_some(Self { center, scale })
    }

    /// Camera x, y to canonical x, y.
    pub fn from_camera(&self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (p[k] - self.center[k]) * self.scale)
    }

    /// Canonical x, y to camera x, y.
    pub fn to_camera(&self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| p[k] / self.scale + self.center[k])
    }

    /// Canonical point (x, y, z = -depth) to the camera frame.
    pub fn point_to_camera(&self, p: &Point3<f64>) -> Point3<f64> {
        let [x, y] = self.to_camera([p.x, p.y]);
        Point3::new(x, y, p.z / self.scale)
    }

    /// Camera point to the canonical frame.
    pub fn point_from_camera(&self, p: &Point3<f64>) -> Point3<f64> {
        let [x, y] = self.from_camera([p.x, p.y]);
        Point3::new(x, y, p.z * self.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_view_is_the_papers() {
        let view = View::default();
        let expected = Vector3::new(1.0, 1.0, 2f64.sqrt()).normalize();
        assert!((view.toward() - expected).norm() < 1e-15);
        assert!((view.right().cross(&view.up()) - view.toward()).norm() < 1e-15);
        assert!(view.up().z > 0.0);
        let p = Point3::new(0.3, -1.2, 2.5);
        assert!((view.camera_to_world(&view.world_to_camera(&p)) - p).norm() < 1e-14);
    }
}
