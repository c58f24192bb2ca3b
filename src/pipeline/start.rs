//! Where a patch begins: what its surface has to obey, BSR-Net's surface, and the unfolded maps.

use crate::control::Control;
use crate::error::Error;
use crate::infer::{DepthPrediction, LayerPrediction, NET_SIZE, Networks, SketchMaps};
use crate::sketch::{CANVAS_HALF_WIDTH, Layer, MAP_SIZE, PatchSketch, StrokeKind};
use crate::surface::{
    BorderCurves, BorderLoop, LayerMap, LayerMaps, LayerSample, NurbsSurface, RayCaster, RayHit, SurfaceMesh,
    SurfaceTargets, coons_net, unfolded_net,
};
use nalgebra::{Point3, Vector3};

/// Where the refinement may begin: the layer maps unfolded, and BSR-Net's answer; the one with less energy is taken.
///
/// With contours the former alone, since the refinement cannot make a fold that its start lacks, and BSR-Net misses some:
/// on 40 folded held-out sketches the contours ended 4.4 px off from BSR-Net's start, 1.0 px from the unfolded one.
///
/// - `predicted`: BSR-Net's answer, where there is no contour.
pub(super) fn first_surfaces(
    predicted: Option<NurbsSurface>,
    targets: &SurfaceTargets,
    curves: &BorderCurves,
) -> Result<Vec<NurbsSurface>, Error> {
    let unfolded = unfolded_surface(targets, curves, 1.0)?;
    Ok([unfolded].into_iter().chain(predicted).collect())
}

/// Cells along each side of a surface that is read as maps.
const CELLS: usize = 48;
/// A surface farther than this from a map, canonical units, is another sheet.
const SAME_SHEET: f64 = 1.5;

