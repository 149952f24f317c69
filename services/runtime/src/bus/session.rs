//! The Zenoh session of a bus: the path to other processes. No other module of the workspace uses
//! Zenoh.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tangent_schemas::topics::Delivery;
use tangent_schemas::{Message, tangent};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Reply};
use zenoh::sample::{Locality, Sample, SampleKind};

use super::attachment::Attachment;
use super::error::BusError;
use super::raw::{RawCore, RawMessage};
use super::reader::{Arrival, ErasedReader};
use super::remarks::Remarks;
use super::remote_publisher::RemotePublisher;
use super::replies::Replies;
use super::role::Role;
use super::session_config::session_config;
use crate::config::ZenohConfig;
use crate::places::without_places;
use crate::realtime::setup_thread;
use crate::stop::Stop;

const CDR: &str = "application/cdr;";

/// How a session is opened.
pub(crate) struct Opening<'a> {
    pub config: &'a ZenohConfig,
    pub namespace: Option<&'a str>,
    pub role: Role,
    /// Time to wait for a router; `None`: without limit.
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
    /// Only one declaration at a time. Zenoh 1.10.2 assigns a number to a key before it announces
    /// the key to the network. A thread that declares the same key in between uses a number that is
    /// not known yet, and its declaration never matches (`Session::declare_prefix`).
    declaring: Mutex<()>,
}

/// Keys and handler of questions for a publisher's recent messages. The handler runs in Zenoh's
/// thread, so it must not wait.
pub(crate) struct Questions {
    pub key: String,
    pub take: Box<dyn Fn(Query) + Send + Sync>,
}

/// One query, ready to be sent.
pub(crate) struct Asking<'a> {
    pub payload: &'a [u8],
    pub attachment: Vec<u8>,
    pub delivery: Delivery,
    pub timeout: Duration,
}

/// Zenoh's priority for this delivery, and whether messages are sent without batching.
fn quality(delivery: Delivery) -> (Priority, bool) {
    match delivery {
        Delivery::RealTime => (Priority::RealTime, true),
        Delivery::Stream => (Priority::Data, false),
        Delivery::Bulk => (Priority::DataLow, false),
        Delivery::Background => (Priority::Background, false),
    }
}

pub(super) fn failed(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> BusError {
    let action = action.into();
    move |error| BusError::Zenoh {
        action,
        reason: without_places(&error.to_string()).into_owned(),
    }
}

impl Session {
    /// Opens the session in a separate thread, as `open` logs nothing while it waits. This function
    /// logs each second until the session is open.
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
                    // Zenoh's threads are created by this one and inherit its scheduling.
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

    /// Remarks on the security of this session that apply now.
    pub(crate) fn remarks(&self) -> Vec<String> {
        self.remarks.now()
    }

    /// The session itself, for [`super::plain`].
    pub(super) fn zenoh(&self) -> &zenoh::Session {
        &self.session
    }

    /// Messages of this many bytes or more are not sent.
    pub(super) fn message_max(&self) -> usize {
        self.message_max
    }

    /// Time for which a process that was cut off still appears to be running.
    pub(crate) fn stale_after(&self) -> Duration {
        self.stale_after
    }

    pub(super) fn declare(&self) -> MutexGuard<'_, ()> {
        self.declaring
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn publisher(
        &self,
        key: &OwnedKeyExpr,
        delivery: Delivery,
        type_name: &str,
        questions: Option<Questions>,
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
            // Readers in this process have already got the message; the session must not deliver it
            // to them again.
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
        let questions = questions
            .map(|questions| self.questions(questions))
            .transpose()?;
        Ok(RemotePublisher::new(
            publisher,
            matching,
            questions,
            self.message_max,
        ))
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
                // Encoded in another way: the reader refuses it by the name of its type.
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
        Ok(Replies::new(replies))
    }

    /// Receives questions for a publisher's recent messages, also from a recorder in this process.
    /// Part of a publisher's declaration.
    fn questions(&self, questions: Questions) -> Result<zenoh::query::Queryable<()>, BusError> {
        let Questions { key, take } = questions;
        self.session
            .declare_queryable(key.clone())
            .callback(take)
            .wait()
            .map_err(failed(format!("answering on `{key}`")))
    }

    /// Sends a question with a lower priority than measurements. Returns key and payload of each
    /// answer, until all have answered. Once answers of `bytes_max` bytes wait to be read, further
    /// ones are dropped.
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
            // Answers have the priority of the question.
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

    /// Name of the connected router, or of this session if it is the router.
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
            reason: without_places(&reason).into_owned(),
        },
    }
}
