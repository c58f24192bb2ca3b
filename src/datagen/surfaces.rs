//! Random roof-like surfaces: the paper's free forms and quadrics, and the types that architects draw.
//!
//! World frame, z up, x and y within [-4, 4]^2, |z| <= 5. Every surface is a 30 x 30 cubic net with uniform clamped knots.

use super::NET;
use crate::numeric::{Cholesky, LeastSquares};
use crate::surface::{FundamentalForms, KnotVector, NurbsSurface};
use nalgebra::{DMatrix, Point3, Rotation3, SymmetricEigen, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::OnceLock;

/// Largest |K| of a surface whose plan fills [-4, 4]^2 (paper, Sec. 5).
const MAX_GAUSSIAN_CURVATURE: f64 = 5.0;

/// Kinds of surface that the generator makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Family {
    /// The paper's recipe: smooth random plan, random low fairness modes in height.
    Freeform,
    /// Patch of an ellipsoid.
    Ellipsoid,
    /// Patch of a rounded box.
    Cuboid,
    /// One profile swept along another.
    Translational,
    /// A profile turned about an axis, upright or lying.
    Rotational,
    /// Hyperbolic paraboloid and its kin.
    Saddle,
    /// Barrel vault with varying section, or gull wing.
    Vault,
    /// Shell on four supports, with arched or flat edges.
    Shell,
}

impl Family {
    /// All families, in the order of the shares in the options.
    pub const ALL: [Self; 8] = [
        Self::Freeform,
        Self::Ellipsoid,
        Self::Cuboid,
        Self::Translational,
        Self::Rotational,
        Self::Saddle,
        Self::Vault,
        Self::Shell,
    ];

    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Freeform => "freeform",
            Self::Ellipsoid => "ellipsoid",
            Self::Cuboid => "cuboid",
            Self::Translational => "translational",
            Self::Rotational => "rotational",
            Self::Saddle => "saddle",
            Self::Vault => "vault",
            Self::Shell => "shell",
        }
    }

    /// Whether the parameter lines of the undeformed surface are a conjugate net.
    pub(super) fn has_conjugate_parameters(self) -> bool {
        matches!(self, Self::Translational | Self::Rotational)
    }
}

/// A random surface of `family`, or `None` where the dice gave one that folds in plan or curves too sharply.
pub(super) fn random_surface(family: Family, rng: &mut ChaCha8Rng) -> Option<NurbsSurface> {
    let mut net = match family {
        Family::Freeform => freeform(rng)?,
        Family::Ellipsoid => superquadric(rng, false),
        Family::Cuboid => superquadric(rng, true),
        Family::Translational => translational(rng),
        Family::Rotational => rotational(rng),
        Family::Saddle => saddle(rng)?,
        Family::Vault => vault(rng),
        Family::Shell => shell(rng)?,
    };
    fit_into_box(&mut net)?;
    // The paper's lattice has cells of 0.8 and so makes ripples; mostly a coarser one bends the whole shape instead.
    let (bent, rippled) = if family == Family::Freeform { (0.5, 0.12) } else { (0.25, 0.0) };
    if rng.random_bool(bent) {
        let reach = rng.random_range(0.1..0.5);
        free_form_deformation::<6>(&mut net, reach, rng);
    }
    if rng.random_bool(rippled) {
        let reach = rng.random_range(0.05..0.2);
        free_form_deformation::<16>(&mut net, reach, rng);
    }
    let surface = NurbsSurface::uniform(3, [NET, NET], net).ok()?;
    let n = 18;
    for i in 0..=n {
        for j in 0..=n {
            let forms = FundamentalForms::new(&surface.evaluate(i as f64 / n as f64, j as f64 / n as f64))?;
            if forms.gaussian_curvature().abs() > MAX_GAUSSIAN_CURVATURE {
                return None;
            }
        }
    }
    Some(surface)
}

