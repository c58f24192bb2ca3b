//! From a seamless map to panels.

use super::border::{self, BorderMode, Repairs};
use super::chords::{BorderSag, follow_border};
use super::isolines::arrange;
use super::panel_mesh::PanelMesh;
use super::planar_map::{Course, NONE, Place, PlanarMap};
use super::topology;
use crate::control::Control;
use crate::error::Error;
use crate::field::{ConjugateField, Density, Integrator, MapOptions, SeamlessMap};
use crate::surface::NurbsSurface;

/// Where a vertex of the mesh comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VertexKind {
    /// Inside the patch.
    Interior,
    /// On a side of the patch: v = min, u = max, v = max, u = min are numbers 0 to 3.
    Border {
        /// Number of the side.
        side: u8,
    },
    /// At a corner of the patch: the start of the side of that number, counter-clockwise.
    Corner {
        /// Number of the corner.
        corner: u8,
    },
}

/// A vertex's parameters on the surface, and its kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexOrigin {
    /// (u, v)
    pub parameter: [f64; 2],
    /// Inside, on a side, or at a corner.
    pub kind: VertexKind,
}

/// What an edge of the mesh follows.
///
/// The two families carry their names from triangle to triangle by the field's matching, from u and v of the first triangle; around
/// singularities of odd index they trade names somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeFamily {
    /// The family of the field's u.
    U,
    /// The family of the field's v.
    V,
    /// The border of the mesh.
    Border,
    /// None: the edge cuts a cell at the border in two.
    Cut,
}

/// Panels on a surface, not yet planar.
#[derive(Clone, Debug)]
pub struct ExtractedMesh {
    /// The panels; vertices lie on the surface exactly.
    pub mesh: PanelMesh,
    /// Where each vertex comes from.
    pub origins: Vec<VertexOrigin>,
    /// Undirected edges, smaller vertex first, sorted.
    pub edges: Vec<[u32; 2]>,
    /// What each edge follows.
    pub families: Vec<EdgeFamily>,
    /// Inner vertices with other than four edges, cuts not counted.
    pub irregular: Vec<u32>,
    /// What had to be repaired.
    pub repairs: Repairs,
    /// Whether the mesh covers the whole surface; false in the interior mode.
    pub covers: bool,
}

/// How [`extract`] makes panels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtractOptions {
    /// What happens at the border.
    pub border: BorderMode,
    /// Shortest edge that is left at the border, in cells.
    pub shortest_border_edge: f64,
    /// Smallest panel that is left at the border, in cells.
    pub smallest_panel: f64,
    /// Farthest that an edge on the border strays from it; nodes on the border are added until it holds.
    pub border_sag: BorderSag,
    /// Corners of the patch whose angle differs less than this from a straight line are no corners of panels, radians.
    pub straight_corner: f64,
}

impl Default for ExtractOptions {
    fn default() -> Self {
        Self {
            border: BorderMode::Trimmed,
            shortest_border_edge: 0.25,
            smallest_panel: 0.15,
            border_sag: BorderSag { in_plane: 0.05, out_of_plane: 0.06 },
            straight_corner: 15f64.to_radians(),
        }
    }
}

/// Number or size of panels that [`panels`] aims at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PanelTarget {
    /// Side of a square with the mean whole panel's area, model units.
    EdgeLength(f64),
    /// Number of faces of the mesh, met within 15 %.
    Faces(usize),
}

/// Panels of about the number or size asked for: integrates the field and extracts, adapting the map's density.
///
/// # Errors
/// As [`crate::field::integrate`] and [`extract`].
pub fn panels(
    field: &ConjugateField,
    surface: &NurbsSurface,
    target: PanelTarget,
    map_options: &MapOptions,
    options: &ExtractOptions,
    control: &Control,
) -> Result<ExtractedMesh, Error> {
    let mut map_options = *map_options;
    map_options.density = match target {
        PanelTarget::EdgeLength(edge) => Density::EdgeLength(edge),
        PanelTarget::Faces(faces) => Density::CellCount(faces.max(1) as f64),
    };
    let integrator = Integrator::new(field, &map_options, control)?;
    let faces = match target {
        PanelTarget::EdgeLength(edge) => {
            let map = integrator.map(Density::EdgeLength(edge), control)?;
            return extract(&map, surface, options, control);
        }
        PanelTarget::Faces(faces) => faces.max(1) as f64,
    };
    let mut best: Option<(f64, ExtractedMesh)> = None;
    let mut cells = faces;
    for _ in 0..6 {
        let map = integrator.map(Density::CellCount(cells), control)?;
        let mesh = match extract(&map, surface, options, control) {
            Ok(mesh) => mesh,
            // Too coarse for a whole quad: finer may do.
            Err(Error::NoMesh { .. }) if best.is_none() => {
                cells *= 2.0;
                continue;
            }
            Err(error) => return Err(error),
        };
        let ratio = mesh.mesh.face_count() as f64 / faces;
        let off = ratio.ln().abs();
        if best.as_ref().is_none_or(|b| off < b.0) {
            best = Some((off, mesh));
        }
        // Integers make small counts jump; within 5 % nothing is gained by another round.
        if off < 0.05 {
            break;
        }
        cells /= ratio.clamp(0.25, 4.0);
    }
    best.map(|b| b.1).ok_or(Error::NoMesh { reason: "no whole panel fits on the surface".into() })
}

