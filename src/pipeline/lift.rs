//! From the canvas to the surface and back: which layer a triangle shows, and what lines and directions of the canvas are on it.
//!
//! The mesh is in the sketch's canonical frame: x right, y up, z towards the viewer.

use crate::field::{DirectionConstraint, PolyVector};
use crate::infer::{DepthPrediction, DirectionPrediction, LayerPrediction, MAP_PIXELS};
use crate::sketch::{MAP_SIZE, Raster, map_coordinates, map_position};
use crate::surface::{RayCaster, SurfaceMesh};
use nalgebra::{Point3, Vector3};

/// Steeper triangles than this, seen almost edge-on, show no direction of the canvas plane: sine of about 5 degrees.
const EDGE_ON: f64 = 0.09;
/// Feature lines are sampled this densely, canonical units: about a pixel and a half.
const LINE_STEP: f64 = 0.05;
/// A lifted line is cut where it jumps this far in space from one sample to the next, canonical units: it left one fold for another.
const LINE_JUMP: f64 = 0.4;
/// Weight of a feature line that crosses a whole triangle. In the solver's unit an edge weighs about 1, so the field follows the line and
/// yields where two lines contradict each other.
const LINE_WEIGHT: f64 = 300.0;

/// Which surface point each line of sight meets first and second.
pub(super) struct SeenLayers<'a> {
    caster: RayCaster<'a>,
    mesh: &'a SurfaceMesh,
}

/// Sorts a mesh for the canonical view.
pub(super) fn seen_layers(mesh: &SurfaceMesh) -> SeenLayers<'_> {
    SeenLayers { caster: RayCaster::new(mesh, [Vector3::x(), Vector3::y(), Vector3::z()]), mesh }
}

impl SeenLayers<'_> {
    /// 0 if the triangle is what is seen at its centre, 1 if it lies just behind that, and so on.
    fn layer_of(&self, triangle: usize) -> Option<usize> {
        let center = centroid(self.mesh, triangle);
        self.caster.hits(center.x, center.y).iter().position(|hit| hit.triangle as usize == triangle)
    }

    /// The surface as CDF-Net reads it: the normals of both layers where the sketch has them.
    pub(super) fn prediction(&self, raster: &Raster, slope: f64) -> DepthPrediction {
        let mut layers = [4, 6].map(|channel| LayerPrediction {
            depth_offset: vec![0.0; MAP_PIXELS],
            normals: vec![[0.0; 3]; MAP_PIXELS],
            coverage_front: raster.channel(channel).to_vec(),
            coverage_back: raster.channel(channel + 1).to_vec(),
        });
        for pixel in 0..MAP_PIXELS {
            if !layers.iter().any(|layer| layer.seen(pixel)) {
                continue;
            }
            let [x, y] = map_position(pixel / MAP_SIZE, pixel % MAP_SIZE, MAP_SIZE);
            for (layer, hit) in layers.iter_mut().zip(self.caster.hits(x, y)) {
                if layer.seen(pixel) {
                    let corners = self.mesh.triangles[hit.triangle as usize];
                    let normal: Vector3<f64> =
                        (0..3).map(|k| self.mesh.normals[corners[k] as usize] * hit.barycentric[k]).sum();
                    let normal = normal.try_normalize(0.0).unwrap_or_default();
                    layer.normals[pixel] = [normal.x as f32, normal.y as f32, normal.z as f32];
                }
            }
        }
        let [visible, occluded] = layers;
        let occluded = (0..MAP_PIXELS).any(|pixel| occluded.seen(pixel)).then_some(occluded);
        DepthPrediction { visible, occluded, reference: 0.0, slope }
    }
}

/// What the network says, and where each layer is.
pub(super) struct Guess {
    pub predicted: DirectionPrediction,
    pub seen: DepthPrediction,
}

/// The network's directions on each triangle; zero where it says nothing.
pub(super) fn guess_directions(mesh: &SurfaceMesh, layers: &SeenLayers, guess: &Guess) -> Vec<[Vector3<f64>; 2]> {
    let maps = [
        Some((&guess.predicted.visible, &guess.seen.visible)),
        guess.predicted.occluded.as_ref().zip(guess.seen.occluded.as_ref()),
    ];
    (0..mesh.triangles.len())
        .map(|triangle| {
            let (normal, _) = mesh.triangle_normal_area(triangle);
            let map = layers.layer_of(triangle).and_then(|layer| maps.get(layer).copied().flatten());
            let Some((coefficients, layer)) = map.filter(|_| normal.z.abs() > EDGE_ON) else {
                return [Vector3::zeros(); 2];
            };
            let center = centroid(mesh, triangle);
            let mut sum = [0.0; 4];
            let mut weights = 0.0;
            for (pixel, weight) in around(center.x, center.y) {
                if layer.seen(pixel) {
                    weights += weight;
                    for (s, c) in sum.iter_mut().zip(coefficients[pixel]) {
                        *s += weight * f64::from(c);
                    }
                }
            }
            if weights <= 0.0 {
                return [Vector3::zeros(); 2];
            }
            let directions = PolyVector::from_array(sum.map(|s| s / weights)).directions();
            directions.map(|d| lifted([d.x, d.y], &normal))
        })
        .collect()
}

