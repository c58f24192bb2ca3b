//! Depth samples and the regions that they lie in.

use super::super::polyline::{Point, arc_lengths, closest};
use super::super::stroke::{Layer, Sketch};
use super::{CANONICAL_PER_PX, CanonicalSample, PatchSketch};
use crate::error::Error;

/// Depth samples this far outside their region still belong to it, px.
const SAMPLE_REACH_PX: f64 = 6.0;

/// Gives every depth sample to the patch and layer that it lies in, or close to.
pub(super) fn place_samples(sketch: &Sketch, patches: &mut [PatchSketch]) -> Result<(), Error> {
    for (index, sample) in sketch.depth_samples.iter().enumerate() {
        let camera = sketch.view.canvas_to_camera(sample.position);
        let mut best: Option<(f64, usize, Point)> = None;
        for (k, patch) in patches.iter().enumerate() {
            let p = patch.frame.from_camera(camera);
            for region in &patch.regions {
                if sample.layer == Layer::Occluded && region.occluded.is_none() {
                    continue;
                }
                let (distance, position) =
                    if region.contains(p) { (0.0, p) } else { nearest_on_rings(&region.rings, p) };
                if best.is_none_or(|(d, _, _)| distance < d) {
                    best = Some((distance, k, position));
                }
            }
        }
        match best {
            Some((distance, k, position)) if distance <= SAMPLE_REACH_PX * CANONICAL_PER_PX => {
                let depth = sample.depth * patches[k].frame.scale;
                patches[k].depth_samples.push(CanonicalSample { position, layer: sample.layer, depth });
            }
            _ => {
                let [x, y] = sample.position;
                return Err(Error::SampleOutside { index, x, y, layer: sample.layer.name() });
            }
        }
    }
    Ok(())
}

fn nearest_on_rings(rings: &[Vec<Point>], p: Point) -> (f64, Point) {
    let mut best = (f64::INFINITY, p);
    for ring in rings {
        let mut closed = ring.clone();
        closed.push(ring[0]);
        let arc = arc_lengths(&closed);
        if let Some((d, _, q)) = closest(&closed, &arc, p, f64::NEG_INFINITY, f64::INFINITY)
            && d < best.0
        {
            best = (d, q);
        }
    }
    best
}
