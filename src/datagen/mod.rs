//! Training data: random roof-like surfaces, their sketches and exact ground truth, from a seed.
//!
//! [`sample`] makes one sketch with its surface and maps; [`generate`] fills folders with them. The same seed gives the same
//! bytes, whatever the number of threads.
//!
//! Follows the paper, Sec. 5, with these departures: plans have smooth radii and heights are damped (independent radii and
//! uniform coefficients fold or overlap in nearly every draw); contours and the visibility of the border come from roots on
//! the B-spline instead of a depth buffer; more types of surface, each with its share.

mod directions;
mod grid;
mod layers;
mod preview;
mod project;
mod reading;
mod shard;
mod strokes;
mod surfaces;
mod truth;

pub use shard::{Options, generate, parse_shares};
pub use surfaces::Family;
pub use truth::Maps;

use crate::sketch::{CanonicalFrame, DepthSample, Layer, PatchSketch, Raster, Sketch, Stroke, View, rasterize};
use crate::surface::NurbsSurface;
use directions::Directions;
use grid::{BasisTable, Grid};
use layers::{Layers, pixel_of};
use nalgebra::{Point3, Rotation3, Vector3};
use project::Structure;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::OnceLock;

/// Control points of every surface in each direction.
pub const NET: usize = 30;
/// Pixels of every map in each direction.
pub const MAP: usize = 64;

/// Tries before a seed is given up.
const MAX_ATTEMPTS: u32 = 120;
/// Tries in which a seed insists on its dice for occlusion.
const INSISTING_ATTEMPTS: u32 = 40;
/// Tries with other views before the surface is changed, where several views share a surface.
const VIEWS_PER_CANDIDATE: u32 = 6;

/// Why a surface in a view was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// The plan folds, the height leaves its box, or |K| exceeds 5.
    Surface,
    /// The projection is long and thin, or fills little of its box.
    Slender,
    /// Front and back are seen in nearly equal parts, so that the sketch could be read either way.
    Ambiguous,
    /// More than two layers along a view ray.
    TooManyLayers,
    /// The projection has a hole or several pieces.
    NotADisk,
    /// The seed asked for an occluded part and there is none, or the reverse.
    Occlusion,
    /// A contour has a cusp.
    Cusp,
    /// A contour is a closed curve.
    ClosedFold,
    /// The surface meets itself.
    SelfIntersection,
    /// A contour or an occluded part is too small to be drawn.
    Tiny,
    /// The visibility of the border does not close up.
    Inconsistent,
    /// The sketch code cannot make one patch of the strokes.
    Unread,
    /// The sketch code reads other regions than the surface has.
    Misread,
}

impl Reason {
    /// All reasons.
    pub const ALL: [Self; 13] = [
        Self::Surface,
        Self::Slender,
        Self::Ambiguous,
        Self::TooManyLayers,
        Self::NotADisk,
        Self::Occlusion,
        Self::Cusp,
        Self::ClosedFold,
        Self::SelfIntersection,
        Self::Tiny,
        Self::Inconsistent,
        Self::Unread,
        Self::Misread,
    ];

    /// Name in statistics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Surface => "surface",
            Self::Slender => "slender",
            Self::Ambiguous => "ambiguous",
            Self::TooManyLayers => "too_many_layers",
            Self::NotADisk => "not_a_disk",
            Self::Occlusion => "occlusion",
            Self::Cusp => "cusp",
            Self::ClosedFold => "closed_fold",
            Self::SelfIntersection => "self_intersection",
            Self::Tiny => "tiny",
            Self::Inconsistent => "inconsistent",
            Self::Unread => "unread",
            Self::Misread => "misread",
        }
    }
}

/// A refused surface or view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rejection(pub Reason);