/// Centres the plan, scales the whole so that the plan's longer side is 8, puts z about 0; `None` if z leaves [-5, 5].
fn fit_into_box(net: &mut [Point3<f64>]) -> Option<()> {
    let (mut low, mut high) = (net[0], net[0]);
    for p in net.iter() {
        low = low.inf(p);
        high = high.sup(p);
    }
    let size = high - low;
    let scale = 8.0 / size.x.max(size.y);
    if !scale.is_finite() || size.z * scale > 10.0 {
        return None;
    }
    let center = nalgebra::center(&low, &high);
    net.iter_mut().for_each(|p| *p = Point3::from((*p - center) * scale));
    Some(())
}

// --- from functions to nets

/// The net that interpolates `f` at the Greville abscissae of the uniform cubic knots.
fn interpolate(f: impl Fn(f64, f64) -> Point3<f64>) -> Vec<Point3<f64>> {
    let greville = greville(NET);
    let samples: Vec<Point3<f64>> =
        greville.iter().flat_map(|&u| greville.iter().map(move |&v| (u, v))).map(|(u, v)| f(u, v)).collect();
    interpolate_samples(&samples)
}

/// The net that goes through 30 x 30 points at the Greville abscissae, v running fastest.
pub(super) fn interpolate_samples(samples: &[Point3<f64>]) -> Vec<Point3<f64>> {
    static INVERSE: OnceLock<DMatrix<f64>> = OnceLock::new();
    let inverse = INVERSE.get_or_init(|| {
        let greville = greville(NET);
        let knots = KnotVector::uniform(3, NET);
        let mut matrix = DMatrix::zeros(NET, NET);
        for (row, &g) in greville.iter().enumerate() {
            let basis = knots.basis(g);
            for k in 0..4 {
                matrix[(row, basis.first + k)] += basis.values[0][k];
            }
        }
        matrix.try_inverse().expect("Greville interpolation is unique")
    });
    let mut net = vec![Point3::origin(); NET * NET];
    for axis in 0..3 {
        let values = DMatrix::from_fn(NET, NET, |i, j| samples[i * NET + j][axis]);
        let control = inverse * values * inverse.transpose();
        for i in 0..NET {
            for j in 0..NET {
                net[i * NET + j][axis] = control[(i, j)];
            }
        }
    }
    net
}

/// Greville abscissae of `count` uniform cubic control points over [0, 1].
pub(super) fn greville(count: usize) -> Vec<f64> {
    let knots = KnotVector::uniform(3, count);
    let k = knots.knots();
    (0..count).map(|i| (k[i + 1] + k[i + 2] + k[i + 3]) / 3.0).collect()
}

/// Smooth random function on [0, 1]: the first `modes` cosines, amplitude about `amplitude`, falling with frequency.
fn wave(rng: &mut ChaCha8Rng, modes: usize, amplitude: f64) -> impl Fn(f64) -> f64 + use<> {
    let terms: Vec<(f64, f64, f64)> = (1..=modes)
        .map(|k| {
            let k = k as f64;
            (rng.random_range(-1.0..1.0) * amplitude / k.powf(1.5), k * PI, rng.random_range(0.0..TAU))
        })
        .collect();
    move |s| terms.iter().map(|(a, w, p)| a * (w * s + p).cos()).sum()
}

/// Smooth random function on the unit square: low products of cosines.
fn wave2(rng: &mut ChaCha8Rng, modes: usize, amplitude: f64) -> impl Fn(f64, f64) -> f64 + use<> {
    let mut terms = vec![];
    for i in 0..=modes {
        for j in 0..=modes - i {
            if i + j > 0 {
                let a = rng.random_range(-1.0..1.0) * amplitude / ((i + j) as f64).powf(1.7);
                terms.push((a, i as f64 * PI, rng.random_range(0.0..TAU), j as f64 * PI, rng.random_range(0.0..TAU)));
            }
        }
    }
    move |s, t| terms.iter().map(|(a, w, p, x, q)| a * (w * s + p).cos() * (x * t + q).cos()).sum()
}

// --- plans

