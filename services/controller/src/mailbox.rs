//! Requests from other threads to the control loop. The loop answers each within one cycle and
//! never waits.
//!
//! A request is either claimed by the loop or withdrawn by its caller, never both: each takes it
//! out of its slot in one atomic operation. The caller of a claimed request waits until its real
//! outcome is known. A withdrawn request has no effect. Memory that is allocated outside the loop
//! is also freed outside of it: a request returns to its caller with the answer.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

use tangent_control::{Clearance, ControlError, EndedPass, EstimatorName, Phase, SwitchRefusal};
use tangent_runtime::ring::Ring;
use tangent_schemas::Text;
use tangent_schemas::convert::cut;
use tangent_sensing::TareGround;

use crate::inputs::EstimateReader;

/// A request to the loop. `P` is a task prepared for the loop's law.
pub enum Action<P> {
    /// Start this program; the box returns with the previous one.
    Start {
        /// The program to start; afterwards the previous one.
        program: Box<Option<P>>,
        /// Whether a person has checked that the tool is free. No effect if the start is refused.
        said_clear: bool,
    },
    /// Stand still.
    Pause,
    /// Resume the task.
    Resume,
    /// Retract and end the task.
    Stop,
    /// Use this estimator.
    Select {
        /// Name of the estimator.
        name: EstimatorName,
        /// Whether to use it even if it is invalid or disagrees with the normal in use.
        force: bool,
    },
    /// Read this estimator's topic too.
    Listen(Box<Option<EstimateReader>>),
}

impl<P> Action<P> {
    /// Whether the request brings the arm to rest. Urgent requests have their own slots.
    fn is_urgent(&self) -> bool {
        matches!(self, Self::Pause | Self::Stop)
    }
}

/// Answer of the loop to a request.
#[derive(Debug)]
pub enum Outcome {
    /// The request was carried out.
    Done {
        /// Number of task starts; for a start, its own number.
        activation: u64,
        /// Phase in which the request was received; for a stop, the phase that it leads to.
        phase: Phase,
    },
    /// The request was refused.
    Refused(ControlError),
    /// The switch to another estimator was refused.
    SwitchRefused(SwitchRefusal),
    /// Not carried out: its deadline had passed before the loop claimed it.
    TooLate,
    /// Not carried out: a stop was requested after this start.
    Stopped,
    /// A stop while no task runs: the tool may still touch what it touched before this controller
    /// started.
    MayTouch,
}

/// Why there is no answer from the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Silence {
    /// The loop did not claim the request in time. It was withdrawn and has no effect.
    Withdrawn,
    /// All slots are in use. The request has no effect.
    Full,
    /// The loop ended after it had claimed the request.
    Lost,
}

/// A request on its way to the loop and back.
pub struct MailboxRequest<P> {
    action: Action<P>,
    outcome: Option<Outcome>,
    received: Instant,
    deadline: Instant,
    back: Arc<Ring<MailboxRequest<P>>>,
    asker: Thread,
}

impl<P> MailboxRequest<P> {
    /// The request, to be carried out in the loop.
    pub fn action(&mut self) -> &mut Action<P> {
        &mut self.action
    }

    /// Returns the request to its caller with the outcome. Takes no lock and allocates nothing.
    pub fn answer(mut self, outcome: Outcome) {
        self.outcome = Some(outcome);
        let back = Arc::clone(&self.back);
        let asker = self.asker.clone();
        // Each return queue receives one request only: there is room.
        let _ = back.push(self);
        asker.unpark();
    }
}

/// When a request was received, and until when it may be carried out.
#[derive(Clone, Copy, Debug)]
pub struct Time {
    /// Time at which it arrived in this process.
    pub received: Instant,
    /// Time after which it has no effect.
    pub deadline: Instant,
}

impl Time {
    /// A request made now by this process itself, with the usual time for the loop.
    pub fn now() -> Self {
        let received = Instant::now();
        Self {
            received,
            deadline: received + PATIENCE,
        }
    }
}

/// The error for a tool that may be on the surface while the arm accepts no commands.
pub fn cannot_leave(phase: Phase) -> ControlError {
    ControlError::WrongPhase {
        request: "retract",
        phase: phase.name(),
        remedy: "the arm does not take commands, and the tool may still be on the surface; make the arm ready, then stop again",
    }
}

/// A log line from the loop, written by another thread.
#[derive(Clone, Copy, Debug)]
pub enum Note {
    /// The phase changed.
    Phase(Phase, Text),
    /// The estimator in use changed, and why.
    Estimator(EstimatorName, Text),
}

