//! Between the tare query, answered in a thread of the bus, and the receiving thread, which averages.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tangent_mechanics::Sensor;
use tangent_runtime::bus::answer::{done, done_with, refused};
use tangent_runtime::ticket::{Order, Ticket};
use tangent_schemas::tangent::{Answer, Request};
use tangent_sensing::{Tare, TareRefusal};

use crate::memory::Memory;

/// Time beyond the average itself that an answer may take.
const SLACK: Duration = Duration::from_secs(1);

/// What the receiving thread made of a request.
pub(crate) enum Outcome {
    Tared(Tare),
    Refused(TareRefusal),
    /// The zero in force was taken back; false: there was none.
    Withdrawn(bool),
}

/// What is asked of the receiving thread.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Wanted {
    Tare = 1,
    /// By a person who has looked and says that the tool hangs free.
    TareSaidClear = 2,
    /// The zero in force was taken in contact.
    Withdraw = 3,
}

/// The asking end.
#[derive(Clone)]
pub(crate) struct TareDesk {
    ticket: Arc<Ticket>,
    wanted: Arc<AtomicU8>,
    memory: Arc<Memory>,
    outcomes: Arc<Mutex<Receiver<Outcome>>>,
    patience: Duration,
}

/// The averaging end, in the receiving thread.
pub(crate) struct TareWork {
    ticket: Arc<Ticket>,
    wanted: Arc<AtomicU8>,
    outcomes: SyncSender<Outcome>,
}

/// For programs: N and Nm, sensor axes.
#[derive(serde::Serialize)]
struct TareFigures {
    bias: [f64; 6],
    std: [f64; 6],
    samples: u32,
}

pub(crate) fn tare_desk(duration_s: f64, memory: &Arc<Memory>) -> (TareDesk, TareWork) {
    let ticket = Arc::new(Ticket::default());
    let wanted = Arc::new(AtomicU8::new(Wanted::Tare as u8));
    let (sender, receiver) = sync_channel(4);
    let desk = TareDesk {
        ticket: Arc::clone(&ticket),
        wanted: Arc::clone(&wanted),
        memory: Arc::clone(memory),
        outcomes: Arc::new(Mutex::new(receiver)),
        patience: Duration::from_secs_f64(duration_s) + SLACK,
    };
    let work = TareWork {
        ticket,
        wanted,
        outcomes: sender,
    };
    (desk, work)
}

impl TareWork {
    /// What to do before the next reading.
    pub(crate) fn order(&self) -> Order {
        self.ticket.order()
    }

    /// What the order that began is about.
    pub(crate) fn wanted(&self) -> Wanted {
        match self.wanted.load(Ordering::Acquire) {
            2 => Wanted::TareSaidClear,
            3 => Wanted::Withdraw,
            _ => Wanted::Tare,
        }
    }

    pub(crate) fn answer(&self, outcome: Outcome) {
        // Nobody waits any more when it is full.
        let _ = self.outcomes.try_send(outcome);
        self.ticket.done();
    }
}

impl TareDesk {
    /// Answers one request; waits for the average, until `deadline` at most. One at a time.
    pub(crate) fn respond(&self, request: &Request, deadline: Instant) -> Answer {
        let wanted = match (request.action.as_str(), request.argument.as_str()) {
            ("" | "tare", "") => Wanted::Tare,
            ("" | "tare", "clear") => Wanted::TareSaidClear,
            ("withdraw", "") => Wanted::Withdraw,
            (action, argument) => {
                return refused(format!(
                    "unknown action `{action}` with `{argument}`: tare, tare with `clear` (a person has looked: the tool hangs free), or withdraw"
                ));
            }
        };
        if wanted != Wanted::Withdraw
            && let Some(sign) = self.memory.contact_sign()
        {
            if wanted != Wanted::TareSaidClear || !sign.can_be_waived() {
                return refused(format!("not tared: {sign}; the zero before stays in force"));
            }
            tracing::warn!(
                "tared on a person's word that the tool hangs free, against this: {sign}"
            );
        } else if wanted == Wanted::TareSaidClear {
            tracing::warn!("tared on a person's word that the tool hangs free");
        }
        let outcomes = self.outcomes.lock().unwrap_or_else(PoisonError::into_inner);
        while outcomes.try_recv().is_ok() {}
        self.wanted.store(wanted as u8, Ordering::Release);
        let deadline = deadline.min(Instant::now() + self.patience);
        let outcome = if self.ticket.ask_and_wait(deadline) {
            outcomes.try_recv().ok()
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
                "the zero was taken in contact and is taken back: the wrench has none until the next tare",
            ),
            Some(Outcome::Withdrawn(false)) => refused("there is no zero to take back"),
            Some(Outcome::Refused(refusal)) => refused(format!(
                "not tared: {refusal}; the zero before stays in force"
            )),
            None => refused(format!(
                "not tared: no records came within {:.1} s; see the sensor's health; the zero before stays in force",
                self.patience.as_secs_f64()
            )),
        }
    }
}

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
