//! The Zenoh session of a bus: the far lane. Nothing else in the workspace names Zenoh.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tangent_schemas::topics::Delivery;
use tangent_schemas::{Message, tangent};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::handlers::FifoChannelHandler;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Reply};
use zenoh::sample::{Locality, Sample, SampleKind};

use super::Role;
use super::attachment::Attachment;
use super::error::BusError;
use super::raw::{RawCore, RawMessage};
use super::reader::{Arrival, ErasedReader};
use super::recall::Entrance;
use super::remarks::Remarks;
use super::session_config::session_config;
use crate::config::ZenohConfig;
use crate::realtime::setup_thread;
use crate::stop::Stop;

const CDR: &str = "application/cdr;";

/// How a session is opened.
pub(crate) struct Opening<'a> {
    pub config: &'a ZenohConfig,
    pub namespace: Option<&'a str>,
    pub role: Role,
    /// How long to wait for a router; for ever without one.
    pub patience: Option<Duration>,
    pub stop: &'a Stop,
    /// SCHED_FIFO priority of Zenoh's threads; `None` for normal scheduling.
    pub priority: Option<u8>,
}

pub(crate) struct Session {
    session: zenoh::Session,
    role: Role,
    stale_after: Duration,
    message_max: usize,
    remarks: Remarks,
    /// One declaration at a time. Zenoh 1.10.2 gives a key its number before it tells the network
    /// of it: a thread that declares the same key in between uses a number that is not known yet,
    /// and what it declared is never matched (`Session::declare_prefix`).
    declaring: Mutex<()>,
}

/// One query, ready to be sent.
pub(crate) struct Asking<'a> {
    pub payload: &'a [u8],
    pub attachment: Vec<u8>,
    pub delivery: Delivery,
    pub timeout: Duration,
}

/// Zenoh's priority, and whether a message goes out at once.
fn quality(delivery: Delivery) -> (Priority, bool) {
    match delivery {
        Delivery::RealTime => (Priority::RealTime, true),
        Delivery::Stream => (Priority::Data, false),
        Delivery::Bulk => (Priority::DataLow, false),
        Delivery::Background => (Priority::Background, false),
    }
}

