//! Publishers say again what a recorder missed: a thread of each process answers from the kept
//! messages.
//!
//! A question is looked at in Zenoh's thread, the publishing thread hands over what is kept without
//! copying it, and a thread of its own sends the answers, at a bounded rate. However many ask, a
//! bounded number of questions is under way; further ones stay without an answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Thread;
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use zenoh::query::Query;

use super::attachment::Attachment;
use super::error::BusError;
use super::history::Block;
use super::question::{Batch, PREFIX, Question, Span, question_key};
use super::raw::RawMessage;
use super::reader::Arrival;
use super::session;
use super::{Bus, Inner};

/// Questions that one process has under way: one to each publisher of a process that runs
/// everything, twice.
const UNDER_WAY_MAX: usize = 64;
/// A batch is sent when it has so many bytes: with one more message, still one packet.
const BATCH_BYTES: usize = 32 << 10;
/// So much is said again per second, beside what is published.
const BYTES_PER_S: f64 = 8e6;
/// Between two questions.
const PAUSE: Duration = Duration::from_millis(1);
/// Who asked has given up by then.
const ANSWER_WITHIN: Duration = Duration::from_secs(6);
/// Answers to one question that an asker holds at most, bytes.
const ANSWERS_BYTES_MAX: usize = 256 << 20;

/// A question to one publisher of this process, on its way to what is kept.
pub(crate) struct Ask {
    query: Query,
    key: String,
    type_name: &'static str,
    pub(super) publisher: [u8; 16],
    spans: Vec<Span>,
    asked: Instant,
    _place: Place,
}