/// Border of a random plan: 30 points a side, sides in the order (u, 0), (1, v), (1 - u, 1), (0, 1 - v).
///
/// Polar as in the paper, but with radii of a few low Fourier modes between a polygon and an oval: independent radii fold
/// the net in nearly every draw.
fn plan_border(rng: &mut ChaCha8Rng, roughness: f64) -> [Vec<Vector2<f64>>; 4] {
    let corners: Vec<f64> = (0..4).map(|k| k as f64 * FRAC_PI_2 + rng.random_range(-0.4..0.4)).collect();
    let corner = |k: usize| corners[k % 4] + if k >= 4 { TAU } else { 0.0 };
    let polygon = rng.random_range(0.0..1.0);
    let squeeze = rng.random_range(0.5..1.0);
    let turn = rng.random_range(0.0..TAU);
    let modes: Vec<(f64, f64, f64)> = (1..=5)
        .map(|k| {
            let k = k as f64;
            (roughness * rng.random_range(-0.3..0.3) / k.powf(0.85), k, rng.random_range(0.0..TAU))
        })
        .collect();
    let radius = |angle: f64| 1.0 + modes.iter().map(|(a, k, p)| a * (k * angle + p).cos()).sum::<f64>();
    let axis = turn + rng.random_range(0.0..PI);
    [0, 1, 2, 3].map(|side| {
        let (a, b) = (corner(side), corner(side + 1));
        let ends = [a, b].map(|t| Vector2::new(t.cos(), t.sin()));
        (0..NET)
            .map(|i| {
                let t = i as f64 / (NET - 1) as f64;
                let angle = a + (b - a) * t;
                let oval = Vector2::new(angle.cos(), angle.sin());
                let chord = ends[0] * (1.0 - t) + ends[1] * t;
                let p = (oval * (1.0 - polygon) + chord * polygon) * radius(angle);
                // Squeeze along a random axis: roofs are seldom as wide as long.
                let n = Vector2::new(axis.cos(), axis.sin());
                let p = p - n * (1.0 - squeeze) * n.dot(&p);
                Vector2::new(turn.cos() * p.x - turn.sin() * p.y, turn.sin() * p.x + turn.cos() * p.y)
            })
            .collect()
    })
}

/// Fills the plan: interior control points that minimize the sum of squared second differences along u and v.
fn fill_plan(border: &[Vec<Vector2<f64>>; 4]) -> Vec<Vector2<f64>> {
    const INNER: usize = NET - 2;
    static SOLVER: OnceLock<Cholesky> = OnceLock::new();
    let mut plan = vec![Vector2::zeros(); NET * NET];
    for i in 0..NET {
        plan[i * NET] = border[0][i];
        plan[(NET - 1) * NET + i] = border[1][i];
        plan[(NET - 1 - i) * NET + NET - 1] = border[2][i];
        plan[NET - 1 - i] = border[3][i];
    }
    let unknown = |i: usize, j: usize| {
        let inside = (1..=INNER).contains(&i) && (1..=INNER).contains(&j);
        inside.then(|| (i - 1) * INNER + j - 1)
    };
    // Every second difference along a grid line, three points each.
    let differences = || {
        (0..NET).flat_map(|i| {
            (1..NET - 1).flat_map(move |j| [[(i, j - 1), (i, j), (i, j + 1)], [(j - 1, i), (j, i), (j + 1, i)]])
        })
    };
    let weights = [1.0, -2.0, 1.0];
    let solver = SOLVER.get_or_init(|| {
        let mut rows = LeastSquares::new(INNER * INNER);
        for triple in differences() {
            let row: Vec<(usize, f64)> =
                triple.iter().zip(weights).filter_map(|(&(i, j), w)| Some((unknown(i, j)?, w))).collect();
            if !row.is_empty() {
                rows.push(&row, 0.0);
            }
        }
        Cholesky::new(&rows.normal_equations().0, "plan").expect("a fixed border makes the fairness energy definite")
    });
    let mut columns = vec![0.0; 2 * INNER * INNER];
    for triple in differences() {
        let known: Vector2<f64> = triple
            .iter()
            .zip(weights)
            .filter(|((i, j), _)| unknown(*i, *j).is_none())
            .map(|(&(i, j), w)| plan[i * NET + j] * w)
            .sum();
        for (&(i, j), w) in triple.iter().zip(weights) {
            if let Some(k) = unknown(i, j) {
                columns[k] -= w * known.x;
                columns[INNER * INNER + k] -= w * known.y;
            }
        }
    }
    solver.solve(&mut columns);
    for i in 1..=INNER {
        for j in 1..=INNER {
            let k = (i - 1) * INNER + j - 1;
            plan[i * NET + j] = Vector2::new(columns[k], columns[INNER * INNER + k]);
        }
    }
    plan
}

