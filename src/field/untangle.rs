//! Turning back triangles that rounding the integers turned over.

// Corners, coordinates and entries are numbers that index several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::conjugate_field::ConjugateField;
use super::map_elements::Element;
use super::map_system::System;
use super::seams::{NONE, Seams};
use crate::control::Control;
use crate::error::Error;
use crate::numeric::{Cholesky, SymbolicCholesky};
use sprs::CsMat;
use std::collections::BTreeSet;

/// A map that has some triangles turned over, and what it shall be like.
pub(super) struct Tangle<'a> {
    pub field: &'a ConjugateField,
    pub seams: &'a Seams,
    pub elements: &'a [Element],
    pub system: &'a System,
    /// Target sizes of each triangle, cells per length.
    pub sizes: Vec<[f64; 2]>,
}

/// Rings of triangles around the turned-over ones that move, tried one after another.
const RINGS: [usize; 3] = [3, 6, 12];
/// Share of the wanted cells below which a triangle counts as turned over.
const LEAST_SHARE: f64 = 1e-3;
/// Most Newton iterations of one try, and most after the last triangle turned back.
const ITERATIONS: usize = 40;
const POLISH: usize = 4;
/// Weight of the angles between isolines and field against the distortion.
const DIRECTION_WEIGHT: f64 = 4.0;
/// How far the barrier reaches beyond zero at first, by what that shrinks once a step gains less than `CONVERGED` of the energy, and where it
/// ends.
const FIRST_REACH: f64 = 0.5;
const DRAWN_IN: f64 = 0.3;
const CONVERGED: f64 = 0.05;
const LEAST_REACH: f64 = 1e-4;
/// Shortest part of a Newton step that is tried.
const SHORTEST_STEP: f64 = 1e-4;
/// Damping of the Newton steps over the largest diagonal entry.
const LEAST_DAMPING: f64 = 1e-12;
const MOST_DAMPING: f64 = 1e-2;
/// Share of a Newton step's expected decrease that counts as one.
const ARMIJO: f64 = 1e-4;

impl Tangle<'_> {
    /// Moves free unknowns of `solution` near turned-over triangles until these are turned back; the integers stay. Returns the triangles that
    /// are turned over still.
    ///
    /// Minimizes, over a few rings of triangles, the sum of area times (|J|^2 + det^2 + 1) / chi(det), J being the map's derivative along the field's
    /// directions over the wanted sizes (the identity where all is well), with a term for the directions. chi = (det + sqrt(det^2 + reach^2)) / 2
    /// is positive everywhere and approaches det from above as the smallest determinant rises and the reach falls.
    ///
    /// # Errors
    /// [`Error::Singular`], [`Error::Cancelled`].
    ///
    /// # Source
    /// Garanzha et al. 2021, Foldover-free maps in 50 lines of code: their energy, with their Hessian without the part that bends
    /// chi. Their reach follows the smallest determinant; ours shrinks as Newton converges.
    pub fn untangle(&self, solution: &mut [f64], control: &Control) -> Result<Vec<usize>, Error> {
        let mut turned = self.turned(solution);
        for rings in RINGS {
            if turned.is_empty() {
                break;
            }
            control.check()?;
            let mut trial = solution.to_vec();
            Region::new(self, &turned, rings)?.minimize(&mut trial)?;
            let left = self.turned(&trial);
            if left.len() < turned.len() {
                solution.copy_from_slice(&trial);
                turned = left;
            }
        }
        Ok(turned)
    }

    /// Triangles with too small a determinant.
    fn turned(&self, solution: &[f64]) -> Vec<usize> {
        (0..self.elements.len()).filter(|&t| determinant(&self.derivative(t, solution)) < LEAST_SHARE).collect()
    }

    /// Places of the integers, after the free unknowns, that the coordinates of some triangles depend on.
    pub fn integers_of(&self, triangles: &[usize]) -> BTreeSet<usize> {
        let unknowns = triangles.iter().flat_map(|&t| (0..6).flat_map(move |i| self.system.coordinate(t, i)));
        unknowns.filter_map(|c| (c.0 as usize).checked_sub(self.system.free)).collect()
    }

    /// Derivative of the map on triangle `t`, over the wanted sizes: row 0 is that of a, column 0 is along u.
    fn derivative(&self, t: usize, solution: &[f64]) -> [[f64; 2]; 2] {
        let value = |i: usize| -> f64 {
            self.system.coordinate(t, i).iter().map(|&(unknown, c)| c * solution[unknown as usize]).sum()
        };
        let slopes = self.slopes(t);
        [0, 1].map(|i| {
            let corners = [0, 1, 2].map(|k| value(3 * i + k));
            [0, 1].map(|j| (0..3).map(|k| slopes[i][j][k] * corners[k]).sum())
        })
    }

    /// Derivatives of the entries of [`Tangle::derivative`] by the three corners' coordinates.
    fn slopes(&self, t: usize) -> [[[f64; 3]; 2]; 2] {
        let element = &self.elements[t];
        [0, 1].map(|i| [0, 1].map(|j| element.along[j].map(|x| x / self.sizes[t][i])))
    }
}

