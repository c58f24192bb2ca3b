//! Layers and orientation of every face, and what contradicts itself, at the place where it does.

use super::super::arrange::{Arrangement, Flaw, kind_index};
use super::super::polyline::{Point, middle};
use super::super::stroke::StrokeKind;
use super::Orientation;
use super::border::trace_border;

/// What the arrangement means.
pub(super) struct Meaning {
    /// Layers of each face.
    pub(super) layers: Vec<u8>,
    /// Orientation of each face's visible layer.
    pub(super) visible: Vec<Orientation>,
    /// Half-edges along the border, counter-clockwise as seen from the front.
    pub(super) border: Vec<usize>,
}

pub(super) fn contradiction<T>(position: Point, reason: impl Into<String>) -> Result<T, Flaw> {
    Err(Flaw::Contradiction { position, reason: reason.into() })
}

/// Layers, orientation and border; every contradiction is found at the place where it is.
pub(super) fn interpret(arrangement: &Arrangement) -> Result<Meaning, Flaw> {
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

pub(super) fn describe(kind: StrokeKind) -> &'static str {
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
            counts[kind_index(arrangement.edges[h / 2].kind)] += 1;
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
