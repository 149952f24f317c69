//! Faults of the stream of RTDE packages that last for several cycles.

use std::time::Instant;

use crate::rtde_server::StreamFaults;

/// Injected faults of the stream, with the state of the burst of losses.
#[derive(Debug, Default)]
pub(super) struct Disturbance {
    pub(super) probability: f64,
    pub(super) burst: u32,
    burst_left: u32,
    pub(super) delay_s: f64,
    pub(super) frozen_until: Option<Instant>,
    /// State of the generator that decides on losses.
    random: u64,
}

impl Disturbance {
    pub(super) fn of_cycle(&mut self, now: Instant) -> StreamFaults {
        if self.burst_left > 0 {
            self.burst_left -= 1;
        } else if self.probability > 0.0 && self.draw() < self.probability {
            self.burst_left = self.burst;
        }
        StreamFaults {
            delay_s: self.delay_s,
            frozen: self.frozen_until.is_some_and(|until| now < until),
            skip: self.burst_left > 0,
        }
    }

    /// Uniform in 0 to 1: splitmix64.
    fn draw(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}
