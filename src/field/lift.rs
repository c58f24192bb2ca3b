//! From the canvas to the surface: feature lines become constraints, the network's maps become a guess.

use super::conjugate_field::ConjugateField;
use super::polyvector::PolyVector;
use super::smooth::DirectionConstraint;
use super::trace::Trace;
use crate::error::Error;
use crate::surface::{RayCaster, SurfaceMesh};
use nalgebra::{Point3, Vector2, Vector3};

/// Least cosine between a triangle's normal and the view at which directions are lifted; below it (84 degrees) they are noise.
const STEEPEST_COSINE: f64 = 0.1;
/// Least angle between the roots of an averaged PolyVector that still counts as a cross, radians.
const LEAST_CROSSING: f64 = 0.05;

/// How a mesh is seen: an orthographic view, and where the canonical square lies in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CanvasView {
    /// Canvas right, canvas up and towards the viewer, orthonormal, in the frame of the mesh.
    pub axes: [Vector3<f64>; 3],
    /// View coordinates (p . right, p . up) of the centre of the canonical square.
    pub center: [f64; 2],
    /// Canonical units per unit of the mesh.
    pub scale: f64,
}

impl Default for CanvasView {
    /// For a mesh in the canonical frame.
    fn default() -> Self {
        Self { axes: [Vector3::x(), Vector3::y(), Vector3::z()], center: [0.0; 2], scale: 1.0 }
    }
}

impl CanvasView {
    /// Canonical x, y of a point of the mesh.
    pub fn canonical(&self, point: &Point3<f64>) -> [f64; 2] {
        [0, 1].map(|k| (point.coords.dot(&self.axes[k]) - self.center[k]) * self.scale)
    }

    /// The tangent vector of the plane with this `normal` that is seen as `direction` (canvas right, canvas up).
    ///
    /// Not unit. `None` where the plane is seen at less than 6 degrees or the direction is 0 or not finite.
    pub fn lift(&self, direction: Vector2<f64>, normal: &Vector3<f64>) -> Option<Vector3<f64>> {
        let [x, y, z] = self.axes.map(|a| a.dot(normal));
        let usable = direction.norm_squared() > 0.0 && direction.iter().all(|c| c.is_finite());
        (z.abs() >= STEEPEST_COSINE && usable).then(|| {
            let depth = -(direction.x * x + direction.y * y) / z;
            self.axes[0] * direction.x + self.axes[1] * direction.y + self.axes[2] * depth
        })
    }
}

/// A field of crosses in the canvas plane for the visible and the occluded layer, as the network gives it.
///
/// Pixel (row, column) of an n x n map has its centre at x = -H + (column + 0.5) 2H / n, y = H - (row + 0.5) 2H / n, canonical units; rows one
/// after another from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct CanvasField {
    size: usize,
    half_extent: f64,
    layers: [Vec<PolyVector>; 2],
    coverage: [Vec<f32>; 2],
}

impl CanvasField {
    /// Takes the network's output.
    ///
    /// - `half_extent`: H.
    /// - `channels`: 8 maps of n x n: Re s, Im s, Re p, Im p of the visible layer, then of the occluded one.
    /// - `coverage`: share of each pixel that the visible and the occluded layer cover, in [0, 1]; pixels are trusted by it.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if the lengths disagree or H is not positive.
    pub fn new(half_extent: f64, channels: &[f32], coverage: [&[f32]; 2]) -> Result<Self, Error> {
        let pixels = coverage[0].len();
        let size = pixels.isqrt();
        if size * size != pixels
            || size == 0
            || coverage[1].len() != pixels
            || channels.len() != 8 * pixels
            || half_extent.is_nan()
            || half_extent <= 0.0
        {
            let lengths = [channels.len(), pixels, coverage[1].len()];
            return Err(Error::Degenerate {
                reason: format!("direction maps of {lengths:?} values over {half_extent}"),
            });
        }
        let layer = |l: usize| {
            let value = |c: usize, i: usize| f64::from(channels[(4 * l + c) * pixels + i]);
            (0..pixels).map(|i| PolyVector::from_array([0, 1, 2, 3].map(|c| value(c, i)))).collect()
        };
        Ok(Self { size, half_extent, layers: [layer(0), layer(1)], coverage: coverage.map(<[f32]>::to_vec) })
    }

