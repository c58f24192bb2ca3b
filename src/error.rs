//! The one error of the library.

/// Everything that can go wrong, stated as a fact with its numbers.
///
/// Positions are canvas coordinates, as the host drew them, unless the message says otherwise.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // The messages say what the fields are.
pub enum Error {
    // --- input files and arguments
    /// A file could not be read or written.
    #[error("{path}: {reason}")]
    File { path: String, reason: String },
    /// The text of a sketch, surface, mesh or manifest does not have the expected form.
    #[error("{what}: {reason}")]
    Format { what: &'static str, reason: String },
    /// An argument is outside its range.
    #[error("{name} is {value}, expected {expected}")]
    Argument { name: &'static str, value: String, expected: &'static str },
    /// A number that must be finite is not.
    #[error("{what} {index} has a coordinate that is not a finite number")]
    NotFinite { what: &'static str, index: usize },

    // --- sketch
    /// The sketch holds no stroke that bounds a surface.
    #[error("the sketch has no outline: draw the surface's border as visible boundary strokes")]
    NoOutline,
    /// A structural stroke ends in the open.
    #[error(
        "the outline is open: stroke {stroke} ends at ({x:.4}, {y:.4}), {gap:.4} away from the nearest other structural \
         line; extend it or draw the missing piece there"
    )]
    OpenOutline { stroke: usize, x: f64, y: f64, gap: f64 },
    /// The strokes contradict each other.
    #[error("the sketch contradicts itself near ({x:.4}, {y:.4}): {reason}")]
    Contradiction { x: f64, y: f64, reason: String },
    /// The sketch is larger than what the library accepts.
    #[error("the sketch has {count} {what}, the limit is {limit}")]
    TooLarge { what: &'static str, count: usize, limit: usize },
    /// A depth sample lies outside the layer that it names.
    #[error("depth sample {index} at ({x:.4}, {y:.4}) lies outside the {layer} part of the surface")]
    SampleOutside { index: usize, x: f64, y: f64, layer: &'static str },

    // --- networks and runtime
    /// A model file is missing, damaged or of another shape than the manifest says.
    #[error("model {name}: {reason}")]
    Model { name: String, reason: String },
    /// The requested inference backend cannot be used.
    #[error("backend {backend}: {reason}")]
    Backend { backend: &'static str, reason: String },

    // --- surfaces, fields, meshes
    /// NURBS data that describe no surface.
    #[error("not a NURBS surface: {reason}")]
    Nurbs { reason: String },
    /// A surface, field or mesh that the stage cannot work on.
    #[error("degenerate geometry: {reason}")]
    Degenerate { reason: String },
    /// A face refers to a vertex that does not exist.
    #[error("face {face} refers to vertex {vertex} of {count}")]
    VertexOutOfRange { face: usize, vertex: u32, count: usize },
    /// A linear system could not be factorized.
    #[error("{what}: the linear system of size {size} is singular or not positive definite")]
    Singular { what: &'static str, size: usize },
    /// Planarization stopped above its target.
    #[error("planarity is {reached:.1e} after {rounds} rounds, asked for {target:.1e}")]
    NotPlanar { reached: f64, target: f64, rounds: usize },
    /// Singularities that no field has which follows the whole border.
    #[error(
        "the singularities sum to {sum} quarter turns, but the border, which the field shall follow all around, leaves room for {room}"
    )]
    SingularityCount { sum: i32, room: i32 },
    /// The map could not be turned into a mesh.
    #[error("no panel mesh: {reason}")]
    NoMesh { reason: String },

    // --- control
    /// The host asked to stop.
    #[error("cancelled by the host")]
    Cancelled,
}
