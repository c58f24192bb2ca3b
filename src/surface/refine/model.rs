//! The energy of a control net and its quadratic model.

use super::super::knots::Basis;
use super::super::layer_map::{EXTRAPOLATED_RINGS, MapSample};
use super::super::nurbs::NurbsSurface;
use super::super::tensor::GridPlanes;
use super::solve::dot;
use super::{NORMAL_WEIGHT, Refiner};
use nalgebra::{Matrix3, Point3, Vector3};

/// Parts of the surface that project outside the regions of their orientation, squared distance.
const OUTSIDE_WEIGHT: f64 = 0.3;
/// Depth residuals r beyond this, s, count less and less, 2 s^2 (1 - (1 + r^2 / s^2)^(-1/2)): maps are wrong by whole layers at
/// occlusions.
const ROBUST_DEPTH: f64 = 0.7;
/// Surface points whose unit normal has |z| below this may belong to a front or a back region.
const UNDECIDED: f64 = 0.15;
/// Parts of the surface whose side facing the viewer is not drawn there: square of what their facing lacks.
const FACING_WEIGHT: f64 = 1.0;
/// The same for border samples beside a contour, where the sheet between the two may be too thin for the maps: the mean over the border
/// samples, so that a turn there costs more than smoothness saves.
const RIM_FACING_WEIGHT: f64 = 4.0;
/// Facing that is asked for where one side alone is drawn: (S_u x S_v).z / (|S_u| |S_v|). Just enough that rounding and the
/// samples' distance leave no turn between them; steep places are no mistake.
const LEAST_FACING: f64 = 0.03;

/// The energy at one net and its quadratic model: half the gradient, and what its Gauss-Newton Hessian is made of.
pub(super) struct Model {
    pub(super) energy: f64,
    /// Energy and half its gradient without fairness, evenness and closeness.
    pub(super) data: (f64, Vec<f64>),
    pub(super) folds: usize,
    pub(super) depth_squared: f64,
    pub(super) gradient: Vec<f64>,
    /// Upper triangles xx, xy, xz, yy, yz, zz of the weight matrices on dS at the grid samples.
    pub(super) weights: Vec<[f64; 6]>,
    /// Map normal and weights on N . dS_u, N . dS_v.
    pub(super) tangents: Vec<(Vector3<f64>, f64, f64)>,
    pub(super) turns: Vec<Turn>,
    pub(super) rows: Vec<Row>,
}

/// A grid sample that shows a side that is not drawn there, or nearly so.
pub(super) struct Turn {
    pub(super) sample: usize,
    /// Derivative of the residual by x_u, y_u, x_v, y_v.
    pub(super) slope: [f64; 4],
    pub(super) weight: f64,
}

/// One residual at a scattered parameter: direction . S(u, v) moves it.
pub(super) struct Row {
    pub(super) bases: [Basis; 2],
    pub(super) direction: Vector3<f64>,
    pub(super) weight: f64,
    pub(super) residual: f64,
}

/// Distance to a region, and which; see [`Refiner::associate`].
enum Association {
    /// Tangent plane of a map.
    Plane {
        /// The map's normal.
        normal: Vector3<f64>,
        /// Signed distance of the point from the plane.
        residual: f64,
        /// 1 on the map, falling to 0 where its extrapolation ends.
        confidence: f64,
        /// Vector back to the mask.
        outside: [f64; 2],
    },
    /// Vector to the region that the point should project into.
    Outside([f64; 2]),
    /// Nothing known.
    None,
}

