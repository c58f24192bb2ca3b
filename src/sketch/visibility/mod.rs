//! What the strokes mean: layers and orientation of every region, the border as one loop.
//!
//! The number of surface layers follows from counting: nothing outside; behind a contour two layers, since the surface
//! folds there; inside a visible boundary one; and every border line in the interior starts or ends one layer. That is
//! stronger than the paper's rule (a region has an occluded part if it touches a contour) and equal to it under the paper's
//! Assumption 1. Orientation follows the paper's Proposition 1.

mod border;
mod features;
mod meaning;
mod patch;
mod samples;

use super::arrange::{Arrangement, Curve, Flaw, arrange};
use super::fit::{smooth, thin};
use super::polyline::{Point, arc_lengths, closest, inside, length};
use super::stroke::{Layer, Sketch, StrokeKind};
use super::view::{CANONICAL_LENGTH, CanonicalFrame, View};
use crate::error::Error;
use features::{MIN_FEATURE_PX, clip_features, clip_to_box};
use std::collections::BTreeSet;

/// Canonical units per pixel of the 256 x 256 canvas: the longer side of the strokes' bounding box covers 232 pixels.
pub const CANONICAL_PER_PX: f64 = CANONICAL_LENGTH / 232.0;
/// Most points that all strokes may have together, after those closer than a quarter pixel were dropped.
const MAX_POINTS: usize = 100_000;
/// Most strokes.
const MAX_STROKES: usize = 2_000;
/// Largest magnitude of a coordinate; beyond it, differences of squares overflow.
const MAX_COORDINATE: f64 = 1e150;
/// Strokes smaller than this are slips of the pen, px.
const MIN_STROKE_PX: f64 = 1.5;

/// Which side of the surface faces the viewer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Orientation {
    /// The outer side, that of the outward normals.
    Front,
    /// The inner side.
    Back,
}

impl Orientation {
    /// The other side.
    pub fn flipped(self) -> Self {
        match self {
            Self::Front => Self::Back,
            Self::Back => Self::Front,
        }
    }
}

/// A cleaned stroke, canonical frame.
#[derive(Clone, Debug, PartialEq)]
pub struct CleanStroke {
    /// What it stands for.
    pub kind: StrokeKind,
    /// Smooth dense polyline, at most about one pixel (0.035) between points; a closed stroke repeats its first point.
    pub points: Vec<[f64; 2]>,
    /// The sketch's stroke that it comes from; the first one, if several were joined.
    pub source: usize,
}

/// A minimal region: bounded by structural lines, with none inside.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Outer ring counter-clockwise, then holes clockwise; canonical frame, first point not repeated.
    pub rings: Vec<Vec<[f64; 2]>>,
    /// Side shown by the visible layer.
    pub visible: Orientation,
    /// Side shown by the occluded layer; `None` where the surface has a single layer.
    pub occluded: Option<Orientation>,
    /// Area, canonical units squared.
    pub area: f64,
}

impl Region {
    /// Whether the point lies in the region.
    pub fn contains(&self, position: [f64; 2]) -> bool {
        inside(&self.rings, position)
    }
}

/// A point of the surface's border, canonical frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BorderPoint {
    /// Canonical x, y.
    pub position: [f64; 2],
    /// Whether the border is seen there.
    pub layer: Layer,
    /// The side that the sheet which ends there shows: the sheet lies to the left of the loop where that is its front, else to the right.
    pub side: Orientation,
}

/// A depth sample in the canonical frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CanonicalSample {
    /// Canonical x, y.
    pub position: [f64; 2],
    /// Surface layer that it lies on.
    pub layer: Layer,
    /// Depth, canonical units, growing away from the viewer.
    pub depth: f64,
}

/// One outline and all that lies in it, in the canonical frame of its own structural strokes.
#[derive(Clone, Debug)]
pub struct PatchSketch {
    /// Where the canonical frame lies in the camera frame.
    pub frame: CanonicalFrame,
    /// The sketch's view.
    pub view: View,
    /// Structural strokes, joined where they continue each other, then feature strokes, clipped to the visible surface.
    pub strokes: Vec<CleanStroke>,
    /// The regions, largest first.
    pub regions: Vec<Region>,
    /// The surface's border: one closed loop, counter-clockwise as seen from the surface's front side (where the front is
    /// visible, the surface lies to the left), starting at its lowest point; the first point is not repeated.
    pub border: Vec<BorderPoint>,
    /// Depth samples inside this outline.
    pub depth_samples: Vec<CanonicalSample>,
}

impl PatchSketch {
    /// The region that contains a canonical point.
    pub fn region_at(&self, position: [f64; 2]) -> Option<&Region> {
        self.regions.iter().find(|r| r.contains(position))
    }
}

/// What a sketch means.
#[derive(Clone, Debug)]
pub struct Understanding {
    /// One patch for each outline, largest first.
    pub patches: Vec<PatchSketch>,
    /// Strokes that belong to no outline: features outside, slips of the pen, and exact repetitions.
    pub unused: Vec<usize>,
}

