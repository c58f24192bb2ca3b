//! Paths along which singularities of opposite index meet, or leave over the border.

use super::conjugate_field::Singularity;
use super::topology::EdgeTopology;
use super::visit::Visit;
use crate::surface::SurfaceMesh;
use std::collections::BinaryHeap;

/// Share of an edge's length that it costs where the field is free to turn.
const FREE_COST: f64 = 0.05;

/// Quarter turns to add across an edge: those raise the index of its second vertex and lower that of its first.
pub(super) type Turn = (u32, i32);

/// The turns so that the charges that can reach each other or leave over the border are gone, and the charges that are left.
///
/// Charges are singularities, and border vertices where the cross turns against the border otherwise than it should. Edges cost their length
/// times (0.05 + mean `rigidity` of their triangles), so that cracks lie where the field can close them. Pairs are chosen greedily, cheapest
/// first, a way over the border counting twice, among those vertices that `meet` holds for; the way over the border leads from a charge's vertex
/// through a border vertex if `leaves` holds for both.
pub(super) fn paths(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    rigidity: &[f64],
    singularities: &[Singularity],
    meet: &dyn Fn(u32, u32) -> bool,
    leaves: &dyn Fn(u32, u32) -> bool,
) -> (Vec<Turn>, Vec<Singularity>) {
    if singularities.is_empty() {
        return (vec![], vec![]);
    }
    let graph = Graph::new(mesh, edges, rigidity);
    let trees: Vec<Tree> = singularities.iter().map(|s| graph.grow(s.vertex)).collect();
    // (cost, from, to): `to` is a singularity, or none for the border.
    let mut candidates: Vec<(f64, usize, Option<usize>, u32)> = vec![];
    for (i, s) in singularities.iter().enumerate() {
        for (j, other) in singularities.iter().enumerate().skip(i + 1) {
            if s.index * other.index < 0 && meet(s.vertex, other.vertex) {
                candidates.push((trees[i].distance[other.vertex as usize], i, Some(j), other.vertex));
            }
        }
        let way_out = (0..mesh.points.len() as u32)
            .filter(|&v| edges.is_border_vertex(v) && leaves(s.vertex, v))
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
        trees[i].turn_along(edges, end, amount, &mut turns);
    }
    let left = singularities.iter().zip(charge).map(|(s, index)| Singularity { index, ..*s });
    (turns, left.filter(|s| s.index != 0).collect())
}

/// The turns that move charges of border vertices, one quarter after another, to inner vertices at least `depth` from the border and apart.
pub(super) fn inward(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    rigidity: &[f64],
    charges: &[Singularity],
    depth: f64,
) -> Vec<Turn> {
    let graph = Graph::new(mesh, edges, rigidity);
    let border: Vec<u32> = (0..mesh.points.len() as u32).filter(|&v| edges.is_border_vertex(v)).collect();
    let clearance = |v: u32, from: &[u32]| {
        from.iter().map(|&w| (mesh.position(v) - mesh.position(w)).norm()).fold(f64::INFINITY, f64::min)
    };
    let mut deep: Vec<u32> = (0..mesh.points.len() as u32).filter(|&v| !edges.is_border_vertex(v)).collect();
    // Where the patch is narrow its middle has to do.
    let depth = depth.min(0.8 * deep.iter().map(|&v| clearance(v, &border)).fold(0.0, f64::max));
    deep.retain(|&v| clearance(v, &border) >= depth);
    let mut taken: Vec<u32> = vec![];
    let mut turns = vec![];
    for charge in charges {
        let tree = graph.grow(charge.vertex);
        for _ in 0..charge.index.abs() {
            let free = deep.iter().copied().filter(|&v| clearance(v, &taken) >= depth);
            let nearest = free.min_by(|&a, &b| tree.distance[a as usize].total_cmp(&tree.distance[b as usize]));
            let Some(end) = nearest.filter(|&v| tree.distance[v as usize].is_finite()) else { continue };
            taken.push(end);
            tree.turn_along(edges, end, charge.index.signum(), &mut turns);
        }
    }
    turns
}

/// The edges of a mesh with what a crack along them costs.
struct Graph<'a> {
    edges: &'a EdgeTopology,
    cost: Vec<f64>,
    /// Edges around vertex v: `around[starts[v]..starts[v + 1]]`.
    starts: Vec<usize>,
    around: Vec<u32>,
}

impl<'a> Graph<'a> {
    fn new(mesh: &SurfaceMesh, edges: &'a EdgeTopology, rigidity: &[f64]) -> Self {
        let cost = |e: usize| {
            let [a, b] = edges.vertices[e].map(|v| mesh.position(v));
            let [f, g] = edges.triangles[e];
            // A border edge joins border vertices: nothing has to run along it.
            if edges.is_border(e) {
                return f64::INFINITY;
            }
            (b - a).norm() * (FREE_COST + 0.5 * (rigidity[f as usize] + rigidity[g as usize]))
        };
        let count = mesh.points.len();
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
        Self { edges, cost: (0..edges.len()).map(cost).collect(), starts, around }
    }

    /// Shortest paths from one vertex; none leads on from the border.
    fn grow(&self, root: u32) -> Tree {
        let count = self.starts.len() - 1;
        let mut tree = Tree { root, distance: vec![f64::INFINITY; count], parent: vec![u32::MAX; count] };
        tree.distance[root as usize] = 0.0;
        let mut queue = BinaryHeap::from([Visit { distance: 0.0, index: root }]);
        while let Some(Visit { distance, index: vertex }) = queue.pop() {
            let ends = vertex != root && self.edges.is_border_vertex(vertex);
            if ends || distance > tree.distance[vertex as usize] {
                continue;
            }
            for &e in &self.around[self.starts[vertex as usize]..self.starts[vertex as usize + 1]] {
                let [a, b] = self.edges.vertices[e as usize];
                let other = if a == vertex { b } else { a };
                let through = distance + self.cost[e as usize];
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

/// Shortest paths from one vertex.
struct Tree {
    root: u32,
    distance: Vec<f64>,
    parent: Vec<u32>,
}

impl Tree {
    /// Moves a charge from the root to `end`: from each edge's root side to the other.
    fn turn_along(&self, edges: &EdgeTopology, end: u32, amount: i32, turns: &mut Vec<Turn>) {
        let mut vertex = end;
        while vertex != self.root {
            let edge = self.parent[vertex as usize];
            let [a, b] = edges.vertices[edge as usize];
            turns.push((edge, if b == vertex { amount } else { -amount }));
            vertex = if b == vertex { a } else { b };
        }
    }
}
