//! Closest points on a surface and on its border.

use super::curvature::FundamentalForms;
use super::knots::KnotVector;
use super::nurbs::{NurbsSurface, SurfacePoint};
use nalgebra::{Point3, Vector3};
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// Seeds in each direction, at least; every knot span gets at least two.
const SEED_CELLS: usize = 48;
/// Newton steps, at most; it converges quadratically from a seed, so this is only reached on kinks.
const NEWTON_STEPS: usize = 30;
/// A step of less than this share of a seed cell ends Newton's method.
const CONVERGED: f64 = 1e-13;
/// Seeds that are looked at for one query, at most: the closest ones within reach, in the order of their distance.
const SEEDS_TRIED: usize = 64;

/// Turn of the border, radians, below which a search along it goes on past a corner of the domain.
const ROUND_CORNER: f64 = 0.25 * std::f64::consts::PI;

/// A point of a surface found as the closest one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceFoot {
    /// Parameters (u, v).
    pub parameters: [f64; 2],
    /// S(u, v), in the surface's frame.
    pub position: Point3<f64>,
    /// Unit normal S_u x S_v there; at a pole the one just inside; zero where the surface has none.
    pub normal: Vector3<f64>,
    /// Distance from the query point.
    pub distance: f64,
}

/// Finds closest points on one surface: seeds on a grid over all knot spans, then Newton within the parameter rectangle.
///
/// Exact up to rounding unless the surface bends through a large angle within one seed cell (1/48 of the domain, or half a
/// knot span if that is shorter).
#[derive(Clone, Debug)]
pub struct SurfaceProjector {
    surface: NurbsSurface,
    parameters: [Vec<f64>; 2],
    seeds: Vec<Point3<f64>>,
    tree: RTree<GeomWithData<[f64; 3], u32>>,
    /// Longest diagonal of a seed cell: no surface point is farther than that from a seed.
    reach: f64,
    /// Seeds on the border: side (u = 0, u = 1, v = 0, v = 1), parameter along it, point.
    border: Vec<(usize, f64, Point3<f64>)>,
}

impl SurfaceProjector {
    /// Samples `surface` for queries.
    pub fn new(surface: &NurbsSurface) -> Self {
        let parameters = [0, 1].map(|k| seed_parameters(&surface.knots()[k]));
        let [us, vs] = &parameters;
        let mut seeds = Vec::with_capacity(us.len() * vs.len());
        for &u in us {
            seeds.extend(vs.iter().map(|&v| surface.point(u, v)));
        }
        let nv = vs.len();
        let mut reach = 0f64;
        for i in 1..us.len() {
            for j in 1..nv {
                let corner = |a: usize, b: usize| seeds[(i - a) * nv + j - b];
                reach = reach.max((corner(0, 0) - corner(1, 1)).norm()).max((corner(1, 0) - corner(0, 1)).norm());
            }
        }
        let tree = seeds.iter().enumerate().map(|(k, p)| GeomWithData::new([p.x, p.y, p.z], k as u32)).collect();
        let tree = RTree::bulk_load(tree);
        let mut border = vec![];
        for side in 0..4 {
            let along = &parameters[1 - side / 2];
            border.extend(along.iter().map(|&t| {
                let [u, v] = on_side(surface, side, t);
                (side, t, surface.point(u, v))
            }));
        }
        Self { surface: surface.clone(), parameters, seeds, tree, reach, border }
    }

    /// The surface that is searched.
    pub fn surface(&self) -> &NurbsSurface {
        &self.surface
    }

