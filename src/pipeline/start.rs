//! Where a patch begins: what its surface has to obey by the networks, and BSR-Net's surface.

use crate::control::Control;
use crate::error::Error;
use crate::infer::{DepthPrediction, LayerPrediction, NET_SIZE, Networks, SketchMaps};
use crate::sketch::{CANVAS_HALF_WIDTH, Layer, MAP_SIZE, PatchSketch};
use crate::surface::{
    BorderCurves, LayerMap, LayerMaps, NurbsSurface, SurfaceTargets, coons_net, reconciled_maps, unfolded_surface,
};
use nalgebra::{Point3, Vector3};

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

/// What a refinement is measured against: BSR-Net's own surface, and the unfolded maps where ours begins. Canonical frame.
///
/// # Errors
/// As [`super::sketch_to_surface`].
pub(crate) fn unrefined_surfaces(
    networks: &mut Networks,
    patch: &PatchSketch,
    maps: &SketchMaps,
    depths: &DepthPrediction,
    control: &Control,
) -> Result<[NurbsSurface; 2], Error> {
    let (drawn, curves) = drawn_targets(patch, None, depths)?;
    let network = network_surface(networks, maps, depths, &curves, control)?;
    let (targets, curves) = reconciled(drawn, curves)?;
    Ok([network, unfolded_surface(&targets, &curves, 1.0)?])
}

/// What the surface has to obey, and its border in space.
pub(super) fn targets(
    patch: &PatchSketch,
    corners: Option<[[f64; 2]; 4]>,
    depths: &DepthPrediction,
) -> Result<(SurfaceTargets, BorderCurves), Error> {
    let (targets, curves) = drawn_targets(patch, corners, depths)?;
    reconciled(targets, curves)
}

/// The same with the maps as the networks leave them.
fn drawn_targets(
    patch: &PatchSketch,
    corners: Option<[[f64; 2]; 4]>,
    depths: &DepthPrediction,
) -> Result<(SurfaceTargets, BorderCurves), Error> {
    let maps = LayerMaps { visible: layer_map(depths, Layer::Visible)?, occluded: layer_map(depths, Layer::Occluded)? };
    let targets = SurfaceTargets::new(patch, corners, maps)?;
    let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [NET_SIZE; 2])?;
    Ok((targets, curves))
}

/// Targets whose layers agree, see [`reconciled_maps`], and their border.
fn reconciled(mut targets: SurfaceTargets, curves: BorderCurves) -> Result<(SurfaceTargets, BorderCurves), Error> {
    let SurfaceTargets { border, contours, samples, maps, .. } = &targets;
    let Some(maps) = reconciled_maps(border, &curves, contours, samples, maps)? else { return Ok((targets, curves)) };
    targets.maps = maps;
    let curves = BorderCurves::new(&targets.border, targets.corners, &targets.maps, [NET_SIZE; 2])?;
    Ok((targets, curves))
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