fn determinant(j: &[[f64; 2]; 2]) -> f64 {
    j[0][0] * j[1][1] - j[0][1] * j[1][0]
}

/// The triangles around some, and the unknowns that move.
struct Region<'a> {
    tangle: &'a Tangle<'a>,
    triangles: Vec<u32>,
    /// Numbers of the unknowns in the solution.
    unknowns: Vec<u32>,
    /// For each triangle's six coordinates (a of the corners, then b) the local unknown, [`NONE`] where it stays, and its sign.
    coordinates: Vec<[(u32, f64); 6]>,
    /// The lower triangle of the matrix, and for each triangle the places of its 6 x 6 entries there ([`NONE`] above the diagonal).
    matrix: CsMat<f64>,
    slots: Vec<[u32; 36]>,
    symbolic: SymbolicCholesky,
}

impl<'a> Region<'a> {
    /// The unknowns of vertices fewer than `rings` edges from the triangles `around`.
    fn new(tangle: &'a Tangle, around: &[usize], rings: usize) -> Result<Self, Error> {
        let corners = &tangle.field.mesh.triangles;
        let mut moves = vec![false; tangle.field.mesh.points.len()];
        let mut inside = vec![false; corners.len()];
        let mut front: Vec<usize> = around.to_vec();
        around.iter().for_each(|&t| inside[t] = true);
        for _ in 0..rings {
            let mut next = vec![];
            for v in front.iter().flat_map(|&t| corners[t]) {
                if !std::mem::replace(&mut moves[v as usize], true) {
                    for t in tangle.seams.fan(v as usize).map(|h| h / 3) {
                        if !std::mem::replace(&mut inside[t], true) {
                            next.push(t);
                        }
                    }
                }
            }
            front = next;
        }
        let triangles: Vec<u32> = (0..corners.len() as u32).filter(|&t| inside[t as usize]).collect();
        let mut number = vec![NONE; tangle.system.free];
        let mut unknowns = vec![];
        let mut coordinates = Vec::with_capacity(triangles.len());
        for &t in &triangles {
            coordinates.push(std::array::from_fn(|i| {
                let free = tangle.system.coordinate(t as usize, i).iter().find(|c| (c.0 as usize) < tangle.system.free);
                match free {
                    Some(&(x, sign)) if moves[corners[t as usize][i % 3] as usize] => {
                        if number[x as usize] == NONE {
                            number[x as usize] = unknowns.len() as u32;
                            unknowns.push(x);
                        }
                        (number[x as usize], sign)
                    }
                    _ => (NONE, 0.0),
                }
            }));
        }
        let (matrix, slots) = pattern(unknowns.len(), &coordinates);
        let symbolic = SymbolicCholesky::new(&matrix)?;
        Ok(Self { tangle, triangles, unknowns, coordinates, matrix, slots, symbolic })
    }

    /// Newton's method on the energy, its barrier drawn in as the triangles turn back.
    fn minimize(&mut self, solution: &mut [f64]) -> Result<(), Error> {
        let n = self.unknowns.len();
        if n == 0 {
            return Ok(());
        }
        let mut reach = FIRST_REACH;
        let mut polished = 0;
        for _ in 0..ITERATIONS {
            let (energy, gradient) = self.assemble(solution, reach);
            let factor = self.factorize()?;
            let mut step: Vec<f64> = gradient.iter().map(|g| -g).collect();
            factor.solve(&mut step);
            let slope: f64 = step.iter().zip(&gradient).map(|(s, g)| s * g).sum();
            let mut length = 1.0;
            let mut trial = solution.to_vec();
            let gain = loop {
                for (&x, s) in self.unknowns.iter().zip(&step) {
                    trial[x as usize] = solution[x as usize] + length * s;
                }
                let next = self.energy(&trial, reach);
                if next <= energy + ARMIJO * length * slope {
                    solution.copy_from_slice(&trial);
                    break energy - next;
                }
                length *= 0.5;
                if length < SHORTEST_STEP {
                    break 0.0;
                }
            };
            let least = self.least_determinant(solution);
            polished += usize::from(least > LEAST_SHARE);
            if polished > POLISH || (least <= LEAST_SHARE && reach < LEAST_REACH) {
                break;
            }
            if gain < CONVERGED * energy || least > LEAST_SHARE {
                reach *= DRAWN_IN;
            }
        }
        Ok(())
    }

