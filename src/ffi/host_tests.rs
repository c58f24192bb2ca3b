//! What only tests of hosts call; not in the header, and exported only with the feature `host-tests`.

use super::S2pqStatus;
use super::guard::guard;

/// Panics inside, to test that a host survives a defect of the library.
#[unsafe(no_mangle)]
pub extern "C" fn s2pq_test_panic() -> S2pqStatus {
    guard(|| panic!("forced by a test"))
}