impl Refiner<'_> {
    /// Where the maps want a surface point: the tangent plane of the nearest layer that shows its side.
    ///
    /// - `facing`: z of the unit normal. `occluded`: the layer, where the sketch says it (border points).
    fn associate(&self, p: Vector3<f64>, facing: f64, occluded: Option<bool>) -> Association {
        let allowed = |side: usize| {
            let front = side.is_multiple_of(2);
            let layer = occluded.is_none_or(|occluded| occluded == (side >= 2));
            layer && if front { facing > -UNDECIDED } else { facing < UNDECIDED }
        };
        let mut best: Option<(f64, usize, MapSample)> = None;
        for side in (0..4).filter(|&side| allowed(side)) {
            if let Some(sample) = self.map_sides[side].sample([p.x, p.y]) {
                // Along the normal of the map, not of its differences: these are infinite at a contour.
                let residual = sample.normal.z * (p.z + sample.depth);
                if best.as_ref().is_none_or(|(shortest, ..)| residual.abs() < shortest.abs()) {
                    best = Some((residual, side, sample));
                }
            }
        }
        if let Some((residual, side, sample)) = best {
            let confidence = (1.0 - sample.beyond / EXTRAPOLATED_RINGS as f64).max(0.0).powi(2);
            let outside = if sample.beyond > 0.0 { self.map_sides[side].outside([p.x, p.y]) } else { None };
            let outside = outside.map_or([0.0; 2], |(vector, _)| vector);
            return Association::Plane { normal: sample.normal, residual, confidence, outside };
        }
        if occluded.is_some() {
            return self.associate(p, facing, None);
        }
        let nearest = (0..4)
            .filter(|&side| allowed(side))
            .filter_map(|side| self.map_sides[side].outside([p.x, p.y]))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((vector, _)) => Association::Outside(vector),
            None => Association::None,
        }
    }

    /// Energy and quadratic model at `net`.
    pub(super) fn linearize(&self, net: &[f64]) -> Model {
        let n = net.len() / 3;
        let planes = self.planes(net);
        let [x, y, z] = &planes;
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        let count = mu * mv;
        let mut weights = vec![[0.0; 6]; count];
        let mut tangents = vec![(Vector3::zeros(), 0.0, 0.0); count];
        let mut slopes: [GridPlanes; 3] =
            [0, 1, 2].map(|_| GridPlanes { value: vec![0.0; count], du: vec![0.0; count], dv: vec![0.0; count] });
        let (mut energy, mut depth_squared) = (0.0, 0.0);
        let mut facings = Vec::with_capacity(count);
        let mut turns = vec![];
        let (border_layers, border_facing) = self.border_layers(&planes);

        for a in 0..mu {
            for b in 0..mv {
                let k = a * mv + b;
                let full = self.quadrature[0][a] * self.quadrature[1][b];
                let p = Vector3::new(x.value[k], y.value[k], z.value[k]);
                let du = Vector3::new(x.du[k], y.du[k], z.du[k]);
                let dv = Vector3::new(x.dv[k], y.dv[k], z.dv[k]);
                let cross = du.cross(&dv);
                let normal = cross / cross.norm().max(f64::MIN_POSITIVE);
                let area = (du.norm() * dv.norm()).max(f64::MIN_POSITIVE);
                facings.push(cross.z / area);
                let drawn = self.facing_at(p);
                let even = FACING_WEIGHT * self.facing / ((mu - 1) * (mv - 1)) as f64;
                let (asked, weight) = if border_facing[k] == 0.0 {
                    (drawn, even)
                } else {
                    (border_facing[k], even.max(RIM_FACING_WEIGHT / (2 * (mu + mv)) as f64))
                };
                let lack = LEAST_FACING - asked * cross.z / area;
                if asked != 0.0 && lack > 0.0 {
                    energy += weight * lack * lack;
                    let slope = [-dv.y, dv.x, du.y, -du.x].map(|s| s * asked / area);
                    for (c, by_u, by_v) in [(0, slope[0], slope[2]), (1, slope[1], slope[3])] {
                        slopes[c].du[k] += weight * lack * by_u;
                        slopes[c].dv[k] += weight * lack * by_v;
                    }
                    turns.push(Turn { sample: k, slope, weight });
                }
                let facing = if drawn == 0.0 { normal.z } else { drawn };
                match self.associate(p, facing, border_layers[k]) {
                    Association::Plane { normal: target, residual, confidence, outside } => {
                        let ratio = (residual / ROBUST_DEPTH).powi(2);
                        let area = full * confidence;
                        let root = (1.0 + ratio).sqrt();
                        energy += area * ROBUST_DEPTH * ROBUST_DEPTH * 2.0 * (1.0 - 1.0 / root);
                        depth_squared += area * residual * residual;
                        let weight = area / (root * root * root);
                        add_row(&mut weights[k], &mut slopes, k, target, weight, residual);
                        let weight = weight * NORMAL_WEIGHT;
                        let (wu, wv) = (
                            weight / du.norm_squared().max(f64::MIN_POSITIVE),
                            weight / dv.norm_squared().max(f64::MIN_POSITIVE),
                        );
                        let (ru, rv) = (target.dot(&du), target.dot(&dv));
                        energy += wu * ru * ru + wv * rv * rv;
                        tangents[k] = (target, wu, wv);
                        for (c, slope) in slopes.iter_mut().enumerate() {
                            slope.du[k] += target[c] * wu * ru;
                            slope.dv[k] += target[c] * wv * rv;
                        }
                        if outside != [0.0; 2] {
                            energy += pull(&mut weights[k], &mut slopes, k, outside, full * OUTSIDE_WEIGHT);
                        }
                    }
                    Association::Outside(outside) => {
                        energy += pull(&mut weights[k], &mut slopes, k, outside, full * OUTSIDE_WEIGHT);
                    }
                    Association::None => {}
                }
            }
        }
        energy += self.border_term(&planes, &mut weights, &mut slopes);
        let folds = self.count_folds(&facings, &planes);

        let surface = self.surface_or_none(net);
        let mut rows = vec![];
        if let Some(surface) = &surface {
            energy += self.contour_term(surface, &planes, &mut rows);
            energy += self.sample_term(surface, &planes, &mut rows);
        } else {
            energy = f64::INFINITY;
        }

        let mut gradient = vec![0.0; 3 * n];
        for (c, slope) in slopes.iter().enumerate() {
            self.grid.add_adjoint(slope, &mut gradient[c * n..(c + 1) * n]);
        }
        for row in &rows {
            self.add_row_adjoint(row, row.weight * row.residual, &mut gradient);
        }
        let data = (energy, gradient);
        let mut model = Model { energy, data, folds, depth_squared, gradient: vec![], weights, tangents, turns, rows };
        self.regularize(net, &mut model);
        model
    }

    /// Sets energy and gradient of `model`, made at `net`, from those of its data and the present stiffness.
    pub(super) fn regularize(&self, net: &[f64], model: &mut Model) {
        let n = net.len() / 3;
        let (mut energy, mut gradient) = model.data.clone();
        let mut product = vec![0.0; n];
        let mut scratch = vec![0.0; n];
        let mut difference = vec![0.0; n];
        for c in 0..3 {
            let part = &net[c * n..(c + 1) * n];
            product.fill(0.0);
            self.add_tensor(&self.fairness, part, &mut product, &mut scratch);
            energy += dot(part, &product);
            add(&mut gradient[c * n..(c + 1) * n], &product);
            for (d, (now, before)) in difference.iter_mut().zip(part.iter().zip(&self.start[c * n..])) {
                *d = now - before;
            }
            product.fill(0.0);
            self.add_tensor(&self.evenness[c / 2], &difference, &mut product, &mut scratch);
            product.iter_mut().for_each(|x| *x *= self.stiffness);
            energy += dot(&difference, &product);
            add(&mut gradient[c * n..(c + 1) * n], &product);
        }
        if let Some(guess) = &self.guess {
            for c in 0..3 {
                let part = c * n..(c + 1) * n;
                for (d, (now, guess)) in difference.iter_mut().zip(net[part.clone()].iter().zip(&guess[part.clone()])) {
                    *d = now - guess;
                }
                product.fill(0.0);
                self.add_tensor(&self.guessed, &difference, &mut product, &mut scratch);
                energy += dot(&difference, &product);
                add(&mut gradient[part], &product);
            }
        }
        model.energy = if energy.is_nan() { f64::INFINITY } else { energy };
        model.gradient = gradient;
    }

    fn surface_or_none(&self, net: &[f64]) -> Option<NurbsSurface> {
        let n = net.len() / 3;
        let points = (0..n).map(|k| Point3::new(net[k], net[n + k], net[2 * n + k])).collect();
        NurbsSurface::new(self.knots.clone(), points, None).ok()
    }
}

