//! Sketches as SVG: one path, polyline, line or polygon per stroke.

use super::polyline::distance;
use super::stroke::{DepthSample, Layer, Sketch, Stroke, StrokeKind};
use super::view::View;
use crate::error::Error;
use roxmltree::{Document, Node};

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

/// Affine map [a b c d e f]: x' = a x + c y + e, y' = b x + d y + f.
#[derive(Clone, Copy)]
struct Affine([f64; 6]);

impl Affine {
    const IDENTITY: Self = Self([1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);

    fn apply(&self, p: [f64; 2]) -> [f64; 2] {
        let m = &self.0;
        [m[0] * p[0] + m[2] * p[1] + m[4], m[1] * p[0] + m[3] * p[1] + m[5]]
    }

    /// First `inner`, then this.
    fn after(&self, inner: &Self) -> Self {
        let (m, n) = (&self.0, &inner.0);
        Self([
            m[0] * n[0] + m[2] * n[1],
            m[1] * n[0] + m[3] * n[1],
            m[0] * n[2] + m[2] * n[3],
            m[1] * n[2] + m[3] * n[3],
            m[0] * n[4] + m[2] * n[5] + m[4],
            m[1] * n[4] + m[3] * n[5] + m[5],
        ])
    }
}

/// What elements inherit from the groups around them.
#[derive(Clone)]
struct Context {
    map: Affine,
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
        let digits = root.attribute(name).map(|t| t.trim_end_matches(|c: char| c.is_alphabetic()).trim());
        let given = digits.and_then(|t| t.parse::<f64>().ok()).filter(|x| x.is_finite() && *x > 0.0);
        view_box.get(index).copied().filter(|x| *x > 0.0).or(given).unwrap_or(256.0)
    };
    let mut sketch = Sketch {
        name: root.children().find(|n| n.has_tag_name("title")).and_then(|n| n.text()).unwrap_or("").trim().to_string(),
        canvas_size: [side("width", 2), side("height", 3)],
        view: View::default(),
        strokes: vec![],
        depth_samples: vec![],
    };
    let context = Context { map: Affine::IDENTITY, color: None, named: None, layer: None };
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
        context.map = outer.map.after(&transform(text).map_err(|e| format(Some(node), e))?);
    }
    if let Some(paint) = property(node, "stroke") {
        context.color = color(paint).map_err(|e| format(Some(node), e))?;
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
        "path" => path(node.attribute("d").unwrap_or("")).map_err(|e| format(Some(node), e))?,
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
                let position = context.map.apply([number("cx")?, number("cy")?]);
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
        sketch
            .strokes
            .extend(drawable.map(|line| Stroke { kind, points: line.into_iter().map(|p| map.apply(p)).collect() }));
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

/// RGB of a paint; `None` where nothing is painted.
fn color(text: &str) -> Result<Option<[u8; 3]>, String> {
    let text = text.trim().to_ascii_lowercase();
    let bad = || format!("stroke colour {text:?} is not understood; use #rrggbb or rgb(r, g, b)");
    if let Some(hex) = text.strip_prefix('#') {
        let digits: Option<Vec<u8>> = hex.chars().map(|c| c.to_digit(16).map(|d| d as u8)).collect();
        return match digits.ok_or_else(bad)?[..] {
            [r, g, b] | [r, g, b, _] => Ok(Some([r * 17, g * 17, b * 17])),
            [a, b, c, d, e, f] | [a, b, c, d, e, f, _, _] => Ok(Some([a * 16 + b, c * 16 + d, e * 16 + f])),
            _ => Err(bad()),
        };
    }
    if let Some(list) = text.strip_prefix("rgb") {
        let inner = list.trim_start_matches('a').trim().strip_prefix('(').and_then(|l| l.strip_suffix(')'));
        let mut parts = inner.ok_or_else(bad)?.split([',', ' ', '/']).filter(|p| !p.is_empty());
        let mut channel = || -> Option<u8> {
            let part = parts.next()?;
            let value = match part.strip_suffix('%') {
                Some(percent) => percent.parse::<f64>().ok()? * 2.55,
                None => part.parse::<f64>().ok()?,
            };
            Some(value.round().clamp(0.0, 255.0) as u8)
        };
        return match (channel(), channel(), channel()) {
            (Some(r), Some(g), Some(b)) => Ok(Some([r, g, b])),
            _ => Err(bad()),
        };
    }
    Ok(Some(match text.as_str() {
        "none" | "transparent" => return Ok(None),
        "black" | "currentcolor" => [0, 0, 0],
        "gray" | "grey" => [128, 128, 128],
        "darkgray" | "darkgrey" => [169, 169, 169],
        "green" => [0, 128, 0],
        "lime" => [0, 255, 0],
        "limegreen" => [50, 205, 50],
        "darkgreen" => [0, 100, 0],
        "forestgreen" => [34, 139, 34],
        "seagreen" => [46, 139, 87],
        "springgreen" => [0, 255, 127],
        "blue" => [0, 0, 255],
        "navy" => [0, 0, 128],
        "darkblue" => [0, 0, 139],
        "mediumblue" => [0, 0, 205],
        "royalblue" => [65, 105, 225],
        "dodgerblue" => [30, 144, 255],
        "steelblue" => [70, 130, 180],
        "red" => [255, 0, 0],
        "darkred" => [139, 0, 0],
        "crimson" => [220, 20, 60],
        "firebrick" => [178, 34, 34],
        "maroon" => [128, 0, 0],
        "orangered" => [255, 69, 0],
        _ => return Err(bad()),
    }))
}

/// Reads numbers as SVG writes them: separated by spaces, commas, or just a sign or second point.
struct Numbers<'a> {
    text: &'a [u8],
    at: usize,
}

