//! Between those who ask (queries, parameters, signals) and the loop, which answers within a cycle and never waits.
//!
//! Whatever is allocated outside the loop is freed outside of it: a request comes back to its asker with the answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::Thread;
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use tangent_control::{ControlError, EstimatorName, Phase, SwitchRefusal};
use tangent_schemas::Text;

use crate::inputs::EstimateReader;

/// What the loop is asked. `P` is a task made ready for the loop's law.
pub enum Ask<P> {
    /// Start this program; the box comes back with the one before.
    Start(Box<Option<P>>),
    /// Stop the path, keep the force.
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
    /// Read this estimator's topic too.
    Listen(Box<Option<EstimateReader>>),
}

/// What the loop answers.
pub enum Outcome {
    /// Done; a start says its activation.
    Done {
        /// Counts task starts.
        activation: u64,
    },
    /// Not done.
    Refused(ControlError),
    /// The switch was refused.
    SwitchRefused(SwitchRefusal),
}

/// A request on its way to the loop and back.
pub struct Letter<P> {
    ask: Ask<P>,
    outcome: Option<Outcome>,
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

/// A line for the log, written outside the loop.
#[derive(Clone, Copy, Debug)]
pub enum Note {
    /// The phase changed.
    Phase(Phase, Text),
    /// The estimator in use changed, and why.
    Estimator(EstimatorName, Text),
}

/// What the loop and the others share.
pub struct Mailbox<P> {
    letters: ArrayQueue<Letter<P>>,
    /// From the loop, for the log.
    pub notes: ArrayQueue<Note>,
    /// A tare is due.
    pub tare_due: AtomicBool,
    phase: AtomicU64,
    cycles: AtomicU64,
}

/// How long a request waits for the loop: several packets of the slowest robot.
const PATIENCE: Duration = Duration::from_millis(500);

impl<P> Default for Mailbox<P> {
    fn default() -> Self {
        Self {
            letters: ArrayQueue::new(16),
            notes: ArrayQueue::new(64),
            tare_due: AtomicBool::new(false),
            phase: AtomicU64::new(Phase::Idle as u64),
            cycles: AtomicU64::new(0),
        }
    }
}

impl<P> Mailbox<P> {
    /// Asks the loop and waits for its answer; none when it does not run. Not for the loop's thread.
    pub fn ask(&self, ask: Ask<P>) -> Option<Outcome> {
        let back = Arc::new(ArrayQueue::<Letter<P>>::new(1));
        let letter = Letter {
            ask,
            outcome: None,
            back: Arc::clone(&back),
            asker: std::thread::current(),
        };
        self.letters.push(letter).ok()?;
        let deadline = Instant::now() + PATIENCE;
        loop {
            if let Some(answered) = back.pop() {
                return answered.outcome;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            std::thread::park_timeout(left);
        }
    }

    /// The next request. For the loop.
    pub fn take(&self) -> Option<Letter<P>> {
        self.letters.pop()
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
