//! Depth of both layers, corrected where it contradicts what the sketch says about them.

use super::border::{BorderCurves, LayerMaps};
use super::corners::BorderLoop;
use super::sheet::{Sheet, factor};
use super::targets::LayerSample;
use crate::error::Error;
use nalgebra::Vector3;

// Weights: that of the difference between the corrections of two neighbours on the visible layer is 1, more across a slope and less along
// it. Chosen on 46 held-out sketches (9,000,500 to 9,000,800) where a hidden sheet comes to light: the mean squared error of both maps without
// the free parameters of depth falls by 3 %, that of the occluded map by 5 % (geometric means); halving or doubling one changes little.

/// The same on the occluded layer, which OD-Net only guesses.
const OCCLUDED_WEIGHT: f64 = 0.3;
/// The step where a hidden sheet comes to light; true maps have one of 0.05 there, the networks' of 0.35 canonical units on the mean.
const SEAM_WEIGHT: f64 = 2.0;
/// The same correction of both layers at a contour, where the networks' maps are as near to each other as true ones, for each crossing of
/// the contour with a line between pixels.
const TURN_WEIGHT: f64 = 0.3;
/// Layers that lie the wrong way round.
const ORDER_WEIGHT: f64 = 2.0;
/// Layers that lie the wrong way round by less than this, canonical units, count less, so that the correction changes continuously.
const FULL_CROSSING: f64 = 0.1;
/// Each pixel's correction itself: one of the other layer is felt ten pixels away.
const LEVEL_WEIGHT: f64 = 0.01;
/// The correction at a depth sample, which the maps meet.
const SAMPLE_WEIGHT: f64 = 10.0;
/// Largest step that is believed, canonical units.
const LARGEST_STEP: f64 = 4.0;
/// Slopes are read from normals whose |z| is at least this.
const LEAST_FACING: f64 = 0.2;

/// The maps with the smallest smooth correction c of their depth d that joins the layers where the sketch does; `None` where nothing is to be
/// joined.
///
/// Beyond a visible border the sheet that it hides comes to light: there the occluded layer continues the visible one without a step, which
/// neither network sees, since each predicts one layer. And the occluded layer lies nowhere before the visible one. Over the pixels of both
/// layers, neighbours i, j as in [`super::unfolded_net`], c minimizes
///
/// `sum w (c_j - c_i)^2 + sum_seams s (c_j - c_i + d_j - d_i - g)^2 + sum_crossed o (c_j - c_i + d_j - d_i)^2 + sum e c^2`
///
/// with g the step that the normals on both sides ask for, and crossed the pixels whose occluded layer lies before the visible one.
///
/// - `contours`: contour strokes, polylines (x, y).
/// - `samples`: depth samples, which the maps meet and go on to meet.
/// - returns maps that differ in depth alone.
///
/// # Errors
/// [`Error::Singular`] if the system cannot be solved, which no finite input causes.
///
/// # Source
/// Ours: the paper predicts the layers one after the other and leaves them apart (Sketch2PQ, Sec. 3.2.2).
pub fn reconciled_maps(
    border: &BorderLoop,
    curves: &BorderCurves,
    contours: &[Vec<[f64; 2]>],
    samples: &[LayerSample],
    maps: &LayerMaps,
) -> Result<Option<LayerMaps>, Error> {
    if !maps.occluded.valid.contains(&true) {
        return Ok(None);
    }
    let sheet = Sheet::new(border, curves, contours, maps);
    let steps = steps(&sheet);
    if steps.is_empty() {
        return Ok(None);
    }
    let mut links: Vec<_> = sheet.links.iter().filter_map(|&(a, b, weight)| smooth(&sheet, a, b, weight)).collect();
    let mut diagonal = vec![LEVEL_WEIGHT; sheet.count];
    for sample in samples {
        if let Some(vertex) = nearest(&sheet, sample) {
            diagonal[vertex] += SAMPLE_WEIGHT;
        }
    }
    let mut correction = vec![0.0; sheet.count];
    for &Step { ends: [a, b], weight, height } in &steps {
        links.push((a, b, weight));
        correction[a as usize] += weight * height;
        correction[b as usize] -= weight * height;
    }
    factor(&links, diagonal, "reconciled layers")?.solve(&mut correction);
    let mut maps = maps.clone();
    for (&(layer, pixel), c) in sheet.places.iter().zip(correction) {
        [&mut maps.visible, &mut maps.occluded][layer].depth[pixel] += c;
    }
    Ok(Some(maps))
}

