//! Known surfaces, projected exactly: the truth that the tests of fitting compare with.

use super::border::LayerMaps;
use super::corners::BorderLoop;
use super::layer_map::LayerMap;
use super::ray::RayCaster;
use super::{NurbsSurface, SurfaceMesh};
use nalgebra::{Point3, Vector3};

pub const HALF: f64 = 4.0 * 256.0 / 232.0;

/// A surface in the canonical frame and what a perfect sketch and perfect networks say about it.
pub struct Scene {
    pub truth: NurbsSurface,
    pub border: BorderLoop,
    pub corners: [usize; 4],
    pub contours: Vec<Vec<[f64; 2]>>,
    pub maps: LayerMaps,
}

/// A 30 x 30 cubic surface through S(s, t) (approximately: control points at the Greville abscissae).
pub fn surface(shape: impl Fn(f64, f64) -> [f64; 3]) -> NurbsSurface {
    let knots = super::KnotVector::uniform(3, 30).greville();
    let net = knots
        .iter()
        .flat_map(|&s| knots.iter().map(move |&t| (s, t)))
        .map(|(s, t)| Point3::from(shape(s, t)))
        .collect();
    NurbsSurface::uniform(3, [30, 30], net).unwrap()
}

/// u runs downwards, v to the right.
pub fn dome() -> NurbsSurface {
    surface(|s, t| {
        let (x, y) = (8.0 * t - 4.0, 3.4 - 6.8 * s);
        let (x, y) = (x * (1.0 - 0.03 * y), y + 0.25 * (0.5 * x).cos());
        [x, y, -6.0 - 0.12 * (x * x + y * y) + 0.2 * y]
    })
}

pub fn saddle() -> NurbsSurface {
    surface(|s, t| {
        let (x, y) = (7.6 * t - 3.8, 3.8 - 7.6 * s);
        let (x, y) = (x + 0.1 * y, y - 0.15 * x);
        [x, y, -5.0 + 0.1 * (x * x - y * y) + 0.3 * y]
    })
}

/// A vault whose crest turns over at the top: the back of its far wall is hidden behind the front, with a curved contour.
pub fn vault() -> NurbsSurface {
    surface(|s, t| {
        // From the far wall's foot over the crest to the near wall's foot.
        let angle = 3.75 - 3.2 * s;
        let x = 7.4 * t - 3.7;
        let radius = 3.0 + 0.35 * (0.8 * x).cos() + 0.1 * x;
        [x, -radius * angle.cos() - 0.6, -7.0 + 1.3 * radius * angle.sin()]
    })
}

/// A sheet that rises at the back, turns over and hangs down in front of itself: below its free edge what it hides comes to light.
pub fn breaker() -> NurbsSurface {
    surface(|s, t| {
        let angle = 2.0 + 3.4 * s;
        let x = (7.4 * t - 3.7) * (1.0 + 0.05 * angle.sin());
        let radius = 3.0 + 0.35 * (0.8 * x).cos() + 0.1 * x;
        [x, -radius * angle.cos() - 0.6, -7.0 + 1.3 * radius * angle.sin()]
    })
}

pub fn scene(truth: NurbsSurface) -> Scene {
    let mesh = SurfaceMesh::new(&truth, [160, 160]).unwrap();
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let caster = RayCaster::new(&mesh, axes);
    let n = 64;
    let mut maps = LayerMaps { visible: LayerMap::empty(n, HALF), occluded: LayerMap::empty(n, HALF) };
    for k in 0..n * n {
        let [x, y] = maps.visible.center(k);
        for (hit, map) in caster.hits(x, y).iter().zip([&mut maps.visible, &mut maps.occluded]) {
            let forms = super::FundamentalForms::new(&truth.evaluate(hit.parameters[0], hit.parameters[1])).unwrap();
            map.valid[k] = true;
            map.front[k] = forms.normal.z > 0.0;
            map.normal[k] = forms.normal;
            map.depth[k] = hit.depth;
        }
    }
    let per_side = 220;
    let mut points = vec![];
    let (mut occluded, mut front) = (vec![], vec![]);
    for side in 0..4 {
        for k in 0..per_side {
            let w = k as f64 / per_side as f64;
            let [u, v] = [[w, 0.0], [1.0, w], [1.0 - w, 1.0], [0.0, 1.0 - w]][side];
            let at = truth.evaluate(u, v);
            let p = at.position;
            points.push([p.x, p.y]);
            front.push(at.du.cross(&at.dv).z > 0.0);
            occluded.push(caster.hits(p.x, p.y).iter().any(|hit| hit.depth < -p.z - 0.02));
        }
    }
    let border = BorderLoop::new(points, occluded, front).unwrap();
    let key = |i: usize| border.points[i][1] - border.points[i][0];
    assert!((1..4).all(|k| key(0) >= key(k * per_side)), "the fixture starts at the upper left");
    let contours = contour_lines(&truth);
    Scene { truth, border, corners: [0, per_side, 2 * per_side, 3 * per_side], contours, maps }
}

/// Projected silhouettes of the fixtures, which cross each line v = const at most once: one polyline along v.
fn contour_lines(truth: &NurbsSurface) -> Vec<Vec<[f64; 2]>> {
    let facing = |u: f64, v: f64| {
        let p = truth.evaluate(u, v);
        p.du.x * p.dv.y - p.dv.x * p.du.y
    };
    let mut line = vec![];
    for k in 0..=200 {
        let v = k as f64 / 200.0;
        for i in 0..100 {
            let (mut a, mut b) = (i as f64 / 100.0, (i + 1) as f64 / 100.0);
            if facing(a, v) * facing(b, v) < 0.0 {
                for _ in 0..50 {
                    let middle = 0.5 * (a + b);
                    if facing(a, v) * facing(middle, v) <= 0.0 { b = middle } else { a = middle }
                }
                let p = truth.point(a, v);
                line.push([p.x, p.y]);
            }
        }
    }
    if line.is_empty() { vec![] } else { vec![line] }
}
