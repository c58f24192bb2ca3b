//! Surfaces with known conjugate nets, and random ones, for the tests of this folder.

use crate::surface::{KnotVector, NurbsSurface};
use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The graph z = f(x, y) over [-1, 1]^2, by control points at its Greville abscissae.
pub fn graph(f: impl Fn(f64, f64) -> f64) -> NurbsSurface {
    let n = 12;
    let knots = KnotVector::uniform(3, n);
    let greville: Vec<f64> =
        (0..n).map(|i| 2.0 * knots.knots()[i + 1..i + 4].iter().sum::<f64>() / 3.0 - 1.0).collect();
    let points =
        greville.iter().flat_map(|&x| greville.iter().map(move |&y| (x, y))).map(|(x, y)| Point3::new(x, y, f(x, y)));
    NurbsSurface::uniform(3, [n, n], points.collect()).unwrap()
}

/// a(u) + b(v): its parameter directions are conjugate; curved in both directions, elliptic and hyperbolic parts.
pub fn translational() -> NurbsSurface {
    let n = 10;
    let a = |i: f64| Vector3::new(i, 0.3 * (0.8 * i).sin(), 0.16 * i * (9.0 - i));
    let b = |j: f64| Vector3::new(0.2 * j, 0.9 * j, -0.06 * j * (9.0 - j) + 0.2 * j);
    let points = (0..n * n).map(|k| Point3::from(a((k / n) as f64) + b((k % n) as f64))).collect();
    NurbsSurface::uniform(3, [n, n], points).unwrap()
}

/// A quarter turn of a waisted profile about z, exact: u around, v along the profile.
pub fn rotational() -> NurbsSurface {
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let n = 8;
    let mut points = vec![];
    let mut weights = vec![];
    for (x, y, w) in [(1.0, 0.0, 1.0), (1.0, 1.0, h), (0.0, 1.0, 1.0)] {
        for j in 0..n {
            let t = j as f64 / (n - 1) as f64;
            let radius = 2.0 - 1.4 * t * (1.2 - t);
            points.push(Point3::new(radius * x, radius * y, 3.0 * t));
            weights.push(w);
        }
    }
    NurbsSurface::new([KnotVector::uniform(2, 3), KnotVector::uniform(3, n)], points, Some(weights)).unwrap()
}

/// A patch of an ellipsoid with three axes, exact, between two latitudes.
pub fn ellipsoid(axes: [f64; 3]) -> NurbsSurface {
    let (low, high) = (0.1f64, 1.2f64);
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let (w, h) = (half.cos(), std::f64::consts::FRAC_1_SQRT_2);
    let profile = [(low.cos(), low.sin(), 1.0), (middle.cos() / w, middle.sin() / w, w), (high.cos(), high.sin(), 1.0)];
    let mut points = vec![];
    let mut weights = vec![];
    for (x, y, weight) in [(1.0, 0.0, 1.0), (1.0, 1.0, h), (0.0, 1.0, 1.0)] {
        for (radius, z, other) in profile {
            points.push(Point3::new(radius * x * axes[0], radius * y * axes[1], z * axes[2]));
            weights.push(weight * other);
        }
    }
    NurbsSurface::new([KnotVector::uniform(2, 3), KnotVector::uniform(2, 3)], points, Some(weights)).unwrap()
}

/// A smooth random height field over a slightly bent square, with elliptic, hyperbolic and almost flat parts.
pub fn wavy(seed: u64) -> NurbsSurface {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let waves: Vec<[f64; 4]> = (0..4)
        .map(|k| {
            let mut next = |low: f64, high: f64| random.random_range(low..high);
            let frequency = 0.5 + 0.35 * f64::from(k);
            let angle: f64 = next(0.0, std::f64::consts::TAU);
            [
                frequency * angle.cos(),
                frequency * angle.sin(),
                next(0.0, std::f64::consts::TAU),
                next(0.2, 1.0) / frequency,
            ]
        })
        .collect();
    let height = move |x: f64, y: f64| -> f64 {
        waves.iter().map(|[a, b, phase, size]| 0.25 * size * (2.0 * (a * x + b * y) + phase).sin()).sum()
    };
    graph(height).mapped(|p| Point3::new(p.x + 0.1 * p.y * p.y, p.y * (1.0 + 0.15 * p.x), p.z))
}
