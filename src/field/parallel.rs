//! Directions beside a line that run parallel to it.

use super::smooth::DirectionConstraint;
use super::topology::{EdgeTopology, TriangleFrames};
use super::visit::Visit;
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;
use std::collections::BinaryHeap;

/// Weight of a constraint whose parallels have half their strength; hard ones have all of it.
const HALF_WEIGHT: f64 = 30.0;

/// A direction that a triangle without a constraint takes over from the nearest one that has one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Parallel {
    /// The triangle.
    pub triangle: usize,
    /// The direction's angle in the triangle's frame.
    pub angle: f64,
    /// In (0, 1): falls to 0 linearly with the distance, and is less beside weak constraints.
    pub strength: f64,
}

/// The directions of `constraints`, carried without turning to the triangles closer than `reach` (by the way over the triangles' middles), in
/// the triangles' order.
///
/// Constraints that count for nothing have no parallels.
pub(super) fn parallels(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    frames: &TriangleFrames,
    constraints: &[DirectionConstraint],
    reach: f64,
) -> Vec<Parallel> {
    let count = mesh.triangles.len();
    let middle = |t: usize| mesh.triangles[t].map(|v| mesh.position(v).coords).iter().sum::<Vector3<f64>>() / 3.0;
    let mut distance = vec![f64::INFINITY; count];
    let mut carried = vec![(0.0, 0.0); count];
    let mut queue = BinaryHeap::new();
    for c in constraints.iter().filter(|c| c.weight > 0.0) {
        let t = c.triangle as usize;
        let tangent = frames.components(t, &c.direction);
        let strength = if c.weight.is_finite() { c.weight / (c.weight + HALF_WEIGHT) } else { 1.0 };
        // Of several constraints on one triangle the strongest.
        if tangent.norm() > 0.0 && strength > carried[t].1 {
            carried[t] = (tangent.y.atan2(tangent.x), strength);
            distance[t] = 0.0;
            queue.push(Visit { distance: 0.0, index: t as u32 });
        }
    }
    while let Some(Visit { distance: so_far, index }) = queue.pop() {
        let t = index as usize;
        if so_far > distance[t] {
            continue;
        }
        for e in edges.triangle_edges[t].map(|e| e as usize) {
            if edges.is_border(e) {
                continue;
            }
            let [f, g] = edges.triangles[e].map(|t| t as usize);
            let (other, turn) = if f == t { (g, frames.turns[e]) } else { (f, -frames.turns[e]) };
            let further = so_far + (middle(t) - middle(other)).norm();
            if further < reach && further < distance[other] {
                distance[other] = further;
                carried[other] = (carried[t].0 + turn, carried[t].1);
                queue.push(Visit { distance: further, index: other as u32 });
            }
        }
    }
    (0..count)
        .filter(|&t| distance[t] > 0.0 && distance[t] < reach)
        .map(|t| Parallel { triangle: t, angle: carried[t].0, strength: carried[t].1 * (1.0 - distance[t] / reach) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::test_surfaces::*;

    #[test]
    fn on_a_plane_parallels_have_the_lines_direction_and_fade_with_the_distance() {
        let mesh = SurfaceMesh::new(&graph(|_, _| 0.0), [20, 20]).unwrap();
        let edges = EdgeTopology::new(mesh.points.len(), &mesh.triangles).unwrap();
        let frames = TriangleFrames::new(&mesh, &edges).unwrap();
        let direction = Vector3::new(2.0, 1.0, 0.0);
        let at = |weight: f64| DirectionConstraint { triangle: 2 * (10 * 20 + 10), direction, weight };
        let middle = |t: usize| mesh.triangles[t].map(|v| mesh.position(v).coords).iter().sum::<Vector3<f64>>() / 3.0;
        let hard = parallels(&mesh, &edges, &frames, &[at(f64::INFINITY)], 0.5);
        let (radius, from) = (0.5, middle(420));
        assert!(hard.len() > 40 && hard.iter().all(|p| p.triangle != 420 && p.strength > 0.0 && p.strength < 1.0));
        for p in &hard {
            let along = frames.direction(p.triangle, p.angle);
            assert!(along.dot(&direction.normalize()) > 1.0 - 1e-9);
            // The way over the triangles is no shorter than the straight one.
            assert!(p.strength <= 1.0 - (middle(p.triangle) - from).norm() / radius + 1e-9);
        }
        let half = parallels(&mesh, &edges, &frames, &[at(HALF_WEIGHT)], 0.5);
        assert!(half.iter().zip(&hard).all(|(a, b)| (a.strength - 0.5 * b.strength).abs() < 1e-12));
        assert!(parallels(&mesh, &edges, &frames, &[at(0.0)], 0.5).is_empty());
        assert!(parallels(&mesh, &edges, &frames, &[at(1.0)], 0.0).is_empty());
    }
}
