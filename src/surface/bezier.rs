//! A surface as bicubic Bezier patches, for hosts that draw those.

use super::knots::KnotVector;
use super::nurbs::NurbsSurface;
use crate::error::Error;
use nalgebra::Point3;

/// Degree of the patches.
const CUBIC: usize = 3;

/// The polynomial pieces of a surface as bicubic Bezier patches, exactly: each piece of the patch equals the surface to rounding.
#[derive(Clone, Debug, PartialEq)]
pub struct BezierPatches {
    /// Number of pieces in u and v: the knot spans that are not empty.
    pub counts: [usize; 2],
    /// 16 control points for each piece, pieces and points with v running fastest: point (a, b) of piece (i, j) is at
    /// `16 * (i * counts[1] + j) + 4 * a + b`. Neighbours repeat the points of their common side.
    pub control_points: Vec<Point3<f64>>,
    /// Ends of the pieces in u and v, `counts[k] + 1` parameters each; piece (i, j) covers
    /// `[breaks[0][i], breaks[0][i + 1]] x [breaks[1][j], breaks[1][j + 1]]`, linearly.
    pub breaks: [Vec<f64>; 2],
}

impl BezierPatches {
    /// Cuts `surface` at its knots; degrees 1 and 2 are raised to 3.
    ///
    /// The control points of a piece are values of the surface's polar form: of S over \[a, b\], point k is the polar form at
    /// k times b and 3 - k times a.
    ///
    /// # Errors
    /// [`Error::Nurbs`] for a rational surface or a degree above 3, which no bicubic equals: sample those, see
    /// [`super::SurfaceGrid`].
    ///
    /// # Source
    /// Ramshaw, "Blossoms are polar forms", 1989; what inserting every knot until it has the degree's multiplicity gives.
    pub fn new(surface: &NurbsSurface) -> Result<Self, Error> {
        let degrees = surface.knots().each_ref().map(KnotVector::degree);
        if surface.weights().is_some() || degrees.iter().any(|&degree| degree > CUBIC) {
            let kind = if surface.weights().is_some() { "rational " } else { "" };
            let reason = format!("a {kind}surface of degrees {degrees:?} is no set of bicubic patches");
            return Err(Error::Nurbs { reason });
        }
        let [u, v] = surface.knots().each_ref().map(pieces);
        let columns = surface.counts()[1];
        let mut control_points = Vec::with_capacity(16 * u.len() * v.len());
        for piece_u in &u {
            for piece_v in &v {
                for row in &piece_u.weights {
                    for column in &piece_v.weights {
                        let mut sum = nalgebra::Vector3::zeros();
                        for (i, a) in row.iter().enumerate().take(degrees[0] + 1) {
                            for (j, b) in column.iter().enumerate().take(degrees[1] + 1) {
                                let index = (piece_u.first + i) * columns + piece_v.first + j;
                                sum += surface.control_points()[index].coords * (a * b);
                            }
                        }
                        control_points.push(Point3::from(sum));
                    }
                }
            }
        }
        let breaks = surface.knots().each_ref().map(KnotVector::breaks);
        Ok(Self { counts: [u.len(), v.len()], control_points, breaks })
    }
}

/// One polynomial piece of a direction: its four Bezier points as combinations of control points.
struct Piece {
    /// Index of the first control point that takes part.
    first: usize,
    /// `weights[k][i]`: share of control point `first + i` in Bezier point k.
    weights: [[f64; CUBIC + 1]; CUBIC + 1],
}

fn pieces(knots: &KnotVector) -> Vec<Piece> {
    let (degree, values) = (knots.degree(), knots.knots());
    let spans = (degree..knots.count()).filter(|&span| values[span] < values[span + 1]);
    spans
        .map(|span| {
            let ends = [values[span], values[span + 1]];
            let mut own = [[0.0; CUBIC + 1]; CUBIC + 1];
            for (k, weights) in own.iter_mut().enumerate().take(degree + 1) {
                let mut at = [ends[0]; CUBIC];
                at[..k].fill(ends[1]);
                *weights = polar_weights(values, degree, span, &at[..degree]);
            }
            Piece { first: span - degree, weights: raised(own, degree) }
        })
        .collect()
}

