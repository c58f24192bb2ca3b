//! What one sample of the parameter grid adds to the energy and to its quadratic model.

use super::super::layer_map::{EXTRAPOLATED_RINGS, MapSample};
use super::super::tensor::GridPlanes;
use super::{NORMAL_WEIGHT, Refiner};
use nalgebra::Vector3;

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

/// Energy of a grid sample, and its quadratic model in the sample's S, S_u and S_v.
#[derive(Default)]
pub(super) struct GridSample {
    pub(super) energy: f64,
    /// Squared distance from the tangent plane of the map, times the area.
    pub(super) depth_squared: f64,
    /// (S_u x S_v).z / (|S_u| |S_v|)
    pub(super) facing: f64,
    /// Half the gradient by S, S_u and S_v.
    pub(super) slope: [Vector3<f64>; 3],
    /// Upper triangle xx, xy, xz, yy, yz, zz of the weight matrix on dS.
    pub(super) weights: [f64; 6],
    /// Map normal N and weights on N . dS_u, N . dS_v.
    pub(super) tangent: (Vector3<f64>, f64, f64),
    pub(super) turn: Option<Turn>,
}

impl GridSample {
    /// Adds weight (direction . dS + residual)^2 to the energy and its model.
    pub(super) fn add(&mut self, direction: Vector3<f64>, weight: f64, residual: f64) {
        self.energy += weight * residual * residual;
        self.add_model(direction, weight, residual);
    }

    /// Adds the same to the model alone.
    fn add_model(&mut self, d: Vector3<f64>, weight: f64, residual: f64) {
        let products = [d.x * d.x, d.x * d.y, d.x * d.z, d.y * d.y, d.y * d.z, d.z * d.z];
        for (slot, product) in self.weights.iter_mut().zip(products) {
            *slot += weight * product;
        }
        self.slope[0] += d * (weight * residual);
    }

    /// Pulls by `vector` in x, y.
    fn pull(&mut self, vector: [f64; 2], weight: f64) {
        for (c, v) in vector.into_iter().enumerate() {
            self.add(Vector3::ith(c, 1.0), weight, -v);
        }
    }
}

/// A grid sample that shows a side that is not drawn there, or nearly so.
pub(super) struct Turn {
    pub(super) sample: usize,
    /// Derivative of the residual by x_u, y_u, x_v, y_v.
    pub(super) slope: [f64; 4],
    pub(super) weight: f64,
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

    /// Energy and model of sample `k`.
    ///
    /// - `layer`, `border_facing`: for border samples the layer on which they are drawn and the side that they show, see
    ///   [`Refiner::border_layers`].
    pub(super) fn grid_sample(
        &self,
        k: usize,
        planes: &[GridPlanes; 3],
        layer: Option<bool>,
        border_facing: f64,
    ) -> GridSample {
        let mut sample = GridSample::default();
        let at = |of: fn(&GridPlanes) -> &Vec<f64>| Vector3::from(planes.each_ref().map(|plane| of(plane)[k]));
        let [p, du, dv] = [at(|plane| &plane.value), at(|plane| &plane.du), at(|plane| &plane.dv)];
        let (mu, mv) = (self.grid.axes[0].len(), self.grid.axes[1].len());
        let full = self.quadrature[0][k / mv] * self.quadrature[1][k % mv];
        let cross = du.cross(&dv);
        let area = (du.norm() * dv.norm()).max(f64::MIN_POSITIVE);
        sample.facing = cross.z / area;
        let drawn = self.facing_at(p);
        let even = FACING_WEIGHT * self.facing / ((mu - 1) * (mv - 1)) as f64;
        let (asked, weight) = if border_facing == 0.0 {
            (drawn, even)
        } else {
            (border_facing, even.max(RIM_FACING_WEIGHT / (2 * (mu + mv)) as f64))
        };
        let lack = LEAST_FACING - asked * cross.z / area;
        if asked != 0.0 && lack > 0.0 {
            sample.energy += weight * lack * lack;
            let slope = [-dv.y, dv.x, du.y, -du.x].map(|s| s * asked / area);
            sample.slope[1] += Vector3::new(slope[0], slope[1], 0.0) * (weight * lack);
            sample.slope[2] += Vector3::new(slope[2], slope[3], 0.0) * (weight * lack);
            sample.turn = Some(Turn { sample: k, slope, weight });
        }
        let facing = if drawn == 0.0 { cross.z / cross.norm().max(f64::MIN_POSITIVE) } else { drawn };
        match self.associate(p, facing, layer) {
            Association::Plane { normal, residual, confidence, outside } => {
                let ratio = (residual / ROBUST_DEPTH).powi(2);
                let area = full * confidence;
                let root = (1.0 + ratio).sqrt();
                sample.energy += area * ROBUST_DEPTH * ROBUST_DEPTH * 2.0 * (1.0 - 1.0 / root);
                sample.depth_squared = area * residual * residual;
                let weight = area / (root * root * root);
                sample.add_model(normal, weight, residual);
                let weight = weight * NORMAL_WEIGHT;
                let [wu, wv] = [du, dv].map(|d| weight / d.norm_squared().max(f64::MIN_POSITIVE));
                let [ru, rv] = [du, dv].map(|d| normal.dot(&d));
                sample.energy += wu * ru * ru + wv * rv * rv;
                sample.slope[1] += normal * (wu * ru);
                sample.slope[2] += normal * (wv * rv);
                sample.tangent = (normal, wu, wv);
                if outside != [0.0; 2] {
                    sample.pull(outside, full * OUTSIDE_WEIGHT);
                }
            }
            Association::Outside(outside) => sample.pull(outside, full * OUTSIDE_WEIGHT),
            Association::None => {}
        }
        sample
    }
}
