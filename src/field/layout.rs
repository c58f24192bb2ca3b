//! The layout: crosses whose conjugacy is soft, and their topology, from coarse to fine.

use super::border::Corner;
use super::coarse::Coarse;
use super::conjugate::SecondForm;
use super::conjugate_field::Singularity;
use super::matching::Cross;
use super::problem::{Conjugacy, Problem};
use super::smooth::{DirectionConstraint, FieldOptions};
use super::smoothness::edge_weights;
use super::system::TriangleSystem;
use super::topology::{EdgeTopology, TriangleFrames};
use crate::control::Control;
use crate::error::Error;
use crate::surface::SurfaceMesh;
use nalgebra::Vector3;

/// Most cells along a side of the mesh on which the layout finds its topology.
const BASE_CELLS: usize = 24;
/// How much more conjugacy weighs on finer meshes.
const FINE_CONJUGACY: f64 = 4.0;
/// Most Gauss-Newton iterations of the layout on each finer mesh.
const FINE_ITERATIONS: usize = 4;

/// A triangulated patch with what is derived from it.
pub(super) struct Patch<'a> {
    pub mesh: &'a SurfaceMesh,
    pub edges: &'a EdgeTopology,
    pub frames: &'a TriangleFrames,
    pub forms: &'a [SecondForm],
    /// Corners of the border that the field follows.
    pub corners: &'a [Corner],
    /// See [`edge_weights`].
    pub weights: &'a [f64],
}

/// Crosses whose conjugacy is soft, and the quarter turns across edges that their topology consists of.
pub(super) struct Layout {
    pub crosses: Vec<Cross>,
    pub jumps: Vec<i32>,
    pub singularities: Vec<Singularity>,
    pub iterations: usize,
}

/// The smoothest crosses with conjugacy as a soft term.
///
/// A mesh finer than [`BASE_CELLS`] starts from the layout on one of half the resolution, keeps its topology, and needs a few iterations only.
/// With `fixed` singularities the quarter turns are moved until the crosses have those.
pub(super) fn layout(
    patch: &Patch,
    guess: Option<&[[Vector3<f64>; 2]]>,
    constraints: &[DirectionConstraint],
    fixed: Option<&[Singularity]>,
    options: &FieldOptions,
    control: &Control,
) -> Result<Layout, Error> {
    let base = patch.mesh.cells.iter().all(|&n| n <= BASE_CELLS);
    // Neither bumps nor parallels of lines shall make singularities: only with the topology settled does conjugacy weigh more, and do
    // parallels weigh at all.
    let weighed = if base {
        FieldOptions { parallel_weight: 0.0, ..*options }
    } else {
        FieldOptions { conjugacy_weight: FINE_CONJUGACY * options.conjugacy_weight, ..*options }
    };
    let problem = Problem::new(patch, Conjugacy::Soft, guess, constraints, &weighed)?;
    if base {
        let mut system = TriangleSystem::new(patch.edges, patch.mesh.triangles.iter().map(|_| 2))?;
        let crosses = problem.initial(&mut system, control)?;
        control.step("field", 0.3)?;
        if problem.freedom.iter().any(|f| f.unknowns() != 2) {
            system = problem.system()?;
        }
        let (crosses, jumps, iterations) = match fixed {
            Some(fixed) => {
                let jumps = problem.prescribed_jumps(&crosses, fixed);
                let most = options.iterations;
                let (crosses, spent) = problem.optimize(&mut system, crosses, Some(&jumps), most, control)?;
                (crosses, jumps, spent)
            }
            None => problem.settle(&mut system, crosses, control)?,
        };
        let singularities = problem.singularities(&crosses, &jumps);
        return Ok(Layout { crosses, jumps, singularities, iterations });
    }
    let coarse = Coarse::new(patch.mesh, guess, constraints)?;
    let edges = EdgeTopology::new(coarse.mesh.points.len(), &coarse.mesh.triangles)?;
    let frames = TriangleFrames::new(&coarse.mesh, &edges)?;
    let forms = coarse.forms(patch.frames, patch.forms, &frames);
    let corners = coarse.corners(patch.mesh.cells, patch.corners);
    let weights = edge_weights(&coarse.mesh, &edges);
    let below = Patch {
        mesh: &coarse.mesh,
        edges: &edges,
        frames: &frames,
        forms: &forms,
        corners: &corners,
        weights: &weights,
    };
    let fixed_below = fixed.map(|fixed| coarse.singularities(patch.mesh.cells, fixed));
    let Layout { crosses, singularities, iterations, .. } =
        layout(&below, coarse.guess.as_deref(), &coarse.constraints, fixed_below.as_deref(), options, control)?;
    let start: Vec<Cross> = (0..patch.mesh.triangles.len())
        .map(|t| {
            let c = coarse.triangles[t] as usize;
            let angle = |a: f64| patch.frames.angle(t, &frames.direction(c, a));
            problem.allowed(t, &Cross::from_angles(angle(crosses[c].u()), angle(crosses[c].v())))
        })
        .collect();
    let mut system = problem.system()?;
    let (jumps, most) = match fixed {
        Some(fixed) => (problem.prescribed_jumps(&start, fixed), options.iterations),
        None => (problem.bordered_jumps(&start), FINE_ITERATIONS),
    };
    let kept = match fixed {
        None if !problem.followed.is_empty() => {
            problem.prescribed_jumps(&start, &coarse.refined(patch.mesh.cells, &singularities))
        }
        _ => jumps.clone(),
    };
    let (mut crosses, mut more) = problem.optimize(&mut system, start.clone(), Some(&jumps), most, control)?;
    let mut jumps = jumps;
    if kept != jumps {
        // Where the start turns at once into the border's direction the nearest quarter turns may be others than on the mesh below.
        let (trial, spent) = problem.optimize(&mut system, start, Some(&kept), most, control)?;
        more += spent;
        if problem.cost(&trial, &kept) <= problem.cost(&crosses, &jumps) {
            (crosses, jumps) = (trial, kept);
        }
    }
    let singularities = problem.singularities(&crosses, &jumps);
    Ok(Layout { crosses, jumps, singularities, iterations: iterations + more })
}

/// Unit vectors along u and v of each cross.
pub(super) fn directions(frames: &TriangleFrames, crosses: &[Cross]) -> Vec<[Vector3<f64>; 2]> {
    crosses.iter().enumerate().map(|(t, c)| [c.u(), c.v()].map(|a| frames.direction(t, a))).collect()
}