/// Two vertices whose depths should differ by `height` less than they do.
struct Step {
    ends: [u32; 2],
    weight: f64,
    height: f64,
}

/// The link that keeps the correction smooth between two vertices; `None` across a seam, which is no reason to be alike.
fn smooth(sheet: &Sheet, a: u32, b: u32, weight: f64) -> Option<(u32, u32, f64)> {
    let [(layer, pixel), (other, there)] = [a, b].map(|k| sheet.places[k as usize]);
    if layer == other {
        let factor = if layer == 0 { 1.0 } else { OCCLUDED_WEIGHT };
        Some((a, b, factor * weight))
    } else {
        (pixel == there).then_some((a, b, TURN_WEIGHT))
    }
}

/// Seams, and layers that lie the wrong way round.
fn steps(sheet: &Sheet) -> Vec<Step> {
    let size = sheet.maps[0].size;
    let mut steps = vec![];
    for &(a, b, _) in &sheet.links {
        let [(layer, pixel), (other, there)] = [a, b].map(|k| sheet.places[k as usize]);
        if layer == other || pixel == there {
            continue;
        }
        let way = [0, 1].map(|c| sheet.maps[0].center(there)[c] - sheet.maps[0].center(pixel)[c]);
        let [(from, n), (to, m)] = [(layer, pixel), (other, there)]
            .map(|(layer, pixel)| (sheet.maps[layer].depth[pixel], sheet.maps[layer].normal[pixel]));
        let slope = |n: &Vector3<f64>| (n.x * way[0] + n.y * way[1]) / n.z.abs().max(LEAST_FACING).copysign(n.z);
        let height = to - from - 0.5 * (slope(&n) + slope(&m));
        let weight = SEAM_WEIGHT * (n.z * m.z).abs();
        steps.push(Step { ends: [a, b], weight, height: height.clamp(-LARGEST_STEP, LARGEST_STEP) });
    }
    for pixel in 0..size * size {
        if let (Some(a), Some(b)) = (sheet.vertex(0, pixel), sheet.vertex(1, pixel)) {
            let gap = sheet.maps[1].depth[pixel] - sheet.maps[0].depth[pixel];
            if gap < 0.0 {
                let weight = ORDER_WEIGHT * (-gap / FULL_CROSSING).min(1.0);
                steps.push(Step { ends: [a, b], weight, height: gap });
            }
        }
    }
    steps
}

