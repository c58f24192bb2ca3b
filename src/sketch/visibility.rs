//! What the strokes mean: layers and orientation of every region, the border as one loop.
//!
//! The number of surface layers follows from counting: nothing outside; behind a contour two layers, since the surface
//! folds there; inside a visible boundary one; and every border line in the interior starts or ends one layer. That is
//! stronger than the paper's rule (a region has an occluded part if it touches a contour) and equal to it under the paper's
//! Assumption 1. Orientation follows the paper's Proposition 1.

use super::arrange::{Arrangement, Curve, Flaw, arrange};
use super::fit::{smooth, thin};
use super::polyline::{Point, SegmentGrid, arc_lengths, closest, inside, length, lerp, meet};
use super::stroke::{Layer, Sketch, StrokeKind};
use super::view::{CANONICAL_LENGTH, CanonicalFrame, View};
use crate::error::Error;
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
/// Regions smaller than this are not listed, px^2.
const MIN_REGION_PX2: f64 = 0.1;
/// Pieces of feature lines shorter than this say nothing, px.
const MIN_FEATURE_PX: f64 = 4.0;
/// Depth samples this far outside their region still belong to it, px.
const SAMPLE_REACH_PX: f64 = 6.0;
/// Features are cut off this far from the origin before anything is computed, px.
const FEATURE_BOX_PX: f64 = 140.0;

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
    place_samples(sketch, &mut patches)?;
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
    let meaning = interpret(&arrangement).map_err(|flaw| frame.error(flaw))?;
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
    let patch = patch(&frame, &arrangement, meaning, features);
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

/// What the arrangement means.
struct Meaning {
    /// Layers of each face.
    layers: Vec<u8>,
    /// Orientation of each face's visible layer.
    visible: Vec<Orientation>,
    /// Half-edges along the border, counter-clockwise as seen from the front.
    border: Vec<usize>,
}

fn contradiction<T>(position: Point, reason: impl Into<String>) -> Result<T, Flaw> {
    Err(Flaw::Contradiction { position, reason: reason.into() })
}

fn middle(points: &[Point]) -> Point {
    let arc = arc_lengths(points);
    super::polyline::point_at(points, &arc, 0.5 * arc[arc.len() - 1])
}

/// Layers, orientation and border; every contradiction is found at the place where it is.
fn interpret(arrangement: &Arrangement) -> Result<Meaning, Flaw> {
    check_edges(arrangement)?;
    check_nodes(arrangement)?;
    let layers = count_layers(arrangement)?;
    let visible = orient(arrangement, &layers)?;
    let border = trace_border(arrangement, &layers, &visible)?;
    Ok(Meaning { layers, visible, border })
}

/// Contours and occluded boundaries must lie where they can.
fn check_edges(arrangement: &Arrangement) -> Result<(), Flaw> {
    for (e, edge) in arrangement.edges.iter().enumerate() {
        let faces = [arrangement.face_of[2 * e], arrangement.face_of[2 * e + 1]];
        let outside = faces.contains(&0);
        if faces[0] == faces[1] {
            return contradiction(
                middle(&edge.points),
                format!("this {} has the same area on both sides; remove it or close its area", describe(edge.kind)),
            );
        }
        match edge.kind {
            StrokeKind::OccludedBoundary if outside => {
                return contradiction(
                    middle(&edge.points),
                    "an occluded boundary runs along the outside of the drawing, where nothing hides it; draw it as visible \
                     boundary, or add the contour that lies in front of it",
                );
            }
            StrokeKind::Contour if !outside => {
                return contradiction(
                    middle(&edge.points),
                    "a contour runs inside the surface; contours lie on the outside, where the surface folds away from the \
                     viewer: draw this line as visible or occluded boundary, or as feature",
                );
            }
            _ => {}
        }
    }
    Ok(())
}

fn describe(kind: StrokeKind) -> &'static str {
    match kind {
        StrokeKind::VisibleBoundary => "visible boundary",
        StrokeKind::OccludedBoundary => "occluded boundary",
        StrokeKind::Contour => "contour",
        StrokeKind::Feature => "feature line",
    }
}

