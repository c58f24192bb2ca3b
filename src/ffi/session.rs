//! Sessions: loaded networks, threads, progress, cancel.

use super::guard::guard;
use super::handle::{Handle, check, free, get, lend};
use super::options::{Sized32, read, write};
use super::{S2pqStatus, choice, flag, lent_text, output, text};
use crate::error::Error;
use crate::infer::BackendChoice;
use crate::pipeline::{MAX_THREADS, Session, SessionOptions, SharedSession};
use std::ffi::{CString, c_char, c_void};
use std::sync::MutexGuard;

/// Which backend runs the networks; passed as uint32_t.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum S2pqBackend {
    /// ONNX Runtime if a usable one is found, else the embedded engine.
    Auto = 0,
    /// ONNX Runtime, or an error.
    Ort = 1,
    /// The engine inside the library.
    Embedded = 2,
}

/// How a session is made. Fill it by s2pq_session_options_init, then change what you need.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct S2pqSessionOptions {
    /// sizeof(S2pqSessionOptions)
    pub struct_size: u32,
    /// An S2pqBackend. Default: S2PQ_BACKEND_AUTO.
    pub backend: u32,
    /// Threads for the stages; 0: as many as the machine has cores, the default. At most 256.
    pub threads: u32,
    /// 1 for a sketch that is drawn while the host looks on, else 0, the default. Then sketch_to_surface begins with the last surface where
    /// the outline, its corners and contours moved by eight pixels of 256 at most, and a newer sketch_to_surface stops the session's
    /// older call. The price: a surface depends on what was drawn before, within what the strokes leave open; with 0 the same sketch gives
    /// the same bytes.
    pub live: u32,
    /// File or folder of the ONNX Runtime, UTF-8, absolute; NULL: search for one. Lent for the call.
    pub runtime_path: *const c_char,
    /// Folder with manifest.json and models to use instead of the built-in ones, UTF-8; NULL: the built-in ones. Lent
    /// for the call.
    pub models_folder: *const c_char,
}

// SAFETY: repr(C), size first, four u32 then two pointers: no padding, and any bits are valid raw pointers.
unsafe impl Sized32 for S2pqSessionOptions {
    const NAME: &'static str = "S2pqSessionOptions";
    const DEFAULT: Self = Self {
        struct_size: 0,
        backend: 0,
        threads: 0,
        live: 0,
        runtime_path: std::ptr::null(),
        models_folder: std::ptr::null(),
    };
}

/// Called on the thread that called the stage, at least some times a second, with the stage's name (UTF-8, valid during
/// the callback) and the fraction of that stage that is done, in [0, 1].
///
/// Must not throw, long-jump or call anything of this session but s2pq_cancel.
pub type S2pqProgress = Option<unsafe extern "C" fn(user: *mut c_void, stage: *const c_char, fraction: f64)>;

/// Loaded networks, threads, progress and cancel. Cheap to keep; made by s2pq_session_new.
///
/// One call at a time: a call that finds the session at work on another thread answers S2PQ_STATUS_INVALID_ARGUMENT at
/// once. Only s2pq_cancel and s2pq_cancel_reset may be called from any thread at any time, and on a live session
/// sketch_to_surface: there the older call soon answers S2PQ_STATUS_CANCELLED, as do those that wait when yet a newer one comes, and the
/// newest waits for the session and runs. A handle that the older call reads or writes must not be freed or changed before it has
/// answered: give each call a sketch of its own.
pub struct S2pqSession {
    session: SharedSession,
    backend: CString,
}

impl Handle for S2pqSession {
    const NAME: &'static str = "S2pqSession";
}

impl S2pqSession {
    /// The session, unless another call is using it.
    pub(super) fn lock(&self) -> Result<MutexGuard<'_, Session>, Error> {
        self.session.get()
    }

    /// The session for a sketch that replaces those before it, see [`SharedSession::get_for_newest`].
    pub(super) fn lock_for_newest(&self) -> Result<MutexGuard<'_, Session>, Error> {
        self.session.get_for_newest()
    }
}

/// A host's callback with its user pointer.
struct Callback {
    function: unsafe extern "C" fn(*mut c_void, *const c_char, f64),
    user: *mut c_void,
}

// SAFETY: the pointer is only handed back to the host, on a thread on which the host called.
unsafe impl Send for Callback {}

