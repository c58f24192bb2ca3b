//! Paths along which singularities of opposite index meet, or leave over the border.

use super::conjugate_field::Singularity;
use super::topology::EdgeTopology;
use super::visit::Visit;
use crate::surface::SurfaceMesh;
use std::collections::BinaryHeap;

/// Share of an edge's length that it costs where the field is free to turn.
const FREE_COST: f64 = 0.05;

/// The quarter turns to add across edges (edge, quarter turns) so that the singularities that can reach each other or the border are gone.
///
/// Edges cost their length times (0.05 + mean `rigidity` of their triangles), so that cracks lie where the field can close them. Pairs are
/// chosen greedily, cheapest first, a way over the border counting twice. Singularities further than `reach` (by straight distance) from
/// each other, or from the border, are not connected. The way over the border leads through border vertices that `passes` holds for.
pub(super) fn paths(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    rigidity: &[f64],
    singularities: &[Singularity],
    reach: f64,
    passes: &dyn Fn(u32) -> bool,
) -> Vec<(u32, i32)> {
    if singularities.is_empty() {
        return vec![];
    }
    let (starts, around) = vertex_edges(edges, mesh.points.len());
    let cost: Vec<f64> = (0..edges.len())
        .map(|e| {
            let [a, b] = edges.vertices[e].map(|v| mesh.position(v));
            let [f, g] = edges.triangles[e];
            // A border edge joins border vertices: nothing has to run along it.
            if edges.is_border(e) {
                return f64::INFINITY;
            }
            (b - a).norm() * (FREE_COST + 0.5 * (rigidity[f as usize] + rigidity[g as usize]))
        })
        .collect();
    let trees: Vec<Tree> = singularities.iter().map(|s| Tree::grow(edges, &starts, &around, &cost, s.vertex)).collect();
    let near = |a: u32, b: u32| (mesh.position(a) - mesh.position(b)).norm() <= reach;
    // (cost, from, to): `to` is a singularity, or none for the border.
    let mut candidates: Vec<(f64, usize, Option<usize>, u32)> = vec![];
    for (i, s) in singularities.iter().enumerate() {
        for (j, other) in singularities.iter().enumerate().skip(i + 1) {
            if s.index * other.index < 0 && near(s.vertex, other.vertex) {
                candidates.push((trees[i].distance[other.vertex as usize], i, Some(j), other.vertex));
            }
        }
        let way_out = (0..mesh.points.len() as u32)
            .filter(|&v| edges.is_border_vertex(v) && near(s.vertex, v) && passes(v))
            .min_by(|&a, &b| trees[i].distance[a as usize].total_cmp(&trees[i].distance[b as usize]));
        if let Some(vertex) = way_out {
            candidates.push((2.0 * trees[i].distance[vertex as usize], i, None, vertex));
        }
    }
    candidates.retain(|c| c.0.is_finite());
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut charge: Vec<i32> = singularities.iter().map(|s| s.index).collect();
    let mut turns = vec![];
    for (_, i, j, end) in candidates {
        let amount = match j {
            Some(j) if charge[i] * charge[j] < 0 => charge[i].signum() * charge[i].abs().min(charge[j].abs()),
            Some(_) => 0,
            None => charge[i],
        };
        if amount == 0 {
            continue;
        }
        charge[i] -= amount;
        if let Some(j) = j {
            charge[j] += amount;
        }
        // Back from the end to the root: the charge moves from each edge's root side to the other.
        let mut vertex = end;
        while vertex != singularities[i].vertex {
            let edge = trees[i].parent[vertex as usize];
            let [a, b] = edges.vertices[edge as usize];
            // Quarter turns across the edge raise the index of its second vertex and lower that of its first.
            turns.push((edge, if b == vertex { amount } else { -amount }));
            vertex = if b == vertex { a } else { b };
        }
    }
    turns
}

/// Edges around each vertex: `around[starts[v]..starts[v + 1]]`.
fn vertex_edges(edges: &EdgeTopology, count: usize) -> (Vec<usize>, Vec<u32>) {
    let mut starts = vec![0; count + 1];
    for v in edges.vertices.iter().flatten() {
        starts[*v as usize + 1] += 1;
    }
    for v in 0..count {
        starts[v + 1] += starts[v];
    }
    let mut next = starts.clone();
    let mut around = vec![0; starts[count]];
    for (e, ends) in edges.vertices.iter().enumerate() {
        for &v in ends {
            around[next[v as usize]] = e as u32;
            next[v as usize] += 1;
        }
    }
    (starts, around)
}

/// Shortest paths from one vertex.
struct Tree {
    distance: Vec<f64>,
    parent: Vec<u32>,
}

impl Tree {
    fn grow(edges: &EdgeTopology, starts: &[usize], around: &[u32], cost: &[f64], root: u32) -> Self {
        let count = starts.len() - 1;
        let mut tree = Self { distance: vec![f64::INFINITY; count], parent: vec![u32::MAX; count] };
        tree.distance[root as usize] = 0.0;
        let mut queue = BinaryHeap::from([Visit { distance: 0.0, index: root }]);
        while let Some(Visit { distance, index: vertex }) = queue.pop() {
            // A path ends where it meets the border: a charge on the border is none.
            if distance > tree.distance[vertex as usize] || edges.is_border_vertex(vertex) {
                continue;
            }
            for &e in &around[starts[vertex as usize]..starts[vertex as usize + 1]] {
                let [a, b] = edges.vertices[e as usize];
                let other = if a == vertex { b } else { a };
                let through = distance + cost[e as usize];
                if through < tree.distance[other as usize] {
                    tree.distance[other as usize] = through;
                    tree.parent[other as usize] = e;
                    queue.push(Visit { distance: through, index: other });
                }
            }
        }
        tree
    }
}