    /// Factorizes the matrix, which has no negative direction but perhaps a nearly flat one: with as much damping as it takes.
    fn factorize(&mut self) -> Result<Cholesky, Error> {
        let diagonal: Vec<usize> = self.matrix.indptr().to_proper()[..self.unknowns.len()].to_vec();
        let largest = diagonal.iter().map(|&slot| self.matrix.data()[slot]).fold(0.0, f64::max);
        let mut damping = LEAST_DAMPING * largest;
        loop {
            diagonal.iter().for_each(|&slot| self.matrix.data_mut()[slot] += damping);
            match self.symbolic.factorize(&self.matrix, "untangling") {
                Err(_) if damping < MOST_DAMPING * largest => damping *= 100.0,
                factor => return factor,
            }
        }
    }

    fn least_determinant(&self, solution: &[f64]) -> f64 {
        let determinants = self.triangles.iter().map(|&t| determinant(&self.tangle.derivative(t as usize, solution)));
        determinants.fold(f64::INFINITY, f64::min)
    }

    fn energy(&self, solution: &[f64], reach: f64) -> f64 {
        self.triangles
            .iter()
            .map(|&t| {
                let j = self.tangle.derivative(t as usize, solution);
                let element = &self.tangle.elements[t as usize];
                let crossing = element.crossing * element.crossing;
                element.area * (Barrier::new(&j, reach).value + DIRECTION_WEIGHT * crossing * skew(&j))
            })
            .sum()
    }

    /// Energy and gradient; the Hessian goes to the matrix.
    fn assemble(&mut self, solution: &[f64], reach: f64) -> (f64, Vec<f64>) {
        let mut gradient = vec![0.0; self.unknowns.len()];
        let mut energy = 0.0;
        let mut values = vec![0.0; self.matrix.nnz()];
        for (place, &t) in self.triangles.iter().enumerate() {
            let element = &self.tangle.elements[t as usize];
            let slopes = self.tangle.slopes(t as usize);
            let j = self.tangle.derivative(t as usize, solution);
            let Barrier { value, slope, hessian } = Barrier::new(&j, reach);
            let (mut slope, mut hessian) = (slope, hessian);
            let direction = DIRECTION_WEIGHT * element.crossing * element.crossing;
            for (k, x) in [(1, j[0][1]), (2, j[1][0])] {
                slope[k] += 2.0 * direction * x;
                hessian[k][k] += 2.0 * direction;
            }
            energy += element.area * (value + direction * skew(&j));
            // Coordinate (i, corner) acts on the entries (i, 0) and (i, 1) of the derivative.
            let by = |c: usize| [0, 1].map(|k| slopes[c / 3][k][c % 3]);
            for p in 0..6 {
                let (x, sign) = self.coordinates[place][p];
                if x == NONE {
                    continue;
                }
                let (row, bp) = (2 * (p / 3), by(p));
                gradient[x as usize] += element.area * sign * (slope[row] * bp[0] + slope[row + 1] * bp[1]);
                for q in 0..6 {
                    let slot = self.slots[place][6 * p + q];
                    if slot == NONE {
                        continue;
                    }
                    let (column, bq) = (2 * (q / 3), by(q));
                    let second: f64 =
                        (0..2).map(|a| (0..2).map(|b| bp[a] * hessian[row + a][column + b] * bq[b]).sum::<f64>()).sum();
                    values[slot as usize] += element.area * sign * self.coordinates[place][q].1 * second;
                }
            }
        }
        self.matrix.data_mut().copy_from_slice(&values);
        (energy, gradient)
    }
}

/// Squares of what should vanish where the isolines follow the field.
fn skew(j: &[[f64; 2]; 2]) -> f64 {
    j[0][1].powi(2) + j[1][0].powi(2)
}

