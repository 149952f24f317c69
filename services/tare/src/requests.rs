//! Link between the tare query, answered in threads of the bus, and the service's loop, which
//! averages.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tangent_mechanics::Sensor;
use tangent_runtime::Asked;
use tangent_runtime::bus::answer::{done, done_with, refused};
use tangent_runtime::ring::Ring;
use tangent_runtime::ticket::{Order, Ticket};
use tangent_schemas::tangent::{Answer, Request};
use tangent_sensing::{Tare, TareGround, TareRefusal};

use crate::TareSetup;
use crate::memory::Memory;

/// Time beyond the average itself that an answer may take.
const SLACK: Duration = Duration::from_secs(1);

/// Result of a request in the loop.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Outcome {
    /// The new zero is in use.
    Tared(Tare),
    /// The previous zero stays in use.
    Refused(TareRefusal),
    /// The zero in use was withdrawn; false: there was none.
    Withdrawn(bool),
}

/// Work requested of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// Take a zero, with the evidence that nothing presses.
    Tare(TareGround),
    /// Withdraw the zero in use, which was taken in contact.
    Withdraw,
}

impl Wanted {
    fn code(self) -> u8 {
        match self {
            Self::Tare(TareGround::Assumed) => 0,
            Self::Tare(TareGround::SaidClear) => 1,
            Self::Tare(TareGround::Shown) => 2,
            Self::Withdraw => 3,
        }
    }

    fn from_code(code: u8) -> Self {
        match code {
            1 => Self::Tare(TareGround::SaidClear),
            2 => Self::Tare(TareGround::Shown),
            3 => Self::Withdraw,
            _ => Self::Tare(TareGround::Assumed),
        }
    }

    fn of(request: &Request) -> Result<Self, Answer> {
        match (request.action.as_str(), request.argument.as_str()) {
            ("" | "tare", "") => Ok(Self::Tare(TareGround::Assumed)),
            ("" | "tare", "clear") => Ok(Self::Tare(TareGround::SaidClear)),
            ("" | "tare", "shown") => Ok(Self::Tare(TareGround::Shown)),
            ("withdraw", "") => Ok(Self::Withdraw),
            (action, argument) => Err(refused(format!(
                "unknown action `{action}` with `{argument}`: tare, tare with `clear` (a person has checked that the tool \
                 hangs free) or `shown` (from the controller: a motion has shown it), or withdraw"
            ))),
        }
    }
}

/// Shared by the requests and the loop that tares. The loop takes no lock and allocates nothing.
#[derive(Debug)]
struct Counter {
    ticket: Ticket,
    wanted: AtomicU8,
    outcomes: Ring<Outcome>,
    /// Held by the thread whose request is in progress.
    turn: Mutex<()>,
}

/// The requesting end.
#[derive(Clone)]
pub(crate) struct TareRequests {
    counter: Arc<Counter>,
    memory: Arc<Memory>,
    patience: Duration,
    silence: &'static str,
}

/// The averaging end, in the service's loop.
#[derive(Debug)]
pub(crate) struct TareWork(Arc<Counter>);

/// Result for programs: N and Nm, sensor axes.
#[derive(serde::Serialize)]
struct TareFigures {
    bias: [f64; 6],
    std: [f64; 6],
    samples: u32,
}

pub(crate) fn tare_requests(setup: &TareSetup, memory: &Arc<Memory>) -> (TareRequests, TareWork) {
    let counter = Arc::new(Counter {
        ticket: Ticket::default(),
        wanted: AtomicU8::new(0),
        outcomes: Ring::new(1),
        turn: Mutex::new(()),
    });
    let requests = TareRequests {
        counter: Arc::clone(&counter),
        memory: Arc::clone(memory),
        patience: Duration::from_secs_f64(setup.duration_s) + SLACK,
        silence: setup.silence,
    };
    (requests, TareWork(counter))
}

impl TareWork {
    /// What to do before the next reading.
    pub(crate) fn order(&self) -> Order {
        self.0.ticket.order()
    }

