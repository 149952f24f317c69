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
/// Largest budget that a request may state: one day, as `--wait-s` allows.
const BUDGET_MAX: Duration = Duration::from_secs(86_400);

/// Why the budget in a request's attachment is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the request's budget is {seconds} s; 0 to {} s are allowed", BUDGET_MAX.as_secs())]
pub struct BudgetError {
    /// Budget that the sender stated, s.
    seconds: f64,
}

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
            budget: (patience - reserve).min(BUDGET_MAX),
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
    ///
    /// # Errors
    /// The budget is negative or longer than a day.
    pub fn from_bytes(bytes: &[u8]) -> Result<Option<Self>, BudgetError> {
        let Some((budget_ns, clock, sent_ns)) = fields(bytes) else {
            return Ok(None);
        };
        let budget = u64::try_from(budget_ns)
            .map(Duration::from_nanos)
            .ok()
            .filter(|budget| *budget <= BUDGET_MAX)
            .ok_or(BudgetError {
                seconds: budget_ns as f64 * 1e-9,
            })?;
        Ok(Some(Self {
            budget,
            clock,
            sent_ns,
        }))
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
        received + left
    }
}

/// Budget, ns, id of the clock, and time of sending, ns, from a query's attachment; `None` if it
/// does not have the length of an attachment with a budget.
fn fields(bytes: &[u8]) -> Option<(i64, u64, i64)> {
    let bytes = <&[u8; BUDGET_LENGTH]>::try_from(bytes).ok()?;
    let (_, rest) = bytes.split_first_chunk::<LENGTH>()?;
    let (budget, rest) = rest.split_first_chunk::<8>()?;
    let (clock, sent) = rest.split_first_chunk::<8>()?;
    Some((
        i64::from_le_bytes(*budget),
        u64::from_le_bytes(*clock),
        i64::from_le_bytes(*sent.first_chunk::<8>()?),
    ))
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
    fn a_budget_is_read_back_and_another_length_is_none() {
        let budget = Budget::within(Duration::from_secs(5));
        assert_eq!(budget.budget, Duration::from_secs(4));
        let bytes = budget.to_bytes(Attachment::default());
        assert_eq!(Budget::from_bytes(&bytes), Ok(Some(budget)));
        assert_eq!(
            Attachment::from_bytes(&bytes[..LENGTH]),
            Some(Attachment::default())
        );
        for length in 0..bytes.len() {
            assert_eq!(Budget::from_bytes(&bytes[..length]), Ok(None));
        }
    }

    /// The bug: a budget out of range counted as one of 4 s.
    #[test]
    fn a_budget_out_of_range_is_refused() {
        let read = |budget_ns: i64| {
            let mut bytes = Budget::within(Duration::from_secs(5)).to_bytes(Attachment::default());
            bytes[LENGTH..LENGTH + 8].copy_from_slice(&budget_ns.to_le_bytes());
            Budget::from_bytes(&bytes)
        };
        let day_ns = 86_400_000_000_000;
        assert!(read(0).is_ok() && read(day_ns).is_ok());
        for bad in [i64::MIN, -1, day_ns + 1, i64::MAX] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert_eq!(
            read(2 * day_ns).unwrap_err().to_string(),
            "the request's budget is 172800 s; 0 to 86400 s are allowed"
        );
        let longest = Budget::within(Duration::MAX);
        assert!(Budget::from_bytes(&longest.to_bytes(Attachment::default())).is_ok());
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
