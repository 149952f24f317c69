//! Age of a message's content, on this host's monotonic clock.

use std::time::{Duration, Instant};

use tangent_schemas::tangent::ArmState;

/// Age of the content of one publisher's messages. The clocks of two hosts may differ, so the age
/// is measured relative to the smallest delay so far. A burst of old messages after a network
/// outage is therefore old although it has just arrived.
#[derive(Clone, Copy, Debug, Default)]
pub struct ContentAge {
    first: Option<First>,
}

#[derive(Clone, Copy, Debug)]
struct First {
    publisher: [u8; 16],
    stamp_ns: i64,
    arrived: Instant,
    /// Delay of the last message, and the minimum so far, s; both contain the offset between the
    /// clocks.
    last_s: f64,
    least_s: f64,
    /// Time since when every message has been late, s.
    late_since_s: Option<f64>,
}

/// Rate at which the minimum delay is forgotten, s/s: clocks drift by up to 100 ppm.
const DRIFT: f64 = 2e-4;

/// Delay beyond the minimum from which a message counts as late, s.
const LATE_S: f64 = 0.01;
/// Time for which messages must be late before the publisher's clock is assumed to have been set
/// back, s. Much longer than the time after which a task ends because of it.
const STEPPED_S: f64 = 2.0;

impl ContentAge {
    /// Processes a message's stamp (ns) and arrival. Returns its delay beyond the minimum, s.
    pub fn take(&mut self, publisher: [u8; 16], stamp_ns: i64, arrived: Instant) -> f64 {
        let first = match &mut self.first {
            Some(first) if first.publisher == publisher => first,
            _ => {
                self.first = Some(First {
                    publisher,
                    stamp_ns,
                    arrived,
                    last_s: 0.0,
                    least_s: 0.0,
                    late_since_s: None,
                });
                return 0.0;
            }
        };
        let since_s = arrived
            .saturating_duration_since(first.arrived)
            .as_secs_f64();
        let said_s = stamp_ns.saturating_sub(first.stamp_ns) as f64 * 1e-9;
        let drift = (since_s - first.last_s).max(0.0) * DRIFT;
        first.last_s = since_s;
        first.least_s = (first.least_s + drift).min(since_s - said_s);
        let late_s = since_s - said_s - first.least_s;
        if late_s < LATE_S {
            first.late_since_s = None;
        } else if since_s - *first.late_since_s.get_or_insert(since_s) > STEPPED_S {
            // Late for this long with a steady delay: the clock was set back.
            first.least_s = since_s - said_s;
            first.late_since_s = None;
            return 0.0;
        }
        late_s
    }
}

/// Age of data derived from the arm's state, from the measurement to its use, s. It is the number
/// of the robot's packets since the one used, plus the time since the newest arrived, on this
/// host's monotonic clock. No two clocks need to agree, and a burst of old messages is old. If a
/// publisher continues with a constant stamp, the age is that of the stamp. Estimates have no other
/// age: the law uses it, `ControlState` publishes it, and every display shows the published value.
#[derive(Clone, Copy, Debug, Default)]
pub struct CycleAge {
    /// Publisher and stamp of the newest message, and the robot's cycle in which they first
    /// arrived.
    advanced: Option<([u8; 16], i64, u64)>,
}

impl CycleAge {
    /// Age, s, of a message `said` by a publisher with a stamp (ns), based on `cycle` and received
    /// `ago`; `arm` is the robot's newest packet, which arrived `since_packet` ago.
    pub fn of(
        &mut self,
        said: ([u8; 16], i64),
        cycle: u64,
        ago: Duration,
        arm: &ArmState,
        since_packet: Duration,
    ) -> f64 {
        if cycle > arm.cycle {
            // From an earlier run of the bridge, whose count was higher.
            return f64::INFINITY;
        }
        let since = match self.advanced {
            Some((publisher, stamp_ns, cycle)) if (publisher, stamp_ns) == said => cycle,
            _ => arm.cycle,
        };
        self.advanced = Some((said.0, said.1, since));
        let behind = arm.cycle - cycle;
        let standing = arm.cycle.saturating_sub(since);
        let age_s = behind.max(standing) as f64 * arm.period_s + since_packet.as_secs_f64();
        age_s.max(ago.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const STAMP: i64 = 1_800_000_000_000_000_000;

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    #[test]
    fn an_estimate_is_as_old_as_the_packet_that_it_rests_on() {
        let mut age = CycleAge::default();
        let arm = ArmState {
            cycle: 100,
            period_s: 0.008,
            ..ArmState::default()
        };
        let us = Duration::from_micros;
        // Based on the previous packet, received 5 ms ago, used 0.3 ms after the newest packet
        // arrived.
        let one = age.of(([1; 16], STAMP), 99, us(5000), &arm, us(300));
        assert!((one - 0.0083).abs() < 1e-12, "{one}");
        // Based on the newest packet, from an estimator in the loop's own process.
        let own = age.of(([1; 16], STAMP + 1), 100, us(100), &arm, us(300));
        assert!((own - 0.0003).abs() < 1e-12, "{own}");
        // The robot stops sending: the age still grows.
        let late = age.of(([1; 16], STAMP + 1), 100, us(60_000), &arm, us(60_200));
        assert!((late - 0.0602).abs() < 1e-12, "{late}");
        assert_eq!(
            age.of(([1; 16], STAMP + 2), 101, us(0), &arm, us(0)),
            f64::INFINITY
        );
    }

    #[test]
    fn a_burst_after_a_cut_is_old() {
        let mut age = ContentAge::default();
        let begin = Instant::now();
        for i in 0..100u64 {
            let late = age.take([1; 16], STAMP + 8_000_000 * i as i64, begin + ms(8 * i));
            assert!(late < 1e-3, "{late}");
        }
        // Two seconds without messages; then the delayed messages arrive at once.
        let arrival = begin + ms(800 + 2000);
        for i in 100..350u64 {
            let late = age.take([1; 16], STAMP + 8_000_000 * i as i64, arrival);
            let truth = 2.8 - 0.008 * i as f64;
            assert!((late - truth).abs() < 2e-3, "{i}: {late} {truth}");
        }
    }

    #[test]
    fn a_clock_set_back_counts_as_late_for_a_while_only() {
        let mut age = ContentAge::default();
        let begin = Instant::now();
        let mut late = Vec::new();
        for i in 0..500u64 {
            let back = if i < 100 { 0 } else { 1_000_000_000 };
            late.push(age.take(
                [1; 16],
                STAMP + 8_000_000 * i as i64 - back,
                begin + ms(8 * i),
            ));
        }
        assert!(late[100] > 0.9 && late[300] > 0.9 && late[499] < 1e-3);
    }

    #[test]
    fn clocks_need_not_agree_and_a_new_publisher_starts_anew() {
        let mut age = ContentAge::default();
        let begin = Instant::now();
        assert_eq!(age.take([1; 16], -5, begin), 0.0);
        assert_eq!(age.take([2; 16], STAMP, begin + ms(8)), 0.0);
        assert!(age.take([2; 16], STAMP + 1_000_000, begin + ms(16)) > 6e-3);
    }
}