/// (|J|^2 + det^2 + 1) / chi(det) with its derivatives by the entries of J, row by row; the Hessian without the part that may be negative.
struct Barrier {
    value: f64,
    slope: [f64; 4],
    hessian: [[f64; 4]; 4],
}

impl Barrier {
    fn new(j: &[[f64; 2]; 2], reach: f64) -> Self {
        let entries = [j[0][0], j[0][1], j[1][0], j[1][1]];
        let cofactors = [j[1][1], -j[1][0], -j[0][1], j[0][0]];
        let square: f64 = entries.iter().map(|x| x * x).sum();
        let d = determinant(j);
        let root = d.hypot(reach);
        // For negative d the difference would cancel.
        let chi = if d > 0.0 { 0.5 * (d + root) } else { 0.5 * reach * reach / (root - d) };
        // The slope of chi is chi / root; chi bends upwards, which is the part that may be negative.
        let top = square + d * d + 1.0;
        let by_d = (2.0 * d - top / root) / chi;
        let mixed = -2.0 / (chi * root);
        let by_dd = (2.0 - 4.0 * d / root + 2.0 * top / (root * root)) / chi;
        let slope = std::array::from_fn(|k| 2.0 * entries[k] / chi + by_d * cofactors[k]);
        let hessian = std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                let diagonal = if a == b { 2.0 / chi } else { 0.0 };
                diagonal
                    + mixed * (entries[a] * cofactors[b] + cofactors[a] * entries[b])
                    + by_dd * cofactors[a] * cofactors[b]
            })
        });
        Self { value: top / chi, slope, hessian }
    }
}

/// The lower triangle of a matrix with an entry wherever two coordinates share a triangle, and the entries' places for each triangle.
fn pattern(size: usize, coordinates: &[[(u32, f64); 6]]) -> (CsMat<f64>, Vec<[u32; 36]>) {
    let key = |row: u32, column: u32| (u64::from(column) << 32) | u64::from(row);
    let mut keys: Vec<u64> = vec![];
    for own in coordinates {
        for &(p, _) in own.iter().filter(|c| c.0 != NONE) {
            keys.extend(own.iter().filter(|c| c.0 != NONE && p >= c.0).map(|c| key(p, c.0)));
        }
    }
    keys.sort_unstable();
    keys.dedup();
    let slots = coordinates
        .iter()
        .map(|own| {
            std::array::from_fn(|k| {
                let (p, q) = (own[k / 6].0, own[k % 6].0);
                if p == NONE || q == NONE || p < q {
                    return NONE;
                }
                keys.binary_search(&key(p, q)).map_or(NONE, |slot| slot as u32)
            })
        })
        .collect();
    let mut starts = vec![0; size + 1];
    for k in &keys {
        starts[(k >> 32) as usize + 1] += 1;
    }
    for c in 0..size {
        starts[c + 1] += starts[c];
    }
    let rows = keys.iter().map(|k| (k & u64::from(u32::MAX)) as usize).collect();
    (CsMat::new_csc((size, size), starts, rows, vec![0.0; keys.len()]), slots)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_barriers_slope_is_its_derivative_and_its_hessian_has_no_negative_direction() {
        for i in 0..200 {
            let t = f64::from(i);
            let mut j = [[(1.3 * t).sin(), (2.1 * t).cos()], [(0.7 * t).sin(), (1.9 * t + 1.0).cos()]];
            let reach = 10f64.powf(-1.0 - 2.0 * (0.37 * t).sin().abs());
            let Barrier { slope, hessian, .. } = Barrier::new(&j, reach);
            for k in 0..4 {
                let h = 1e-6 * reach;
                let mut value = |step: f64| {
                    j[k / 2][k % 2] += step;
                    let value = Barrier::new(&j, reach).value;
                    j[k / 2][k % 2] -= step;
                    value
                };
                let difference = (value(h) - value(-h)) / (2.0 * h);
                let size = slope.iter().fold(1.0f64, |m, s| m.max(s.abs()));
                assert!((difference - slope[k]).abs() < 1e-4 * size, "{i}, {k}: {difference} {}", slope[k]);
            }
            let matrix = nalgebra::Matrix4::from_fn(|a, b| hessian[a][b]);
            let eigenvalues = matrix.symmetric_eigenvalues();
            assert!(eigenvalues.min() >= -1e-9 * eigenvalues.max(), "{i}: {eigenvalues}");
        }
    }
}