/// One of the questions under way.
struct Place(Arc<AtomicUsize>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

struct Job {
    ask: Ask,
    blocks: Vec<Arc<Block>>,
}

/// The questions that a process has under way, and the thread that answers them; it ends with this
/// value.
pub(crate) struct Recall {
    under_way: Arc<AtomicUsize>,
    asks: ArrayQueue<Ask>,
    jobs: SyncSender<Job>,
}

impl Recall {
    pub(crate) fn start() -> Arc<Self> {
        let (jobs, waiting) = sync_channel(UNDER_WAY_MAX);
        let spawned = std::thread::Builder::new()
            .name("bus-recall".into())
            .spawn(move || answer_all(&waiting));
        if let Err(error) = spawned {
            tracing::error!("no thread to say again what a recorder missed: {error}");
        }
        Arc::new(Self {
            under_way: Arc::default(),
            asks: ArrayQueue::new(UNDER_WAY_MAX),
            jobs,
        })
    }

    /// A question that waits for the publishing thread.
    pub(crate) fn next(&self) -> Option<Ask> {
        self.asks.pop()
    }

    /// Has it answered from these. Never waits.
    pub(crate) fn answer(&self, ask: Ask, blocks: Vec<Arc<Block>>) {
        // Without room the asker gets no answer, and asks again.
        let _ = self.jobs.try_send(Job { ask, blocks });
    }

    fn place(&self) -> Option<Place> {
        let taken = self.under_way.fetch_add(1, Ordering::Relaxed);
        let place = Place(Arc::clone(&self.under_way));
        (taken < UNDER_WAY_MAX).then_some(place)
    }
}

/// Where questions to one publisher come in.
pub(crate) struct Entrance {
    pub recall: Arc<Recall>,
    pub pump: Option<Thread>,
    pub key: String,
    pub type_name: &'static str,
    pub publisher: [u8; 16],
}

impl Entrance {
    /// Takes one question in, or leaves it without an answer. In Zenoh's thread: never waits.
    pub(crate) fn take(&self, query: Query) {
        let question = query
            .payload()
            .and_then(|payload| Question::from_bytes(&payload.to_bytes()));
        let Some(spans) = question.and_then(|question| question.of(self.publisher)) else {
            return;
        };
        let Some(place) = self.recall.place() else {
            tracing::debug!("{}: a question too many", self.key);
            return;
        };
        let ask = Ask {
            query,
            key: self.key.clone(),
            type_name: self.type_name,
            publisher: self.publisher,
            spans,
            asked: Instant::now(),
            _place: place,
        };
        if self.recall.asks.push(ask).is_ok()
            && let Some(pump) = &self.pump
        {
            pump.unpark();
        }
    }
}

fn answer_all(jobs: &Receiver<Job>) {
    for Job { ask, blocks } in jobs {
        let mut batch = Batch::new(ask.publisher, ask.type_name);
        for block in blocks {
            for (sequence, source_time_ns, payload) in block.messages() {
                let wanted = |span: &Span| span.holds(sequence, source_time_ns);
                if !ask.spans.iter().any(wanted) {
                    continue;
                }
                batch.push(sequence, source_time_ns, payload);
                if batch.bytes().len() >= BATCH_BYTES {
                    send(&ask, &mut batch);
                }
            }
            if ask.asked.elapsed() > ANSWER_WITHIN {
                break;
            }
        }
        if !batch.is_empty() {
            send(&ask, &mut batch);
        }
        drop(ask);
        std::thread::sleep(PAUSE);
    }
}

fn send(ask: &Ask, batch: &mut Batch) {
    session::reply_batch(&ask.query, &ask.key, batch.bytes());
    std::thread::sleep(Duration::from_secs_f64(
        batch.bytes().len() as f64 / BYTES_PER_S,
    ));
    batch.clear();
}

impl Bus {
    /// Asks every publisher of a cell for messages that it still has (about the last 12 s, no
    /// images), waits until all have answered or `patience` is over, and gives each to `take`.
    /// `prefix` stands before the cell's keys: `CELL/` on a bus outside any cell, nothing
    /// otherwise. Without a network nothing is kept, and nothing comes.
    ///
    /// # Errors
    /// A bad key, or a closed session.
    pub fn recall(
        &self,
        prefix: &str,
        question: &Question,
        patience: Duration,
        mut take: impl FnMut(RawMessage),
    ) -> Result<(), BusError> {
        let Some(session) = &self.inner.session else {
            return Ok(());
        };
        let key = format!("{prefix}{}", question_key("**"));
        let began = Instant::now();
        let answers = session.recall(&key, question.to_bytes(), patience, ANSWERS_BYTES_MAX)?;
        while let Ok((key, bytes)) = answers.recv_timeout(patience.saturating_sub(began.elapsed()))
        {
            let key = key
                .strip_prefix(prefix)
                .and_then(|k| k.strip_prefix(PREFIX));
            let (Some(key), Some(said)) = (key, Batch::read(&bytes)) else {
                tracing::warn!(
                    "an answer that cannot be read came to a question on `{prefix}{PREFIX}**`"
                );
                continue;
            };
            let key = format!("{prefix}{key}");
            for (attachment, payload) in said.messages {
                take(recalled(&key, &said.type_name, attachment, payload));
            }
        }
        Ok(())
    }

    /// Name of the router that this process is connected to now; of the process itself where that
    /// is the router. `None` while there is none, and without a network.
    pub fn router(&self) -> Option<String> {
        self.inner.session.as_ref()?.router()
    }
}

fn recalled(key: &str, type_name: &str, attachment: Attachment, payload: &[u8]) -> RawMessage {
    RawMessage::arrived(key, type_name.to_owned(), Arrival::now(payload, attachment))
}

impl Inner {
    /// Where questions to a publisher come in; none without a network.
    pub(super) fn entrance(
        &self,
        key: &str,
        type_name: &'static str,
        publisher: [u8; 16],
        pump: Option<Thread>,
    ) -> Option<Entrance> {
        Some(Entrance {
            recall: Arc::clone(self.recall.as_ref()?),
            pump,
            key: question_key(key),
            type_name,
            publisher,
        })
    }
}
