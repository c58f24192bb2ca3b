//! The triangles of a field as the energy of the map sees them.

use super::conjugate_field::ConjugateField;
use super::seams::Seams;
use crate::error::Error;
use nalgebra::Vector3;

/// What the energy needs of one triangle.
pub(super) struct Element {
    pub area: f64,
    /// Derivatives of the three hat functions along the combed directions d_0, d_1.
    pub along: [[f64; 3]; 2],
    /// Gradients of the hat functions in an orthonormal frame.
    pub gradient: [[f64; 2]; 3],
    /// Sine of the crossing angle.
    pub crossing: f64,
    /// Lines on the triangle that the map follows.
    pub lines: Vec<Line>,
}

/// A line that one family of isolines follows on a triangle.
pub(super) struct Line {
    /// Number of the combed direction that the line belongs to.
    pub family: usize,
    /// Derivatives of the three hat functions along the line.
    pub along: [f64; 3],
    /// Weight of the squared angle, the field weighing 1.
    pub weight: f64,
}

/// What the energy needs of each triangle of `field`.
///
/// # Errors
/// [`Error::Degenerate`] if the surface has no area.
pub(super) fn elements(field: &ConjugateField, seams: &Seams) -> Result<Vec<Element>, Error> {
    let mesh = &field.mesh;
    let mut elements = Vec::with_capacity(mesh.triangles.len());
    let mut total = 0.0;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.triangles[t].map(|v| mesh.position(v));
        let sides = [c - b, a - c, b - a];
        let longest = sides.iter().map(|s| s.norm_squared()).fold(0.0, f64::max);
        let (mut normal, mut area) = mesh.triangle_normal_area(t);
        if area <= 1e-9 * longest {
            // Without area there is no gradient: such a triangle, at a collapsed side, gets next to no say.
            let [u, v] = field.layout[t];
            normal = u.cross(&v).try_normalize(1e-300).unwrap_or_else(Vector3::z);
            area = (1e-9 * longest).max(f64::MIN_POSITIVE);
        }
        total += area;
        let hats = sides.map(|s| normal.cross(&s) / (2.0 * area));
        let directions = [0, 1].map(|i| field.layout_direction(t as u32, (seams.name[t] + i) as usize));
        let x = directions[0].normalize();
        let y = normal.cross(&x);
        elements.push(Element {
            area,
            along: directions.map(|d| hats.map(|g| g.dot(&d))),
            gradient: hats.map(|g| [g.dot(&x), g.dot(&y)]),
            crossing: directions[0].cross(&directions[1]).norm().clamp(0.05, 1.0),
            lines: vec![],
        });
    }
    if !(total > 0.0 && total.is_finite()) {
        return Err(Error::Degenerate { reason: "the surface has no area".into() });
    }
    add_lines(field, seams, &mut elements);
    Ok(elements)
}

/// Weight of following a line that the field was asked to follow, the field itself weighing 1.
const LINE_WEIGHT: f64 = 10.0;
/// Weight of a constraint that counts half of that; hard ones count in full.
const HALF_WEIGHT: f64 = 30.0;

/// Gives each element the lines on its triangle.
fn add_lines(field: &ConjugateField, seams: &Seams, elements: &mut [Element]) {
    for line in field.lines.iter().chain(&field.parallels) {
        let t = line.triangle as usize;
        let along = [0, 1].map(|i| field.layout_direction(line.triangle, (seams.name[t] + i) as usize));
        let family = usize::from(along[1].dot(&line.direction).abs() > along[0].dot(&line.direction).abs());
        let share = if line.weight.is_finite() { line.weight / (line.weight + HALF_WEIGHT) } else { 1.0 };
        let [a, b, c] = field.mesh.triangles[t].map(|v| field.mesh.position(v));
        let normal = field.mesh.triangle_normal_area(t).0;
        let hats = [c - b, a - c, b - a].map(|s| normal.cross(&s) / (2.0 * elements[t].area));
        elements[t].lines.push(Line {
            family,
            along: hats.map(|g| g.dot(&line.direction)),
            weight: LINE_WEIGHT * share,
        });
    }
}
