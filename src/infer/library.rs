//! Loading a shared library that claims to be ONNX Runtime, and finding our own.
//!
//! This is foreign-function work by nature: a symbol looked up by name in a mapped file is called through a signature
//! that only a convention vouches for. It is therefore the one file outside `ffi` that may say `unsafe`; what it hands out
//! is plain data.
#![allow(unsafe_code)]

use ort::sys::{ORT_API_VERSION, OrtApiBase};
use std::ffi::CStr;
use std::path::{Path, PathBuf};

/// Smallest version 1.x of ONNX Runtime that offers the interface we were compiled against.
pub const MINIMUM_MINOR: u32 = ORT_API_VERSION;

/// Opens `path` and reads the version of ONNX Runtime in it, without telling `ort`.
///
/// `ort` keeps the first library it is given for the life of the process and panics if that library is too old, hence this
/// look beforehand. A library that passes stays mapped, so that `ort` gets the very same one; the others are closed again.
///
/// - `path`: absolute, so that the system's search path, with its outdated copies, has no say.
/// - returns the version string, such as `1.31.1`.
///
/// # Errors
/// Why the file is of no use, as a clause for a message.
pub fn probe(path: &Path) -> Result<String, String> {
    if !path.is_absolute() {
        return Err("the path is not absolute".into());
    }
    if !path.is_file() {
        return Err("no such file".into());
    }
    // SAFETY: runs the initializers of a library that the host, its environment or the system administrator put where
    // an ONNX Runtime belongs. Nothing can be checked before that.
    let library = unsafe { libloading::Library::new(path) }.map_err(|error| chain(&error))?;
    // SAFETY: the signature is that of `onnxruntime_c_api.h`, unchanged since version 1.0.
    let get_base = unsafe { library.get::<unsafe extern "C" fn() -> *const OrtApiBase>(c"OrtGetApiBase") }
        .map_err(|_| "it does not export OrtGetApiBase, so it is no ONNX Runtime")?;
    // SAFETY: as above; the result points to a static of the library, or is null.
    let base = unsafe { get_base().as_ref() }.ok_or("OrtGetApiBase returned null")?;
    // SAFETY: the function pointers of a valid base; the string is a static of the library.
    let version = unsafe {
        let text = (base.GetVersionString)();
        if text.is_null() {
            return Err("it tells no version".into());
        }
        CStr::from_ptr(text).to_str().map_err(|_| "its version is not text")?.to_owned()
    };
    // Asked for an interface it does not know, an old runtime writes to stderr: look at the version first.
    let usable = matches!(parse_version(&version), Some((1, minor)) if minor >= MINIMUM_MINOR);
    if !usable {
        return Err(format!("it is version {version}, need 1.{MINIMUM_MINOR} or later"));
    }
    // SAFETY: as above.
    if unsafe { (base.GetApi)(ORT_API_VERSION) }.is_null() {
        return Err(format!("version {version} refuses interface {ORT_API_VERSION}"));
    }
    std::mem::forget(library);
    Ok(version)
}

/// Major and minor number of `1.31.1` and the like.
fn parse_version(text: &str) -> Option<(u32, u32)> {
    let mut numbers = text.split(['.', '-', '+']).map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

/// An error with all its causes: libloading's own message says only that `dlopen` failed.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

/// The file that this code was loaded from: our shared library, or the program that we are linked into.
#[cfg(unix)]
pub fn own_path() -> Option<PathBuf> {
    use std::os::unix::ffi::OsStrExt;
    let mut info = std::mem::MaybeUninit::<libc::Dl_info>::zeroed();
    // SAFETY: the address is one of our functions; `info` is written, or left zero on failure.
    let found = unsafe { libc::dladdr((own_path as *const ()).cast(), info.as_mut_ptr()) };
    // SAFETY: all zero is a valid `Dl_info`.
    let info = unsafe { info.assume_init() };
    if found == 0 || info.dli_fname.is_null() {
        return std::env::current_exe().ok();
    }
    // SAFETY: a string of the loader, valid while our library is mapped.
    let name = Path::new(std::ffi::OsStr::from_bytes(unsafe { CStr::from_ptr(info.dli_fname) }.to_bytes()));
    // A program's name is what the shell passed, and may have been found through PATH.
    if name.is_absolute() || name.components().count() > 1 {
        name.canonicalize().ok().or_else(|| std::env::current_exe().ok())
    } else {
        std::env::current_exe().ok()
    }
}

/// The file that this code was loaded from: our DLL, or the program that we are linked into.
#[cfg(windows)]
pub fn own_path() -> Option<PathBuf> {
    use std::ffi::{OsString, c_void};
    use std::os::windows::ffi::OsStringExt;
    #[link(name = "kernel32")]
    unsafe extern "system" {
        fn GetModuleHandleExW(flags: u32, address: *const c_void, module: *mut *mut c_void) -> i32;
        fn GetModuleFileNameW(module: *mut c_void, name: *mut u16, capacity: u32) -> u32;
    }
    const FROM_ADDRESS: u32 = 0x4;
    const UNCHANGED_REFCOUNT: u32 = 0x2;
    let mut module = std::ptr::null_mut();
    let address = (own_path as *const ()).cast();
    // SAFETY: the address is one of our functions; `module` is written on success only.
    if unsafe { GetModuleHandleExW(FROM_ADDRESS | UNCHANGED_REFCOUNT, address, &mut module) } == 0 {
        return None;
    }
    let mut name = vec![0u16; 32_768]; // the longest path of Windows
    // SAFETY: the buffer has the capacity that is passed.
    let length = unsafe { GetModuleFileNameW(module, name.as_mut_ptr(), name.len() as u32) } as usize;
    (length > 0 && length < name.len()).then(|| PathBuf::from(OsString::from_wide(&name[..length])))
}

/// Elsewhere there is no way to ask.
#[cfg(not(any(unix, windows)))]
pub fn own_path() -> Option<PathBuf> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read() {
        assert_eq!(parse_version("1.31.1"), Some((1, 31)));
        assert_eq!(parse_version("1.17.0-rc1"), Some((1, 17)));
        assert_eq!(parse_version("two.three"), None);
        assert_eq!(parse_version(""), None);
    }

    #[test]
    fn our_own_file_is_the_test_program() {
        let exe = std::env::current_exe().unwrap().canonicalize().unwrap();
        assert_eq!(own_path().unwrap().canonicalize().unwrap(), exe);
    }

    #[test]
    fn what_is_no_runtime_is_refused_with_a_reason() {
        let folder = tempfile::tempdir().unwrap();
        let text = folder.path().join("libonnxruntime.so");
        std::fs::write(&text, "not a library").unwrap();
        for (path, reason) in [
            (text.as_path(), ""),
            (folder.path(), "no such file"),
            (Path::new("libonnxruntime.so"), "not absolute"),
            (&folder.path().join("absent.so"), "no such file"),
        ] {
            let error = probe(path).unwrap_err();
            assert!(error.contains(reason) && !error.is_empty(), "{error}");
        }
    }
}
