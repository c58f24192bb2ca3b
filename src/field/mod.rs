//! Conjugate direction fields on surfaces.

mod border;
mod cancel;
mod coarse;
mod conjugate;
mod conjugate_field;
mod finish;
mod gauss_newton;
mod initial;
mod integrate;
mod layout;
mod lift;
mod map_elements;
mod map_sizes;
mod map_system;
mod map_unknowns;
mod matching;
mod parallel;
mod polyvector;
mod prescribe;
mod problem;
mod quarter_turns;
mod relations;
mod rounding;
mod seamless_map;
mod seams;
mod settle;
mod smooth;
mod smoothness;
mod system;
#[cfg(test)]
mod test_surfaces;
mod topology;
mod trace;
mod untangle;
mod visit;

pub use conjugate::{SecondForm, middle_forms, second_forms};
pub use conjugate_field::{ConjugateField, FieldDiagnostics, Singularity};
pub use integrate::{Density, Integrator, MapOptions, SideFit, integrate};
pub use lift::{
    CanvasField, CanvasView, constraints_along, constraints_from_lines, constraints_from_parameters, guess_from_canvas,
};
pub use matching::{Cross, match_field, matching};
pub use polyvector::PolyVector;
pub use seamless_map::{MAP_UNIT, MapDiagnostics, SeamlessMap, Transition};
pub use smooth::{DirectionConstraint, FieldOptions, conjugate_field, conjugate_field_with_singularities};
pub use smoothness::smoothness_energy;
pub use topology::{EdgeTopology, NO_TRIANGLE, TriangleFrames};
pub use trace::{Trace, TraceEnd, trace, trace_both_ways};
