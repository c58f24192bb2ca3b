//! The one door between the C ABI and the library.

use super::status::S2pqStatus;
use crate::error::Error;
use std::any::Any;
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};

thread_local! {
    static LAST_MESSAGE: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Runs the body of an export: errors and panics become a status and this thread's last message; success clears it.
pub(super) fn guard(body: impl FnOnce() -> Result<(), Error>) -> S2pqStatus {
    let (status, message) = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => (S2pqStatus::Ok, String::new()),
        Ok(Err(error)) => (S2pqStatus::from(&error), error.to_string()),
        Err(panic) => (S2pqStatus::Internal, panic_text(panic.as_ref())),
    };
    LAST_MESSAGE.with_borrow_mut(|last| *last = message);
    status
}

/// What [`guard`] wrote last on this thread.
pub(super) fn last_message() -> String {
    LAST_MESSAGE.with_borrow(String::clone)
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("internal error, please report it: {}", text.unwrap_or("a panic without a text"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_panics_become_a_status_with_its_message_and_success_clears_it() {
        assert_eq!(guard(|| Err(Error::Cancelled)), S2pqStatus::Cancelled);
        assert_eq!(last_message(), "cancelled by the host");
        assert_eq!(guard(|| panic!("a {}", "test")), S2pqStatus::Internal);
        assert!(last_message().ends_with("report it: a test"));
        assert_eq!(guard(|| Ok(())), S2pqStatus::Ok);
        assert_eq!(last_message(), "");
    }
}
