//! Handlers of requests in this process, and requests to other processes.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tangent_schemas::cdr;
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::queries;
use zenoh::key_expr::OwnedKeyExpr;

use super::Inner;
use super::answer::{Asked, Handler, Judge, Reply, reply_key};
use super::attachment::Attachment;
use super::budget::Budget;
use super::error::BusError;
use super::lane::{self, Entrance, Jobs, LaneOf};
use super::reader::Handle;
use super::registry::parse_key;
use super::replies::UnknownOutcome;
use super::session::Asking;
use crate::clock::now_ns;

struct Entry {
    id: u64,
    pattern: OwnedKeyExpr,
    handler: Handler,
}

#[derive(Default)]
struct State {
    next_id: u64,
    entries: Vec<Entry>,
}

/// All request handlers of this process.
#[derive(Default)]
pub(crate) struct Answerers {
    state: Mutex<State>,
    /// The lane that all keys share.
    prompt: OnceLock<Jobs>,
    /// SCHED_FIFO priority of the urgent lanes' threads; `None` for normal scheduling.
    priority: Option<u8>,
    /// Id under which this bus sends queries.
    asker: OnceLock<[u8; 16]>,
    asked: AtomicU64,
}

impl Answerers {
    /// Without any handler. `priority` is the SCHED_FIFO priority of the urgent lanes' threads.
    pub fn new(priority: Option<u8>) -> Self {
        Self {
            priority,
            ..Self::default()
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
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

pub(crate) fn declare(
    bus: &Arc<Inner>,
    key: &str,
    lane: LaneOf,
    judge: Option<Judge>,
    handler: Handler,
) -> Result<Handle, BusError> {
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
        let prompt = bus
            .answerers
            .prompt
            .get_or_init(|| lane::start("bus-answer", None))
            .clone();
        let entrance = Entrance {
            pattern,
            handler,
            lane,
            judge,
            prompt,
            slow: OnceLock::new(),
            urgent: OnceLock::new(),
            priority: bus.answerers.priority,
        };
        handle.keep(session.queryable(key, move |query| entrance.take(query))?);
    }
    Ok(handle)
}

pub(crate) fn ask(
    bus: &Arc<Inner>,
    key: &str,
    request: &Request,
    timeout: Duration,
) -> Result<Answer, BusError> {
    let parsed = parse_key(key)?;
    // Within the same process a request needs no network: `stop` works even when the router is
    // down.
    if let Some((_, handler)) = bus.answerers.matching(&parsed).into_iter().next() {
        return known(key, handler(Asked::now(key, request, timeout)));
    }
    let began = Instant::now();
    let no_answer = || BusError::NoAnswer {
        key: key.to_owned(),
        waited: began.elapsed(),
    };
    let session = bus.session.as_ref().ok_or_else(no_answer)?;
    let mut payload = Vec::new();
    encode(key, request, &mut payload)?;
    let replies = session.get(key, &asking(bus, key, request, &payload, timeout))?;
    match replies.recv_timeout(timeout) {
        Some(Ok((_, bytes))) => decode(key, &bytes),
        Some(Err(UnknownOutcome(reason))) => Err(BusError::Unknown {
            key: key.to_owned(),
            reason,
        }),
        None => Err(no_answer()),
    }
}

/// All queries of a bus have the same id, and are numbered from 1.
fn asking<'a>(
    bus: &Inner,
    key: &str,
    request: &Request,
    payload: &'a [u8],
    timeout: Duration,
) -> Asking<'a> {
    let own = &bus.answerers;
    let attachment = Attachment {
        sequence: own.asked.fetch_add(1, Ordering::Relaxed) + 1,
        source_time_ns: now_ns(),
        publisher: *own.asker.get_or_init(|| bus.ids.next()),
    };
    Asking {
        payload,
        attachment: Budget::within(timeout).to_bytes(attachment).to_vec(),
        delivery: queries::delivery(key, &request.action),
        timeout,
    }
}

fn known(key: &str, reply: Reply) -> Result<Answer, BusError> {
    match reply {
        Reply::Answered(answer) => Ok(answer),
        Reply::Unknown(reason) => Err(BusError::Unknown {
            key: key.to_owned(),
            reason,
        }),
    }
}

pub(crate) fn ask_all(
    bus: &Arc<Inner>,
    key: &str,
    request: &Request,
    timeout: Duration,
) -> Result<Vec<(String, Answer)>, BusError> {
    let parsed = parse_key(key)?;
    let mut answers = Vec::new();
    for (pattern, handler) in bus.answerers.matching(&parsed) {
        match known(key, handler(Asked::now(key, request, timeout))) {
            Ok(answer) => answers.push((reply_key(key, &pattern), answer)),
            Err(error) => tracing::warn!("{error}"),
        }
    }
    if let Some(session) = &bus.session {
        let mut payload = Vec::new();
        encode(key, request, &mut payload)?;
        let deadline = Instant::now() + timeout;
        let replies = session.get(key, &asking(bus, key, request, &payload, timeout))?;
        while let Some(reply) =
            replies.recv_timeout(deadline.saturating_duration_since(Instant::now()))
        {
            match reply {
                Ok((from, bytes)) => answers.push((from, decode(key, &bytes)?)),
                Err(reason) => tracing::warn!("{key}: one answer is unknown: {reason}"),
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
