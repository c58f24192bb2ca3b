//! The planarity equations of one face.

use nalgebra::Vector3;

/// The equations of one face.
pub(super) struct FaceEquations {
    pub(super) normal: Vector3<f64>,
    /// Projector onto what an affine function on the face's plane cannot reach, k x k, row by row.
    pub(super) projector: Vec<f64>,
    /// Projector times n . v_i, in mean edge lengths.
    pub(super) residual: Vec<f64>,
}

impl FaceEquations {
    /// `None` for triangles and for faces on a line, which are planar.
    pub(super) fn new(corners: &[Vector3<f64>]) -> Option<Self> {
        let count = corners.len();
        if count < 4 {
            return None;
        }
        let center: Vector3<f64> = corners.iter().sum::<Vector3<f64>>() / count as f64;
        let local: Vec<Vector3<f64>> = corners.iter().map(|p| p - center).collect();
        let area: Vector3<f64> = (0..count).map(|k| local[k].cross(&local[(k + 1) % count])).sum();
        let spread: f64 = local.iter().map(|p| p.norm_squared()).sum();
        let normal = area.try_normalize(1e-12 * spread)?;
        let longest = local.iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
        let e1 = (longest - normal * normal.dot(longest)).try_normalize(1e-300)?;
        let e2 = normal.cross(&e1);
        let mut x: Vec<f64> = local.iter().map(|p| p.dot(&e1)).collect();
        let mut y: Vec<f64> = local.iter().map(|p| p.dot(&e2)).collect();
        // Gram-Schmidt; both are already orthogonal to the constant vector.
        let norm = |v: &[f64]| v.iter().map(|t| t * t).sum::<f64>().sqrt();
        let nx = norm(&x);
        x.iter_mut().for_each(|t| *t /= nx);
        let xy: f64 = x.iter().zip(&y).map(|(a, b)| a * b).sum();
        y.iter_mut().zip(&x).for_each(|(b, a)| *b -= xy * a);
        let ny = norm(&y);
        if ny <= 1e-9 * nx {
            return None;
        }
        y.iter_mut().for_each(|t| *t /= ny);
        let mut projector = vec![0.0; count * count];
        for i in 0..count {
            for j in 0..count {
                let identity = if i == j { 1.0 } else { 0.0 };
                projector[i * count + j] = identity - 1.0 / count as f64 - x[i] * x[j] - y[i] * y[j];
            }
        }
        let heights: Vec<f64> = local.iter().map(|p| normal.dot(p)).collect();
        let residual = product(&projector, &heights);
        Some(Self { normal, projector, residual })
    }
}

pub(super) fn product(matrix: &[f64], vector: &[f64]) -> Vec<f64> {
    matrix.chunks_exact(vector.len()).map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum()).collect()
}
