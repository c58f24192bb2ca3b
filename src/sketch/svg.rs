//! Sketches as SVG: one path, polyline, line or polygon per stroke.

use super::polyline::distance;
use super::stroke::{DepthSample, Layer, Sketch, Stroke, StrokeKind};
use super::view::View;
use crate::error::Error;
use nalgebra::{Affine2, Matrix3, Point2};
use roxmltree::{Document, Node};
use std::str::FromStr;
use svgtypes::{Color, LengthUnit, NumberListParser, Paint, PathParser, PathSegment, Transform};

/// Segments that a curve of a path is flattened to.
const CURVE_STEPS: usize = 24;
/// Elements deeper than this are refused.
const MAX_DEPTH: usize = 200;

fn format(node: Option<Node>, reason: impl std::fmt::Display) -> Error {
    let place = node.map(|n| {
        let position = n.document().text_pos_at(n.range().start);
        format!("line {}, column {}: ", position.row, position.col)
    });
    Error::Format { what: "sketch SVG", reason: format!("{}{reason}", place.unwrap_or_default()) }
}

/// What elements inherit from the groups around them.
#[derive(Clone)]
struct Context {
    map: Affine2<f64>,
    color: Option<[u8; 3]>,
    /// Kind by the name of a layer, class or id.
    named: Option<StrokeKind>,
    layer: Option<Layer>,
}

/// Reads a sketch from SVG text; canvas y is down, the view is the default.
///
/// The kind of a stroke follows from the layer, group, class or id names around it (`visible boundary`, `occluded`,
/// `contour`, `feature`), else from its colour: the nearest of green, blue, red and black by hue. Unpainted strokes
/// (`stroke: none`) and hidden elements are left out. Circles with a number in `data-depth` or in their `<title>` are depth
/// samples; on the occluded layer, if their `data-layer`, class, id or group says so.
///
/// # Errors
/// [`Error::Format`] names the line and column of the element.
pub fn parse_svg(text: &str) -> Result<Sketch, Error> {
    let document = Document::parse(text).map_err(|e| format(None, e))?;
    let root = document.root_element();
    if root.tag_name().name() != "svg" {
        return Err(format(Some(root), format!("the root element is <{}>, expected <svg>", root.tag_name().name())));
    }
    let view_box: Vec<f64> = match root.attribute("viewBox") {
        Some(text) => numbers(text).map_err(|e| format(Some(root), e))?,
        None => vec![],
    };
    let side = |name: &str, index: usize| {
        let length = root.attribute(name).and_then(|text| svgtypes::Length::from_str(text).ok());
        let given = length.filter(|l| l.unit != LengthUnit::Percent).map(|l| l.number);
        [view_box.get(index).copied(), given].into_iter().flatten().find(|x| *x > 0.0).unwrap_or(256.0)
    };
    let mut sketch = Sketch {
        name: root.children().find(|n| n.has_tag_name("title")).and_then(|n| n.text()).unwrap_or("").trim().to_string(),
        canvas_size: [side("width", 2), side("height", 3)],
        view: View::default(),
        strokes: vec![],
        depth_samples: vec![],
    };
    let context = Context { map: Affine2::identity(), color: None, named: None, layer: None };
    visit(root, &context, 0, &mut sketch)?;
    Ok(sketch)
}

/// The value of a presentation property: from `style`, else from the attribute.
fn property<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    let style = node.attribute("style").and_then(|style| {
        style
            .split(';')
            .filter_map(|item| item.split_once(':'))
            .find(|(key, _)| key.trim() == name)
            .map(|(_, v)| v.trim())
    });
    style.or_else(|| node.attribute(name).map(str::trim))
}