    /// The coefficients of a layer (0 visible, 1 occluded) at canonical (x, y): bilinear, weighted by coverage; `None` where less than
    /// a tenth of the four pixels around is covered.
    pub fn sample(&self, layer: usize, [x, y]: [f64; 2]) -> Option<PolyVector> {
        let pixel = 2.0 * self.half_extent / self.size as f64;
        let last = (self.size - 1) as f64;
        let column = ((x + self.half_extent) / pixel - 0.5).clamp(0.0, last);
        let row = ((self.half_extent - y) / pixel - 0.5).clamp(0.0, last);
        let (c, r) = (column.floor(), row.floor());
        let mut sum = [0.0; 4];
        let mut total = 0.0;
        for (dr, dc) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let (i, j) = ((r as usize + dr).min(self.size - 1), (c as usize + dc).min(self.size - 1));
            let along = if dc == 1 { column - c } else { 1.0 - (column - c) };
            let down = if dr == 1 { row - r } else { 1.0 - (row - r) };
            let value = self.layers[layer][i * self.size + j].to_array();
            let weight = along * down * f64::from(self.coverage[layer][i * self.size + j]);
            if weight > 0.0 && value.iter().all(|v| v.is_finite()) {
                (0..4).for_each(|k| sum[k] += weight * value[k]);
                total += weight;
            }
        }
        (total > 0.1).then(|| PolyVector::from_array(sum.map(|s| s / total)))
    }
}

/// The guess for [`super::conjugate_field`]: the canvas field lifted to each triangle along the view.
///
/// The layer of a triangle is its place along the line of sight through its middle: the nearest sheet is visible, the next one occluded.
/// Triangles further behind, too steep, or where the map has no cross get two zero vectors: no guess.
///
/// - `caster`: of `mesh` along the axes of `view`.
pub fn guess_from_canvas(
    mesh: &SurfaceMesh,
    caster: &RayCaster,
    view: &CanvasView,
    field: &CanvasField,
) -> Vec<[Vector3<f64>; 2]> {
    (0..mesh.triangles.len())
        .map(|t| lifted_cross(mesh, view, field, caster, t).unwrap_or([Vector3::zeros(); 2]))
        .collect()
}

fn lifted_cross(
    mesh: &SurfaceMesh,
    view: &CanvasView,
    field: &CanvasField,
    caster: &RayCaster,
    t: usize,
) -> Option<[Vector3<f64>; 2]> {
    let [a, b, c] = mesh.triangles[t].map(|v| mesh.position(v).coords);
    let middle = Point3::from((a + b + c) / 3.0);
    let [x, y] = [0, 1].map(|k| middle.coords.dot(&view.axes[k]));
    let layer = caster.hits(x, y).iter().position(|hit| hit.triangle as usize == t)?;
    if layer > 1 {
        return None;
    }
    let poly = field.sample(layer, view.canonical(&middle))?;
    if poly.cross()?.crossing() < LEAST_CROSSING {
        return None;
    }
    let normal = mesh.triangle_normal_area(t).0;
    let [u, v] = poly.directions();
    Some([view.lift(u, &normal)?.normalize(), view.lift(v, &normal)?.normalize()])
}

/// Constraints along feature lines drawn over a mesh.
///
/// - `caster`: of `mesh` along the axes of `view`.
/// - `lines`: polylines in view coordinates (p . right, p . up), in the unit of the mesh.
/// - `weight`: as in [`DirectionConstraint`], for a triangle that a line crosses over its full width; infinite for hard constraints.
///
/// A line is on the sheet nearest to the viewer. Each line gives at most one constraint on each triangle, the mean direction over the
/// triangle; soft ones weigh less where the line only touches the triangle. What lies beside the surface, or where it is seen at less than 6 degrees,
/// is left out.
///
/// # Errors
/// [`Error::NotFinite`] names the first line with a bad coordinate.
pub fn constraints_from_lines(
    mesh: &SurfaceMesh,
    caster: &RayCaster,
    view: &CanvasView,
    lines: &[Vec<[f64; 2]>],
    weight: f64,
) -> Result<Vec<DirectionConstraint>, Error> {
    let size = mean_size(mesh);
    let mut constraints = vec![];
    for (index, line) in lines.iter().enumerate() {
        if !line.iter().flatten().all(|c| c.is_finite()) {
            return Err(Error::NotFinite { what: "feature line", index });
        }
        let mut pieces: Vec<(u32, Vector3<f64>)> = vec![];
        for pair in line.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|p| Vector2::new(p[0], p[1]));
            // Fine enough that few triangles are skipped, bounded for lines far larger than the mesh.
            let steps = ((b - a).norm() / (0.25 * size)).ceil().clamp(1.0, 4000.0) as usize;
            for i in 0..steps {
                let middle = a + (b - a) * ((i as f64 + 0.5) / steps as f64);
                let Some(hit) = caster.hits(middle.x, middle.y).first().copied() else { continue };
                let normal = mesh.triangle_normal_area(hit.triangle as usize).0;
                if let Some(direction) = view.lift((b - a) / steps as f64, &normal) {
                    pieces.push((hit.triangle, direction));
                }
            }
        }
        collect_pieces(pieces, size, weight, &mut constraints);
    }
    Ok(constraints)
}

