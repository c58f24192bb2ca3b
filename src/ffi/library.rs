//! The library as a whole: version and last message.

use super::MAX_COUNT;
use super::guard::last_message;
use std::ffi::{CStr, c_char};
use std::sync::LazyLock;

const fn number(text: &str) -> u32 {
    let bytes = text.as_bytes();
    let (mut i, mut value) = (0, 0);
    while i < bytes.len() {
        value = value * 10 + (bytes[i] - b'0') as u32;
        i += 1;
    }
    value
}

/// Major and minor version of the crate: the number that hosts compare.
pub(super) const ABI_VERSION: u32 =
    number(env!("CARGO_PKG_VERSION_MAJOR")) * 1000 + number(env!("CARGO_PKG_VERSION_MINOR"));

static VERSION: LazyLock<std::ffi::CString> = LazyLock::new(|| super::lent_text(env!("CARGO_PKG_VERSION").to_owned()));

/// The version of the ABI, 1000 * major + minor.
///
/// Check on load that it equals S2PQ_ABI_VERSION: until version 1.0 every minor version may change the ABI; from then
/// on a library serves every host of the same major version that was compiled against its own or a smaller minor
/// version.
#[unsafe(no_mangle)]
pub extern "C" fn s2pq_abi_version() -> u32 {
    ABI_VERSION
}

/// The version of the library as text, "major.minor.patch"; static.
#[unsafe(no_mangle)]
pub extern "C" fn s2pq_version() -> *const c_char {
    let version: &CStr = &VERSION;
    version.as_ptr()
}

/// Copies what the last fallible call on this thread had to say; empty after a success.
///
/// Ask on the thread that got the status, before its next call.
///
/// - `buffer`: takes the UTF-8 text, cut where it does not fit, always NUL-terminated; may be NULL if `capacity` is 0.
/// - `capacity`: size of the buffer in bytes.
/// - returns the length of the whole message in bytes, without the NUL.
///
/// # Safety
/// `buffer` is valid for writing `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_last_message(buffer: *mut c_char, capacity: usize) -> usize {
    let message = last_message();
    if !buffer.is_null() && (1..=MAX_COUNT).contains(&capacity) {
        let mut fits = message.len().min(capacity - 1);
        while !message.is_char_boundary(fits) {
            fits -= 1;
        }
        // SAFETY: `fits` bytes and the NUL are within the capacity that the host vouches for.
        unsafe {
            std::ptr::copy_nonoverlapping(message.as_ptr(), buffer.cast::<u8>(), fits);
            buffer.add(fits).write(0);
        }
    }
    message.len()
}