impl Numbers<'_> {
    fn skip(&mut self) {
        while self.at < self.text.len() && (self.text[self.at].is_ascii_whitespace() || self.text[self.at] == b',') {
            self.at += 1;
        }
    }

    /// The next command letter, if there is one.
    fn letter(&mut self) -> Option<u8> {
        self.skip();
        let c = *self.text.get(self.at)?;
        c.is_ascii_alphabetic().then(|| {
            self.at += 1;
            c
        })
    }

    fn done(&mut self) -> bool {
        self.skip();
        self.at >= self.text.len()
    }

    fn number(&mut self) -> Result<f64, String> {
        self.skip();
        let start = self.at;
        let byte = |at: usize| self.text.get(at).copied().unwrap_or(0);
        let mut at = start;
        if matches!(byte(at), b'+' | b'-') {
            at += 1;
        }
        let mut point = false;
        while byte(at).is_ascii_digit() || (byte(at) == b'.' && !point) {
            point |= byte(at) == b'.';
            at += 1;
        }
        if matches!(byte(at), b'e' | b'E') {
            let sign = usize::from(matches!(byte(at + 1), b'+' | b'-'));
            if byte(at + 1 + sign).is_ascii_digit() {
                at += 1 + sign;
                while byte(at).is_ascii_digit() {
                    at += 1;
                }
            }
        }
        self.at = at;
        let text = std::str::from_utf8(&self.text[start..at]).unwrap_or("");
        let value = text.parse::<f64>().ok().filter(|x| x.is_finite());
        value.ok_or_else(|| format!("expected a number at character {} of the list", start + 1))
    }

    /// A flag of an arc: one digit, which may touch the next number.
    fn flag(&mut self) -> Result<bool, String> {
        self.skip();
        let c = self.text.get(self.at).copied();
        self.at += 1;
        match c {
            Some(b'0') => Ok(false),
            Some(b'1') => Ok(true),
            _ => Err(format!("expected 0 or 1 at character {} of the path", self.at)),
        }
    }
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let mut reader = Numbers { text: text.as_bytes(), at: 0 };
    let mut values = vec![];
    while !reader.done() {
        values.push(reader.number()?);
    }
    Ok(values)
}

fn transform(text: &str) -> Result<Affine, String> {
    let mut map = Affine::IDENTITY;
    let mut rest = text.trim();
    while !rest.is_empty() {
        let bad = || format!("transform {text:?} is not understood");
        let (name, after) = rest.split_once('(').ok_or_else(bad)?;
        let (list, after) = after.split_once(')').ok_or_else(bad)?;
        let v = numbers(list)?;
        let shift = |x: f64, y: f64| Affine([1.0, 0.0, 0.0, 1.0, x, y]);
        let step = match (name.trim(), &v[..]) {
            ("matrix", &[a, b, c, d, e, f]) => Affine([a, b, c, d, e, f]),
            ("translate", &[x]) => shift(x, 0.0),
            ("translate", &[x, y]) => shift(x, y),
            ("scale", &[s]) => Affine([s, 0.0, 0.0, s, 0.0, 0.0]),
            ("scale", &[x, y]) => Affine([x, 0.0, 0.0, y, 0.0, 0.0]),
            ("rotate", &[angle]) => rotation(angle),
            ("rotate", &[angle, x, y]) => shift(x, y).after(&rotation(angle)).after(&shift(-x, -y)),
            ("skewX", &[angle]) => Affine([1.0, 0.0, angle.to_radians().tan(), 1.0, 0.0, 0.0]),
            ("skewY", &[angle]) => Affine([1.0, angle.to_radians().tan(), 0.0, 1.0, 0.0, 0.0]),
            _ => return Err(bad()),
        };
        map = map.after(&step);
        rest = after.trim_start_matches([',', ' ', '\t', '\n', '\r']);
    }
    Ok(map)
}