/// Place in which one request waits for the loop.
struct Slot<P> {
    /// Whether a caller holds this slot; it does so until its request has an outcome.
    taken: AtomicBool,
    request: Ring<MailboxRequest<P>>,
}

/// State that the loop shares with other threads.
pub struct Mailbox<P> {
    /// Slots of the requests. The urgent ones come last, so that a stop is handled after all others
    /// of a cycle.
    slots: [Slot<P>; SLOTS],
    /// One bit for each slot that may hold a request.
    waiting: AtomicU32,
    /// Log lines from the loop.
    pub notes: Ring<Note>,
    /// The tare that is due, and how it is known that the tool is free. Only the newest counts.
    pub tare_due: Ring<TareGround>,
    /// Why the tare that the loop waits for was refused, for the loop; an empty text if it was not.
    pub tare_refused: Ring<Text>,
    /// Why the last tare was refused, for answers about the state of the task; empty if it was not.
    tare_reason: Mutex<String>,
    /// Time of the newest stop request, ns since `epoch`; 0: none.
    stopped_ns: AtomicU64,
    epoch: Instant,
    /// Whether the zero in force was taken in contact: the sensor's service must withdraw it.
    pub withdraw_due: AtomicBool,
    /// Whether the tool may touch something, from the loop, to be stored across restarts. Only the
    /// newest counts.
    pub clearance: Ring<Clearance>,
    /// The pass of a task that learns, once it has ended.
    pub pass: Ring<EndedPass>,
    phase: AtomicU64,
    cycles: AtomicU64,
}

/// Number of requests that can wait at once: these, and further ones that are urgent.
const ORDINARY: usize = 16;
const SLOTS: usize = ORDINARY + 8;
/// Longest time that a request waits for the loop: several packets of the slowest robot.
pub const PATIENCE: Duration = Duration::from_millis(500);
/// Interval at which the caller of a claimed request checks whether the loop still exists.
const LOOK: Duration = Duration::from_millis(50);

impl<P> Default for Mailbox<P> {
    fn default() -> Self {
        Self {
            slots: std::array::from_fn(|_| Slot {
                taken: AtomicBool::new(false),
                request: Ring::new(1),
            }),
            waiting: AtomicU32::new(0),
            notes: Ring::new(64),
            tare_due: Ring::new(1),
            tare_refused: Ring::new(1),
            tare_reason: Mutex::default(),
            stopped_ns: AtomicU64::new(0),
            epoch: Instant::now(),
            withdraw_due: AtomicBool::new(false),
            clearance: Ring::new(1),
            pass: Ring::new(1),
            phase: AtomicU64::new(Phase::Idle as u64),
            cycles: AtomicU64::new(0),
        }
    }
}

impl<P> Mailbox<P> {
    /// Sends a request to the loop and waits for the answer. Not for the loop's thread.
    ///
    /// # Errors
    /// [`Silence`]. The request has no effect, except after [`Silence::Lost`], where that is
    /// unknown.
    pub fn ask(&self, action: Action<P>, time: Time) -> Result<Outcome, Silence> {
        let deadline = time.deadline.min(Instant::now() + PATIENCE);
        let index = loop {
            match self.reserve(&action) {
                Some(index) => break index,
                // A slot for urgent requests is free again within a cycle.
                None if action.is_urgent() && Instant::now() < deadline => {
                    std::thread::park_timeout(Duration::from_millis(1));
                }
                None => return Err(Silence::Full),
            }
        };
        let time = Time { deadline, ..time };
        let mut posted = self.post(index, action, time);
        loop {
            let now = Instant::now();
            if let Some(outcome) = posted.poll(now) {
                return outcome;
            }
            let left = deadline.saturating_duration_since(now);
            std::thread::park_timeout(if posted.claimed { LOOK } else { left });
        }
    }

    /// Reserves a free slot for one request, if there is one.
    fn reserve(&self, action: &Action<P>) -> Option<usize> {
        let mut range = if action.is_urgent() {
            ORDINARY..SLOTS
        } else {
            0..ORDINARY
        };
        range.find(|index| !self.slots[*index].taken.swap(true, Ordering::AcqRel))
    }

