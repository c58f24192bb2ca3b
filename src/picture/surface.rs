//! Shaded surfaces.

use super::canvas::{Corner, DepthBuffer, Frame, Picture, shaded};
use crate::sketch::View;
use crate::surface::SurfaceMesh;
use nalgebra::{Point3, Vector3};

/// Side of S_u x S_v, and the other side.
const FRONT: [u8; 3] = [152, 212, 244];
const BACK: [u8; 3] = [172, 164, 236];
const BORDER: [u8; 3] = [60, 100, 140];

/// How much the nearest layer covers what lies behind it.
const OPACITY: f64 = 0.84;

/// Draws tessellated surfaces, world frame, smoothly shaded, seen along `view`: light blue on the side of their normals,
/// violet on the other, a little translucent so that the part behind shows, with their border.
pub fn surface_picture(surfaces: &[&SurfaceMesh], view: &View, frame: &Frame) -> Picture {
    let mut buffer = DepthBuffer::new(frame);
    let camera: Vec<Vec<Corner>> = surfaces.iter().map(|surface| corners(surface, view)).collect();
    let behind = 1.5 / frame.scale;
    for layer in 0..2 {
        for (surface, corners) in surfaces.iter().zip(&camera) {
            for triangle in &surface.triangles {
                let triangle = triangle.map(|k| corners[k as usize]);
                buffer.triangle(&triangle, layer, behind, |fragment| {
                    shaded(if fragment.normal.z >= 0.0 { FRONT } else { BACK }, &fragment.normal, 0.42, 0.16)
                });
            }
        }
    }
    for layer in 0..2 {
        for (surface, corners) in surfaces.iter().zip(&camera) {
            for [a, b] in border(surface) {
                let ends = [corners[a].position, corners[b].position];
                buffer.line(ends, 1.6, BORDER, layer, 3.0 / frame.scale);
            }
        }
    }
    buffer.resolve(OPACITY)
}

/// Positions and normals in the camera frame.
fn corners(surface: &SurfaceMesh, view: &View) -> Vec<Corner> {
    let turn = |v: &Vector3<f64>| view.world_to_camera(&Point3::from(*v)).coords;
    surface
        .points
        .iter()
        .zip(&surface.normals)
        .map(|(p, n)| Corner { position: view.world_to_camera(&p.position), normal: turn(n) })
        .collect()
}

/// The edges of the grid's border.
fn border(surface: &SurfaceMesh) -> Vec<[usize; 2]> {
    let [nu, nv] = surface.cells;
    let at = |i: usize, j: usize| i * (nv + 1) + j;
    let mut edges = vec![];
    for i in 0..nu {
        edges.extend([[at(i, 0), at(i + 1, 0)], [at(i, nv), at(i + 1, nv)]]);
    }
    for j in 0..nv {
        edges.extend([[at(0, j), at(0, j + 1)], [at(nu, j), at(nu, j + 1)]]);
    }
    edges
}
