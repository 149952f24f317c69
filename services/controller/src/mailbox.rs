//! Requests from other threads to the loop, which answers each within a cycle and never waits.
//!
//! A request is claimed by the loop or withdrawn by its asker, never both: either takes it out of its slot, which is one atomic
//! operation. A claimed request is waited for until its real outcome is known; a withdrawn one has no effect. Whatever is allocated
//! outside the loop is freed outside of it: a request comes back to its asker with the answer.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use tangent_control::{Clearance, ControlError, EstimatorName, Phase, SwitchRefusal};
use tangent_schemas::Text;
use tangent_schemas::convert::cut;

use crate::inputs::EstimateReader;

/// What the loop is asked. `P` is a task made ready for the loop's law.
pub enum Ask<P> {
    /// Start this program; the box comes back with the one before.
    Start(Box<Option<P>>),
    /// Stand still.
    Pause,
    /// Go on.
    Resume,
    /// Retract and end.
    Stop,
    /// Use this estimator; `force` waives its agreement.
    Select {
        /// Which one.
        name: EstimatorName,
        /// Even if it disagrees.
        force: bool,
    },
    /// A person has looked: the tool hangs free.
    Clear,
    /// Read this estimator's topic too.
    Listen(Box<Option<EstimateReader>>),
}

impl<P> Ask<P> {
    /// It brings the arm to rest, and has slots of its own.
    fn is_urgent(&self) -> bool {
        matches!(self, Self::Pause | Self::Stop)
    }
}

/// What the loop answers.
#[derive(Debug)]
pub enum Outcome {
    /// Done.
    Done {
        /// Counts task starts; a start says its own.
        activation: u64,
        /// Phase in which the request found the task; for a stop, the phase that it leads to.
        phase: Phase,
    },
    /// Not done.
    Refused(ControlError),
    /// The switch was refused.
    SwitchRefused(SwitchRefusal),
    /// Not done: its deadline had passed when the loop came to it.
    TooLate,
    /// Not done: a stop was asked for after this start.
    Stopped,
}

/// Why the loop has not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Silence {
    /// Nobody took the request in time. It is withdrawn and has no effect.
    Withdrawn,
    /// All slots are in use. It has no effect.
    Full,
    /// The loop ended with the request in its hands.
    Lost,
}

/// A request on its way to the loop and back.
pub struct Letter<P> {
    ask: Ask<P>,
    outcome: Option<Outcome>,
    received: Instant,
    deadline: Instant,
    back: Arc<ArrayQueue<Letter<P>>>,
    asker: Thread,
}

impl<P> Letter<P> {
    /// The request, to be dealt with in the loop.
    pub fn ask(&mut self) -> &mut Ask<P> {
        &mut self.ask
    }

    /// Sends it back with its answer. No lock, no memory.
    pub fn answer(mut self, outcome: Outcome) {
        self.outcome = Some(outcome);
        let back = Arc::clone(&self.back);
        let asker = self.asker.clone();
        // One letter per return queue: there is room.
        let _ = back.push(self);
        asker.unpark();
    }
}

/// When a request was asked, and until when it may be carried out.
#[derive(Clone, Copy, Debug)]
pub struct Time {
    /// When it came to this process.
    pub received: Instant,
    /// It has no effect after this.
    pub deadline: Instant,
}

impl Time {
    /// Asked now by this process itself: the loop has its usual time.
    pub fn now() -> Self {
        let received = Instant::now();
        Self {
            received,
            deadline: received + PATIENCE,
        }
    }
}

/// The tool may be on the surface, and the arm does not take commands.
pub fn cannot_leave(phase: Phase) -> ControlError {
    ControlError::WrongPhase {
        request: "retract",
        phase: phase.name(),
        remedy: "the arm does not take commands, and the tool may still be on the surface; make the arm ready, then stop again",
    }
}

/// A line for the log, written outside the loop.
#[derive(Clone, Copy, Debug)]
pub enum Note {
    /// The phase changed.
    Phase(Phase, Text),
    /// The estimator in use changed, and why.
    Estimator(EstimatorName, Text),
}

