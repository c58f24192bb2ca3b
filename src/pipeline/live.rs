//! What a live session keeps of the last sketch, and when its surface is a start for the next one.

use super::surface::SurfaceOptions;
use crate::sketch::{CANONICAL_PER_PX, CanonicalFrame, PatchSketch, View};
use crate::surface::{BorderLoop, NurbsSurface, RefineReport, SurfaceTargets};

/// Most that a border, a corner or a contour may have moved since the last sketch, pixels of the 256 canvas: the refinement's first
/// steps bridge as much without bending the parameter lines.
const MOST_MOVED_PX: f64 = 8.0;
/// Every fourth point is compared: they lie within a pixel of each other.
const EVERY: usize = 4;
/// Largest mean miss of border and contours with which a warm result stands, pixels: what is asked of the strokes.
const MEAN_MISS_PX: f64 = 0.5;
/// Largest single miss, pixels.
const WORST_MISS_PX: f64 = 2.0;
/// Largest miss of a depth sample, canonical units: a hundredth of the depth range of a usual patch.
const SAMPLE_MISS: f64 = 0.06;
/// Largest share of the surface that shows a side that is not drawn.
const MISFACING: f64 = 0.01;

/// The patches of the last sketch.
#[derive(Default)]
pub(super) struct LiveSurfaces {
    patches: Vec<LivePatch>,
}

/// A patch as it was drawn, with its surface; canonical frame of that sketch.
pub(super) struct LivePatch {
    view: View,
    frame: CanonicalFrame,
    options: SurfaceOptions,
    border: BorderLoop,
    corners: [[f64; 2]; 4],
    contours: Vec<Vec<[f64; 2]>>,
    samples: [usize; 2],
    surface: NurbsSurface,
    /// How well the last surface that began anew obeyed.
    anew: RefineReport,
}

impl LiveSurfaces {
    /// The last sketch's patch with this number; `None` unless there were `count` patches.
    pub fn patch(&self, index: usize, count: usize) -> Option<&LivePatch> {
        self.patches.get(index).filter(|_| self.patches.len() == count)
    }

    /// Keeps the patches of a sketch instead.
    pub fn keep(&mut self, patches: Vec<LivePatch>) {
        self.patches = patches;
    }
}

fn samples(targets: &SurfaceTargets) -> [usize; 2] {
    [false, true].map(|occluded| targets.samples.iter().filter(|s| s.occluded == occluded).count())
}

fn corners(targets: &SurfaceTargets) -> [[f64; 2]; 4] {
    targets.corners.map(|corner| targets.border.points[corner])
}

impl LivePatch {
    /// Keeps a patch; `surface` in its canonical frame.
    pub fn new(
        patch: &PatchSketch,
        options: &SurfaceOptions,
        targets: &SurfaceTargets,
        surface: NurbsSurface,
        anew: RefineReport,
    ) -> Self {
        Self {
            view: patch.view,
            frame: patch.frame,
            options: *options,
            border: targets.border.clone(),
            corners: corners(targets),
            contours: targets.contours.clone(),
            samples: samples(targets),
            surface,
            anew,
        }
    }

    /// The last surface in the frame of `patch`, if the sketch is much the same: the same view, options, numbers of contours, depth
    /// samples and changes of layer along the border, and no corner, border or contour moved by more than [`MOST_MOVED_PX`].
    pub fn start(
        &self,
        patch: &PatchSketch,
        options: &SurfaceOptions,
        targets: &SurfaceTargets,
    ) -> Option<NurbsSurface> {
        let same = self.view == patch.view
            && self.options == *options
            && self.contours.len() == targets.contours.len()
            && self.samples == samples(targets)
            && layer_changes(&self.border) == layer_changes(&targets.border);
        if !same {
            return None;
        }
        let moved = |p: &[f64; 2]| patch.frame.from_camera(self.frame.to_camera(*p));
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) <= MOST_MOVED_PX * CANONICAL_PER_PX;
        let covers = |old: &[[f64; 2]], new: &[[f64; 2]]| {
            let old: Vec<[f64; 2]> = old.iter().map(moved).collect();
            let covered =
                |by: &[[f64; 2]], of: &[[f64; 2]]| of.iter().step_by(EVERY).all(|p| by.iter().any(|q| near(*p, *q)));
            covered(&old, new) && covered(new, &old)
        };
        let at_corners = self.corners.iter().zip(corners(targets)).all(|(old, new)| near(moved(old), new));
        let covered = at_corners
            && covers(&self.border.points, &targets.border.points)
            && self.contours.iter().zip(&targets.contours).all(|(old, new)| covers(old, new));
        covered.then(|| self.surface.mapped(|p| patch.frame.point_from_camera(&self.frame.point_to_camera(p))))
    }

    /// How well the last surface obeyed that began anew.
    pub fn anew(&self) -> RefineReport {
        self.anew
    }

    /// Whether a surface that began with this one obeys the sketch: as is asked of the strokes, or, where that is not to be had, as
    /// well as the last one that began anew, so that misses do not add up from call to call.
    pub fn obeys(&self, report: &RefineReport) -> bool {
        let anew = &self.anew;
        let missed = [(report.border_px, anew.border_px), (report.contour_px, anew.contour_px)];
        missed.iter().all(|(now, anew)| now[0] <= MEAN_MISS_PX.max(anew[0]) && now[1] <= WORST_MISS_PX.max(anew[1]))
            && report.sample_residual <= SAMPLE_MISS.max(anew.sample_residual)
            && report.samples_missed <= anew.samples_missed
            && report.folds <= anew.folds
            && report.misfacing <= MISFACING.max(anew.misfacing)
    }
}

/// Number of places along the loop where the border changes its layer.
fn layer_changes(border: &BorderLoop) -> usize {
    let flags = &border.occluded;
    (0..flags.len()).filter(|&i| flags[i] != flags[(i + 1) % flags.len()]).count()
}
