//! The border of the surface in space: depth along the loop, and a B-spline curve for each of its four sides.

use super::corners::BorderLoop;
use super::knots::KnotVector;
use super::layer_map::LayerMap;
use crate::error::Error;
use crate::numeric::SymbolicCholesky;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};
use sprs::CsMat;

/// Depth and normals of both layers.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMaps {
    /// The layer in front.
    pub visible: LayerMap,
    /// The layer behind it; has no valid pixel where nothing is hidden.
    pub occluded: LayerMap,
}

/// The border in space.
#[derive(Clone, Debug, PartialEq)]
pub struct BorderCurves {
    /// Knots in u (sides 0 and 2) and v (sides 1 and 3), clamped, uniform, cubic.
    pub knots: [KnotVector; 2],
    /// Control points of side k, from corner k to corner k + 1, in loop order: neighbours share their corner exactly.
    pub sides: [Vec<Point3<f64>>; 4],
    /// The loop's points with their smoothed depth, z = -depth, in the order of the loop.
    pub points: Vec<Point3<f64>>,
    /// Parameters (u, v) of the loop's points, on the rim of [0, 1]^2.
    pub parameters: Vec<[f64; 2]>,
}

/// Half-width in pixels of the window in which a map is fitted by a plane at a border point.
const WINDOW: isize = 3;
/// Standard deviation in pixels of the plane fit's weights.
const WINDOW_DEVIATION: f64 = 1.2;
/// Pixels this far on the wrong side of the border, in pixels, still count as the patch's.
const SIDE_SLACK: f64 = 0.3;
/// Weight of the slopes given by the normals against the depths' own, pixels^2 times coverage.
const SLOPE_PRIOR: f64 = 0.5;
/// Smoothing of the depth: weight of the integral of z''^2 over the side's parameter in [0, 1] against the mean squared
/// residual. Waves shorter than a fifth of a side are damped: 1 / (2 pi 5)^4.
const DEPTH_SMOOTHING: f64 = 1e-6;
/// Smoothing of x, y, only so that sides with few points have a unique fit.
const SHAPE_SMOOTHING: f64 = 1e-10;
/// Rounds of reweighting against outliers at occlusions.
const ROBUST_ROUNDS: usize = 4;
/// Depth residuals below this are not treated as outliers, canonical units.
const ROBUST_FLOOR: f64 = 0.02;

impl BorderCurves {
    /// Lifts the loop to the depth of the maps, smoothly, and fits its four sides.
    ///
    /// - `corners`: indices of the four corners in loop order, see [`BorderLoop::choose_corners`].
    /// - `counts`: control points in u and v; the paper has 30 and 30.
    ///
    /// Depth at each loop point is that of a plane fitted to the pixels of its layer on the patch's side of the border
    /// (left of the loop where the front faces the viewer, right where the back does): bilinear reading would mix in what
    /// lies behind. The four sides' depths are then fitted together, robustly, so that the loop is closed and passes
    /// continuously from one layer to the other. Parameters are chord lengths in space.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if the corners are not four different ones in order, or no part of the maps touches the loop.
    pub fn new(border: &BorderLoop, corners: [usize; 4], maps: &LayerMaps, counts: [usize; 2]) -> Result<Self, Error> {
        let n = border.points.len();
        let sides: [Vec<usize>; 4] = [0, 1, 2, 3].map(|k| border.side(corners, k));
        let in_order = sides.iter().map(|side| side.len() - 1).sum::<usize>() == n;
        if corners.iter().any(|&c| c >= n) || sides.iter().any(|side| side.len() < 2) || !in_order {
            return Err(Error::Degenerate { reason: format!("border corners {corners:?} of {n} points") });
        }
        if counts.iter().any(|&c| c < 4) {
            return Err(Error::Degenerate { reason: format!("{counts:?} control points, a cubic needs 4") });
        }
        let samples = border_depths(border, maps);
        if samples.iter().all(|&(_, weight)| weight == 0.0) {
            return Err(Error::Degenerate { reason: "the depth maps do not touch the border".into() });
        }
        let knots = counts.map(|c| KnotVector::uniform(3, c));

        let mut z = vec![0.0; n];
        let mut curves = None;
        // Chord lengths in the canvas plane first, in space once the depth is known.
        for _ in 0..2 {
            let parameters = sides.each_ref().map(|side| chord_parameters(border, side, &z));
            let heights = fit_heights(&knots, &sides, &parameters, &samples)?;
            for (k, side) in sides.iter().enumerate() {
                for (&index, &t) in side.iter().zip(&parameters[k]) {
                    z[index] = curve_value(&knots[k % 2], &heights[k], t);
                }
            }
            curves = Some((parameters, heights));
        }
        let (parameters, heights) = curves.expect("the loop ran");
        let mut result = vec![];
        for (k, side) in sides.iter().enumerate() {
            let flat = fit_shape(&knots[k % 2], border, side, &parameters[k])?;
            result.push(flat.iter().zip(&heights[k]).map(|(p, z)| Point3::new(p[0], p[1], *z)).collect());
        }
        let points = border.points.iter().zip(&z).map(|(p, z)| Point3::new(p[0], p[1], *z)).collect();
        let mut on_rim = vec![[0.0; 2]; n];
        for (k, side) in sides.iter().enumerate() {
            for (&index, &t) in side.iter().zip(&parameters[k]) {
                on_rim[index] = [[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]][k];
            }
        }
        let sides = result.try_into().expect("there are four sides");
        Ok(Self { knots, sides, points, parameters: on_rim })
    }
}