fn rotation(angle_deg: f64) -> Affine {
    let (s, c) = angle_deg.to_radians().sin_cos();
    Affine([c, s, -s, c, 0.0, 0.0])
}

/// A path's subpaths as polylines.
fn path(text: &str) -> Result<Vec<Vec<[f64; 2]>>, String> {
    let mut reader = Numbers { text: text.as_bytes(), at: 0 };
    let mut lines: Vec<Vec<[f64; 2]>> = vec![];
    let (mut at, mut start) = ([0.0f64; 2], [0.0f64; 2]);
    // Last control point, for the smooth commands; which curve it belongs to.
    let mut control: Option<(u8, [f64; 2])> = None;
    let mut command = 0;
    let mut closed = false;
    while !reader.done() {
        let implicit = match reader.letter() {
            Some(letter) => {
                command = letter;
                false
            }
            None => true,
        };
        let upper = command.to_ascii_uppercase();
        if command == 0 || (implicit && upper == b'Z') {
            return Err("a path has to begin with M, and Z takes no numbers".into());
        }
        if upper != b'M' && lines.is_empty() {
            return Err("a path has to begin with M".into());
        }
        let base = if command.is_ascii_lowercase() { at } else { [0.0; 2] };
        let point = |reader: &mut Numbers| -> Result<[f64; 2], String> {
            let x = reader.number()?;
            Ok([base[0] + x, base[1] + reader.number()?])
        };
        let mut following = None;
        let reflected = |kind: u8| match control {
            Some((k, c)) if k == kind => [2.0 * at[0] - c[0], 2.0 * at[1] - c[1]],
            _ => at,
        };
        let mut added: Vec<[f64; 2]> = vec![];
        match upper {
            b'M' => {
                let p = point(&mut reader)?;
                if implicit {
                    added.push(p);
                } else {
                    lines.push(vec![p]);
                    (at, start) = (p, p);
                }
            }
            b'L' => added.push(point(&mut reader)?),
            b'H' => added.push([base[0] + reader.number()?, at[1]]),
            b'V' => added.push([at[0], base[1] + reader.number()?]),
            b'C' | b'S' => {
                let c1 = if upper == b'C' { point(&mut reader)? } else { reflected(b'C') };
                let (c2, end) = (point(&mut reader)?, point(&mut reader)?);
                following = Some((b'C', c2));
                added.extend(cubic(at, c1, c2, end));
            }
            b'Q' | b'T' => {
                let c = if upper == b'Q' { point(&mut reader)? } else { reflected(b'Q') };
                let end = point(&mut reader)?;
                following = Some((b'Q', c));
                let third = |a: [f64; 2]| [0, 1].map(|k| a[k] + 2.0 / 3.0 * (c[k] - a[k]));
                added.extend(cubic(at, third(at), third(end), end));
            }
            b'A' => {
                let radii = [reader.number()?, reader.number()?];
                let angle = reader.number()?;
                let (large, sweep) = (reader.flag()?, reader.flag()?);
                let end = point(&mut reader)?;
                added.extend(arc(at, radii, angle, large, sweep, end));
            }
            b'Z' => {
                if distance(at, start) > 0.0 {
                    added.push(start);
                }
                at = start;
            }
            other => return Err(format!("path command {:?} is not known", char::from(other))),
        }
        if let Some(&last) = added.last() {
            if closed {
                // After Z a new subpath starts without M.
                lines.push(vec![at]);
            }
            lines.last_mut().expect("a path begins with M").extend(added);
            at = last;
        }
        control = following;
        closed = upper == b'Z';
        if upper == b'M' {
            // Further pairs are lines.
            command = if command == b'M' { b'L' } else { b'l' };
        }
    }
    Ok(lines)
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
