//! The bilinearly blended Coons patch over four border curves.

use super::border::BorderCurves;
use nalgebra::Point3;

/// Control net of the Coons patch of `curves`: the exact B-spline form of
/// (1 - u) S(0, v) + u S(1, v) + (1 - v) S(u, 0) + v S(u, 1) minus the bilinear patch of the corners, (u, v) in [0, 1]^2.
///
/// Exact because Greville abscissae are the B-spline coefficients of the parameter itself.
///
/// Sides of the loop, which runs counter-clockwise seen from the front:
/// side 0 is v = 0 with u growing, side 1 is u = 1 with v growing, side 2 is v = 1 with u falling, side 3 is u = 0 with v
/// falling. So S_u x S_v points to the front, and for a patch whose front faces the viewer, with the first corner at the
/// upper left, u grows downwards and v to the right, like the rows and columns of an image.
///
/// - returns count_u * count_v points, v running fastest, in the frame of the curves.
pub fn coons_net(curves: &BorderCurves) -> Vec<Point3<f64>> {
    let [nu, nv] = [0, 1].map(|k| curves.knots[k].count());
    let [s, t] = [0, 1].map(|k| curves.knots[k].greville());
    let bottom = |i: usize| curves.sides[0][i].coords;
    let right = |j: usize| curves.sides[1][j].coords;
    let top = |i: usize| curves.sides[2][nu - 1 - i].coords;
    let left = |j: usize| curves.sides[3][nv - 1 - j].coords;
    let mut net = Vec::with_capacity(nu * nv);
    for (i, &s) in s.iter().enumerate() {
        for (j, &t) in t.iter().enumerate() {
            let between_u = left(j) * (1.0 - s) + right(j) * s;
            let between_v = bottom(i) * (1.0 - t) + top(i) * t;
            let corners =
                (bottom(0) * (1.0 - t) + top(0) * t) * (1.0 - s) + (bottom(nu - 1) * (1.0 - t) + top(nu - 1) * t) * s;
            net.push(Point3::from(between_u + between_v - corners));
        }
    }
    net
}