fn curve_value(knots: &KnotVector, control: &[f64], t: f64) -> f64 {
    let basis = knots.basis(t);
    (0..=knots.degree()).map(|i| basis.values[0][i] * control[basis.first + i]).sum()
}

fn chord_parameters(border: &BorderLoop, side: &[usize], z: &[f64]) -> Vec<f64> {
    let mut parameters = vec![0.0];
    let mut sum = 0.0;
    for pair in side.windows(2) {
        let (a, b) = (border.points[pair[0]], border.points[pair[1]]);
        sum += (Vector3::new(b[0], b[1], z[pair[1]]) - Vector3::new(a[0], a[1], z[pair[0]])).norm();
        parameters.push(sum);
    }
    let last = parameters.len() - 1;
    for t in &mut parameters {
        *t = if sum > 0.0 { *t / sum } else { 0.0 };
    }
    parameters[last] = 1.0;
    parameters
}

/// Rows whose squares sum to `weight` times the integral of the second derivative's square: two Gauss points a span are exact
/// for cubics.
fn smoothing_rows(knots: &KnotVector, weight: f64, mut push: impl FnMut(usize, &[f64])) {
    for span in knots.breaks().windows(2) {
        let (middle, half) = (0.5 * (span[0] + span[1]), 0.5 * (span[1] - span[0]));
        for side in [-1.0, 1.0] {
            let basis = knots.basis(middle + side * half / 3f64.sqrt());
            let row = basis.values[2].map(|value| value * (weight * half).sqrt());
            push(basis.first, &row[..=knots.degree()]);
        }
    }
}

/// Depth and confidence in [0, 1] at each loop point, from the pixels of the sheet that ends there.
fn border_depths(border: &BorderLoop, maps: &LayerMaps) -> Vec<(f64, f64)> {
    let n = border.points.len();
    let at = |i: usize| {
        let (a, b) = (border.points[(i + n - 2) % n], border.points[(i + 2) % n]);
        let length = (b[0] - a[0]).hypot(b[1] - a[1]).max(f64::MIN_POSITIVE);
        let tangent = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
        let map = if border.occluded[i] { &maps.occluded } else { &maps.visible };
        plane_fit(map, border.points[i], tangent, border.front[i]).unwrap_or((0.0, 0.0))
    };
    (0..n).map(at).collect()
}

/// Depth at `p` of the plane that fits the pixels of one orientation on the patch's side of the border, and the share of
/// the weights that had a pixel.
fn plane_fit(map: &LayerMap, p: [f64; 2], tangent: [f64; 2], front: bool) -> Option<(f64, f64)> {
    let [column, row] = map.to_pixels(p);
    let (c0, r0) = (column.round() as isize, row.round() as isize);
    let n = map.size as isize;
    let bell = |d: f64| (-d * d / (2.0 * WINDOW_DEVIATION * WINDOW_DEVIATION)).exp();
    let mut across = [0.0; 2 * WINDOW as usize + 1];
    for (value, c) in across.iter_mut().zip(c0 - WINDOW..) {
        *value = bell(c as f64 - column);
    }
    let mut matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    let (mut total, mut slopes) = (0.0, Vector3::zeros());
    for r in (r0 - WINDOW).max(0)..=(r0 + WINDOW).min(n - 1) {
        let along = bell(row - r as f64);
        for c in (c0 - WINDOW).max(0)..=(c0 + WINDOW).min(n - 1) {
            let k = (r * n + c) as usize;
            if !map.valid[k] || map.front[k] != front {
                continue;
            }
            let (dx, dy) = (c as f64 - column, row - r as f64);
            let left = tangent[0] * dy - tangent[1] * dx;
            if (if front { left } else { -left }) < -SIDE_SLACK {
                continue;
            }
            let weight = along * across[(c - c0 + WINDOW) as usize];
            let basis = Vector3::new(1.0, dx, dy);
            matrix += basis * basis.transpose() * weight;
            right += basis * (weight * map.depth[k]);
            total += weight;
            let normal = map.normal[k];
            let steep = normal.z.abs().max(0.2).copysign(normal.z);
            slopes += Vector3::new(0.0, normal.x / steep, normal.y / steep) * (weight * map.pixel());
        }
    }
    if total < 0.02 {
        return None;
    }
    let prior = SLOPE_PRIOR * total.min(1.0);
    matrix[(1, 1)] += prior;
    matrix[(2, 2)] += prior;
    right += slopes * (prior / total);
    let solution = matrix.cholesky()?.solve(&right);
    // Half of a full window lies on the patch's side.
    let full = std::f64::consts::PI * WINDOW_DEVIATION * WINDOW_DEVIATION;
    Some((solution[0], (total / full).min(1.0)))
}

