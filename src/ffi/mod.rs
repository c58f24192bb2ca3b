//! The C ABI: checks pointers, calls the pipeline, lends views into its results; nothing else.
//!
//! `include/sketch2pq.h` is written from these files, and the doc comments of exported items are its text: they speak
//! to C. Every fallible export is one [`guard::guard`] and nothing around it. Names of exports and the order of struct
//! fields are stable: append only.

#![allow(unsafe_code)]

mod field;
mod guard;
mod handle;
#[cfg(feature = "host-tests")]
mod host_tests;
mod library;
mod mesh;
mod options;
mod planarize;
mod session;
mod sketch;
mod status;
mod surface;

pub use field::*;
pub use library::*;
pub use mesh::*;
pub use planarize::*;
pub use session::*;
pub use sketch::*;
pub use status::*;
pub use surface::*;

use crate::error::Error;
use std::ffi::{CString, c_char};

/// Most values that one array argument may hold; more is a mistake of the caller.
const MAX_COUNT: usize = 1 << 28;

/// An array that the host lends for a call.
///
/// # Safety
/// `pointer` is NULL or valid for reading `count` values.
///
/// # Errors
/// [`Error::Argument`] if `count` is impossible, or `pointer` is NULL or misaligned although `count` is not 0.
unsafe fn slice<'a, T>(name: &'static str, pointer: *const T, count: usize) -> Result<&'a [T], Error> {
    if count == 0 {
        return Ok(&[]);
    }
    if count > MAX_COUNT {
        return Err(Error::Argument { name, value: format!("{count} values"), expected: "at most 2^28 values" });
    }
    if pointer.is_null() || !pointer.is_aligned() {
        let value = if pointer.is_null() { "NULL" } else { "misaligned" }.into();
        return Err(Error::Argument { name, value, expected: "a valid array" });
    }
    // SAFETY: not NULL, aligned, and the caller vouches for `count` values.
    Ok(unsafe { std::slice::from_raw_parts(pointer, count) })
}

/// Where a result goes, checked before any work is done.
///
/// # Errors
/// [`Error::Argument`] for a NULL or misaligned pointer.
fn output<T>(name: &'static str, pointer: *mut T) -> Result<Output<T>, Error> {
    if pointer.is_null() || !pointer.is_aligned() {
        let value = if pointer.is_null() { "NULL" } else { "misaligned" }.into();
        return Err(Error::Argument { name, value, expected: "a place for the result" });
    }
    Ok(Output(pointer))
}

/// A checked place for a result.
struct Output<T>(*mut T);

impl<T> Output<T> {
    fn set(self, value: T) {
        // SAFETY: not NULL and aligned by `output`; the host vouches that it may be written.
        unsafe { self.0.write(value) }
    }
}

/// A text that the host lends, NUL-terminated UTF-8; `None` for NULL.
///
/// # Safety
/// `pointer` is NULL or points to a NUL-terminated string.
///
/// # Errors
/// [`Error::Argument`] if it is not UTF-8.
unsafe fn text<'a>(name: &'static str, pointer: *const c_char) -> Result<Option<&'a str>, Error> {
    if pointer.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller vouches for the terminating NUL.
    let text = unsafe { std::ffi::CStr::from_ptr(pointer) };
    let text = text.to_str();
    text.map(Some).map_err(|e| Error::Argument { name, value: e.to_string(), expected: "UTF-8 text" })
}

/// A text to lend; what follows a NUL inside is left out.
fn lent_text(text: String) -> CString {
    CString::new(text).unwrap_or_else(|error| {
        let end = error.nul_position();
        let mut bytes = error.into_vec();
        bytes.truncate(end);
        CString::new(bytes).expect("the bytes end before the first NUL")
    })
}

/// `value` as a truth value of the ABI.
///
/// # Errors
/// [`Error::Argument`] unless 0 or 1.
fn flag(name: &'static str, value: u32) -> Result<bool, Error> {
    match value {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(Error::Argument { name, value: value.to_string(), expected: "0 or 1" }),
    }
}

/// The element of `all` that `number` stands for.
///
/// # Errors
/// [`Error::Argument`] for a number beyond the last.
fn choice<T: Copy>(name: &'static str, number: u32, all: &[T], expected: &'static str) -> Result<T, Error> {
    let found = all.get(number as usize).copied();
    found.ok_or_else(|| Error::Argument { name, value: number.to_string(), expected })
}

/// Hands out a text that a handle keeps; `length` may be NULL.
///
/// # Errors
/// [`Error::Argument`] if there is no place for the text.
fn lend_text(text: &std::ffi::CStr, place: *mut *const c_char, length: *mut usize) -> Result<(), Error> {
    let place = output("json", place)?;
    if !length.is_null() {
        output("length", length)?.set(text.count_bytes());
    }
    place.set(text.as_ptr());
    Ok(())
}

/// Hands out an array that a handle keeps.
///
/// # Errors
/// [`Error::Argument`] if there is no place for the array or its count.
fn lend_array<T>(values: &[T], per_item: usize, place: *mut *const T, count: *mut usize) -> Result<(), Error> {
    let (place, count) = (output("values", place)?, output("count", count)?);
    place.set(values.as_ptr());
    count.set(values.len() / per_item);
    Ok(())
}