/// Constraints along a curve on the surface, e.g. one that was traced along another field, or the image of a host's curve.
///
/// `weight` as in [`constraints_from_lines`].
pub fn constraints_along(field: &ConjugateField, trace: &Trace, weight: f64) -> Vec<DirectionConstraint> {
    let pieces = trace.triangles.iter().enumerate().map(|(i, &t)| (t, trace.points[i + 1] - trace.points[i])).collect();
    let mut constraints = vec![];
    collect_pieces(pieces, mean_size(&field.mesh), weight, &mut constraints);
    constraints
}

/// Constraints along polylines in the parameter domain, e.g. curves of constant parameter, or curves that a host drew on its surface.
///
/// - `curves`: points (u, v); what lies outside the domain is left out.
/// - `weight` as in [`constraints_from_lines`].
///
/// # Errors
/// [`Error::NotFinite`] names the first curve with a bad coordinate.
pub fn constraints_from_parameters(
    mesh: &SurfaceMesh,
    curves: &[Vec<[f64; 2]>],
    weight: f64,
) -> Result<Vec<DirectionConstraint>, Error> {
    let size = mean_size(mesh);
    let mut constraints = vec![];
    for (index, curve) in curves.iter().enumerate() {
        if !curve.iter().flatten().all(|c| c.is_finite()) {
            return Err(Error::NotFinite { what: "feature curve", index });
        }
        let mut pieces = vec![];
        for pair in curve.windows(2) {
            let cells = [0, 1].map(|k| {
                let last = mesh.parameters[mesh.parameters.len() - 1][k];
                (pair[1][k] - pair[0][k]).abs() / (last - mesh.parameters[0][k]) * mesh.cells[k] as f64
            });
            let steps = (4.0 * cells[0].max(cells[1])).ceil().clamp(1.0, 4000.0) as usize;
            for i in 0..steps {
                let at = |s: f64| [0, 1].map(|k| pair[0][k] + (pair[1][k] - pair[0][k]) * s / steps as f64);
                let (from, middle, to) = (at(i as f64), at(i as f64 + 0.5), at(i as f64 + 1.0));
                if let Some(t) = locate(mesh, middle) {
                    // The triangle's linear map from parameters to space.
                    let corners = mesh.triangles[t as usize];
                    let p = corners.map(|v| mesh.position(v));
                    let q = corners.map(|v| Vector2::from(mesh.parameters[v as usize]));
                    let (e, f, d) = (q[1] - q[0], q[2] - q[0], Vector2::from(to) - Vector2::from(from));
                    let determinant = e.perp(&f);
                    pieces.push((t, ((p[1] - p[0]) * d.perp(&f) + (p[2] - p[0]) * e.perp(&d)) / determinant));
                }
            }
        }
        collect_pieces(pieces, size, weight, &mut constraints);
    }
    Ok(constraints)
}