/// Heights z = -depth of the control points of the four sides, fitted together.
fn fit_heights(
    knots: &[KnotVector; 2],
    sides: &[Vec<usize>; 4],
    parameters: &[Vec<f64>; 4],
    samples: &[(f64, f64)],
) -> Result<[Vec<f64>; 4], Error> {
    // Side k begins where side k - 1 ends: they share that unknown.
    let mut starts = [0; 5];
    for k in 0..4 {
        starts[k + 1] = starts[k] + knots[k % 2].count() - 1;
    }
    let unknowns = starts[4];
    let id = |side: usize, i: usize| (starts[side] + i) % unknowns;

    let mut smoothing = CyclicBand::new(unknowns);
    for k in 0..4 {
        smoothing_rows(&knots[k % 2], DEPTH_SMOOTHING, |first, row| smoothing.add_square(id(k, first), row));
    }
    // First unknown and basis functions of each place on a side, with the loop's point and its share of the side.
    let places: Vec<_> = (0..4)
        .flat_map(|k| {
            let side = sides[k].iter().zip(&parameters[k]);
            side.map(move |(&index, &t)| {
                let basis = knots[k % 2].basis(t);
                (id(k, basis.first), [0, 1, 2, 3].map(|i| basis.values[0][i]), index, 1.0 / sides[k].len() as f64)
            })
        })
        .collect();
    let mut robust = vec![1.0; samples.len()];
    let mut solution = vec![];
    let symbolic = SymbolicCholesky::new(&smoothing.matrix())?;
    for _ in 0..ROBUST_ROUNDS {
        let mut band = smoothing.clone();
        let mut right = vec![0.0; unknowns];
        for &(first, values, index, share) in &places {
            let (depth, weight) = samples[index];
            let scale = (weight * robust[index] * share).sqrt();
            let row = values.map(|value| scale * value);
            band.add_square(first, &row);
            for (i, value) in row.iter().enumerate() {
                right[(first + i) % unknowns] -= value * depth * scale;
            }
        }
        symbolic.factorize(&band.matrix(), "border depth")?.solve(&mut right);
        solution = right;

        let mut residuals = vec![f64::NAN; samples.len()];
        for &(first, values, index, _) in &places {
            let z: f64 = (0..4).map(|i| values[i] * solution[(first + i) % unknowns]).sum();
            residuals[index] = (z + samples[index].0).abs();
        }
        let mut sorted: Vec<f64> = (0..samples.len()).filter(|&i| samples[i].1 > 0.0).map(|i| residuals[i]).collect();
        sorted.sort_by(f64::total_cmp);
        // 3 standard deviations, the deviation estimated from the median.
        let threshold = (3.0 * 1.48 * sorted[sorted.len() / 2]).max(ROBUST_FLOOR);
        for (weight, residual) in robust.iter_mut().zip(&residuals) {
            *weight = 1.0 / (1.0 + (residual / threshold).powi(2)).powi(2);
        }
    }
    Ok([0, 1, 2, 3].map(|k| (0..knots[k % 2].count()).map(|i| solution[id(k, i)]).collect()))
}

/// The symmetric matrix of a closed cubic spline: entry [i][d] couples unknowns i and i + d, counted around the loop.
#[derive(Clone)]
struct CyclicBand {
    entries: Vec<[f64; 4]>,
}

impl CyclicBand {
    /// The zero matrix of `unknowns` rows, at least eight, so that the band does not meet itself.
    fn new(unknowns: usize) -> Self {
        Self { entries: vec![[0.0; 4]; unknowns] }
    }

