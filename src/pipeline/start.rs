//! Where a patch begins: what its surface has to obey, BSR-Net's surface, and the unfolded maps.

use super::session::{Times, timed};
use crate::control::Control;
use crate::error::Error;
use crate::infer::{DepthPrediction, LayerPrediction, NET_SIZE, Networks, SketchMaps};
use crate::sketch::{CANVAS_HALF_WIDTH, Layer, MAP_SIZE, PatchSketch, StrokeKind};
use crate::surface::{
    BorderCurves, BorderLoop, LayerMap, LayerMaps, LayerSample, NurbsSurface, SurfaceTargets, coons_net, unfolded_net,
};
use nalgebra::{Point3, Vector3};

/// Where the refinement may begin: the layer maps unfolded, and BSR-Net's answer.
///
/// With contours the former alone, since the refinement cannot make a fold that its start lacks, and BSR-Net misses some:
/// on 40 folded held-out sketches the contours ended 4.4 px off from BSR-Net's start, 1.0 px from the unfolded one. Without
/// contours the one with less energy is taken.
pub(super) fn first_surfaces(
    networks: &mut Networks,
    maps: &SketchMaps,
    depths: &DepthPrediction,
    targets: &SurfaceTargets,
    curves: &BorderCurves,
    control: &Control,
    times: &mut Times,
) -> Result<Vec<NurbsSurface>, Error> {
    let unfolded = timed(&mut times.refine, || unfolded_surface(targets, curves, 1.0))?;
    if !targets.contours.is_empty() {
        return Ok(vec![unfolded]);
    }
    let predicted = timed(&mut times.infer, || network_surface(networks, maps, depths, curves, control))?;
    Ok(vec![unfolded, predicted])
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
fn network_surface(
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
