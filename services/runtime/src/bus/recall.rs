//! Resending of messages that a recorder missed: a thread of each process answers from the kept
//! messages.
//!
//! Zenoh's thread checks a question, the publishing thread hands over the kept messages without
//! copying them, and a third thread sends the answers at a bounded rate. The number of questions in
//! progress is bounded; further ones get no answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Thread;
use std::time::{Duration, Instant};

use zenoh::query::Query;

use super::attachment::Attachment;
use super::error::BusError;
use super::history::Block;
use super::question::{Batch, PREFIX, Question, Span, question_key};
use super::raw::RawMessage;
use super::reader::Arrival;
use super::replies::reply_batch;
use super::session::Questions;
use super::{Bus, Inner};
use crate::ring::Ring;

/// Largest number of questions in progress in one process: twice one question to each publisher of
/// a process that runs all services.
const UNDER_WAY_MAX: usize = 64;
/// Size at which a batch is sent, bytes: with one more message it still fits into one packet.
const BATCH_BYTES: usize = 32 << 10;
/// Largest rate of resending, bytes/s, besides what is published.
const BYTES_PER_S: f64 = 8e6;
/// Pause between two questions.
const PAUSE: Duration = Duration::from_millis(1);
/// Time after which the sender of a question has given up.
const ANSWER_WITHIN: Duration = Duration::from_secs(6);
/// Largest size of the answers to one question that its sender buffers, bytes.
const ANSWERS_BYTES_MAX: usize = 256 << 20;

/// A question to one publisher of this process, on its way to the kept messages.
pub(crate) struct Ask {
    query: Query,
    key: String,
    type_name: &'static str,
    pub(super) publisher: [u8; 16],
    spans: Vec<Span>,
    asked: Instant,
    _place: Place,
}

/// Counts as one question in progress until it is dropped.
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

/// The questions in progress in this process, and the thread that answers them; it ends when this
/// value is dropped.
pub(crate) struct Recall {
    under_way: Arc<AtomicUsize>,
    asks: Ring<Ask>,
    jobs: SyncSender<Job>,
}

impl Recall {
    pub(crate) fn start() -> Arc<Self> {
        let (jobs, waiting) = sync_channel(UNDER_WAY_MAX);
        let spawned = std::thread::Builder::new()
            .name("bus-recall".into())
            .spawn(move || answer_all(&waiting));
        if let Err(error) = spawned {
            tracing::error!(
                "the thread that repeats missed messages could not be started: {error}"
            );
        }
        Arc::new(Self {
            under_way: Arc::default(),
            asks: Ring::new(UNDER_WAY_MAX),
            jobs,
        })
    }

    /// The next question that waits for the publishing thread.
    pub(crate) fn next(&self) -> Option<Ask> {
        self.asks.pop()
    }

    /// Queues the question for an answer from these blocks. Never waits.
    pub(crate) fn answer(&self, ask: Ask, blocks: Vec<Arc<Block>>) {
        // If the queue is full, no answer is sent, and the recorder asks again.
        let _ = self.jobs.try_send(Job { ask, blocks });
    }

    fn place(&self) -> Option<Place> {
        let taken = self.under_way.fetch_add(1, Ordering::Relaxed);
        let place = Place(Arc::clone(&self.under_way));
        (taken < UNDER_WAY_MAX).then_some(place)
    }
}

/// Receives the questions to one publisher.
struct Entrance {
    recall: Arc<Recall>,
    pump: Option<Thread>,
    key: String,
    type_name: &'static str,
    publisher: [u8; 16],
}

impl Entrance {
    /// Accepts one question, or leaves it without an answer. Runs in Zenoh's thread, so it never
    /// waits.
    fn take(&self, query: Query) {
        let question = query
            .payload()
            .and_then(|payload| Question::from_bytes(&payload.to_bytes()));
        let Some(spans) = question.and_then(|question| question.of(self.publisher)) else {
            return;
        };
        let Some(place) = self.recall.place() else {
            tracing::debug!("{}: too many queries for missed messages", self.key);
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
    reply_batch(&ask.query, &ask.key, batch.bytes());
    std::thread::sleep(Duration::from_secs_f64(
        batch.bytes().len() as f64 / BYTES_PER_S,
    ));
    batch.clear();
}

impl Bus {
    /// Asks every publisher of a cell for messages that it still has (about the last 12 s, no
    /// images), waits until all have answered or `patience` is over, and passes each message to
    /// `take`. `prefix` precedes the cell's keys: `CELL/` on a bus outside any cell, otherwise
    /// empty. Without a network, no messages are kept and none are returned.
    ///
    /// # Errors
    /// The key is not valid, or the session is closed.
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
                    "an answer that cannot be decoded arrived for the query on `{prefix}{PREFIX}**`"
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

    /// Name of the router that this process is connected to now, or of the process itself if it is
    /// the router. `None` while there is no router, and without a network.
    pub fn router(&self) -> Option<String> {
        self.inner.session.as_ref()?.router()
    }
}

fn recalled(key: &str, type_name: &str, attachment: Attachment, payload: &[u8]) -> RawMessage {
    RawMessage::arrived(key, type_name.to_owned(), Arrival::now(payload, attachment))
}

impl Inner {
    /// Receiver of questions to a publisher; `None` without a network.
    pub(super) fn questions(
        &self,
        key: &str,
        type_name: &'static str,
        publisher: [u8; 16],
        pump: Option<Thread>,
    ) -> Option<Questions> {
        let entrance = Entrance {
            recall: Arc::clone(self.recall.as_ref()?),
            pump,
            key: question_key(key),
            type_name,
            publisher,
        };
        Some(Questions {
            key: entrance.key.clone(),
            take: Box::new(move |query| entrance.take(query)),
        })
    }
}
