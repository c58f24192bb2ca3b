//! Structural strokes to a planar arrangement: ends snapped, crossings cut, half-edges and faces.
//!
//! Pixels of the 256 x 256 canvas, y up. The arrangement works on the curves, never on a raster: a contour and the border
//! that it ends in stay within 3 px for some 15 px, where pixels would merge or cut regions.

mod cut;
mod faces;
mod prune;
mod snap;
mod weld;

use super::polyline::Point;
use super::stroke::StrokeKind;

/// Ends of strokes that miss each other, or another stroke, by at most this belong together, px (3 % of the canvas).
pub(crate) const SNAP_PX: f64 = 8.0;
/// Over how much of a stroke the displacement of its end is spread, px.
const SPREAD_PX: f64 = 15.0;
/// Crossings closer than this are one, px.
const MERGE_PX: f64 = 0.05;

/// A smooth structural curve with its kind and the index of the stroke it came from.
#[derive(Clone, Debug)]
pub(crate) struct Curve {
    pub kind: StrokeKind,
    pub points: Vec<Point>,
    pub source: usize,
}

/// What is wrong with the strokes, in pixels; the caller knows the canvas.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Flaw {
    /// A stroke ends in the open.
    Open { stroke: usize, position: Point, gap: f64 },
    /// The strokes contradict each other.
    Contradiction { position: Point, reason: String },
    /// There is no closed outline.
    NoOutline,
    /// More crossings or strokes than a sketch can have.
    TooLarge { what: &'static str, count: usize, limit: usize },
}

/// An edge of the arrangement: a piece of a curve between two nodes.
#[derive(Clone, Debug)]
pub(crate) struct Edge {
    pub kind: StrokeKind,
    pub points: Vec<Point>,
    pub source: usize,
    pub nodes: [usize; 2],
}

/// A face: half-edge cycles with the face on their left.
#[derive(Clone, Debug, Default)]
pub(crate) struct Face {
    /// Outer cycle (empty for the unbounded face), then holes.
    pub cycles: Vec<Vec<usize>>,
    /// Area without the holes, px^2; 0 for the unbounded face.
    pub area: f64,
}

/// Nodes, edges and faces. Half-edge `2 e` runs along edge `e`, `2 e + 1` against it; face 0 is the unbounded one.
#[derive(Clone, Debug)]
pub(crate) struct Arrangement {
    pub nodes: Vec<Point>,
    pub edges: Vec<Edge>,
    /// Half-edges leaving each node, counter-clockwise.
    pub leaving: Vec<Vec<usize>>,
    /// The face to the left of each half-edge.
    pub face_of: Vec<usize>,
    pub faces: Vec<Face>,
    /// Connected component of each edge, and the face that each component lies in.
    pub component_of: Vec<usize>,
    pub component_face: Vec<usize>,
}

impl Arrangement {
    /// Points along a half-edge.
    pub(crate) fn half_edge_points(&self, h: usize) -> Vec<Point> {
        let mut points = self.edges[h / 2].points.clone();
        if h % 2 == 1 {
            points.reverse();
        }
        points
    }

    /// Node that a half-edge leaves.
    pub(crate) fn origin(&self, h: usize) -> usize {
        self.edges[h / 2].nodes[h % 2]
    }

    /// The closed ring of a cycle, first point not repeated.
    pub(crate) fn ring(&self, cycle: &[usize]) -> Vec<Point> {
        let mut ring = vec![];
        for &h in cycle {
            let points = self.half_edge_points(h);
            ring.extend_from_slice(&points[..points.len() - 1]);
        }
        ring
    }
}

/// A curve between two nodes, before it is cut at crossings.
#[derive(Clone, Debug)]
struct Piece {
    kind: StrokeKind,
    points: Vec<Point>,
    source: usize,
    nodes: [usize; 2],
}

/// Number of branches of visible boundary, occluded boundary and contour at a node.
type Branches = [usize; 3];

/// Place of a kind in [`Branches`].
pub(crate) fn kind_index(kind: StrokeKind) -> usize {
    match kind {
        StrokeKind::VisibleBoundary => 0,
        StrokeKind::OccludedBoundary => 1,
        StrokeKind::Contour | StrokeKind::Feature => 2,
    }
}

/// Whether a node with these branches is complete: the border goes on, and changes visibility only behind something.
fn is_complete(branches: Branches) -> bool {
    matches!(branches, [2, 0, 0] | [0, 2, 0] | [0, 0, 2] | [1, 1, 1] | [2, 0, 1] | [3, 1, 0])
}

/// Builds the arrangement of the structural curves.
pub(crate) fn arrange(curves: &[Curve]) -> Result<Arrangement, Flaw> {
    let curves = snap::join_pieces(curves);
    let mut nodes = vec![];
    let mut pieces = snap::snap(&curves, &mut nodes);
    weld::weld(&mut pieces, &mut nodes);
    let edges = cut::cut(&pieces, &mut nodes)?;
    let edges = prune::prune(cut::contract(edges, &nodes), &nodes)?;
    if edges.is_empty() {
        return Err(Flaw::NoOutline);
    }
    let mut arrangement = faces::faces(edges, nodes);
    faces::untangle(&mut arrangement);
    Ok(arrangement)
}
