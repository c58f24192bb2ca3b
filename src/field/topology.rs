//! Edges of a triangle mesh, and the flat frames that its triangles carry.

use crate::error::Error;
use crate::surface::SurfaceMesh;
use nalgebra::{Vector2, Vector3};

/// Stands for the missing second triangle of a border edge.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Edges of an oriented triangle mesh with border: who bounds whom.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeTopology {
    /// Two end vertices of each edge, in the order in which the edge's first triangle runs through them (its left side).
    pub vertices: Vec<[u32; 2]>,
    /// The triangle to the left and to the right of each edge; the second is [`NO_TRIANGLE`] on the border.
    pub triangles: Vec<[u32; 2]>,
    /// Three edges of each triangle: edge k joins the triangle's corners k and (k + 1) mod 3.
    pub triangle_edges: Vec<[u32; 3]>,
    /// For each vertex, its triangles counter-clockwise; all of them around an inner vertex, from border to border otherwise.
    fans: Vec<u32>,
    fan_starts: Vec<u32>,
    on_border: Vec<bool>,
}

impl EdgeTopology {
    /// Collects the edges of `triangles`, numbered in the order of their first appearance.
    ///
    /// # Errors
    /// [`Error::VertexOutOfRange`], or [`Error::Degenerate`] if the mesh is not an oriented manifold: an edge with more than two
    /// triangles or two of equal orientation, or a vertex whose triangles form more than one fan.
    pub fn new(vertex_count: usize, triangles: &[[u32; 3]]) -> Result<Self, Error> {
        let fail = |reason: String| Err(Error::Degenerate { reason });
        for (face, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= vertex_count) {
                return Err(Error::VertexOutOfRange { face, vertex, count: vertex_count });
            }
        }
        // Half-edges sorted by (smaller, larger) vertex bring the two sides of an edge together.
        let mut half_edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * triangles.len());
        for (t, corners) in triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                half_edges.push((a.min(b), a.max(b), (3 * t + k) as u32));
            }
        }
        half_edges.sort_unstable();
        let mut twin = vec![u32::MAX; half_edges.len()];
        let mut i = 0;
        while i < half_edges.len() {
            let (a, b, first) = half_edges[i];
            let count = half_edges[i..].iter().take_while(|h| (h.0, h.1) == (a, b)).count();
            if a == b || count > 2 {
                return fail(format!("the edge between vertices {a} and {b} has {count} triangles"));
            }
            if count == 2 {
                let second = half_edges[i + 1].2;
                let origin = |h: u32| triangles[h as usize / 3][h as usize % 3];
                if origin(first) == origin(second) {
                    return fail(format!("triangles {} and {} have opposite orientations", first / 3, second / 3));
                }
                twin[first as usize] = second;
                twin[second as usize] = first;
            }
            i += count;
        }
        let mut edges = Self {
            vertices: vec![],
            triangles: vec![],
            triangle_edges: vec![[u32::MAX; 3]; triangles.len()],
            fans: Vec::with_capacity(half_edges.len()),
            fan_starts: vec![0],
            on_border: vec![false; vertex_count],
        };
        for (h, &other) in twin.iter().enumerate() {
            if (other as usize) < h {
                continue;
            }
            let (t, k) = (h / 3, h % 3);
            let ends = [triangles[t][k], triangles[t][(k + 1) % 3]];
            edges.triangle_edges[t][k] = edges.vertices.len() as u32;
            if other == u32::MAX {
                ends.iter().for_each(|&v| edges.on_border[v as usize] = true);
                edges.triangles.push([t as u32, NO_TRIANGLE]);
            } else {
                edges.triangle_edges[other as usize / 3][other as usize % 3] = edges.vertices.len() as u32;
                edges.triangles.push([t as u32, other / 3]);
            }
            edges.vertices.push(ends);
        }
        edges.collect_fans(vertex_count, triangles, &twin)?;
        Ok(edges)
    }

    fn collect_fans(&mut self, vertex_count: usize, triangles: &[[u32; 3]], twin: &[u32]) -> Result<(), Error> {
        let mut outgoing = vec![u32::MAX; vertex_count];
        let mut degree = vec![0u32; vertex_count];
        for (t, corners) in triangles.iter().enumerate() {
            for (k, &v) in corners.iter().enumerate() {
                let h = (3 * t + k) as u32;
                degree[v as usize] += 1;
                // A fan with border starts at the border half-edge that leaves the vertex.
                if outgoing[v as usize] == u32::MAX || twin[h as usize] == u32::MAX {
                    outgoing[v as usize] = h;
                }
            }
        }
        for v in 0..vertex_count {
            let start = outgoing[v];
            let mut h = start;
            let mut count = 0;
            while h != u32::MAX && count < degree[v] {
                self.fans.push(h / 3);
                count += 1;
                let previous = h / 3 * 3 + (h + 2) % 3;
                h = twin[previous as usize];
                if h == start {
                    break;
                }
            }
            if count != degree[v] {
                return Err(Error::Degenerate { reason: format!("the triangles of vertex {v} form several fans") });
            }
            self.fan_starts.push(self.fans.len() as u32);
        }
        Ok(())
    }

    /// Number of edges.
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Whether there is no edge.
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// Whether an edge has one triangle only.
    pub fn is_border(&self, edge: usize) -> bool {
        self.triangles[edge][1] == NO_TRIANGLE
    }

    /// Whether a vertex lies on the border.
    pub fn is_border_vertex(&self, vertex: u32) -> bool {
        self.on_border[vertex as usize]
    }

    /// Triangles around a vertex, counter-clockwise; the whole circle for an inner vertex, from border to border otherwise.
    pub fn fan(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.fans[self.fan_starts[v] as usize..self.fan_starts[v + 1] as usize]
    }

    /// The triangle on the other side of edge `k` (0 to 2) of `triangle`.
    pub fn neighbour(&self, triangle: u32, k: usize) -> Option<u32> {
        let [f, g] = self.triangles[self.triangle_edges[triangle as usize][k] as usize];
        let other = if f == triangle { g } else { f };
        (other != NO_TRIANGLE).then_some(other)
    }

    /// The edge between two triangles, if they share one.
    pub fn between(&self, a: u32, b: u32) -> Option<u32> {
        self.triangle_edges[a as usize].into_iter().find(|&e| {
            let [f, g] = self.triangles[e as usize];
            (f, g) == (a, b) || (f, g) == (b, a)
        })
    }
}