    /// The closest surface point to `query`, same frame; the first found among equally close ones.
    pub fn closest(&self, query: &Point3<f64>) -> SurfaceFoot {
        let nv = self.parameters[1].len();
        let (nu, target) = (self.parameters[0].len(), [query.x, query.y, query.z]);
        let mut best: Option<([f64; 2], SurfacePoint, f64)> = None;
        for (seed, squared) in self.tree.nearest_neighbor_iter_with_distance_2(target).take(SEEDS_TRIED) {
            if best.as_ref().is_some_and(|(_, _, distance)| squared.sqrt() > distance + self.reach) {
                break;
            }
            // Only seeds that are closest among their neighbours in the grid start a basin of their own.
            let (i, j) = (seed.data as usize / nv, seed.data as usize % nv);
            let around = (i.saturating_sub(1)..=(i + 1).min(nu - 1))
                .flat_map(|a| (j.saturating_sub(1)..=(j + 1).min(nv - 1)).map(move |b| a * nv + b));
            if best.is_some() && around.into_iter().any(|k| (self.seeds[k] - query).norm_squared() < squared) {
                continue;
            }
            let found = self.newton(query, [self.parameters[0][i], self.parameters[1][j]]);
            if best.as_ref().is_none_or(|(_, _, distance)| found.2 < *distance) {
                best = Some(found);
            }
        }
        let (parameters, point, distance) =
            best.unwrap_or_else(|| self.newton(query, self.surface.at_fraction(0.5, 0.5)));
        self.foot(parameters, &point, distance)
    }

    /// The closest point reached from `start`, without a global search: for queries that move a little each time.
    pub fn closest_near(&self, query: &Point3<f64>, start: [f64; 2]) -> SurfaceFoot {
        let (parameters, point, distance) = self.newton(query, start);
        self.foot(parameters, &point, distance)
    }

    /// The closest point on the four border curves u = 0, u = 1, v = 0, v = 1.
    pub fn closest_on_border(&self, query: &Point3<f64>) -> SurfaceFoot {
        let squared: Vec<f64> = self.border.iter().map(|(_, _, p)| (p - query).norm_squared()).collect();
        let nearest = squared.iter().copied().fold(f64::INFINITY, f64::min).sqrt();
        let mut best: Option<(usize, f64, f64)> = None;
        for (k, (side, t, _)) in self.border.iter().enumerate() {
            let same_side = |other: usize| self.border[other].0 == *side;
            let lower_before = k > 0 && same_side(k - 1) && squared[k - 1] < squared[k];
            let lower_after = k + 1 < squared.len() && same_side(k + 1) && squared[k + 1] < squared[k];
            if lower_before || lower_after || squared[k].sqrt() > nearest + self.reach {
                continue;
            }
            let (t, distance) = self.newton_on_side(query, *side, *t);
            if best.is_none_or(|(_, _, shortest)| distance < shortest) {
                best = Some((*side, t, distance));
            }
        }
        let (side, t, distance) = best.unwrap_or((0, self.parameters[1][0], nearest));
        let parameters = on_side(&self.surface, side, t);
        self.foot(parameters, &self.surface.evaluate(parameters[0], parameters[1]), distance)
    }

    /// The closest point reached from `start` along the border, without a global search: for queries that move a little each time, and where
    /// another side is as near. Past a corner it goes on along the next side where the border turns by less than [`ROUND_CORNER`] there. A start
    /// inside the domain has no side: then the global search.
    pub fn closest_on_border_near(&self, query: &Point3<f64>, start: [f64; 2]) -> SurfaceFoot {
        let domains = [0, 1].map(|k| self.surface.knots()[k].domain());
        let sides_at = |at: [f64; 2]| (0..4).filter(move |&side| at[side / 2] == domains[side / 2][side % 2]);
        let along = |side: usize, at: [f64; 2]| {
            let (t, distance) = self.newton_on_side(query, side, at[1 - side / 2]);
            (on_side(&self.surface, side, t), distance)
        };
        let nearer = |a: ([f64; 2], f64), b: ([f64; 2], f64)| if b.1 < a.1 { b } else { a };
        let found = sides_at(start).map(|side| along(side, start)).reduce(nearer);
        let Some(found) = found else { return self.closest_on_border(query) };
        let corner = sides_at(found.0).count() == 2 && self.turn_at_corner(found.0) < ROUND_CORNER;
        let on = if corner { sides_at(found.0).map(|side| along(side, found.0)).reduce(nearer) } else { None };
        let ([u, v], distance) = on.map_or(found, |on| nearer(found, on));
        self.foot([u, v], &self.surface.evaluate(u, v), distance)
    }

