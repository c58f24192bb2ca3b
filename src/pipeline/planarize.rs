//! The last stage alone: a host's own polygons, made planar.

use super::mesh::{BorderHold, MeshPatch, MeshResult};
use super::report::Report;
use super::session::{Session, timed};
use super::surface::SurfaceResult;
use crate::control::Control;
use crate::error::Error;
use crate::mesh::{PanelMesh, PlanarizeInput, PlanarizeOptions, border_vertices, check, grid_triples, planarize};
use crate::surface::SurfaceProjector;

/// What a host may ask of [`planarize_panels`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PanelOptions {
    /// What the vertices on the border of the mesh may do.
    pub hold: BorderHold,
    /// Whether a mesh whose planarity misses the target is an error.
    pub strict: bool,
    /// Target, allowed deviation and weights.
    pub planarize: PlanarizeOptions,
}

/// Moves the vertices of a host's own mesh until every face is planar.
///
/// - `mesh`: any polygons, manifold or not; world frame, any unit.
/// - `surface`: a surface of one patch to stay on, whose border the mesh's border vertices keep to; `None`: the mesh stays
///   close to itself as it is given, and to its own border.
/// - `pins`: vertices that do not move at all.
///
/// The result is one patch. Without a surface its border length is 0.
///
/// # Errors
/// [`Error::Argument`] for options out of range, for a surface of several patches and for a pin that is no vertex;
/// [`Error::NotPlanar`] if asked to be strict; else as [`planarize`]; [`Error::Cancelled`].
pub fn planarize_panels(
    session: &mut Session,
    mesh: &PanelMesh,
    surface: Option<&SurfaceResult>,
    pins: &[u32],
    options: &PanelOptions,
) -> Result<MeshResult, Error> {
    session.run(|_, control| run(mesh, surface, pins, options, control))
}

fn run(
    mesh: &PanelMesh,
    surface: Option<&SurfaceResult>,
    pins: &[u32],
    options: &PanelOptions,
    control: &Control,
) -> Result<MeshResult, Error> {
    control.step("planarize", 0.0)?;
    let surface = match surface.map(|s| s.patches.as_slice()) {
        None => None,
        Some([patch]) => Some(&patch.surface),
        Some(patches) => {
            let value = format!("{} patches", patches.len());
            return Err(Error::Argument { name: "surface", value, expected: "a surface of one patch" });
        }
    };
    if let Some(pin) = pins.iter().find(|&&v| v as usize >= mesh.vertices.len()) {
        let value = pin.to_string();
        return Err(Error::Argument { name: "pins", value, expected: "numbers of vertices" });
    }
    let outline = border_vertices(mesh);
    let mut pins = pins.to_vec();
    if options.hold == BorderHold::Pinned {
        pins.extend_from_slice(&outline);
    }
    let held: &[u32] = if options.hold == BorderHold::Free { &[] } else { &outline };
    let projector = surface.map(SurfaceProjector::new);
    let polylines = grid_triples(mesh, |_| false);
    let mut report = Report { patches: 1, ..Report::new() };
    let planarized = timed(&mut report.time_ms.planarize, || {
        let input = PlanarizeInput {
            reference: projector.as_ref().map(|p| p as _),
            border: held,
            pins: &pins,
            polylines: &polylines,
            ..PlanarizeInput::new(mesh)
        };
        planarize(&input, &options.planarize, control)
    })?;
    if options.strict && !planarized.is_planar {
        let (reached, rounds) = (planarized.planarity_max(), planarized.rounds);
        return Err(Error::NotPlanar { reached, target: options.planarize.target, rounds });
    }
    let irregular = irregular_vertices(mesh);
    let patch = MeshPatch::new(planarized, surface, &outline, held, irregular);
    control.step("planarize", 1.0)?;
    Ok(MeshResult::new(vec![patch], report))
}

/// Inner vertices where another number than four edges meets, ascending.
fn irregular_vertices(mesh: &PanelMesh) -> Vec<u32> {
    let on_border = check(mesh).on_border;
    let mut degree = vec![0u32; mesh.vertices.len()];
    crate::mesh::edges(mesh).into_iter().flatten().for_each(|v| degree[v as usize] += 1);
    let is_irregular = |v: &u32| !on_border[*v as usize] && !matches!(degree[*v as usize], 0 | 4);
    (0..mesh.vertices.len() as u32).filter(is_irregular).collect()
}
