//! One sketch with its truth, through the whole pipeline.

use super::metrics::{SurfaceSamples, chamfer, depth_errors, pair_angle_deg};
use crate::control::Control;
use crate::datagen::{DEPTH_OF_REFERENCE, MAP, Sample};
use crate::error::Error;
use crate::field::PolyVector;
use crate::infer::{DepthPrediction, DirectionPrediction, Networks, SketchMaps};
use crate::pipeline::{
    FieldOptions, MeshOptions, Session, SurfaceOptions, SurfaceResult, Times, extract_pq_mesh, sketch_to_cdf,
    sketch_to_surface, unrefined_surfaces,
};
use crate::sketch::{CANONICAL_PER_PX, Layer, map_position, understand};
use crate::surface::NurbsSurface;
use nalgebra::{Matrix4, Point3, Vector4};
use std::collections::BTreeMap;

/// What is measured, in the order of tables; each is raw canonical units or as its name says.
pub const KEYS: [&str; 34] = [
    "d_c",
    "d_n_deg",
    "d_c_start",
    "d_n_start_deg",
    "d_c_network",
    "d_n_network_deg",
    "d_c_network_shear",
    "d_v",
    "d_o",
    "d_c_shear",
    "d_v_shear",
    "d_o_shear",
    "d_v_plane",
    "d_o_plane",
    "cdf_angle_deg",
    "e_smooth",
    "p_max",
    "p_mean",
    "d_f_deg",
    "reprojection_mean_px",
    "reprojection_p95_px",
    "strokes_mean_px",
    "strokes_max_px",
    "fold_overs",
    "misfacing",
    "deviation_max_edges",
    "deviation_over_limit",
    "border_covered",
    "border_deviation_widths",
    "conjugacy_mean",
    "crossing_min_deg",
    "irregular_vertices",
    "sample_residual",
    "sample_residual_share",
];

/// The measures of one sketch.
#[derive(Clone, Debug, Default)]
pub struct Case {
    /// Number within the split.
    pub index: u64,
    /// Seed of the sketch.
    pub seed: u64,
    /// Kind of surface.
    pub family: &'static str,
    /// Whether a part of the surface is occluded.
    pub occluded: bool,
    /// Whether the strokes are drawn as by hand.
    pub noisy: bool,
    /// Number of depth samples.
    pub samples: usize,
    /// Measures by key; one that does not apply is missing.
    pub values: BTreeMap<&'static str, f64>,
    /// Wall time of the stages; `None` for a refused sketch.
    pub times: Option<Times>,
    /// Why a stage refused the sketch.
    pub failed: Option<String>,
}

/// Points a side of the surface samples for D_c and D_n; the paper's.
const SURFACE_SIDE: usize = 100;
/// Points along the border where its reprojection is measured.
const BORDER_POINTS: usize = 400;

/// Runs a sketch through networks and pipeline and compares with its truth.
///
/// # Errors
/// Only what stops the whole evaluation: [`Error::Cancelled`]. A refused sketch is a case with `failed` set.
pub fn measure(session: &mut Session, networks: &mut Networks, truth: &Sample) -> Result<Case, Error> {
    let mut case = Case {
        seed: truth.seed,
        family: truth.family.name(),
        occluded: truth.occluded,
        noisy: truth.noisy,
        samples: truth.sketch.depth_samples.len(),
        ..Case::default()
    };
    match fill(&mut case, session, networks, truth) {
        Err(Error::Cancelled) => Err(Error::Cancelled),
        Err(error) => {
            case.failed = Some(error.to_string());
            Ok(case)
        }
        Ok(()) => Ok(case),
    }
}

fn fill(case: &mut Case, session: &mut Session, networks: &mut Networks, truth: &Sample) -> Result<(), Error> {
    network_errors(case, networks, truth)?;
    let surface = sketch_to_surface(session, &truth.sketch, &SurfaceOptions::default())?;
    let recovered = surface_errors(case, &in_canonical(&surface, truth), truth, ["d_c", "d_n_deg"]);
    case.values.insert("d_c_shear", sheared_chamfer(&recovered, &truth.surface));
    let [mean, p95] = reprojection(&recovered, truth);
    case.values.insert("reprojection_mean_px", mean);
    case.values.insert("reprojection_p95_px", p95);
    if let Some(residual) = surface.report.sample_residual {
        let residual = residual * truth.patch.frame.scale;
        case.values.insert("sample_residual", residual);
        case.values.insert(
            "sample_residual_share",
            residual / SurfaceSamples::new(&truth.surface, SURFACE_SIDE).depth_range(),
        );
    }
    let field = sketch_to_cdf(session, Some(&truth.sketch), &surface, &FieldOptions::default())?;
    let mesh = extract_pq_mesh(session, &field, &MeshOptions::default())?;
    let report = &mesh.report;
    let from_report = [
        ("strokes_mean_px", report.reprojection_mean_px),
        ("strokes_max_px", report.reprojection_max_px),
        ("fold_overs", report.fold_overs.map(|n| n as f64)),
        ("misfacing", report.misfacing),
        ("e_smooth", report.e_smooth),
        ("conjugacy_mean", report.conjugacy_mean),
        ("crossing_min_deg", report.crossing_min_deg),
        ("p_max", report.p_max),
        ("p_mean", report.p_mean),
        ("d_f_deg", report.d_f_deg),
        ("deviation_max_edges", report.deviation_max_edges),
        ("deviation_over_limit", report.deviation_over_limit),
        ("border_covered", report.border_covered),
        ("border_deviation_widths", report.border_deviation_widths),
        ("irregular_vertices", report.irregular_vertices.map(|n| n as f64)),
    ];
    case.times = Some(report.time_ms);
    case.values.extend(from_report.into_iter().filter_map(|(key, value)| Some((key, value?))));
    Ok(())
}

