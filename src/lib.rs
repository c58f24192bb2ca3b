//! `sketch2pq` turns an architect's single sketch into a building skin: strokes go in, a NURBS surface and a
//! mesh of planar quadrilateral panels come out.
//!
//! The folders are the pipeline:
//!
//! - [`sketch`]: strokes are cleaned, cut and arranged into regions; visibility and orientation of each region; the
//!   maps that the networks read.
//! - [`infer`]: the four networks, through ONNX Runtime or an embedded engine.
//! - [`surface`]: NURBS, and the refinement of the control net until it obeys the sketch.
//! - [`field`]: conjugate direction fields and the seamless map whose isolines follow them.
//! - [`mesh`]: quad extraction, borders, planarity, planarization.
//! - [`pipeline`]: the three calls that a host makes, one for each arrow.
//!
//! [`ffi`] lends them to C. [`numeric`] solves sparse systems and knows no geometry. [`datagen`] makes training data
//! with the very same [`sketch`] code, [`evaluate`] measures. Imports point downwards only (see CONTRIBUTING.md).

pub mod control;
pub mod datagen;
pub mod error;
pub mod evaluate;
pub mod ffi;
pub mod field;
pub mod infer;
pub mod mesh;
pub mod numeric;
pub mod picture;
pub mod pipeline;
pub mod sketch;
pub mod surface;

pub use error::Error;
