//! The quadratic energy of a map as a matrix of one fixed pattern.

#![allow(clippy::needless_range_loop)]

use super::conjugate_field::ConjugateField;
use super::map_unknowns::{Form, component, source_component};
use super::relations::{Relations, Terms, add};
use super::rounding::Reduced;
use super::seams::Seams;
use crate::error::Error;
use crate::numeric::{Cholesky, SymbolicCholesky};
use nalgebra::{DMatrix, DVector};
use sprs::CsMat;

/// The energy's matrix as a sum over triangles into the slots of one fixed pattern: free unknowns first, then integers.
pub(super) struct System {
    pub free: usize,
    pub integers: usize,
    /// Value slots: the free-free lower triangle in CSC order, then free-integer pairs, then integer-integer pairs.
    pub slots: usize,
    column_starts: Vec<usize>,
    rows: Vec<usize>,
    mixed: Vec<(u32, u32)>,
    dense: Vec<(u32, u32)>,
    symbolic: SymbolicCholesky,
    /// For each triangle: (slot, place in the element's Hessian, coefficient).
    contributions: Vec<(u32, u8, f64)>,
    contribution_starts: Vec<u32>,
    /// For each triangle's six coordinates (a of the corners, then b): (unknown, coefficient).
    terms: Vec<(u32, f64)>,
    term_starts: Vec<u32>,
}

impl System {
    pub fn new(
        field: &ConjugateField,
        seams: &Seams,
        forms: &[[Form; 2]],
        free: usize,
        relations: &Relations,
    ) -> Result<Self, Error> {
        let triangles = &field.mesh.triangles;
        let integers = relations.free;
        let shifts: Vec<[Terms; 2]> =
            seams.translations.iter().map(|t| [0, 1].map(|i| relations.expand(&component(t, i)))).collect();
        let mut terms: Vec<(u32, f64)> = Vec::with_capacity(6 * triangles.len());
        let mut term_starts = vec![0u32];
        for (t, triangle) in triangles.iter().enumerate() {
            for family in 0..2 {
                for k in 0..3 {
                    let (r, place) = seams.corner[3 * t + k];
                    let (index, sign) = source_component(family, r);
                    let shift = &shifts[place as usize][family];
                    match &forms[triangle[k] as usize][index] {
                        Form::Free(x) => {
                            terms.push((*x, sign as f64));
                            terms.extend(shift.iter().map(|&(k, c)| (free as u32 + k, c as f64)));
                        }
                        Form::Integer(own) => {
                            let mut sum = shift.clone();
                            add(&mut sum, &relations.expand(own), sign);
                            terms.extend(sum.iter().map(|&(k, c)| (free as u32 + k, c as f64)));
                        }
                    }
                    term_starts.push(terms.len() as u32);
                }
            }
        }
        // Every pair of unknowns that share a triangle and family, lower triangle only.
        let mut pairs: Vec<(u64, u32, u8, f64)> = Vec::with_capacity(12 * triangles.len());
        let mut contribution_starts = vec![0u32];
        let key = |p: u32, q: u32| {
            let class = u64::from(p >= free as u32) + u64::from(q >= free as u32);
            (class << 60) | (u64::from(q) << 30) | u64::from(p)
        };
        for t in 0..triangles.len() {
            for family in 0..2 {
                for i in 0..3 {
                    for j in 0..3 {
                        let list = |c: usize| {
                            let place = 6 * t + 3 * family + c;
                            &terms[term_starts[place] as usize..term_starts[place + 1] as usize]
                        };
                        for &(p, cp) in list(i) {
                            for &(q, cq) in list(j).iter().filter(|&&(q, _)| p >= q) {
                                pairs.push((key(p, q), t as u32, (9 * family + 3 * i + j) as u8, cp * cq));
                            }
                        }
                    }
                }
            }
            contribution_starts.push(pairs.len() as u32);
        }
        let mut keys: Vec<u64> = pairs.iter().map(|p| p.0).collect();
        // A full diagonal keeps the pattern valid whatever the weights.
        keys.extend((0..free as u32).map(|x| key(x, x)));
        keys.sort_unstable();
        keys.dedup();
        let mask = (1u64 << 30) - 1;
        let split = |k: u64| ((k & mask) as u32, ((k >> 30) & mask) as u32);
        let mut column_starts = vec![0usize; free + 1];
        let (mut rows, mut mixed, mut dense) = (vec![], vec![], vec![]);
        for &k in &keys {
            let (p, q) = split(k);
            match k >> 60 {
                0 => {
                    rows.push(p as usize);
                    column_starts[q as usize + 1] += 1;
                }
                1 => mixed.push((q, p - free as u32)),
                _ => dense.push((q - free as u32, p - free as u32)),
            }
        }
        for c in 0..free {
            column_starts[c + 1] += column_starts[c];
        }
        let contributions = pairs
            .iter()
            .map(|&(k, _, place, c)| (keys.binary_search(&k).expect("collected above") as u32, place, c))
            .collect();
        let pattern = CsMat::new_csc((free, free), column_starts.clone(), rows.clone(), vec![0.0; rows.len()]);
        let symbolic = SymbolicCholesky::new(&pattern)?;
        Ok(Self {
            free,
            integers,
            slots: keys.len(),
            column_starts,
            rows,
            mixed,
            dense,
            symbolic,
            contributions,
            contribution_starts,
            terms,
            term_starts,
        })
    }