/// Errors of VD-Net, OD-Net and CDF-Net on their own maps, of BSR-Net's surface and of the unfolded maps.
fn network_errors(case: &mut Case, networks: &mut Networks, truth: &Sample) -> Result<(), Error> {
    // The patch of the truth was read before the depth samples were drawn.
    let patch = understand(&truth.sketch)?.patches.swap_remove(0);
    let maps = SketchMaps::new(&patch, &truth.raster);
    let control = Control::default();
    let depths = networks.predict_depths(&maps, &control)?;
    let [predicted, unfolded] = unrefined_surfaces(networks, &patch, &maps, &depths, &control)?;
    let predicted = surface_errors(case, &predicted, truth, ["d_c_network", "d_n_network_deg"]);
    case.values.insert("d_c_network_shear", sheared_chamfer(&predicted, &truth.surface));
    surface_errors(case, &unfolded, truth, ["d_c_start", "d_n_start_deg"]);
    let pixels = MAP * MAP;
    // Without depth samples the distance to the viewer is free: the mean over the visible pixels decides.
    let mut free = None;
    for (index, layer) in Layer::ALL.into_iter().enumerate() {
        let Some((drawn, predicted)) = depths.layer(layer).zip(depths.depths(layer)) else { continue };
        // A hand draws a layer a little beside where it is: what it leaves out nothing was predicted for.
        let known = |k: &usize| truth.maps.valid[index * pixels + k] > 0 && drawn.seen(*k);
        let known: Vec<usize> = (0..pixels).filter(known).collect();
        let positions: Vec<[f64; 2]> = known.iter().map(|&k| map_position(k / MAP, k % MAP, MAP)).collect();
        let actual: Vec<f64> = known
            .iter()
            .zip(&positions)
            .map(|(&k, p)| f64::from(truth.maps.depth[index * pixels + k]) + maps.slope * p[1])
            .collect();
        let mut guess: Vec<f64> = known.iter().map(|&k| predicted[k]).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let shift = if case.samples == 0 {
            *free.get_or_insert(mean(&actual) - mean(&guess))
        } else {
            -DEPTH_OF_REFERENCE * truth.patch.frame.scale
        };
        guess.iter_mut().for_each(|d| *d += shift);
        if let Some(errors) = depth_errors(&positions, &guess, &actual) {
            let keys = [["d_v", "d_v_shear", "d_v_plane"], ["d_o", "d_o_shear", "d_o_plane"]][index];
            case.values.extend(keys.into_iter().zip([errors.direct, errors.shear, errors.plane]));
        }
    }
    let directions = networks.predict_directions(&maps, &depths, &control)?;
    if let Some(angle) = direction_error(&directions, &depths, truth) {
        case.values.insert("cdf_angle_deg", angle);
    }
    Ok(())
}

