//! The topology of a layout settles: singularities that nothing asks for go.

use super::cancel::paths;
use super::matching::Cross;
use super::problem::Problem;
use super::system::TriangleSystem;
use crate::control::Control;
use crate::error::Error;

/// What a singularity may save of the energy before its removal is refused. One of quarter index over n triangles across costs about
/// (pi / 2)^2 / (2 pi) log n, 1.4 for n = 40; far ones give the lines room to spread, close pairs no mesh can show.
const FAR_PAIR_ENERGY: f64 = 0.3;
const CLOSE_PAIR_ENERGY: f64 = 1.5;
/// The same for far ones where the field follows the border: a border that turns away from what conjugacy asks for makes singularities on its own.
const ALIGNED_PAIR_ENERGY: f64 = 0.6;
/// Distance of singularities that count as a close pair, in square roots of the area.
const CLOSE_PAIR: f64 = 0.15;
/// Most Gauss-Newton iterations with, and again without, the jumps of a removal.
const REMOVAL_ITERATIONS: usize = 4;

impl Problem<'_> {
    /// Gauss-Newton from `crosses`, then with the border where the field follows it, then without the singularities that nothing asks for; with
    /// the quarter turns across edges, and the iterations spent.
    ///
    /// Moving the charges of the singularities together, or over the border, by quarter turns across the edges of paths between them makes
    /// a field without them, cracked along the paths; Gauss-Newton closes the cracks where neither conjugacy nor constraints need
    /// them. The result counts if it has fewer singularities at little more energy: first all at once, then close pairs only.
    pub fn settle(
        &self,
        system: &mut TriangleSystem,
        crosses: Vec<Cross>,
        control: &Control,
    ) -> Result<(Vec<Cross>, Vec<i32>, usize), Error> {
        let (crosses, mut iterations) = self.optimize(system, crosses, None, self.options.iterations, control)?;
        let jumps = self.bordered_jumps(&crosses);
        let (mut crosses, mut jumps, spent) = if jumps == self.nearest_jumps(&crosses) {
            (crosses, jumps, 0)
        } else {
            self.closed(system, crosses, jumps, control)?
        };
        iterations += spent;
        let size = self.frames.areas.iter().sum::<f64>().sqrt();
        let rigidity = self.rigidity();
        let far = if self.followed.is_empty() { FAR_PAIR_ENERGY } else { ALIGNED_PAIR_ENERGY };
        for (reach, saving) in [(f64::INFINITY, far), (CLOSE_PAIR * size, CLOSE_PAIR_ENERGY)] {
            let singularities = self.singularities(&crosses, &jumps);
            let near = |a: u32, b: u32| (self.mesh.position(a) - self.mesh.position(b)).norm() <= reach;
            let leaves = |a: u32, v: u32| near(a, v) && !self.followed.contains_key(&v);
            let (turns, _) = paths(self.mesh, self.edges, &rigidity, &singularities, &near, &leaves);
            if turns.is_empty() {
                continue;
            }
            let mut turned = jumps.clone();
            turns.iter().for_each(|&(edge, quarters)| turned[edge as usize] += quarters);
            let (trial, turned, spent) = self.closed(system, crosses.clone(), turned, control)?;
            iterations += spent;
            let left = self.singularities(&trial, &turned).len();
            let allowed = saving * (singularities.len() as f64 - left as f64);
            let energies = [(&trial, &turned), (&crosses, &jumps)].map(|(c, j)| self.energy(c, Some(j)));
            if left < singularities.len() && energies[0] <= energies[1] + allowed {
                (crosses, jumps) = (trial, turned);
            }
        }
        Ok((crosses, jumps, iterations))
    }

    /// Gauss-Newton with the cracks of `jumps`, then with the smallest rotations, so that singularities find their places. Where the field follows
    /// the border, that counts if none leaves over it, and if it costs no more than to keep to `jumps` on and on.
    fn closed(
        &self,
        system: &mut TriangleSystem,
        crosses: Vec<Cross>,
        jumps: Vec<i32>,
        control: &Control,
    ) -> Result<(Vec<Cross>, Vec<i32>, usize), Error> {
        let most = self.options.iterations.min(REMOVAL_ITERATIONS);
        let (crosses, spent) = self.optimize(system, crosses, Some(&jumps), most, control)?;
        let (free, more) = self.optimize(system, crosses.clone(), None, most, control)?;
        let nearest = self.nearest_jumps(&free);
        if self.followed.is_empty() {
            return Ok((free, nearest, spent + more));
        }
        let (held, last) = self.optimize(system, crosses, Some(&jumps), self.options.iterations, control)?;
        let spent = spent + more + last;
        let turns_with_border = self.border_charges(&free, &nearest).is_empty();
        if turns_with_border && self.cost(&free, &nearest) <= self.cost(&held, &jumps) {
            return Ok((free, nearest, spent));
        }
        Ok((held, jumps, spent))
    }

    /// Energy of crosses with these quarter turns, and what their singularities count for on a border that the field follows.
    pub fn cost(&self, crosses: &[Cross], jumps: &[i32]) -> f64 {
        let singularities = self.singularities(crosses, jumps).len();
        self.energy(crosses, Some(jumps)) + ALIGNED_PAIR_ENERGY * singularities as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::conjugate::second_forms;
    use crate::field::layout::Patch;
    use crate::field::problem::Conjugacy;
    use crate::field::smooth::FieldOptions;
    use crate::field::smoothness::edge_weights;
    use crate::field::test_surfaces::*;
    use crate::field::topology::{EdgeTopology, TriangleFrames};
    use crate::surface::SurfaceMesh;
    use nalgebra::Vector3;
    use std::f64::consts::FRAC_PI_4;

    #[test]
    fn a_pair_that_nothing_asks_for_is_removed() {
        let mesh = SurfaceMesh::new(&graph(|_, _| 0.0), [20, 20]).unwrap();
        let edges = EdgeTopology::new(mesh.points.len(), &mesh.triangles).unwrap();
        let frames = TriangleFrames::new(&mesh, &edges).unwrap();
        for distance in [0.13, 0.45] {
            let crosses: Vec<Cross> = (0..mesh.triangles.len())
                .map(|t| {
                    let p: Vector3<f64> = mesh.triangles[t].iter().map(|&v| mesh.position(v).coords / 3.0).sum();
                    let bisector = 0.25 * (p.y.atan2(p.x - distance) - p.y.atan2(p.x + distance));
                    Cross { bisector: bisector + frames.angle(t, &Vector3::x()), half_crossing: FRAC_PI_4 }
                })
                .collect();
            let options = FieldOptions::default();
            let forms = second_forms(&mesh, &frames);
            let weights = edge_weights(&mesh, &edges);
            let patch =
                Patch { mesh: &mesh, edges: &edges, frames: &frames, forms: &forms, corners: &[], weights: &weights };
            let problem = Problem::new(&patch, Conjugacy::Soft, None, &[], &options).unwrap();
            let indices: Vec<i32> = problem.matched(&crosses).1.iter().map(|s| s.index).collect();
            assert_eq!((indices.len(), indices.iter().sum::<i32>()), (2, 0));
            let (settled, ..) = problem.settle(&mut problem.system().unwrap(), crosses, &Control::default()).unwrap();
            assert!(problem.matched(&settled).1.is_empty());
            assert!(problem.energy(&settled, None) < 1e-3);
        }
    }
}
