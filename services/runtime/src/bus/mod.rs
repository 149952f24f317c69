//! The bus: typed publish, latest, subscribe and request, independent of the transport.
//!
//! There are two paths. Readers in the same process get a message inside `publish`, in the sender's
//! thread, through lock-free slots or a direct call. Readers in other processes get it from a
//! publishing thread, which encodes it as CDR and calls Zenoh. A Zenoh `put` can take milliseconds
//! and drop a message silently, so a control loop must never call it.

mod alive;
pub mod answer;
mod attachment;
mod budget;
mod error;
mod guard;
mod history;
mod keys;
mod lane;
mod latest;
mod outlet;
mod plain;
mod publisher;
mod pump;
mod question;
mod raw;
mod raw_reader;
mod reader;
mod recall;
mod refused;
mod registry;
mod remarks;
mod remote_publisher;
mod replies;
mod requests;
mod role;
mod session;
mod session_config;
mod sleeper;
mod source;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tangent_schemas::Message;
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::Topic;

pub use alive::{Alive, AliveToken};
pub use answer::{Asked, Reply};
pub use attachment::Attachment;
pub use error::BusError;
pub use lane::Lane;
pub use latest::Latest;
pub use plain::{PlainPublisher, PlainQuery, PlainSample, PlainSession};
pub use publisher::{Publisher, RawPublisher};
pub use question::{Question, SPANS_MAX, Span};
pub use raw::{PushedOut, RawMessage};
pub use raw_reader::RawSubscription;
pub use reader::{Counts, Handle, Received, Subscription};
pub use refused::Refused;
pub use role::Role;

use crate::config::{CellConfig, ZenohConfig};
use crate::stop::Stop;
use attachment::BusId;
use reader::{ReaderCore, Sink};
use registry::Registry;
use session::{Opening, Session};
use source::Admission;

/// A cell's bus. Clones are cheap and share one session.
#[derive(Clone)]
pub struct Bus {
    inner: Arc<Inner>,
}

pub(crate) struct Inner {
    name: String,
    registry: Arc<Registry>,
    ids: BusId,
    names: refused::Names,
    pump: pump::Pump,
    recall: Option<Arc<recall::Recall>>,
    answerers: requests::Answerers,
    tokens: Mutex<Vec<Alive>>,
    session: Option<Session>,
}

impl Bus {
    /// A bus without any network, for tests and for closed loops within one process.
    pub fn in_process(name: &str) -> Self {
        Self::assemble(name, None, None)
    }

    /// Joins the cell's network. Waits for the router without a time limit, with a log line each
    /// second.
    ///
    /// # Errors
    /// The endpoint is invalid or in use. See also [`Bus::open_within`].
    pub fn open(config: &CellConfig, role: Role) -> Result<Self, BusError> {
        Self::open_until(config, role, None, &Stop::new())
    }

    /// Joins the cell's network. Waits for the router for at most `patience`, for commands that a
    /// person waits for.
    ///
    /// # Errors
    /// [`BusError::NoRouter`] if no router answers in time; [`BusError::PortBusy`] for a router
    /// whose port is taken.
    pub fn open_within(
        config: &CellConfig,
        role: Role,
        patience: Duration,
    ) -> Result<Self, BusError> {
        Self::join(config, role, Some(patience), &Stop::new(), None)
    }

    /// Joins the cell's network for a service. Waits for the router for at most `patience`, or
    /// until `stop` is triggered. If the cell asks for real-time scheduling, the threads of the bus
    /// get it too, as messages wait for them under load.
    ///
    /// # Errors
    /// As [`Bus::open_within`], and [`BusError::Stopped`].
    pub fn open_until(
        config: &CellConfig,
        role: Role,
        patience: Option<Duration>,
        stop: &Stop,
    ) -> Result<Self, BusError> {
        let realtime = &config.realtime;
        let priority = realtime.enabled.then_some(realtime.bus_priority);
        Self::join(config, role, patience, stop, priority)
    }