fn failed(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> BusError {
    let action = action.into();
    move |error| BusError::Zenoh {
        action,
        reason: error.to_string(),
    }
}

impl Session {
    /// Opens on a thread of its own, since `open` says nothing while it waits; logs each second
    /// until it is there.
    pub(crate) fn open(opening: Opening<'_>) -> Result<Self, BusError> {
        let Opening {
            config,
            namespace,
            role,
            patience,
            stop,
            priority,
        } = opening;
        let zenoh_config = session_config(config, namespace, role, patience)?;
        let remarks = Remarks::on(config, role)?;
        remarks.log();
        let endpoints = match role {
            Role::Client => config.connect.join(", "),
            Role::Router => config.listen.join(", "),
        };
        let (sender, opened) = channel();
        let start = Instant::now();
        std::thread::Builder::new()
            .name("bus-open".into())
            .spawn(move || {
                if let Some(priority) = priority {
                    // Zenoh's threads are made by this one and inherit its scheduling.
                    setup_thread("bus", priority);
                }
                let _ = sender.send(zenoh::open(zenoh_config).wait());
            })
            .map_err(|error| BusError::Zenoh {
                action: "starting a thread".into(),
                reason: error.to_string(),
            })?;
        let mut said = 0;
        loop {
            match opened.recv_timeout(Duration::from_millis(50)) {
                Ok(Ok(session)) => {
                    tracing::debug!("{role:?} at {endpoints} after {:?}", start.elapsed());
                    return Ok(Self {
                        session,
                        role,
                        stale_after: config.stale_after(),
                        message_max: config.message_max_bytes(),
                        remarks,
                        declaring: Mutex::default(),
                    });
                }
                Ok(Err(error)) => return Err(open_error(&error, role, endpoints, patience)),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(BusError::Zenoh {
                        action: "opening the session".into(),
                        reason: "its thread panicked".into(),
                    });
                }
                Err(RecvTimeoutError::Timeout) => {
                    if stop.is_stopped() {
                        return Err(BusError::Stopped);
                    }
                    let waited = start.elapsed();
                    if let Some(patience) = patience
                        && waited > patience + Duration::from_secs(1)
                    {
                        return Err(BusError::NoRouter {
                            endpoints,
                            patience,
                        });
                    }
                    if waited.as_secs() > said {
                        said = waited.as_secs();
                        tracing::info!("waiting for a router at {endpoints}, {said} s so far");
                    }
                }
            }
        }
    }

    /// What a person should know about how this session is secured, as it stands now.
    pub(crate) fn remarks(&self) -> Vec<String> {
        self.remarks.now()
    }

    /// A process that was cut off seems to be here for so long.
    pub(crate) fn stale_after(&self) -> Duration {
        self.stale_after
    }

    fn declare(&self) -> MutexGuard<'_, ()> {
        self.declaring
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn publisher(
        &self,
        key: &OwnedKeyExpr,
        delivery: Delivery,
        type_name: &str,
        entrance: Option<Entrance>,
    ) -> Result<RemotePublisher, BusError> {
        let _alone = self.declare();
        let (priority, express) = quality(delivery);
        let publisher = self
            .session
            .declare_publisher(key.clone())
            .encoding(Encoding::APPLICATION_CDR.with_schema(type_name))
            .congestion_control(CongestionControl::Drop)
            .priority(priority)
            .express(express)
            // Readers in this process were served before; the session must not bring them the same
            // again.
            .allowed_destination(Locality::Remote)
            .wait()
            .map_err(failed(format!("publishing `{key}`")))?;
        let matching = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&matching);
        publisher
            .matching_listener()
            .callback(move |status| told.store(status.matching(), Ordering::Release))
            .background()
            .wait()
            .map_err(failed(format!("watching the readers of `{key}`")))?;
        if publisher
            .matching_status()
            .wait()
            .is_ok_and(|status| status.matching())
        {
            matching.store(true, Ordering::Release);
        }
        let questions = match entrance {
            Some(entrance) => Some(self.questions(entrance)?),
            None => None,
        };
        Ok(RemotePublisher {
            publisher,
            matching,
            questions,
            message_max: self.message_max,
            too_large: AtomicBool::new(false),
        })
    }

    pub(crate) fn subscribe(
        &self,
        pattern: &str,
        reader: Arc<dyn ErasedReader>,
    ) -> Result<zenoh::pubsub::Subscriber<()>, BusError> {
        let name = reader.message_name();
        self.subscribe_samples(pattern, move |sample, at| {
            let encoding = sample.encoding().to_string();
            let type_name = encoding.strip_prefix(CDR);
            if type_name.is_none() && *sample.encoding() != Encoding::default() {
                // Some other serialisation: let the reader refuse it by name.
                return reader.deliver_encoded(sample.key_expr().as_str(), Some(&encoding), at);
            }
            reader.deliver_encoded(sample.key_expr().as_str(), type_name, at);
        })
        .map_err(|error| match error {
            BusError::Zenoh { action, reason } => BusError::Zenoh {
                action: format!("{action} ({name})"),
                reason,
            },
            other => other,
        })
    }

    pub(crate) fn subscribe_raw(
        &self,
        pattern: &str,
        core: Arc<RawCore>,
    ) -> Result<zenoh::pubsub::Subscriber<()>, BusError> {
        self.subscribe_samples(pattern, move |sample, at| {
            let encoding = sample.encoding().to_string();
            let type_name = encoding.strip_prefix(CDR).unwrap_or_default();
            core.deliver(RawMessage::arrived(
                sample.key_expr().as_str(),
                type_name.to_owned(),
                at,
            ));
        })
    }

    fn subscribe_samples(
        &self,
        pattern: &str,
        deliver: impl Fn(&Sample, Arrival<'_>) + Send + Sync + 'static,
    ) -> Result<zenoh::pubsub::Subscriber<()>, BusError> {
        let _alone = self.declare();
        self.session
            .declare_subscriber(pattern.to_owned())
            .allowed_origin(Locality::Remote)
            .callback(move |sample: Sample| {
                if sample.kind() != SampleKind::Put {
                    return;
                }
                let attachment = sample
                    .attachment()
                    .and_then(|bytes| Attachment::from_bytes(&bytes.to_bytes()))
                    .unwrap_or_default();
                let payload = sample.payload().to_bytes();
                deliver(&sample, Arrival::now(&payload, attachment));
            })
            .wait()
            .map_err(failed(format!("subscribing to `{pattern}`")))
    }

    pub(crate) fn queryable(
        &self,
        key: &str,
        callback: impl Fn(Query) + Send + Sync + 'static,
    ) -> Result<zenoh::query::Queryable<()>, BusError> {
        let _alone = self.declare();
        self.session
            .declare_queryable(key.to_owned())
            .allowed_origin(Locality::Remote)
            .callback(callback)
            .wait()
            .map_err(failed(format!("answering on `{key}`")))
    }

    pub(crate) fn get(&self, key: &str, asking: &Asking<'_>) -> Result<Replies, BusError> {
        let (priority, express) = quality(asking.delivery);
        let replies = self
            .session
            .get(key.to_owned())
            .payload(asking.payload)
            .encoding(Encoding::APPLICATION_CDR.with_schema(tangent::Request::NAME))
            .attachment(asking.attachment.as_slice())
            .priority(priority)
            .express(express)
            .target(zenoh::query::QueryTarget::All)
            .consolidation(zenoh::query::ConsolidationMode::None)
            .allowed_destination(Locality::Remote)
            .timeout(asking.timeout)
            .wait()
            .map_err(failed(format!("asking on `{key}`")))?;
        Ok(Replies { replies })
    }

    /// Has questions for what a publisher said come in. Also those of a recorder in this process.
    /// Part of a publisher's declaration.
    fn questions(&self, entrance: Entrance) -> Result<zenoh::query::Queryable<()>, BusError> {
        let key = entrance.key.clone();
        self.session
            .declare_queryable(key.clone())
            .callback(move |query| entrance.take(query))
            .wait()
            .map_err(failed(format!("answering on `{key}`")))
    }

    /// Asks behind everything that is measured; key and payload of each answer. They end when all
    /// have answered. Beyond `bytes_max` of answers that have not been taken, further ones are
    /// dropped.
    pub(crate) fn recall(
        &self,
        key: &str,
        question: Vec<u8>,
        timeout: Duration,
        bytes_max: usize,
    ) -> Result<Receiver<(String, Vec<u8>)>, BusError> {
        let (sender, answers) = channel();
        let mut left = bytes_max;
        let callback = move |reply: Reply| {
            if let Ok(sample) = reply.into_result() {
                let bytes = sample.payload().to_bytes().into_owned();
                let Some(room) = left.checked_sub(bytes.len()) else {
                    return;
                };
                left = room;
                let _ = sender.send((sample.key_expr().to_string(), bytes));
            }
        };
        self.session
            .get(key.to_owned())
            .payload(question)
            // Answers go out as the question does.
            .priority(Priority::DataLow)
            .congestion_control(CongestionControl::Drop)
            .target(zenoh::query::QueryTarget::All)
            .consolidation(zenoh::query::ConsolidationMode::None)
            .timeout(timeout)
            .callback_mut(callback)
            .wait()
            .map_err(failed(format!("asking on `{key}`")))?;
        Ok(answers)
    }

    /// The router at the other end, or this session where it is one.
    pub(crate) fn router(&self) -> Option<String> {
        let info = self.session.info();
        if self.role == Role::Router {
            return Some(info.zid().wait().to_string());
        }
        info.routers_zid().wait().next().map(|id| id.to_string())
    }

    pub(crate) fn token(&self, key: &str) -> Result<zenoh::liveliness::LivelinessToken, BusError> {
        let _alone = self.declare();
        self.session
            .liveliness()
            .declare_token(key.to_owned())
            .wait()
            .map_err(failed(format!("declaring `{key}`")))
    }

    pub(crate) fn tokens(&self, pattern: &str, timeout: Duration) -> Result<Vec<String>, BusError> {
        let replies = self
            .session
            .liveliness()
            .get(pattern.to_owned())
            .timeout(timeout)
            .wait()
            .map_err(failed(format!("looking for `{pattern}`")))?;
        let mut keys = Vec::new();
        while let Ok(reply) = replies.recv() {
            if let Ok(sample) = reply.result() {
                keys.push(sample.key_expr().to_string());
            }
        }
        Ok(keys)
    }

    pub(crate) fn close(&self) {
        if !self.session.is_closed()
            && let Err(error) = self.session.close().wait()
        {
            tracing::warn!("leaving the network failed: {error}");
        }
    }
}

