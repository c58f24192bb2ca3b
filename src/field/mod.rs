//! Conjugate direction fields on surfaces.

mod conjugate_field;
mod matching;
mod topology;

pub use conjugate_field::{ConjugateField, FieldDiagnostics, Singularity};
pub use matching::{Cross, match_field, matching};
pub use topology::{EdgeTopology, NO_TRIANGLE, TriangleFrames};