/// The triangle that holds a point of the parameter domain.
pub(super) fn locate(mesh: &SurfaceMesh, point: [f64; 2]) -> Option<u32> {
    let [nu, nv] = mesh.cells;
    // Rows and columns of the grid have common parameters, not equally spaced in general.
    let column = |k: usize| {
        let stride = if k == 0 { nv + 1 } else { 1 };
        let at = |i: usize| mesh.parameters[i * stride][k];
        let count = mesh.cells[k];
        if !(point[k] >= at(0) && point[k] <= at(count)) {
            return None;
        }
        let (mut low, mut high) = (0, count);
        while high - low > 1 {
            let middle = (low + high) / 2;
            if at(middle) <= point[k] { low = middle } else { high = middle }
        }
        Some(low)
    };
    let (i, j) = (column(0)?.min(nu - 1), column(1)?.min(nv - 1));
    let first = 2 * (i * nv + j) as u32;
    let inside = |t: u32| {
        let [a, b, c] = mesh.triangles[t as usize].map(|v| Vector2::from(mesh.parameters[v as usize]));
        let p = Vector2::from(point);
        let least = |u: Vector2<f64>, v: Vector2<f64>| (v - u).perp(&(p - u));
        least(a, b).min(least(b, c)).min(least(c, a))
    };
    Some(if inside(first) >= inside(first + 1) { first } else { first + 1 })
}

/// Side of a square of two mean triangles.
fn mean_size(mesh: &SurfaceMesh) -> f64 {
    (2.0 * mesh.area() / mesh.triangles.len() as f64).sqrt()
}

