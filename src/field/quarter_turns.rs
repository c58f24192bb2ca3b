//! Quarter turns across edges, and the singularities that they make.

use super::border::inner_angle;
use super::cancel::{inward, paths};
use super::conjugate_field::Singularity;
use super::matching::{Cross, match_edges};
use super::prescribe;
use super::problem::{Freedom, HARD_WEIGHT, Problem};
use super::topology::wrap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Distance from the border to which a charge of it moves inside, in square roots of the area.
const INWARD: f64 = 0.12;

impl Problem<'_> {
    /// Matching of the smallest rotations, and the singularities.
    pub fn matched(&self, crosses: &[Cross]) -> (Vec<u8>, Vec<Singularity>) {
        match_edges(self.mesh, self.edges, |e| {
            let (k, rotation, _) = self.across(e, crosses, None);
            (k, rotation)
        })
    }

    /// The singularities of crosses with these quarter turns.
    pub fn singularities(&self, crosses: &[Cross], jumps: &[i32]) -> Vec<Singularity> {
        let across = |e| {
            let (k, rotation, _) = self.across(e, crosses, Some(jumps));
            (k, rotation)
        };
        match_edges(self.mesh, self.edges, across).1
    }

    /// Quarter turns across each edge that make the rotation smallest.
    pub fn nearest_jumps(&self, crosses: &[Cross]) -> Vec<i32> {
        let mut jumps = vec![0; self.edges.len()];
        for e in self.inner_edges() {
            let [f, g] = self.edges.triangles[e].map(|t| t as usize);
            let (_, rotation, _) = self.across(e, crosses, None);
            let plain = crosses[g].bisector - crosses[f].bisector - self.frames.turns[e];
            jumps[e] = ((rotation - plain) / FRAC_PI_2).round() as i32;
        }
        jumps
    }

    /// Quarter turns across each edge with which `crosses` have the `fixed` singularities and no others, and turn with the border that they
    /// follow; what does not match leaves over the border where they do not.
    pub fn prescribed_jumps(&self, crosses: &[Cross], fixed: &[Singularity]) -> Vec<i32> {
        let mut jumps = self.nearest_jumps(crosses);
        let mut present = self.matched(crosses).1;
        present.extend(self.border_charges(crosses, &jumps));
        let charges = prescribe::charges(&present, fixed);
        let leaves = |_, v: u32| !self.followed.contains_key(&v);
        let (turns, _) = paths(self.mesh, self.edges, &self.crack_rigidity(), &charges, &|_, _| true, &leaves);
        turns.iter().for_each(|&(edge, quarters)| jumps[edge as usize] += quarters);
        jumps
    }

    /// Border vertices that the cross passes with other quarter turns than the border, both as it should: index 1 where a quad is missing, -1
    /// where there is one too many.
    pub fn border_charges(&self, crosses: &[Cross], jumps: &[i32]) -> Vec<Singularity> {
        let mut charges = vec![];
        let number = |t: u32, from: u32, to: u32| {
            let along = self.mesh.position(to) - self.mesh.position(from);
            let angle = self.frames.angle(t as usize, &along);
            let cross = &crosses[t as usize];
            let off = |i: i32| {
                let own = if i % 2 == 0 { cross.u() } else { cross.v() } + PI * f64::from(i / 2);
                wrap(own - angle, TAU).abs()
            };
            (0..4).min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0)
        };
        for &edge in self.followed.values() {
            let [before, vertex] = self.edges.vertices[edge as usize];
            let Some(&next) = self.followed.get(&vertex) else { continue };
            let fan = self.edges.fan(vertex);
            let turned: i32 = fan
                .windows(2)
                .filter_map(|pair| {
                    let e = self.edges.between(pair[0], pair[1])? as usize;
                    Some(if self.edges.triangles[e][0] == pair[0] { jumps[e] } else { -jumps[e] })
                })
                .sum();
            let out = number(fan[0], vertex, self.edges.vertices[next as usize][1]);
            let back = number(fan[fan.len() - 1], vertex, before);
            let wanted = 2 - self.corners.get(&vertex).copied().unwrap_or(0);
            // Quads are known up to four, by the angle at the vertex.
            let most = inner_angle(self.mesh, self.edges, vertex) / FRAC_PI_2 - f64::from(wanted);
            let index = (wanted - (back - out - turned)).rem_euclid(4);
            let index = if index > 2 || (index == 2 && most > 0.0) { index - 4 } else { index };
            if index != 0 {
                charges.push(Singularity { vertex, index });
            }
        }
        charges
    }

    /// The nearest quarter turns, but with the border where the field follows it: a charge of the border meets the nearest opposite one, or
    /// moves inside.
    pub fn bordered_jumps(&self, crosses: &[Cross]) -> Vec<i32> {
        let mut jumps = self.nearest_jumps(crosses);
        let border = self.border_charges(crosses, &jumps);
        if border.is_empty() {
            return jumps;
        }
        let mut charges = self.matched(crosses).1;
        charges.extend(&border);
        let on_border = |v: u32| self.edges.is_border_vertex(v);
        let meet = |a: u32, b: u32| on_border(a) || on_border(b);
        let leaves = |a: u32, v: u32| on_border(a) && !self.followed.contains_key(&v);
        let rigidity = self.crack_rigidity();
        let (turns, mut left) = paths(self.mesh, self.edges, &rigidity, &charges, &meet, &leaves);
        turns.iter().for_each(|&(edge, quarters)| jumps[edge as usize] += quarters);
        left.retain(|charge| on_border(charge.vertex));
        let depth = INWARD * self.frames.areas.iter().sum::<f64>().sqrt();
        let turns = inward(self.mesh, self.edges, &rigidity, &left, depth);
        turns.iter().for_each(|&(edge, quarters)| jumps[edge as usize] += quarters);
        jumps
    }

    /// How dear a crack is on each triangle, where it could not close across a line that the field follows.
    fn crack_rigidity(&self) -> Vec<f64> {
        let mut rigidity = self.rigidity();
        for &(t, _, weight) in &self.soft {
            rigidity[t] += weight;
        }
        for (rigid, hard) in rigidity.iter_mut().zip(&self.hard) {
            *rigid += if hard.is_some() { HARD_WEIGHT } else { 0.0 };
        }
        rigidity
    }

    /// How firmly each triangle holds its cross, from 0 (free to turn) to 1.
    pub fn rigidity(&self) -> Vec<f64> {
        let rigid = |t: usize| match self.freedom[t] {
            Freedom::Fixed => 1.0,
            Freedom::AboutU => 0.5,
            Freedom::Bisector | Freedom::Crossing | Freedom::Free => {
                let (h, d) = (self.forms[t].h.powi(2), self.forms[t].deviator().powi(2));
                if self.flat[t] { 0.0 } else { ((d - h) / (d + h)).max(0.0) }
            }
        };
        (0..self.freedom.len()).map(rigid).collect()
    }
}