/// Answers from other processes.
pub(crate) struct Replies {
    replies: FifoChannelHandler<Reply>,
}

impl Replies {
    /// Key and payload of the next answer; `None` when no more come, or not in time.
    pub(crate) fn recv_timeout(
        &self,
        timeout: Duration,
    ) -> Option<Result<(String, Vec<u8>), String>> {
        let reply = self.replies.recv_timeout(timeout).ok()??;
        match reply.into_result() {
            Ok(sample) => Some(Ok((
                sample.key_expr().to_string(),
                sample.payload().to_bytes().into_owned(),
            ))),
            Err(error) => {
                let reason = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
                // Zenoh's own text for a missing answer.
                (reason != TIMEOUT).then_some(Err(reason))
            }
        }
    }
}

/// What Zenoh answers itself with when a query's time is up.
const TIMEOUT: &str = "Timeout";

/// The answer that it is not known whether it was done, and why.
pub(crate) fn reply_unknown(query: &Query, key: &str, reason: &str) {
    let result = query
        .reply_err(reason.as_bytes())
        .encoding(Encoding::ZENOH_STRING)
        .wait();
    if let Err(error) = result {
        tracing::warn!("{key}: an answer could not be sent: {error}");
    }
}

/// Sends one answer.
pub(crate) fn reply(query: &Query, key: &str, payload: &[u8]) {
    let result = query
        .reply(key, payload)
        .encoding(Encoding::APPLICATION_CDR.with_schema(tangent::Answer::NAME))
        .wait();
    if let Err(error) = result {
        tracing::warn!("{key}: an answer could not be sent: {error}");
    }
}

