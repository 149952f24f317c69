//! The bus: typed publish, latest, subscribe and ask, whatever lies beneath.
//!
//! Two lanes. Readers in the same process get a message inside `publish`, in the sender's thread, through lock-free
//! slots or a direct call. Everybody else gets it from a publishing thread, which encodes it as CDR and calls Zenoh; a
//! Zenoh `put` can take milliseconds and drop without a word, so a control loop must never call it.

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
mod publisher;
mod question;
mod raw;
mod raw_reader;
mod reader;
mod recall;
mod refused;
mod registry;
mod remarks;
mod requests;
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
pub use error::BusError;
pub use lane::Lane;
pub use latest::Latest;
pub use publisher::{Publisher, RawPublisher};
pub use question::{Question, SPANS_MAX, Span};
pub use raw::{PushedOut, RawMessage};
pub use raw_reader::RawSubscription;
pub use reader::{Counts, Handle, Received, Subscription};
pub use refused::Refused;

use crate::config::{CellConfig, ZenohConfig};
use crate::stop::Stop;
use attachment::BusId;
use reader::{ReaderCore, Sink};
use registry::Registry;
use session::{Opening, Session};
use source::Admission;

/// What a session is to the others on the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Dials the cell's router.
    Client,
    /// Is the cell's router: listens, and passes everybody's messages on.
    Router,
}

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
    pump: outlet::Pump,
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

    /// Joins the cell's network, and waits for the router for as long as it takes, with a log line each second.
    ///
    /// # Errors
    /// A busy or bad endpoint. See also [`Bus::open_within`].
    pub fn open(config: &CellConfig, role: Role) -> Result<Self, BusError> {
        Self::open_until(config, role, None, &Stop::new())
    }

    /// The same, for at most `patience` (for commands that a person waits for).
    ///
    /// # Errors
    /// [`BusError::NoRouter`] when nobody answers in time; [`BusError::PortBusy`] for a router whose port is taken.
    pub fn open_within(
        config: &CellConfig,
        role: Role,
        patience: Duration,
    ) -> Result<Self, BusError> {
        Self::join(config, role, Some(patience), &Stop::new(), None)
    }

    /// The same for a service, given up when `stop` is triggered: where the cell asks for real-time scheduling, the
    /// bus's own threads get it too, since a message waits for them under load.
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

    /// Joins the network outside any cell: keys begin with the cell's name, `*/health/*` reads every cell's health.
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

    /// That a router with certificates would take the cell's access rules as they stand now; without certificates there
    /// are none.
    ///
    /// # Errors
    /// What is wrong with the file, and what to do.
    pub fn check_access(config: &ZenohConfig) -> Result<(), BusError> {
        match config.tls {
            Some(_) => session_config::check_access(config),
            None => Ok(()),
        }
    }

    fn assemble(name: &str, session: Option<Session>, priority: Option<u8>) -> Self {
        let registry = Arc::new(Registry::default());
        let recall = session.as_ref().map(|_| recall::Recall::start());
        Self {
            inner: Arc::new(Inner {
                name: name.to_owned(),
                pump: outlet::Pump::start(priority, recall.clone()),
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

    /// A publisher for one topic. Each counts its own sequence under its own id.
    ///
    /// # Errors
    /// A key with wildcards, or one that is in use with another message type.
    pub fn publisher<M: Message>(&self, topic: &Topic<M>) -> Result<Publisher<M>, BusError> {
        Publisher::declare(&self.inner, topic)
    }

    /// The newest message of a topic, and nothing before it.
    ///
    /// # Errors
    /// A bad key, or one that is in use with another message type.
    pub fn latest<M: Message>(&self, topic: &Topic<M>) -> Result<Latest<M>, BusError> {
        let (core, output) = ReaderCore::newest(self.admission(topic));
        let core = Arc::new(core);
        let handle = self.register(topic, &core)?;
        Ok(Latest::new(core, output, handle))
    }

    /// Every message of a topic, in a queue that holds `capacity`: when it is full the oldest goes, counted.
    ///
    /// # Errors
    /// A bad key, or one that is in use with another message type.
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

    /// Calls `callback` for every message: from the same process inside `publish`, in the publisher's thread, in the
    /// order of registration; from elsewhere in a Zenoh thread. It must be short and must not wait. It ends with the
    /// handle. A callback that publishes what it listens to is not called again from within itself: that message is
    /// counted as dropped.
    ///
    /// # Errors
    /// A bad key, or one that is in use with another message type.
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

    /// Publishers that readers of this bus refuse now, and what they refused before: one per topic.
    pub fn refused(&self) -> Vec<Refused> {
        refused::list(&self.inner)
    }

    /// Learns who is behind each publisher's id, for [`Bus::refused`]. [`crate::HealthReporter`] does it for services.
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

    /// Every message on keys that match `pattern`, encoded, from this process and from others. For the recorder.
    ///
    /// # Errors
    /// A bad pattern.
    pub fn subscribe_raw(
        &self,
        pattern: &str,
        capacity: usize,
    ) -> Result<RawSubscription, BusError> {
        self.subscribe_raw_all(&[pattern.to_owned()], capacity)
    }

    /// The same for several patterns through one queue. A message that two of them match comes twice.
    ///
    /// # Errors
    /// A bad pattern.
    pub fn subscribe_raw_all(
        &self,
        patterns: &[String],
        capacity: usize,
    ) -> Result<RawSubscription, BusError> {
        raw_reader::subscribe(&self.inner, patterns, capacity)
    }

    /// Publishes bytes that are encoded already, for replay. Not for real-time threads.
    ///
    /// # Errors
    /// A key with wildcards.
    pub fn raw_publisher(&self, key: &str, type_name: &str) -> Result<RawPublisher, BusError> {
        RawPublisher::declare(&self.inner, key, type_name)
    }

    /// Answers requests on `key`, which may hold wildcards; the handler gets the key that was asked, and must not wait for
    /// anything. Requests from this process run it in the asker's thread, others in the bus's answering thread, one after another.
    /// A request whose time is up is refused before it comes to the handler.
    ///
    /// # Errors
    /// A bad key.
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

    /// Answers requests on `key`, each in the thread of the lane that `lane` says, and with its deadline: the handler has no
    /// effect after it. It is for requests that wait for something, and for those that must never wait.
    ///
    /// # Errors
    /// A bad key.
    pub fn answer_in(
        &self,
        key: &str,
        lane: impl Fn(&Request) -> Lane + Send + Sync + 'static,
        handler: impl Fn(Asked) -> Reply + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        requests::declare(&self.inner, key, Arc::new(lane), Arc::new(handler))
    }

    /// Asks and waits for the first answer. The request may be carried out within four fifths of `timeout`, less at most 1 s before its
    /// end; later it is refused.
    ///
    /// # Errors
    /// [`BusError::NoAnswer`] when nobody answers in time, [`BusError::Unknown`] when the service cannot tell: either way it may have
    /// been done.
    pub fn ask(&self, key: &str, request: &Request, timeout: Duration) -> Result<Answer, BusError> {
        requests::ask(&self.inner, key, request, timeout)
    }

    /// Asks everybody whose key matches, and waits until all have answered or the time is up.
    ///
    /// # Errors
    /// A bad key, or a closed session.
    pub fn ask_all(
        &self,
        key: &str,
        request: &Request,
        timeout: Duration,
    ) -> Result<Vec<(String, Answer)>, BusError> {
        requests::ask_all(&self.inner, key, request, timeout)
    }

    /// Says that a service is here, until the token is dropped. [`crate::HealthReporter`] does it for services.
    ///
    /// # Errors
    /// A name that cannot stand in a key.
    pub fn declare_alive(&self, service: &str, instance: &str) -> Result<AliveToken, BusError> {
        alive::declare(&self.inner, service, instance)
    }

    /// The same for a service of which a cell has one: refused when it runs already, here or elsewhere.
    /// [`crate::HealthReporter::start_only`] does it for services.
    ///
    /// # Errors
    /// [`BusError::Taken`] with where it runs; see also [`Bus::declare_alive`].
    pub fn claim_alive(&self, service: &str, instance: &str) -> Result<AliveToken, BusError> {
        alive::claim(&self.inner, service, instance)
    }

    /// Who is here now, in this process and on the network, sorted.
    ///
    /// # Errors
    /// A closed session.
    pub fn alive(&self, timeout: Duration) -> Result<Vec<Alive>, BusError> {
        alive::list(&self.inner, "*", timeout)
    }

    /// Who publishes normals: the estimator's name and its process, sorted. By liveliness tokens, as
    /// [`Bus::declare_alive`] makes them of a [`tangent_schemas::topics::estimator_service`].
    ///
    /// # Errors
    /// A closed session.
    pub fn alive_estimators(&self, timeout: Duration) -> Result<Vec<(String, String)>, BusError> {
        let service = tangent_schemas::topics::estimator_service("*");
        let alive = alive::list(&self.inner, &service, timeout)?;
        let named = alive.into_iter().filter_map(|alive| {
            let (_, name) = alive.service.split_once('/')?;
            Some((name.to_owned(), alive.instance))
        });
        Ok(named.collect())
    }

    /// True when there is a network session; false for [`Bus::in_process`].
    pub fn is_networked(&self) -> bool {
        self.inner.session.is_some()
    }

    /// What a person should know about this process's place on the network though nothing has failed: a router that is open
    /// to anybody, a certificate that ends soon. [`crate::HealthReporter`] passes it on.
    pub fn remarks(&self) -> Vec<String> {
        let session = self.inner.session.as_ref().map(Session::remarks);
        let mut all = session.unwrap_or_default();
        all.extend(self.inner.registry.raw_remarks());
        all
    }

    /// Messages for other processes that were dropped before the wire because the publishing thread fell behind.
    pub fn dropped(&self) -> u64 {
        self.inner.pump.dropped()
    }

    /// Sends what waits, then leaves the network. Without it, the last clone's end does the same.
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

    /// It is a service of this process's own.
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