pub(super) fn axis(c: usize) -> Vector3<f64> {
    Matrix3::identity().column(c).into_owned()
}

/// Adds weight (direction . dS + residual)^2 at grid sample `k`.
pub(super) fn add_row(
    weights: &mut [f64; 6],
    slopes: &mut [GridPlanes; 3],
    k: usize,
    direction: Vector3<f64>,
    weight: f64,
    residual: f64,
) {
    let d = direction;
    for (slot, product) in weights.iter_mut().zip([d.x * d.x, d.x * d.y, d.x * d.z, d.y * d.y, d.y * d.z, d.z * d.z]) {
        *slot += weight * product;
    }
    for (c, slope) in slopes.iter_mut().enumerate() {
        slope.value[k] += weight * residual * d[c];
    }
}

/// Pulls grid sample `k` by `vector` in x, y; returns the energy.
fn pull(weights: &mut [f64; 6], slopes: &mut [GridPlanes; 3], k: usize, vector: [f64; 2], weight: f64) -> f64 {
    for (c, v) in vector.iter().enumerate() {
        add_row(weights, slopes, k, axis(c), weight, -v);
    }
    weight * (vector[0] * vector[0] + vector[1] * vector[1])
}

fn add(a: &mut [f64], b: &[f64]) {
    for (x, y) in a.iter_mut().zip(b) {
        *x += y;
    }
}
