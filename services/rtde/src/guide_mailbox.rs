//! Passes requests to guide the arm to the loop, and its answers back, one at a time and without a
//! lock.

use std::time::{Duration, Instant};

use crate::bridge::{Bridge, GuideRefusal};
use crate::guiding::GuideEnd;

use tangent_runtime::ring::Ring;

/// Time for which the loop's answer is waited for: several cycles of the slowest robot.
const ANSWER: Duration = Duration::from_millis(300);
/// Interval at which the answer is looked for.
const LOOK: Duration = Duration::from_millis(2);

/// A request of a client that guides the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Guide {
    Begin,
    Keep,
    End,
    /// Whether the arm is guided; without effect.
    Look,
}

/// What became of it.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Outcome {
    Done,
    Refused(GuideRefusal),
    /// There is nothing to keep: guiding has ended.
    Ended(GuideEnd),
}

/// Requests to the loop and its answers, one at a time, without a lock.
#[derive(Debug)]
pub(crate) struct GuideMailbox {
    requests: Ring<Guide>,
    answers: Ring<Outcome>,
}

impl Default for GuideMailbox {
    fn default() -> Self {
        Self {
            requests: Ring::new(1),
            answers: Ring::new(1),
        }
    }
}

impl GuideMailbox {
    /// Answers a request that waits, if any. Called by the loop in each cycle.
    pub fn serve(&self, bridge: &mut Bridge, now_s: f64) {
        let Some(request) = self.requests.pop() else {
            return;
        };
        let outcome = match request {
            Guide::Keep | Guide::Look if !bridge.guiding().is_asked() => {
                Outcome::Ended(bridge.guiding().ended())
            }
            Guide::Look => Outcome::Done,
            Guide::Begin | Guide::Keep => match bridge.guide(now_s) {
                Ok(()) => Outcome::Done,
                Err(refusal) => Outcome::Refused(refusal),
            },
            Guide::End => {
                bridge.end_guiding();
                Outcome::Done
            }
        };
        self.answers.force_push(outcome, drop);
    }

    /// Passes a request to the loop; `None`: the loop did not take it, as no packets arrive.
    pub fn ask(&self, request: Guide) -> Option<Outcome> {
        let _ = self.answers.pop();
        self.requests.force_push(request, drop);
        let until = Instant::now() + ANSWER;
        loop {
            if let Some(outcome) = self.answers.pop() {
                return Some(outcome);
            }
            let late = Instant::now().saturating_duration_since(until);
            if late > ANSWER || (!late.is_zero() && self.requests.pop().is_some()) {
                return None;
            }
            std::thread::sleep(LOOK);
        }
    }
}