    /// Adds the outer product of `row`, the coefficients of the unknowns from `first` on, with itself.
    fn add_square(&mut self, first: usize, row: &[f64]) {
        let n = self.entries.len();
        for (i, a) in row.iter().enumerate() {
            for (entry, b) in self.entries[(first + i) % n].iter_mut().zip(&row[i..]) {
                *entry += a * b;
            }
        }
    }

    /// The lower triangle.
    fn matrix(&self) -> CsMat<f64> {
        let n = self.entries.len();
        let (mut starts, mut rows, mut values) = (vec![0], vec![], vec![]);
        for column in 0..n {
            for (d, &value) in self.entries[column].iter().enumerate().take(n - column) {
                rows.push(column + d);
                values.push(value);
            }
            // Couplings that pass the end of the loop.
            for d in (column + 1..4).rev() {
                rows.push(column + n - d);
                values.push(self.entries[column + n - d][d]);
            }
            starts.push(rows.len());
        }
        CsMat::new_csc((n, n), starts, rows, values)
    }
}

/// Control points (x, y) of one side, its ends exactly at the corners.
fn fit_shape(
    knots: &KnotVector,
    border: &BorderLoop,
    side: &[usize],
    parameters: &[f64],
) -> Result<Vec<[f64; 2]>, Error> {
    let count = knots.count();
    let ends = [border.points[side[0]], border.points[side[side.len() - 1]]];
    let mut result = vec![[0.0; 2]; count];
    (result[0], result[count - 1]) = (ends[0], ends[1]);
    // The smoothing pulls towards the straight line between the ends, not towards the origin of x, y.
    let line: Vec<[f64; 2]> =
        knots.greville().iter().map(|&t| [0, 1].map(|k| ends[0][k] + (ends[1][k] - ends[0][k]) * t)).collect();
    let unknowns = count - 2;
    let inner = |i: usize| (1..=unknowns).contains(&i).then(|| i - 1);
    let mut matrix = DMatrix::zeros(unknowns, unknowns);
    let mut right = [DVector::zeros(unknowns), DVector::zeros(unknowns)];
    smoothing_rows(knots, SHAPE_SMOOTHING, |first, row| add_square(&mut matrix, row, |i| inner(first + i)));
    for (&index, &t) in side.iter().zip(parameters) {
        let basis = knots.basis(t);
        let row = [0, 1, 2, 3].map(|i| basis.values[0][i] / (side.len() as f64).sqrt());
        add_square(&mut matrix, &row, |i| inner(basis.first + i));
        for (axis, right) in right.iter_mut().enumerate() {
            let straight: f64 = (0..4).map(|i| basis.values[0][i] * line[basis.first + i][axis]).sum();
            let residual = (border.points[index][axis] - straight) / (side.len() as f64).sqrt();
            for (i, value) in row.iter().enumerate() {
                if let Some(k) = inner(basis.first + i) {
                    right[k] += value * residual;
                }
            }
        }
    }
    let factor = matrix.cholesky().ok_or(Error::Singular { what: "border curve", size: unknowns })?;
    let offsets = right.map(|right| factor.solve(&right));
    for i in 1..=unknowns {
        result[i] = [0, 1].map(|axis| line[i][axis] + offsets[axis][i - 1]);
    }
    Ok(result)
}