/// Shares of control points span - degree .. span in the polar form at the arguments `at` (de Boor, one argument a level).
fn polar_weights(knots: &[f64], degree: usize, span: usize, at: &[f64]) -> [f64; CUBIC + 1] {
    // Row i: what point i of the present level is made of.
    let mut rows = [[0.0; CUBIC + 1]; CUBIC + 1];
    for (i, row) in rows.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for (level, t) in at.iter().enumerate() {
        for i in 0..degree - level {
            let index = span + i + 1 + level - degree;
            let (low, high) = (knots[index], knots[index + degree - level]);
            let share = (t - low) / (high - low);
            let next = rows[i + 1];
            for (value, next) in rows[i].iter_mut().zip(next) {
                *value = (1.0 - share) * *value + share * next;
            }
        }
    }
    rows[0]
}

/// The same curve with four Bezier points.
fn raised(mut weights: [[f64; CUBIC + 1]; CUBIC + 1], degree: usize) -> [[f64; CUBIC + 1]; CUBIC + 1] {
    for from in degree..CUBIC {
        let before = weights;
        let share = |k: usize| k as f64 / (from + 1) as f64;
        for k in 0..=from + 1 {
            let lower = if k > 0 { before[k - 1] } else { [0.0; CUBIC + 1] };
            weights[k] = std::array::from_fn(|c| share(k) * lower[c] + (1.0 - share(k)) * before[k][c]);
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(degrees: [usize; 2], knots: [Vec<f64>; 2]) -> NurbsSurface {
        let knots = [0, 1].map(|k| KnotVector::new(degrees[k], knots[k].clone()).unwrap());
        let columns = knots[1].count();
        let net = (0..knots[0].count() * columns).map(|k| {
            let (i, j) = ((k / columns) as f64, (k % columns) as f64);
            Point3::new(i + 0.2 * (j * 1.7).sin(), j - 0.3 * (i * 2.1).cos(), (i * 1.3 + j * 0.7).sin())
        });
        NurbsSurface::new(knots.clone(), net.collect(), None).unwrap()
    }

    fn bezier(points: &[Point3<f64>], s: f64, t: f64) -> Point3<f64> {
        let basis = |t: f64| {
            let r = 1.0 - t;
            [r * r * r, 3.0 * t * r * r, 3.0 * t * t * r, t * t * t]
        };
        let (a, b) = (basis(s), basis(t));
        Point3::from((0..16).map(|k| points[k].coords * (a[k / 4] * b[k % 4])).sum::<nalgebra::Vector3<f64>>())
    }

    #[test]
    fn patches_are_the_surface_for_every_degree_and_knot_up_to_cubic() {
        let linear = vec![-1.0, -1.0, 0.5, 2.0, 2.0];
        let quadratic = vec![0.0, 0.0, 0.0, 0.3, 0.3, 1.0, 1.0, 1.0];
        let cubic = vec![2.0, 2.0, 2.0, 2.0, 2.1, 2.4, 2.4, 2.4, 3.0, 5.0, 5.0, 5.0, 5.0];
        for (degrees, knots) in [
            ([3, 3], [cubic.clone(), cubic.clone()]),
            ([1, 2], [linear.clone(), quadratic.clone()]),
            ([2, 3], [quadratic, cubic]),
            ([1, 1], [linear.clone(), linear]),
        ] {
            let surface = surface(degrees, knots);
            let patches = BezierPatches::new(&surface).unwrap();
            let [nu, nv] = patches.counts;
            assert_eq!(patches.control_points.len(), 16 * nu * nv);
            for i in 0..nu {
                for j in 0..nv {
                    let points = &patches.control_points[16 * (i * nv + j)..][..16];
                    for k in 0..36 {
                        let (s, t) = ((k / 6) as f64 / 5.0, (k % 6) as f64 / 5.0);
                        let at = |axis: usize, piece: usize, t: f64| {
                            let [a, b] = [0, 1].map(|end| patches.breaks[axis][piece + end]);
                            a + (b - a) * t
                        };
                        let p = surface.point(at(0, i, s), at(1, j, t));
                        assert!((bezier(points, s, t) - p).norm() < 1e-12 * (1.0 + p.coords.norm()));
                    }
                }
            }
        }
    }

    #[test]
    fn what_no_bicubic_equals_is_an_error() {
        let net = vec![Point3::origin(); 36];
        let quintic = NurbsSurface::uniform(5, [6, 6], net.clone()).unwrap();
        assert!(matches!(BezierPatches::new(&quintic), Err(Error::Nurbs { .. })));
        let knots = [KnotVector::uniform(3, 6), KnotVector::uniform(3, 6)];
        let rational = NurbsSurface::new(knots, net, Some(vec![1.0; 36])).unwrap();
        assert!(BezierPatches::new(&rational).unwrap_err().to_string().contains("rational"));
    }
}
