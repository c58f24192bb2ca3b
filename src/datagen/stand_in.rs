//! Development only: frame and raster without the sketch code.
use super::MAP;
use super::layers::{HALF, Layers, pixel_center};
use crate::sketch::{CanonicalFrame, Sketch, StrokeKind};

pub(super) struct Reading {
    pub frame: CanonicalFrame,
    pub raster: Vec<f32>,
}

pub(super) fn read(sketch: &Sketch, layers: &Layers) -> Option<Reading> {
    let camera = |p: &[f64; 2]| sketch.view.canvas_to_camera(*p);
    let frame = CanonicalFrame::fitting(
        sketch.strokes.iter().filter(|s| s.kind.is_structural()).flat_map(|s| s.points.iter().map(camera)),
    )?;
    let mut raster = vec![0f32; 10 * MAP * MAP];
    let pixel = 2.0 * HALF / 256.0;
    for (channel, kind) in StrokeKind::ALL.into_iter().enumerate() {
        let segments: Vec<[[f64; 2]; 2]> = sketch
            .strokes
            .iter()
            .filter(|s| s.kind == kind)
            .flat_map(|s| {
                s.points.windows(2).map(|w| [frame.from_camera(camera(&w[0])), frame.from_camera(camera(&w[1]))])
            })
            .collect();
        if segments.is_empty() {
            continue;
        }
        for k in 0..MAP * MAP {
            let p = pixel_center(MAP, k / MAP, k % MAP);
            let (mut best, mut tangent) = (f64::MAX, [1.0, 0.0]);
            for [a, b] in &segments {
                let d = [b[0] - a[0], b[1] - a[1]];
                let e = [p[0] - a[0], p[1] - a[1]];
                let t = ((d[0] * e[0] + d[1] * e[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-30)).clamp(0.0, 1.0);
                let r = (e[0] - t * d[0]).powi(2) + (e[1] - t * d[1]).powi(2);
                if r < best {
                    best = r;
                    tangent = d;
                }
            }
            let proximity = 8.0 / (8.0 + best.sqrt() / pixel);
            raster[channel * MAP * MAP + k] = proximity as f32;
            if channel == 3 {
                let angle = 2.0 * tangent[1].atan2(tangent[0]);
                raster[8 * MAP * MAP + k] = (proximity * angle.cos()) as f32;
                raster[9 * MAP * MAP + k] = (proximity * angle.sin()) as f32;
            }
        }
    }
    for (k, hits) in layers.hits.iter().enumerate() {
        let (row, column) = (k / 256 / 4, k % 256 / 4);
        for (layer, hit) in hits.iter().enumerate() {
            if let Some(hit) = hit {
                let channel = 4 + 2 * layer + usize::from(!hit.front);
                raster[(channel * MAP + row) * MAP + column] += 1.0 / 16.0;
            }
        }
    }
    Some(Reading { frame, raster })
}
