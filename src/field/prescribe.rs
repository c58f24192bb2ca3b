//! Singularities that the host fixes: whether a field can have them, and the quarter turns that give it those and no others.

use super::border::{Corner, followed};
use super::conjugate_field::Singularity;
use super::topology::EdgeTopology;
use crate::error::Error;
use crate::surface::SurfaceMesh;
use std::collections::BTreeMap;

/// Whether a field that follows the sides `aligned` (u = min, u = max, v = min, v = max) can have these singularities and no others.
///
/// Where a side is free the cross may turn against the border there as often as it likes, so that any indices will do. Where all
/// sides are followed the cross turns once with the border, less a quarter at each corner: by Poincare and Hopf the indices then
/// sum to 4 quarter turns minus those of the border at its `corners`, 0 on a patch with four convex ones.
///
/// # Errors
/// [`Error::Argument`] for an index other than 1 and -1, a vertex on the border, or two singularities on one vertex;
/// [`Error::SingularityCount`] for a sum that aligned sides leave no room for.
pub(super) fn check(
    mesh: &SurfaceMesh,
    edges: &EdgeTopology,
    aligned: &[bool; 4],
    corners: &[Corner],
    fixed: &[Singularity],
) -> Result<(), Error> {
    let fail = |value: String, expected| Err(Error::Argument { name: "singularities", value, expected });
    let mut taken = BTreeMap::new();
    for (i, s) in fixed.iter().enumerate() {
        if s.index.abs() != 1 {
            return fail(format!("number {i} of index {}", s.index), "quarter turns of 1 or -1");
        }
        if s.vertex as usize >= mesh.points.len() || edges.is_border_vertex(s.vertex) {
            return fail(format!("number {i} on the border or beyond"), "places inside the patch");
        }
        if let Some(other) = taken.insert(s.vertex, i) {
            let value = format!("numbers {other} and {i} on the same vertex of the triangulation");
            return fail(value, "places more than a cell of the triangulation apart");
        }
    }
    let sum = fixed.iter().map(|s| s.index).sum();
    // A collapsed side is not followed.
    let all_around = followed(mesh, edges, aligned).len() == (0..edges.len()).filter(|&e| edges.is_border(e)).count();
    let room = 4 - corners.iter().map(|c| c.turns).sum::<i32>();
    if all_around && room != sum { Err(Error::SingularityCount { sum, room }) } else { Ok(()) }
}

