//! Integer unknowns that linear relations tie together, in terms of fewer that are free.

use std::collections::BTreeMap;

/// Sum of integer unknowns times coefficients.
pub(super) type Terms = Vec<(u32, i64)>;

/// `to` += `sign` times `terms`
pub(super) fn add(to: &mut Terms, terms: &[(u32, i64)], sign: i64) {
    for &(k, c) in terms {
        match to.iter_mut().find(|t| t.0 == k) {
            Some(t) => t.1 += sign * c,
            None => to.push((k, sign * c)),
        }
    }
    to.retain(|t| t.1 != 0);
}

/// All integer solutions of homogeneous linear relations.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Relations {
    /// Each unknown as a sum of free ones.
    expressions: Vec<Terms>,
    /// Number of free unknowns.
    pub free: usize,
}

impl Relations {
    /// Solves `relations`, sums that have to vanish, among `count` unknowns: Euclid's algorithm on the coefficients of each finds
    /// an unknown to do without.
    pub fn new(count: usize, relations: &[Terms]) -> Self {
        let mut expressions: Vec<Terms> = (0..count as u32).map(|k| vec![(k, 1)]).collect();
        for relation in relations {
            let mut left = Terms::new();
            for &(k, c) in relation {
                add(&mut left, &expressions[k as usize], c);
            }
            // x_k = x'_k - sum of q_j x_j leaves the remainders c_j - q_j c_k of the others' coefficients.
            while let Some(&(k, c)) = left.iter().min_by_key(|t| (t.1.abs(), t.0)) {
                let quotients: Terms =
                    left.iter().filter(|t| t.0 != k).map(|&(j, other)| (j, other.div_euclid(c))).collect();
                left.iter_mut().filter(|t| t.0 != k).for_each(|t| t.1 = t.1.rem_euclid(c));
                left.retain(|t| t.1 != 0);
                let last = left.len() == 1;
                for expression in &mut expressions {
                    let Some(place) = expression.iter().position(|t| t.0 == k) else { continue };
                    let coefficient = expression[place].1;
                    add(expression, &quotients, -coefficient);
                    if last {
                        expression.retain(|t| t.0 != k);
                    }
                }
                if last {
                    break;
                }
            }
        }
        let mut numbers: BTreeMap<u32, u32> = expressions.iter().flatten().map(|t| (t.0, 0)).collect();
        numbers.values_mut().enumerate().for_each(|(i, number)| *number = i as u32);
        expressions.iter_mut().flatten().for_each(|t| t.0 = numbers[&t.0]);
        Self { expressions, free: numbers.len() }
    }

    /// A sum of the unknowns as a sum of the free ones.
    pub fn expand(&self, terms: &[(u32, i64)]) -> Terms {
        let mut sum = Terms::new();
        terms.iter().for_each(|&(k, c)| add(&mut sum, &self.expressions[k as usize], c));
        sum
    }

    /// Values of all unknowns.
    pub fn values(&self, free: &[i64]) -> Vec<i64> {
        self.expressions.iter().map(|terms| terms.iter().map(|&(k, c)| c * free[k as usize]).sum()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(terms: &[(u32, i64)], values: &[i64]) -> i64 {
        terms.iter().map(|&(k, c)| c * values[k as usize]).sum()
    }

    #[test]
    fn every_solution_is_found_and_nothing_else() {
        let relations = [vec![(0, 2), (1, -3)], vec![(1, 1), (2, 4), (3, -6)], vec![(4, 5)]];
        let solved = Relations::new(5, &relations);
        assert_eq!(solved.free, 2);
        let mut reached = std::collections::BTreeSet::new();
        for a in -40..=40 {
            for b in -40..=40 {
                let values = solved.values(&[a, b]);
                assert!(relations.iter().all(|r| sum(r, &values) == 0));
                reached.insert(values);
            }
        }
        // All small solutions: x_0 = 3 k, x_1 = 2 k, k + 2 x_2 = 3 x_3.
        for k in -3i64..=3 {
            for x in (-3i64..=3).filter(|x| (2 * k + 4 * x) % 6 == 0) {
                assert!(reached.contains(&vec![3 * k, 2 * k, x, (2 * k + 4 * x) / 6, 0]), "{k} {x}");
            }
        }
    }

    #[test]
    fn relations_that_say_nothing_new_change_nothing() {
        let plain = Relations::new(3, &[vec![(0, 1), (2, -1)]]);
        assert_eq!(plain, Relations::new(3, &[vec![(0, 1), (2, -1)], vec![], vec![(2, 3), (0, -3)]]));
        assert_eq!(plain.expand(&[(0, 1), (1, 2), (2, 1)]).len(), 2);
        assert_eq!(Relations::new(2, &[]).values(&[7, 9]), [7, 9]);
    }
}
