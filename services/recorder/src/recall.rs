//! Asks publishers for what the recorder missed, without keeping the disk waiting: after a restart
//! of the recorder, a return of the router, and holes in what came.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use tangent_runtime::{Bus, Question, RawMessage, clock};

use crate::error::RecorderError;
use crate::ledger::Ledger;

/// Publishers have this long to answer.
const PATIENCE: Duration = Duration::from_secs(4);
/// After a start or a return of the router, everybody is asked at these times: who is not there yet
/// the first time is later.
const ROUNDS: [Duration; 3] = [
    Duration::from_millis(300),
    Duration::from_millis(1500),
    Duration::from_secs(4),
];
/// Time between two looks for the router.
const LOOK: Duration = Duration::from_millis(100);
/// What was published shortly before the router was seen to be gone did not come either, ns.
const BEFORE_NS: i64 = 2_000_000_000;

enum Answer {
    Message(Box<RawMessage>),
    Complete,
}

/// When to ask whom, and a thread that does; it ends with this value.
pub(crate) struct Recaller {
    bus: Bus,
    questions: Option<Sender<Question>>,
    answers: Receiver<Answer>,
    thread: Option<std::thread::JoinHandle<()>>,
    under_way: bool,
    /// Everybody is to be asked for what was published since, at these times.
    rounds: Vec<Instant>,
    since_ns: i64,
    /// The router, and when it was last seen.
    router: Option<String>,
    seen_ns: i64,
    looked: Instant,
}

impl Recaller {
    /// `prefixes`: what stands before the keys of each cell.
    pub(crate) fn start(bus: Bus, prefixes: Vec<String>) -> Result<Self, RecorderError> {
        let (questions, asked) = channel();
        let (said, answers) = channel();
        let asking = bus.clone();
        let thread = std::thread::Builder::new()
            .name("recorder-recall".to_owned())
            .spawn(move || {
                for question in asked {
                    for prefix in &prefixes {
                        let take = |message| {
                            let _ = said.send(Answer::Message(Box::new(message)));
                        };
                        if let Err(error) = asking.recall(prefix, &question, PATIENCE, take) {
                            tracing::warn!("what is missing cannot be asked for: {error}");
                        }
                    }
                    if said.send(Answer::Complete).is_err() {
                        return;
                    }
                }
            })
            .map_err(|source| RecorderError::Thread { source })?;
        Ok(Self {
            router: bus.router(),
            bus,
            questions: Some(questions),
            answers,
            thread: Some(thread),
            under_way: false,
            rounds: Vec::new(),
            since_ns: 0,
            seen_ns: clock::now_ns(),
            looked: Instant::now(),
        })
    }

    /// Everybody is to be asked for what was published since.
    pub(crate) fn ask_since(&mut self, since_ns: i64, now: Instant) {
        self.since_ns = match self.rounds.is_empty() {
            true => since_ns,
            false => self.since_ns.min(since_ns),
        };
        self.rounds = ROUNDS.iter().map(|after| now + *after).collect();
    }

    /// Asks what is due, unless a query is under way or there is no session to send it on.
    pub(crate) fn tend(&mut self, ledger: &mut Ledger, now: Instant) {
        self.look(now);
        if self.under_way || self.router.is_none() {
            return;
        }
        let round = self.rounds.first().is_some_and(|at| now >= *at);
        if round {
            self.rounds.remove(0);
        }
        if (round || ledger.is_due(now))
            && let Some(question) = ledger.question(round.then_some(self.since_ns), now)
        {
            self.ask(question);
        }
    }

    fn ask(&mut self, question: Question) {
        if let Some(questions) = &self.questions {
            // A thread that is gone asks nothing; what is missing stays so.
            self.under_way = questions.send(question).is_ok();
        }
    }

    /// A router that is gone or another one: what was published meanwhile did not come.
    fn look(&mut self, now: Instant) {
        if now.duration_since(self.looked) < LOOK {
            return;
        }
        self.looked = now;
        let router = self.bus.router();
        if router.is_some() && router != self.router {
            let since_ns = self.seen_ns - BEFORE_NS;
            self.ask_since(since_ns, now);
        }
        if router.is_some() {
            self.seen_ns = clock::now_ns();
            self.router = router;
        } else {
            // Seen as another one when it is back.
            self.router = None;
        }
    }

    /// What was said again since the last call, at most so many messages.
    pub(crate) fn answers(&mut self, messages_max: usize) -> Vec<RawMessage> {
        let mut messages = Vec::new();
        while messages.len() < messages_max
            && let Ok(answer) = self.answers.try_recv()
        {
            match answer {
                Answer::Message(message) => messages.push(*message),
                Answer::Complete => self.under_way = false,
            }
        }
        messages
    }

    /// Asks once more for everything that is missing, and waits for it at most so long.
    pub(crate) fn finish(&mut self, ledger: &mut Ledger, patience: Duration) -> Vec<RawMessage> {
        let mut messages = Vec::new();
        let until = Instant::now() + patience;
        let mut last = false;
        if self.bus.router().is_some() {
            loop {
                if !self.under_way {
                    let later = Instant::now() + Duration::from_secs(60);
                    match ledger.question(None, later).filter(|_| !last) {
                        Some(question) => self.ask(question),
                        None => break,
                    }
                    last = true;
                }
                let left = until.saturating_duration_since(Instant::now());
                match self.answers.recv_timeout(left) {
                    Ok(Answer::Message(message)) => messages.push(*message),
                    Ok(Answer::Complete) => self.under_way = false,
                    Err(_) => break,
                }
            }
        }
        self.questions = None;
        messages
    }
}

impl Drop for Recaller {
    fn drop(&mut self) {
        self.questions = None;
        // One that waits for an answer ends with the process.
        if !self.under_way
            && let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the recorder's recalling thread panicked");
        }
    }
}
