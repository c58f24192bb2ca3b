//! A first surface for a sketch with folds: both layers glued along the contours, flattened, and fitted.

use super::border::{BorderCurves, LayerMaps};
use super::corners::BorderLoop;
use super::sheet::{Sheet, factor};
use super::tensor::gram;
use crate::error::Error;
use crate::numeric::Cholesky;
use nalgebra::{DMatrix, Point3, Vector3};
use sprs::CsMat;

/// Pull of each pixel to the middle of the parameter square, for pieces that nothing else holds.
const HOLD: f64 = 1e-7;
/// Smoothness of the fitted net: weight of the integrals of S_uuu^2 + S_vvv^2 over the unit square against the mean squared
/// distance to the samples. Waves beyond about three and a half a side are damped: 1 / (2 pi 3.4)^6.
const SMOOTHING: f64 = 1e-8;

/// Control net of a surface through both layers that folds where the contours are.
///
/// The graph of the pixels of both layers, glued by what the strokes say, is a disk; its rim lies on the border strokes, whose
/// parameters are known. A discretely harmonic map, in the metric of the normals, spreads the parameters over the disk, which no
/// fold of the canvas disturbs, and a smooth net is fitted to the pixels' points over them. All weights are positive, so the map
/// is the embedding of Tutte and Floater where the graph is planar.
///
/// - `contours`: contour strokes, polylines (x, y).
/// - `maps`: both layers, corrected to the depth samples if there are any.
/// - `smoothness`: 1 is balanced; 10 irons out waves twice as long as 1 does not touch, where parameter lines would jam.
/// - returns count_u * count_v points, v running fastest, canonical frame; the rim is that of `curves`.
///
/// # Errors
/// [`Error::Singular`] if a system cannot be solved, which no finite input causes.
///
/// # Source
/// Floater, "Parametrization and smooth approximation of surface triangulations", 1997, on the two-layer maps of Sketch2PQ.
pub fn unfolded_net(
    border: &BorderLoop,
    curves: &BorderCurves,
    contours: &[Vec<[f64; 2]>],
    maps: &LayerMaps,
    smoothness: f64,
) -> Result<Vec<Point3<f64>>, Error> {
    let sheet = Sheet::new(border, curves, contours, maps);
    let parameters = sheet.flatten()?;
    fit(curves, &sheet.samples(&parameters), SMOOTHING * smoothness)
}

impl Sheet<'_> {
    /// Parameters (u, v) of all vertices: the harmonic map with the rim held.
    fn flatten(&self) -> Result<Vec<[f64; 2]>, Error> {
        let n = self.count;
        let mut diagonal = vec![HOLD; n];
        let mut right = vec![0.5 * HOLD; 2 * n];
        for &(vertex, [u, v], weight) in &self.held {
            let k = vertex as usize;
            diagonal[k] += weight;
            right[k] += weight * u;
            right[n + k] += weight * v;
        }
        factor(&self.links, diagonal, "unfolding")?.solve(&mut right);
        Ok((0..n).map(|k| [right[k], right[n + k]]).collect())
    }

    /// Parameters and points that the surface should pass through: pixels, and the folds between them.
    fn samples(&self, parameters: &[[f64; 2]]) -> Vec<([f64; 2], Point3<f64>)> {
        let pixels = (0..self.count as u32).map(|k| (parameters[k as usize], self.point(k)));
        let turns = self.turns.iter().map(|&(a, b, point)| {
            let [p, q] = [a, b].map(|k| parameters[k as usize]);
            ([0, 1].map(|c| 0.5 * (p[c] + q[c])), point)
        });
        let rolled = self.rolled.iter().map(|&(vertex, rim, share, point)| {
            let from = parameters[vertex as usize];
            ([0, 1].map(|c| from[c] + (rim[c] - from[c]) * share), point)
        });
        pixels.chain(turns).chain(rolled).collect()
    }
}

