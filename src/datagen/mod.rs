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
mod natural;
mod perfect;
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
const INSISTING_ATTEMPTS: u32 = 60;
/// Tries with other views before the surface is changed, where several seeds share a surface, and where none do.
const SHARED_VIEWS_PER_CANDIDATE: u32 = 6;
const OWN_VIEWS_PER_CANDIDATE: u32 = 3;

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
    /// There is no smooth conjugate field.
    Field,
    /// The corners that the sketch code chooses do not fit the surface's border.
    Corners,
    /// The sketch code cannot make one patch of the strokes.
    Unread,
    /// The sketch code reads other regions than the surface has.
    Misread,
}

impl Reason {
    /// All reasons.
    pub const ALL: [Self; 15] = [
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
        Self::Field,
        Self::Corners,
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
            Self::Field => "field",
            Self::Corners => "corners",
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
    /// of S_u x S_v. Corners as the sketch code chooses them on the drawn border, (0, 0) the one nearest to the upper left;
    /// the border runs by chord length in space.
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
    /// Which of the surfaces that `surface_id` may stand for this is.
    pub candidate: u32,
}

/// A generator for one purpose: distinct for each seed, purpose and try.
fn dice(seed: u64, purpose: u64, attempt: u32) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&purpose.to_le_bytes());
    key[16..20].copy_from_slice(&attempt.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}

/// Whether the dice of a seed ask for an occluded part.
fn wants_occlusion(seed: u64, options: &Options) -> bool {
    dice(seed, 1, 0).random_bool(options.occluded_share.clamp(0.0, 1.0))
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
    let wants_occlusion = wants_occlusion(seed, options);
    let mut rejected = [0; Reason::ALL.len()];
    let family = draw_family(&options.shares, &mut dice(surface_id, 2, 0));
    let views = if rotations > 1 { SHARED_VIEWS_PER_CANDIDATE } else { OWN_VIEWS_PER_CANDIDATE };
    let mut last = Rejection(Reason::Surface);
    let mut attempt = 0;
    for candidate in 0..MAX_ATTEMPTS {
        let mut refuse = |rejection: Rejection| {
            rejected[Reason::ALL.iter().position(|&r| r == rejection.0).unwrap_or(0)] += 1;
            last = rejection;
        };
        let Some(world) = surfaces::random_surface(family, &mut dice(surface_id, 3, candidate)) else {
            refuse(Rejection(Reason::Surface));
            continue;
        };
        for _ in 0..views {
            let wish = (attempt < INSISTING_ATTEMPTS).then_some(wants_occlusion);
            let identity = Identity { seed, surface_id, family };
            match view_sample(&world, identity, attempt, wish, options) {
                Ok(sample) => return Ok(Sample { rejected, candidate, ..sample }),
                Err(rejection) => refuse(rejection),
            }
            attempt += 1;
        }
        if attempt >= MAX_ATTEMPTS {
            break;
        }
    }
    Err(last)
}

/// The surface of a sample from another direction, with the dice of `seed` for the view and all that follows.
///
/// # Errors
/// The [`Rejection`] of the last try.
pub fn sample_again(shown: &Sample, seed: u64, options: &Options) -> Result<Sample, Rejection> {
    let &Sample { surface_id, family, candidate, .. } = shown;
    let refused = Rejection(Reason::Surface);
    let world = surfaces::random_surface(family, &mut dice(surface_id, 3, candidate)).ok_or(refused)?;
    let wants_occlusion = wants_occlusion(seed, options);
    let mut last = refused;
    for attempt in 0..MAX_ATTEMPTS {
        let wish = (attempt < INSISTING_ATTEMPTS).then_some(wants_occlusion);
        let identity = Identity { seed, surface_id, family };
        match view_sample(&world, identity, attempt, wish, options) {
            Ok(sample) => return Ok(Sample { candidate, ..sample }),
            Err(rejection) => last = rejection,
        }
    }
    Err(last)
}

/// What a sample inherits.
struct Identity {
    seed: u64,
    surface_id: u64,
    family: Family,
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

/// Control net seen along -z: rotated about the vertical, turned into the camera frame, scaled into the canonical square; its
/// coarse grid and the scale. `None` if the view has no extent.
fn view_net(surface: &NurbsSurface, azimuth: f64, view: &View) -> Option<(Vec<Point3<f64>>, Grid, f64)> {
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), azimuth);
    let mut net: Vec<Point3<f64>> =
        surface.control_points().iter().map(|p| view.world_to_camera(&(turn * p))).collect();
    let mut grid = Grid::new(&net, &tables()[0]);
    let frame = CanonicalFrame::fitting(grid.position.iter().map(|p| [p.x, p.y]))?;
    net.iter_mut().chain(&mut grid.position).for_each(|p| *p = frame.point_from_camera(p));
    Some((net, grid, frame.scale))
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

