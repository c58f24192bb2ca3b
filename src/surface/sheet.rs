//! Both layers glued into one sheet: the graph of their pixels, joined by what the strokes say.

use super::border::{BorderCurves, LayerMaps};
use super::corners::BorderLoop;
use super::layer_map::LayerMap;
use crate::error::Error;
use crate::numeric::Cholesky;
use nalgebra::{Point3, Vector3};
use sprs::CsMat;

/// Least |z| of a unit normal in the metric: at a contour the slope is infinite, a pixel's is not.
const LEAST_FACING: f64 = 0.15;
/// Least distance, in pixels, of a pixel's centre from the line that ends its sheet.
const LEAST_DISTANCE: f64 = 0.1;
/// An arc over its chord, where the sheet turns around a fold.
const ARC: f64 = 1.1;
/// Least conductance between neighbours: where the slope changes much, the diagonals may take more than there was.
const LEAST_CONDUCTANCE: f64 = 0.02;

/// Where a stroke crosses the line between the centres of two neighbouring pixels.
struct Crossing {
    /// The line: pixel * 2, plus 1 if it runs to the row below rather than to the next column.
    link: usize,
    /// Share of the line before the crossing.
    at: f64,
    line: Line,
}

#[derive(Clone, Copy)]
enum Line {
    Border {
        parameters: [f64; 2],
        /// Depth of the border, -z.
        depth: f64,
        occluded: bool,
        /// Whether the line's first pixel lies on the side of the border on which its sheet does.
        within: bool,
    },
    /// With |cosine| of the angle between its normal and the line.
    Contour(f64),
}

/// The graph of all pixels of both layers.
///
/// Every pixel of a layer is a vertex. Neighbours are joined across the regions by what the strokes say: a visible border
/// ends the visible sheet and the occluded one comes to light beyond it, an occluded border ends the occluded sheet, and at
/// a contour the two layers of a pixel are joined to each other, through the air between them. Where the strip between a
/// contour and the border behind it is thinner than a pixel, the pixel before the contour is held by that border.
pub(super) struct Sheet<'a> {
    /// Visible layer, occluded layer.
    pub(super) maps: [&'a LayerMap; 2],
    /// For each layer the vertex of each pixel, or `NONE`.
    vertices: [Vec<u32>; 2],
    /// Number of vertices.
    pub(super) count: usize,
    /// Layer and pixel of each vertex.
    pub(super) places: Vec<(usize, usize)>,
    /// Conductances of each vertex in x, in y, and along the diagonal.
    conductances: Vec<[f64; 3]>,
    /// Two vertices and their conductance. Those of one pixel are joined at a contour.
    pub(super) links: Vec<(u32, u32, f64)>,
    /// Vertices held by a point of the rim, its parameters, and how strongly.
    pub(super) held: Vec<(u32, [f64; 2], f64)>,
    /// The two vertices joined at a contour, and the point between them.
    pub(super) turns: Vec<(u32, u32, Point3<f64>)>,
    /// The vertex before a contour, and the parameters of the border behind it; the share of the way at the contour; its point.
    pub(super) rolled: Vec<(u32, [f64; 2], f64, Point3<f64>)>,
}

const NONE: u32 = u32::MAX;

impl<'a> Sheet<'a> {
    /// - `contours`: contour strokes, polylines (x, y).
    pub(super) fn new(
        border: &BorderLoop,
        curves: &BorderCurves,
        contours: &[Vec<[f64; 2]>],
        maps: &'a LayerMaps,
    ) -> Self {
        let maps = [&maps.visible, &maps.occluded];
        let mut places = vec![];
        let vertices = [0, 1].map(|layer: usize| {
            let mut ids = vec![NONE; maps[layer].valid.len()];
            for pixel in (0..ids.len()).filter(|&pixel| maps[layer].valid[pixel]) {
                ids[pixel] = places.len() as u32;
                places.push((layer, pixel));
            }
            ids
        });
        let count = places.len();
        let conductances = places.iter().map(|&(layer, pixel)| conductance(&maps[layer].normal[pixel])).collect();
        let mut sheet = Self {
            maps,
            vertices,
            count,
            places,
            conductances,
            links: vec![],
            held: vec![],
            turns: vec![],
            rolled: vec![],
        };
        let crossings = crossings(maps[0], border, curves, contours);
        sheet.join(&crossings);
        sheet
    }

    /// The vertex of a pixel on a layer, if the layer is there.
    pub(super) fn vertex(&self, layer: usize, pixel: usize) -> Option<u32> {
        Some(self.vertices[layer][pixel]).filter(|&vertex| vertex != NONE)
    }

    fn exists(&self, layer: usize, pixel: usize) -> bool {
        self.maps[layer].valid[pixel]
    }