fn visit(node: Node, outer: &Context, depth: usize, sketch: &mut Sketch) -> Result<(), Error> {
    if depth > MAX_DEPTH {
        return Err(format(Some(node), "elements are nested too deeply"));
    }
    let hidden = property(node, "display") == Some("none") || property(node, "visibility") == Some("hidden");
    let skipped = ["defs", "symbol", "clipPath", "mask", "marker", "pattern", "metadata"];
    if hidden || skipped.contains(&node.tag_name().name()) {
        return Ok(());
    }
    let mut context = outer.clone();
    if let Some(text) = node.attribute("transform") {
        let Transform { a, b, c, d, e, f } = Transform::from_str(text)
            .map_err(|e| format(Some(node), format!("transform {text:?} is not understood: {e}")))?;
        context.map = outer.map * Affine2::from_matrix_unchecked(Matrix3::new(a, c, e, b, d, f, 0.0, 0.0, 1.0));
    }
    if let Some(paint) = property(node, "stroke") {
        context.color = match Paint::from_str(paint) {
            Ok(Paint::None) => None,
            Ok(Paint::Inherit) => context.color,
            Ok(Paint::CurrentColor) => Some([0; 3]),
            Ok(Paint::Color(Color { red, green, blue, alpha })) => (alpha > 0).then_some([red, green, blue]),
            _ => {
                let reason =
                    format!("stroke colour {paint:?} is not understood; use #rrggbb, rgb(r, g, b) or a name of CSS");
                return Err(format(Some(node), reason));
            }
        };
    }
    let names: Vec<&str> = node
        .attributes()
        .filter(|a| matches!(a.name(), "id" | "class" | "label" | "data-kind" | "data-layer"))
        .map(|a| a.value())
        .collect();
    context.named = names.iter().find_map(|n| kind_by_name(n)).or(context.named);
    context.layer = names.iter().find_map(|n| layer_by_name(n)).or(context.layer);
    let tag = node.tag_name().name();
    let number = |name: &str| -> Result<f64, Error> {
        let Some(text) = node.attribute(name) else { return Ok(0.0) };
        let value: Option<f64> = text.trim().trim_end_matches("px").parse().ok().filter(|x: &f64| x.is_finite());
        value.ok_or_else(|| format(Some(node), format!("{name} is {text:?}, expected a number")))
    };
    let lines: Vec<Vec<[f64; 2]>> = match tag {
        "path" => {
            path(node.attribute("d").unwrap_or("")).map_err(|e| format(Some(node), format!("in its path, {e}")))?
        }
        "polyline" | "polygon" => {
            let values = numbers(node.attribute("points").unwrap_or("")).map_err(|e| format(Some(node), e))?;
            if values.len() % 2 == 1 {
                return Err(format(Some(node), "points has an odd number of coordinates"));
            }
            let mut points: Vec<[f64; 2]> = values.chunks_exact(2).map(|c| [c[0], c[1]]).collect();
            if tag == "polygon"
                && let Some(&first) = points.first()
            {
                points.push(first);
            }
            vec![points]
        }
        "line" => vec![vec![[number("x1")?, number("y1")?], [number("x2")?, number("y2")?]]],
        "circle" | "ellipse" => {
            let title = node.children().find(|n| n.has_tag_name("title")).and_then(|n| n.text());
            if let Some(text) = node.attribute("data-depth").or(title) {
                let value = text.trim().trim_start_matches("depth").trim_start_matches([' ', '=', ':']).trim();
                let depth: Option<f64> = value.parse().ok().filter(|x: &f64| x.is_finite());
                let depth = depth.ok_or_else(|| format(Some(node), format!("depth is {text:?}, expected a number")))?;
                let position = (context.map * Point2::new(number("cx")?, number("cy")?)).into();
                let layer = context.layer.unwrap_or(Layer::Visible);
                sketch.depth_samples.push(DepthSample { position, layer, depth });
            }
            vec![]
        }
        _ => vec![],
    };
    let drawable = lines.into_iter().filter(|l| l.len() > 1);
    if let Some(kind) = context.color.map(|c| context.named.unwrap_or_else(|| kind_by_color(c))) {
        let map = &context.map;
        sketch.strokes.extend(
            drawable.map(|line| Stroke {
                kind,
                points: line.into_iter().map(|p| (map * Point2::from(p)).into()).collect(),
            }),
        );
    }
    for child in node.children().filter(Node::is_element) {
        visit(child, &context, depth + 1, sketch)?;
    }
    Ok(())
}

fn kind_by_name(name: &str) -> Option<StrokeKind> {
    let name = name.to_ascii_lowercase();
    let has = |word: &str| name.contains(word);
    if has("feature") {
        Some(StrokeKind::Feature)
    } else if has("contour") || has("silhouette") {
        Some(StrokeKind::Contour)
    } else if has("occluded") || has("hidden") {
        Some(StrokeKind::OccludedBoundary)
    } else if has("boundary") || has("border") || has("visible") {
        Some(StrokeKind::VisibleBoundary)
    } else {
        None
    }
}

