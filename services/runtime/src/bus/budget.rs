//! Time budget of a request: how long it may wait before it is carried out. It travels with each
//! query, and the receiving service enforces it.
//!
//! The sender waits longer than the budget, so that any answer still reaches it.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};

use super::attachment::{Attachment, LENGTH};

/// Budget of a request that states none, for instance from a third-party client.
pub const BUDGET_UNNAMED: Duration = Duration::from_secs(4);
/// Share of the sender's timeout that is reserved for the way back of the answer.
const RESERVE_SHARE: f64 = 0.2;
const RESERVE_MAX: Duration = Duration::from_secs(1);
/// Length of an attachment with a budget, bytes. rmw_zenoh's attachment is followed by an i64
/// budget in ns, a u64 clock id and an i64 time on that clock in ns; little-endian.
const BUDGET_LENGTH: usize = LENGTH + 24;

/// Time budget as the sender states it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Time after sending within which the request may be carried out.
    pub budget: Duration,
    /// Id of the clock of `sent_ns`: two processes with the same id read the same clock. 0 if there
    /// is none.
    clock: u64,
    sent_ns: i64,
}

impl Budget {
    /// Budget, starting now, for a sender that waits for `patience`.
    pub fn within(patience: Duration) -> Self {
        let reserve = patience.mul_f64(RESERVE_SHARE).min(RESERVE_MAX);
        Self {
            budget: patience - reserve,
            clock: clock_name(),
            sent_ns: monotonic_ns(),
        }
    }

    /// Encodes it as the attachment of a query.
    pub fn to_bytes(self, attachment: Attachment) -> [u8; BUDGET_LENGTH] {
        let mut bytes = [0; BUDGET_LENGTH];
        let nanoseconds = i64::try_from(self.budget.as_nanos()).unwrap_or(i64::MAX);
        bytes[..LENGTH].copy_from_slice(&attachment.to_bytes());
        bytes[LENGTH..LENGTH + 8].copy_from_slice(&nanoseconds.to_le_bytes());
        bytes[LENGTH + 8..LENGTH + 16].copy_from_slice(&self.clock.to_le_bytes());
        bytes[LENGTH + 16..].copy_from_slice(&self.sent_ns.to_le_bytes());
        bytes
    }

    /// Decodes it from a query's attachment; `None` if that states no budget.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let bytes = <&[u8; BUDGET_LENGTH]>::try_from(bytes).ok()?;
        let (_, rest) = bytes.split_first_chunk::<LENGTH>()?;
        let (budget, rest) = rest.split_first_chunk::<8>()?;
        let (clock, sent) = rest.split_first_chunk::<8>()?;
        Some(Self {
            budget: Duration::from_nanos(u64::try_from(i64::from_le_bytes(*budget)).ok()?),
            clock: u64::from_le_bytes(*clock),
            sent_ns: i64::from_le_bytes(*sent.first_chunk::<8>()?),
        })
    }

    /// Deadline for carrying out the request, on the receiver's clock. The transit time counts if
    /// both processes read the same clock; otherwise the budget runs from the receipt.
    pub fn deadline(&self, received: Instant) -> Instant {
        let under_way_ns = if self.clock != 0 && self.clock == clock_name() {
            // The order matters: time between the two readings then shortens the remaining budget,
            // and never extends it.
            let since = received.elapsed();
            monotonic_ns()
                .saturating_sub(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
                .saturating_sub(self.sent_ns)
        } else {
            0
        };
        let under_way = Duration::from_nanos(u64::try_from(under_way_ns).unwrap_or(0));
        let left = self.budget.saturating_sub(under_way);
        // A deadline beyond the range of the clock counts as if no budget was stated.
        received
            .checked_add(left)
            .unwrap_or(received + BUDGET_UNNAMED)
    }
}

fn monotonic_ns() -> i64 {
    clock_gettime(ClockId::CLOCK_MONOTONIC).map_or(0, |t| {
        t.tv_sec()
            .saturating_mul(1_000_000_000)
            .saturating_add(t.tv_nsec())
    })
}

/// Id of the monotonic clock of this boot and time namespace; 0 if the system does not provide it.
fn clock_name() -> u64 {
    static NAME: OnceLock<u64> = OnceLock::new();
    *NAME.get_or_init(|| {
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id");
        let space = std::fs::read_link("/proc/self/ns/time");
        match (boot, space) {
            (Ok(boot), Ok(space)) => {
                // The hasher has fixed keys, so that the result is the same in every process of
                // this build, and of other builds by the same toolchain.
                let mut hasher = DefaultHasher::new();
                boot.trim().hash(&mut hasher);
                space.hash(&mut hasher);
                hasher.finish().max(1)
            }
            _ => 0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_comes_through_and_anything_else_is_none() {
        let budget = Budget::within(Duration::from_secs(5));
        assert_eq!(budget.budget, Duration::from_secs(4));
        let bytes = budget.to_bytes(Attachment::default());
        assert_eq!(Budget::from_bytes(&bytes), Some(budget));
        assert_eq!(
            Attachment::from_bytes(&bytes[..LENGTH]),
            Some(Attachment::default())
        );
        for length in 0..bytes.len() {
            assert_eq!(Budget::from_bytes(&bytes[..length]), None);
        }
        let mut negative = bytes;
        negative[LENGTH + 7] = 0x80;
        assert_eq!(Budget::from_bytes(&negative), None);
    }

    #[test]
    fn the_way_here_counts_where_the_clock_is_the_same() {
        let mut budget = Budget::within(Duration::from_secs(5));
        budget.sent_ns -= 3_000_000_000;
        let received = Instant::now();
        let near = budget.deadline(received) - received;
        assert!(near <= Duration::from_secs(1), "{near:?}");
        budget.sent_ns -= 3_000_000_000;
        assert!(budget.deadline(received) <= received);
        // A time on another host's clock is ignored, and so is one in the future.
        budget.clock ^= 1;
        assert_eq!(budget.deadline(received), received + Duration::from_secs(4));
        let mut ahead = Budget::within(Duration::from_secs(5));
        ahead.sent_ns = i64::MAX;
        assert_eq!(ahead.deadline(received), received + Duration::from_secs(4));
    }
}
