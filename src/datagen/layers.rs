//! The layers of a projected surface: first and second surface point along the view ray of each pixel.

use super::{Reason, Rejection};
use nalgebra::Point3;

/// Half side of the square that the canvas covers in the canonical frame.
pub(super) const HALF: f64 = 4.0 * 256.0 / 232.0;

/// A surface point seen through a pixel's centre.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Camera z, canonical unit.
    pub z: f64,
    /// Parameters.
    pub uv: [f64; 2],
    /// Whether the side of S_u x S_v faces the viewer.
    pub front: bool,
}

/// Hits of an n x n raster over the canvas, nearest first.
pub(super) struct Layers {
    /// Pixels in each direction.
    pub n: usize,
    /// First and second layer, row by row from the top.
    pub hits: Vec<[Option<Hit>; 2]>,
    /// Pixels with more than two layers.
    pub overfull: usize,
}

/// Centre of pixel (row, column) of an n x n map, canonical x and y.
pub(super) fn pixel_center(n: usize, row: usize, column: usize) -> [f64; 2] {
    let size = 2.0 * HALF / n as f64;
    [-HALF + (column as f64 + 0.5) * size, HALF - (row as f64 + 0.5) * size]
}

/// Pixel that holds a canonical point; `None` outside the canvas.
pub(super) fn pixel_of(n: usize, p: [f64; 2]) -> Option<usize> {
    let size = 2.0 * HALF / n as f64;
    let (column, row) = (((p[0] + HALF) / size).floor(), ((HALF - p[1]) / size).floor());
    let inside = |x: f64| x >= 0.0 && x < n as f64;
    (inside(column) && inside(row)).then(|| row as usize * n + column as usize)
}

impl Layers {
    /// Intersects the view rays of all pixel centres with a triangulated surface.
    ///
    /// `grid`: (m + 1)^2 points of the surface at regular parameters, v running fastest, canonical frame.
    pub fn new(grid: &[Point3<f64>], n: usize) -> Self {
        let mut layers = Self { n, hits: vec![[None; 2]; n * n], overfull: 0 };
        let mut count = vec![0u8; n * n];
        let size = 2.0 * HALF / n as f64;
        let m = grid.len().isqrt().max(2) - 1;
        let cells = m as f64;
        // Pixel coordinates of every vertex, pixel centres at integers.
        let screen: Vec<[f64; 2]> =
            grid.iter().map(|p| [(p.x + HALF) / size - 0.5, (HALF - p.y) / size - 0.5]).collect();
        // First and last column and row of pixel centres beyond each vertex: most small triangles hold none, and end there.
        let beyond = |x: f64| [x.ceil().max(0.0) as i32, x.floor().min(n as f64 - 1.0) as i32];
        let spans: Vec<[[i32; 2]; 2]> = screen.iter().map(|p| p.map(beyond)).collect();
        for i in 0..m {
            for j in 0..m {
                for corners in [[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]] {
                    let index = corners.map(|(a, b)| (i + a) * (m + 1) + j + b);
                    let [columns, rows] = [0, 1].map(|axis| {
                        let [a, b, c] = index.map(|k| spans[k][axis]);
                        a[0].min(b[0]).min(c[0])..=a[1].max(b[1]).max(c[1])
                    });
                    if columns.is_empty() || rows.is_empty() {
                        continue;
                    }
                    let [a, b, c] = index.map(|k| screen[k]);
                    // Screen y points down, so that a triangle that faces the viewer has negative area here.
                    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
                    if area == 0.0 {
                        continue;
                    }
                    for row in rows {
                        for column in columns.clone() {
                            let p = [f64::from(column), f64::from(row)];
                            let cross = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
                                (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
                            };
                            let parts = [cross(b, c, p), cross(c, a, p), cross(a, b, p)];
                            if parts.iter().any(|&part| if area > 0.0 { part < 0.0 } else { part > 0.0 }) {
                                continue;
                            }
                            let weight = parts.map(|part| part / area);
                            let mix = |f: &dyn Fn(usize) -> f64| (0..3).map(|k| weight[k] * f(k)).sum::<f64>();
                            let hit = Hit {
                                z: mix(&|k| grid[index[k]].z),
                                uv: [
                                    mix(&|k| (i + corners[k].0) as f64) / cells,
                                    mix(&|k| (j + corners[k].1) as f64) / cells,
                                ],
                                front: area < 0.0,
                            };
                            layers.insert(row as usize * n + column as usize, hit, &mut count);
                        }
                    }
                }
            }
        }
        layers.overfull = count.iter().filter(|&&c| c > 2).count();
        layers
    }

    fn insert(&mut self, pixel: usize, hit: Hit, count: &mut [u8]) {
        let slots = &mut self.hits[pixel];
        // A centre on the common edge of two triangles is hit twice.
        if slots.iter().flatten().any(|other| (other.z - hit.z).abs() < 1e-9) {
            return;
        }
        count[pixel] = count[pixel].saturating_add(1);
        match slots {
            [None, _] => slots[0] = Some(hit),
            [Some(first), second] if hit.z > first.z => {
                *second = Some(*first);
                *first = hit;
            }
            [Some(_), second] => {
                if second.is_none_or(|s| hit.z > s.z) {
                    *second = Some(hit);
                }
            }
        }
    }

    /// Number of pixels in which the visible side faces (front, back), and that have a second layer.
    pub fn areas(&self) -> [usize; 3] {
        let mut areas = [0; 3];
        for [first, second] in &self.hits {
            if let Some(hit) = first {
                areas[usize::from(!hit.front)] += 1;
            }
            areas[2] += usize::from(second.is_some());
        }
        areas
    }

    /// Checks that the covered pixels form a disk: one piece, no hole.
    ///
    /// # Errors
    /// [`Reason::NotADisk`].
    pub fn check_disk(&self) -> Result<(), Rejection> {
        let n = self.n;
        let filled: Vec<bool> = self.hits.iter().map(|h| h[0].is_some()).collect();
        let mut seen = vec![false; n * n];
        let mut pieces = [0; 2];
        let mut stack = vec![];
        for start in 0..n * n {
            if seen[start] {
                continue;
            }
            let inside = filled[start];
            let mut area = 0;
            seen[start] = true;
            stack.push(start);
            while let Some(k) = stack.pop() {
                area += 1;
                let (row, column) = (k / n, k % n);
                let mut visit = |k: usize| {
                    if !seen[k] && filled[k] == inside {
                        seen[k] = true;
                        stack.push(k);
                    }
                };
                if row > 0 {
                    visit(k - n);
                }
                if row + 1 < n {
                    visit(k + n);
                }
                if column > 0 {
                    visit(k - 1);
                }
                if column + 1 < n {
                    visit(k + 1);
                }
            }
            // Single pixels at thin tips are matters of sampling.
            if area > 6 {
                pieces[usize::from(inside)] += 1;
            }
        }
        if pieces == [1, 1] { Ok(()) } else { Err(Rejection(Reason::NotADisk)) }
    }
}