/// The four map pixels around a canonical point, with bilinear weights; at the rim the outermost pixels continue.
fn around(x: f64, y: f64) -> [(usize, f64); 4] {
    let last = (MAP_SIZE - 1) as f64;
    let [row, column] = map_coordinates([x, y], MAP_SIZE).map(|c| c.clamp(0.0, last));
    let [i, j] = [row, column].map(|c| (c as usize).min(MAP_SIZE - 2));
    let (s, t) = (row - i as f64, column - j as f64);
    let corner = |a: usize, b: usize| {
        ((i + a) * MAP_SIZE + j + b, (if a == 1 { s } else { 1.0 - s }) * (if b == 1 { t } else { 1.0 - t }))
    };
    [corner(0, 0), corner(0, 1), corner(1, 0), corner(1, 1)]
}

/// Constraints on the triangles that feature lines cross, and the lines on the surface.
///
/// Of each line and triangle the constraint is the chord between the ends of the line's part there.
pub(super) fn feature_constraints(
    mesh: &SurfaceMesh,
    layers: &SeenLayers,
    lines: &[Vec<[f64; 2]>],
) -> (Vec<DirectionConstraint>, Vec<Vec<Point3<f64>>>) {
    let (mut constraints, mut lifted_lines) = (vec![], vec![]);
    for line in lines {
        let mut current: Vec<Point3<f64>> = vec![];
        // Triangle that the line is on, and where its part there begins and ends.
        let mut part: Option<(u32, Point3<f64>, Point3<f64>)> = None;
        let mut end_part = |part: &mut Option<(u32, Point3<f64>, Point3<f64>)>| {
            if let Some((triangle, from, to)) = part.take() {
                let (normal, area) = mesh.triangle_normal_area(triangle as usize);
                let direction = to - from;
                let weight = LINE_WEIGHT * (direction.norm() / area.sqrt()).min(1.0);
                if weight > 0.0 && normal.z.abs() > EDGE_ON {
                    constraints.push(DirectionConstraint { triangle, direction, weight });
                }
            }
        };
        for [x, y] in resampled(line) {
            let hit = layers.caster.hits(x, y).into_iter().next();
            let point = hit.map(|hit| Point3::new(x, y, -hit.depth));
            let joined = matches!((current.last(), point), (Some(a), Some(b)) if (b - a).norm() < LINE_JUMP);
            if !joined {
                end_part(&mut part);
                if current.len() > 1 {
                    lifted_lines.push(std::mem::take(&mut current));
                }
                current.clear();
            }
            let Some((hit, point)) = hit.zip(point) else { continue };
            current.push(point);
            match &mut part {
                Some((triangle, _, to)) if *triangle == hit.triangle => *to = point,
                _ => {
                    end_part(&mut part);
                    part = Some((hit.triangle, point, point));
                }
            }
        }
        end_part(&mut part);
        if current.len() > 1 {
            lifted_lines.push(current);
        }
    }
    (constraints, lifted_lines)
}

/// The polyline with points every [`LINE_STEP`] at most.
fn resampled(line: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut points = vec![];
    for ends in line.windows(2) {
        let [a, b] = [ends[0], ends[1]];
        let steps = ((b[0] - a[0]).hypot(b[1] - a[1]) / LINE_STEP).ceil().clamp(1.0, 1e4) as usize;
        points.extend((0..steps).map(|i| [0, 1].map(|k| a[k] + (b[k] - a[k]) * i as f64 / steps as f64)));
    }
    points.extend(line.last());
    points
}

/// The tangent vector that is seen as `d` on the canvas, unit.
fn lifted(d: [f64; 2], normal: &Vector3<f64>) -> Vector3<f64> {
    let z = -(normal.x * d[0] + normal.y * d[1]) / normal.z;
    Vector3::new(d[0], d[1], z).try_normalize(0.0).unwrap_or_default()
}

fn centroid(mesh: &SurfaceMesh, triangle: usize) -> Point3<f64> {
    let [a, b, c] = mesh.triangles[triangle].map(|v| mesh.position(v).coords);
    Point3::from((a + b + c) / 3.0)
}