/// Where one request waits for the loop.
struct Slot<P> {
    /// An asker has this slot until its request has an outcome.
    taken: AtomicBool,
    letter: ArrayQueue<Letter<P>>,
}

/// What the loop and the others share.
pub struct Mailbox<P> {
    /// The urgent ones last: within a cycle, a stop has the last word.
    slots: [Slot<P>; SLOTS],
    /// One bit per slot that may hold a request.
    waiting: AtomicU32,
    /// From the loop, for the log.
    pub notes: ArrayQueue<Note>,
    /// A tare is due.
    pub tare_due: AtomicBool,
    /// Why the tare that the loop waits for was refused, for the loop; empty when it was not.
    pub tare_refused: ArrayQueue<Text>,
    /// The same for those who ask how the task stands.
    tare_reason: Mutex<String>,
    /// Newest stop, ns since `epoch`.
    stopped_ns: AtomicU64,
    epoch: Instant,
    /// A person has looked before this start: the tare that is due goes by it.
    pub said_clear: AtomicBool,
    /// The zero in force was taken in contact: the sensor's service has to take it back.
    pub withdraw_due: AtomicBool,
    /// From the loop, to be kept over restarts: whether the tool may touch something. The newest counts.
    pub clearance: ArrayQueue<Clearance>,
    phase: AtomicU64,
    cycles: AtomicU64,
}

/// Requests that can wait at once: these, and as many more that are urgent.
const ORDINARY: usize = 16;
const SLOTS: usize = ORDINARY + 8;
/// How long a request waits for the loop: several packets of the slowest robot.
pub const PATIENCE: Duration = Duration::from_millis(500);
/// An asker whose request was claimed looks so often whether the loop is still there.
const LOOK: Duration = Duration::from_millis(50);

impl<P> Default for Mailbox<P> {
    fn default() -> Self {
        Self {
            slots: std::array::from_fn(|_| Slot {
                taken: AtomicBool::new(false),
                letter: ArrayQueue::new(1),
            }),
            waiting: AtomicU32::new(0),
            notes: ArrayQueue::new(64),
            tare_due: AtomicBool::new(false),
            tare_refused: ArrayQueue::new(1),
            tare_reason: Mutex::default(),
            stopped_ns: AtomicU64::new(0),
            epoch: Instant::now(),
            said_clear: AtomicBool::new(false),
            withdraw_due: AtomicBool::new(false),
            clearance: ArrayQueue::new(1),
            phase: AtomicU64::new(Phase::Idle as u64),
            cycles: AtomicU64::new(0),
        }
    }
}

impl<P> Mailbox<P> {
    /// Asks the loop and waits for its answer. Not for the loop's thread.
    ///
    /// # Errors
    /// [`Silence`]; the request has no effect but for [`Silence::Lost`], of which nobody knows.
    pub fn ask(&self, ask: Ask<P>, time: Time) -> Result<Outcome, Silence> {
        let deadline = time.deadline.min(Instant::now() + PATIENCE);
        let index = loop {
            match self.reserve(&ask) {
                Some(index) => break index,
                // A slot for what is urgent is free again within a cycle.
                None if ask.is_urgent() && Instant::now() < deadline => {
                    std::thread::park_timeout(Duration::from_millis(1));
                }
                None => return Err(Silence::Full),
            }
        };
        let time = Time { deadline, ..time };
        let mut posted = self.post(index, ask, time);
        loop {
            let now = Instant::now();
            if let Some(outcome) = posted.poll(now) {
                return outcome;
            }
            let left = deadline.saturating_duration_since(now);
            std::thread::park_timeout(if posted.claimed { LOOK } else { left });
        }
    }

    /// A slot for this asker alone.
    fn reserve(&self, ask: &Ask<P>) -> Option<usize> {
        let mut range = if ask.is_urgent() {
            ORDINARY..SLOTS
        } else {
            0..ORDINARY
        };
        range.find(|index| !self.slots[*index].taken.swap(true, Ordering::AcqRel))
    }

