//! A triangle mesh over the whole parameter domain of a surface.

use super::curvature::FundamentalForms;
use super::nurbs::{NurbsSurface, SurfacePoint};
use crate::error::Error;
use nalgebra::{Point3, Vector3};

/// A regular triangulation of a surface's parameter domain, lifted to the surface.
///
/// Vertex (i, j) is at `i * (cells[1] + 1) + j`; i counts along u. Each cell is cut in two triangles, counter-clockwise in
/// the parameter plane, so that triangle normals agree with S_u x S_v. Its border is exactly the surface's border.
#[derive(Clone, Debug)]
pub struct SurfaceMesh {
    /// Number of cells in u and v.
    pub cells: [usize; 2],
    /// Parameters of each vertex.
    pub parameters: Vec<[f64; 2]>,
    /// Surface points with derivatives, one for each vertex.
    pub points: Vec<SurfacePoint>,
    /// Unit normals S_u x S_v, one for each vertex.
    pub normals: Vec<Vector3<f64>>,
    /// Three vertex indices for each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Surface points at the means of the triangles' parameters, one for each triangle; empty unless asked for, see
    /// [`SurfaceMesh::with_middles`].
    pub middles: Vec<SurfacePoint>,
}

impl SurfaceMesh {
    /// Samples `surface` on a grid of `cells` cells; the diagonal of each cell is its shorter one, but at the patch's corners it ends there, so
    /// that no triangle has two edges on the border.
    ///
    /// # Errors
    /// [`Error::Degenerate`] if the surface has no normal at an inner grid point.
    pub fn new(surface: &NurbsSurface, cells: [usize; 2]) -> Result<Self, Error> {
        let [nu, nv] = cells.map(|c| c.max(1));
        let fractions = |n: usize| (0..=n).map(move |i| i as f64 / n as f64);
        let us: Vec<f64> = fractions(nu).map(|s| surface.knots()[0].at_fraction(s)).collect();
        let vs: Vec<f64> = fractions(nv).map(|t| surface.knots()[1].at_fraction(t)).collect();
        let points = surface.evaluate_grid(&us, &vs);
        let mut parameters = Vec::with_capacity(points.len());
        let mut normals = Vec::with_capacity(points.len());
        for (i, s) in fractions(nu).enumerate() {
            for (j, t) in fractions(nv).enumerate() {
                let (u, v) = (us[i], vs[j]);
                let point = &points[i * (nv + 1) + j];
                // A collapsed side (a pole) has no normal: take the one just inside.
                let forms = FundamentalForms::new(point).or_else(|| {
                    let [u, v] = surface.at_fraction(s.clamp(1e-4, 1.0 - 1e-4), t.clamp(1e-4, 1.0 - 1e-4));
                    FundamentalForms::new(&surface.evaluate(u, v))
                });
                let Some(forms) = forms else {
                    return Err(Error::Degenerate { reason: format!("the surface has no normal at ({u:.4}, {v:.4})") });
                };
                parameters.push([u, v]);
                normals.push(forms.normal);
            }
        }
        let triangles = triangulated([nu, nv], &points);
        Ok(Self { cells: [nu, nv], parameters, points, normals, triangles, middles: vec![] })
    }

    /// The same with the surface points at the triangles' middles.
    ///
    /// # Errors
    /// As [`SurfaceMesh::new`].
    pub fn with_middles(surface: &NurbsSurface, cells: [usize; 2]) -> Result<Self, Error> {
        let mut mesh = Self::new(surface, cells)?;
        let middle = |corners: &[u32; 3]| {
            let [u, v] = [0, 1].map(|k| corners.iter().map(|&c| mesh.parameters[c as usize][k]).sum::<f64>() / 3.0);
            surface.evaluate(u, v)
        };
        mesh.middles = mesh.triangles.iter().map(middle).collect();
        Ok(mesh)
    }

    /// The mesh of every second grid line, rounded up, without middles; its border is sampled at the same ends.
    pub fn thinned(&self) -> Self {
        let cells = self.cells.map(|n| n.div_ceil(2));
        let line = |k: usize, i: usize| i * self.cells[k] / cells[k];
        let kept: Vec<usize> = (0..=cells[0])
            .flat_map(|i| (0..=cells[1]).map(move |j| (i, j)))
            .map(|(i, j)| line(0, i) * (self.cells[1] + 1) + line(1, j))
            .collect();
        let points: Vec<SurfacePoint> = kept.iter().map(|&v| self.points[v]).collect();
        Self {
            cells,
            parameters: kept.iter().map(|&v| self.parameters[v]).collect(),
            normals: kept.iter().map(|&v| self.normals[v]).collect(),
            triangles: triangulated(cells, &points),
            points,
            middles: vec![],
        }
    }

    /// Position of vertex `index`.
    pub fn position(&self, index: u32) -> Point3<f64> {
        self.points[index as usize].position
    }

    /// Unit normal and area of a triangle.
    pub fn triangle_normal_area(&self, triangle: usize) -> (Vector3<f64>, f64) {
        let [a, b, c] = self.triangles[triangle].map(|k| self.position(k));
        let cross = (b - a).cross(&(c - a));
        let norm = cross.norm();
        (cross / norm.max(f64::MIN_POSITIVE), 0.5 * norm)
    }

    /// Area of all triangles.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| self.triangle_normal_area(t).1).sum()
    }
}

/// Two triangles for each cell of a grid of points, cut along the diagonal that ends in a corner of the grid, else along the shorter one.
fn triangulated([nu, nv]: [usize; 2], points: &[SurfacePoint]) -> Vec<[u32; 3]> {
    let mut triangles = Vec::with_capacity(2 * nu * nv);
    for i in 0..nu {
        for j in 0..nv {
            let corner = |a: usize, b: usize| (i + a) * (nv + 1) + j + b;
            let length = |a: usize, b: usize| (points[a].position - points[b].position).norm();
            let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            let [first, last] = [[i == 0, j == 0], [i + 1 == nu, j + 1 == nv]];
            let rising = first == [true; 2] || last == [true; 2];
            let falling = (first[0] && last[1]) || (last[0] && first[1]);
            let along_ac = if rising == falling { length(a, c) <= length(b, d) } else { rising };
            let pair = if along_ac { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            triangles.extend(pair.map(|t| t.map(|k| k as u32)));
        }
    }
    triangles
}