    /// Angle by which the border turns at a corner of the domain, radians.
    fn turn_at_corner(&self, corner: [f64; 2]) -> f64 {
        let at = self.surface.evaluate(corner[0], corner[1]);
        let is_low = [0, 1].map(|k| corner[k] <= self.surface.knots()[k].domain()[0]);
        // Into both sides from there: straight on is half a turn between them.
        let inwards = [(at.du, is_low[0]), (at.dv, is_low[1])].map(|(d, low)| if low { d } else { -d });
        std::f64::consts::PI - inwards[0].angle(&inwards[1])
    }

    fn foot(&self, parameters: [f64; 2], point: &SurfacePoint, distance: f64) -> SurfaceFoot {
        let normal = FundamentalForms::new(point)
            .or_else(|| {
                let [u, v] = [0, 1].map(|k| {
                    let [a, b] = self.surface.knots()[k].domain();
                    parameters[k].clamp(a + 1e-4 * (b - a), b - 1e-4 * (b - a))
                });
                FundamentalForms::new(&self.surface.evaluate(u, v))
            })
            .map_or_else(Vector3::zeros, |forms| forms.normal);
        SurfaceFoot { parameters, position: point.position, normal, distance }
    }

    /// Minimizes |S(u, v) - query|^2 / 2 over the parameter rectangle: Newton, Gauss-Newton where the Hessian is not positive
    /// definite, with an active set for the four bounds.
    fn newton(&self, query: &Point3<f64>, start: [f64; 2]) -> ([f64; 2], SurfacePoint, f64) {
        let domains = [0, 1].map(|k| self.surface.knots()[k].domain());
        let mut at = [0, 1].map(|k| start[k].clamp(domains[k][0], domains[k][1]));
        let mut point = self.surface.evaluate(at[0], at[1]);
        let mut squared = (point.position - query).norm_squared();
        for _ in 0..NEWTON_STEPS {
            let r = point.position - query;
            let tangents = [point.du, point.dv];
            let gradient = tangents.map(|t| t.dot(&r));
            let blocked = |k: usize| {
                (at[k] <= domains[k][0] && gradient[k] >= 0.0) || (at[k] >= domains[k][1] && gradient[k] <= 0.0)
            };
            let free = [!blocked(0), !blocked(1)];
            let step = descent_step(&point, &r, gradient, free);
            let mut scale = 1.0;
            let accepted = loop {
                let next = [0, 1].map(|k| (at[k] + scale * step[k]).clamp(domains[k][0], domains[k][1]));
                let candidate = self.surface.evaluate(next[0], next[1]);
                let value = (candidate.position - query).norm_squared();
                if value <= squared * (1.0 + 4.0 * f64::EPSILON) {
                    let moved = (candidate.position - point.position).norm_squared();
                    (at, point, squared) = (next, candidate, value);
                    break moved > (CONVERGED * self.reach).powi(2);
                }
                scale *= 0.5;
                if scale < 1e-3 {
                    break false;
                }
            };
            if !accepted {
                break;
            }
        }
        (at, point, squared.sqrt())
    }