/// Around every node the layers must add up.
fn check_nodes(arrangement: &Arrangement) -> Result<(), Flaw> {
    for (n, leaving) in arrangement.leaving.iter().enumerate() {
        if leaving.is_empty() {
            continue;
        }
        let position = arrangement.nodes[n];
        let outer: Vec<usize> = (0..leaving.len()).filter(|&k| arrangement.face_of[leaving[k]] == 0).collect();
        let mut counts = [0; 3];
        for &h in leaving {
            match arrangement.edges[h / 2].kind {
                StrokeKind::VisibleBoundary => counts[0] += 1,
                StrokeKind::OccludedBoundary => counts[1] += 1,
                StrokeKind::Contour | StrokeKind::Feature => counts[2] += 1,
            }
        }
        if outer.len() > 1 {
            return contradiction(
                position,
                "the outline crosses or touches itself here, so the surface would shrink to a point; draw the piece that \
                 passes behind as occluded boundary, or move the lines apart",
            );
        }
        if !adds_up(arrangement, leaving, outer.first().copied()) {
            return contradiction(position, node_reason(counts));
        }
    }
    Ok(())
}

/// Counts layers around a node, starting in the outside if the node lies there.
fn adds_up(arrangement: &Arrangement, leaving: &[usize], outer: Option<usize>) -> bool {
    let border = |h: usize| arrangement.edges[h / 2].kind != StrokeKind::Contour;
    let Some(outer) = outer else {
        return leaving.iter().filter(|&&h| border(h)).count() % 2 == 0;
    };
    let mut layers = 0;
    for step in 1..=leaving.len() {
        let h = leaving[(outer + step) % leaving.len()];
        let last = step == leaving.len();
        layers = match (layers, border(h)) {
            (0, false) => 2,
            (0, true) => 1,
            (1, true) if last => 0,
            (1, true) => 2,
            (2, true) if !last => 1,
            (2, false) if last => 0,
            _ => return false,
        };
    }
    layers == 0
}

fn node_reason([visible, occluded, contours]: [usize; 3]) -> String {
    let border = visible + occluded;
    match (border, contours) {
        (1, 1) => "a contour meets the border here, but where a contour ends two border lines go on: the one in front and the \
                   one that turns back behind the fold; draw the missing one, as occluded boundary where it is hidden"
            .into(),
        (2, 0) if visible == 1 => "the border turns from visible to occluded here, but nothing hides it; end a contour here, \
                                   or draw the visible boundary that passes in front"
            .into(),
        (_, 0) if border % 2 == 1 => format!(
            "{border} border lines meet here, but the border has to go on behind every crossing; draw the missing piece, as \
             occluded boundary where it is hidden"
        ),
        (_, 2..) => format!("{contours} contours and {border} border lines meet here; end the contours at different places"),
        _ => format!(
            "{visible} visible, {occluded} occluded boundaries and {contours} contours meet here, which no surface with at \
             most two layers does; check their kinds"
        ),
    }
}

/// Layers of each face, spread from the outside.
fn count_layers(arrangement: &Arrangement) -> Result<Vec<u8>, Flaw> {
    let count = arrangement.faces.len();
    let mut layers = vec![u8::MAX; count];
    layers[0] = 0;
    let mut queue = vec![0];
    while let Some(f) = queue.pop() {
        for &h in arrangement.faces[f].cycles.iter().flatten() {
            let g = arrangement.face_of[h ^ 1];
            let edge = &arrangement.edges[h / 2];
            let expected = match (layers[f], edge.kind, g) {
                (0, StrokeKind::Contour, _) => 2,
                (0, _, _) => 1,
                (2, StrokeKind::Contour, 0) | (1, StrokeKind::VisibleBoundary, 0) => 0,
                (1, StrokeKind::VisibleBoundary | StrokeKind::OccludedBoundary, _) => 2,
                (2, StrokeKind::VisibleBoundary | StrokeKind::OccludedBoundary, _) => 1,
                _ => u8::MAX,
            };
            if layers[g] == u8::MAX && expected != u8::MAX {
                layers[g] = expected;
                queue.push(g);
            } else if layers[g] != expected {
                return contradiction(
                    middle(&edge.points),
                    format!(
                        "counting surface layers across this {} gives two answers; check its kind and those of the lines \
                         around it",
                        describe(edge.kind)
                    ),
                );
            }
        }
    }
    Ok(layers)
}