fn layer_by_name(name: &str) -> Option<Layer> {
    let name = name.to_ascii_lowercase();
    if name.contains("occluded") || name.contains("hidden") {
        Some(Layer::Occluded)
    } else if name.contains("visible") {
        Some(Layer::Visible)
    } else {
        None
    }
}

/// The nearest of the four kinds' colours by hue; dark or grey is a feature.
fn kind_by_color([r, g, b]: [u8; 3]) -> StrokeKind {
    let (r, g, b) = (f64::from(r), f64::from(g), f64::from(b));
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    if high < 60.0 || high - low < 0.25 * high {
        return StrokeKind::Feature;
    }
    let hue = if high == r {
        ((g - b) / (high - low)).rem_euclid(6.0)
    } else if high == g {
        (b - r) / (high - low) + 2.0
    } else {
        (r - g) / (high - low) + 4.0
    };
    match hue {
        h if (1.0..3.0).contains(&h) => StrokeKind::VisibleBoundary,
        h if (3.0..5.0).contains(&h) => StrokeKind::OccludedBoundary,
        _ => StrokeKind::Contour,
    }
}

fn numbers(text: &str) -> Result<Vec<f64>, svgtypes::Error> {
    NumberListParser::from(text).collect()
}

/// A path's subpaths as polylines.
fn path(text: &str) -> Result<Vec<Vec<[f64; 2]>>, svgtypes::Error> {
    let mut lines: Vec<Vec<[f64; 2]>> = vec![];
    let (mut at, mut start) = ([0.0f64; 2], [0.0f64; 2]);
    // Last control points of a cubic and of a quadratic curve, for the smooth commands.
    let (mut cubic_control, mut quadratic_control) = (None, None);
    let mut closed = false;
    for segment in PathParser::from(text) {
        let segment = segment?;
        let base = if segment.is_abs() { [0.0; 2] } else { at };
        let place = |x: f64, y: f64| [base[0] + x, base[1] + y];
        let reflected = |control: Option<[f64; 2]>| control.map_or(at, |c| [0, 1].map(|k| 2.0 * at[k] - c[k]));
        let (mut following_cubic, mut following_quadratic) = (None, None);
        let mut added: Vec<[f64; 2]> = vec![];
        match segment {
            PathSegment::MoveTo { x, y, .. } => {
                start = place(x, y);
                at = start;
                lines.push(vec![at]);
            }
            PathSegment::LineTo { x, y, .. } => added.push(place(x, y)),
            PathSegment::HorizontalLineTo { x, .. } => added.push([base[0] + x, at[1]]),
            PathSegment::VerticalLineTo { y, .. } => added.push([at[0], base[1] + y]),
            PathSegment::CurveTo { x1, y1, x2, y2, x, y, .. } => {
                following_cubic = Some(place(x2, y2));
                added.extend(cubic(at, place(x1, y1), place(x2, y2), place(x, y)));
            }
            PathSegment::SmoothCurveTo { x2, y2, x, y, .. } => {
                following_cubic = Some(place(x2, y2));
                added.extend(cubic(at, reflected(cubic_control), place(x2, y2), place(x, y)));
            }
            PathSegment::Quadratic { x1, y1, x, y, .. } => {
                following_quadratic = Some(place(x1, y1));
                added.extend(quadratic(at, place(x1, y1), place(x, y)));
            }
            PathSegment::SmoothQuadratic { x, y, .. } => {
                let control = reflected(quadratic_control);
                following_quadratic = Some(control);
                added.extend(quadratic(at, control, place(x, y)));
            }
            PathSegment::EllipticalArc { rx, ry, x_axis_rotation, large_arc, sweep, x, y, .. } => {
                added.extend(arc(at, [rx, ry], x_axis_rotation, large_arc, sweep, place(x, y)));
            }
            PathSegment::ClosePath { .. } => {
                if distance(at, start) > 0.0 {
                    added.push(start);
                }
                at = start;
            }
        }
        if let Some(&last) = added.last() {
            if closed {
                // After Z a new subpath starts without M.
                lines.push(vec![at]);
            }
            lines.last_mut().expect("a path begins with M").extend(added);
            at = last;
        }
        (cubic_control, quadratic_control) = (following_cubic, following_quadratic);
        closed = matches!(segment, PathSegment::ClosePath { .. });
    }
    Ok(lines)
}

