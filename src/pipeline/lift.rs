//! From the surface to the canvas and back, in the sketch's canonical frame: what CDF-Net reads and says, and feature
//! lines in space.

use crate::error::Error;
use crate::field::CanvasField;
use crate::infer::{DepthPrediction, DirectionPrediction, LayerPrediction, MAP_PIXELS};
use crate::sketch::{CANVAS_HALF_WIDTH, MAP_SIZE, Raster, map_position};
use crate::surface::{RayCaster, SurfaceMesh};
use nalgebra::{Point3, Vector3};

/// Feature lines are sampled this densely, canonical units: about a pixel and a half.
const LINE_STEP: f64 = 0.05;
/// A lifted line is cut where it jumps this far in space from one sample to the next, canonical units: it left one fold
/// for another.
const LINE_JUMP: f64 = 0.4;

/// A mesh in the canonical frame, seen along z.
pub(super) struct Seen<'a> {
    caster: RayCaster<'a>,
    mesh: &'a SurfaceMesh,
}

impl<'a> Seen<'a> {
    /// Sorts the triangles for lines of sight.
    pub fn new(mesh: &'a SurfaceMesh) -> Self {
        Self { caster: RayCaster::new(mesh, [Vector3::x(), Vector3::y(), Vector3::z()]), mesh }
    }

    /// The lines of sight.
    pub fn caster(&self) -> &RayCaster<'a> {
        &self.caster
    }

    /// The surface as CDF-Net reads it: normals of the first and second sheet where the sketch has those layers.
    pub fn prediction(&self, raster: &Raster, slope: f64) -> DepthPrediction {
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

    /// Canvas lines on the first sheet that they meet; cut where they leave the surface or change to another fold.
    pub fn lifted_lines(&self, lines: &[Vec<[f64; 2]>]) -> Vec<Vec<Point3<f64>>> {
        let mut lifted = vec![];
        for line in lines {
            let mut current: Vec<Point3<f64>> = vec![];
            for [x, y] in resampled(line, LINE_STEP) {
                let point = self.caster.hits(x, y).first().map(|hit| Point3::new(x, y, -hit.depth));
                let joined = matches!((current.last(), point), (Some(a), Some(b)) if (b - a).norm() < LINE_JUMP);
                if !joined {
                    lifted.push(std::mem::take(&mut current));
                }
                current.extend(point);
            }
            lifted.push(current);
        }
        lifted.retain(|line| line.len() > 1);
        lifted
    }
}

/// What the network says, in the form that the field reads.
///
/// # Errors
/// As [`CanvasField::new`].
pub(super) fn canvas_field(predicted: &DirectionPrediction, raster: &Raster) -> Result<CanvasField, Error> {
    let mut channels = Vec::with_capacity(8 * MAP_PIXELS);
    for layer in [Some(&predicted.visible), predicted.occluded.as_ref()] {
        for k in 0..4 {
            channels.extend((0..MAP_PIXELS).map(|pixel| layer.map_or(0.0, |layer| layer[pixel][k])));
        }
    }
    let coverage = |of: fn(&Raster, usize) -> f32| (0..MAP_PIXELS).map(|i| of(raster, i)).collect::<Vec<f32>>();
    let visible = coverage(Raster::visible_coverage);
    let occluded =
        if predicted.occluded.is_some() { coverage(Raster::occluded_coverage) } else { vec![0.0; MAP_PIXELS] };
    CanvasField::new(CANVAS_HALF_WIDTH, &channels, [&visible, &occluded])
}

/// The polyline with points every `step` at most, 4000 on one segment at most.
pub(super) fn resampled<const N: usize>(line: &[[f64; N]], step: f64) -> Vec<[f64; N]> {
    let mut points = vec![];
    for ends in line.windows(2) {
        let [a, b] = [ends[0], ends[1]];
        let length = (0..N).map(|k| (b[k] - a[k]).powi(2)).sum::<f64>().sqrt();
        let steps = (length / step).ceil().clamp(1.0, 4000.0) as usize;
        points.extend((0..steps).map(|i| std::array::from_fn(|k| a[k] + (b[k] - a[k]) * i as f64 / steps as f64)));
    }
    points.extend(line.last());
    points
}
