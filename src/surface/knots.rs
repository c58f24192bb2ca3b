//! Knot vectors and B-spline basis functions.

use crate::error::Error;

/// Highest degree that the library accepts.
pub const MAX_DEGREE: usize = 5;

/// A valid, clamped, non-decreasing knot vector of n + degree + 1 entries.
///
/// Rhino stores the same vector without its first and last entry, see [`KnotVector::rhino`].
#[derive(Clone, Debug, PartialEq)]
pub struct KnotVector {
    degree: usize,
    knots: Vec<f64>,
}

/// The degree + 1 basis functions that do not vanish at a parameter, with their first two derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Basis {
    /// Index of the first control point that takes part.
    pub first: usize,
    /// `values[k][i]`: k-th derivative of the basis function `first + i`.
    pub values: [[f64; MAX_DEGREE + 1]; 3],
}

impl KnotVector {
    /// Checks and takes a textbook knot vector.
    ///
    /// # Errors
    /// [`Error::Nurbs`] if the degree is not 1 to 5, the knots decrease, are not finite, are not clamped at both ends, or an
    /// interior knot is repeated more than `degree` times.
    pub fn new(degree: usize, knots: Vec<f64>) -> Result<Self, Error> {
        let fail = |reason: String| Err(Error::Nurbs { reason });
        if degree == 0 || degree > MAX_DEGREE {
            return fail(format!("degree is {degree}, expected 1 to {MAX_DEGREE}"));
        }
        if knots.len() < 2 * (degree + 1) {
            return fail(format!("{} knots are too few for degree {degree}", knots.len()));
        }
        if let Some(i) = knots.iter().position(|k| !k.is_finite()) {
            return fail(format!("knot {i} is not finite"));
        }
        if let Some(i) = knots.windows(2).position(|w| w[0] > w[1]) {
            return fail(format!("knots decrease after knot {i}"));
        }
        let last = knots.len() - 1;
        if knots[0] != knots[degree] || knots[last] != knots[last - degree] || knots[0] == knots[last] {
            return fail("the knot vector is not clamped: its first and its last degree + 1 knots must agree".into());
        }
        if let Some(i) = (1..last - degree).find(|&i| knots[i] == knots[i + degree]) {
            return fail(format!("knot {i} is repeated more than {degree} times"));
        }
        Ok(Self { degree, knots })
    }

    /// The clamped uniform knot vector of `count` control points over [0, 1].
    ///
    /// # Panics
    /// If `count` is at most `degree`, or the degree is not 1 to 5.
    pub fn uniform(degree: usize, count: usize) -> Self {
        assert!((1..=MAX_DEGREE).contains(&degree) && count > degree, "no such uniform knot vector");
        let spans = count - degree;
        let knots =
            (0..count + degree + 1).map(|i| (i.saturating_sub(degree)).min(spans) as f64 / spans as f64).collect();
        Self { degree, knots }
    }

    /// Takes Rhino's n + degree - 1 knots.
    ///
    /// # Errors
    /// As [`KnotVector::new`].
    pub fn from_rhino(degree: usize, knots: &[f64]) -> Result<Self, Error> {
        let (Some(first), Some(last)) = (knots.first(), knots.last()) else {
            return Err(Error::Nurbs { reason: "no knots".into() });
        };
        let full = std::iter::once(*first).chain(knots.iter().copied()).chain(std::iter::once(*last)).collect();
        Self::new(degree, full)
    }

    /// The n + degree - 1 knots that Rhino and openNURBS store: without the first and last entry.
    pub fn rhino(&self) -> &[f64] {
        &self.knots[1..self.knots.len() - 1]
    }

    /// Polynomial degree, 1 to 5.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// All n + degree + 1 knots.
    pub fn knots(&self) -> &[f64] {
        &self.knots
    }

    /// Number of control points n.
    pub fn count(&self) -> usize {
        self.knots.len() - self.degree - 1
    }

    /// First and last parameter.
    pub fn domain(&self) -> [f64; 2] {
        [self.knots[0], self.knots[self.knots.len() - 1]]
    }

    /// Parameter at the fraction `t` in [0, 1] of the domain.
    pub fn at_fraction(&self, t: f64) -> f64 {
        let [a, b] = self.domain();
        a + (b - a) * t
    }