/// A sketch, the surface it shows, and the maps that the networks learn.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Seed that makes this sample.
    pub seed: u64,
    /// Number shared by all samples that may show the same surface.
    pub surface_id: u64,
    /// Kind of surface.
    pub family: Family,
    /// The surface in the canonical frame of the sketch, its z moved so that the depth reference is 0; its front side is that
    /// of S_u x S_v and control point (0, 0) is the corner nearest to the upper left.
    pub surface: NurbsSurface,
    /// The strokes on a canvas of 256 x 256 pixels, y down, with 0 to 6 depth samples.
    pub sketch: Sketch,
    /// What the sketch code makes of the sketch.
    pub patch: PatchSketch,
    /// The stroke channels of the patch.
    pub raster: Raster,
    /// Ground truth.
    pub maps: Maps,
    /// Rotation of the surface about the vertical, degrees.
    pub azimuth_deg: f64,
    /// Elevation of the view, degrees.
    pub elevation_deg: f64,
    /// Whether a part of the surface is occluded.
    pub occluded: bool,
    /// Whether the strokes are drawn as by hand.
    pub noisy: bool,
    /// Canonical units per unit of the surface whose plan fills [-4, 4]^2.
    pub scale: f64,
    /// How often each reason refused a try before, in the order of [`Reason::ALL`].
    pub rejected: [u32; Reason::ALL.len()],
}

/// A generator for one purpose: distinct for each seed, purpose and try.
fn dice(seed: u64, purpose: u64, attempt: u32) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&purpose.to_le_bytes());
    key[16..20].copy_from_slice(&attempt.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}

/// Makes the sample of a seed.
///
/// Of `options` the family shares, the elevations, the shares of noise and occlusion and the number of rotations per surface
/// count.
///
/// # Errors
/// The last [`Rejection`] if no try succeeded.
pub fn sample(seed: u64, options: &Options) -> Result<Sample, Rejection> {
    let rotations = options.rotations_per_surface.max(1);
    let surface_id = seed / rotations;
    let mut own = dice(seed, 1, 0);
    let wants_occlusion = own.random_bool(options.occluded_share.clamp(0.0, 1.0));
    let mut rejected = [0; Reason::ALL.len()];
    let mut last = Rejection(Reason::Surface);
    for attempt in 0..MAX_ATTEMPTS {
        let candidate = if rotations > 1 { attempt / VIEWS_PER_CANDIDATE } else { attempt };
        let wish = (attempt < INSISTING_ATTEMPTS).then_some(wants_occlusion);
        match attempt_sample(seed, surface_id, candidate, attempt, wish, options) {
            Ok(sample) => return Ok(Sample { rejected, ..sample }),
            Err(rejection) => {
                rejected[Reason::ALL.iter().position(|&r| r == rejection.0).unwrap_or(0)] += 1;
                last = rejection;
            }
        }
    }
    Err(last)
}

fn tables() -> &'static [BasisTable; 2] {
    static TABLES: OnceLock<[BasisTable; 2]> = OnceLock::new();
    TABLES.get_or_init(|| [BasisTable::new(56), BasisTable::new(160)])
}

/// Draws a family by the shares.
fn draw_family(shares: &[f64; 8], rng: &mut ChaCha8Rng) -> Family {
    let total: f64 = shares.iter().map(|s| s.max(0.0)).sum();
    let mut x = rng.random_range(0.0..1.0) * total;
    for (family, share) in Family::ALL.into_iter().zip(shares) {
        x -= share.max(0.0);
        if x < 0.0 {
            return family;
        }
    }
    Family::Freeform
}

/// Control net seen along -z: rotated about the vertical, turned into the camera frame, scaled into the canonical square.
fn view_net(surface: &NurbsSurface, azimuth: f64, view: &View) -> (Vec<Point3<f64>>, f64) {
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), azimuth);
    let mut net: Vec<Point3<f64>> =
        surface.control_points().iter().map(|p| view.world_to_camera(&(turn * p))).collect();
    let grid = Grid::new(&net, &tables()[0]);
    let frame = CanonicalFrame::fitting(grid.position.iter().map(|p| [p.x, p.y]));
    let frame = frame.unwrap_or(CanonicalFrame { center: [0.0; 2], scale: 1.0 });
    net.iter_mut().for_each(|p| *p = frame.point_from_camera(p));
    (net, frame.scale)
}

/// The net with u and v exchanged.
fn transposed(net: &[Point3<f64>]) -> Vec<Point3<f64>> {
    (0..NET * NET).map(|k| net[(k % NET) * NET + k / NET]).collect()
}

/// The net turned by a quarter in the parameter plane, which keeps its orientation: (u, v) reads (v, 1 - u) of the old.
fn quarter_turned(net: &[Point3<f64>]) -> Vec<Point3<f64>> {
    (0..NET * NET).map(|k| net[(k % NET) * NET + NET - 1 - k / NET]).collect()
}