fn quadratic(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
    let third = |end: [f64; 2]| [0, 1].map(|k| end[k] + 2.0 / 3.0 * (b[k] - end[k]));
    cubic(a, third(a), third(c), c)
}

fn cubic(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
    (1..=CURVE_STEPS).map(move |i| {
        let t = i as f64 / CURVE_STEPS as f64;
        let s = 1.0 - t;
        [0, 1].map(|k| s * s * s * a[k] + 3.0 * s * s * t * b[k] + 3.0 * s * t * t * c[k] + t * t * t * d[k])
    })
}

/// An elliptical arc by its end points (SVG 2, appendix B.2.4).
fn arc(from: [f64; 2], radii: [f64; 2], angle_deg: f64, large: bool, sweep: bool, to: [f64; 2]) -> Vec<[f64; 2]> {
    let [mut rx, mut ry] = radii.map(f64::abs);
    if rx == 0.0 || ry == 0.0 || from == to {
        return vec![to];
    }
    let (s, c) = angle_deg.to_radians().sin_cos();
    let half = [0, 1].map(|k| 0.5 * (from[k] - to[k]));
    let p = [c * half[0] + s * half[1], -s * half[0] + c * half[1]];
    let lambda = (p[0] / rx).powi(2) + (p[1] / ry).powi(2);
    if lambda > 1.0 {
        (rx, ry) = (rx * lambda.sqrt(), ry * lambda.sqrt());
    }
    let lambda = lambda.min(1.0);
    let root = ((1.0 - lambda) / lambda).max(0.0).sqrt() * if large == sweep { -1.0 } else { 1.0 };
    let center = [root * rx * p[1] / ry, -root * ry * p[0] / rx];
    let start = ((p[1] - center[1]) / ry).atan2((p[0] - center[0]) / rx);
    let end = ((-p[1] - center[1]) / ry).atan2((-p[0] - center[0]) / rx);
    let mut turn = end - start;
    if sweep && turn < 0.0 {
        turn += std::f64::consts::TAU;
    } else if !sweep && turn > 0.0 {
        turn -= std::f64::consts::TAU;
    }
    let middle = [0, 1].map(|k| 0.5 * (from[k] + to[k]));
    let steps = 2 * CURVE_STEPS;
    let mut points: Vec<[f64; 2]> = (1..=steps)
        .map(|i| {
            let t = start + turn * i as f64 / steps as f64;
            let q = [center[0] + rx * t.cos(), center[1] + ry * t.sin()];
            [c * q[0] - s * q[1] + middle[0], s * q[0] + c * q[1] + middle[1]]
        })
        .collect();
    points[steps - 1] = to;
    points
}

