//! Where lines of sight meet a tessellated surface.

use super::tessellate::SurfaceMesh;
use nalgebra::Vector3;

/// One crossing of a line of sight with a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Triangle of the mesh.
    pub triangle: u32,
    /// Weights of its three vertices, sum 1.
    pub barycentric: [f64; 3],
    /// Surface parameters (u, v), interpolated in the triangle.
    pub parameters: [f64; 2],
    /// Depth along the view, growing away from the viewer, unit of the mesh.
    pub depth: f64,
    /// Whether the front of the surface (the side of S_u x S_v) faces the viewer there.
    pub front: bool,
}

/// Casts lines of sight of one orthographic view at one mesh; triangles are found through a grid of buckets.
#[derive(Clone, Debug)]
pub struct RayCaster<'a> {
    mesh: &'a SurfaceMesh,
    /// View coordinates (x, y, depth) of each vertex.
    projected: Vec<[f64; 3]>,
    low: [f64; 2],
    cell: f64,
    counts: [usize; 2],
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl<'a> RayCaster<'a> {
    /// Sorts the triangles of `mesh` for a view.
    ///
    /// - `axes`: canvas right, canvas up, and towards the viewer, orthonormal, in the frame of the mesh.
    pub fn new(mesh: &'a SurfaceMesh, axes: [Vector3<f64>; 3]) -> Self {
        let projected: Vec<[f64; 3]> = mesh
            .points
            .iter()
            .map(|p| {
                [p.position.coords.dot(&axes[0]), p.position.coords.dot(&axes[1]), -p.position.coords.dot(&axes[2])]
            })
            .collect();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &projected {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        // About two triangles a cell, at least one cell even where the mesh is a point.
        let size = [0, 1].map(|k| high[k] - low[k]);
        let per_side = (mesh.triangles.len() as f64 / 2.0).sqrt().max(1.0);
        let cell = (size[0].max(size[1]) / per_side).max(f64::MIN_POSITIVE);
        let counts = size.map(|s| (s / cell) as usize + 1);
        let range = |triangle: &[u32; 3]| {
            [0, 1].map(|k| {
                let values = triangle.map(|v| projected[v as usize][k]);
                let index = |x: f64| (((x - low[k]) / cell) as usize).min(counts[k] - 1);
                (index(values[0].min(values[1]).min(values[2])), index(values[0].max(values[1]).max(values[2])))
            })
        };
        let mut starts = vec![0u32; counts[0] * counts[1] + 1];
        for triangle in &mesh.triangles {
            let [(x0, x1), (y0, y1)] = range(triangle);
            for y in y0..=y1 {
                for x in x0..=x1 {
                    starts[y * counts[0] + x + 1] += 1;
                }
            }
        }
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let mut next = starts.clone();
        let mut triangles = vec![0; starts[starts.len() - 1] as usize];
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let [(x0, x1), (y0, y1)] = range(triangle);
            for y in y0..=y1 {
                for x in x0..=x1 {
                    let slot = &mut next[y * counts[0] + x];
                    triangles[*slot as usize] = t as u32;
                    *slot += 1;
                }
            }
        }
        Self { mesh, projected, low, cell, counts, starts, triangles }
    }

    /// All crossings of the line of sight through (x, y), nearest to the viewer first.
    ///
    /// A line through an edge or a vertex meets each sheet of the surface once. Triangles seen edge-on are not hit.
    pub fn hits(&self, x: f64, y: f64) -> Vec<RayHit> {
        let mut hits: Vec<RayHit> = vec![];
        // A line through the rim of the mesh must not be lost to rounding.
        let slack = 1e-9 * self.cell;
        let mut at = [0; 2];
        for (k, value) in [x, y].into_iter().enumerate() {
            let offset = (value - self.low[k]) / self.cell;
            if !(offset >= -1e-9 && offset <= self.counts[k] as f64 + 1e-9) {
                return hits;
            }
            at[k] = (offset.max(0.0) as usize).min(self.counts[k] - 1);
        }
        let bucket = at[1] * self.counts[0] + at[0];
        for &t in &self.triangles[self.starts[bucket] as usize..self.starts[bucket + 1] as usize] {
            let corners = self.mesh.triangles[t as usize];
            let [a, b, c] = corners.map(|v| self.projected[v as usize]);
            let doubled =
                |p: [f64; 2], q: [f64; 3], r: [f64; 3]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
            let area = doubled([a[0], a[1]], b, c);
            let longest = (b[0] - a[0]).hypot(b[1] - a[1]).max((c[0] - a[0]).hypot(c[1] - a[1]));
            if area.abs() <= slack * longest {
                continue;
            }
            let weights = [doubled([x, y], b, c), doubled([x, y], c, a), doubled([x, y], a, b)].map(|w| w / area);
            let tolerance = slack * longest / area.abs();
            if weights.iter().any(|&w| w < -tolerance) {
                continue;
            }
            let depth = weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2];
            let parameters =
                [0, 1].map(|k| (0..3).map(|i| weights[i] * self.mesh.parameters[corners[i] as usize][k]).sum::<f64>());
            hits.push(RayHit { triangle: t, barycentric: weights, parameters, depth, front: area > 0.0 });
        }
        hits.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.triangle.cmp(&b.triangle)));
        // Neighbouring triangles both report a line through their common edge.
        hits.dedup_by(|later, first| {
            let shared = self.mesh.triangles[later.triangle as usize]
                .iter()
                .any(|v| self.mesh.triangles[first.triangle as usize].contains(v));
            shared && later.front == first.front && later.depth - first.depth <= 1e-6 * self.cell
        });
        hits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::NurbsSurface;
    use nalgebra::Point3;

    /// Half a cylinder shell over x in [-2, 2], seen from above: one sheet; from the side: two.
    fn arch() -> SurfaceMesh {
        let net = (0..16 * 6)
            .map(|k| {
                let (s, t) = ((k / 6) as f64 / 15.0, (k % 6) as f64 / 5.0);
                let angle = std::f64::consts::PI * s;
                Point3::new(-2.0 * angle.cos(), 5.0 * t, 2.0 * angle.sin())
            })
            .collect();
        SurfaceMesh::new(&NurbsSurface::uniform(3, [16, 6], net).unwrap(), [60, 20]).unwrap()
    }

    #[test]
    fn hits_lie_on_the_line_and_come_sorted() {
        let mesh = arch();
        let axes = [Vector3::y(), Vector3::z(), Vector3::x()];
        let caster = RayCaster::new(&mesh, axes);
        for (x, y) in [(2.5, 1.0), (0.013, 0.4), (4.9, 1.7), (2.5, 0.0)] {
            let hits = caster.hits(x, y);
            assert_eq!(hits.len(), 2, "at {x}, {y}");
            assert!(hits[0].depth < hits[1].depth);
            assert_ne!(hits[0].front, hits[1].front);
            for hit in hits {
                let corners = mesh.triangles[hit.triangle as usize];
                let p: Vector3<f64> = (0..3).map(|i| mesh.position(corners[i]).coords * hit.barycentric[i]).sum();
                assert!((p.dot(&axes[0]) - x).abs() < 1e-12 && (p.dot(&axes[1]) - y).abs() < 1e-12);
                assert!((p.dot(&axes[2]) + hit.depth).abs() < 1e-12);
                let normal = mesh.triangle_normal_area(hit.triangle as usize).0;
                assert_eq!(hit.front, normal.dot(&axes[2]) > 0.0);
            }
        }
        assert!(
            caster.hits(2.5, 2.5).is_empty()
                && caster.hits(-0.1, 1.0).is_empty()
                && caster.hits(f64::NAN, 0.0).is_empty()
        );
    }

    #[test]
    fn every_vertex_of_a_single_sheet_is_hit_once() {
        let mesh = arch();
        let caster = RayCaster::new(&mesh, [Vector3::x(), Vector3::y(), Vector3::z()]);
        for point in &mesh.points {
            let hits = caster.hits(point.position.x, point.position.y);
            // The two straight edges on the ground are seen edge-on.
            assert!(hits.len() == 1 || point.position.z < 1e-6, "{} at {:?}", hits.len(), point.position);
        }
    }
}
