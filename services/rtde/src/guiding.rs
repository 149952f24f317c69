//! Hand guiding: for how long the arm stays free.
//!
//! The bridge asks it in each cycle. The arm is free only while the client that asked for it says
//! so again in time: a client that ends or is cut off leaves an arm that holds itself.

/// Longest time between two requests of the client that guides, s.
pub const KEEP_ALIVE_S: f64 = 2.0;

/// Why guiding ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GuideEnd {
    /// It was ended on request, by a stop or by the service's end; or it never began.
    #[default]
    Asked,
    /// The client that asked for it fell silent.
    Silent,
    /// The robot stopped, was not to be moved any more, or the connection was lost.
    Fault,
}

impl GuideEnd {
    /// The reason in words.
    pub fn text(self) -> &'static str {
        match self {
            Self::Asked => "it was ended on request",
            Self::Silent => "the program that asked for it fell silent",
            Self::Fault => "the robot or its connection had a fault",
        }
    }
}

/// Whether the arm is to be free.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guiding {
    until_s: Option<f64>,
    ended: GuideEnd,
}

impl Guiding {
    /// Makes the arm free for [`KEEP_ALIVE_S`] from `now_s`.
    pub fn ask(&mut self, now_s: f64) {
        self.until_s = Some(now_s + KEEP_ALIVE_S);
    }

    /// Ends it; no effect if it has ended.
    pub fn end(&mut self, why: GuideEnd) {
        if self.until_s.take().is_some() {
            self.ended = why;
        }
    }

    /// Whether the arm is to be free at `now_s`.
    pub fn step(&mut self, now_s: f64) -> bool {
        if self.until_s.is_some_and(|until_s| now_s > until_s) {
            self.end(GuideEnd::Silent);
        }
        self.is_asked()
    }

    /// Whether the arm was to be free at the last step, or a request came since.
    pub fn is_asked(&self) -> bool {
        self.until_s.is_some()
    }

    /// Why it ended last.
    pub fn ended(&self) -> GuideEnd {
        self.ended
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arm_is_free_only_while_somebody_asks_for_it() {
        let mut guiding = Guiding::default();
        assert!(!guiding.step(0.0));
        guiding.ask(1.0);
        assert!(guiding.step(1.0 + KEEP_ALIVE_S));
        guiding.ask(1.0 + KEEP_ALIVE_S);
        assert!(guiding.step(1.1 + KEEP_ALIVE_S));
        assert!(!guiding.step(1.1 + 2.0 * KEEP_ALIVE_S));
        assert_eq!(guiding.ended(), GuideEnd::Silent);
        // A fault after that does not change why it ended.
        guiding.end(GuideEnd::Fault);
        assert_eq!(guiding.ended(), GuideEnd::Silent);
        guiding.ask(10.0);
        guiding.end(GuideEnd::Fault);
        assert!(!guiding.step(10.0));
        assert_eq!(guiding.ended(), GuideEnd::Fault);
    }
}
