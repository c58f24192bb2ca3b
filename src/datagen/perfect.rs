//! What perfect networks would say of a sketch, so that the later stages can be judged apart from the present ones.

use super::{MAP, Sample};
use crate::error::Error;
use crate::sketch::{CANVAS_HALF_WIDTH, horizontal_slope};
use crate::surface::{LayerMap, LayerMaps, SurfaceTargets};
use nalgebra::Vector3;

impl Sample {
    /// What the surface has to obey: the strokes, without depth samples, and the exact maps. Canonical frame, as the sample's surface.
    ///
    /// # Errors
    /// [`Error::Degenerate`] for a border that spans no patch.
    pub fn surface_targets(&self) -> Result<SurfaceTargets, Error> {
        let maps = LayerMaps { visible: self.layer_map(0), occluded: self.layer_map(1) };
        SurfaceTargets::new(&self.patch, None, maps)
    }

    fn layer_map(&self, layer: usize) -> LayerMap {
        const PIXELS: usize = MAP * MAP;
        let slope = horizontal_slope(&self.patch.view);
        let mut map = LayerMap::empty(MAP, CANVAS_HALF_WIDTH);
        for k in (0..PIXELS).filter(|k| self.maps.valid[layer * PIXELS + k] > 0) {
            map.valid[k] = true;
            map.front[k] = self.maps.valid[layer * PIXELS + k] == 1;
            map.depth[k] = f64::from(self.maps.depth[layer * PIXELS + k]) + slope * map.center(k)[1];
            let normal = |axis: usize| f64::from(self.maps.normal[(layer * 3 + axis) * PIXELS + k]);
            map.normal[k] = Vector3::new(normal(0), normal(1), normal(2));
        }
        map
    }
}
