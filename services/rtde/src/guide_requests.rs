//! Requests to guide the arm by hand, `rtde/guide`: begin, keep, end. The loop answers each in the
//! cycle in which it takes it, so that the outcome is known.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::{Asked, Bus, BusError, Handle, Lane};
use tangent_schemas::tangent::Answer;

use crate::bridge::{Bridge, GuideRefusal};
use crate::guiding::{GuideEnd, KEEP_ALIVE_S};
use crate::queries;
use crate::shared::Shared;

/// Time for which the loop's answer is waited for: several cycles of the slowest robot.
const ANSWER: Duration = Duration::from_millis(300);
/// Interval at which the answer is looked for.
const LOOK: Duration = Duration::from_millis(2);

/// A request of a client that guides the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Guide {
    Begin,
    Keep,
    End,
    /// Whether the arm is guided; without effect.
    Look,
}

/// What became of it.
#[derive(Clone, Copy, Debug)]
enum Outcome {
    Done,
    Refused(GuideRefusal),
    /// There is nothing to keep: guiding has ended.
    Ended(GuideEnd),
}

/// Requests to the loop and its answers, one at a time, without a lock.
#[derive(Debug)]
pub(crate) struct GuideMailbox {
    requests: ArrayQueue<Guide>,
    answers: ArrayQueue<Outcome>,
}

impl Default for GuideMailbox {
    fn default() -> Self {
        Self {
            requests: ArrayQueue::new(1),
            answers: ArrayQueue::new(1),
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
        self.answers.force_push(outcome);
    }

    /// Passes a request to the loop; `None`: the loop did not take it, as no packets arrive.
    fn ask(&self, request: Guide) -> Option<Outcome> {
        let _ = self.answers.pop();
        self.requests.force_push(request);
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

/// Starts to answer requests.
pub(crate) fn answers(bus: &Bus, shared: &Arc<Shared>) -> Result<Handle, BusError> {
    let shared = Arc::clone(shared);
    // Name of the client that guides; requests are answered one after another.
    let guide = Mutex::new(String::new());
    bus.answer_in(
        queries::GUIDE,
        |_| Lane::Slow,
        move |asked| {
            let mut guide = guide.lock().unwrap_or_else(PoisonError::into_inner);
            answer(&asked, &shared.guide, &mut guide).into()
        },
    )
}

fn answer(asked: &Asked, mailbox: &GuideMailbox, guide: &mut String) -> Answer {
    let name = asked.request.argument.as_str();
    if name.is_empty() || name.len() > 64 {
        return refused("name the client that guides the arm, in 1 to 64 bytes, as the argument");
    }
    let request = match asked.request.action.as_str() {
        "begin" => Guide::Begin,
        "keep" => Guide::Keep,
        "end" => Guide::End,
        other => return refused(format!("unknown action `{other}`: begin, keep or end")),
    };
    // Any client may end it. Only the one that began may keep it; another one waits for its end.
    if !guide.is_empty() && guide != name && request != Guide::End {
        match mailbox.ask(Guide::Look) {
            Some(Outcome::Done) => return refused(format!("{guide} guides the arm")),
            _ => guide.clear(),
        }
    }
    match mailbox.ask(request) {
        None => refused("no packet from the robot: is the bridge connected to it?"),
        Some(Outcome::Refused(refusal)) => refused(refusal.to_string()),
        Some(Outcome::Ended(why)) => {
            guide.clear();
            refused(format!("the arm is not guided any more: {}", why.text()))
        }
        Some(Outcome::Done) if request == Guide::End => {
            guide.clear();
            done("the arm holds itself")
        }
        Some(Outcome::Done) => {
            name.clone_into(guide);
            done(format!(
                "a hand can guide the arm; without `keep` it holds itself again after {KEEP_ALIVE_S} s"
            ))
        }
    }
}
