//! Requests and answers: somebody asks on a key, the service behind it says done, or why not.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::{Message, cdr};
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::query::Query;

use super::Inner;
use super::error::BusError;
use super::reader::Handle;
use super::registry::parse_key;
use super::session;

/// It was done.
pub fn done(message: impl Into<String>) -> Answer {
    Answer {
        done: true,
        message: message.into(),
        data: String::new(),
    }
}

/// It was done, and this came of it, as JSON.
pub fn done_with<T: Serialize + ?Sized>(message: impl Into<String>, data: &T) -> Answer {
    match serde_json::to_string(data) {
        Ok(data) => Answer {
            done: true,
            message: message.into(),
            data,
        },
        Err(error) => refused(format!("the answer cannot be written as JSON: {error}")),
    }
}

/// It was not done, and why.
pub fn refused(reason: impl Into<String>) -> Answer {
    Answer {
        done: false,
        message: reason.into(),
        data: String::new(),
    }
}

type Handler = Arc<dyn Fn(&str, Request) -> Answer + Send + Sync>;

struct Entry {
    id: u64,
    pattern: OwnedKeyExpr,
    handler: Handler,
}

/// A request from another process.
struct Job {
    query: Query,
    pattern: OwnedKeyExpr,
    handler: Handler,
}

#[derive(Default)]
struct State {
    next_id: u64,
    entries: Vec<Entry>,
}

/// Everything that answers in this process.
#[derive(Default)]
pub(crate) struct Answerers {
    state: Mutex<State>,
    /// To the answering thread; a handler may take long, and Zenoh's threads must not wait for it.
    jobs: OnceLock<SyncSender<Job>>,
}

impl Answerers {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn jobs(&self) -> SyncSender<Job> {
        self.jobs
            .get_or_init(|| {
                let (sender, receiver) = sync_channel(64);
                let spawned = std::thread::Builder::new()
                    .name("bus-answer".into())
                    .spawn(move || answer_all(&receiver));
                if let Err(error) = spawned {
                    tracing::error!("no answering thread ({error}): requests stay unanswered");
                }
                sender
            })
            .clone()
    }

    fn matching(&self, key: &OwnedKeyExpr) -> Vec<(OwnedKeyExpr, Handler)> {
        self.lock()
            .entries
            .iter()
            .filter(|entry| entry.pattern.intersects(key))
            .map(|entry| (entry.pattern.clone(), Arc::clone(&entry.handler)))
            .collect()
    }
}

pub(crate) fn declare(bus: &Arc<Inner>, key: &str, handler: Handler) -> Result<Handle, BusError> {
    let pattern = parse_key(key)?;
    let mut state = bus.answerers.lock();
    let id = state.next_id;
    state.next_id += 1;
    state.entries.push(Entry {
        id,
        pattern: pattern.clone(),
        handler: Arc::clone(&handler),
    });
    drop(state);
    let weak = Arc::downgrade(bus);
    let mut handle = Handle::new(move || {
        if let Some(bus) = weak.upgrade() {
            let mut state = bus.answerers.lock();
            let (gone, kept) = std::mem::take(&mut state.entries)
                .into_iter()
                .partition(|entry| entry.id == id);
            state.entries = kept;
            drop(state);
            // A handler may own a bus; it must not be dropped under the lock.
            let _: Vec<Entry> = gone;
        }
    });
    if let Some(session) = &bus.session {
        let jobs = bus.answerers.jobs();
        handle.keep(session.queryable(key, move |query| {
            let job = Job {
                query,
                pattern: pattern.clone(),
                handler: Arc::clone(&handler),
            };
            if jobs.try_send(job).is_err() {
                tracing::warn!("{pattern}: too many requests at once, one is left unanswered");
            }
        })?);
    }
    Ok(handle)
}

fn answer_all(jobs: &Receiver<Job>) {
    let mut scratch = Vec::new();
    for job in jobs {
        let key = job.query.key_expr().as_str();
        let payload = job.query.payload().map(|payload| payload.to_bytes());
        let answer = match cdr::decode::<Request>(payload.as_deref().unwrap_or_default()) {
            Ok(request) => (job.handler)(key, request),
            Err(error) => refused(format!(
                "the request cannot be read as {}: {error}",
                Request::NAME
            )),
        };
        let key = reply_key(job.query.key_expr().as_str(), &job.pattern);
        match cdr::encode(&answer, &mut scratch) {
            Ok(()) => session::reply(&job.query, &key, &scratch),
            Err(error) => tracing::warn!("{key}: an answer cannot be encoded: {error}"),
        }
    }
}

/// The key an answer goes out under: the one asked, or for a question to many the answerer's own.
fn reply_key(asked: &str, pattern: &OwnedKeyExpr) -> String {
    if asked.contains('*') {
        pattern.to_string()
    } else {
        asked.to_owned()
    }
}

pub(crate) fn ask(
    bus: &Arc<Inner>,
    key: &str,
    request: &Request,
    timeout: Duration,
) -> Result<Answer, BusError> {
    let parsed = parse_key(key)?;
    // In the same process an answer needs no network: `stop` works also when the router is gone.
    if let Some((_, handler)) = bus.answerers.matching(&parsed).into_iter().next() {
        return Ok(handler(key, request.clone()));
    }
    let no_answer = || BusError::NoAnswer {
        key: key.to_owned(),
        timeout,
    };
    let session = bus.session.as_ref().ok_or_else(no_answer)?;
    let mut payload = Vec::new();
    encode(key, request, &mut payload)?;
    let replies = session.get(key, &payload, timeout)?;
    match replies.recv_timeout(timeout) {
        Some(Ok((_, bytes))) => decode(key, &bytes),
        Some(Err(reason)) => Err(BusError::BadAnswer {
            key: key.to_owned(),
            reason,
        }),
        None => Err(no_answer()),
    }
}

pub(crate) fn ask_all(
    bus: &Arc<Inner>,
    key: &str,
    request: &Request,
    timeout: Duration,
) -> Result<Vec<(String, Answer)>, BusError> {
    let parsed = parse_key(key)?;
    let mut answers: Vec<(String, Answer)> = bus
        .answerers
        .matching(&parsed)
        .into_iter()
        .map(|(pattern, handler)| (reply_key(key, &pattern), handler(key, request.clone())))
        .collect();
    if let Some(session) = &bus.session {
        let mut payload = Vec::new();
        encode(key, request, &mut payload)?;
        let deadline = Instant::now() + timeout;
        let replies = session.get(key, &payload, timeout)?;
        while let Some(reply) =
            replies.recv_timeout(deadline.saturating_duration_since(Instant::now()))
        {
            match reply {
                Ok((from, bytes)) => answers.push((from, decode(key, &bytes)?)),
                Err(reason) => tracing::warn!("{key}: an answer was refused: {reason}"),
            }
        }
    }
    Ok(answers)
}

fn encode(key: &str, request: &Request, payload: &mut Vec<u8>) -> Result<(), BusError> {
    cdr::encode(request, payload).map_err(|error| BusError::Zenoh {
        action: format!("asking on `{key}`"),
        reason: error.to_string(),
    })
}

fn decode(key: &str, bytes: &[u8]) -> Result<Answer, BusError> {
    cdr::decode(bytes).map_err(|error| BusError::BadAnswer {
        key: key.to_owned(),
        reason: error.to_string(),
    })
}
