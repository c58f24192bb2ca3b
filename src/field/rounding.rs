//! Rounding the integers of a map, one after another, on the dense Schur complement that the free unknowns leave.

use nalgebra::{DMatrix, DVector};

/// The minimum over the free unknowns x as a function of the integers y: x = scale x_0 - W y, and the quadratic in y.
#[derive(Default)]
pub(super) struct Reduced {
    pub free: usize,
    /// x_0, then the columns of W.
    pub columns: Vec<f64>,
    pub schur: DMatrix<f64>,
    pub right: DVector<f64>,
}

impl Reduced {
    /// The minimum over real y at scale 1.
    pub fn relaxed(&self) -> Vec<f64> {
        let all: Vec<usize> = (0..self.right.len()).collect();
        self.minimum(1.0, &all, &vec![0.0; all.len()])
    }

    /// The minimum over the `open` entries of y, the others kept.
    fn minimum(&self, scale: f64, open: &[usize], y: &[f64]) -> Vec<f64> {
        let mut y = y.to_vec();
        if open.is_empty() {
            return y;
        }
        let is_open: Vec<bool> = (0..y.len()).map(|i| open.contains(&i)).collect();
        let largest = self.schur.diagonal().iter().fold(0.0f64, |a, &b| a.max(b));
        let matrix = DMatrix::from_fn(open.len(), open.len(), |i, j| {
            // A trace of regularization, for integers that nothing determines.
            self.schur[(open[i], open[j])] + if i == j { 1e-13 * largest + f64::MIN_POSITIVE } else { 0.0 }
        });
        let right = DVector::from_fn(open.len(), |i, _| {
            let fixed: f64 = (0..y.len()).filter(|&k| !is_open[k]).map(|k| self.schur[(open[i], k)] * y[k]).sum();
            scale * self.right[open[i]] - fixed
        });
        let solved = matrix.clone().cholesky().map(|c| c.solve(&right)).or_else(|| matrix.lu().solve(&right));
        for (i, &k) in open.iter().enumerate() {
            y[k] = solved.as_ref().map_or(0.0, |s| s[i]);
        }
        y
    }

    /// Rounds one integer after another, the most certain first, the others following.
    pub fn rounded(&self, scale: f64) -> Vec<f64> {
        let mut open: Vec<usize> = (0..self.right.len()).collect();
        let mut y = vec![0.0; open.len()];
        while !open.is_empty() {
            y = self.minimum(scale, &open, &y);
            let off: Vec<f64> = y.iter().map(|x| (x - x.round()).abs()).collect();
            let best = open.iter().copied().min_by(|&a, &b| off[a].total_cmp(&off[b])).expect("some are open");
            // All that are certain enough go at once.
            open.retain(|&k| {
                let take = k == best || off[k] < 0.02;
                if take {
                    y[k] = y[k].round();
                }
                !take
            });
        }
        y
    }

    /// Free unknowns, then y.
    pub fn solution(&self, scale: f64, y: &[f64]) -> Vec<f64> {
        let n = self.free;
        let mut solution: Vec<f64> = self.columns[..n].iter().map(|x| scale * x).collect();
        for (k, &value) in y.iter().enumerate() {
            if value != 0.0 {
                let column = &self.columns[n * (k + 1)..n * (k + 2)];
                solution.iter_mut().zip(column).for_each(|(x, w)| *x -= w * value);
            }
        }
        solution.extend_from_slice(y);
        solution
    }
}