/// An orthonormal frame in the plane of each triangle, and the rotations that carry one frame to the next.
///
/// Angles of tangent directions are measured from `x` towards `y`, radians.
#[derive(Clone, Debug)]
pub struct TriangleFrames {
    /// Along the triangle's first edge, unit.
    pub x: Vec<Vector3<f64>>,
    /// normal x `x`
    pub y: Vec<Vector3<f64>>,
    /// Unit normals, counter-clockwise side.
    pub normals: Vec<Vector3<f64>>,
    /// Areas.
    pub areas: Vec<f64>,
    /// For each edge (f, g): the angle in g's frame is the angle in f's frame plus this, when f is unfolded into the
    /// plane of g; 0 on the border.
    pub turns: Vec<f64>,
}

impl TriangleFrames {
    /// The frames of `mesh`, whose edges are `edges`.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if the mesh has no area. Single triangles without area (at a collapsed side) are given the
    /// mean of their vertices' normals.
    pub fn new(mesh: &SurfaceMesh, edges: &EdgeTopology) -> Result<Self, Error> {
        let count = mesh.triangles.len();
        let mut frames = Self {
            x: Vec::with_capacity(count),
            y: Vec::with_capacity(count),
            normals: Vec::with_capacity(count),
            areas: Vec::with_capacity(count),
            turns: vec![0.0; edges.len()],
        };
        for t in 0..count {
            let corners = mesh.triangles[t].map(|v| mesh.position(v));
            let sides = [0, 1, 2].map(|k| corners[(k + 1) % 3] - corners[k]);
            let (mut normal, area) = mesh.triangle_normal_area(t);
            let longest = sides.iter().map(|s| s.norm_squared()).fold(0.0, f64::max);
            if area <= 1e-12 * longest {
                normal = mesh.triangles[t].iter().map(|&v| mesh.normals[v as usize]).sum::<Vector3<f64>>();
                normal = normal.try_normalize(1e-300).unwrap_or_else(Vector3::z);
            }
            let along = sides.iter().map(|s| s - normal * normal.dot(s)).find_map(|s| s.try_normalize(1e-300));
            let x = along.unwrap_or_else(|| any_perpendicular(&normal));
            frames.x.push(x);
            frames.y.push(normal.cross(&x));
            frames.normals.push(normal);
            frames.areas.push(area);
        }
        let total: f64 = frames.areas.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return Err(Error::Degenerate { reason: "the surface has no area".into() });
        }
        for e in 0..edges.len() {
            if !edges.is_border(e) {
                let [f, g] = edges.triangles[e].map(|t| t as usize);
                let [a, b] = edges.vertices[e].map(|v| mesh.position(v));
                let side = b - a;
                frames.turns[e] = wrap(frames.angle(g, &side) - frames.angle(f, &side), std::f64::consts::TAU);
            }
        }
        Ok(frames)
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Angle of the tangential part of `direction` in the frame of `triangle`; 0 for a direction along the normal.
    pub fn angle(&self, triangle: usize, direction: &Vector3<f64>) -> f64 {
        self.y[triangle].dot(direction).atan2(self.x[triangle].dot(direction))
    }

