//! Offset of another process's clock from this one's, measured by queries on
//! `ping/SERVICE/INSTANCE`.
//!
//! Every service answers these queries; `tangent status` sends them. The control loop does not
//! depend on the result: a reader judges ages by its own clock and by the robot's packets. The
//! offset explains to a person why the stamps of two hosts do not match.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::queries;

use crate::bus::answer::done_with;
use crate::bus::{Bus, BusError, Handle};
use crate::clock;

/// Number of queries per measurement. The one with the shortest round trip is used, as it waited
/// least on the way.
const QUESTIONS: usize = 8;

/// Data of the answer.
#[derive(Serialize, Deserialize)]
struct Now {
    now_ns: i64,
}

/// Offset of another clock from this one's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockOffset {
    /// The other clock minus this one, s.
    pub offset_s: f64,
    /// Round trip of the query, s. The offset may be wrong by half of it, if one direction took all
    /// of the time.
    pub round_trip_s: f64,
}

/// Answers queries for this host's time until the handle is dropped.
///
/// # Errors
/// The name is not valid in a key.
pub fn answer(bus: &Bus, service: &str, instance: &str) -> Result<Handle, BusError> {
    bus.answer(&queries::ping(service, instance), |_, _| {
        done_with(
            "here",
            &Now {
                now_ns: clock::now_ns(),
            },
        )
    })
}

/// Queries one instance's time repeatedly; `None` if it does not answer within `timeout`.
pub fn measure(bus: &Bus, service: &str, instance: &str, timeout: Duration) -> Option<ClockOffset> {
    let key = queries::ping(service, instance);
    let request = Request {
        action: "ping".to_owned(),
        argument: String::new(),
    };
    let until = Instant::now() + timeout;
    let mut best: Option<ClockOffset> = None;
    for _ in 0..QUESTIONS {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        let (asked, asked_ns) = (Instant::now(), clock::now_ns());
        let Ok(answer) = bus.ask(&key, &request, left) else {
            break;
        };
        let round_trip = asked.elapsed();
        let Ok(there) = serde_json::from_str::<Now>(&answer.data) else {
            break;
        };
        let one = offset(asked_ns, round_trip, there.now_ns);
        if best.is_none_or(|best| one.round_trip_s < best.round_trip_s) {
            best = Some(one);
        }
    }
    best
}

/// Assumes that the other clock was read halfway through the round trip (RFC 5905, clause 8, with
/// one reading by the other host).
fn offset(asked_ns: i64, round_trip: Duration, there_ns: i64) -> ClockOffset {
    let round_trip_s = round_trip.as_secs_f64();
    ClockOffset {
        offset_s: there_ns.saturating_sub(asked_ns) as f64 * 1e-9 - 0.5 * round_trip_s,
        round_trip_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_the_way_is_taken_off() {
        let there = 1_800_000_000_250_000_000;
        let found = offset(1_800_000_000_000_000_000, Duration::from_millis(40), there);
        assert!((found.offset_s - 0.23).abs() < 1e-9);
        assert_eq!(found.round_trip_s, 0.04);
    }

    #[test]
    fn our_own_clock_is_where_we_are() {
        let bus = Bus::in_process("test");
        let _answering = answer(&bus, "netft", "here-1").unwrap();
        let found = measure(&bus, "netft", "here-1", Duration::from_secs(10)).unwrap();
        assert!(
            found.offset_s.abs() <= 0.5 * found.round_trip_s + 1e-6,
            "{found:?}"
        );
        assert_eq!(
            measure(&bus, "netft", "here-2", Duration::from_millis(50)),
            None
        );
    }
}