/// Sends some messages again.
pub(crate) fn reply_batch(query: &Query, key: &str, payload: &[u8]) {
    if let Err(error) = query.reply(key, payload).wait() {
        tracing::debug!("{key}: an answer could not be sent: {error}");
    }
}

/// A declared publisher, and whether anybody in another process reads it.
pub(crate) struct RemotePublisher {
    publisher: zenoh::pubsub::Publisher<'static>,
    matching: Arc<AtomicBool>,
    /// Where it is asked for what it said last; what it says is kept for that.
    questions: Option<zenoh::query::Queryable<()>>,
    message_max: usize,
    /// One was, and it was said.
    too_large: AtomicBool,
}

impl RemotePublisher {
    pub(crate) fn matches(&self) -> bool {
        self.matching.load(Ordering::Acquire)
    }

    /// What it says is to be kept.
    pub(crate) fn keeps(&self) -> bool {
        self.questions.is_some()
    }

    pub(crate) fn put(&self, payload: &[u8], attachment: Attachment) {
        if payload.len() >= self.message_max {
            if !self.too_large.swap(true, Ordering::Relaxed) {
                tracing::warn!(
                    "{}: a message of {:.1} MB is not sent, nobody would take it: zenoh.message_max_mb is {:.1} (said once)",
                    self.publisher.key_expr(),
                    payload.len() as f64 * 1e-6,
                    self.message_max as f64 * 1e-6
                );
            }
            return;
        }
        let result = self
            .publisher
            .put(payload)
            .attachment(attachment.to_bytes())
            .wait();
        if let Err(error) = result {
            // The session is closed; readers notice the silence.
            tracing::debug!("{}: {error}", self.publisher.key_expr());
        }
    }
}

fn open_error(
    error: &zenoh::Error,
    role: Role,
    endpoint: String,
    patience: Option<Duration>,
) -> BusError {
    let reason = error.to_string();
    if role == Role::Router
        && (reason.contains("Address already in use") || reason.contains("os error 98"))
    {
        return BusError::PortBusy { endpoint };
    }
    match (role, patience) {
        (Role::Client, Some(patience)) => {
            tracing::debug!("{reason}");
            BusError::NoRouter {
                endpoints: endpoint,
                patience,
            }
        }
        _ => BusError::Zenoh {
            action: format!("opening the session at {endpoint}"),
            reason,
        },
    }
}