    /// Components of the tangential part of `direction`.
    pub fn components(&self, triangle: usize, direction: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(self.x[triangle].dot(direction), self.y[triangle].dot(direction))
    }

    /// The unit tangent vector at `angle`.
    pub fn direction(&self, triangle: usize, angle: f64) -> Vector3<f64> {
        let (sin, cos) = angle.sin_cos();
        self.x[triangle] * cos + self.y[triangle] * sin
    }
}

/// `angle` moved by a multiple of `period` into (-period / 2, period / 2].
pub(crate) fn wrap(angle: f64, period: f64) -> f64 {
    // Adding and taking away this rounds to an integer without a call, halves either way: both ends of the interval are one.
    const ROUND: f64 = 1.5 * (1u64 << 52) as f64;
    let turned = angle - period * ((angle / period + ROUND) - ROUND);
    if turned <= -0.5 * period { turned + period } else { turned }
}

fn any_perpendicular(normal: &Vector3<f64>) -> Vector3<f64> {
    let axis = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    (axis - normal * normal.dot(&axis)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_of_triangles_obeys_eulers_formula() {
        let mut triangles = vec![];
        let n = 4u32;
        for i in 0..n {
            for j in 0..n {
                let a = i * (n + 1) + j;
                let (b, c, d) = (a + n + 1, a + n + 2, a + 1);
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        let vertices = ((n + 1) * (n + 1)) as usize;
        let edges = EdgeTopology::new(vertices, &triangles).unwrap();
        assert_eq!(vertices as i64 - edges.len() as i64 + triangles.len() as i64, 1);
        assert_eq!((0..edges.len()).filter(|&e| edges.is_border(e)).count(), 4 * n as usize);
        let center = 2 * (n + 1) + 2;
        assert!(!edges.is_border_vertex(center));
        let fan = edges.fan(center);
        assert_eq!(fan.len(), 6);
        for i in 0..6 {
            let e = edges.between(fan[i], fan[(i + 1) % 6]).unwrap() as usize;
            // Counter-clockwise: the shared edge leaves the centre on the left of the next triangle.
            let t = triangles[fan[(i + 1) % 6] as usize];
            let k = t.iter().position(|&v| v == center).unwrap();
            assert_eq!(edges.triangle_edges[fan[(i + 1) % 6] as usize][k] as usize, e);
        }
    }

    #[test]
    fn meshes_that_are_no_manifold_are_refused() {
        assert!(EdgeTopology::new(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).is_err());
        assert!(EdgeTopology::new(4, &[[0, 1, 2], [0, 1, 3]]).is_err());
        assert!(EdgeTopology::new(5, &[[0, 1, 2], [0, 3, 4]]).is_err());
        assert!(EdgeTopology::new(3, &[[0, 1, 3]]).is_err());
    }
}