/// Extracts panels from a seamless map.
///
/// The integer isolines cut the parameter domain into cells, by exact predicates, so the panels cover the domain and form one disk whatever
/// the map is like; contractions then remove folds and slivers and keep it so. Singular vertices become irregular vertices; cells at
/// the border become polygons of three and more corners, whose border vertices lie on the surface's border.
///
/// - `surface`: the surface that the map's triangulation samples.
///
/// # Errors
/// [`Error::NoMesh`] when no panel remains, [`Error::Cancelled`].
///
/// # Source
/// Replaces the extraction of Liu et al. 2011, which Sketch2PQ uses: that keeps whole quads only, so its borders are saw-tooth lines.
pub fn extract(
    map: &SeamlessMap,
    surface: &NurbsSurface,
    options: &ExtractOptions,
    control: &Control,
) -> Result<ExtractedMesh, Error> {
    control.step("extract", 0.0)?;
    let mut cells = arrange(map);
    let mut repairs = Repairs::default();
    border::unfold(&mut cells, &mut repairs);
    control.step("extract", 0.5)?;
    let faces = if options.border == BorderMode::Interior {
        border::keep_interior(&cells)
    } else {
        border::snap(&mut cells, options.shortest_border_edge, &mut repairs);
        border::unite_slivers(&mut cells, options.smallest_panel, &mut repairs);
        for node in 0..cells.nodes.len() as u32 {
            border::drop_straight(&mut cells, node);
        }
        for node in 0..cells.nodes.len() as u32 {
            if matches!(cells.nodes[node as usize].place, Place::Corner(_))
                && is_straight(&cells, node, surface, options.straight_corner)
            {
                cells.dissolve(node);
            }
        }
        border::simplify(&mut cells, &mut repairs);
        repairs.cut = follow_border(&mut cells, surface, &options.border_sag);
        cells.faces()
    };
    assemble(&cells, faces, surface, repairs, options.border != BorderMode::Interior)
}

/// Whether the border runs through a corner of the patch nearly straight.
fn is_straight(cells: &PlanarMap, node: u32, surface: &NurbsSurface, tolerance: f64) -> bool {
    let [u, v] = cells.nodes[node as usize].parameter;
    let ends: Vec<_> = cells
        .arms(node)
        .map(|h| cells.nodes[cells.end(h) as usize].parameter)
        .map(|[a, b]| surface.point(a, b) - surface.point(u, v))
        .collect();
    match ends.as_slice() {
        [a, b] => a.angle(b) > std::f64::consts::PI - tolerance,
        _ => false,
    }
}