/// The charges to take out of a field so that it has the `fixed` singularities and no others: a charge that shall come to a vertex is the
/// opposite charge there, waiting to be cancelled.
pub(super) fn charges(present: &[Singularity], fixed: &[Singularity]) -> Vec<Singularity> {
    let mut charges: BTreeMap<u32, i32> = BTreeMap::new();
    for s in present {
        *charges.entry(s.vertex).or_default() += s.index;
    }
    for s in fixed {
        *charges.entry(s.vertex).or_default() -= s.index;
    }
    charges.into_iter().filter(|c| c.1 != 0).map(|(vertex, index)| Singularity { vertex, index }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Control;
    use crate::field::test_surfaces::*;
    use crate::field::{ConjugateField, FieldOptions, conjugate_field_with_singularities};
    use nalgebra::Point3;

    const ALL: [bool; 4] = [true; 4];

    fn solve(mesh: SurfaceMesh, fixed: &[Singularity], aligned_sides: [bool; 4]) -> Result<ConjugateField, Error> {
        let options = FieldOptions { aligned_sides, ..FieldOptions::default() };
        conjugate_field_with_singularities(mesh, None, &[], fixed, &options, &Control::default())
    }

    fn at(mesh: &SurfaceMesh, [i, j]: [usize; 2], index: i32) -> Singularity {
        Singularity { vertex: (i * (mesh.cells[1] + 1) + j) as u32, index }
    }

    /// Largest angle, degrees, by which a layout direction turns from a triangle to the next, away from the singularities.
    fn largest_turn(field: &ConjugateField) -> f64 {
        let near: Vec<u32> = field.singularities.iter().flat_map(|s| field.edges.fan(s.vertex).to_vec()).collect();
        let mut largest = 0.0f64;
        for e in (0..field.edges.len()).filter(|&e| !field.edges.is_border(e)) {
            let [f, g] = field.edges.triangles[e];
            if near.contains(&f) || near.contains(&g) {
                continue;
            }
            let normals = [f, g].map(|t| field.mesh.triangle_normal_area(t as usize).0);
            let carry = nalgebra::Rotation3::rotation_between(&normals[0], &normals[1]).unwrap();
            for i in 0..2 {
                let there = field.layout_direction(g, i + field.matching[e] as usize);
                largest = largest.max((carry * field.layout_direction(f, i)).angle(&there).to_degrees());
            }
        }
        largest
    }

    #[test]
    fn a_field_has_the_singularities_that_are_asked_for_and_no_others() {
        for (surface, cells) in [(graph(|_, _| 0.0), [16, 16]), (wavy(2), [16, 16]), (wavy(5), [40, 30])] {
            let mesh = SurfaceMesh::new(&surface, cells).unwrap();
            let place = |s: f64, t: f64| [(s * cells[0] as f64) as usize, (t * cells[1] as f64) as usize];
            let one = at(&mesh, place(0.3, 0.4), 1);
            let other = at(&mesh, place(0.7, 0.6), -1);
            let third = at(&mesh, place(0.75, 0.2), -1);
            for mut fixed in [vec![], vec![one], vec![other], vec![one, other], vec![third, one, other]] {
                let field = solve(mesh.clone(), &fixed, [false; 4]).unwrap();
                fixed.sort_by_key(|s| s.vertex);
                assert_eq!(field.singularities, fixed);
                assert!(field.fixed_singularities && field.diagnostics.conjugacy_max < 1e-9);
                assert!(largest_turn(&field) < 35.0, "{:?}: {}", fixed, largest_turn(&field));
            }
        }
    }

    #[test]
    fn a_border_that_is_followed_all_around_decides_on_the_sum_of_indices() {
        let mesh = SurfaceMesh::new(&wavy(2), [16, 16]).unwrap();
        let (plus, minus) = (at(&mesh, [5, 6], 1), at(&mesh, [11, 10], -1));
        for fixed in [&[][..], &[plus, minus]] {
            let field = solve(mesh.clone(), fixed, ALL).unwrap();
            assert_eq!(field.singularities, fixed);
            assert!(largest_turn(&field) < 50.0, "{}", largest_turn(&field));
        }
        for (fixed, sum) in [([plus], 1), ([minus], -1)] {
            assert_eq!(solve(mesh.clone(), &fixed, ALL).err(), Some(Error::SingularityCount { sum, room: 0 }));
            // One free side takes what is left over.
            let field = solve(mesh.clone(), &fixed, [true, true, true, false]).unwrap();
            assert_eq!(field.singularities, fixed);
        }
        // A triangle whose longest side holds the fourth corner: three quads meet inside.
        let corners = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.0, 1.7]].map(|[x, y]| Point3::new(x, y, 0.0));
        let net = vec![corners[0], corners[3], corners[1], corners[2]];
        let triangle = crate::surface::NurbsSurface::uniform(1, [2, 2], net).unwrap();
        let mesh = SurfaceMesh::new(&triangle, [12, 12]).unwrap();
        assert_eq!(solve(mesh.clone(), &[], ALL).err(), Some(Error::SingularityCount { sum: 0, room: 1 }));
        let plus = at(&mesh, [6, 5], 1);
        assert_eq!(solve(mesh, &[plus], ALL).unwrap().singularities, [plus]);
    }

    #[test]
    fn impossible_singularities_are_refused() {
        let mesh = SurfaceMesh::new(&wavy(1), [8, 8]).unwrap();
        let inside = at(&mesh, [3, 3], 1);
        let refused = |fixed: &[Singularity]| {
            matches!(solve(mesh.clone(), fixed, [false; 4]), Err(Error::Argument { name: "singularities", .. }))
        };
        assert!(refused(&[at(&mesh, [0, 3], 1)]) && refused(&[at(&mesh, [3, 8], -1)]));
        assert!(refused(&[at(&mesh, [9, 0], 1)]) && refused(&[Singularity { index: 2, ..inside }]));
        assert!(refused(&[Singularity { index: 0, ..inside }]) && refused(&[inside, at(&mesh, [3, 3], -1)]));
    }
}