    /// Puts a request into a slot that its caller has reserved.
    fn post(&self, index: usize, action: Action<P>, time: Time) -> Posted<'_, P> {
        let slot = &self.slots[index];
        let back = Arc::new(Ring::new(1));
        let request = MailboxRequest {
            action,
            outcome: None,
            received: time.received,
            deadline: time.deadline,
            back: Arc::clone(&back),
            asker: std::thread::current(),
        };
        // The slot is reserved for this request: it is empty.
        let _ = slot.request.push(request);
        self.waiting.fetch_or(1 << index, Ordering::AcqRel);
        Posted {
            slot,
            back,
            deadline: time.deadline,
            claimed: false,
        }
    }

    /// The slots that may hold a request now, to be passed to [`take`](Self::take) in this order.
    /// For the loop; takes no lock and allocates nothing.
    pub fn waiting(&self) -> impl Iterator<Item = usize> + use<P> {
        let mut bits = match self.waiting.load(Ordering::Acquire) {
            0 => 0,
            _ => self.waiting.swap(0, Ordering::AcqRel),
        };
        std::iter::from_fn(move || {
            let index = bits.trailing_zeros();
            (bits != 0).then(|| {
                bits &= bits - 1;
                index as usize
            })
        })
    }

    /// Claims the request in this slot, unless its caller has withdrawn it. A request that must no
    /// longer be carried out is answered here. For the loop.
    pub fn take(&self, index: usize, now: Instant) -> Option<MailboxRequest<P>> {
        let request = self.slots.get(index)?.request.pop()?;
        if now > request.deadline {
            request.answer(Outcome::TooLate);
            return None;
        }
        if matches!(request.action, Action::Start { .. }) && self.stopped_after(request.received) {
            request.answer(Outcome::Stopped);
            return None;
        }
        Some(request)
    }

    /// Records a stop request that arrived at `received`. Starts from before it are refused from
    /// now on, wherever they wait.
    pub fn stop_asked(&self, received: Instant) {
        self.stopped_ns
            .fetch_max(self.since_epoch(received), Ordering::AcqRel);
    }

    /// Refuses all further starts, as the service ends.
    pub fn close(&self) {
        self.stopped_ns.store(u64::MAX, Ordering::Release);
    }

    /// Whether a stop was requested after a request that arrived at `received`.
    pub fn stopped_after(&self, received: Instant) -> bool {
        self.stopped_ns.load(Ordering::Acquire) > self.since_epoch(received)
    }

    /// Time since `epoch`, ns. It is never 0, which means no stop.
    fn since_epoch(&self, at: Instant) -> u64 {
        let since = at.saturating_duration_since(self.epoch);
        u64::try_from(since.as_nanos()).unwrap_or(u64::MAX - 1) + 1
    }

    /// Stores why a tare was refused; an empty text removes the reason. Not for the loop's thread.
    pub fn tare_refusal(&self, reason: &str) {
        self.tare_refused.force_push(cut(reason), drop);
        let mut told = self
            .tare_reason
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        reason.clone_into(&mut told);
    }

    /// Why the last tare was refused; empty if it was not. Not for the loop's thread.
    pub fn tare_reason(&self) -> String {
        self.tare_reason
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Counts a cycle of the loop and stores its phase.
    pub fn tick(&self, phase: Phase) {
        self.phase.store(phase as u64, Ordering::Release);
        self.cycles.fetch_add(1, Ordering::Release);
    }

    /// Phase after the last cycle.
    pub fn phase(&self) -> Phase {
        let code = self.phase.load(Ordering::Acquire);
        u8::try_from(code)
            .ok()
            .and_then(Phase::from_code)
            .unwrap_or_default()
    }

    /// Number of cycles since the start.
    pub fn cycles(&self) -> u64 {
        self.cycles.load(Ordering::Acquire)
    }
}

/// A request in its slot, as held by its caller.
struct Posted<'a, P> {
    slot: &'a Slot<P>,
    back: Arc<Ring<MailboxRequest<P>>>,
    deadline: Instant,
    /// Whether the loop has claimed it: it can no longer be withdrawn.
    claimed: bool,
}

impl<P> Posted<'_, P> {
    /// The outcome, if there is one at `now`. Withdraws the request at its deadline.
    fn poll(&mut self, now: Instant) -> Option<Result<Outcome, Silence>> {
        // Counted before the queue is read: an answer that arrives in between is still found.
        let alone = self.claimed && Arc::strong_count(&self.back) == 1;
        if let Some(answered) = self.back.pop() {
            return Some(answered.outcome.ok_or(Silence::Lost));
        }
        if alone {
            return Some(Err(Silence::Lost));
        }
        if !self.claimed && now >= self.deadline {
            if self.slot.request.pop().is_some() {
                return Some(Err(Silence::Withdrawn));
            }
            self.claimed = true;
        }
        None
    }
}

impl<P> Drop for Posted<'_, P> {
    fn drop(&mut self) {
        self.slot.taken.store(false, Ordering::Release);
    }
}

#[cfg(test)]
#[path = "mailbox_tests.rs"]
mod tests;