/// The net with the rim of `curves` that passes near the samples, smoothly.
fn fit(curves: &BorderCurves, samples: &[([f64; 2], Point3<f64>)], smoothing: f64) -> Result<Vec<Point3<f64>>, Error> {
    let knots = &curves.knots;
    let start = super::coons_net(curves);
    let (rows, columns) = (knots[0].count(), knots[1].count());
    let inner = |k: usize| {
        let (i, j) = (k / columns, k % columns);
        (i > 0 && j > 0 && i + 1 < rows && j + 1 < columns).then(|| (i - 1) * (columns - 2) + j - 1)
    };
    let unknowns = (rows - 2) * (columns - 2);
    // Entry [k][7 (di + 3) + dj + 3] couples control points k and k + (di, dj); a cubic reaches no farther.
    const REACH: usize = 7;
    let mut band = vec![[0.0; REACH * REACH]; rows * columns];
    let mut right = vec![Vector3::zeros(); rows * columns];
    let share = 1.0 / samples.len().max(1) as f64;
    for ([u, v], point) in samples {
        let [bu, bv] = [knots[0].basis(u.clamp(0.0, 1.0)), knots[1].basis(v.clamp(0.0, 1.0))];
        for a in 0..16 {
            let (i, j) = (a / 4, a % 4);
            let k = (bu.first + i) * columns + bv.first + j;
            let weight = share * bu.values[0][i] * bv.values[0][j];
            right[k] += point.coords * weight;
            for b in 0..16 {
                let (p, q) = (b / 4, b % 4);
                band[k][REACH * (p + 3 - i) + q + 3 - j] += weight * bu.values[0][p] * bv.values[0][q];
            }
        }
    }
    let [mass, third] = [0, 3].map(|order| [0, 1].map(|axis: usize| gram(&knots[axis], order)));
    let couple = |m: &DMatrix<f64>, i: usize, j: usize| if i.abs_diff(j) > 3 { 0.0 } else { m[(i, j)] };
    for i in 0..rows {
        for j in 0..columns {
            for p in i.saturating_sub(3)..(i + 4).min(rows) {
                for q in j.saturating_sub(3)..(j + 4).min(columns) {
                    let value = couple(&third[0], i, p) * couple(&mass[1], j, q)
                        + couple(&mass[0], i, p) * couple(&third[1], j, q);
                    band[i * columns + j][REACH * (p + 3 - i) + q + 3 - j] += smoothing * value;
                }
            }
        }
    }
    let (mut starts, mut indices, mut values) = (vec![0], vec![], vec![]);
    let mut columns_of_right = vec![0.0; 3 * unknowns];
    for k in 0..rows * columns {
        let Some(unknown) = inner(k) else { continue };
        let mut rest = right[k];
        for (entry, &value) in band[k].iter().enumerate() {
            let (i, j) = (k / columns + entry / REACH, k % columns + entry % REACH);
            if i < 3 || j < 3 || i - 3 >= rows || j - 3 >= columns {
                continue;
            }
            let other = (i - 3) * columns + j - 3;
            match inner(other) {
                Some(row) if row >= unknown => {
                    indices.push(row);
                    values.push(value);
                }
                Some(_) => {}
                None => rest -= start[other].coords * value,
            }
        }
        starts.push(indices.len());
        for c in 0..3 {
            columns_of_right[c * unknowns + unknown] = rest[c];
        }
    }
    let matrix = CsMat::new_csc((unknowns, unknowns), starts, indices, values);
    Cholesky::new(&matrix, "unfolded net")?.solve(&mut columns_of_right);
    let moved = |k: usize| {
        inner(k).map_or(start[k], |unknown| Point3::from([0, 1, 2].map(|c| columns_of_right[c * unknowns + unknown])))
    };
    Ok((0..rows * columns).map(moved).collect())
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{self, Scene};
    use super::super::{NurbsSurface, SurfaceProjector};
    use super::*;

    fn unfolded(scene: &Scene) -> NurbsSurface {
        let curves = BorderCurves::new(&scene.border, scene.corners, &scene.maps, [30, 30]).unwrap();
        let net = unfolded_net(&scene.border, &curves, &scene.contours, &scene.maps, 1.0).unwrap();
        NurbsSurface::new(curves.knots, net, None).unwrap()
    }

    /// Largest distance from samples of one surface to the other.
    fn deviation(surface: &NurbsSurface, truth: &NurbsSurface) -> f64 {
        let projector = SurfaceProjector::new(truth);
        let places = (0..31 * 31).map(|k| [(k / 31) as f64 / 30.0, (k % 31) as f64 / 30.0]);
        let distances = places.map(|[s, t]| {
            let [u, v] = surface.at_fraction(s, t);
            projector.closest(&surface.point(u, v)).distance
        });
        distances.fold(0.0, f64::max)
    }

    #[test]
    fn open_sheets_are_fitted_everywhere() {
        for truth in [synthetic::dome(), synthetic::saddle()] {
            let scene = synthetic::scene(truth);
            let surface = unfolded(&scene);
            let distance = deviation(&surface, &scene.truth).max(deviation(&scene.truth, &surface));
            assert!(distance < 0.03, "{distance}");
        }
    }

    #[test]
    fn a_fold_is_fitted_on_both_sides() {
        let scene = synthetic::scene(synthetic::vault());
        assert!(!scene.contours.is_empty());
        let surface = unfolded(&scene);
        // Both ways: no part is missing, and none sticks out. Without the contour the hidden wall would be lost.
        let distance = deviation(&surface, &scene.truth).max(deviation(&scene.truth, &surface));
        assert!(distance < 0.25, "{distance}");
        let flat = Scene { contours: vec![], ..scene };
        assert!(deviation(&flat.truth, &unfolded(&flat)) > 2.0 * distance);
    }

    #[test]
    fn parameters_of_a_plane_are_affine() {
        // Conformal, so harmonic: a square seen straight on.
        let scene = synthetic::scene(synthetic::surface(|s, t| [7.0 * t - 3.5, 3.5 - 7.0 * s, -4.0]));
        let curves = BorderCurves::new(&scene.border, scene.corners, &scene.maps, [30, 30]).unwrap();
        let sheet = Sheet::new(&scene.border, &curves, &scene.contours, &scene.maps);
        for (k, [u, v]) in sheet.flatten().unwrap().into_iter().enumerate() {
            let p = sheet.point(k as u32);
            assert!((u - (3.5 - p.y) / 7.0).abs() < 1e-4 && (v - (p.x + 3.5) / 7.0).abs() < 1e-4, "{p} {u} {v}");
        }
    }
}
