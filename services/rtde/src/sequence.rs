//! Sequence numbers of the packages to the robot, and the time until the robot uses one.

/// Value at which sequence numbers wrap.
const SEQUENCE_MAX: i32 = 1 << 30;
/// Number of sent sequence numbers whose time is stored.
const REMEMBERED: usize = 256;

/// Sequence numbers, and when each was sent.
#[derive(Debug)]
pub(crate) struct Sequence {
    newest: i32,
    sent: [(i32, f64); REMEMBERED],
    latency_s: f64,
    latency_is_new: bool,
}

impl Default for Sequence {
    fn default() -> Self {
        Self {
            newest: 0,
            sent: [(0, 0.0); REMEMBERED],
            latency_s: 0.0,
            latency_is_new: false,
        }
    }
}

impl Sequence {
    /// The number of a package that is sent at `now_s`.
    pub fn next(&mut self, now_s: f64) -> i32 {
        self.newest = (self.newest + 1) % SEQUENCE_MAX;
        self.sent[self.newest as usize % REMEMBERED] = (self.newest, now_s);
        self.newest
    }

    /// Takes the number that the robot uses, `used`. `is_news`: it differs from the one before, and
    /// the bridge's program has reported it. Numbers that were not sent do not count.
    pub fn take(&mut self, used: i32, is_news: bool, now_s: f64) {
        self.latency_is_new = false;
        if used <= 0 || !is_news {
            return;
        }
        let (sequence, sent_s) = self.sent[used as usize % REMEMBERED];
        if sequence == used {
            self.latency_s = now_s - sent_s;
            self.latency_is_new = true;
        }
    }

    /// Time from sending a number until the robot reports it in use, s; of the newest one in use.
    pub fn latency_s(&self) -> f64 {
        self.latency_s
    }

    /// Whether the last number taken has given a latency.
    pub fn latency_is_new(&self) -> bool {
        self.latency_is_new
    }
}
