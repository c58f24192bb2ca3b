//! A wavy roof over [-4, 4]^2, the surface of the mesh stage's bench and scaling example.

use sketch2pq::surface::NurbsSurface;

/// The roof, cubic, 14 x 14 control points.
pub fn waves() -> NurbsSurface {
    let n = 14;
    let at = |k: usize| 8.0 * k as f64 / (n - 1) as f64 - 4.0;
    let height = |x: f64, y: f64| 0.6 * (0.7 * x + 0.3 * y).sin() + 0.5 * (0.6 * y - 0.2 * x).cos() + 0.03 * x * y;
    let points = (0..n * n).map(|k| (at(k / n), at(k % n))).map(|(x, y)| [x, y, height(x, y)].into()).collect();
    NurbsSurface::uniform(3, [n, n], points).expect("the counts agree")
}