    fn join(
        config: &CellConfig,
        role: Role,
        patience: Option<Duration>,
        stop: &Stop,
        priority: Option<u8>,
    ) -> Result<Self, BusError> {
        let session = Session::open(Opening {
            config: &config.zenoh,
            namespace: Some(config.cell.name.as_str()),
            role,
            patience,
            stop,
            priority,
        })?;
        Ok(Self::assemble(&config.cell.name, Some(session), priority))
    }

    /// Joins the network outside any cell: keys begin with the cell's name, and `*/health/*` reads
    /// the health of every cell.
    ///
    /// # Errors
    /// As [`Bus::open_within`].
    pub fn open_network(config: &ZenohConfig, patience: Duration) -> Result<Self, BusError> {
        let session = Session::open(Opening {
            config,
            namespace: None,
            role: Role::Client,
            patience: Some(patience),
            stop: &Stop::new(),
            priority: None,
        })?;
        Ok(Self::assemble("", Some(session), None))
    }

    /// Checks that a router with certificates would accept the cell's current access rules. Without
    /// certificates there are none.
    ///
    /// # Errors
    /// What is wrong with the file, and what to do about it.
    pub fn check_access(config: &ZenohConfig) -> Result<(), BusError> {
        match config.tls {
            Some(_) => session_config::check_access(config),
            None => Ok(()),
        }
    }

    /// Checks that a router may listen where the cell says.
    ///
    /// # Errors
    /// [`BusError::Open`]: it would listen beyond this host without certificates, and the file does
    /// not allow it.
    pub fn check_listeners(config: &ZenohConfig) -> Result<(), BusError> {
        remarks::open_listener(config).map(drop)
    }

    fn assemble(name: &str, session: Option<Session>, priority: Option<u8>) -> Self {
        let registry = Arc::new(Registry::default());
        let recall = session.as_ref().map(|_| recall::Recall::start());
        Self {
            inner: Arc::new(Inner {
                name: name.to_owned(),
                pump: pump::Pump::start(priority, recall.clone()),
                recall,
                registry,
                ids: BusId::new(),
                names: refused::Names::default(),
                answerers: requests::Answerers::new(priority),
                tokens: Mutex::default(),
                session,
            }),
        }
    }

    /// The cell's name; empty outside any cell.
    pub fn cell(&self) -> &str {
        &self.inner.name
    }

    /// Creates a publisher for one topic. Each has its own id and counts its own sequence.
    ///
    /// # Errors
    /// The key has wildcards, or is in use with another message type.
    pub fn publisher<M: Message>(&self, topic: &Topic<M>) -> Result<Publisher<M>, BusError> {
        Publisher::declare(&self.inner, topic)
    }

    /// Reads only the newest message of a topic.
    ///
    /// # Errors
    /// The key is not valid, or is in use with another message type.
    pub fn latest<M: Message>(&self, topic: &Topic<M>) -> Result<Latest<M>, BusError> {
        let (core, output) = ReaderCore::newest(self.admission(topic));
        let core = Arc::new(core);
        let handle = self.register(topic, &core)?;
        Ok(Latest::new(core, output, handle))
    }

    /// Reads every message of a topic through a queue of `capacity`. When it is full, the oldest
    /// message is dropped and counted.
    ///
    /// # Errors
    /// The key is not valid, or is in use with another message type.
    pub fn subscribe<M: Message>(
        &self,
        topic: &Topic<M>,
        capacity: usize,
    ) -> Result<Subscription<M>, BusError> {
        let core = Arc::new(ReaderCore::new(
            Sink::queue(capacity),
            self.admission(topic),
        ));
        let handle = self.register(topic, &core)?;
        Ok(Subscription::new(core, handle))
    }

    /// Calls `callback` for every message until the handle is dropped. For messages of the same
    /// process it runs inside `publish`, in the publisher's thread, in the order of registration;
    /// for others, in a Zenoh thread. It must be short and must not wait. A callback that publishes
    /// on its own topic is not called recursively: that message is counted as dropped.
    ///
    /// # Errors
    /// The key is not valid, or is in use with another message type.
    pub fn on<M: Message>(
        &self,
        topic: &Topic<M>,
        callback: impl FnMut(&Received<M>) + Send + 'static,
    ) -> Result<Handle, BusError> {
        let core = Arc::new(ReaderCore::new(
            Sink::callback(callback),
            self.admission(topic),
        ));
        self.register(topic, &core)
    }