/// Orientation of each face's visible layer (paper, Proposition 1); the front has the larger area.
fn orient(arrangement: &Arrangement, layers: &[u8]) -> Result<Vec<Orientation>, Flaw> {
    let count = arrangement.faces.len();
    let mut visible: Vec<Option<Orientation>> = vec![None; count];
    for start in 1..count {
        if visible[start].is_some() || layers[start] == 0 {
            continue;
        }
        // All faces of one outline hang together across border lines, except where contours touch; each such island is
        // oriented by its own areas.
        visible[start] = Some(Orientation::Front);
        let mut island = vec![start];
        let mut k = 0;
        while k < island.len() {
            let f = island[k];
            k += 1;
            for &h in arrangement.faces[f].cycles.iter().flatten() {
                let g = arrangement.face_of[h ^ 1];
                let edge = &arrangement.edges[h / 2];
                if g == 0 {
                    continue;
                }
                let own = visible[f].expect("faces of the island are oriented");
                let expected = if edge.kind == StrokeKind::VisibleBoundary { own.flipped() } else { own };
                match visible[g] {
                    None => {
                        visible[g] = Some(expected);
                        island.push(g);
                    }
                    Some(o) if o == expected => {}
                    Some(_) => {
                        return contradiction(
                            middle(&edge.points),
                            format!(
                                "across this {} the surface would have to show its front and its back side at once; check \
                                 its kind and those of the lines around it",
                                describe(edge.kind)
                            ),
                        );
                    }
                }
            }
        }
        let signed: f64 = island
            .iter()
            .map(|&f| arrangement.faces[f].area * if visible[f] == Some(Orientation::Front) { 1.0 } else { -1.0 })
            .sum();
        if signed < 0.0 {
            for &f in &island {
                visible[f] = visible[f].map(Orientation::flipped);
            }
        }
    }
    Ok(visible.into_iter().map(|o| o.unwrap_or(Orientation::Front)).collect())
}

/// The border as one loop of half-edges, counter-clockwise as seen from the front side.
fn trace_border(arrangement: &Arrangement, layers: &[u8], visible: &[Orientation]) -> Result<Vec<usize>, Flaw> {
    let is_border = |h: usize| arrangement.edges[h / 2].kind != StrokeKind::Contour;
    let total = arrangement.edges.iter().filter(|e| e.kind != StrokeKind::Contour).count();
    let Some(start) = (0..arrangement.edges.len()).map(|e| 2 * e).find(|&h| is_border(h)) else {
        return contradiction(
            middle(&arrangement.edges[0].points),
            "the outline consists of contours alone, which is a closed body; draw the surface's border",
        );
    };
    // The half-edge on which the border goes on after it arrived along `h`.
    let follow = |h: usize| {
        let node = arrangement.origin(h ^ 1);
        let branches: Vec<usize> = arrangement.leaving[node].iter().copied().filter(|&h| is_border(h)).collect();
        let k = branches.iter().position(|&b| b == (h ^ 1)).expect("a half-edge's twin leaves its target");
        match branches.len() {
            2 => Ok(branches[1 - k]),
            4 => {
                let occluded = |h: &&usize| arrangement.edges[**h / 2].kind == StrokeKind::OccludedBoundary;
                match branches.iter().filter(occluded).count() {
                    1 => Ok(branches[(k + 2) % 4]),
                    n => contradiction(
                        arrangement.nodes[node],
                        if n == 0 {
                            "two visible boundaries cross here; behind the front one the other one must go on as occluded \
                             boundary"
                        } else {
                            "where two border lines cross the front one stays visible, and exactly one piece of the other is \
                             occluded; check their kinds"
                        },
                    ),
                }
            }
            n => contradiction(arrangement.nodes[node], format!("{n} border lines meet here; let two cross at a time")),
        }
    };
    let mut border = vec![start];
    loop {
        let next = follow(border[border.len() - 1])?;
        if next == start {
            break;
        }
        if border.len() > total {
            return contradiction(arrangement.nodes[arrangement.origin(next)], "the border does not close here");
        }
        border.push(next);
    }
    if border.len() < total {
        let used: BTreeSet<usize> = border.iter().map(|h| h / 2).collect();
        let other = (0..arrangement.edges.len()).find(|e| is_border(2 * e) && !used.contains(e));
        return contradiction(
            middle(&arrangement.edges[other.unwrap_or(start / 2)].points),
            "the border consists of several closed lines; surfaces with holes are not supported, so leave the hole out, or \
             draw the second outline beside the first",
        );
    }
    // Which way round: the sheet that ends at the border lies to the left where its front is seen, else to the right.
    let mut vote = 0.0;
    let mut against: [(f64, usize); 2] = [(0.0, start); 2];
    for &h in &border {
        let (left, right) = (arrangement.face_of[h], arrangement.face_of[h ^ 1]);
        let surface = if layers[left] > layers[right] { left } else { right };
        let sheet = match arrangement.edges[h / 2].kind {
            StrokeKind::OccludedBoundary => visible[surface].flipped(),
            _ => visible[surface],
        };
        let agrees = (surface == left) == (sheet == Orientation::Front);
        let weight = length(&arrangement.edges[h / 2].points);
        vote += if agrees { weight } else { -weight };
        let slot = &mut against[usize::from(agrees)];
        if weight > slot.0 {
            *slot = (weight, h);
        }
    }
    let (disagreement, h) = against[usize::from(vote < 0.0)];
    if disagreement > 3.0 {
        let edge = &arrangement.edges[h / 2];
        return contradiction(
            middle(&edge.points),
            format!(
                "along this {} the surface would lie on the wrong side of its border; check its kind",
                describe(edge.kind)
            ),
        );
    }
    if vote < 0.0 {
        border.reverse();
        border.iter_mut().for_each(|h| *h ^= 1);
    }
    Ok(border)
}