/// One view of a surface as a sample.
fn view_sample(
    world: &NurbsSurface,
    Identity { seed, surface_id, family }: Identity,
    attempt: u32,
    wants_occlusion: Option<bool>,
    options: &Options,
) -> Result<Sample, Rejection> {
    let refuse = |reason: Reason| Err(Rejection(reason));
    let rng = &mut dice(seed, 4, attempt);
    let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
    let [low, high] = options.elevation_deg;
    let elevation_deg = if high > low { rng.random_range(low..high) } else { low };
    let Ok(view) = View::from_angles(45.0, elevation_deg, true) else { return refuse(Reason::Surface) };

    // A coarse look first: most tries end here.
    let (net, coarse, scale) = view_net(world, azimuth, &view).ok_or(Rejection(Reason::Surface))?;
    let (mut low, mut high) = (coarse.position[0], coarse.position[0]);
    for p in &coarse.position {
        low = low.inf(p);
        high = high.sup(p);
    }
    let size = high - low;
    let layers = Layers::new(&coarse.position, 72);
    if layers.overfull > 4 {
        return refuse(Reason::TooManyLayers);
    }
    let [front, back, double] = layers.areas();
    let pixel_area = (2.0 * layers::HALF / 72.0).powi(2);
    let filled = (front + back) as f64 * pixel_area;
    if size.x.min(size.y) < 0.28 * size.x.max(size.y) || filled < 0.38 * size.x * size.y {
        return refuse(Reason::Slender);
    }
    // Most occluded parts should be large enough to mean something: at least 450 of the canvas' pixels.
    let enough = if rng.random_bool(0.7) { 36 } else { 8 };
    if wants_occlusion.is_some_and(|wish| if wish { double < enough } else { double > 8 }) {
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
    let layers = Layers::new(&grid.position, 256);
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
    let directions = Directions::random(&surface, by_parameters, rng)?;
    lines.extend(feature_lines(&surface, &directions, &layers, rng));
    // The hand has its own dice, and noise takes one throw whatever its share: with and without it, a seed differs in the
    // strokes alone.
    let noisy = rng.random_range(0.0..1.0) < options.noise_share;
    if noisy {
        let hand = &mut dice(seed, 5, attempt);
        let size = hand.random_range(0.4..1.2);
        strokes::draw_by_hand(&mut lines, size, hand);
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
    let positions: Vec<Point3<f64>> = grid.position.iter().map(to_frame).collect();
    reading::check(&patch, &Layers::new(&positions, 256), noisy)?;
    let net = natural::natural_net(&moved, &patch, |t| structure.is_hidden(t))?;
    let maps = Maps::new(&moved, &positions, &directions, cotangent);
    // depth - y cot e - reference = 0 on the mean: the reference moves into z.
    let net = net.iter().map(|p| Point3::new(p.x, p.y, p.z + maps.reference)).collect();
    let Ok(surface) = NurbsSurface::uniform(3, [NET, NET], net) else { return refuse(Reason::Surface) };
    sketch.depth_samples = depth_samples(&maps, &frame, &view, cotangent, rng);
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
        candidate: 0,
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

/// Depth of the reference in the depth samples of a sketch, canvas unit: keeps depths positive, as in the paper, on a canvas 256
/// wide.
pub const DEPTH_OF_REFERENCE: f64 = 512.0;

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
                depth: depth / frame.scale + DEPTH_OF_REFERENCE,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patch about the top of a sphere of radius 2.5 that reaches 75 degrees down, seen at 45 degrees: along -z.
    fn sphere() -> NurbsSurface {
        let view = View::from_angles(45.0, 45.0, true).unwrap();
        let greville = surfaces::greville(NET);
        let points: Vec<Point3<f64>> = greville
            .iter()
            .flat_map(|&u| greville.iter().map(move |&v| (u, v)))
            .map(|(u, v)| {
                let [a, b] = [u, v].map(|s| (75f64.to_radians() * (2.0 * s - 1.0)).tan());
                view.world_to_camera(&Point3::from(Vector3::new(a, b, 1.0).normalize() * 2.5))
            })
            .collect();
        NurbsSurface::uniform(3, [NET, NET], surfaces::interpolate_samples(&points)).unwrap()
    }

    #[test]
    fn the_contour_of_a_sphere_is_its_great_circle() {
        let surface = sphere();
        let grid = Grid::new(surface.control_points(), &tables()[1]);
        let structure = Structure::new(&surface, &grid).unwrap();
        assert_eq!(structure.contours.len(), 1);
        for p in &structure.contours[0] {
            assert!(p.z.abs() < 5e-3 && (p.x.hypot(p.y) - 2.5).abs() < 2e-3, "{p}");
        }
        // The far part of the border is hidden, from one end of the contour to the other.
        let hidden: Vec<&project::Piece> = structure.border.iter().filter(|p| p.hidden).collect();
        let ends = [structure.contours[0][0], structure.contours[0][structure.contours[0].len() - 1]];
        for end in ends {
            let distance = |p: &Point3<f64>| (p - end).norm();
            let touches =
                |p: &&&project::Piece| distance(&p.points[0]).min(distance(&p.points[p.points.len() - 1])) < 1e-9;
            assert_eq!(hidden.iter().filter(touches).count(), 1);
        }
    }

    #[test]
    fn maps_hold_the_depth_and_normals_of_a_sphere() {
        let surface = sphere();
        let grid = Grid::new(surface.control_points(), &tables()[1]);
        let directions = Directions::random(&surface, false, &mut dice(0, 0, 0)).unwrap();
        let maps = Maps::new(&surface, &grid.position, &directions, 1.0);
        let (mut seen, mut hidden) = (0, 0);
        for slot in 0..2 * MAP * MAP {
            if maps.valid[slot] == 0 {
                continue;
            }
            let (layer, pixel) = (slot / (MAP * MAP), slot % (MAP * MAP));
            let [x, y] = layers::pixel_center(MAP, pixel / MAP, pixel % MAP);
            let z = (6.25 - x * x - y * y).max(0.0).sqrt() * if layer == 0 { 1.0 } else { -1.0 };
            let h = -z - y - maps.reference;
            // Near the contour depth changes without bound within a pixel.
            if z.abs() > 0.3 {
                assert!((f64::from(maps.depth[slot]) - h).abs() < 1e-3, "{x} {y} {layer}: {} {h}", maps.depth[slot]);
                let n: f64 = (0..3)
                    .map(|a| f64::from(maps.normal[(layer * 3 + a) * MAP * MAP + pixel]) * [x, y, z][a] / 2.5)
                    .sum();
                assert!(n > 0.9999);
            }
            assert_eq!(maps.valid[slot], if layer == 0 { 1 } else { 2 });
            seen += usize::from(layer == 0);
            hidden += usize::from(layer == 1);
        }
        assert!(seen > 700 && hidden > 20);
        assert!(maps.conjugacy < 1e-3);
    }

    #[test]
    fn samples_keep_their_promises() {
        let options = Options::default();
        for seed in 0..6 {
            let sample = sample(seed, &options).unwrap();
            let net = sample.surface.control_points();
            let corners = [net[0], net[NET - 1], net[NET * NET - 1], net[NET * (NET - 1)]];
            assert!(corners.iter().all(|c| c.y - c.x <= net[0].y - net[0].x + 1e-9));
            assert!(sample.maps.conjugacy < 1e-3);
            assert_eq!(sample.occluded, sample.maps.valid[MAP * MAP..].iter().any(|&v| v > 0));
            // Sides run by chord length in space.
            let step = |a: f64| {
                let d = sample.surface.point(a, 0.0) - sample.surface.point(a + 0.05, 0.0);
                d.norm()
            };
            assert!((step(0.2) / step(0.7) - 1.0).abs() < 0.15, "seed {seed}");
            // Inside the layers that the sketch code reads, the maps agree with it and with the net.
            let covered = |k: usize| sample.raster.visible_coverage(k) > 0.99;
            let mut off = 0;
            for pixel in (0..MAP * MAP).filter(|&k| covered(k)) {
                off += usize::from(sample.maps.valid[pixel] == 0);
            }
            assert!(off < 20, "seed {seed}: {off}");
            let visible: Vec<f64> =
                (0..MAP * MAP).filter(|&k| sample.maps.valid[k] > 0).map(|k| f64::from(sample.maps.depth[k])).collect();
            assert!((visible.iter().sum::<f64>() / visible.len() as f64).abs() < 1e-4);
        }
    }

    #[test]
    fn the_net_goes_through_the_depth_maps() {
        let options = Options { noise_share: 0.0, ..Options::default() };
        for seed in 10..13 {
            let sample = sample(seed, &options).unwrap();
            let grid = Grid::new(sample.surface.control_points(), &tables()[1]);
            let layers = Layers::new(&grid.position, MAP);
            let cotangent = 1.0 / sample.elevation_deg.to_radians().tan();
            let mut errors = vec![];
            for pixel in 0..MAP * MAP {
                if let (Some(hit), true) = (layers.hits[pixel][0], sample.maps.valid[pixel] > 0) {
                    let [_, y] = layers::pixel_center(MAP, pixel / MAP, pixel % MAP);
                    errors.push((-hit.z - y * cotangent - f64::from(sample.maps.depth[pixel])).abs());
                }
            }
            errors.sort_by(f64::total_cmp);
            assert!(errors[errors.len() / 2] < 3e-3 && errors[errors.len() * 95 / 100] < 0.03, "seed {seed}");
        }
    }

    #[test]
    fn the_border_of_the_net_is_the_one_that_inference_finds() {
        use crate::sketch::CANVAS_HALF_WIDTH;
        use crate::surface::{BorderCurves, BorderLoop, LayerMap, LayerMaps};
        const PIXELS: usize = MAP * MAP;
        let options = Options { noise_share: 0.0, ..Options::default() };
        for seed in 20..26 {
            let sample = sample(seed, &options).unwrap();
            let cotangent = 1.0 / sample.elevation_deg.to_radians().tan();
            let map = |layer: usize| {
                let at = |k: usize| sample.maps.valid[layer * PIXELS + k];
                let depth = |k: usize| {
                    let [_, y] = layers::pixel_center(MAP, k / MAP, k % MAP);
                    f64::from(sample.maps.depth[layer * PIXELS + k]) + y * cotangent
                };
                let normal =
                    |k: usize| Vector3::from_fn(|a, _| f64::from(sample.maps.normal[(layer * 3 + a) * PIXELS + k]));
                let coverage = |side: u8| (0..PIXELS).map(|k| f64::from(at(k) == side)).collect::<Vec<_>>();
                let (depth, normal) = ((0..PIXELS).map(depth).collect(), (0..PIXELS).map(normal).collect());
                LayerMap::new(CANVAS_HALF_WIDTH, depth, normal, &coverage(1), &coverage(2)).unwrap()
            };
            let maps = LayerMaps { visible: map(0), occluded: map(1) };
            let border = BorderLoop::drawn(&sample.patch).unwrap();
            let corners = border.choose_corners().unwrap();
            let curves = BorderCurves::new(&border, corners, &maps, [NET, NET]).unwrap();
            let net = sample.surface.control_points();
            let mut errors = vec![];
            for i in 0..NET {
                let ends = [i * NET, (NET - 1) * NET + i, (NET - 1 - i) * NET + NET - 1, NET - 1 - i];
                errors.extend((0..4).map(|k| (curves.sides[k][i] - net[ends[k]]).norm()));
            }
            errors.sort_by(f64::total_cmp);
            assert!(errors[errors.len() / 2] < 0.12, "seed {seed}: {}", errors[errors.len() / 2]);
            // Depth read from maps is rough where the border runs along the view, and shifts the chord lengths with it.
            for (k, corner) in [0, (NET - 1) * NET, NET * NET - 1, NET - 1].into_iter().enumerate() {
                let apart = (curves.sides[k][0] - net[corner]).xy().norm();
                assert!(apart < 0.25, "seed {seed}, corner {k}: {apart}");
            }
        }
    }

    #[test]
    fn another_view_shows_the_same_surface() {
        let options = Options::default();
        let first = sample(40, &options).unwrap();
        let again = sample_again(&first, 5_000, &options).unwrap();
        assert_eq!((first.surface_id, first.candidate), (again.surface_id, again.candidate));
        assert_ne!(first.azimuth_deg, again.azimuth_deg);
        // A rotation keeps the area; both nets are fitted anew, each with corners of its own.
        let area = |s: &Sample| {
            let mesh = crate::surface::SurfaceMesh::new(&s.surface, [60; 2]).unwrap();
            let area: f64 = (0..mesh.triangles.len()).map(|t| mesh.triangle_normal_area(t).1).sum();
            area / (s.scale * strokes::PIXELS_PER_UNIT * s.patch.frame.scale).powi(2)
        };
        assert!((area(&first) / area(&again) - 1.0).abs() < 0.02, "{} {}", area(&first), area(&again));
    }

    #[test]
    fn noise_changes_the_strokes_alone() {
        let with = |noise_share: f64| sample(61, &Options { noise_share, ..Options::default() }).unwrap();
        let (clean, noisy) = (with(0.0), with(1.0));
        assert!(!clean.noisy && noisy.noisy);
        assert_eq!((clean.azimuth_deg, clean.candidate), (noisy.azimuth_deg, noisy.candidate));
        assert_ne!(clean.sketch.strokes, noisy.sketch.strokes);
        assert_eq!(clean.sketch.depth_samples.len(), noisy.sketch.depth_samples.len());
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let run = |threads: usize| {
            let out = folder.path().join(format!("{threads}"));
            let options = Options { seeds: 100..105, out: out.clone(), threads, shard_size: 3, ..Options::default() };
            generate(&options, &crate::control::Control::default()).unwrap();
            out
        };
        let (one, two) = (run(1), run(2));
        for shard in ["shard_00033", "shard_00034"] {
            for name in ["strokes.npy", "valid.npy", "depth.npy", "normal.npy", "control.npy", "cdf.npy", "meta.jsonl"]
            {
                let read = |out: &std::path::Path| std::fs::read(out.join(shard).join(name)).unwrap();
                assert!(read(&one) == read(&two), "{shard}/{name}");
            }
        }
    }
}
