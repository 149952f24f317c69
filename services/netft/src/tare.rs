//! Between the tare query, answered in a thread of the bus, and the receiving thread, which averages.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tangent_mechanics::Sensor;
use tangent_runtime::bus::answer::{done_with, refused};
use tangent_schemas::tangent::{Answer, Request};
use tangent_sensing::{Tare, TareRefusal};

/// Time beyond the average itself that an answer may take.
const SLACK: Duration = Duration::from_secs(1);

type Outcome = Result<Tare, TareRefusal>;

/// The asking end.
#[derive(Clone)]
pub(crate) struct TareDesk {
    requested: Arc<AtomicBool>,
    outcomes: Arc<Mutex<Receiver<Outcome>>>,
    patience: Duration,
}

/// The averaging end, in the receiving thread.
pub(crate) struct TareWork {
    requested: Arc<AtomicBool>,
    outcomes: SyncSender<Outcome>,
}

/// For programs: N and Nm, sensor axes.
#[derive(serde::Serialize)]
struct TareFigures {
    bias: [f64; 6],
    std: [f64; 6],
    samples: u32,
}

pub(crate) fn tare_desk(duration_s: f64) -> (TareDesk, TareWork) {
    let requested = Arc::new(AtomicBool::new(false));
    let (sender, receiver) = sync_channel(4);
    let desk = TareDesk {
        requested: Arc::clone(&requested),
        outcomes: Arc::new(Mutex::new(receiver)),
        patience: Duration::from_secs_f64(duration_s) + SLACK,
    };
    let work = TareWork {
        requested,
        outcomes: sender,
    };
    (desk, work)
}

impl TareWork {
    /// True once per request.
    pub(crate) fn is_requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed) && self.requested.swap(false, Ordering::Acquire)
    }

    pub(crate) fn answer(&self, outcome: Outcome) {
        // Nobody waits any more when it is full.
        let _ = self.outcomes.try_send(outcome);
    }
}

impl TareDesk {
    /// Answers one request; waits for the average. One at a time.
    pub(crate) fn respond(&self, request: &Request) -> Answer {
        if !matches!(request.action.as_str(), "" | "tare") {
            return refused(format!("unknown action `{}`: tare", request.action));
        }
        let outcomes = self.outcomes.lock().unwrap_or_else(PoisonError::into_inner);
        while outcomes.try_recv().is_ok() {}
        self.requested.store(true, Ordering::Release);
        match outcomes.recv_timeout(self.patience) {
            Ok(Ok(tare)) => {
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
            Ok(Err(refusal)) => refused(format!(
                "not tared: {refusal}; the zero before stays in force"
            )),
            Err(_) => {
                self.requested.store(false, Ordering::Release);
                refused(format!(
                    "not tared: no records came within {:.1} s; see the sensor's health",
                    self.patience.as_secs_f64()
                ))
            }
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
