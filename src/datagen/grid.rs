//! Fast evaluation of a uniform cubic net on a regular parameter grid.

use super::NET;
use crate::surface::KnotVector;
use nalgebra::{Point3, Vector3};

/// Positions and first derivatives of a 30 x 30 cubic net at (n + 1)^2 regular parameters.
///
/// Vertex (i, j) is at `i * (n + 1) + j`, its parameters are (i / n, j / n).
pub(super) struct Grid {
    /// Cells in each direction.
    pub n: usize,
    /// S.
    pub position: Vec<Point3<f64>>,
    /// S_u.
    pub du: Vec<Vector3<f64>>,
    /// S_v.
    pub dv: Vec<Vector3<f64>>,
}

/// First control point and the values and derivatives of its four cubic basis functions, for each grid parameter.
pub(super) struct BasisTable(Vec<(usize, [[f64; 4]; 2])>);

impl BasisTable {
    /// The table for n cells.
    pub fn new(n: usize) -> Self {
        let knots = KnotVector::uniform(3, NET);
        let row = |i: usize| {
            let basis = knots.basis(i as f64 / n as f64);
            let take = |k: usize| [0, 1, 2, 3].map(|a| basis.values[k][a]);
            (basis.first, [take(0), take(1)])
        };
        Self((0..=n).map(row).collect())
    }

    /// Number of cells.
    fn cells(&self) -> usize {
        self.0.len() - 1
    }
}

impl Grid {
    /// Evaluates the `control` net (v running fastest) on the grid of `table`.
    pub fn new(control: &[Point3<f64>], table: &BasisTable) -> Self {
        let n = table.cells();
        let count = (n + 1) * (n + 1);
        let mut grid = Self {
            n,
            position: Vec::with_capacity(count),
            du: Vec::with_capacity(count),
            dv: Vec::with_capacity(count),
        };
        let mut value = [Vector3::zeros(); NET];
        let mut slope = [Vector3::zeros(); NET];
        for (first, [b, d]) in &table.0 {
            for j in 0..NET {
                let at = |a: usize| control[(first + a) * NET + j].coords;
                value[j] = at(0) * b[0] + at(1) * b[1] + at(2) * b[2] + at(3) * b[3];
                slope[j] = at(0) * d[0] + at(1) * d[1] + at(2) * d[2] + at(3) * d[3];
            }
            for (first, [b, d]) in &table.0 {
                let mix = |row: &[Vector3<f64>; NET], w: &[f64; 4]| {
                    row[*first] * w[0] + row[first + 1] * w[1] + row[first + 2] * w[2] + row[first + 3] * w[3]
                };
                grid.position.push(Point3::from(mix(&value, b)));
                grid.du.push(mix(&slope, b));
                grid.dv.push(mix(&value, d));
            }
        }
        grid
    }

    /// Signed area ratio of the projection along z: the z component of S_u x S_v.
    pub fn facing(&self, index: usize) -> f64 {
        self.du[index].x * self.dv[index].y - self.du[index].y * self.dv[index].x
    }

    /// Index of vertex (i, j).
    pub fn index(&self, i: usize, j: usize) -> usize {
        i * (self.n + 1) + j
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::NurbsSurface;

    #[test]
    fn the_grid_is_the_surface() {
        let control: Vec<_> = (0..NET * NET)
            .map(|k| {
                let (i, j) = ((k / NET) as f64, (k % NET) as f64);
                Point3::new(i + (0.3 * j).sin(), j, (0.2 * i * j).cos())
            })
            .collect();
        let surface = NurbsSurface::uniform(3, [NET, NET], control.clone()).unwrap();
        let grid = Grid::new(&control, &BasisTable::new(16));
        for i in 0..=16 {
            for j in 0..=16 {
                let truth = surface.evaluate(i as f64 / 16.0, j as f64 / 16.0);
                let k = grid.index(i, j);
                assert!((truth.position - grid.position[k]).norm() < 1e-12);
                assert!((truth.du - grid.du[k]).norm() < 1e-11);
                assert!((truth.dv - grid.dv[k]).norm() < 1e-11);
            }
        }
    }
}
