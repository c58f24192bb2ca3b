//! Feature lines over a panel mesh, and the edges that should run along them.

use super::panel_mesh::PanelMesh;
use nalgebra::{Point3, Vector3};

/// A quad as a bilinear patch.
struct BilinearPanel {
    corners: [Vector3<f64>; 4],
    center: Vector3<f64>,
    /// Of a ball about the centre that holds the panel.
    radius: f64,
}

impl BilinearPanel {
    fn new(corners: [Vector3<f64>; 4]) -> Self {
        let center = corners.iter().sum::<Vector3<f64>>() / 4.0;
        let radius = corners.iter().map(|c| (c - center).norm()).fold(0.0, f64::max);
        Self { corners, center, radius }
    }

    /// Directions of the two families at (s, t) in the unit square.
    fn families(&self, [s, t]: [f64; 2]) -> [Vector3<f64>; 2] {
        let [a, b, c, d] = self.corners;
        [(b - a) * (1.0 - t) + (c - d) * t, (d - a) * (1.0 - s) + (c - b) * s]
    }

    /// Distance to the closest point, and its place.
    fn closest(&self, query: &Vector3<f64>) -> (f64, [f64; 2]) {
        let [a, b, c, d] = self.corners;
        let mut at = [0.5; 2];
        let apart = |[s, t]: [f64; 2]| query - ((a * (1.0 - s) + b * s) * (1.0 - t) + (d * (1.0 - s) + c * s) * t);
        for _ in 0..CLOSEST_ROUNDS {
            let (rest, [u, _]) = (apart(at), self.families(at));
            // One coordinate after the other, so that the square's sides need no care.
            at[0] = (at[0] + rest.dot(&u) / u.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            let (rest, [_, v]) = (apart(at), self.families(at));
            at[1] = (at[1] + rest.dot(&v) / v.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        }
        (apart(at).norm(), at)
    }
}

/// Rounds of the search for the closest point on a panel.
const CLOSEST_ROUNDS: usize = 12;

/// A piece of a feature line, and the panel that it runs over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeaturePiece {
    /// From the start of the piece to its end.
    pub along: Vector3<f64>,
    /// Number of the nearest quad's face.
    pub face: u32,
    /// Place of the point of that quad, taken as a bilinear patch, that is closest to the piece's middle: weights of its corners 0 and 1 are (1 - s)(1 - t)
    /// and s (1 - t), of 2 and 3 s t and (1 - s) t.
    pub place: [f64; 2],
}

/// The segments of the feature lines, each with the nearest quad; none where the mesh has no quads.
pub fn feature_pieces(lines: &[Vec<Point3<f64>>], mesh: &PanelMesh) -> Vec<FeaturePiece> {
    let quads: Vec<(u32, BilinearPanel)> = (0..mesh.face_count())
        .map(|f| (f as u32, mesh.face(f)))
        .filter(|(_, face)| face.len() == 4)
        .map(|(f, face)| (f, BilinearPanel::new([0, 1, 2, 3].map(|k| mesh.vertices[face[k] as usize].coords))))
        .collect();
    let mut pieces = vec![];
    // Of the piece before: most often also of the next one, which spares looking closely at the others.
    let mut near = None;
    for ends in lines.iter().flat_map(|line| line.windows(2)) {
        let (along, middle) = (ends[1] - ends[0], nalgebra::center(&ends[0], &ends[1]).coords);
        let mut best: Option<(f64, usize, [f64; 2])> = near.map(|k: usize| {
            let (distance, place) = quads[k].1.closest(&middle);
            (distance, k, place)
        });
        for (k, (_, quad)) in quads.iter().enumerate() {
            let least = (quad.center - middle).norm() - quad.radius;
            if near != Some(k) && best.is_none_or(|(distance, ..)| least < distance) {
                let (distance, place) = quad.closest(&middle);
                if best.is_none_or(|(nearest, ..)| distance < nearest) {
                    best = Some((distance, k, place));
                }
            }
        }
        near = best.map(|b| b.1);
        pieces.extend(best.map(|(_, k, place)| FeaturePiece { along, face: quads[k].0, place }));
    }
    pieces
}

impl FeaturePiece {
    /// How the two families of edges run at the piece's place, as weights of the quad's corners.
    pub fn families(&self) -> [[f64; 4]; 2] {
        let [s, t] = self.place;
        [[t - 1.0, 1.0 - t, t, -t], [s - 1.0, -s, s, 1.0 - s]]
    }

    /// The same as vectors.
    pub fn directions(&self, mesh: &PanelMesh) -> [Vector3<f64>; 2] {
        let face = mesh.face(self.face as usize);
        self.families().map(|weights| (0..4).map(|k| mesh.vertices[face[k] as usize].coords * weights[k]).sum())
    }
}

/// Sum over the segments of the feature lines of length times angle to the better aligned family of edges, degrees, and the
/// sum of the lengths.
///
/// The families are those of the nearest quad, taken as a bilinear patch, at the point closest to the segment's middle.
///
/// # Source
/// Sketch2PQ, Sec. 4.1 (D_f). As printed it is a sum, and to the closest edge, which is often one of the crossing
/// family.
pub fn feature_angle(lines: &[Vec<Point3<f64>>], mesh: &PanelMesh) -> [f64; 2] {
    let mut sum = [0.0; 2];
    for piece in feature_pieces(lines, mesh) {
        let along = piece.along;
        let angle = |family: Vector3<f64>| along.cross(&family).norm().atan2(along.dot(&family).abs()).to_degrees();
        sum[0] += along.norm() * piece.directions(mesh).map(angle).into_iter().fold(90.0, f64::min);
        sum[1] += along.norm();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One quad with corners (0, 0), (2, 0), (2, 3), (0, 1): its sides across run straight up, those along fan out.
    fn trapezoid() -> PanelMesh {
        let vertices = [[0.0, 0.0], [2.0, 0.0], [2.0, 3.0], [0.0, 1.0]].map(|[x, y]| Point3::new(x, y, 0.0)).to_vec();
        PanelMesh { vertices, starts: vec![0, 4], indices: vec![0, 1, 2, 3] }
    }

    #[test]
    fn feature_lines_are_held_against_the_edges_at_their_place() {
        let line = |a: [f64; 2], b: [f64; 2]| vec![[a, b].map(|[x, y]| Point3::new(x, y, 0.4)).to_vec()];
        let angle = |lines: &[Vec<Point3<f64>>]| {
            let [sum, length] = feature_angle(lines, &trapezoid());
            sum / length
        };
        // Halfway up the fan rises by one in two.
        assert!(angle(&line([0.5, 0.75], [1.5, 1.25])) < 1e-6);
        assert!((angle(&line([0.9, 1.0], [1.1, 1.0])) - 0.5f64.atan().to_degrees()).abs() < 1e-6);
        // At the lower side it is level; beyond the panel the nearest point counts.
        assert!(angle(&line([0.9, -0.5], [1.1, -0.5])) < 1e-6);
        // Straight up is the other family everywhere; twenty degrees off are twenty.
        let tilted = [1.0 + 0.1 * 20f64.to_radians().tan(), 1.1];
        assert!(angle(&line([1.0, 0.9], [1.0, 1.1])) < 1e-6);
        assert!((angle(&line([1.0, 1.0], tilted)) - 20.0).abs() < 0.5);
        assert_eq!(feature_angle(&[], &trapezoid()), [0.0, 0.0]);
    }
}