    /// Puts a request into a slot that its asker has reserved.
    fn post(&self, index: usize, ask: Ask<P>, time: Time) -> Posted<'_, P> {
        let slot = &self.slots[index];
        let back = Arc::new(ArrayQueue::new(1));
        let letter = Letter {
            ask,
            outcome: None,
            received: time.received,
            deadline: time.deadline,
            back: Arc::clone(&back),
            asker: std::thread::current(),
        };
        // The slot is this asker's: it is empty.
        let _ = slot.letter.push(letter);
        self.waiting.fetch_or(1 << index, Ordering::AcqRel);
        Posted {
            slot,
            back,
            deadline: time.deadline,
            claimed: false,
        }
    }

    /// The slots that may hold a request now, to be [taken](Self::take) from in this order. For the loop; no lock, no memory.
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

    /// Claims the request in this slot, unless its asker has withdrawn it or it may no longer be carried out: that one is answered
    /// here. For the loop.
    pub fn take(&self, index: usize, now: Instant) -> Option<Letter<P>> {
        let letter = self.slots.get(index)?.letter.pop()?;
        if now > letter.deadline {
            letter.answer(Outcome::TooLate);
            return None;
        }
        if matches!(letter.ask, Ask::Start(_)) && self.stopped_after(letter.received) {
            letter.answer(Outcome::Stopped);
            return None;
        }
        Some(letter)
    }

    /// A stop was asked for at `received`: a start from before it is refused from now on, wherever it waits.
    pub fn stop_asked(&self, received: Instant) {
        self.stopped_ns
            .fetch_max(self.since_epoch(received), Ordering::AcqRel);
    }

    /// The service ends: no task is started any more.
    pub fn close(&self) {
        self.stopped_ns.store(u64::MAX, Ordering::Release);
    }

    /// A stop was asked for after a request that came at `received`.
    pub fn stopped_after(&self, received: Instant) -> bool {
        self.stopped_ns.load(Ordering::Acquire) > self.since_epoch(received)
    }

    /// Never 0, which means no stop.
    fn since_epoch(&self, at: Instant) -> u64 {
        let since = at.saturating_duration_since(self.epoch);
        u64::try_from(since.as_nanos()).unwrap_or(u64::MAX - 1) + 1
    }

    /// Says why a tare was refused; empty once there is nothing to say. Not for the loop's thread.
    pub fn tare_refusal(&self, reason: &str) {
        self.tare_refused.force_push(cut(reason));
        let mut told = self
            .tare_reason
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        reason.clone_into(&mut told);
    }

    /// Why the last tare was refused; empty when it was not. Not for the loop's thread.
    pub fn tare_reason(&self) -> String {
        self.tare_reason
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// The loop has run once more and is in this phase.
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

    /// Cycles since the start.
    pub fn cycles(&self) -> u64 {
        self.cycles.load(Ordering::Acquire)
    }
}

/// A request in its slot, on its asker's side.
struct Posted<'a, P> {
    slot: &'a Slot<P>,
    back: Arc<ArrayQueue<Letter<P>>>,
    deadline: Instant,
    /// The loop has it: it can no longer be withdrawn.
    claimed: bool,
}

impl<P> Posted<'_, P> {
    /// Its outcome, where there is one at `now`; withdraws it at its deadline.
    fn poll(&mut self, now: Instant) -> Option<Result<Outcome, Silence>> {
        // Before the queue is looked at: an answer that comes in between is still found.
        let alone = self.claimed && Arc::strong_count(&self.back) == 1;
        if let Some(answered) = self.back.pop() {
            return Some(answered.outcome.ok_or(Silence::Lost));
        }
        if alone {
            return Some(Err(Silence::Lost));
        }
        if !self.claimed && now >= self.deadline {
            if self.slot.letter.pop().is_some() {
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
