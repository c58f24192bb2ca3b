//! The four networks, through ONNX Runtime or an embedded engine.
//!
//! [`Networks`] owns them and knows what each reads and answers; [`Models`] are their files; [`BackendOptions`] say what runs
//! them.

mod backend;
mod bsr_net;
mod cdf_net;
mod embedded;
mod layers;
mod library;
mod maps;
mod models;
mod networks;
mod od_net;
mod onnx_runtime;
mod samples;
mod search;
mod vd_net;

pub use backend::{Backend, BackendChoice, BackendInfo, BackendOptions, Engine};
pub use bsr_net::{NET_POINTS, NET_SIZE};
pub use cdf_net::DirectionPrediction;
pub use layers::{DepthPrediction, LayerPrediction};
pub use maps::{MAP_PIXELS, bilinear, pixel_center};
pub use models::{MANIFEST_FORMAT, Manifest, ModelEntry, Models, Network, TensorEntry, TrainingEntry};
pub use networks::{Networks, SketchMaps};
