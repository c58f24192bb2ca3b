//! A problem on a mesh of half the resolution, on which topology is cheap.

use super::border::Corner;
use super::conjugate::SecondForm;
use super::conjugate_field::Singularity;
use super::lift::locate;
use super::smooth::DirectionConstraint;
use super::topology::TriangleFrames;
use crate::error::Error;
use crate::surface::SurfaceMesh;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Share of a soft constraint's weight that it keeps: a line crosses about half as many triangles.
const WEIGHT_SHARE: f64 = 0.5;

/// Every second grid line of a mesh, with the guess and the constraints of the triangles carried over.
pub(super) struct Coarse {
    pub mesh: SurfaceMesh,
    pub guess: Option<Vec<[Vector3<f64>; 2]>>,
    pub constraints: Vec<DirectionConstraint>,
    /// For each fine triangle the coarse one that holds its middle.
    pub triangles: Vec<u32>,
}

impl Coarse {
    /// Thins the grid of `fine`; its border stays.
    ///
    /// # Errors
    /// [`Error::Degenerate`] for a constraint on a triangle that does not exist.
    pub fn new(
        fine: &SurfaceMesh,
        guess: Option<&[[Vector3<f64>; 2]]>,
        constraints: &[DirectionConstraint],
    ) -> Result<Self, Error> {
        let mesh = fine.thinned();
        let middle = |mesh: &SurfaceMesh, t: usize| {
            let corners = mesh.triangles[t].map(|v| mesh.parameters[v as usize]);
            [0, 1].map(|k| corners.iter().map(|p| p[k]).sum::<f64>() / 3.0)
        };
        let outside = |t: usize| Error::Degenerate { reason: format!("triangle {t} lies outside its own mesh") };
        let triangles: Vec<u32> = (0..fine.triangles.len())
            .map(|t| locate(&mesh, middle(fine, t)).ok_or_else(|| outside(t)))
            .collect::<Result<_, _>>()?;
        let guess = guess
            .map(|guess| {
                let at = |t: usize| Ok(guess[locate(fine, middle(&mesh, t)).ok_or_else(|| outside(t))? as usize]);
                (0..mesh.triangles.len()).map(at).collect::<Result<Vec<_>, Error>>()
            })
            .transpose()?;
        let constraints = constraints
            .iter()
            .map(|c| {
                let triangle = triangles.get(c.triangle as usize).copied();
                let triangle = triangle.ok_or_else(|| outside(c.triangle as usize))?;
                Ok(DirectionConstraint { triangle, weight: WEIGHT_SHARE * c.weight, ..*c })
            })
            .collect::<Result<_, Error>>()?;
        Ok(Self { mesh, guess, constraints, triangles })
    }

    /// Singularities of the fine mesh, whose cells are `fine`, at the nearest inner vertices; those that meet there are added up.
    pub fn singularities(&self, fine: [usize; 2], singularities: &[Singularity]) -> Vec<Singularity> {
        let cells = self.mesh.cells;
        if cells.contains(&1) {
            return vec![];
        }
        let mut sums: BTreeMap<u32, i32> = BTreeMap::new();
        for s in singularities {
            let v = s.vertex as usize;
            let line = [v / (fine[1] + 1), v % (fine[1] + 1)];
            let [i, j] = [0, 1].map(|k| ((line[k] * cells[k] + fine[k] / 2) / fine[k]).clamp(1, cells[k] - 1));
            *sums.entry((i * (cells[1] + 1) + j) as u32).or_default() += s.index;
        }
        sums.into_iter().filter(|s| s.1 != 0).map(|(vertex, index)| Singularity { vertex, index }).collect()
    }

    /// Singularities of this mesh at their places on the fine one, whose cells are `fine`.
    pub fn refined(&self, fine: [usize; 2], singularities: &[Singularity]) -> Vec<Singularity> {
        let cells = self.mesh.cells;
        let place = |s: &Singularity| {
            let v = s.vertex as usize;
            let [i, j] = [v / (cells[1] + 1) * fine[0] / cells[0], v % (cells[1] + 1) * fine[1] / cells[1]];
            Singularity { vertex: (i * (fine[1] + 1) + j) as u32, ..*s }
        };
        singularities.iter().map(place).collect()
    }

    /// Corners of the border of the fine mesh, whose cells are `fine`, at the nearest border vertices; those that meet there are added up.
    pub fn corners(&self, fine: [usize; 2], corners: &[Corner]) -> Vec<Corner> {
        let cells = self.mesh.cells;
        let mut sums: BTreeMap<u32, i32> = BTreeMap::new();
        for corner in corners {
            let v = corner.vertex as usize;
            let line = [v / (fine[1] + 1), v % (fine[1] + 1)];
            // A line next to the border is no border.
            let [i, j] = [0, 1].map(|k| match line[k] {
                0 => 0,
                l if l == fine[k] => cells[k],
                l => ((l * cells[k] + fine[k] / 2) / fine[k]).clamp(1, cells[k].max(2) - 1),
            });
            *sums.entry((i * (cells[1] + 1) + j) as u32).or_default() += corner.turns;
        }
        sums.into_iter().map(|(vertex, turns)| Corner { vertex, turns }).collect()
    }

    /// Second forms of the coarse triangles, in their `frames`: the means of the `fine` ones over area, so that bumps are averaged, not
    /// sampled.
    pub fn forms(&self, fine_frames: &TriangleFrames, fine: &[SecondForm], frames: &TriangleFrames) -> Vec<SecondForm> {
        let mut sums = vec![(Matrix3::zeros(), 0.0); frames.len()];
        for (t, form) in fine.iter().enumerate() {
            let (sum, area) = &mut sums[self.triangles[t] as usize];
            *sum += form.tensor(&fine_frames.x[t], &fine_frames.y[t]) * fine_frames.areas[t];
            *area += fine_frames.areas[t];
        }
        let mean = |(t, (sum, area)): (usize, &(Matrix3<f64>, f64))| {
            if *area > 0.0 {
                SecondForm::of_tensor(&(sum / *area), &frames.x[t], &frames.y[t])
            } else {
                Default::default()
            }
        };
        sums.iter().enumerate().map(mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::test_surfaces::wavy;

    #[test]
    fn the_coarse_mesh_has_the_same_border_and_holds_every_fine_triangle() {
        for cells in [[10, 7], [5, 12]] {
            let fine = SurfaceMesh::new(&wavy(1), cells).unwrap();
            let constraint = DirectionConstraint { triangle: 9, direction: Vector3::x(), weight: 8.0 };
            let coarse = Coarse::new(&fine, None, &[constraint]).unwrap();
            assert_eq!(coarse.mesh.cells, cells.map(|c| c.div_ceil(2)));
            assert_eq!(coarse.mesh.parameters.first(), fine.parameters.first());
            assert_eq!(coarse.mesh.parameters.last(), fine.parameters.last());
            assert_eq!((coarse.constraints[0].triangle, coarse.constraints[0].weight), (coarse.triangles[9], 4.0));
            let mut count = vec![0; coarse.mesh.triangles.len()];
            coarse.triangles.iter().for_each(|&t| count[t as usize] += 1);
            assert!(count.iter().all(|&n| (1..=6).contains(&n)), "{count:?}");
        }
    }
}
