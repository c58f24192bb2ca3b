//! Conjugate direction fields on surfaces.