/// A random plan without folds.
fn plan(rng: &mut ChaCha8Rng, roughness: f64) -> Option<Vec<Vector2<f64>>> {
    let border = plan_border(rng, roughness);
    let plan = fill_plan(&border);
    let area = |a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>| (b - a).perp(&(c - a));
    let mean = (plan[NET * NET - 1] - plan[0]).perp(&(plan[NET - 1] - plan[(NET - 1) * NET])) / (2 * NET * NET) as f64;
    for i in 0..NET - 1 {
        for j in 0..NET - 1 {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| plan[i * NET + j]);
            if area(a, b, c).min(area(a, c, d)) < 0.04 * mean.abs() {
                return None;
            }
        }
    }
    Some(plan)
}

// --- heights

/// The eigenvectors of the fairness energy's 1D part, sum of squared second differences, with their eigenvalues.
///
/// The 2D energy is the Kronecker sum K x I + I x K, so that its eigenvectors are products of these and its eigenvalues
/// sums. With all rows kept its null space is bilinear: no spikes at the corners (paper, Sec. 5, read strictly, has four).
fn modes() -> &'static (Vec<f64>, DMatrix<f64>) {
    static MODES: OnceLock<(Vec<f64>, DMatrix<f64>)> = OnceLock::new();
    MODES.get_or_init(|| {
        let mut second = DMatrix::<f64>::zeros(NET - 2, NET);
        for i in 0..NET - 2 {
            second[(i, i)] = 1.0;
            second[(i, i + 1)] = -2.0;
            second[(i, i + 2)] = 1.0;
        }
        let eigen = SymmetricEigen::new(second.transpose() * &second);
        let mut order: Vec<usize> = (0..NET).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let values: Vec<f64> = order.iter().map(|&k| eigen.eigenvalues[k].max(0.0)).collect();
        let mut vectors = DMatrix::from_fn(NET, NET, |i, k| eigen.eigenvectors[(i, order[k])]);
        // The null space as constant and linear, every other mode positive at its end.
        for i in 0..NET {
            vectors[(i, 0)] = 1.0;
            vectors[(i, 1)] = 2.0 * i as f64 / (NET - 1) as f64 - 1.0;
        }
        for k in 2..NET {
            let scale = vectors[(NET - 1, k)];
            vectors.column_mut(k).scale_mut(1.0 / scale);
        }
        (values, vectors)
    })
}

/// Heights over the net: the 30 lowest fairness modes with random coefficients, damped by frequency^-`damping`.
fn mode_heights(rng: &mut ChaCha8Rng, damping: f64) -> Vec<f64> {
    let (values, vectors) = modes();
    let mut pairs: Vec<(usize, usize)> = (0..9).flat_map(|i| (0..9).map(move |j| (i, j))).collect();
    pairs.sort_by(|a, b| (values[a.0] + values[a.1]).total_cmp(&(values[b.0] + values[b.1])).then(a.cmp(b)));
    let unit = values[2].powf(0.25);
    let mut heights = vec![0.0; NET * NET];
    for &(i, j) in pairs.iter().take(30) {
        if i + j == 0 {
            continue;
        }
        let frequency = (values[i] + values[j]).powf(0.25) / unit;
        let mut c = rng.random_range(-1.0..1.0)
            * match (i, j) {
                (0, 1) | (1, 0) => 0.5,
                (1, 1) => 0.7,
                _ => frequency.powf(-damping),
            };
        // Roofs bulge upwards more often than they sag.
        if (i, j) == (2, 0) || (i, j) == (0, 2) {
            c = if rng.random_bool(0.75) { -c.abs() } else { c.abs() };
        }
        for a in 0..NET {
            for b in 0..NET {
                heights[a * NET + b] += c * vectors[(a, i)] * vectors[(b, j)];
            }
        }
    }
    heights
}

