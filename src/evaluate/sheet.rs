//! The best, the median and the worst cases, to be looked at.

use super::{Case, Split};
use crate::control::Control;
use crate::datagen::Options;
use crate::error::Error;
use crate::picture::{CaseRow, Picture, case_sheet};
use crate::pipeline::{
    FieldOptions, MeshOptions, Session, SurfaceOptions, extract_pq_mesh, sketch_to_cdf, sketch_to_surface,
};
use crate::surface::SurfaceMesh;

/// Where a case lies among all by D_c.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rank {
    /// Smallest D_c.
    Best,
    /// About the median.
    Median,
    /// Largest D_c.
    Worst,
}

/// Rows of a sheet.
const ROWS: usize = 10;
/// Width of a sheet, pixels.
const WIDTH: usize = 1400;
/// Cells along each side of a surface in the picture.
const CELLS: usize = 60;

/// The ten measured cases of that rank, D_c rising, those with failures left out; fewer if there are not as many.
fn chosen(cases: &[Case], rank: Rank) -> Vec<&Case> {
    let mut ranked: Vec<(&Case, f64)> =
        cases.iter().filter(|c| c.failed.is_none()).filter_map(|c| Some((c, *c.values.get("d_c")?))).collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    let count = ranked.len();
    let first = match rank {
        Rank::Best => 0,
        Rank::Median => (count / 2).saturating_sub(ROWS / 2),
        Rank::Worst => count.saturating_sub(ROWS),
    };
    ranked.into_iter().skip(first).take(ROWS).map(|(case, _)| case).collect()
}

/// Runs the chosen cases again and draws them, see [`case_sheet`].
///
/// # Errors
/// Those of the pipeline, which took these cases before; [`Error::Cancelled`].
pub fn sheet(
    session: &mut Session,
    split: Split,
    cases: &[Case],
    rank: Rank,
    options: &Options,
    control: &Control,
) -> Result<Picture, Error> {
    let chosen = chosen(cases, rank);
    let mut rows = Vec::with_capacity(chosen.len());
    for (k, case) in chosen.iter().enumerate() {
        control.step("pictures", k as f64 / chosen.len() as f64)?;
        let Ok(truth) = split.sample(case.index, options) else { continue };
        let surface = sketch_to_surface(session, &truth.sketch, &SurfaceOptions::default())?;
        let field = sketch_to_cdf(session, Some(&truth.sketch), &surface, &FieldOptions::default())?;
        let mesh = extract_pq_mesh(session, &field, &MeshOptions::default())?.patches.swap_remove(0);
        let (frame, view) = (truth.patch.frame, truth.sketch.view);
        let actual = truth.surface.mapped(|p| view.camera_to_world(&frame.point_to_camera(p)));
        let value = |key: &str| case.values.get(key).copied().unwrap_or(f64::NAN);
        // Without feature lines there is no D_f.
        let d_f = case.values.get("d_f_deg").map_or(String::new(), |angle| format!(" D_f {angle:.1} deg,"));
        rows.push(CaseRow {
            label: format!(
                "seed {}, {}{}, {} depth samples: D_c {:.3}, {:.3} sheared, D_n {:.1} deg,{d_f} P_max {:.0e}",
                case.seed,
                case.family,
                if case.noisy { ", noisy" } else { "" },
                case.samples,
                value("d_c"),
                value("d_c_shear"),
                value("d_n_deg"),
                value("p_max"),
            ),
            sketch: truth.sketch,
            surface: SurfaceMesh::new(&surface.patches[0].surface, [CELLS; 2])?,
            mesh: mesh.mesh,
            planarity: mesh.planarity,
            irregular: mesh.irregular,
            truth: SurfaceMesh::new(&actual, [CELLS; 2])?,
        });
    }
    control.step("pictures", 1.0)?;
    Ok(case_sheet(&rows, WIDTH))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn ranks_leave_failures_out() {
        let case = |index: u64| Case {
            index,
            failed: (index == 7).then(|| "refused".into()),
            values: BTreeMap::from([("d_c", (index as f64 - 12.0).abs())]),
            ..Case::default()
        };
        let cases: Vec<Case> = (0..31).map(case).collect();
        let best = chosen(&cases, Rank::Best);
        assert_eq!((best.len(), best[0].index), (10, 12));
        assert!(best.iter().all(|c| c.index != 7));
        assert_eq!(chosen(&cases, Rank::Worst)[9].index, 30);
        assert_eq!(chosen(&cases[..3], Rank::Median).len(), 3);
    }
}