/// A stroke in the camera frame.
struct Drawn {
    kind: StrokeKind,
    points: Vec<Point>,
    source: usize,
}

/// Cleans the strokes, arranges them into regions, and decides visibility and orientation.
///
/// Strokes may come in any order and direction and in pieces; ends may miss each other by 8 px of the 256 canvas (3 %), and
/// overshoot by 12. Separate outlines become separate patches. Moving or scaling the canvas changes nothing but the frame.
///
/// # Errors
/// [`Error::NotFinite`], [`Error::Argument`] (a coordinate beyond 1e150), [`Error::TooLarge`]; [`Error::NoOutline`] without
/// structural strokes; [`Error::OpenOutline`] names the widest gap; [`Error::Contradiction`] names the place and what to
/// draw; [`Error::SampleOutside`] for a depth sample more than 6 px outside its layer.
///
/// # Source
/// Sketch2PQ, Sec. 3.2. The paper fills regions of the rasterized sketch; here they are exact faces of the planar
/// arrangement of the curves, and layers are counted, so that a contradiction shows where it is.
pub fn understand(sketch: &Sketch) -> Result<Understanding, Error> {
    let mut unused = vec![];
    let drawn = validate(sketch, &mut unused)?;
    let (structural, features): (Vec<&Drawn>, Vec<&Drawn>) = drawn.iter().partition(|d| d.kind.is_structural());
    let mut patches = vec![];
    outlines(sketch, &structural, &features, &mut patches)?;
    let used: BTreeSet<usize> = patches.iter().flat_map(|p: &PatchSketch| p.strokes.iter().map(|s| s.source)).collect();
    unused.extend(features.iter().map(|f| f.source).filter(|s| !used.contains(s)));
    unused.sort_unstable();
    unused.dedup();
    patches.sort_by(|a, b| a.frame.scale.total_cmp(&b.frame.scale));
    samples::place_samples(sketch, &mut patches)?;
    Ok(Understanding { patches, unused })
}

/// Checks the numbers, moves to the camera frame, drops points without extent and repeated strokes.
fn validate(sketch: &Sketch, unused: &mut Vec<usize>) -> Result<Vec<Drawn>, Error> {
    if sketch.strokes.len() > MAX_STROKES {
        return Err(Error::TooLarge { what: "strokes", count: sketch.strokes.len(), limit: MAX_STROKES });
    }
    let check = |what, index, p: Point| {
        if !p.iter().all(|x| x.is_finite()) {
            return Err(Error::NotFinite { what, index });
        }
        match p.iter().find(|x| x.abs() > MAX_COORDINATE) {
            Some(x) => {
                let value = format!("{x:e}");
                Err(Error::Argument { name: "coordinate", value, expected: "a magnitude of at most 1e150" })
            }
            None => Ok(()),
        }
    };
    for (index, sample) in sketch.depth_samples.iter().enumerate() {
        check("depth sample", index, sample.position)?;
        check("depth sample", index, [sample.depth, 0.0])?;
    }
    let mut drawn: Vec<Drawn> = vec![];
    for (source, stroke) in sketch.strokes.iter().enumerate() {
        let mut points: Vec<Point> = Vec::with_capacity(stroke.points.len());
        for &p in &stroke.points {
            check("stroke", source, p)?;
            let p = sketch.view.canvas_to_camera(p);
            if points.last() != Some(&p) {
                points.push(p);
            }
        }
        let same = |d: &Drawn| {
            d.kind == stroke.kind
                && d.points.len() == points.len()
                && (d.points == points || d.points.iter().eq(points.iter().rev()))
        };
        if points.len() < 2 || drawn.iter().any(same) {
            unused.push(source);
        } else {
            drawn.push(Drawn { kind: stroke.kind, points, source });
        }
    }
    Ok(drawn)
}

/// Pixels of the 256 x 256 canvas, centred at the outline, y up; and back to the host's canvas.
struct PixelFrame<'a> {
    frame: CanonicalFrame,
    view: &'a View,
}

impl PixelFrame<'_> {
    fn pixel(&self, p: Point) -> Point {
        self.frame.from_camera(p).map(|x| x / CANONICAL_PER_PX)
    }

    fn to_camera(&self, p: Point) -> Point {
        self.frame.to_camera(p.map(|x| x * CANONICAL_PER_PX))
    }

    fn to_canvas(&self, p: Point) -> Point {
        self.view.camera_to_canvas(self.to_camera(p))
    }

    fn error(&self, flaw: Flaw) -> Error {
        match flaw {
            Flaw::NoOutline => Error::NoOutline,
            Flaw::TooLarge { what, count, limit } => Error::TooLarge { what, count, limit },
            Flaw::Open { stroke, position, gap } => {
                let [x, y] = self.to_canvas(position);
                Error::OpenOutline { stroke, x, y, gap: gap * CANONICAL_PER_PX / self.frame.scale }
            }
            Flaw::Contradiction { position, reason } => {
                let [x, y] = self.to_canvas(position);
                Error::Contradiction { x, y, reason }
            }
        }
    }
}

