//! Ground truth maps of a sketch, in its canonical frame.

use super::MAP;
use super::directions::Directions;
use super::layers::{Layers, pixel_center};
use crate::surface::{NurbsSurface, SurfacePoint};
use nalgebra::{Point3, Vector3};

/// Ground truth of one sketch on 64 x 64 maps: visible layer, then occluded layer; row 0 is the top.
#[derive(Clone, Debug)]
pub struct Maps {
    /// 0 no surface, 1 its front faces the viewer, 2 its back does. 2 x 64 x 64.
    pub valid: Vec<u8>,
    /// h = depth - y cot(elevation) in canonical units, mean over the visible pixels 0; 0 where invalid. 2 x 64 x 64.
    pub depth: Vec<f32>,
    /// Unit normals of the front side, canonical frame; zero where invalid. 2 x 3 x 64 x 64.
    pub normal: Vec<f32>,
    /// Two unit directions (x right, y up) of the conjugate field seen on the canvas: ux, uy, vx, vy; zero where the layer or
    /// the field is invalid. 2 x 4 x 64 x 64.
    pub directions: Vec<f32>,
    /// Mean conjugacy residual |II(u, v)| / |II| over the valid pixels.
    pub conjugacy: f64,
    /// Mean over the visible pixels of -z - y cot(elevation) of the surface that was given.
    pub reference: f64,
}

/// Moves (u, v) so that the surface point projects on `target`: Newton steps, as long as they help.
fn sharpen(surface: &NurbsSurface, uv: [f64; 2], target: [f64; 2]) -> ([f64; 2], SurfacePoint) {
    let miss = |p: &SurfacePoint| [target[0] - p.position.x, target[1] - p.position.y];
    let size = |m: [f64; 2]| m[0].hypot(m[1]);
    let (mut uv, mut point) = (uv, surface.evaluate(uv[0], uv[1]));
    for _ in 0..2 {
        let [x, y] = miss(&point);
        if x.hypot(y) < 1e-7 {
            break;
        }
        let determinant = point.du.x * point.dv.y - point.du.y * point.dv.x;
        let step = [(point.dv.y * x - point.dv.x * y) / determinant, (point.du.x * y - point.du.y * x) / determinant];
        // Beside a contour the system is nearly singular: the triangulation knows better.
        let length = step[0].hypot(step[1]);
        if length.is_nan() || length > 0.02 {
            break;
        }
        let next = [0, 1].map(|k| (uv[k] + step[k]).clamp(0.0, 1.0));
        let candidate = surface.evaluate(next[0], next[1]);
        if size(miss(&candidate)) >= x.hypot(y) {
            break;
        }
        (uv, point) = (next, candidate);
    }
    (uv, point)
}

impl Maps {
    /// The maps of `surface` in its canonical frame; `grid` holds its points at regular parameters, `cotangent` is that of the
    /// elevation.
    pub(super) fn new(surface: &NurbsSurface, grid: &[Point3<f64>], directions: &Directions, cotangent: f64) -> Self {
        const PIXELS: usize = MAP * MAP;
        let layers = Layers::new(grid, MAP);
        let mut maps = Self {
            valid: vec![0; 2 * PIXELS],
            depth: vec![0.0; 2 * PIXELS],
            normal: vec![0.0; 6 * PIXELS],
            directions: vec![0.0; 8 * PIXELS],
            conjugacy: 0.0,
            reference: 0.0,
        };
        let mut depth = vec![0.0; 2 * PIXELS];
        let (mut residual, mut pairs) = (0.0, 0usize);
        for pixel in 0..PIXELS {
            let center = pixel_center(MAP, pixel / MAP, pixel % MAP);
            for (layer, hit) in layers.hits[pixel].iter().enumerate() {
                let Some(hit) = hit else { continue };
                let (uv, point) = sharpen(surface, hit.uv, center);
                let slot = layer * PIXELS + pixel;
                maps.valid[slot] = if hit.front { 1 } else { 2 };
                depth[slot] = -point.position.z - center[1] * cotangent;
                let normal: Vector3<f64> = point.du.cross(&point.dv).normalize();
                for axis in 0..3 {
                    maps.normal[(layer * 3 + axis) * PIXELS + pixel] = normal[axis] as f32;
                }
                let Some(pair) = directions.at(&point, uv) else { continue };
                let flat = pair.vectors.map(|v| v.xy());
                // Directions along the view have no direction on the canvas.
                if flat.iter().any(|v| v.norm() < 0.05) {
                    continue;
                }
                residual += pair.residual;
                pairs += 1;
                for (k, v) in flat.iter().enumerate() {
                    let v = v.normalize();
                    maps.directions[(layer * 4 + 2 * k) * PIXELS + pixel] = v.x as f32;
                    maps.directions[(layer * 4 + 2 * k + 1) * PIXELS + pixel] = v.y as f32;
                }
            }
        }
        let visible = maps.valid[..PIXELS].iter().filter(|&&v| v > 0).count().max(1);
        maps.reference = (0..PIXELS).filter(|&k| maps.valid[k] > 0).map(|k| depth[k]).sum::<f64>() / visible as f64;
        for (slot, depth) in depth.iter().enumerate() {
            if maps.valid[slot] > 0 {
                maps.depth[slot] = (depth - maps.reference) as f32;
            }
        }
        maps.conjugacy = residual / pairs.max(1) as f64;
        maps
    }
}