/// Mean angle between the predicted and the true cross over all pixels of both layers.
fn direction_error(predicted: &DirectionPrediction, depths: &DepthPrediction, truth: &Sample) -> Option<f64> {
    let pixels = MAP * MAP;
    let (mut sum, mut count) = (0.0, 0usize);
    for (index, layer) in Layer::ALL.into_iter().enumerate() {
        let coefficients = match layer {
            Layer::Visible => Some(&predicted.visible),
            Layer::Occluded => predicted.occluded.as_ref(),
        };
        let (Some(coefficients), Some(_)) = (coefficients, depths.layer(layer)) else { continue };
        for (k, predicted) in coefficients.iter().enumerate() {
            let component = |c: usize| f64::from(truth.maps.directions[(index * 4 + c) * pixels + k]);
            let actual = [[component(0), component(1)], [component(2), component(3)]];
            if actual[0][0].hypot(actual[0][1]) < 0.5 {
                continue;
            }
            let [u, v] = PolyVector::from_array(predicted.map(f64::from)).directions();
            sum += pair_angle_deg([[u.x, u.y], [v.x, v.y]], actual);
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// The surface of a result in the canonical frame of its sketch.
fn in_canonical(result: &SurfaceResult, truth: &Sample) -> NurbsSurface {
    let view = &truth.patch.view;
    result.patches[0].surface.mapped(|p| truth.patch.frame.point_from_camera(&view.world_to_camera(p)))
}

/// D_c and D_n of a surface, by name; returned as measured.
fn surface_errors(case: &mut Case, recovered: &NurbsSurface, truth: &Sample, keys: [&'static str; 2]) -> NurbsSurface {
    let (recovered, scores) = surface_scores(recovered, truth);
    case.values.extend(keys.into_iter().zip(scores));
    recovered
}

/// D_c and D_n of a surface in the canonical frame of the sketch, and the surface at the depth at which they are measured: without depth
/// samples, where a sketch leaves it free, at the mean depth of the truth, over its area.
pub fn surface_scores(recovered: &NurbsSurface, truth: &Sample) -> (NurbsSurface, [f64; 2]) {
    let shift = if truth.sketch.depth_samples.is_empty() {
        mean_z(&truth.surface) - mean_z(recovered)
    } else {
        DEPTH_OF_REFERENCE * truth.patch.frame.scale
    };
    let recovered = recovered.mapped(|p| Point3::new(p.x, p.y, p.z + shift));
    let sampled = |surface: &NurbsSurface| SurfaceSamples::new(surface, SURFACE_SIDE);
    let (distance, angle) = chamfer(&sampled(&recovered), &sampled(&truth.surface));
    (recovered, [distance, angle])
}

/// Mean z of a surface, over its area: that over the parameters would depend on how they are spread.
fn mean_z(surface: &NurbsSurface) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for i in 0..40 {
        for j in 0..40 {
            let [u, v] = surface.at_fraction((i as f64 + 0.5) / 40.0, (j as f64 + 0.5) / 40.0);
            let point = surface.evaluate(u, v);
            let area = point.du.cross(&point.dv).norm();
            sum += area * point.position.z;
            total += area;
        }
    }
    sum / total.max(f64::MIN_POSITIVE)
}

/// D_c with the four parameters of depth that a sketch leaves open removed: z' = s z + a x + b y + t, fitted to the nearest points
/// of the truth, four rounds.
fn sheared_chamfer(recovered: &NurbsSurface, truth: &NurbsSurface) -> f64 {
    let side = SURFACE_SIDE / 2;
    let target = SurfaceSamples::new(truth, side);
    let mut surface = recovered.clone();
    let mut best = f64::INFINITY;
    for _ in 0..4 {
        let samples = SurfaceSamples::new(&surface, side);
        best = best.min(chamfer(&samples, &target).0);
        let (mut matrix, mut right) = (Matrix4::<f64>::identity() * 1e-9, Vector4::<f64>::zeros());
        for (p, q) in samples.nearest_in(&target) {
            let row = Vector4::new(p.z, p.x, p.y, 1.0);
            matrix += row * row.transpose();
            right += row * q.z;
        }
        let Some(x) = matrix.cholesky().map(|c| c.solve(&right)) else { break };
        surface = surface.mapped(|p| Point3::new(p.x, p.y, x[0] * p.z + x[1] * p.x + x[2] * p.y + x[3]));
    }
    best.min(chamfer(&SurfaceSamples::new(&surface, side), &target).0)
}

/// Mean and 95th percentile of the distance from the surface's projected border to the true border, pixels of the 256 canvas.
///
/// The true border is the generator's surface itself, so that drawing noise in the strokes counts as an error.
fn reprojection(recovered: &NurbsSurface, truth: &Sample) -> [f64; 2] {
    let line = border(&truth.surface, 4 * BORDER_POINTS);
    let mut distances: Vec<f64> = border(recovered, BORDER_POINTS)
        .into_iter()
        .map(|p| {
            let nearest = (0..line.len()).map(|i| {
                let (a, b) = (line[i], line[(i + 1) % line.len()]);
                let (ab, ap) = (b - a, p - a);
                let t = (ap.dot(&ab) / ab.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                (ap - ab * t).norm()
            });
            nearest.fold(f64::INFINITY, f64::min) / CANONICAL_PER_PX
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    [mean, distances[distances.len() * 95 / 100]]
}

/// The projected border of a surface, about `count` points.
fn border(surface: &NurbsSurface, count: usize) -> Vec<nalgebra::Point2<f64>> {
    let side = count / 4;
    (0..4 * side)
        .map(|k| {
            let t = (k % side) as f64 / side as f64;
            let (s, t) = [(t, 0.0), (1.0, t), (1.0 - t, 1.0), (0.0, 1.0 - t)][k / side];
            let [u, v] = surface.at_fraction(s, t);
            surface.point(u, v).xy()
        })
        .collect()
}
