//! The order of shortest-path searches.

use std::cmp::Ordering;

/// A vertex or triangle to be visited: in a [`std::collections::BinaryHeap`] the nearest comes first, then the lowest index.
pub(super) struct Visit {
    pub distance: f64,
    pub index: u32,
}

impl PartialEq for Visit {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Visit {}

impl PartialOrd for Visit {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Visit {
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance).then(other.index.cmp(&self.index))
    }
}
