//! Opaque handles: who is alive, and of which kind.
//!
//! Every handle is entered in one table when it is made and struck out when it is freed, so that a NULL, a stray
//! pointer, a handle of another kind and a second free get an answer and not a crash: the process is someone's open
//! document.

use crate::error::Error;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A type that hosts hold behind an opaque pointer.
pub(super) trait Handle: Sized {
    /// Its name in the header.
    const NAME: &'static str;
}

/// Address and kind of every live handle.
static LIVE: Mutex<BTreeMap<usize, &'static str>> = Mutex::new(BTreeMap::new());

fn live() -> MutexGuard<'static, BTreeMap<usize, &'static str>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Gives `value` to the host.
pub(super) fn lend<T: Handle>(value: T) -> *mut T {
    let pointer = Box::into_raw(Box::new(value));
    live().insert(pointer as usize, T::NAME);
    pointer
}

/// Checks that `pointer` is a live handle of type `T`.
///
/// # Errors
/// [`Error::Argument`] for NULL, for a pointer that is no handle (any more), and for a handle of another kind.
pub(super) fn check<T: Handle>(pointer: *const T) -> Result<(), Error> {
    let found = if pointer.is_null() { Some("NULL") } else { live().get(&(pointer as usize)).copied() };
    match found {
        Some(name) if name == T::NAME => Ok(()),
        found => {
            let value = found.unwrap_or("no live handle").to_owned();
            Err(Error::Argument { name: T::NAME, value, expected: "a handle that was made and not yet freed" })
        }
    }
}

/// The value behind a handle, for reading.
///
/// # Safety
/// The host keeps the promise of one thread at a time, and does not free the handle before the call returns.
///
/// # Errors
/// As [`check`].
pub(super) unsafe fn get<'a, T: Handle>(pointer: *const T) -> Result<&'a T, Error> {
    check(pointer)?;
    // SAFETY: the table says that `lend` made this pointer for a `T` and that nobody freed it.
    Ok(unsafe { &*pointer })
}

/// The value behind a handle, for writing.
///
/// # Safety
/// As [`get`], and no other reference to the value is in use.
///
/// # Errors
/// As [`check`].
pub(super) unsafe fn get_mut<'a, T: Handle>(pointer: *mut T) -> Result<&'a mut T, Error> {
    check(pointer)?;
    // SAFETY: as in `get`.
    Ok(unsafe { &mut *pointer })
}

/// Takes a handle back and drops its value; NULL is fine, and so is what is no live handle of this kind.
pub(super) fn free<T: Handle>(pointer: *mut T) {
    {
        let mut live = live();
        if live.get(&(pointer as usize)) != Some(&T::NAME) {
            return;
        }
        live.remove(&(pointer as usize));
    }
    // SAFETY: `lend` made this pointer from a box of a `T`, and the table gave it up just now, once.
    drop(unsafe { Box::from_raw(pointer) });
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Apple(#[allow(dead_code)] u64);
    struct Pear(#[allow(dead_code)] u64);
    impl Handle for Apple {
        const NAME: &'static str = "Apple";
    }
    impl Handle for Pear {
        const NAME: &'static str = "Pear";
    }

    #[test]
    fn null_stray_foreign_and_freed_handles_are_told_apart_from_live_ones() {
        let handle = lend(Apple(1));
        assert!(check(handle).is_ok());
        assert!(check(handle.cast::<Pear>()).unwrap_err().to_string().contains("Apple"));
        assert!(check(std::ptr::null::<Apple>()).is_err());
        assert!(check(16 as *const Apple).is_err());
        free(handle.cast::<Pear>());
        assert!(check(handle).is_ok());
        free(handle);
        assert!(check(handle).is_err());
        free(handle);
    }
}