fn freeform(rng: &mut ChaCha8Rng) -> Option<Vec<Point3<f64>>> {
    let roughness = rng.random_range(0.2..1.0);
    let plan = plan(rng, roughness)?;
    let damping = rng.random_range(1.6..3.4);
    let heights = mode_heights(rng, damping);
    let (low, high) = heights.iter().fold((f64::MAX, f64::MIN), |(l, h), &z| (l.min(z), h.max(z)));
    // The plan spans about 2 here, 8 after scaling.
    let range = rng.random_range(0.3f64..1.9);
    let scale = range / (high - low).max(1e-9);
    Some(plan.iter().zip(&heights).map(|(p, z)| Point3::new(p.x, p.y, z * scale)).collect())
}

// --- quadrics

/// Patch about the top of a superellipsoid |x/a|^p + |y/b|^p + |z/c|^p = 1, cut by planes through its centre (p = 2: an
/// ellipsoid; p = 3 to 7: a rounded box).
fn superquadric(rng: &mut ChaCha8Rng, boxy: bool) -> Vec<Point3<f64>> {
    let exponent = if boxy { rng.random_range(2.8f64..6.0) } else { 2.0 };
    let axes = Vector3::new(1.0, rng.random_range(0.6..1.0), rng.random_range(0.35..1.15));
    // Half opening angles of the cutting planes: near 90 degrees the patch reaches down the sides.
    let opening: Vec<f64> = (0..4).map(|_| rng.random_range(35f64..80.0).to_radians()).collect();
    let opening = if rng.random_bool(0.5) {
        [opening[0], opening[0], opening[1], opening[1]]
    } else {
        [opening[0], opening[1], opening[2], opening[3]]
    };
    let tilt_range = if boxy { 0.25 } else { 0.5 };
    let tilt = Rotation3::from_euler_angles(
        rng.random_range(-tilt_range..tilt_range),
        rng.random_range(-tilt_range..tilt_range),
        0.0,
    );
    let skew = rng.random_range(-0.15..0.15);
    // The pattern of planes turns against the axes.
    let turn = Rotation3::from_axis_angle(
        &Vector3::z_axis(),
        if boxy { rng.random_range(-0.15..0.15) } else { rng.random_range(0.0..PI) },
    );
    let bend = [wave(rng, 2, 0.1), wave(rng, 2, 0.1)];
    interpolate(|u, v| {
        let (s, t) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        // Blend the two halves so that the net has no kink where their openings differ.
        let smooth = |s: f64, low: f64, high: f64| s * 0.5 * (low + high) + 0.5 * (high - low) * s * s;
        let a = smooth(s, opening[0], opening[1]) + bend[0](v) * s * s;
        let b = smooth(t, opening[2], opening[3]) + bend[1](u) * t * t + skew * s;
        let limit = 84f64.to_radians();
        let direction =
            turn * Vector3::new(a.clamp(-limit, limit).tan(), b.clamp(-limit, limit).tan(), 1.0).normalize();
        let q = direction.component_div(&axes).map(f64::abs);
        let norm = (q.x.powf(exponent) + q.y.powf(exponent) + q.z.powf(exponent)).powf(1.0 / exponent);
        tilt * Point3::from(direction / norm)
    })
}

// --- architecture

