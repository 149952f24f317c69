//! How long a request may wait before it is carried out: travels with each query, judged by the
//! service that gets it.
//!
//! The asker waits longer than the budget, so that an answer of any kind still reaches it.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};

use super::attachment::{Attachment, LENGTH};

/// Budget of a request that names none, as from a client of another make.
pub const BUDGET_UNNAMED: Duration = Duration::from_secs(4);
/// Part of the asker's patience that is kept for the answer's way back.
const RESERVE_SHARE: f64 = 0.2;
const RESERVE_MAX: Duration = Duration::from_secs(1);
/// i64 budget in ns, u64 clock, i64 time on that clock in ns; little-endian, behind rmw_zenoh's
/// attachment.
const BUDGET_LENGTH: usize = LENGTH + 24;

/// What an asker says about its own time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// The request may be carried out so long after it was sent.
    pub budget: Duration,
    /// Names the clock of `sent_ns`: two processes with the same one read the same time. 0 where
    /// there is none.
    clock: u64,
    sent_ns: i64,
}

impl Budget {
    /// For an asker that waits for `patience`, from now.
    pub fn within(patience: Duration) -> Self {
        let reserve = patience.mul_f64(RESERVE_SHARE).min(RESERVE_MAX);
        Self {
            budget: patience - reserve,
            clock: clock_name(),
            sent_ns: monotonic_ns(),
        }
    }

    /// As a query carries it.
    pub fn to_bytes(self, attachment: Attachment) -> [u8; BUDGET_LENGTH] {
        let mut bytes = [0; BUDGET_LENGTH];
        let nanoseconds = i64::try_from(self.budget.as_nanos()).unwrap_or(i64::MAX);
        bytes[..LENGTH].copy_from_slice(&attachment.to_bytes());
        bytes[LENGTH..LENGTH + 8].copy_from_slice(&nanoseconds.to_le_bytes());
        bytes[LENGTH + 8..LENGTH + 16].copy_from_slice(&self.clock.to_le_bytes());
        bytes[LENGTH + 16..].copy_from_slice(&self.sent_ns.to_le_bytes());
        bytes
    }

    /// From a query's attachment; `None` when it names no budget.
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

    /// Until when the request may be carried out, on the receiver's clock. The way here counts
    /// where both read the same clock; elsewhere the budget runs from the receipt.
    pub fn deadline(&self, received: Instant) -> Instant {
        let under_way_ns = if self.clock != 0 && self.clock == clock_name() {
            // This order: time between the two readings shortens what is left, and never adds to
            // the budget.
            let since = received.elapsed();
            monotonic_ns()
                .saturating_sub(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
                .saturating_sub(self.sent_ns)
        } else {
            0
        };
        let under_way = Duration::from_nanos(u64::try_from(under_way_ns).unwrap_or(0));
        let left = self.budget.saturating_sub(under_way);
        // A budget of centuries is as good as none.
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

/// Names the monotonic clock of this boot and time namespace; 0 where the system does not say.
fn clock_name() -> u64 {
    static NAME: OnceLock<u64> = OnceLock::new();
    *NAME.get_or_init(|| {
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id");
        let space = std::fs::read_link("/proc/self/ns/time");
        match (boot, space) {
            (Ok(boot), Ok(space)) => {
                // Fixed keys: the same in every process of one build, and of another build of the
                // same toolchain.
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
        // Another host's clock says nothing here, nor does one from the future.
        budget.clock ^= 1;
        assert_eq!(budget.deadline(received), received + Duration::from_secs(4));
        let mut ahead = Budget::within(Duration::from_secs(5));
        ahead.sent_ns = i64::MAX;
        assert_eq!(ahead.deadline(received), received + Duration::from_secs(4));
    }
}