fn assemble(
    cells: &PlanarMap,
    faces: Vec<u32>,
    surface: &NurbsSurface,
    mut repairs: Repairs,
    covers: bool,
) -> Result<ExtractedMesh, Error> {
    let mut polygons: Vec<Vec<u32>> = vec![];
    let mut half_edges: Vec<Vec<u32>> = vec![];
    for h in faces {
        let sides: Vec<u32> = cells.face(h).collect();
        let nodes: Vec<u32> = sides.iter().map(|&g| cells.origin[g as usize]).collect();
        let repeated = (1..nodes.len()).any(|i| nodes[..i].contains(&nodes[i]));
        if nodes.len() < 3 || repeated {
            repairs.dropped += 1;
            continue;
        }
        polygons.push(nodes);
        half_edges.push(sides);
    }
    let keep = largest_manifold_part(&polygons, cells.nodes.len());
    repairs.dropped += if covers { keep.iter().filter(|k| !**k).count() } else { 0 };
    let mut number = vec![NONE; cells.nodes.len()];
    let mut order = vec![];
    let mut corners: Vec<Vec<u32>> = vec![];
    let mut edges: Vec<([u32; 2], EdgeFamily, bool)> = vec![];
    for (polygon, sides) in polygons.iter().zip(&half_edges).zip(&keep).filter(|(_, k)| **k).map(|(p, _)| p) {
        let numbered: Vec<u32> = polygon
            .iter()
            .map(|&n| {
                if number[n as usize] == NONE {
                    number[n as usize] = order.len() as u32;
                    order.push(n);
                }
                number[n as usize]
            })
            .collect();
        for (k, &g) in sides.iter().enumerate() {
            let (a, b) = (numbered[k], numbered[(k + 1) % numbered.len()]);
            let family = match cells.course[g as usize] {
                Course::U => EdgeFamily::U,
                Course::V => EdgeFamily::V,
                Course::Border => EdgeFamily::Border,
                Course::Cut => EdgeFamily::Cut,
            };
            edges.push(([a.min(b), a.max(b)], family, false));
        }
        corners.push(numbered);
    }
    if corners.is_empty() {
        return Err(Error::NoMesh { reason: "no whole panel fits on the surface".into() });
    }
    let origins: Vec<VertexOrigin> = order
        .iter()
        .map(|&n| {
            let node = cells.nodes[n as usize];
            let kind = match node.place {
                Place::Inner | Place::Singular => VertexKind::Interior,
                Place::Border(side) => VertexKind::Border { side },
                Place::Corner(corner) => VertexKind::Corner { corner },
            };
            VertexOrigin { parameter: node.parameter, kind }
        })
        .collect();
    let vertices = origins.iter().map(|o| surface.point(o.parameter[0], o.parameter[1])).collect();
    let mesh = PanelMesh::new(vertices, &corners)?;
    edges.sort_by_key(|e| e.0);
    edges.dedup_by_key(|e| e.0);
    let check = topology::check(&mesh);
    let mut degree = vec![0usize; mesh.vertices.len()];
    for ([a, b], ..) in edges.iter().filter(|e| e.1 != EdgeFamily::Cut) {
        degree[*a as usize] += 1;
        degree[*b as usize] += 1;
    }
    let irregular =
        (0..mesh.vertices.len() as u32).filter(|&v| !check.on_border[v as usize] && degree[v as usize] != 4).collect();
    let (edges, families) = edges.into_iter().map(|(e, f, _)| (e, f)).unzip();
    Ok(ExtractedMesh { mesh, origins, edges, families, irregular, repairs, covers: covers && repairs.dropped == 0 })
}

/// The largest set of faces connected over edges, without faces that touch the rest in single vertices only.
fn largest_manifold_part(polygons: &[Vec<u32>], node_count: usize) -> Vec<bool> {
    let mut keep = vec![true; polygons.len()];
    loop {
        // Faces at each directed side.
        let mut side_face: std::collections::BTreeMap<(u32, u32), usize> = std::collections::BTreeMap::new();
        for (f, polygon) in polygons.iter().enumerate().filter(|(f, _)| keep[*f]) {
            for (k, &a) in polygon.iter().enumerate() {
                side_face.insert((a, polygon[(k + 1) % polygon.len()]), f);
            }
        }
        let neighbours = |f: usize| {
            let polygon = &polygons[f];
            (0..polygon.len())
                .filter_map(|k| side_face.get(&(polygon[(k + 1) % polygon.len()], polygon[k])).copied())
                .collect::<Vec<_>>()
        };
        let mut component = vec![usize::MAX; polygons.len()];
        let mut sizes = vec![];
        for seed in 0..polygons.len() {
            if !keep[seed] || component[seed] != usize::MAX {
                continue;
            }
            let mut stack = vec![seed];
            component[seed] = sizes.len();
            let mut size = 0;
            while let Some(f) = stack.pop() {
                size += 1;
                for g in neighbours(f) {
                    if component[g] == usize::MAX {
                        component[g] = sizes.len();
                        stack.push(g);
                    }
                }
            }
            sizes.push(size);
        }
        let largest = (0..sizes.len()).max_by_key(|&c| (sizes[c], std::cmp::Reverse(c)));
        for f in 0..polygons.len() {
            keep[f] &= Some(component[f]) == largest;
        }
        // A vertex where more than one border side leaves is a pinch: its smallest fan goes.
        let mut leaving = vec![0u8; node_count];
        for (&(a, b), &f) in &side_face {
            if keep[f] && side_face.get(&(b, a)).is_none_or(|&g| !keep[g]) {
                leaving[a as usize] = leaving[a as usize].saturating_add(1);
            }
        }
        let Some(pinch) = (0..node_count as u32).find(|&n| leaving[n as usize] > 1) else { return keep };
        let around: Vec<usize> = (0..polygons.len()).filter(|&f| keep[f] && polygons[f].contains(&pinch)).collect();
        let mut fans: Vec<Vec<usize>> = vec![];
        for &f in &around {
            if fans.iter().any(|fan| fan.contains(&f)) {
                continue;
            }
            let mut fan = vec![f];
            let mut i = 0;
            while i < fan.len() {
                for g in neighbours(fan[i]) {
                    // Adjacent over a side that ends in the pinch.
                    let shares = polygons[g].iter().filter(|n| polygons[fan[i]].contains(n)).count() >= 2
                        && polygons[g].contains(&pinch);
                    if keep[g] && shares && !fan.contains(&g) {
                        fan.push(g);
                    }
                }
                i += 1;
            }
            fans.push(fan);
        }
        if fans.len() < 2 {
            return keep;
        }
        fans.sort_by_key(|fan| (fan.len(), fan[0]));
        for &f in &fans[0] {
            keep[f] = false;
        }
    }
}

