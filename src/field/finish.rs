//! What is told of a finished field.

use super::conjugate_field::{FieldDiagnostics, Singularity};
use super::layout::directions;
use super::matching::{Cross, match_edges};
use super::problem::{Problem, nearest_direction};
use super::smoothness::weighted_energy;
use nalgebra::Vector3;

/// What [`Problem::finish`] adds to the mesh.
pub(super) struct Finished {
    pub directions: Vec<[Vector3<f64>; 2]>,
    pub matching: Vec<u8>,
    pub singularities: Vec<Singularity>,
    pub diagnostics: FieldDiagnostics,
}

impl Problem<'_> {
    /// Directions, matching, singularities and measures of the finished crosses.
    pub fn finish(&self, crosses: &[Cross], jumps: &[i32], iterations: usize) -> Finished {
        let directions = directions(self.frames, crosses);
        let (matching, singularities) = match_edges(self.mesh, self.edges, |e| {
            let (k, rotation, _) = self.across(e, crosses, Some(jumps));
            (k, rotation)
        });
        let mut diagnostics = FieldDiagnostics {
            crossing_min_deg: 90.0,
            smoothness_energy: weighted_energy(self.edges, self.frames, &directions, self.edge_weights),
            floor_triangles: self.floor_triangles.clone(),
            iterations,
            ..FieldDiagnostics::default()
        };
        let mut curved = 0.0;
        for (t, cross) in crosses.iter().enumerate() {
            diagnostics.crossing_min_deg = diagnostics.crossing_min_deg.min(cross.crossing().to_degrees());
            if self.flat[t] {
                diagnostics.flat_triangles.push(t as u32);
                continue;
            }
            let residual = self.forms[t].residual(cross).abs();
            diagnostics.conjugacy_mean += residual * self.frames.areas[t];
            diagnostics.conjugacy_max = diagnostics.conjugacy_max.max(residual);
            curved += self.frames.areas[t];
        }
        if curved > 0.0 {
            diagnostics.conjugacy_mean /= curved;
        }
        let total: f64 = self.constraint_angles.iter().map(|c| c.2).sum();
        for &(t, angle, weight) in &self.constraint_angles {
            let difference = nearest_direction(&crosses[t], angle).1.abs().to_degrees();
            diagnostics.constraint_angle_deg += difference * weight / total;
        }
        Finished { directions, matching, singularities, diagnostics }
    }
}