/// Writes a sketch as SVG, strokes in the paper's colours; [`parse_svg`] reads it back (the view is not kept).
pub fn write_svg(sketch: &Sketch) -> String {
    let [width, height] = sketch.canvas_size;
    let flip = |p: [f64; 2]| [p[0], if sketch.view.y_down { p[1] } else { height - p[1] }];
    let escape = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\">\n<title>{}</title>\n",
        escape(&sketch.name)
    );
    for stroke in &sketch.strokes {
        let points: Vec<String> = stroke.points.iter().map(|&p| flip(p)).map(|[x, y]| format!("{x},{y}")).collect();
        let [r, g, b] = stroke.kind.color();
        out += &format!(
            "<polyline class=\"{}\" fill=\"none\" stroke=\"#{r:02x}{g:02x}{b:02x}\" points=\"{}\"/>\n",
            stroke.kind.name(),
            points.join(" ")
        );
    }
    for sample in &sketch.depth_samples {
        let [x, y] = flip(sample.position);
        out += &format!(
            "<circle class=\"{}\" cx=\"{x}\" cy=\"{y}\" r=\"3\" fill=\"#e87040\" data-depth=\"{}\"/>\n",
            sample.layer.name(),
            sample.depth
        );
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(d: &str) -> Vec<([f64; 2], [f64; 2])> {
        path(d).unwrap().iter().map(|l| (l[0], l[l.len() - 1])).collect()
    }

    #[test]
    fn paths_are_read_as_browsers_read_them() {
        assert_eq!(ends("M10-5l5 5 1.5.5"), [([10.0, -5.0], [16.5, 0.5])]);
        assert_eq!(ends("m1,2h3v4H0V0z M9 9 L8 8"), [([1.0, 2.0], [1.0, 2.0]), ([9.0, 9.0], [8.0, 8.0])]);
        assert_eq!(ends("M0 0c1 1 2 1 3 0s2-1 3 0"), [([0.0, 0.0], [6.0, 0.0])]);
        assert_eq!(ends("M0 0Q1 1 2 0T4 0"), [([0.0, 0.0], [4.0, 0.0])]);
        assert_eq!(ends("M0 0 1 0z l0 5"), [([0.0, 0.0], [0.0, 0.0]), ([0.0, 0.0], [0.0, 5.0])]);
        for bad in ["L1 1", "M1", "M1 1 X", "M0 0 A1 1 0 2 0 1 1", "M0 0 C 1 1", "M 1e999 0"] {
            assert!(path(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn arcs_stay_on_their_circle() {
        let points = path("M1 0A1 1 0 01-1 0").unwrap().remove(0);
        assert!(points.iter().all(|p| (p[0].hypot(p[1]) - 1.0).abs() < 1e-12));
        assert!(points.iter().all(|p| p[1] > -1e-9), "sweep 1 turns clockwise on screen, through y > 0");
        let large = path("M1 0A2 2 0 1 0 -1 0").unwrap().remove(0);
        assert!(large.iter().map(|p| p[1].abs()).fold(0.0, f64::max) > 3.0);
    }

    #[test]
    fn kinds_come_from_names_and_colours() {
        let sketch = parse_svg(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 300 200">
            <g transform="translate(10 20) scale(2)" stroke="#10c020">
              <path d="M0 0L1 1"/><path style="fill:none; stroke:rgb(0,0,200)" d="M0 0L5 1"/>
              <line stroke="crimson" x1="0" y1="0" x2="1" y2="1"/><polyline stroke="#222" points="0,0 1,1 2,2"/>
              <g id="Contours"><path d="M0 0L1 1"/></g><path stroke="none" d="M0 0L1 1"/>
            </g>
            <g display="none"><path stroke="red" d="M0 0L1 1"/></g>
            <circle cx="5" cy="6" data-depth="7.5" class="occluded"/><circle cx="5" cy="6"><title>depth 2</title></circle>
            <circle cx="1" cy="2" r="3" stroke="red"/>
            </svg>"##,
        )
        .unwrap();
        use StrokeKind::{Contour as R, Feature as F, OccludedBoundary as B, VisibleBoundary as G};
        assert_eq!(sketch.strokes.iter().map(|s| s.kind).collect::<Vec<_>>(), [G, B, R, F, R]);
        assert_eq!(sketch.strokes[0].points, [[10.0, 20.0], [12.0, 22.0]]);
        let samples: Vec<_> = sketch.depth_samples.iter().map(|s| (s.layer, s.depth)).collect();
        assert_eq!(samples, [(Layer::Occluded, 7.5), (Layer::Visible, 2.0)]);
        assert_eq!(sketch.canvas_size, [300.0, 200.0]);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let sketch = crate::sketch::parse_json(
            r#"{"name": "a<b", "strokes": [{"kind": "contour", "points": [[0, 1], [2.5, -3]]},
            {"kind": "occluded_boundary", "points": [[0, 1], [2.5, -3]]}],
            "depth_samples": [{"x": 1, "y": 2, "layer": "occluded", "depth": 3}]}"#,
        )
        .unwrap();
        assert_eq!(parse_svg(&write_svg(&sketch)).unwrap(), sketch);
    }

    #[test]
    fn errors_name_the_place() {
        let reason = |text: &str| parse_svg(text).unwrap_err().to_string();
        assert!(reason("<svg>\n<path stroke='red' d='M0 0 L x'/></svg>").contains("line 2, column 1"));
        assert!(reason("<svg>\n<path stroke='vermillion' d='M0 0L1 1'/></svg>").contains("vermillion"));
        assert!(reason("<svg>\n<circle data-depth='deep'/></svg>").contains("deep"));
        assert!(reason("<html/>").contains("expected <svg>"));
        assert!(reason("<svg>").contains("SVG"));
    }
}