/// The vertex of a sample's layer that is nearest to it.
fn nearest(sheet: &Sheet, sample: &LayerSample) -> Option<usize> {
    let squared = |k: &usize| {
        let [x, y] = sheet.maps[0].center(sheet.places[*k].1);
        (x - sample.position[0]).powi(2) + (y - sample.position[1]).powi(2)
    };
    let on_layer = (0..sheet.count).filter(|&k| sheet.places[k].0 == usize::from(sample.occluded));
    on_layer.min_by(|a, b| squared(a).total_cmp(&squared(b)))
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{self, Scene};
    use super::*;

    fn reconciled(scene: &Scene, samples: &[LayerSample], maps: &LayerMaps) -> LayerMaps {
        let curves = BorderCurves::new(&scene.border, scene.corners, maps, [30, 30]).unwrap();
        let maps = reconciled_maps(&scene.border, &curves, &scene.contours, samples, maps).unwrap();
        maps.expect("a hidden sheet comes to light")
    }

    /// The true maps with the occluded depth moved.
    fn moved(scene: &Scene, by: impl Fn([f64; 2]) -> f64) -> LayerMaps {
        let mut maps = scene.maps.clone();
        for k in (0..maps.occluded.depth.len()).filter(|&k| scene.maps.occluded.valid[k]) {
            maps.occluded.depth[k] += by(maps.occluded.center(k));
        }
        maps
    }

    /// Largest and root mean square difference of the occluded depth.
    fn difference(a: &LayerMaps, b: &LayerMaps) -> [f64; 2] {
        let known = (0..a.occluded.depth.len()).filter(|&k| a.occluded.valid[k]);
        let off: Vec<f64> = known.map(|k| (a.occluded.depth[k] - b.occluded.depth[k]).abs()).collect();
        let squares = off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64;
        [off.iter().copied().fold(0.0, f64::max), squares.sqrt()]
    }

    #[test]
    fn true_maps_are_left_alone() {
        let scene = synthetic::scene(synthetic::breaker());
        let [largest, mean] = difference(&reconciled(&scene, &[], &scene.maps), &scene.maps);
        assert!(largest < 0.1 && mean < 0.03, "{largest} {mean}");
        // One layer, and a fold whose hidden sheet never comes to light: nothing to join.
        for truth in [synthetic::dome(), synthetic::vault()] {
            let scene = synthetic::scene(truth);
            let curves = BorderCurves::new(&scene.border, scene.corners, &scene.maps, [30, 30]).unwrap();
            let maps = reconciled_maps(&scene.border, &curves, &scene.contours, &[], &scene.maps).unwrap();
            assert!(maps.is_none());
        }
    }

    #[test]
    fn a_hidden_sheet_goes_on_where_it_comes_to_light() {
        let scene = synthetic::scene(synthetic::breaker());
        // Right at the contour, wrong at the free edge below it.
        let maps = moved(&scene, |[_, y]| 0.3 * (2.4 - y).max(0.0));
        let (before, after) =
            (difference(&maps, &scene.maps), difference(&reconciled(&scene, &[], &maps), &scene.maps));
        assert!(after[0] < 0.5 * before[0] && after[1] < 0.5 * before[1], "{before:?} {after:?}");
    }

    #[test]
    fn the_hidden_layer_is_brought_behind_the_visible_one() {
        let scene = synthetic::scene(synthetic::breaker());
        // How far the hidden layer lies before the visible one, at most.
        let before = |maps: &LayerMaps| {
            let hidden = (0..maps.occluded.depth.len()).filter(|&k| maps.occluded.valid[k]);
            hidden.map(|k| maps.visible.depth[k] - maps.occluded.depth[k]).fold(f64::NEG_INFINITY, f64::max)
        };
        let maps = moved(&scene, |_| -0.8);
        let (wrong, better) = (before(&maps), before(&reconciled(&scene, &[], &maps)));
        assert!(before(&scene.maps) < 0.0 && wrong > 0.3 && better < 0.5 * wrong, "{wrong} {better}");
    }

    #[test]
    fn depth_samples_stay_met_and_the_level_is_free() {
        let scene = synthetic::scene(synthetic::breaker());
        let maps = moved(&scene, |[_, y]| 0.3 * (2.4 - y).max(0.0));
        let pixel = (0..64 * 64)
            .filter(|&k| maps.occluded.valid[k])
            .min_by(|&a, &b| {
                let off = |k: usize| (maps.occluded.center(k)[0]).hypot(maps.occluded.center(k)[1] - 1.2);
                off(a).total_cmp(&off(b))
            })
            .unwrap();
        let sample =
            LayerSample { position: maps.occluded.center(pixel), occluded: true, depth: maps.occluded.depth[pixel] };
        let change = |samples: &[LayerSample]| reconciled(&scene, samples, &maps).occluded.depth[pixel] - sample.depth;
        assert!(change(&[sample]).abs() < 0.1 * change(&[]).abs(), "{} {}", change(&[sample]), change(&[]));
        let mut lifted = maps.clone();
        lifted.visible.depth.iter_mut().chain(&mut lifted.occluded.depth).for_each(|d| *d += 3.0);
        let higher = reconciled(&scene, &[], &lifted).occluded.depth[pixel] - sample.depth - 3.0;
        assert!((higher - change(&[])).abs() < 1e-9);
    }
}