    /// Greville abscissae: the mean of the `degree` inner knots of each basis function, one parameter a control point.
    ///
    /// Control values that are linear in them give a linear function.
    pub fn greville(&self) -> Vec<f64> {
        let p = self.degree;
        (0..self.count()).map(|i| self.knots[i + 1..=i + p].iter().sum::<f64>() / p as f64).collect()
    }

    /// The distinct knots: ends of the polynomial pieces, increasing.
    pub fn breaks(&self) -> Vec<f64> {
        let mut breaks = self.knots.clone();
        breaks.dedup();
        breaks
    }

    /// Basis functions and their first two derivatives at `t`, which is clamped to the domain.
    pub fn basis(&self, t: f64) -> Basis {
        let p = self.degree;
        let n = self.count();
        let [start, end] = self.domain();
        let t = t.clamp(start, end);
        // The last span is closed on the right.
        let span = self.knots[p + 1..n].partition_point(|&k| k <= t) + p;
        let knots = &self.knots;

        // Triangular table of the basis functions of every degree up to p (Cox-de Boor), kept for the derivatives.
        let mut table = [[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1];
        table[0][0] = 1.0;
        for d in 1..=p {
            for i in 0..=d {
                // Function number span - d + i of degree d.
                let index = span + i - d;
                let mut value = 0.0;
                if i > 0 {
                    let width = knots[index + d] - knots[index];
                    if width > 0.0 {
                        value += (t - knots[index]) / width * table[d - 1][i - 1];
                    }
                }
                if i < d {
                    let width = knots[index + d + 1] - knots[index + 1];
                    if width > 0.0 {
                        value += (knots[index + d + 1] - t) / width * table[d - 1][i];
                    }
                }
                table[d][i] = value;
            }
        }
        let mut values = [[0.0; MAX_DEGREE + 1]; 3];
        values[0] = table[p];
        // N'_{i,d} = d (N_{i,d-1} / (k_{i+d} - k_i) - N_{i+1,d-1} / (k_{i+d+1} - k_{i+1})), twice for the second derivative.
        let differentiate = |lower: &[f64; MAX_DEGREE + 1], d: usize| {
            let mut result = [0.0; MAX_DEGREE + 1];
            for (i, slot) in result.iter_mut().enumerate().take(d + 1) {
                let index = span + i - d;
                if i > 0 {
                    *slot += d as f64 * lower[i - 1] / (knots[index + d] - knots[index]);
                }
                if i < d {
                    *slot -= d as f64 * lower[i] / (knots[index + d + 1] - knots[index + 1]);
                }
            }
            result
        };
        values[1] = differentiate(&table[p - 1], p);
        if p >= 2 {
            values[2] = differentiate(&differentiate(&table[p - 2], p - 1), p);
        }
        Basis { first: span - p, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_sums_to_one_and_derivatives_match_finite_differences() {
        for degree in 1..=MAX_DEGREE {
            let knots = KnotVector::uniform(degree, degree + 6);
            for i in 0..=40 {
                let t = i as f64 / 40.0 * 0.998 + 0.0011;
                let basis = knots.basis(t);
                let sum: f64 = basis.values[0].iter().sum();
                assert!((sum - 1.0).abs() < 1e-12);
                let h = 1e-6;
                let (a, b) = (knots.basis(t - h), knots.basis(t + h));
                if a.first != b.first {
                    continue;
                }
                for k in 0..2 {
                    for j in 0..=degree {
                        let difference = (b.values[k][j] - a.values[k][j]) / (2.0 * h);
                        let scale = 1.0 + basis.values[k + 1][j].abs();
                        assert!((difference - basis.values[k + 1][j]).abs() < 1e-5 * scale * 100.0);
                    }
                }
            }
        }
    }

    #[test]
    fn both_knot_conventions_agree() {
        let knots = KnotVector::uniform(3, 30);
        assert_eq!((knots.knots().len(), knots.rhino().len()), (34, 32));
        assert_eq!(KnotVector::from_rhino(3, knots.rhino()).unwrap(), knots);
    }

    #[test]
    fn bad_knots_are_refused() {
        assert!(KnotVector::new(3, vec![0.0, 0.1, 0.2, 0.3, 0.7, 0.8, 0.9, 1.0]).is_err());
        assert!(KnotVector::new(1, vec![0.0, 0.0, 0.7, 0.5, 1.0, 1.0]).is_err());
        assert!(KnotVector::new(2, vec![0.0, 0.0, 0.0, f64::NAN, 1.0, 1.0, 1.0]).is_err());
        assert!(KnotVector::new(6, vec![0.0; 14]).is_err());
    }
}