    fn admission<M: Message>(&self, topic: &Topic<M>) -> Admission {
        Admission::new(topic.sources(), self.inner.ids.clone())
    }

    /// Publishers that readers of this bus refuse now, and the number of samples refused so far:
    /// one entry per topic.
    pub fn refused(&self) -> Vec<Refused> {
        refused::list(&self.inner)
    }

    /// Learns the name behind each publisher's id, for [`Bus::refused`]. [`crate::HealthReporter`]
    /// calls this for services.
    ///
    /// # Errors
    /// The bus refused the topic.
    pub(crate) fn learn_names(&self) -> Result<Handle, BusError> {
        refused::learn(self)
    }

    fn register<M: Message>(
        &self,
        topic: &Topic<M>,
        core: &Arc<ReaderCore<M>>,
    ) -> Result<Handle, BusError> {
        let mut handle = registry::add_reader(&self.inner.registry, topic.key(), core)?;
        if let Some(session) = &self.inner.session {
            handle.keep(session.subscribe(topic.key(), Arc::clone(core) as _)?);
        }
        Ok(handle)
    }

    /// Reads every message on keys that match `pattern`, encoded, from this process and from
    /// others. For the recorder.
    ///
    /// # Errors
    /// The pattern is not valid.
    pub fn subscribe_raw(
        &self,
        pattern: &str,
        capacity: usize,
    ) -> Result<RawSubscription, BusError> {
        self.subscribe_raw_all(&[pattern.to_owned()], capacity)
    }

    /// Reads every message on keys that match any of `patterns`, encoded, through one queue. A
    /// message that matches two of them arrives twice.
    ///
    /// # Errors
    /// A pattern is not valid.
    pub fn subscribe_raw_all(
        &self,
        patterns: &[String],
        capacity: usize,
    ) -> Result<RawSubscription, BusError> {
        raw_reader::subscribe(&self.inner, patterns, capacity)
    }

    /// Creates a publisher of messages that are already encoded, for replay. Not for real-time
    /// threads.
    ///
    /// # Errors
    /// The key has wildcards.
    pub fn raw_publisher(&self, key: &str, type_name: &str) -> Result<RawPublisher, BusError> {
        RawPublisher::declare(&self.inner, key, type_name)
    }

    /// Answers requests on `key`, which may contain wildcards. The handler gets the requested key,
    /// and must not wait for anything. Requests from this process run in the caller's thread;
    /// others run in the answering thread of the bus, one after another. A request whose time is up
    /// is refused before it reaches the handler.
    ///
    /// # Errors
    /// The key is not valid.
    pub fn answer(
        &self,
        key: &str,
        handler: impl Fn(&str, Request) -> Answer + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        self.answer_in(
            key,
            |_| Lane::Prompt,
            move |asked| handler(&asked.key, asked.request).into(),
        )
    }

    /// Answers requests on `key`, each in the thread of the lane that `lane` selects, with its
    /// deadline; after that the handler must have no effect. For requests that wait for something,
    /// and for those that must never wait.
    ///
    /// # Errors
    /// The key is not valid.
    pub fn answer_in(
        &self,
        key: &str,
        lane: impl Fn(&Request) -> Lane + Send + Sync + 'static,
        handler: impl Fn(Asked) -> Reply + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        requests::declare(&self.inner, key, Arc::new(lane), None, Arc::new(handler))
    }

    /// Answers requests on `key` that take time, and may be refused at once. `judge` says why a
    /// request is refused, in the urgent lane: it does not wait for requests that are under way.
    /// An allowed request passes to the slow lane, where it is judged again when its turn comes,
    /// and then handled.
    ///
    /// # Errors
    /// A bad key.
    pub fn answer_judged(
        &self,
        key: &str,
        judge: impl Fn(&Asked) -> Option<Answer> + Send + Sync + 'static,
        handler: impl Fn(Asked) -> Reply + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        let judge: answer::Judge = Arc::new(judge);
        let first = Arc::clone(&judge);
        let handler = move |asked: Asked| match judge(&asked) {
            Some(answer) => answer.into(),
            None => handler(asked),
        };
        let lane = Arc::new(|_: &Request| Lane::Slow);
        requests::declare(&self.inner, key, lane, Some(first), Arc::new(handler))
    }