    fn newton_on_side(&self, query: &Point3<f64>, side: usize, start: f64) -> (f64, f64) {
        let [low, high] = self.surface.knots()[1 - side / 2].domain();
        let evaluate = |t: f64| {
            let [u, v] = on_side(&self.surface, side, t);
            let p = self.surface.evaluate(u, v);
            if side < 2 { (p.position, p.dv, p.dvv) } else { (p.position, p.du, p.duu) }
        };
        let (mut t, (mut position, mut first, mut second)) = (start, evaluate(start));
        let mut squared = (position - query).norm_squared();
        for _ in 0..NEWTON_STEPS {
            let r = position - query;
            let gradient = first.dot(&r);
            let gauss_newton = first.norm_squared();
            let curvature = gauss_newton + second.dot(&r);
            let curvature = if curvature > 1e-3 * gauss_newton { curvature } else { gauss_newton };
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let mut step = -gradient / curvature;
            let accepted = loop {
                let next = (t + step).clamp(low, high);
                let candidate = evaluate(next);
                let value = (candidate.0 - query).norm_squared();
                if value <= squared * (1.0 + 4.0 * f64::EPSILON) {
                    let moved = (candidate.0 - position).norm_squared();
                    (t, squared) = (next, value);
                    (position, first, second) = candidate;
                    break moved > (CONVERGED * self.reach).powi(2);
                }
                step *= 0.5;
                if step.abs() < 1e-15 * (high - low) {
                    break false;
                }
            };
            if !accepted {
                break;
            }
        }
        (t, squared.sqrt())
    }
}

/// Newton step in the free parameters.
fn descent_step(point: &SurfacePoint, r: &Vector3<f64>, gradient: [f64; 2], free: [bool; 2]) -> [f64; 2] {
    let (e, f, g) = (point.du.norm_squared(), point.du.dot(&point.dv), point.dv.norm_squared());
    let (huu, huv, hvv) = (e + point.duu.dot(r), f + point.duv.dot(r), g + point.dvv.dot(r));
    match free {
        [true, true] => {
            let floor = 1e-6 * e * g;
            let (a, b, c) = if huu > 0.0 && huu * hvv - huv * huv > floor { (huu, huv, hvv) } else { (e, f, g) };
            let determinant = a * c - b * b;
            if determinant > 1e-12 * a * c {
                [(b * gradient[1] - c * gradient[0]) / determinant, (b * gradient[0] - a * gradient[1]) / determinant]
            } else {
                // A pole: move along each direction that has a length.
                [(gradient[0], a), (gradient[1], c)].map(|(slope, h)| if h > 0.0 { -slope / h } else { 0.0 })
            }
        }
        _ => [(0, huu, e), (1, hvv, g)].map(|(k, newton, gauss_newton)| {
            let h = if newton > 1e-3 * gauss_newton { newton } else { gauss_newton };
            if free[k] && h > 0.0 { -gradient[k] / h } else { 0.0 }
        }),
    }
}

/// Parameters of the point `t` on a side: u = first, u = last, v = first, v = last.
fn on_side(surface: &NurbsSurface, side: usize, t: f64) -> [f64; 2] {
    let end = surface.knots()[side / 2].domain()[side % 2];
    if side < 2 { [end, t] } else { [t, end] }
}