/// The parts of a polyline inside the box in which features can matter.
fn clip_to_box(points: impl Iterator<Item = Point>) -> Vec<Vec<Point>> {
    let mut parts: Vec<Vec<Point>> = vec![];
    let mut previous: Option<Point> = None;
    let mut open = false;
    for p in points {
        if let Some(q) = previous {
            let mut range = (0.0f64, 1.0f64);
            for k in 0..2 {
                let d = p[k] - q[k];
                if d == 0.0 {
                    if q[k].abs() > FEATURE_BOX_PX {
                        range.1 = -1.0;
                    }
                    continue;
                }
                let (a, b) = ((-FEATURE_BOX_PX - q[k]) / d, (FEATURE_BOX_PX - q[k]) / d);
                range = (range.0.max(a.min(b)), range.1.min(a.max(b)));
            }
            if range.0 < range.1 {
                if !open || range.0 > 0.0 {
                    parts.push(vec![lerp(q, p, range.0)]);
                }
                let part = parts.last_mut().expect("a part was opened");
                part.push(lerp(q, p, range.1));
                open = range.1 >= 1.0;
            } else {
                open = false;
            }
        }
        previous = Some(p);
    }
    parts
}

/// The parts of the features on the visible surface, split where they pass from one sheet to another.
fn clip_features(arrangement: &Arrangement, features: &[Curve]) -> Vec<Curve> {
    let mut segments = vec![];
    for (e, edge) in arrangement.edges.iter().enumerate() {
        let outside = arrangement.face_of[2 * e] == 0 || arrangement.face_of[2 * e + 1] == 0;
        // Behind an occluded boundary the visible sheet goes on.
        if outside || edge.kind == StrokeKind::VisibleBoundary {
            segments.extend(edge.points.windows(2).map(|w| [w[0], w[1]]));
        }
    }
    let grid = SegmentGrid::new(&segments, 4.0);
    let rings: Vec<Vec<Point>> = arrangement.faces[0].cycles.iter().map(|c| arrangement.ring(c)).collect();
    let mut found = vec![];
    let mut result = vec![];
    for feature in features {
        let mut parts = vec![vec![feature.points[0]]];
        for w in feature.points.windows(2) {
            grid.near(&[w[0], w[1]], &mut found);
            let mut cuts: Vec<f64> =
                found.iter().filter_map(|&s| meet([w[0], w[1]], segments[s as usize]).map(|(t, _)| t)).collect();
            cuts.sort_by(f64::total_cmp);
            for t in cuts {
                let p = lerp(w[0], w[1], t);
                parts.last_mut().expect("there is an open part").push(p);
                parts.push(vec![p]);
            }
            parts.last_mut().expect("there is an open part").push(w[1]);
        }
        for points in parts {
            if points.len() > 1 && length(&points) >= MIN_FEATURE_PX && inside(&rings, middle(&points)) {
                result.push(Curve { kind: feature.kind, points, source: feature.source });
            }
        }
    }
    result
}

/// Chains of contour edges.
fn contour_chains(arrangement: &Arrangement) -> Vec<Vec<usize>> {
    let is_contour = |e: usize| arrangement.edges[e].kind == StrokeKind::Contour;
    let follow = |h: usize| {
        let branches: Vec<usize> =
            arrangement.leaving[arrangement.origin(h ^ 1)].iter().copied().filter(|&b| is_contour(b / 2)).collect();
        (branches.len() == 2).then(|| branches[usize::from(branches[0] == (h ^ 1))])
    };
    let mut used = vec![false; arrangement.edges.len()];
    let mut chains = vec![];
    for e in 0..arrangement.edges.len() {
        if !is_contour(e) || used[e] {
            continue;
        }
        let mut chain = vec![2 * e];
        used[e] = true;
        for _ in 0..2 {
            while let Some(next) = follow(chain[chain.len() - 1]) {
                if used[next / 2] {
                    break;
                }
                used[next / 2] = true;
                chain.push(next);
            }
            chain.reverse();
            chain.iter_mut().for_each(|h| *h ^= 1);
        }
        chains.push(chain);
    }
    chains
}

