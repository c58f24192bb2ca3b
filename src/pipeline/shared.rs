//! A session that several threads call.

use super::session::{REPORTING, Session};
use crate::control::Control;
use crate::error::Error;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

/// A [`Session`] behind a lock, for hosts whose pen moves on one thread while another still works.
///
/// One call works at a time. A call that finds the session at work answers so at once; only a newer sketch on a live session
/// ([`super::SessionOptions::live`]) stops the older work, whatever it is, and waits for it to end.
pub struct SharedSession {
    session: Mutex<Session>,
    control: Control,
    live: bool,
    newest: Arc<AtomicU64>,
}

impl SharedSession {
    /// Takes a session.
    pub fn new(session: Session) -> Self {
        let (control, live, newest) = (session.control(), session.is_live(), Arc::clone(&session.newest));
        Self { session: Mutex::new(session), control, live, newest }
    }

    /// See [`Session::control`].
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// The session, for any call.
    ///
    /// # Errors
    /// [`Error::Argument`] if another call is using it.
    pub fn get(&self) -> Result<MutexGuard<'_, Session>, Error> {
        let mut session = match self.session.try_lock() {
            Ok(session) => session,
            // A panic left nothing half-done that a later call reads: results are moved out whole.
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => {
                let expected = "one call at a time, and none from within a progress callback";
                return Err(Error::Argument { name: "S2pqSession", value: "busy with another call".into(), expected });
            }
        };
        session.ticket = self.newest.load(Ordering::Relaxed);
        Ok(session)
    }

    /// The session, for [`super::sketch_to_surface`] with a sketch that replaces those before it.
    ///
    /// In a live session the call at work, if there is one, soon answers [`Error::Cancelled`], and this one waits for it; so does a
    /// call that still waits when yet a newer one comes. Else, and from within a progress callback, as [`Self::get`].
    ///
    /// # Errors
    /// [`Error::Cancelled`] if a newer call came meanwhile; [`Error::Argument`] as [`Self::get`].
    pub fn get_for_newest(&self) -> Result<MutexGuard<'_, Session>, Error> {
        if !self.live || REPORTING.get() {
            return self.get();
        }
        let ticket = self.newest.fetch_add(1, Ordering::Relaxed) + 1;
        let mut session = self.session.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if self.newest.load(Ordering::Relaxed) != ticket {
            return Err(Error::Cancelled);
        }
        session.ticket = ticket;
        Ok(session)
    }
}
