//! Meshes with offsets: circular and conical quads, by alternating sums of angles.

use super::panel_mesh::PanelMesh;
use nalgebra::{Point3, Vector3};

/// Which offsets a planar quad mesh should have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OffsetKind {
    /// Any.
    #[default]
    Any,
    /// Circular: each quad has a circumscribed circle, so there are offsets at constant distance between vertices.
    Circular,
    /// Conical: the panels around each vertex touch a cone, so there are offsets at constant distance between panels, and
    /// beams whose middle planes meet along an axis at each node.
    Conical,
}

/// Four angles, (apex, from, to) each, whose alternating sum a + c - b - d should vanish.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AngleSum {
    pub angles: [[u32; 3]; 4],
}

impl AngleSum {
    /// The sum in radians and its derivative by each angle's apex, from and to; `None` where an angle has no derivative.
    pub fn evaluate(&self, vertices: &[Point3<f64>]) -> Option<(f64, [[Vector3<f64>; 3]; 4])> {
        let mut sum = 0.0;
        let mut gradients = [[Vector3::zeros(); 3]; 4];
        for (k, corners) in self.angles.iter().enumerate() {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            let [apex, from, to] = corners.map(|v| vertices[v as usize]);
            let (value, gradient) = angle(apex, from, to)?;
            sum += sign * value;
            gradients[k] = gradient.map(|g| g * sign);
        }
        Some((sum, gradients))
    }
}

/// The angle at `apex`, radians, and its derivatives by apex, from and to; `None` if it is 0 or pi.
fn angle(apex: Point3<f64>, from: Point3<f64>, to: Point3<f64>) -> Option<(f64, [Vector3<f64>; 3])> {
    let (a, b) = (from - apex, to - apex);
    let (length_a, length_b) = (a.norm(), b.norm());
    let (a, b) = (a.try_normalize(0.0)?, b.try_normalize(0.0)?);
    let cos = a.dot(&b);
    let away_b = (b - a * cos).try_normalize(1e-9)?;
    let away_a = (a - b * cos).try_normalize(1e-9)?;
    let (by_from, by_to) = (-away_b / length_a, -away_a / length_b);
    Some((a.cross(&b).norm().atan2(cos), [-by_from - by_to, by_from, by_to]))
}

/// The sums that vanish for meshes of the given kind: one for each quad, or one for each inner vertex of four edges.
pub(crate) fn angle_sums(mesh: &PanelMesh, kind: OffsetKind) -> Vec<AngleSum> {
    match kind {
        OffsetKind::Any => vec![],
        OffsetKind::Circular => mesh
            .faces()
            .filter(|face| face.len() == 4)
            .map(|face| AngleSum { angles: [0, 1, 2, 3].map(|k| [face[k], face[(k + 1) % 4], face[(k + 3) % 4]]) })
            .collect(),
        OffsetKind::Conical => stars(mesh)
            .into_iter()
            .map(|(vertex, ring)| AngleSum { angles: [0, 1, 2, 3].map(|k| [vertex, ring[k], ring[(k + 1) % 4]]) })
            .collect(),
    }
}

/// The inner vertices of four edges, ascending, each with its neighbours in order around it.
fn stars(mesh: &PanelMesh) -> Vec<(u32, [u32; 4])> {
    // Vertex, next vertex along the face, previous one.
    let mut corners: Vec<[u32; 3]> = Vec::with_capacity(mesh.indices.len());
    for face in mesh.faces() {
        let count = face.len();
        corners.extend((0..count).map(|k| [face[k], face[(k + 1) % count], face[(k + count - 1) % count]]));
    }
    corners.sort_unstable();
    corners
        .chunk_by(|a, b| a[0] == b[0])
        .filter(|group| group.len() == 4)
        .filter_map(|group| {
            let follow = |edge: u32| group.iter().find(|c| c[1] == edge).map(|c| c[2]);
            let a = group[0][1];
            let b = follow(a)?;
            let c = follow(b)?;
            let d = follow(c)?;
            let distinct = a != c && b != d && a != b && a != d && b != c && c != d;
            (distinct && follow(d) == Some(a)).then_some((group[0][0], [a, b, c, d]))
        })
        .collect()
}