/// Points along consecutive half-edges.
fn chain_points(arrangement: &Arrangement, chain: &[usize]) -> Vec<Point> {
    let mut points: Vec<Point> = vec![];
    for &h in chain {
        points.pop();
        points.extend(arrangement.half_edge_points(h));
    }
    points
}

/// Collects everything in the canonical frame of the cleaned strokes.
fn patch(frame: &PixelFrame, arrangement: &Arrangement, meaning: Meaning, features: Vec<Curve>) -> PatchSketch {
    let mut curves: Vec<Curve> = vec![];
    let add = |curves: &mut Vec<Curve>, chain: &[usize]| {
        let edges = chain.iter().map(|h| &arrangement.edges[h / 2]);
        let source = edges.clone().map(|e| e.source).min().unwrap_or(0);
        let kind = arrangement.edges[chain[0] / 2].kind;
        curves.push(Curve { kind, points: chain_points(arrangement, chain), source });
    };
    // Runs of the border with the same visibility.
    let kind = |h: usize| arrangement.edges[h / 2].kind;
    let mut border = meaning.border;
    let change = (0..border.len()).find(|&k| kind(border[k]) != kind(border[(k + border.len() - 1) % border.len()]));
    border.rotate_left(change.unwrap_or(0));
    for run in border.chunk_by(|&a, &b| kind(a) == kind(b)) {
        add(&mut curves, run);
    }
    for chain in contour_chains(arrangement) {
        add(&mut curves, &chain);
    }
    let structural = curves.iter().flat_map(|c| c.points.iter().map(|&p| frame.to_camera(p)));
    let canonical = CanonicalFrame::fitting(structural).unwrap_or(frame.frame);
    // Pixel to canonical by way of the camera would lose digits on canvases far from their origin.
    let scale = canonical.scale / frame.frame.scale * CANONICAL_PER_PX;
    let bounds = |k: usize| {
        let xs = curves.iter().flat_map(|c| c.points.iter().map(move |p| p[k]));
        xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let center = [0, 1].map(|k| 0.5 * (bounds(k).0 + bounds(k).1));
    let to_canonical = |p: Point| [0, 1].map(|k| (p[k] - center[k]) * scale);
    let convert = |points: &[Point]| -> Vec<Point> { points.iter().map(|&p| to_canonical(p)).collect() };

    let mut regions: Vec<Region> = (1..arrangement.faces.len())
        .map(|f| {
            let face = &arrangement.faces[f];
            let visible = meaning.visible[f];
            Region {
                rings: face.cycles.iter().map(|c| convert(&arrangement.ring(c))).collect(),
                visible,
                occluded: (meaning.layers[f] == 2).then(|| visible.flipped()),
                area: face.area * scale * scale,
            }
        })
        .collect();
    // Lines drawn exactly over each other may leave areas without extent.
    regions.retain(|r| r.area > MIN_REGION_PX2 * CANONICAL_PER_PX * CANONICAL_PER_PX);
    regions.sort_by(|a, b| b.area.total_cmp(&a.area));

    let mut loop_points: Vec<BorderPoint> = vec![];
    for &h in &border {
        let layer = if kind(h) == StrokeKind::OccludedBoundary { Layer::Occluded } else { Layer::Visible };
        let points = arrangement.half_edge_points(h);
        let [left, right] = [h, h ^ 1].map(|h| meaning.layers[arrangement.face_of[h]]);
        let side = if left > right { Orientation::Front } else { Orientation::Back };
        let point = |&p: &Point| BorderPoint { position: to_canonical(p), layer, side };
        loop_points.extend(points[..points.len() - 1].iter().map(point));
    }
    let lowest = (0..loop_points.len()).min_by(|&a, &b| {
        let (p, q) = (loop_points[a].position, loop_points[b].position);
        p[1].total_cmp(&q[1]).then(p[0].total_cmp(&q[0]))
    });
    loop_points.rotate_left(lowest.unwrap_or(0));

    curves.sort_by_key(|c| (c.kind, c.source));
    curves.extend(features);
    let strokes =
        curves.iter().map(|c| CleanStroke { kind: c.kind, points: convert(&c.points), source: c.source }).collect();
    PatchSketch { frame: canonical, view: *frame.view, strokes, regions, border: loop_points, depth_samples: vec![] }
}

/// Gives every depth sample to the patch and layer that it lies in, or close to.
fn place_samples(sketch: &Sketch, patches: &mut [PatchSketch]) -> Result<(), Error> {
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

#[cfg(test)]
mod tests;
