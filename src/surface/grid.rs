//! A surface as a grid of points with normals and quads, for drawing.

use super::nurbs::NurbsSurface;
use crate::error::Error;
use nalgebra::{Point3, Vector3};

/// Most vertices of a grid.
const MOST_VERTICES: usize = 1 << 24;
/// How far inside a side without normal, such as a pole, its normal is taken, as a share of the domain.
const INSIDE: f64 = 1e-4;

/// Samples of a surface on a regular grid of its parameters: any degree, rational or not.
///
/// Not the panels: its quads are not planar.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceGrid {
    /// Surface points, `(cells[0] + 1) * (cells[1] + 1)` of them, v running fastest.
    pub points: Vec<Point3<f64>>,
    /// Unit normals S_u x S_v, one for each point; zero where the surface has none.
    pub normals: Vec<Vector3<f64>>,
    /// Four vertex indices for each cell, counter-clockwise seen from the side of the normals; cells with v running fastest.
    pub quads: Vec<[u32; 4]>,
}

impl SurfaceGrid {
    /// Samples `surface` at the corners of `cells` equal cells in u and v; the border is on the surface's border.
    ///
    /// # Errors
    /// [`Error::Argument`] for no cells, or more than 2^24 vertices.
    pub fn new(surface: &NurbsSurface, cells: [usize; 2]) -> Result<Self, Error> {
        let [rows, columns] = cells.map(|count| count.saturating_add(1));
        if cells.contains(&0) || rows.saturating_mul(columns) > MOST_VERTICES {
            let expected = "at least one in each direction, and at most 2^24 vertices";
            return Err(Error::Argument { name: "cells", value: format!("{cells:?}"), expected });
        }
        let share = |axis: usize, i: usize| i as f64 / cells[axis] as f64;
        let [us, vs] = [0, 1].map(|axis: usize| {
            (0..=cells[axis]).map(|i| surface.knots()[axis].at_fraction(share(axis, i))).collect::<Vec<f64>>()
        });
        let samples = surface.evaluate_grid(&us, &vs);
        let normals = samples.iter().enumerate().map(|(k, sample)| {
            sample.du.cross(&sample.dv).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(|| {
                let inside = |t: f64| t.clamp(INSIDE, 1.0 - INSIDE);
                let [u, v] = surface.at_fraction(inside(share(0, k / columns)), inside(share(1, k % columns)));
                let near = surface.evaluate(u, v);
                near.du.cross(&near.dv).try_normalize(f64::MIN_POSITIVE).unwrap_or_default()
            })
        });
        let normals = normals.collect();
        let cell = |k: usize| {
            let corner = k / cells[1] * columns + k % cells[1];
            [corner, corner + columns, corner + columns + 1, corner + 1].map(|index| index as u32)
        };
        let quads = (0..cells[0] * cells[1]).map(cell).collect();
        Ok(Self { points: samples.iter().map(|sample| sample.position).collect(), normals, quads })
    }
}

#[cfg(test)]
mod tests {
    use super::super::knots::KnotVector;
    use super::*;

    /// A quarter of a cylinder of radius 1 around z, rational, S_u x S_v outwards.
    fn cylinder() -> NurbsSurface {
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let points = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let net = points.iter().flat_map(|&(x, y)| [Point3::new(x, y, 0.0), Point3::new(x, y, 1.0)]).collect();
        let knots = [KnotVector::uniform(2, 3), KnotVector::uniform(1, 2)];
        NurbsSurface::new(knots, net, Some(vec![1.0, 1.0, h, h, 1.0, 1.0])).unwrap()
    }

    #[test]
    fn a_cylinder_has_its_radius_normals_and_quads() {
        let grid = SurfaceGrid::new(&cylinder(), [7, 3]).unwrap();
        assert_eq!([grid.points.len(), grid.normals.len(), grid.quads.len()], [32, 32, 21]);
        for (p, n) in grid.points.iter().zip(&grid.normals) {
            assert!((p.x.hypot(p.y) - 1.0).abs() < 1e-14 && (n - Vector3::new(p.x, p.y, 0.0)).norm() < 1e-12);
        }
        for quad in &grid.quads {
            let [a, b, c, d] = quad.map(|k| grid.points[k as usize]);
            assert!((c - a).cross(&(d - b)).dot(&grid.normals[quad[0] as usize]) > 0.0);
        }
    }

    #[test]
    fn a_pole_takes_the_normal_beside_it() {
        // A cone: the row v = 1 is one point.
        let net = [(1.0, 0.0), (0.0, 1.0)].map(|(x, y)| [Point3::new(x, y, 0.0), Point3::new(0.0, 0.0, 1.0)]);
        let cone = NurbsSurface::uniform(1, [2, 2], net.concat()).unwrap();
        let grid = SurfaceGrid::new(&cone, [2, 2]).unwrap();
        assert!(grid.normals.iter().all(|n| (n.norm() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn impossible_counts_are_errors() {
        for cells in [[0, 3], [3, 0], [usize::MAX, 1], [1 << 13, 1 << 13]] {
            assert!(matches!(SurfaceGrid::new(&cylinder(), cells), Err(Error::Argument { .. })));
        }
    }
}