/// How far each quad is from having a circumscribed circle: |a - b + c - d| of its angles, radians; 0 for other faces.
///
/// A planar convex quad is circular if and only if this vanishes.
///
/// # Source
/// Liu et al. 2006, "Geometric modeling with conical meshes and developable surfaces", Sec. 2.
pub fn circularity(mesh: &PanelMesh) -> Vec<f64> {
    let mut sums = angle_sums(mesh, OffsetKind::Circular).into_iter();
    mesh.faces()
        .map(|face| if face.len() == 4 { sums.next().map_or(0.0, |sum| value(&sum, mesh)) } else { 0.0 })
        .collect()
}

/// How far the panels around each vertex are from touching a cone: |a - b + c - d| of the angles around an inner vertex of four
/// edges, radians; 0 for other vertices.
///
/// # Source
/// Liu et al. 2006, Sec. 2: a vertex of a planar quad mesh is conical if and only if this vanishes.
pub fn conicality(mesh: &PanelMesh) -> Vec<f64> {
    let mut values = vec![0.0; mesh.vertices.len()];
    for sum in angle_sums(mesh, OffsetKind::Conical) {
        values[sum.angles[0][0] as usize] = value(&sum, mesh);
    }
    values
}

fn value(sum: &AngleSum, mesh: &PanelMesh) -> f64 {
    sum.evaluate(&mesh.vertices).map_or(0.0, |(value, _)| value.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A net of parallels and meridians on a surface of revolution, which is circular and conical.
    fn turned(n: u32) -> PanelMesh {
        let vertices = (0..=n)
            .flat_map(|i| (0..=n).map(move |j| (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n))))
            .map(|(s, t)| {
                let radius = 2.0 - 1.4 * t * (1.2 - t);
                Point3::new(radius * (1.5 * s).cos(), radius * (1.5 * s).sin(), 3.0 * t)
            })
            .collect();
        let faces: Vec<[u32; 4]> = (0..n * n)
            .map(|k| {
                let a = k / n * (n + 1) + k % n;
                [a, a + n + 1, a + n + 2, a + 1]
            })
            .collect();
        PanelMesh::new(vertices, &faces).unwrap()
    }

    #[test]
    fn a_net_of_revolution_is_circular_and_conical() {
        let mesh = turned(6);
        assert!(circularity(&mesh).iter().all(|c| *c < 1e-12));
        assert!(conicality(&mesh).iter().all(|c| *c < 1e-12));
        assert_eq!(angle_sums(&mesh, OffsetKind::Conical).len(), 25);
        let mut bent = mesh;
        bent.vertices[24] += Vector3::new(0.1, -0.05, 0.08);
        assert_eq!(circularity(&bent).iter().filter(|c| **c > 1e-3).count(), 4);
        assert!(conicality(&bent)[24] > 1e-3);
    }

    #[test]
    fn angle_sums_have_the_right_derivatives() {
        let mut mesh = turned(3);
        mesh.vertices[5] += Vector3::new(0.1, -0.05, 0.2);
        for kind in [OffsetKind::Circular, OffsetKind::Conical] {
            for sum in angle_sums(&mesh, kind) {
                let (_, gradients) = sum.evaluate(&mesh.vertices).unwrap();
                for v in 0..mesh.vertices.len() {
                    for axis in 0..3 {
                        let expected: f64 = (0..12)
                            .filter(|k| sum.angles[k / 3][k % 3] as usize == v)
                            .map(|k| gradients[k / 3][k % 3][axis])
                            .sum();
                        let at = |h: f64| {
                            let mut moved = mesh.vertices.clone();
                            moved[v][axis] += h;
                            sum.evaluate(&moved).unwrap().0
                        };
                        let h = 1e-6;
                        assert!(((at(h) - at(-h)) / (2.0 * h) - expected).abs() < 1e-7);
                    }
                }
            }
        }
    }
}