/// Adds the outer product of `row` with itself at the places that `index` gives its entries.
fn add_square(matrix: &mut DMatrix<f64>, row: &[f64], index: impl Fn(usize) -> Option<usize>) {
    for (i, a) in row.iter().enumerate() {
        for (j, b) in row.iter().enumerate() {
            if let (Some(r), Some(c)) = (index(i), index(j)) {
                matrix[(r, c)] += a * b;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{NurbsSurface, coons_net};

    #[test]
    fn a_cyclic_band_is_the_sum_of_its_squares() {
        let n = 9;
        let mut band = CyclicBand::new(n);
        let mut dense = DMatrix::zeros(n, n);
        for first in 0..n {
            let row = [1.0, -2.0, 0.5, 3.0].map(|value| value + 0.1 * first as f64);
            band.add_square(first, &row);
            add_square(&mut dense, &row, |i| Some((first + i) % n));
        }
        let mut found = DMatrix::zeros(n, n);
        for (&value, (row, column)) in band.matrix().iter() {
            assert!(row >= column);
            found[(row, column)] = value;
            found[(column, row)] = value;
        }
        assert!((found - dense).amax() < 1e-12);
    }

    fn saddle(x: f64, y: f64) -> f64 {
        5.0 + 0.1 * (x * x - y * y) + 0.3 * x
    }

    fn case() -> (BorderLoop, LayerMaps) {
        let (n, half) = (64, 4.4);
        let mut map = LayerMap::empty(n, half);
        let inside = |x: f64, y: f64| x.abs() < 3.5 + 0.2 * (y * 0.6).cos() && y.abs() < 3.0;
        for k in 0..n * n {
            let [x, y] = map.center(k);
            map.valid[k] = inside(x, y);
            map.depth[k] = saddle(x, y);
            map.normal[k] = Vector3::new(0.2 * x + 0.3, -0.2 * y, 1.0).normalize();
        }
        let maps = LayerMaps { visible: map, occluded: LayerMap::empty(n, half) };
        let mut points = vec![];
        for k in 0..200 {
            points.push([-3.5 - 0.2 * ((3.0 - 6.0 * k as f64 / 200.0) * 0.6).cos(), 3.0 - 6.0 * k as f64 / 200.0]);
        }
        let x = 3.5 + 0.2 * (3.0f64 * 0.6).cos();
        points.extend((0..200).map(|k| [-x + 2.0 * x * k as f64 / 200.0, -3.0]));
        for k in 0..200 {
            points.push([3.5 + 0.2 * ((-3.0 + 6.0 * k as f64 / 200.0) * 0.6).cos(), -3.0 + 6.0 * k as f64 / 200.0]);
        }
        points.extend((0..200).map(|k| [x - 2.0 * x * k as f64 / 200.0, 3.0]));
        let occluded = vec![false; points.len()];
        (BorderLoop::new(points, occluded, vec![true; 800]).unwrap(), maps)
    }

    #[test]
    fn a_border_is_lifted_to_the_surface() {
        let (border, maps) = case();
        let corners = border.choose_corners().unwrap();
        assert_eq!(corners, [0, 200, 400, 600]);
        let curves = BorderCurves::new(&border, corners, &maps, [30, 30]).unwrap();
        for p in &curves.points {
            assert!((p.z + saddle(p.x, p.y)).abs() < 0.01, "{p:?} {}", p.z + saddle(p.x, p.y));
        }
        for (k, &corner) in corners.iter().enumerate() {
            let (a, b) = (&curves.sides[k], &curves.sides[(k + 1) % 4]);
            assert_eq!(a[29], b[0]);
            assert_eq!([a[0].x, a[0].y], border.points[corner]);
        }
    }

    #[test]
    fn the_coons_patch_has_these_borders_and_the_right_front() {
        let (border, maps) = case();
        let corners = border.choose_corners().unwrap();
        let curves = BorderCurves::new(&border, corners, &maps, [30, 20]).unwrap();
        let net = coons_net(&curves);
        let surface = NurbsSurface::new(curves.knots.clone(), net, None).unwrap();
        let at = |side: usize, t: f64| -> Point3<f64> {
            let value = |c: usize| {
                let control: Vec<f64> = curves.sides[side].iter().map(|p| p[c]).collect();
                curve_value(&curves.knots[side % 2], &control, t)
            };
            Point3::new(value(0), value(1), value(2))
        };
        for k in 0..=10 {
            let t = k as f64 / 10.0;
            for (side, [u, v]) in [[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]].into_iter().enumerate() {
                assert!((surface.point(u, v) - at(side, t)).norm() < 1e-12);
            }
        }
        let point = surface.evaluate(0.4, 0.7);
        assert!(point.du.cross(&point.dv).z > 0.0);
    }

    #[test]
    fn outliers_in_the_map_do_not_tear_the_border() {
        let (border, mut maps) = case();
        for k in 0..maps.visible.depth.len() {
            let [x, y] = maps.visible.center(k);
            if x > 3.0 && (0.5..1.2).contains(&y) {
                maps.visible.depth[k] += 2.0;
            }
        }
        let corners = border.choose_corners().unwrap();
        let curves = BorderCurves::new(&border, corners, &maps, [30, 30]).unwrap();
        for p in &curves.points {
            assert!((p.z + saddle(p.x, p.y)).abs() < 0.25, "{p:?} {}", p.z + saddle(p.x, p.y));
        }
    }

    #[test]
    fn maps_that_miss_the_border_are_an_error() {
        let (border, mut maps) = case();
        maps.visible = LayerMap::empty(64, 4.4);
        assert!(matches!(
            BorderCurves::new(&border, [0, 200, 400, 600], &maps, [30, 30]),
            Err(Error::Degenerate { .. })
        ));
        assert!(BorderCurves::new(&border, [0, 400, 200, 600], &maps, [30, 30]).is_err());
    }
}