/// A profile over [0, 1]: height 0 to about 1.
fn profile(rng: &mut ChaCha8Rng) -> impl Fn(f64) -> f64 + use<> {
    let kind = rng.random_range(0..5);
    let power = rng.random_range(0.7f64..1.3);
    let phase = rng.random_range(0.0..TAU);
    let shift = rng.random_range(-0.2..0.2);
    let extra = wave(rng, 3, 0.15);
    move |s| {
        let x = 2.0 * s - 1.0;
        let base = match kind {
            // Arch, sag, wave, S, half arch.
            0 => 1.0 - (x - shift).powi(2),
            1 => ((1.0 - (x - shift).powi(2)).max(-0.6) + 0.6).powf(power),
            2 => 0.5 * (TAU * s + phase).cos(),
            3 => 0.5 * (PI * 0.9 * x + shift).sin(),
            _ => 0.5 * (1.5 * PI * s + phase).cos(),
        };
        base + extra(s)
    }
}

fn translational(rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let (f, g) = (profile(rng), profile(rng));
    let (hf, hg) = (rng.random_range(0.0..0.8) * sign(rng, 0.8), rng.random_range(0.0..0.5) * sign(rng, 0.6));
    let width = rng.random_range(0.45..1.0);
    let (bend_p, bend_q) = (wave(rng, 2, 0.12), wave(rng, 2, 0.12));
    let shear = rng.random_range(-0.3..0.3);
    interpolate(|u, v| {
        let p = Vector3::new(2.0 * u - 1.0, bend_p(u), hf * f(u));
        let q = Vector3::new(bend_q(v) + shear * v, width * (2.0 * v - 1.0), hg * g(v));
        Point3::from(p + q)
    })
}

/// 1 with probability `up`, else -1.
fn sign(rng: &mut ChaCha8Rng, up: f64) -> f64 {
    if rng.random_bool(up) { 1.0 } else { -1.0 }
}

fn rotational(rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let extra = wave(rng, 2, 0.12);
    if rng.random_bool(0.5) {
        // Upright axis: canopies, bowls, pieces of domes and of rings.
        let inner = rng.random_range(0.05..0.7);
        let span = rng.random_range(50f64..200.0).to_radians();
        let height = rng.random_range(0.1..0.9) * sign(rng, 0.7);
        let f = profile(rng);
        let lean = rng.random_range(-0.6..0.6);
        interpolate(|u, v| {
            let angle = (u - 0.5) * span;
            let r = inner + (1.0 - inner) * v;
            Point3::new(r * angle.cos(), r * angle.sin(), height * f(v) + lean * v + 0.5 * extra(v))
        })
    } else {
        // Lying axis: barrels and tubes of varying radius.
        let half = rng.random_range(40f64..100.0).to_radians();
        let length = rng.random_range(0.8..2.6);
        let radius = wave(rng, 3, 0.35);
        interpolate(|u, v| {
            let angle = (2.0 * u - 1.0) * half;
            let r = (1.0 + radius(v)).max(0.25);
            Point3::new(r * angle.sin(), length * (v - 0.5) * 2.0, r * angle.cos())
        })
    }
}

fn saddle(rng: &mut ChaCha8Rng) -> Option<Vec<Point3<f64>>> {
    let plan = plan(rng, 0.35)?;
    let turn = if rng.random_bool(0.5) { 0.0 } else { rng.random_range(0.0..PI) };
    let (a, b) = (rng.random_range(0.15..0.8), rng.random_range(0.15..0.8));
    let by_parameter = rng.random_bool(0.5);
    let tilt = [rng.random_range(-0.25..0.25), rng.random_range(-0.25..0.25)];
    let extra = wave2(rng, 3, 0.1);
    let heights = |k: usize, p: &Vector2<f64>| {
        let (s, t) = ((k / NET) as f64 / (NET - 1) as f64, (k % NET) as f64 / (NET - 1) as f64);
        let (x, y) = if by_parameter { (2.0 * s - 1.0, 2.0 * t - 1.0) } else { (p.x, p.y) };
        let (x, y) = (turn.cos() * x + turn.sin() * y, turn.cos() * y - turn.sin() * x);
        a * x * x - b * y * y + tilt[0] * x + tilt[1] * y + extra(s, t)
    };
    Some(plan.iter().enumerate().map(|(k, p)| Point3::new(p.x, p.y, heights(k, p))).collect())
}