/// Turns the net so that its first corner is the one nearest to the upper left.
fn relabel(mut net: Vec<Point3<f64>>) -> Vec<Point3<f64>> {
    let score = |p: &Point3<f64>| p.y - p.x;
    let corners = [net[0], net[NET - 1], net[NET * NET - 1], net[NET * (NET - 1)]];
    let best = (0..4).max_by(|&a, &b| score(&corners[a]).total_cmp(&score(&corners[b]))).unwrap_or(0);
    // A quarter turn brings corner (0, 1) to (0, 0).
    for _ in 0..best {
        net = quarter_turned(&net);
    }
    net
}

fn attempt_sample(
    seed: u64,
    surface_id: u64,
    candidate: u32,
    attempt: u32,
    wants_occlusion: Option<bool>,
    options: &Options,
) -> Result<Sample, Rejection> {
    let refuse = |reason: Reason| Err(Rejection(reason));
    let family = draw_family(&options.shares, &mut dice(surface_id, 2, 0));
    let mut shape_dice = dice(surface_id, 3, candidate);
    let Some(world) = surfaces::random_surface(family, &mut shape_dice) else { return refuse(Reason::Surface) };

    let mut rng = dice(seed, 4, attempt);
    let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
    let [low, high] = options.elevation_deg;
    let elevation_deg = if high > low { rng.random_range(low..high) } else { low };
    let Ok(view) = View::from_angles(45.0, elevation_deg, true) else { return refuse(Reason::Surface) };

    // A coarse look first: most tries end here.
    let (net, scale) = view_net(&world, azimuth, &view);
    let coarse = Grid::new(&net, &tables()[0]);
    let (mut low, mut high) = (coarse.position[0], coarse.position[0]);
    for p in &coarse.position {
        low = low.inf(p);
        high = high.sup(p);
    }
    let size = high - low;
    let layers = Layers::new(&coarse, 72);
    if layers.overfull > 4 {
        return refuse(Reason::TooManyLayers);
    }
    let [front, back, double] = layers.areas();
    let pixel_area = (2.0 * layers::HALF / 72.0).powi(2);
    let filled = (front + back) as f64 * pixel_area;
    if size.x.min(size.y) < 0.28 * size.x.max(size.y) || filled < 0.38 * size.x * size.y {
        return refuse(Reason::Slender);
    }
    if wants_occlusion.is_some_and(|wish| wish != (double > 8)) {
        return refuse(Reason::Occlusion);
    }
    if (front.min(back) as f64) > 0.42 * (front + back) as f64 {
        return refuse(Reason::Ambiguous);
    }
    layers.check_disk()?;
    let net = relabel(if front >= back { net } else { transposed(&net) });

    // Now exactly.
    let Ok(surface) = NurbsSurface::uniform(3, [NET, NET], net) else { return refuse(Reason::Surface) };
    let grid = Grid::new(surface.control_points(), &tables()[1]);
    let structure = Structure::new(&surface, &grid)?;
    let layers = Layers::new(&grid, 256);
    if layers.overfull > 12 {
        return refuse(Reason::TooManyLayers);
    }
    layers.check_disk()?;
    let double = layers.areas()[2];
    let occluded = !structure.contours.is_empty();
    if occluded != (double > 24) || (occluded && double < 150) {
        return refuse(Reason::Tiny);
    }
    if wants_occlusion.is_some_and(|wish| wish != occluded) {
        return refuse(Reason::Occlusion);
    }
    let mut lines = strokes::structural(&structure);
    if lines.iter().any(|s| strokes::length(&s.points) < 6.0) {
        return refuse(Reason::Tiny);
    }

    let by_parameters = family.has_conjugate_parameters() && rng.random_bool(0.6);
    let directions = Directions::random(&surface, by_parameters, &mut rng);
    lines.extend(feature_lines(&surface, &directions, &layers, &mut rng));
    let noisy = rng.random_bool(options.noise_share.clamp(0.0, 1.0));
    if noisy {
        let size = rng.random_range(0.4..1.2);
        strokes::draw_by_hand(&mut lines, size, &mut rng);
    }
    let mut sketch =
        Sketch { name: format!("seed_{seed}"), canvas_size: [256.0; 2], view, strokes: lines, depth_samples: vec![] };
    let patch = reading::read(&sketch)?;

    // Into the frame that the sketch code found in the strokes.
    let frame = patch.frame;
    let cotangent = 1.0 / elevation_deg.to_radians().tan();
    let to_frame = |p: &Point3<f64>| {
        let [x, y] = strokes::to_canvas([p.x, p.y]);
        let [x, y] = frame.from_camera(sketch.view.canvas_to_camera([x, y]));
        Point3::new(x, y, p.z * strokes::PIXELS_PER_UNIT * frame.scale)
    };
    let moved = surface.mapped(to_frame);
    let fine = Grid::new(moved.control_points(), &tables()[1]);
    reading::check(&patch, &Layers::new(&fine, 256), noisy)?;
    let maps = Maps::new(&moved, &fine, &directions, cotangent);
    // depth - y cot e - reference = 0 on the mean: the reference moves into z.
    let surface = moved.mapped(|p| Point3::new(p.x, p.y, p.z + maps.reference));
    sketch.depth_samples = depth_samples(&maps, &frame, &view, cotangent, &mut rng);
    Ok(Sample {
        seed,
        surface_id,
        family,
        surface,
        sketch,
        raster: rasterize(&patch),
        patch,
        maps,
        azimuth_deg: azimuth.to_degrees(),
        elevation_deg,
        occluded,
        noisy,
        scale,
        rejected: [0; Reason::ALL.len()],
    })
}