/// One constraint for each run of pieces on one triangle.
fn collect_pieces(
    pieces: Vec<(u32, Vector3<f64>)>,
    size: f64,
    weight: f64,
    constraints: &mut Vec<DirectionConstraint>,
) {
    let mut i = 0;
    while i < pieces.len() {
        let triangle = pieces[i].0;
        let run = pieces[i..].iter().take_while(|p| p.0 == triangle).count();
        let direction: Vector3<f64> = pieces[i..i + run].iter().map(|p| p.1).sum();
        let share = (direction.norm() / size).min(1.0);
        // Hard ones are not to hang on a corner that the line barely touches.
        if share > 0.05 {
            let weight = if weight.is_finite() { weight * share } else { weight };
            constraints.push(DirectionConstraint { triangle, direction, weight });
        }
        i += run;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Control;
    use crate::field::test_surfaces::*;
    use crate::field::{FieldOptions, conjugate_field};

    fn view() -> CanvasView {
        let toward = Vector3::new(0.4, -0.5, 0.8).normalize();
        let right = Vector3::z().cross(&toward).normalize();
        CanvasView { axes: [right, toward.cross(&right), toward], center: [0.1, -0.2], scale: 1.7 }
    }

    #[test]
    fn lifted_directions_are_tangent_and_seen_as_drawn() {
        let view = view();
        let normal = Vector3::new(0.2, 0.3, 0.9).normalize();
        let direction = Vector2::new(0.6, -0.8);
        let lifted = view.lift(direction, &normal).unwrap();
        assert!(lifted.dot(&normal).abs() < 1e-12);
        assert!((lifted.dot(&view.axes[0]) - direction.x).abs() < 1e-12);
        assert!((lifted.dot(&view.axes[1]) - direction.y).abs() < 1e-12);
        assert!(view.lift(direction, &view.axes[0]).is_none());
    }

    #[test]
    fn a_field_seen_on_the_canvas_comes_back_as_the_guess() {
        let view = view();
        let mesh = SurfaceMesh::new(&wavy(1), [20, 20]).unwrap();
        let field = conjugate_field(mesh, None, &[], &FieldOptions::default(), &Control::default()).unwrap();
        // Draw the field as the generator does, one cross a pixel.
        let (n, half) = (64, 4.0);
        let caster = RayCaster::new(&field.mesh, view.axes);
        let mut channels = vec![0f32; 8 * n * n];
        let mut coverage = [vec![0f32; n * n], vec![0f32; n * n]];
        for r in 0..n {
            for c in 0..n {
                let x = -half + (c as f64 + 0.5) * 2.0 * half / n as f64;
                let y = half - (r as f64 + 0.5) * 2.0 * half / n as f64;
                let hits = caster.hits(x / view.scale + view.center[0], y / view.scale + view.center[1]);
                for (layer, hit) in hits.iter().enumerate().take(2) {
                    let flat = field.directions[hit.triangle as usize]
                        .map(|d| Vector2::new(d.dot(&view.axes[0]), d.dot(&view.axes[1])).normalize());
                    let values = PolyVector::from_directions(flat[0], flat[1]).to_array();
                    for k in 0..4 {
                        channels[(4 * layer + k) * n * n + r * n + c] = values[k] as f32;
                    }
                    coverage[layer][r * n + c] = 1.0;
                }
            }
        }
        let canvas = CanvasField::new(half, &channels, [&coverage[0], &coverage[1]]).unwrap();
        let guess = guess_from_canvas(&field.mesh, &RayCaster::new(&field.mesh, view.axes), &view, &canvas);
        let guessed = guess.iter().filter(|g| g[0].norm() > 0.0).count();
        assert!(guessed > guess.len() * 8 / 10, "{guessed} of {}", guess.len());
        let mut worst: Vec<f64> = vec![];
        for (t, pair) in guess.iter().enumerate().filter(|(_, g)| g[0].norm() > 0.0) {
            for d in pair {
                let cosine = field.directions[t].iter().map(|e| e.dot(d).abs()).fold(0.0, f64::max);
                worst.push(cosine.min(1.0).acos().to_degrees());
            }
        }
        worst.sort_by(f64::total_cmp);
        assert!(worst[worst.len() / 2] < 2.0 && worst[worst.len() * 95 / 100] < 10.0);
        // Solving with that guess stays at the field.
        let options = FieldOptions::default();
        let again = conjugate_field(field.mesh.clone(), Some(&guess), &[], &options, &Control::default()).unwrap();
        let mean: f64 = (0..guess.len())
            .map(|t| {
                let cosine = |d: &Vector3<f64>| field.directions[t].iter().map(|e| e.dot(d).abs()).fold(0.0, f64::max);
                again.directions[t].iter().map(|d| cosine(d).min(1.0).acos().to_degrees()).sum::<f64>() / 2.0
            })
            .sum::<f64>()
            / guess.len() as f64;
        assert!(mean < 4.0, "{mean} degrees");
        assert!(CanvasField::new(half, &channels[1..], [&coverage[0], &coverage[1]]).is_err());
    }

    #[test]
    fn drawn_lines_constrain_the_front_sheet() {
        let view = view();
        let mesh = SurfaceMesh::new(&wavy(2), [20, 20]).unwrap();
        // The image of a parameter line.
        let line: Vec<[f64; 2]> = (0..=40)
            .map(|i| {
                let p = &mesh.points[(i / 2) * 21 + 9].position.coords;
                [p.dot(&view.axes[0]), p.dot(&view.axes[1])]
            })
            .collect();
        let constraints =
            constraints_from_lines(&mesh, &RayCaster::new(&mesh, view.axes), &view, &[line], 20.0).unwrap();
        assert!(constraints.len() > 10);
        for c in &constraints {
            let along: Vector3<f64> =
                mesh.triangles[c.triangle as usize].iter().map(|&v| mesh.points[v as usize].du).sum();
            assert!(c.direction.normalize().dot(&along.normalize()).abs() > 0.98);
            assert!(c.weight > 0.0 && c.weight <= 20.0);
        }
        assert!(
            constraints_from_lines(&mesh, &RayCaster::new(&mesh, view.axes), &view, &[vec![[f64::NAN, 0.0]]], 1.0)
                .is_err()
        );
        assert!(
            constraints_from_lines(
                &mesh,
                &RayCaster::new(&mesh, view.axes),
                &view,
                &[vec![[1e6, 0.0], [1e6, 1.0]]],
                1.0
            )
            .unwrap()
            .is_empty()
        );
    }

    #[test]
    fn parameter_curves_constrain_the_triangles_below_them() {
        let mesh = SurfaceMesh::new(&rotational(), [16, 12]).unwrap();
        let constraints = constraints_from_parameters(&mesh, &[vec![[0.3, -0.5], [0.3, 1.5]]], 20.0).unwrap();
        assert!(constraints.len() >= 12);
        for c in &constraints {
            let corners = mesh.triangles[c.triangle as usize];
            let range = corners.map(|v| mesh.parameters[v as usize][0]);
            assert!(range.iter().any(|&u| u <= 0.3 + 1e-9) && range.iter().any(|&u| u >= 0.3 - 1e-9));
            let along: Vector3<f64> = corners.iter().map(|&v| mesh.points[v as usize].dv).sum();
            assert!(c.direction.normalize().dot(&along.normalize()).abs() > 0.995);
        }
    }
}