fn vault(rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let half = rng.random_range(45f64..105.0).to_radians();
    let length = rng.random_range(0.7..2.4);
    let height = rng.random_range(0.5..1.5);
    let (rise, width, spine, ridge) = (wave(rng, 3, 0.3), wave(rng, 3, 0.25), wave(rng, 2, 0.35), wave(rng, 3, 0.15));
    let end = [wave(rng, 3, 0.3), wave(rng, 3, 0.3)];
    let gull = rng.random_bool(0.3);
    let dip = rng.random_range(0.2..0.7);
    let lean = rng.random_range(-0.25..0.25);
    interpolate(|u, v| {
        let x = 2.0 * u - 1.0;
        let y = length * ((1.0 - v) * (-1.0 + end[0](u)) + v * (1.0 + end[1](u)));
        let (across, up) = if gull {
            (x, 0.5 * (1.0 - (2.0 * TAU * u).cos()) * dip + 0.4 * (1.0 - x * x))
        } else {
            ((x * half).sin() / half.sin().max(0.7), ((x * half).cos() - half.cos()) / (1.0 - half.cos()))
        };
        let w = 1.0 + width(v);
        let h = height * (1.0 + rise(v)).max(0.2);
        Point3::new(spine(v) + across * w + lean * h * up, y, h * up + ridge(v))
    })
}

fn shell(rng: &mut ChaCha8Rng) -> Option<Vec<Point3<f64>>> {
    let plan = plan(rng, 0.3)?;
    let power = rng.random_range(0.8f64..1.4);
    let arch = move |s: f64| (PI * s).sin().max(0.0).powf(power).min(1.0);
    let smooth_arch = move |s: f64| if power < 1.0 { 4.0 * s * (1.0 - s) } else { arch(s) };
    let (a, b, c) = (rng.random_range(0.0..0.6), rng.random_range(0.0..0.6), rng.random_range(-0.1..1.0));
    let tilt = [rng.random_range(-0.2..0.2), rng.random_range(-0.2..0.2)];
    let extra = wave2(rng, 3, 0.12);
    let height = |k: usize| {
        let (s, t) = ((k / NET) as f64 / (NET - 1) as f64, (k % NET) as f64 / (NET - 1) as f64);
        let (x, y) = (smooth_arch(s), smooth_arch(t));
        a * x + b * y + c * x * y + tilt[0] * s + tilt[1] * t + extra(s, t)
    };
    Some(plan.iter().enumerate().map(|(k, p)| Point3::new(p.x, p.y, height(k))).collect())
}

/// Moves the control points by a tricubic B-spline lattice over [-5, 5]^3, whose x and y are displaced by up to `reach`
/// (paper, Sec. 5: 16^3 points and 0.2).
fn free_form_deformation<const LATTICE: usize>(net: &mut [Point3<f64>], reach: f64, rng: &mut ChaCha8Rng) {
    let shift: Vec<[f64; 2]> =
        (0..LATTICE.pow(3)).map(|_| [rng.random_range(-reach..reach), rng.random_range(-reach..reach)]).collect();
    let knots = KnotVector::uniform(3, LATTICE);
    for p in net.iter_mut() {
        let basis = [p.x, p.y, p.z].map(|x| knots.basis((x + 5.0) / 10.0));
        let mut sum = [0.0; 2];
        for i in 0..4 {
            for j in 0..4 {
                let weight = basis[0].values[0][i] * basis[1].values[0][j];
                for k in 0..4 {
                    let w = weight * basis[2].values[0][k];
                    let index = ((basis[0].first + i) * LATTICE + basis[1].first + j) * LATTICE + basis[2].first + k;
                    sum[0] += w * shift[index][0];
                    sum[1] += w * shift[index][1];
                }
            }
        }
        p.x += sum[0];
        p.y += sum[1];
    }
}