/// Understands the outlines among `structural`: one directly, several each in its own scale.
fn outlines(
    sketch: &Sketch,
    structural: &[&Drawn],
    features: &[&Drawn],
    patches: &mut Vec<PatchSketch>,
) -> Result<(), Error> {
    let frame = CanonicalFrame::fitting(structural.iter().flat_map(|d| d.points.iter().copied()));
    let frame = PixelFrame { frame: frame.ok_or(Error::NoOutline)?, view: &sketch.view };
    let mut count = 0;
    let mut curves = vec![];
    for d in structural {
        let points = thin(d.points.iter().map(|&p| frame.pixel(p)));
        count += points.len().max(length(&points) as usize);
        if count > MAX_POINTS {
            return Err(Error::TooLarge { what: "points along its strokes", count, limit: MAX_POINTS });
        }
        if length(&points) >= MIN_STROKE_PX {
            curves.push(Curve { kind: d.kind, points: smooth(&points), source: d.source });
        }
    }
    if curves.is_empty() {
        return Err(Error::NoOutline);
    }
    let arrangement = arrange(&curves).map_err(|flaw| frame.error(flaw))?;
    let groups = groups(&arrangement);
    if groups.len() > 1 {
        for group in &groups {
            // A piece that was joined names only its first stroke, so strokes are assigned by nearness.
            let own: Vec<&Drawn> = structural
                .iter()
                .copied()
                .filter(|d| nearest_group(&arrangement, &groups, &frame, d) == Some(group[0]))
                .collect();
            if own.len() == structural.len() {
                let [x, y] = frame.to_canvas(arrangement.nodes[arrangement.edges[0].nodes[0]]);
                let reason =
                    "one stroke belongs to several outlines; draw each outline with its own strokes".to_string();
                return Err(Error::Contradiction { x, y, reason });
            }
            outlines(sketch, &own, features, patches)?;
        }
        return Ok(());
    }
    let meaning = meaning::interpret(&arrangement).map_err(|flaw| frame.error(flaw))?;
    let mut features_px = vec![];
    for d in features {
        for points in clip_to_box(d.points.iter().map(|&p| frame.pixel(p))) {
            let points = thin(points);
            count += points.len().max(length(&points) as usize);
            if count > MAX_POINTS {
                return Err(Error::TooLarge { what: "points along its strokes", count, limit: MAX_POINTS });
            }
            if points.len() > 1 && length(&points) >= MIN_FEATURE_PX {
                features_px.push(Curve { kind: d.kind, points: smooth(&points), source: d.source });
            }
        }
    }
    let features = clip_features(&arrangement, &features_px);
    let patch = patch::patch(&frame, &arrangement, meaning, features);
    if patch.regions.is_empty() {
        return Err(Error::NoOutline);
    }
    patches.push(patch);
    Ok(())
}

/// Components that are separate outlines, each with those nested in it; the first of each group is the outer one.
fn groups(arrangement: &Arrangement) -> Vec<Vec<usize>> {
    let count = arrangement.component_face.len();
    let parent: Vec<Option<usize>> = (0..count)
        .map(|c| {
            let face = arrangement.component_face[c];
            (face != 0).then(|| arrangement.component_of[arrangement.faces[face].cycles[0][0] / 2])
        })
        .collect();
    let mut groups: Vec<Vec<usize>> = (0..count).filter(|&c| parent[c].is_none()).map(|c| vec![c]).collect();
    for c in (0..count).filter(|&c| parent[c].is_some()) {
        let mut root = c;
        while let Some(p) = parent[root] {
            root = p;
        }
        if let Some(group) = groups.iter_mut().find(|g| g[0] == root) {
            group.push(c);
        }
    }
    groups
}

/// The outer component of the group whose lines run closest to the middle of a stroke.
fn nearest_group(arrangement: &Arrangement, groups: &[Vec<usize>], frame: &PixelFrame, d: &Drawn) -> Option<usize> {
    let points = thin(d.points.iter().map(|&p| frame.pixel(p)));
    let middle = points[points.len() / 2];
    let mut best = (f64::INFINITY, None);
    for (e, edge) in arrangement.edges.iter().enumerate() {
        let component = arrangement.component_of[e];
        if edge.kind == d.kind
            && let Some((distance, _, _)) =
                closest(&edge.points, &arc_lengths(&edge.points), middle, f64::NEG_INFINITY, f64::INFINITY)
            && distance < best.0
        {
            best = (distance, groups.iter().find(|g| g.contains(&component)).map(|g| g[0]));
        }
    }
    best.1
}

#[cfg(test)]
mod tests;