/// The maps, moved by `share` of the way to `surface` in depth and normals: two answers err less together than each alone.
///
/// Each pixel looks along its line of sight for the sheet with its orientation that is nearest to its depth. Where there is none, the
/// difference is that of the pixels around it.
pub(super) fn moved_towards(maps: &LayerMaps, surface: &NurbsSurface, share: f64) -> LayerMaps {
    // A prediction without normals says nothing.
    let Ok(mesh) = SurfaceMesh::new(surface, [CELLS; 2]) else { return maps.clone() };
    let caster = RayCaster::new(&mesh, [Vector3::x(), Vector3::y(), Vector3::z()]);
    let moved = |map: &LayerMap| {
        let mut result = map.clone();
        let valid: Vec<usize> = (0..map.valid.len()).filter(|&k| map.valid[k]).collect();
        let mut differences: Vec<Option<f64>> = vec![None; map.valid.len()];
        for &k in &valid {
            let [x, y] = map.center(k);
            let hits = caster.hits(x, y).into_iter().filter(|hit| hit.front == map.front[k]);
            let apart = |hit: &RayHit| (hit.depth - map.depth[k]).abs();
            let nearest = hits.filter(|hit| apart(hit) < SAME_SHEET).min_by(|a, b| apart(a).total_cmp(&apart(b)));
            if let Some(hit) = nearest {
                differences[k] = Some(hit.depth - map.depth[k]);
                let corners = mesh.triangles[hit.triangle as usize];
                let normal: Vector3<f64> = (0..3).map(|i| mesh.normals[corners[i] as usize] * hit.barycentric[i]).sum();
                let between = map.normal[k] * (1.0 - share) + normal * share;
                result.normal[k] = between.try_normalize(1e-6).unwrap_or(map.normal[k]);
            }
        }
        let mut missing: Vec<usize> = valid.iter().copied().filter(|&k| differences[k].is_none()).collect();
        while !missing.is_empty() {
            let around = |k: usize| {
                let n = map.size;
                let (row, column) = (k / n, k % n);
                let near = (row.saturating_sub(1)..=(row + 1).min(n - 1))
                    .flat_map(move |r| (column.saturating_sub(1)..=(column + 1).min(n - 1)).map(move |c| r * n + c));
                let known: Vec<f64> =
                    near.filter(|&q| map.front[q] == map.front[k]).filter_map(|q| differences[q]).collect();
                (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
            };
            let found: Vec<(usize, f64)> = missing.iter().filter_map(|&k| Some((k, around(k)?))).collect();
            if found.is_empty() {
                break;
            }
            found.iter().for_each(|&(k, difference)| differences[k] = Some(difference));
            missing.retain(|&k| differences[k].is_none());
        }
        for k in valid {
            result.depth[k] += share * differences[k].unwrap_or(0.0);
        }
        result
    };
    LayerMaps { visible: moved(&maps.visible), occluded: moved(&maps.occluded) }
}

/// The layer maps, meeting the depth samples, as one sheet; smoothness as [`unfolded_net`] has it.
pub(super) fn unfolded_surface(
    targets: &SurfaceTargets,
    curves: &BorderCurves,
    smoothness: f64,
) -> Result<NurbsSurface, Error> {
    let maps = targets.maps.meeting(&targets.samples);
    let net = unfolded_net(&targets.border, curves, &targets.contours, &maps, smoothness)?;
    NurbsSurface::new(curves.knots.clone(), net, None)
}

/// BSR-Net's own answer, canonical frame: the Coons patch of the border curves, moved by what the network predicts.
///
/// # Errors
/// As [`Networks::net_offsets`].
///
/// # Source
/// Sketch2PQ, Sec. 3.2.3; there the network answers with the whole net.
pub(super) fn network_surface(
    networks: &mut Networks,
    maps: &SketchMaps,
    depths: &DepthPrediction,
    curves: &BorderCurves,
    control: &Control,
) -> Result<NurbsSurface, Error> {
    let offsets_from = |p: &Point3<f64>| [p.x, p.y, -p.z - depths.plane_depth(p.y)];
    let coons: Vec<[f64; 3]> = coons_net(curves).iter().map(offsets_from).collect();
    let moved = networks.net_offsets(maps, depths, &coons, control)?;
    let net = coons.iter().zip(&moved).map(|(p, d)| {
        let [x, y, h] = [0, 1, 2].map(|k| p[k] + d[k]);
        Point3::new(x, y, -h - depths.plane_depth(y))
    });
    NurbsSurface::new(curves.knots.clone(), net.collect(), None)
}

/// The surface that the networks give alone, before anything is fitted: what refinement is measured against. Canonical frame.
///
/// # Errors
/// As [`super::sketch_to_surface`].
pub(crate) fn unrefined_surface(
    networks: &mut Networks,
    patch: &PatchSketch,
    maps: &SketchMaps,
    control: &Control,
) -> Result<NurbsSurface, Error> {
    let depths = networks.predict_depths(maps, control)?;
    let (_, curves) = targets(patch, None, &depths)?;
    network_surface(networks, maps, &depths, &curves, control)
}

/// What the surface has to obey, and its border in space.
pub(super) fn targets(
    patch: &PatchSketch,
    corners: Option<[[f64; 2]; 4]>,
    depths: &DepthPrediction,
) -> Result<(SurfaceTargets, BorderCurves), Error> {
    let points = patch.border.iter().map(|b| b.position).collect();
    let occluded = patch.border.iter().map(|b| b.layer == Layer::Occluded).collect();
    let border = BorderLoop::new(points, occluded)?;
    let corners = match corners {
        Some(places) => border.corners_near(places.map(|p| patch.frame.from_camera(p)))?,
        None => border.choose_corners()?,
    };
    let maps = LayerMaps { visible: layer_map(depths, Layer::Visible)?, occluded: layer_map(depths, Layer::Occluded)? };
    let curves = BorderCurves::new(&border, corners, &maps, [NET_SIZE; 2])?;
    let contours = patch.strokes.iter().filter(|s| s.kind == StrokeKind::Contour).map(|s| s.points.clone()).collect();
    let samples = patch
        .depth_samples
        .iter()
        .map(|s| LayerSample { position: s.position, occluded: s.layer == Layer::Occluded, depth: s.depth })
        .collect();
    Ok((SurfaceTargets { border, corners, contours, samples, maps }, curves))
}

fn layer_map(depths: &DepthPrediction, layer: Layer) -> Result<LayerMap, Error> {
    let Some((prediction, depth)) = depths.layer(layer).zip(depths.depths(layer)) else {
        return Ok(LayerMap::empty(MAP_SIZE, CANVAS_HALF_WIDTH));
    };
    let LayerPrediction { normals, coverage_front, coverage_back, .. } = prediction;
    let normal = normals.iter().map(|n| {
        let n = Vector3::from(n.map(f64::from));
        n.try_normalize(0.0).unwrap_or_else(Vector3::z)
    });
    let wide = |coverage: &[f32]| coverage.iter().map(|&c| f64::from(c)).collect::<Vec<_>>();
    LayerMap::new(CANVAS_HALF_WIDTH, depth, normal.collect(), &wide(coverage_front), &wide(coverage_back))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depth 1 + x / 2 on a disk of radius 3.
    fn disk() -> LayerMap {
        let mut map = LayerMap::empty(64, 4.4);
        for k in 0..64 * 64 {
            let [x, y] = map.center(k);
            map.valid[k] = x.hypot(y) < 3.0;
            map.depth[k] = 1.0 + 0.5 * x;
            map.normal[k] = Vector3::new(0.5, 0.0, 1.0).normalize();
        }
        map
    }

    /// The plane of depth `depth`, x from -4 to 1, seen from the front.
    fn sheet(depth: f64) -> NurbsSurface {
        let point = |k: usize| Point3::new((k % 6) as f64 - 4.0, 4.0 - 8.0 * (k / 6) as f64 / 5.0, -depth);
        NurbsSurface::uniform(3, [6, 6], (0..36).map(point).collect()).unwrap()
    }

    #[test]
    fn maps_move_to_a_surface_and_past_its_border() {
        let maps = LayerMaps { visible: disk(), occluded: LayerMap::empty(64, 4.4) };
        let moved = moved_towards(&maps, &sheet(0.5), 0.5);
        for k in (0..64 * 64).filter(|&k| maps.visible.valid[k]) {
            let [x, _] = maps.visible.center(k);
            // Beyond x = 1 the difference is that of the rim.
            let expected = 0.5 * (0.5 - (1.0 + 0.5 * x.min(1.0)));
            let found = moved.visible.depth[k] - maps.visible.depth[k];
            assert!((found - expected).abs() < if x < 1.0 { 1e-6 } else { 0.08 }, "{x}: {found} {expected}");
            let between = (Vector3::new(0.5, 0.0, 1.0).normalize() + Vector3::z()).normalize();
            assert!(x > 0.99 || (moved.visible.normal[k] - between).norm() < 1e-6);
        }
        assert_eq!(moved.occluded, maps.occluded);
        // Another sheet, far behind, and the same from behind, have no say.
        assert_eq!(moved_towards(&maps, &sheet(9.0), 0.5), maps);
        let mut back = maps.clone();
        back.visible.front.fill(false);
        assert_eq!(moved_towards(&back, &sheet(0.5), 0.5), back);
    }
}
