//! Requests missed messages from publishers, without delaying the disk: after a restart of the
//! recorder, a return of the router, and gaps in the received messages.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use tangent_runtime::{Bus, Question, RawMessage, clock};

use crate::error::RecorderError;
use crate::ledger::Ledger;

/// Time that publishers have to answer.
const PATIENCE: Duration = Duration::from_secs(4);
/// Times after a start or a return of the router at which all publishers are asked; some may not be
/// connected yet the first time.
const ROUNDS: [Duration; 3] = [
    Duration::from_millis(300),
    Duration::from_millis(1500),
    Duration::from_secs(4),
];
/// Interval between two checks of the router.
const LOOK: Duration = Duration::from_millis(100);
/// Time before the loss of the router was seen for which messages are requested too, ns.
const BEFORE_NS: i64 = 2_000_000_000;

enum Answer {
    Message(Box<RawMessage>),
    Complete,
}

/// Schedules the requests, and owns the thread that sends them; it ends when this value is dropped.
pub(crate) struct Recaller {
    bus: Bus,
    questions: Option<Sender<Question>>,
    answers: Receiver<Answer>,
    thread: Option<std::thread::JoinHandle<()>>,
    under_way: bool,
    /// Times at which all publishers are to be asked.
    rounds: Vec<Instant>,
    since_ns: i64,
    /// Name of the router, and when it was last seen.
    router: Option<String>,
    seen_ns: i64,
    looked: Instant,
}

impl Recaller {
    /// `prefixes` are those of each cell's keys.
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
                            tracing::warn!("missing messages cannot be requested: {error}");
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

    /// Schedules requests to all publishers for messages published since `since_ns`.
    pub(crate) fn ask_since(&mut self, since_ns: i64, now: Instant) {
        self.since_ns = match self.rounds.is_empty() {
            true => since_ns,
            false => self.since_ns.min(since_ns),
        };
        self.rounds = ROUNDS.iter().map(|after| now + *after).collect();
    }

    /// Sends a request that is due, unless one is in progress or there is no session.
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
            // If the thread has ended, nothing is requested; missing messages stay missing.
            self.under_way = questions.send(question).is_ok();
        }
    }

    /// Detects a lost or replaced router: messages published in the meantime were not received.
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
            // When the router returns, it counts as another one.
            self.router = None;
        }
    }

    /// Messages resent since the last call, at most `messages_max`.
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

    /// Requests all missing messages once more, and those after the last recorded ones, and waits
    /// for at most `patience`.
    pub(crate) fn finish(&mut self, ledger: &mut Ledger, patience: Duration) -> Vec<RawMessage> {
        let mut messages = Vec::new();
        let until = Instant::now() + patience;
        let mut last = false;
        if self.bus.router().is_some() {
            loop {
                if !self.under_way {
                    match ledger.last_question(Instant::now()).filter(|_| !last) {
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