/// Evenly spaced parameters within each knot span, so that [`SEED_CELLS`] or two a span are reached.
fn seed_parameters(knots: &KnotVector) -> Vec<f64> {
    let distinct = knots.breaks();
    let pieces = SEED_CELLS.div_ceil(distinct.len() - 1).max(2);
    let mut result = vec![distinct[0]];
    for span in distinct.windows(2) {
        result.extend((1..=pieces).map(|k| span[0] + (span[1] - span[0]) * k as f64 / pieces as f64));
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn vault() -> NurbsSurface {
        let net = (0..12 * 10)
            .map(|k| {
                let (s, t) = ((k / 10) as f64 / 11.0, (k % 10) as f64 / 9.0);
                let angle = 4.0 * s;
                Point3::new(3.0 * angle.cos(), 6.0 * t, 3.0 * angle.sin() + 0.4 * (5.0 * t).sin())
            })
            .collect();
        NurbsSurface::uniform(3, [12, 10], net).unwrap()
    }

    #[test]
    fn a_point_pushed_off_along_the_normal_comes_back() {
        let surface = vault();
        let projector = SurfaceProjector::new(&surface);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..200 {
            let (u, v) = (random.random::<f64>(), random.random::<f64>());
            let point = surface.evaluate(u, v);
            let normal = FundamentalForms::new(&point).unwrap().normal;
            let height = 0.6 * random.random::<f64>() - 0.3;
            let foot = projector.closest(&(point.position + normal * height));
            assert!((foot.distance - height.abs()).abs() < 1e-12);
            assert!((foot.position - point.position).norm() < 2e-8);
            assert!((foot.normal - normal).norm() < 1e-7);
        }
    }

    #[test]
    fn no_sample_of_the_surface_is_closer_than_the_foot() {
        let surface = vault();
        let projector = SurfaceProjector::new(&surface);
        let dense: Vec<_> = (0..=100)
            .flat_map(|i| (0..=100).map(move |j| (i, j)))
            .map(|(i, j)| (i as f64 / 100.0, j as f64 / 100.0))
            .collect();
        let points: Vec<_> = dense.iter().map(|&(u, v)| surface.point(u, v)).collect();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..60 {
            let query = Point3::from(Vector3::from_fn(|_, _| 14.0 * random.random::<f64>() - 6.0));
            let foot = projector.closest(&query);
            let border = projector.closest_on_border(&query);
            let mut sampled = [f64::INFINITY; 2];
            for (p, (u, v)) in points.iter().zip(&dense) {
                let distance = (p - query).norm();
                sampled[0] = sampled[0].min(distance);
                if [u, v].iter().any(|t| **t == 0.0 || **t == 1.0) {
                    sampled[1] = sampled[1].min(distance);
                }
            }
            assert!(foot.distance <= sampled[0] + 1e-12 && foot.distance > sampled[0] - 0.15);
            assert!(border.distance <= sampled[1] + 1e-12 && border.distance > sampled[1] - 0.15);
            let [u, v] = border.parameters;
            assert!((surface.point(u, v) - border.position).norm() < 1e-13);
            assert!([u, v].iter().any(|t| *t == 0.0 || *t == 1.0));
        }
    }

    /// The bilinear patch with corners S(0, 0), S(1, 0), S(1, 1), S(0, 1) in the plane z = 0.
    fn quad(corners: [[f64; 2]; 4]) -> SurfaceProjector {
        let [a, b, c, d] = corners.map(|[x, y]| Point3::new(x, y, 0.0));
        SurfaceProjector::new(&NurbsSurface::uniform(1, [2, 2], vec![a, d, b, c]).unwrap())
    }

    #[test]
    fn a_search_along_the_border_stays_on_its_side_of_a_needle() {
        let needle = quad([[0.0, 0.0], [10.0, 0.0], [0.0, 1.0], [-1.0, 0.5]]);
        let query = Point3::new(8.0, 0.15, 0.0);
        assert!(needle.closest_on_border(&query).parameters[0] == 1.0);
        let near = needle.closest_on_border_near(&query, [0.7, 0.0]);
        assert!((near.position - Point3::new(8.0, 0.0, 0.0)).norm() < 1e-9);
        // Beyond the tip it stays at the corner.
        let near = needle.closest_on_border_near(&Point3::new(11.0, 2.0, 0.0), [0.9, 0.0]);
        assert_eq!(near.parameters, [1.0, 0.0]);
    }

    #[test]
    fn a_search_along_the_border_goes_on_past_a_round_corner() {
        let round = quad([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [5.0, 10.0]]);
        let near = round.closest_on_border_near(&Point3::new(15.0, -1.0, 0.0), [0.9, 0.0]);
        assert!((near.position - Point3::new(15.0, 0.0, 0.0)).norm() < 1e-9 && near.parameters[0] == 1.0);
        // From inside there is no side to stay on.
        let query = Point3::new(3.0, 0.5, 0.0);
        assert_eq!(round.closest_on_border_near(&query, [0.5, 0.5]), round.closest_on_border(&query));
    }

    #[test]
    fn a_warm_start_gives_the_same_foot() {
        let projector = SurfaceProjector::new(&vault());
        let query = Point3::new(2.0, 3.0, 3.5);
        let foot = projector.closest(&query);
        let near = projector.closest_near(&query, [foot.parameters[0] + 0.02, foot.parameters[1] - 0.02]);
        assert!((foot.position - near.position).norm() < 1e-10);
    }
}
