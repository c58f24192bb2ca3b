//! Sized structs: the host says how large its struct is, so that old hosts and new libraries understand each other.

use crate::error::Error;

/// Sizes above this are a mistake of the caller.
const MAX_SIZE: usize = 4096;

/// A struct of the ABI that begins with its own size.
///
/// # Safety
/// `repr(C)`, first field `struct_size: u32`, no padding, size a multiple of 8, and every bit pattern is a valid value.
pub(super) unsafe trait Sized32: Copy {
    /// Its name in the header.
    const NAME: &'static str;
    /// Its value when the host says nothing; `struct_size` is overwritten.
    const DEFAULT: Self;
}

fn check_size(name: &'static str, size: usize) -> Result<usize, Error> {
    if (8..=MAX_SIZE).contains(&size) && size.is_multiple_of(8) {
        Ok(size)
    } else {
        Err(Error::Argument { name, value: format!("{size} bytes large"), expected: "struct_size = sizeof the struct" })
    }
}

/// Reads what a host gives: defaults for a tail that it does not know, an error for a tail that we do not know unless
/// zero.
///
/// NULL means the defaults.
///
/// # Safety
/// `pointer` is NULL or valid for reading `struct_size` bytes.
///
/// # Errors
/// [`Error::Argument`] for an impossible size, and for a tail from a newer header that asks for something.
pub(super) unsafe fn read<T: Sized32>(pointer: *const T) -> Result<T, Error> {
    let mut value = T::DEFAULT;
    if pointer.is_null() {
        return Ok(value);
    }
    // SAFETY: every such struct begins with its size, and the caller vouches for the pointer.
    let size = check_size(T::NAME, unsafe { pointer.cast::<u32>().read_unaligned() } as usize)?;
    let known = size.min(size_of::<T>());
    let bytes = pointer.cast::<u8>();
    for i in known..size {
        // SAFETY: within the `size` bytes that the caller vouches for.
        if unsafe { bytes.add(i).read() } != 0 {
            let value = format!("{size} bytes large with byte {i} set");
            return Err(Error::Argument { name: T::NAME, value, expected: "zeros beyond what this version knows" });
        }
    }
    // SAFETY: both ranges hold `known` bytes, and every bit pattern is a valid `T`.
    unsafe { std::ptr::copy_nonoverlapping(bytes, (&raw mut value).cast::<u8>(), known) };
    Ok(value)
}

/// Writes `value` into a host's struct of `size` bytes: at most that many; zeros beyond what this version knows.
///
/// # Safety
/// `pointer` is NULL or valid for writing `size` bytes.
///
/// # Errors
/// [`Error::Argument`] for NULL and for an impossible size.
pub(super) unsafe fn write<T: Sized32>(pointer: *mut T, size: usize, value: &T) -> Result<(), Error> {
    if pointer.is_null() {
        return Err(Error::Argument { name: T::NAME, value: "NULL".into(), expected: "a struct to fill" });
    }
    let size = check_size(T::NAME, size)?;
    let known = size.min(size_of::<T>());
    let bytes = pointer.cast::<u8>();
    // SAFETY: the caller vouches for `size` bytes at `pointer`; `value` holds `known` bytes; a size fits u32.
    unsafe {
        std::ptr::copy_nonoverlapping((value as *const T).cast::<u8>(), bytes, known);
        bytes.add(known).write_bytes(0, size - known);
        bytes.cast::<u32>().write_unaligned(size as u32);
    }
    Ok(())
}

/// Fills a result struct whose first field the host has set to its size.
///
/// # Safety
/// `pointer` is NULL or valid for writing as many bytes as its first field says.
///
/// # Errors
/// As [`write`].
pub(super) unsafe fn fill<T: Sized32>(pointer: *mut T, value: &T) -> Result<(), Error> {
    // SAFETY: every such struct begins with its size, and the caller vouches for the pointer.
    let size = if pointer.is_null() { 0 } else { unsafe { pointer.cast::<u32>().read_unaligned() } };
    // SAFETY: the caller's promise.
    unsafe { write(pointer, size as usize, value) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Copy)]
    #[repr(C)]
    struct New {
        struct_size: u32,
        a: u32,
        b: f64,
    }
    // SAFETY: no padding, 16 bytes, plain numbers.
    unsafe impl Sized32 for New {
        const NAME: &'static str = "New";
        const DEFAULT: Self = Self { struct_size: 0, a: 1, b: 2.0 };
    }

    #[repr(C)]
    struct Newer {
        known: New,
        c: u64,
    }

    #[test]
    fn an_older_struct_gets_defaults_for_its_missing_tail() {
        let old: [u32; 2] = [8, 7];
        let value = unsafe { read(old.as_ptr().cast::<New>()) }.unwrap();
        assert_eq!((value.a, value.b), (7, 2.0));
    }

    #[test]
    fn a_newer_struct_is_taken_only_if_its_unknown_tail_is_zero() {
        let mut newer = Newer { known: New { struct_size: 24, a: 3, b: 4.0 }, c: 0 };
        let value = unsafe { read((&raw const newer).cast::<New>()) }.unwrap();
        assert_eq!((value.a, value.b), (3, 4.0));
        newer.c = 1;
        assert!(unsafe { read((&raw const newer).cast::<New>()) }.is_err());
    }

    #[test]
    fn writing_never_leaves_the_hosts_struct() {
        let mut bytes = [0xAAu64; 4];
        for (size, touched) in [(8usize, 1usize), (16, 2), (24, 3)] {
            bytes.fill(0xAAAA_AAAA_AAAA_AAAA);
            unsafe { write(bytes.as_mut_ptr().cast::<New>(), size, &New::DEFAULT) }.unwrap();
            assert_eq!(bytes[0] as u32 as usize, size);
            assert!(bytes[touched..].iter().all(|&b| b == 0xAAAA_AAAA_AAAA_AAAA));
            assert!(size < 24 || bytes[2] == 0);
        }
        for size in [0, 4, 12, 8192] {
            assert!(unsafe { write(bytes.as_mut_ptr().cast::<New>(), size, &New::DEFAULT) }.is_err());
        }
    }
}