/// Two to eight lines of both families on the visible layer; one sketch in ten has none.
fn feature_lines(
    surface: &NurbsSurface,
    directions: &Directions,
    layers: &Layers,
    rng: &mut ChaCha8Rng,
) -> Vec<Stroke> {
    if rng.random_bool(0.1) {
        return vec![];
    }
    let visible: Vec<usize> = (0..layers.n * layers.n).filter(|&k| layers.hits[k][0].is_some()).collect();
    let wanted = rng.random_range(2..=8);
    let mut lines: Vec<Vec<Point3<f64>>> = vec![];
    let on_visible = |uv: [f64; 2], point: &crate::surface::SurfacePoint| {
        let pixel = pixel_of(layers.n, [point.position.x, point.position.y]);
        let Some(hit) = pixel.and_then(|k| layers.hits[k][0]) else { return false };
        let apart = (hit.uv[0] - uv[0]).hypot(hit.uv[1] - uv[1]);
        let normal = point.du.cross(&point.dv);
        apart < 0.04 && normal.z.abs() > 0.1 * normal.norm()
    };
    for _ in 0..4 * wanted {
        if lines.len() == wanted || visible.is_empty() {
            break;
        }
        let Some(hit) = layers.hits[visible[rng.random_range(0..visible.len())]][0] else { continue };
        let family = rng.random_range(0..2);
        let length = rng.random_range(0.15..0.6) * crate::sketch::CANONICAL_LENGTH;
        let start = surface.point(hit.uv[0], hit.uv[1]);
        // Not on top of a line that is there already.
        if lines.iter().flatten().any(|p| (p - start).xy().norm() < 0.35) {
            continue;
        }
        let line = directions::trace(surface, directions, family, hit.uv, length, on_visible);
        let line: Vec<Point3<f64>> = line.into_iter().map(|[u, v]| surface.point(u, v)).collect();
        let drawn: f64 = line.windows(2).map(|w| (w[1] - w[0]).xy().norm()).sum();
        if drawn > 0.7 {
            lines.push(line);
        }
    }
    lines.iter().map(|line| strokes::feature(line)).collect()
}

/// Up to six random depth samples, canvas frame and unit.
fn depth_samples(
    maps: &Maps,
    frame: &CanonicalFrame,
    view: &View,
    cotangent: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<DepthSample> {
    let slots: Vec<usize> = (0..2 * MAP * MAP).filter(|&k| maps.valid[k] > 0).collect();
    if slots.is_empty() {
        return vec![];
    }
    (0..rng.random_range(0..=6))
        .map(|_| {
            let slot = slots[rng.random_range(0..slots.len())];
            let pixel = slot % (MAP * MAP);
            let center = layers::pixel_center(MAP, pixel / MAP, pixel % MAP);
            let depth = f64::from(maps.depth[slot]) + center[1] * cotangent;
            DepthSample {
                position: view.camera_to_canvas(frame.to_camera(center)),
                layer: if slot < MAP * MAP { Layer::Visible } else { Layer::Occluded },
                // The canvas is 256 wide: this keeps depths positive, as in the paper.
                depth: depth / frame.scale + 512.0,
            }
        })
        .collect()
}
