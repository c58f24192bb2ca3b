//! How large the cells of a map shall be: as nearly equal as the field's directions allow.

// Corners and families are numbers that index several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::map_elements::Element;
use super::seams::{NONE, Seams};

/// Cells per length that the map has and shall have, for each triangle and family.
pub(super) struct Sizes {
    /// Cells per length of a map of equal cells.
    unit: f64,
    /// What the map shall have: the geometric mean of equal sizes and what the directions allow.
    pub wanted: Vec<[f64; 2]>,
    /// What the map so far has, smoothed: angles between isolines and field are taken as slopes across over this.
    pub reached: Vec<[f64; 2]>,
    /// Factor of the weight of sizes, 1 or more.
    pub stiffness: Vec<[f64; 2]>,
}

/// Least and largest size that counts as reached, over equal ones.
const REACHED: [f64; 2] = [0.15, 6.0];
/// Passes over the triangles that smooth what is reached.
const SMOOTHING: usize = 3;
/// Least slope, over that of equal sizes, to which a stretched map's stiffness answers.
const LEAST_SLOPE: f64 = 0.05;

impl Sizes {
    /// Equal sizes of `unit` cells per length on `count` triangles.
    pub fn equal(count: usize, unit: f64) -> Self {
        Self { unit, wanted: vec![[unit; 2]; count], reached: vec![[unit; 2]; count], stiffness: vec![[1.0; 2]; count] }
    }

    /// Follows a map of these sizes, given by the coordinates of each triangle's corners.
    ///
    /// Where the map is so stretched that its slope x along the family is below that of equal sizes, the stiffness is ((1 + 1 / x) / 2)^2: the energy
    /// of sizes becomes about ((x - 1 / x) / 2)^2, which does not let a coordinate stand still or turn back. Where one stands still that
    /// follows any direction at no cost, and its isolines run anywhere.
    pub fn adapt(&mut self, elements: &[Element], seams: &Seams, corners: &[[[f64; 2]; 3]]) {
        let slope = |t: usize, family: usize| -> f64 {
            (0..3).map(|i| elements[t].along[family][i] * corners[t][i][family]).sum::<f64>() / self.unit
        };
        let slopes: Vec<[f64; 2]> = (0..elements.len()).map(|t| [0, 1].map(|family| slope(t, family))).collect();
        let mut logs: Vec<[f64; 2]> = slopes.iter().map(|s| s.map(|x| x.clamp(REACHED[0], REACHED[1]).ln())).collect();
        for _ in 0..SMOOTHING {
            let before = logs.clone();
            for t in 0..logs.len() {
                let mut sum = before[t];
                let mut count = 1.0;
                for h in 3 * t..3 * t + 3 {
                    let other = seams.twin[h];
                    if other != NONE {
                        let there = before[other as usize / 3];
                        let odd = seams.turn[h] % 2 == 1;
                        sum[0] += there[usize::from(odd)];
                        sum[1] += there[usize::from(!odd)];
                        count += 1.0;
                    }
                }
                logs[t] = sum.map(|s| s / count);
            }
        }
        self.reached = logs.iter().map(|log| log.map(|l| self.unit * l.exp())).collect();
        self.wanted = logs.iter().map(|log| log.map(|l| self.unit * (0.5 * l).exp())).collect();
        let stiffness = |x: f64| (0.5 + 0.5 / x.clamp(LEAST_SLOPE, 1.0)).powi(2);
        self.stiffness = slopes.iter().map(|s| s.map(stiffness)).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Control;
    use crate::field::map_elements::elements;
    use crate::field::test_surfaces::graph;
    use crate::field::{DirectionConstraint, FieldOptions, conjugate_field};
    use crate::surface::SurfaceMesh;
    use nalgebra::Vector3;

    #[test]
    fn a_stretched_map_is_stiff_and_half_forgiven() {
        let mesh = SurfaceMesh::new(&graph(|_, _| 0.0), [8, 8]).unwrap();
        let along = DirectionConstraint { triangle: 20, direction: Vector3::x(), weight: f64::INFINITY };
        let field = conjugate_field(mesh, None, &[along], &FieldOptions::default(), &Control::default()).unwrap();
        let seams = Seams::new(&field, 0.0, 0.0);
        let elements = elements(&field, &seams).unwrap();
        let unit = 3.0;
        // Coordinates along the combed directions of a map with `slopes` times as many cells per length.
        let adapted = |slopes: [f64; 2]| {
            let corners: Vec<[[f64; 2]; 3]> = (0..elements.len())
                .map(|t| {
                    let along = [0, 1].map(|i| field.layout_direction(t as u32, (seams.name[t] + i) as usize));
                    let place = |v: u32| field.mesh.position(v).coords;
                    field.mesh.triangles[t].map(|v| [0, 1].map(|i| unit * slopes[i] * place(v).dot(&along[i])))
                })
                .collect();
            let mut sizes = Sizes::equal(elements.len(), unit);
            sizes.adapt(&elements, &seams, &corners);
            sizes
        };
        // Which family runs along x is the field's affair: both are asked.
        for (slopes, wanted, reached, stiffness) in [
            ([1.0, 1.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]),
            ([0.25, 2.25], [0.5, 1.5], [0.25, 2.25], [6.25, 1.0]),
            ([4.0, -1.0], [2.0, 0.15f64.sqrt()], [4.0, 0.15], [1.0, 110.25]),
        ] {
            let sizes = adapted(slopes);
            for t in 0..elements.len() {
                for i in 0..2 {
                    assert!((sizes.wanted[t][i] - unit * wanted[i]).abs() < 1e-6);
                    assert!((sizes.reached[t][i] - unit * reached[i]).abs() < 1e-6);
                    assert!((sizes.stiffness[t][i] - stiffness[i]).abs() < 1e-6);
                }
            }
        }
    }
}