    /// Work that the present order requests.
    pub(crate) fn wanted(&self) -> Wanted {
        Wanted::from_code(self.0.wanted.load(Ordering::Acquire))
    }

    /// Reports the result of the present order.
    pub(crate) fn answer(&self, outcome: Outcome) {
        self.0.outcomes.force_push(outcome, drop);
        self.0.ticket.done();
    }
}

impl TareRequests {
    /// Reason for refusing a request without asking the loop; `None` if it may be carried out.
    /// Never waits.
    pub(crate) fn judge(&self, request: &Request) -> Option<Answer> {
        let wanted = match Wanted::of(request) {
            Ok(wanted) => wanted,
            Err(answer) => return Some(answer),
        };
        let not = |why: String| Some(refused(format!("not tared: {why}{STAYS}")));
        if wanted == Wanted::Withdraw {
            return None;
        }
        let said_clear = wanted == Wanted::Tare(TareGround::SaidClear);
        if let Some(sign) = self.memory.contact_sign()
            && !(said_clear && sign.can_be_waived())
        {
            return not(sign.to_string());
        }
        if said_clear {
            return None;
        }
        let second = self.memory.second_controller()?;
        not(format!(
            "{second}: end the one that does not belong to this cell; or, if you see that the tool hangs free, run \
             `tangent tare --clear`"
        ))
    }

    /// Answers one request that has passed the check. Waits for its turn and the average, at most
    /// until the request's deadline.
    pub(crate) fn respond(&self, asked: &Asked) -> Answer {
        let wanted = match Wanted::of(&asked.request) {
            Ok(wanted) => wanted,
            Err(answer) => return answer,
        };
        let counter = &self.counter;
        let _turn = counter.turn.lock().unwrap_or_else(PoisonError::into_inner);
        // Another average may have come first, and the tool may have touched since.
        if let Some(refusal) = asked.late().or_else(|| self.judge(&asked.request)) {
            return refusal;
        }
        if wanted == Wanted::Tare(TareGround::SaidClear) {
            let against = match self.memory.contact_sign() {
                Some(sign) => format!(", despite this evidence: {sign}"),
                None => String::new(),
            };
            tracing::warn!("tared: a person has confirmed that the tool hangs free{against}");
        }
        while counter.outcomes.pop().is_some() {}
        counter.wanted.store(wanted.code(), Ordering::Release);
        let deadline = asked.deadline.min(Instant::now() + self.patience);
        let outcome = if counter.ticket.ask_and_wait(deadline) {
            counter.outcomes.pop()
        } else {
            None
        };
        match outcome {
            Some(Outcome::Tared(tare)) => {
                let (bias, std) = (tare.bias, tare.std);
                done_with(
                    words(&tare),
                    &TareFigures {
                        bias: bias.vector().into(),
                        std: std.vector().into(),
                        samples: tare.samples,
                    },
                )
            }
            Some(Outcome::Withdrawn(true)) => done(
                "the zero was measured in contact and is withdrawn: the wrench has no zero until the next tare",
            ),
            Some(Outcome::Withdrawn(false)) => refused("there is no zero to withdraw"),
            Some(Outcome::Refused(refusal)) => refused(format!("not tared: {refusal}{STAYS}")),
            None => refused(format!("not tared: {}{STAYS}", self.silence)),
        }
    }
}

/// End of every refusal.
const STAYS: &str = "; the previous zero stays in force";

fn words(tare: &Tare) -> String {
    let show = |wrench: &tangent_mechanics::Wrench<Sensor>| {
        let (f, t) = (wrench.force, wrench.torque);
        format!(
            "[{:.3}, {:.3}, {:.3}] N, [{:.4}, {:.4}, {:.4}] Nm",
            f.x, f.y, f.z, t.x, t.y, t.z
        )
    };
    format!(
        "tared over {} readings: zero {}, scatter {}",
        tare.samples,
        show(&tare.bias),
        show(&tare.std)
    )
}