    fn layers(&self, pixel: usize) -> usize {
        usize::from(self.exists(0, pixel)) + usize::from(self.exists(1, pixel))
    }

    /// Where a vertex lies, canonical frame.
    pub(super) fn point(&self, vertex: u32) -> Point3<f64> {
        let (layer, pixel) = self.places[vertex as usize];
        let [x, y] = self.maps[layer].center(pixel);
        Point3::new(x, y, -self.maps[layer].depth[pixel])
    }

    fn conductance(&self, vertex: u32) -> [f64; 3] {
        self.conductances[vertex as usize]
    }

    fn join(&mut self, crossings: &[Crossing]) {
        let n = self.maps[0].size;
        let mut starts = vec![0; 2 * n * n + 1];
        crossings.iter().for_each(|crossing| starts[crossing.link + 1] += 1);
        for link in 0..2 * n * n {
            starts[link + 1] += starts[link];
        }
        let on = |link: usize| &crossings[starts[link]..starts[link + 1]];
        for pixel in 0..n * n {
            let (row, column) = (pixel / n, pixel % n);
            for down in [0, 1] {
                let other = if down == 0 { pixel + 1 } else { pixel + n };
                if (down == 0 && column + 1 == n) || (down == 1 && row + 1 == n) {
                    continue;
                }
                let between = on(2 * pixel + down);
                match (between.first(), between.last()) {
                    (Some(first), Some(last)) => {
                        let single = between.len() == 1;
                        self.end(pixel, other, down, first.at, first.line, true, single);
                        self.end(other, pixel, down, 1.0 - last.at, last.line, false, single);
                        if let [first, last] = between {
                            self.roll(pixel, other, down, [first.at, last.at], [first.line, last.line], true);
                            let at = [1.0 - last.at, 1.0 - first.at];
                            self.roll(other, pixel, down, at, [last.line, first.line], false);
                        }
                    }
                    _ => self.continue_freely(pixel, other, down),
                }
            }
            // Diagonals only where nothing is drawn around.
            if column + 1 < n && row + 1 < n {
                let (right, below, far) = (pixel + 1, pixel + n, pixel + n + 1);
                let free = [2 * pixel, 2 * pixel + 1, 2 * below, 2 * right + 1].iter().all(|&link| on(link).is_empty());
                for layer in 0..2 {
                    let same =
                        |a: usize| self.exists(layer, a) && self.maps[layer].front[a] == self.maps[layer].front[pixel];
                    if free && [pixel, right, below, far].into_iter().all(same) {
                        let [a, b, c, d] = [pixel, far, right, below].map(|k| self.vertices[layer][k]);
                        let falling = 0.5 * (self.conductance(a)[2] + self.conductance(b)[2]);
                        let rising = 0.5 * (self.conductance(c)[2] + self.conductance(d)[2]);
                        // In x, y the way from a pixel to the next one below on the right falls. What goes along a
                        // diagonal is taken from the sides of its cell.
                        for (ends, weight) in [([a, b], -falling), ([c, d], rising)] {
                            if weight > 0.0 {
                                self.links.push((ends[0], ends[1], weight));
                                for (p, q) in [(a, c), (a, d), (c, b), (d, b)] {
                                    self.links.push((p, q, -0.5 * weight));
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    fn link(&mut self, a: u32, b: u32, down: usize) {
        let weight = 0.5 * (self.conductance(a)[down] + self.conductance(b)[down]);
        self.links.push((a, b, weight));
    }

    /// No stroke between two pixels: sheets of one layer and orientation continue.
    fn continue_freely(&mut self, p: usize, q: usize, down: usize) {
        let mut taken = [false; 2];
        for layer in 0..2 {
            if !self.exists(layer, p) {
                continue;
            }
            let front = self.maps[layer].front[p];
            let fits = |other: usize| self.exists(other, q) && self.maps[other].front[q] == front && !taken[other];
            // Masks are decided by half a pixel: the other layer where they disagree.
            if let Some(other) = [layer, 1 - layer].into_iter().find(|&other| fits(other)) {
                taken[other] = true;
                self.link(self.vertices[layer][p], self.vertices[other][q], down);
            }
        }
    }

    /// A stroke lies `at` of the way from `p` to `q`.
    ///
    /// - `forward`: whether `p` is the first pixel of the link; it alone adds what continues.
    /// - `single`: whether this is the only stroke on the way.
    #[expect(clippy::too_many_arguments, reason = "one call site, each is a fact of the crossing")]
    fn end(&mut self, p: usize, q: usize, down: usize, at: f64, line: Line, forward: bool, single: bool) {
        let at = at.max(LEAST_DISTANCE);
        match line {
            Line::Contour(cosine) => {
                if self.layers(p) < 2 || (single && self.layers(q) == 2) {
                    return;
                }
                let pixel = self.maps[0].pixel();
                let [a, b] = [0, 1].map(|layer| self.vertices[layer][p]);
                let (above, below) = (self.point(a), self.point(b));
                let way = ARC * (above.z - below.z).hypot(2.0 * at * pixel);
                self.links.push((a, b, cosine * pixel / way));
                let mut between = nalgebra::center(&above, &below);
                let sign = if forward { at } else { -at };
                if down == 0 {
                    between.x += sign * pixel;
                } else {
                    between.y -= sign * pixel;
                }
                self.turns.push((a, b, between));
            }
            Line::Border { parameters, occluded, within, .. } => {
                let layer = usize::from(occluded);
                let owns = within == forward && self.exists(layer, p);
                if owns {
                    let vertex = self.vertices[layer][p];
                    let weight = self.conductance(vertex)[down] / at;
                    self.held.push((vertex, parameters, weight));
                }
                // The sheet that does not end here.
                let other = 1 - layer;
                if owns && single && self.exists(other, p) && self.exists(0, q) {
                    self.link(self.vertices[other][p], self.vertices[0][q], down);
                }
            }
        }
    }

    /// From `p` on a single sheet outwards come first a border, then a contour, both before the next pixel: around the contour the
    /// sheet rolls back to that border, in a strip too thin for the maps.
    ///
    /// - `at`: shares of the way to `q` at border and contour.
    /// - `forward`: whether `p` is the first pixel of the link.
    fn roll(&mut self, p: usize, q: usize, down: usize, at: [f64; 2], lines: [Line; 2], forward: bool) {
        let [Line::Border { parameters, depth, within, .. }, Line::Contour(cosine)] = lines else { return };
        let single = self.exists(0, p) && !self.exists(1, p);
        if within == forward || !single || self.layers(q) != 0 {
            return;
        }
        let vertex = self.vertices[0][p];
        let pixel = self.maps[0].pixel();
        let point = self.point(vertex);
        let there = at[1].max(LEAST_DISTANCE) / self.conductance(vertex)[down];
        let back = ARC * (point.z + depth).hypot((at[1] - at[0]) * pixel) / (cosine.max(LEAST_DISTANCE) * pixel);
        self.held.push((vertex, parameters, 1.0 / (there + back)));
        let mut turn = Point3::new(point.x, point.y, 0.5 * (point.z - depth));
        let step = if forward { at[1] } else { -at[1] } * pixel;
        if down == 0 {
            turn.x += step;
        } else {
            turn.y -= step;
        }
        self.rolled.push((vertex, parameters, there / (there + back), turn));
    }
}

/// Factor of the Laplacian of a graph, plus a diagonal.
///
/// - `links`: two vertices and a weight; those of the same two add up, to [`LEAST_CONDUCTANCE`] at least.
/// - `diagonal`: a positive number for each vertex.
/// - `what`: names the system in an error.
///
/// # Errors
/// [`Error::Singular`] if it cannot be factorized, which finite numbers do not cause.
pub(super) fn factor(links: &[(u32, u32, f64)], mut diagonal: Vec<f64>, what: &'static str) -> Result<Cholesky, Error> {
    let n = diagonal.len();
    let mut below = sorted(links, n);
    below.dedup_by(|later, first| {
        let same = (later.0, later.1) == (first.0, first.1);
        if same {
            first.2 += later.2;
        }
        same
    });
    for (a, b, weight) in &mut below {
        *weight = weight.max(LEAST_CONDUCTANCE);
        diagonal[*a as usize] += *weight;
        diagonal[*b as usize] += *weight;
    }
    let (mut starts, mut rows, mut values) = (vec![0], vec![], vec![]);
    let mut next = below.iter().peekable();
    for (k, &d) in diagonal.iter().enumerate() {
        rows.push(k);
        values.push(d);
        while let Some(&&(_, row, weight)) = next.peek().filter(|(column, ..)| *column as usize == k) {
            rows.push(row as usize);
            values.push(-weight);
            next.next();
        }
        starts.push(rows.len());
    }
    Cholesky::new(&CsMat::new_csc((n, n), starts, rows, values), what)
}

/// All links from their lower to their higher vertex, sorted.
fn sorted(links: &[(u32, u32, f64)], count: usize) -> Vec<(u32, u32, f64)> {
    let mut starts = vec![0; count + 1];
    let ordered = || links.iter().filter(|(a, b, _)| a != b).map(|&(a, b, w)| (a.min(b), a.max(b), w));
    ordered().for_each(|(a, ..)| starts[a as usize + 1] += 1);
    for vertex in 0..count {
        starts[vertex + 1] += starts[vertex];
    }
    let mut next = starts.clone();
    let mut sorted = vec![(0, 0, 0.0); starts[count]];
    for link in ordered() {
        let slot = &mut next[link.0 as usize];
        sorted[*slot] = link;
        *slot += 1;
    }
    for row in starts.windows(2) {
        sorted[row[0]..row[1]].sort_by_key(|&(_, b, _)| b);
    }
    sorted
}

/// Conductance of a sheet with this normal in x, in y, and along the diagonal: the tensor sqrt(det g) g^-1 of its metric
/// g, split into directions. The diagonal rises where the last is positive.
fn conductance(normal: &Vector3<f64>) -> [f64; 3] {
    let across = normal.x.hypot(normal.y);
    if across < 1e-6 {
        return [1.0, 1.0, 0.0];
    }
    let (ex, ey) = (normal.x / across, normal.y / across);
    let facing = normal.z.abs().max(LEAST_FACING);
    // Along the slope ways are longer by 1 / facing, across it the sheet is wider by as much.
    let (along, wide) = (facing, 1.0 / facing);
    let (xx, yy) = (along * ex * ex + wide * ey * ey, along * ey * ey + wide * ex * ex);
    let limit = 0.9 * xx.min(yy);
    let xy = ((along - wide) * ex * ey).clamp(-limit, limit);
    [xx, yy, xy]
}

/// All crossings of strokes with the lines between neighbouring pixels, sorted by line and place.
fn crossings(map: &LayerMap, border: &BorderLoop, curves: &BorderCurves, contours: &[Vec<[f64; 2]>]) -> Vec<Crossing> {
    let n = border.points.len();
    let mut result = vec![];
    for i in 0..n {
        let j = (i + 1) % n;
        let occluded = border.occluded[i];
        let [a, b] = [i, j].map(|k| map.to_pixels(border.points[k]));
        cross_segment(map.size, a, b, |link, at, t, down| {
            let parameters = [0, 1].map(|c| curves.parameters[i][c] * (1.0 - t) + curves.parameters[j][c] * t);
            // The pixel before the crossing is the left one, or the upper one; rows grow downwards.
            let left = if down == 0 { b[1] < a[1] } else { b[0] > a[0] };
            let depth = -(curves.points[i].z * (1.0 - t) + curves.points[j].z * t);
            let line = Line::Border { parameters, depth, occluded, within: left == border.front[i] };
            result.push(Crossing { link, at, line });
        });
    }
    for contour in contours {
        for pair in contour.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|p| map.to_pixels(p));
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            cross_segment(map.size, a, b, |link, at, _, down| {
                let cosine = if down == 0 { b[1] - a[1] } else { b[0] - a[0] };
                result.push(Crossing { link, at, line: Line::Contour((cosine / length).abs()) });
            });
        }
    }
    result.sort_by(|a, b| a.link.cmp(&b.link).then(a.at.total_cmp(&b.at)));
    result
}

/// Calls `found` with link, share of the link, share of the segment and direction for each grid line that the segment from
/// `a` to `b` crosses, in pixels: [column, row].
fn cross_segment(n: usize, a: [f64; 2], b: [f64; 2], mut found: impl FnMut(usize, f64, f64, usize)) {
    for down in 0..2 {
        // Lines to the right are met where the row is whole, lines downwards where the column is.
        let fixed = 1 - down;
        let (low, high) = (a[fixed].min(b[fixed]), a[fixed].max(b[fixed]));
        let mut whole = low.floor() + 1.0;
        while whole <= high {
            let t = (whole - a[fixed]) / (b[fixed] - a[fixed]);
            let along = a[down] + t * (b[down] - a[down]);
            let before = along.floor();
            let last = (n - 1) as f64;
            if (0.0..last).contains(&before) && (0.0..=last).contains(&whole) {
                let (row, column) = if down == 0 { (whole, before) } else { (before, whole) };
                found(2 * (row as usize * n + column as usize) + down, along - before, t, down);
            }
            whole += 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strokes_cross_grid_lines_where_they_do() {
        let mut found = vec![];
        cross_segment(64, [2.25, 3.5], [4.25, 5.5], |link, at, t, down| found.push((link, at, t, down)));
        let expected = [
            (2 * (4 * 64 + 2), 0.75, 0.25, 0),
            (2 * (5 * 64 + 3), 0.75, 0.75, 0),
            (2 * (4 * 64 + 3) + 1, 0.25, 0.375, 1),
            (2 * (5 * 64 + 4) + 1, 0.25, 0.875, 1),
        ];
        assert_eq!(found, expected);
    }
}