impl Callback {
    fn call(&self, stage: &str, fraction: f64) {
        let stage = lent_text(stage.to_owned());
        // SAFETY: the host vouches for its callback and user pointer until it sets another.
        unsafe { (self.function)(self.user, stage.as_ptr(), fraction) }
    }
}

/// Gives every option its default.
///
/// - `options`: takes the defaults.
/// - `size`: sizeof(S2pqSessionOptions) as the host compiled it.
///
/// # Safety
/// `options` is valid for writing `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_session_options_init(options: *mut S2pqSessionOptions, size: usize) -> S2pqStatus {
    // SAFETY: the host's promise.
    guard(|| unsafe { write(options, size, &S2pqSessionOptions::DEFAULT) })
}

/// Loads the networks and starts the threads. Takes some tens of milliseconds.
///
/// - `options`: NULL for the defaults.
/// - `session`: takes the new session.
/// - S2PQ_STATUS_UNAVAILABLE: the requested backend or a model cannot be used; the message says why.
///
/// # Safety
/// `options` is NULL or valid as its `struct_size` says; `session` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_session_new(
    options: *const S2pqSessionOptions,
    session: *mut *mut S2pqSession,
) -> S2pqStatus {
    guard(|| {
        let place = output("session", session)?;
        // SAFETY: the host's promise.
        let options = unsafe { read(options) }?;
        // SAFETY: the host's promise.
        let (runtime, models) =
            unsafe { (text("runtime_path", options.runtime_path)?, text("models_folder", options.models_folder)?) };
        if options.threads as usize > MAX_THREADS {
            let value = options.threads.to_string();
            return Err(Error::Argument { name: "threads", value, expected: "at most 256" });
        }
        let options = SessionOptions {
            backend: choice("backend", options.backend, &BackendChoice::ALL, "an S2pqBackend")?,
            runtime_path: runtime.map(Into::into),
            models_folder: models.map(Into::into),
            threads: options.threads as usize,
            live: flag("live", options.live)?,
        };
        let session = Session::new(&options)?;
        let backend = lent_text(session.backend().to_string());
        place.set(lend(S2pqSession { session: SharedSession::new(session), backend }));
        Ok(())
    })
}

/// Reports the progress of later calls to `callback`; NULL ends it.
///
/// - `user`: handed to the callback; must stay valid until another callback is set or the session is freed.
///
/// # Safety
/// `callback` may be called with `user`, on each thread that calls a stage.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_session_set_progress(
    session: *mut S2pqSession,
    callback: S2pqProgress,
    user: *mut c_void,
) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let mut session = unsafe { get(session) }?.lock()?;
        let callback = callback.map(|function| Callback { function, user });
        session.set_progress(
            callback
                .map(|callback| Box::new(move |stage: &str, fraction: f64| callback.call(stage, fraction)) as Box<_>),
        );
        Ok(())
    })
}

/// Which backend runs, for reports: name, version and path. Lent until the session is freed.
///
/// # Safety
/// `text` is valid for writing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_session_backend(session: *const S2pqSession, text: *mut *const c_char) -> S2pqStatus {
    guard(|| {
        // SAFETY: not freed during the call, as the header asks.
        let session = unsafe { get(session) }?;
        output("text", text)?.set(session.backend.as_ptr());
        Ok(())
    })
}

/// Stops the call that the session is at work on, from any thread: it soon answers S2PQ_STATUS_CANCELLED.
///
/// Every stage looks between its networks and in every outer iteration, some tens of milliseconds apart at most. If no
/// call is at work, the next one is stopped; s2pq_cancel_reset forgets such a cancel. Each call forgets the cancel when
/// it returns.
///
/// # Safety
/// The session is not freed during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_cancel(session: *const S2pqSession) -> S2pqStatus {
    guard(|| {
        check(session)?;
        // SAFETY: live, and not freed during the call, as the header asks; only the flag is touched.
        unsafe { &(*session).session }.control().cancel();
        Ok(())
    })
}

/// Forgets a cancel that came too late to stop a call; from any thread.
///
/// # Safety
/// The session is not freed during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_cancel_reset(session: *const S2pqSession) -> S2pqStatus {
    guard(|| {
        check(session)?;
        // SAFETY: as in `s2pq_cancel`.
        unsafe { &(*session).session }.control().reset();
        Ok(())
    })
}

/// Frees a session; NULL is fine. Surfaces, fields and meshes that it made stay alive.
///
/// # Safety
/// No call uses the session.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn s2pq_session_free(session: *mut S2pqSession) {
    free(session);
}