    pub fn add(&self, t: usize, hessian: &[f64; 18], right: &[f64; 6], values: &mut [f64], gradient: &mut [f64]) {
        let range = self.contribution_starts[t] as usize..self.contribution_starts[t + 1] as usize;
        for &(slot, place, c) in &self.contributions[range] {
            values[slot as usize] += c * hessian[place as usize];
        }
        for (i, value) in right.iter().enumerate() {
            for &(unknown, c) in self.coordinate(t, i) {
                gradient[unknown as usize] += c * value;
            }
        }
    }

    pub fn coordinate(&self, t: usize, i: usize) -> &[(u32, f64)] {
        let place = 6 * t + i;
        &self.terms[self.term_starts[place] as usize..self.term_starts[place + 1] as usize]
    }

    pub fn corners(&self, solution: &[f64]) -> Vec<[[f64; 2]; 3]> {
        let value = |t: usize, i: usize| -> f64 {
            self.coordinate(t, i).iter().map(|&(unknown, c)| c * solution[unknown as usize]).sum()
        };
        (0..self.contribution_starts.len() - 1).map(|t| [0, 1, 2].map(|k| [value(t, k), value(t, 3 + k)])).collect()
    }

    fn factorize(&self, values: &[f64]) -> Result<Cholesky, Error> {
        let n = self.free;
        let values = values[..self.rows.len()].to_vec();
        let matrix = CsMat::new_csc((n, n), self.column_starts.clone(), self.rows.clone(), values);
        self.symbolic.factorize(&matrix, "seamless map")
    }

    /// Eliminates the free unknowns.
    pub fn reduce(&self, values: Vec<f64>, gradient: Vec<f64>) -> Result<Reduced, Error> {
        let (n, m) = (self.free, self.integers);
        let direct = self.rows.len();
        let factor = self.factorize(&values)?;
        let mut columns = vec![0.0; n * (m + 1)];
        columns[..n].copy_from_slice(&gradient[..n]);
        for (&(x, y), value) in self.mixed.iter().zip(&values[direct..]) {
            columns[n * (1 + y as usize) + x as usize] = *value;
        }
        if n > 0 {
            factor.solve(&mut columns);
        }
        let mut schur = DMatrix::zeros(m, m);
        let mut right = DVector::from_column_slice(&gradient[n..]);
        for (&(q, p), value) in self.dense.iter().zip(&values[direct + self.mixed.len()..]) {
            schur[(p as usize, q as usize)] = *value;
            schur[(q as usize, p as usize)] = *value;
        }
        for (&(x, y), value) in self.mixed.iter().zip(&values[direct..]) {
            right[y as usize] -= value * columns[x as usize];
            for k in 0..m {
                schur[(y as usize, k)] -= value * columns[n * (1 + k) + x as usize];
            }
        }
        Ok(Reduced { free: n, columns, schur, right })
    }
}
