//! A session outside any cell: its keys, payloads and liveliness tokens are used exactly as given.
//!
//! For a service that stands between a cell and another Zenoh network with a layout of its own,
//! such as that of ROS 2. The session of a cell cannot be used for it, because every key of that
//! session begins with the cell's name.

use std::sync::Arc;
use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Query;
use zenoh::sample::{Sample, SampleKind};

use super::attachment::Attachment;
use super::error::BusError;
use super::reader::Handle;
use super::role::Role;
use super::session::{Opening, Session, failed};
use crate::config::ZenohConfig;
use crate::stop::Stop;

/// A client of a router, outside any cell. Clones share the session.
#[derive(Clone)]
pub struct PlainSession {
    session: Arc<Session>,
}

/// A message on a plain session.
#[derive(Clone, Debug)]
pub struct PlainSample {
    /// Content, as it was sent.
    pub payload: Vec<u8>,
    /// Sequence number, time and publisher; `None` without an attachment of this layout.
    pub attachment: Option<Attachment>,
    /// Time of arrival here.
    pub received: Instant,
}

/// A request on a plain session. It is answered once, or not at all if it is dropped.
pub struct PlainQuery {
    /// Content, as it was sent.
    pub payload: Vec<u8>,
    /// Sequence number, time and sender; `None` without an attachment of this layout.
    pub attachment: Option<Attachment>,
    /// Time of arrival here.
    pub received: Instant,
    query: Query,
}

/// Publishes on one key of a plain session.
pub struct PlainPublisher {
    publisher: zenoh::pubsub::Publisher<'static>,
    message_max: usize,
}

fn attachment(bytes: Option<&zenoh::bytes::ZBytes>) -> Option<Attachment> {
    bytes.and_then(|bytes| Attachment::from_bytes(&bytes.to_bytes()))
}

impl PlainSession {
    /// Connects to a router at one of `endpoints`. Other settings of the network, such as the
    /// lease and the largest message, are those of `config`; certificates are used only if every
    /// endpoint needs them. Waits for a router for at most `patience`, or until `stop` is
    /// triggered.
    ///
    /// # Errors
    /// [`BusError::NoRouter`], [`BusError::Stopped`], or an endpoint that is not valid.
    pub fn open(
        config: &ZenohConfig,
        endpoints: &[String],
        patience: Option<Duration>,
        stop: &Stop,
    ) -> Result<Self, BusError> {
        let encrypted = endpoints.iter().all(|e| e.starts_with("quic/"));
        let config = ZenohConfig {
            connect: endpoints.to_vec(),
            access: None,
            tls: config.tls.clone().filter(|_| encrypted),
            ..config.clone()
        };
        let session = Session::open(Opening {
            config: &config,
            namespace: None,
            role: Role::Client,
            patience,
            stop,
            priority: None,
        })?;
        Ok(Self {
            session: Arc::new(session),
        })
    }

    /// Id of this session on the network, in hexadecimal digits.
    pub fn id(&self) -> String {
        self.session.zenoh().zid().to_string()
    }

    /// Whether a router is connected now.
    pub fn is_connected(&self) -> bool {
        self.session.router().is_some()
    }

    /// Creates a publisher. Messages are dropped and not queued when the network is busy.
    ///
    /// # Errors
    /// The key is not valid, or the session is closed.
    pub fn publisher(&self, key: &str) -> Result<PlainPublisher, BusError> {
        let _alone = self.session.declare();
        let publisher = self
            .session
            .zenoh()
            .declare_publisher(key.to_owned())
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Data)
            .wait()
            .map_err(failed(format!("publishing `{key}`")))?;
        Ok(PlainPublisher {
            publisher,
            message_max: self.session.message_max(),
        })
    }

    /// Calls `take` for every message on `key`, in a Zenoh thread, until the handle is dropped. It
    /// must not wait.
    ///
    /// # Errors
    /// The key is not valid, or the session is closed.
    pub fn subscribe(
        &self,
        key: &str,
        take: impl Fn(PlainSample) + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        let _alone = self.session.declare();
        let subscriber = self
            .session
            .zenoh()
            .declare_subscriber(key.to_owned())
            .callback(move |sample: Sample| {
                if sample.kind() == SampleKind::Put {
                    take(PlainSample {
                        payload: sample.payload().to_bytes().into_owned(),
                        attachment: attachment(sample.attachment()),
                        received: Instant::now(),
                    });
                }
            })
            .wait()
            .map_err(failed(format!("subscribing to `{key}`")))?;
        Ok(kept(subscriber))
    }

    /// Calls `take` for every request on exactly `key`, in a Zenoh thread, until the handle is
    /// dropped. It must not wait. A request with wildcards is not answered: it is for nobody in
    /// particular.
    ///
    /// # Errors
    /// The key is not valid, or the session is closed.
    pub fn answer(
        &self,
        key: &str,
        take: impl Fn(PlainQuery) + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        let _alone = self.session.declare();
        let own = key.to_owned();
        let queryable = self
            .session
            .zenoh()
            .declare_queryable(key.to_owned())
            .complete(true)
            .callback(move |query: Query| {
                if query.key_expr().as_str() != own {
                    return;
                }
                let payload = query.payload().map(|bytes| bytes.to_bytes().into_owned());
                take(PlainQuery {
                    payload: payload.unwrap_or_default(),
                    attachment: attachment(query.attachment()),
                    received: Instant::now(),
                    query,
                });
            })
            .wait()
            .map_err(failed(format!("answering on `{key}`")))?;
        Ok(kept(queryable))
    }

    /// Declares a liveliness token until the handle is dropped.
    ///
    /// # Errors
    /// The key is not valid, or the session is closed.
    pub fn token(&self, key: &str) -> Result<Handle, BusError> {
        self.session.token(key).map(kept)
    }

    /// Calls `take` for every liveliness token that matches `pattern`, present and future, with
    /// whether it appears (true) or ends.
    ///
    /// # Errors
    /// The pattern is not valid, or the session is closed.
    pub fn on_tokens(
        &self,
        pattern: &str,
        take: impl Fn(&str, bool) + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        let _alone = self.session.declare();
        let subscriber = self
            .session
            .zenoh()
            .liveliness()
            .declare_subscriber(pattern.to_owned())
            .history(true)
            .callback(move |sample: Sample| {
                take(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
            })
            .wait()
            .map_err(failed(format!("looking for `{pattern}`")))?;
        Ok(kept(subscriber))
    }

    /// Leaves the network. Dropping the last clone does the same.
    pub fn close(&self) {
        self.session.close();
    }
}

fn kept(what: impl std::any::Any + Send + Sync) -> Handle {
    let mut handle = Handle::new(|| ());
    handle.keep(what);
    handle
}

impl PlainPublisher {
    /// Sends one message in this thread; false if it was not sent, because it is too large or the
    /// session is closed.
    pub fn publish(&self, payload: &[u8], attachment: Attachment) -> bool {
        payload.len() < self.message_max
            && self
                .publisher
                .put(payload)
                .attachment(attachment.to_bytes())
                .wait()
                .is_ok()
    }
}

impl PlainQuery {
    /// Sends the answer; false if the session is closed.
    pub fn reply(self, payload: &[u8], attachment: Attachment) -> bool {
        self.query
            .reply(self.query.key_expr().clone(), payload)
            .attachment(attachment.to_bytes())
            .wait()
            .is_ok()
    }
}
