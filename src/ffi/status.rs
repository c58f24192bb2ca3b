//! What a call answers: one status for each thing that a host would do about it.

use crate::error::Error;

/// What a call answers. The number says what to do, s2pq_last_message says what happened and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum S2pqStatus {
    /// Done.
    Ok = 0,
    /// An argument, a handle or a struct size is wrong: fix the call.
    InvalidArgument = 1,
    /// The sketch is empty, open, or contradicts itself: change the drawing where the message says.
    InvalidSketch = 2,
    /// The surface, field or mesh is degenerate: change the geometry.
    InvalidGeometry = 3,
    /// A target could not be reached: relax it.
    NotReached = 4,
    /// The host cancelled the call.
    Cancelled = 5,
    /// A file, a model or the requested backend cannot be used: repair the installation.
    Unavailable = 6,
    /// A defect of the library: report it with the message.
    Internal = 7,
}

impl S2pqStatus {
    /// Every status, in the order of their numbers.
    const ALL: [Self; 8] = [
        Self::Ok,
        Self::InvalidArgument,
        Self::InvalidSketch,
        Self::InvalidGeometry,
        Self::NotReached,
        Self::Cancelled,
        Self::Unavailable,
        Self::Internal,
    ];

    fn name(self) -> &'static std::ffi::CStr {
        match self {
            Self::Ok => c"ok",
            Self::InvalidArgument => c"invalid argument",
            Self::InvalidSketch => c"invalid sketch",
            Self::InvalidGeometry => c"invalid geometry",
            Self::NotReached => c"target not reached",
            Self::Cancelled => c"cancelled",
            Self::Unavailable => c"unavailable",
            Self::Internal => c"internal error",
        }
    }
}

impl From<&Error> for S2pqStatus {
    /// No `_` arm: a new error asks for its status here.
    fn from(error: &Error) -> Self {
        match error {
            Error::Argument { .. } | Error::Format { .. } | Error::SingularityCount { .. } => Self::InvalidArgument,
            Error::NotFinite { .. }
            | Error::NoOutline
            | Error::OpenOutline { .. }
            | Error::Contradiction { .. }
            | Error::TooLarge { .. }
            | Error::SampleOutside { .. } => Self::InvalidSketch,
            Error::Nurbs { .. }
            | Error::Degenerate { .. }
            | Error::VertexOutOfRange { .. }
            | Error::Singular { .. }
            | Error::NoMesh { .. } => Self::InvalidGeometry,
            Error::NotPlanar { .. } => Self::NotReached,
            Error::Cancelled => Self::Cancelled,
            Error::File { .. } | Error::Model { .. } | Error::Backend { .. } => Self::Unavailable,
        }
    }
}

/// The English name of a status, never NULL, static.
///
/// - `status`: an S2pqStatus; any other number has the name "unknown status".
#[unsafe(no_mangle)]
pub extern "C" fn s2pq_status_name(status: u32) -> *const std::ffi::c_char {
    S2pqStatus::ALL.iter().find(|s| **s as u32 == status).map_or(c"unknown status", |s| s.name()).as_ptr()
}