impl ExtractedMesh {
    /// Triples (previous, vertex, next) along grid lines: two for each inner vertex of four edges, one along the border for
    /// each border vertex that is no corner. What fairness and isolines read.
    pub fn strips(&self) -> Vec<[u32; 3]> {
        let corner = |v: u32| matches!(self.origins[v as usize].kind, VertexKind::Corner { .. });
        let is_cut = |a: u32, b: u32| {
            let edge = self.edges.binary_search(&[a.min(b), a.max(b)]);
            edge.is_ok_and(|e| self.families[e] == EdgeFamily::Cut)
        };
        triples_along(&self.mesh, corner, is_cut)
    }
}

/// Triples (previous, vertex, next) along the grid lines of a manifold mesh: opposite neighbours at inner vertices of even degree, and the
/// border neighbours at border vertices that are no `corner`. In order of the vertices.
pub fn grid_triples(mesh: &PanelMesh, corner: impl Fn(u32) -> bool) -> Vec<[u32; 3]> {
    triples_along(mesh, corner, |_, _| false)
}

/// The same without edges that `is_cut`, as if these were not there.
fn triples_along(mesh: &PanelMesh, corner: impl Fn(u32) -> bool, is_cut: impl Fn(u32, u32) -> bool) -> Vec<[u32; 3]> {
    // For each directed side (a, b), the side that leaves `a` next, counter-clockwise.
    let mut sides: Vec<(u32, u32, u32)> = Vec::with_capacity(mesh.indices.len());
    for face in mesh.faces() {
        for (k, &a) in face.iter().enumerate() {
            let (before, after) = (face[(k + face.len() - 1) % face.len()], face[(k + 1) % face.len()]);
            sides.push((a, after, before));
        }
    }
    sides.sort_unstable();
    let mut triples = vec![];
    let mut i = 0;
    while i < sides.len() {
        let vertex = sides[i].0;
        let group = &sides[i..i + sides[i..].iter().take_while(|s| s.0 == vertex).count()];
        i += group.len();
        // Follow the fan; on the border it starts at the neighbour that no face leads to.
        let start = group.iter().map(|s| s.1).find(|n| !group.iter().any(|s| s.2 == *n));
        let mut ring = vec![start.unwrap_or(group[0].1)];
        while let Some(s) = group.iter().find(|s| s.1 == ring[ring.len() - 1]) {
            if s.2 == ring[0] || ring.len() > group.len() {
                break;
            }
            ring.push(s.2);
        }
        ring.retain(|&n| !is_cut(vertex, n));
        if start.is_some() {
            if !corner(vertex) {
                triples.push([ring[0], vertex, ring[ring.len() - 1]]);
            }
        } else if ring.len().is_multiple_of(2) {
            let half = ring.len() / 2;
            triples.extend((0..half).map(|k| [ring[k], vertex, ring[k + half]]));
        }
    }
    triples
}

#[cfg(test)]
#[path = "extract_tests.rs"]
mod tests;