    /// Sends a request and waits for the first answer. The request may be carried out only within
    /// the first four fifths of `timeout`, or up to 1 s before its end if that is later. After that
    /// it is refused.
    ///
    /// # Errors
    /// [`BusError::NoAnswer`] if there is no answer in time, [`BusError::Unknown`] if the service
    /// does not know the outcome. In both cases the request may have been carried out.
    pub fn ask(&self, key: &str, request: &Request, timeout: Duration) -> Result<Answer, BusError> {
        requests::ask(&self.inner, key, request, timeout)
    }

    /// Sends a request to all services whose key matches, and waits until all have answered or the
    /// time is up.
    ///
    /// # Errors
    /// The key is not valid, or the session is closed.
    pub fn ask_all(
        &self,
        key: &str,
        request: &Request,
        timeout: Duration,
    ) -> Result<Vec<(String, Answer)>, BusError> {
        requests::ask_all(&self.inner, key, request, timeout)
    }

    /// Declares a service as running until the token is dropped. [`crate::HealthReporter`] calls
    /// this for services.
    ///
    /// # Errors
    /// A name is not valid in a key.
    pub fn declare_alive(&self, service: &str, instance: &str) -> Result<AliveToken, BusError> {
        alive::declare(&self.inner, service, instance)
    }

    /// Declares a service as running that may run only once in a cell; refused if it already runs,
    /// here or elsewhere. [`crate::HealthReporter::start_only`] calls this for services.
    ///
    /// # Errors
    /// [`BusError::Taken`], with the place where it runs; see also [`Bus::declare_alive`].
    pub fn claim_alive(&self, service: &str, instance: &str) -> Result<AliveToken, BusError> {
        alive::claim(&self.inner, service, instance)
    }

    /// All services running now, in this process and on the network, sorted.
    ///
    /// # Errors
    /// The session is closed.
    pub fn alive(&self, timeout: Duration) -> Result<Vec<Alive>, BusError> {
        alive::list(&self.inner, "*", timeout)
    }

    /// Estimators that publish normals: name and process of each, sorted. They are found by
    /// liveliness tokens, which [`Bus::declare_alive`] creates for a
    /// [`tangent_schemas::topics::estimator_service`].
    ///
    /// # Errors
    /// The session is closed.
    pub fn alive_estimators(&self, timeout: Duration) -> Result<Vec<(String, String)>, BusError> {
        let service = tangent_schemas::topics::estimator_service("*");
        let alive = alive::list(&self.inner, &service, timeout)?;
        let named = alive.into_iter().filter_map(|alive| {
            let (_, name) = alive.service.split_once('/')?;
            Some((name.to_owned(), alive.instance))
        });
        Ok(named.collect())
    }

    /// Whether there is a network session; false for [`Bus::in_process`].
    pub fn is_networked(&self) -> bool {
        self.inner.session.is_some()
    }

    /// Remarks about this process's place on the network that are not faults, such as a router that
    /// is open to anybody or a certificate that expires soon. [`crate::HealthReporter`] publishes
    /// them.
    pub fn remarks(&self) -> Vec<String> {
        let session = self.inner.session.as_ref().map(Session::remarks);
        let mut all = session.unwrap_or_default();
        all.extend(self.inner.registry.raw_remarks());
        all
    }

    /// Number of messages for other processes that were dropped before they were sent, as the
    /// publishing thread fell behind.
    pub fn dropped(&self) -> u64 {
        self.inner.pump.dropped()
    }

    /// Sends what is queued, then leaves the network. Dropping the last clone does the same.
    pub fn close(&self) {
        self.inner.shut_down();
    }
}

impl Inner {
    fn shut_down(&self) {
        self.pump.stop();
        if let Some(session) = &self.session {
            session.close();
        }
    }

    /// Whether it is a service of this process.
    fn is_local(&self, alive: &Alive) -> bool {
        self.lock_tokens().contains(alive)
    }

    fn lock_tokens(&self) -> std::sync::MutexGuard<'_, Vec<Alive>> {
        self.tokens.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.shut_down();
    }
}
