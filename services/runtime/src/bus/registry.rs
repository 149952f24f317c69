//! Readers and publishers within this process: the path that does not use the network.

use std::any::{Any, TypeId};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tangent_schemas::Message;
use zenoh::key_expr::OwnedKeyExpr;

use super::error::BusError;
use super::raw::RawCore;
use super::reader::{Arrival, ErasedReader, Handle, ReaderCore};
use super::source::Rival;

/// Checks a key or a pattern by Zenoh's rules.
pub(crate) fn parse_key(key: &str) -> Result<OwnedKeyExpr, BusError> {
    OwnedKeyExpr::new(key).map_err(|error| BusError::Key {
        key: key.to_owned(),
        reason: error.to_string(),
    })
}

/// Checks a key to publish on by Zenoh's rules; wildcards are refused.
pub(crate) fn parse_concrete_key(key: &str) -> Result<OwnedKeyExpr, BusError> {
    let parsed = parse_key(key)?;
    if parsed.is_wild() {
        return Err(BusError::Key {
            key: key.to_owned(),
            reason: "wildcards can be read, not published".to_owned(),
        });
    }
    Ok(parsed)
}

struct ReaderEntry {
    id: u64,
    pattern: OwnedKeyExpr,
    typed: Arc<dyn Any + Send + Sync>,
    erased: Arc<dyn ErasedReader>,
    first: bool,
}

/// One concrete key and its readers in this process.
pub(crate) struct Channel<M: Message> {
    key: OwnedKeyExpr,
    /// Changes whenever the set of readers changes.
    generation: AtomicU64,
    readers: Mutex<Readers<M>>,
}

/// Readers of one channel; always replaced as a whole.
pub(crate) type Readers<M> = Arc<[Arc<ReaderCore<M>>]>;

impl<M: Message> Channel<M> {
    pub(crate) fn generation(&self) -> u64 {
        self.generation.load(Ordering::Acquire)
    }

    pub(crate) fn readers(&self) -> Readers<M> {
        Arc::clone(&self.readers.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

trait AnyChannel: Send + Sync {
    fn key(&self) -> &OwnedKeyExpr;
    fn message_name(&self) -> &'static str;
    fn rebuild(&self, entries: &[ReaderEntry]);
}

impl<M: Message> AnyChannel for Channel<M> {
    fn key(&self) -> &OwnedKeyExpr {
        &self.key
    }

    fn message_name(&self) -> &'static str {
        M::NAME
    }

    /// Puts callbacks before slots, each in the order of registration, so that the control loop
    /// comes first.
    fn rebuild(&self, entries: &[ReaderEntry]) {
        let matching = |first: bool| {
            entries
                .iter()
                .filter(move |entry| entry.first == first && entry.pattern.intersects(&self.key))
                .filter_map(|entry| Arc::clone(&entry.typed).downcast::<ReaderCore<M>>().ok())
        };
        let readers: Readers<M> = matching(true).chain(matching(false)).collect();
        *self.readers.lock().unwrap_or_else(PoisonError::into_inner) = readers;
        self.generation.fetch_add(1, Ordering::Release);
    }
}

struct ChannelEntry {
    erased: Arc<dyn AnyChannel>,
    typed: Arc<dyn Any + Send + Sync>,
    message: TypeId,
}

struct RawEntry {
    id: u64,
    pattern: OwnedKeyExpr,
    core: Arc<RawCore>,
}

#[derive(Default)]
struct State {
    next_id: u64,
    readers: Vec<ReaderEntry>,
    channels: Vec<ChannelEntry>,
    raw: Vec<RawEntry>,
}

/// All channels and readers of a bus.
#[derive(Default)]
pub(crate) struct Registry {
    state: Mutex<State>,
    raw_readers: AtomicUsize,
}

impl Registry {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The channel of a key, created if it does not exist.
    pub(crate) fn channel<M: Message>(
        &self,
        key: &OwnedKeyExpr,
    ) -> Result<Arc<Channel<M>>, BusError> {
        let mut state = self.lock();
        check_type::<M>(&state, key)?;
        let known = state
            .channels
            .iter()
            .find(|entry| entry.erased.key() == key && entry.message == TypeId::of::<M>());
        if let Some(entry) = known
            && let Ok(channel) = Arc::clone(&entry.typed).downcast::<Channel<M>>()
        {
            return Ok(channel);
        }
        let channel = Arc::new(Channel::<M> {
            key: key.clone(),
            generation: AtomicU64::new(0),
            readers: Mutex::new(Arc::from([])),
        });
        channel.rebuild(&state.readers);
        state.channels.push(ChannelEntry {
            erased: Arc::clone(&channel) as _,
            typed: Arc::clone(&channel) as _,
            message: TypeId::of::<M>(),
        });
        Ok(channel)
    }

    fn remove_reader(&self, id: u64) {
        let mut state = self.lock();
        let Some(index) = state.readers.iter().position(|entry| entry.id == id) else {
            return;
        };
        let entry = state.readers.remove(index);
        rebuild_matching(&state, &entry.pattern);
        // A callback may own a publisher or a bus; it must not be dropped under the registry's
        // lock.
        drop(state);
        drop(entry);
    }

    /// Delivers an encoded message to the typed readers of its key.
    pub(crate) fn deliver_encoded(&self, key: &OwnedKeyExpr, type_name: &str, at: Arrival<'_>) {
        let readers: Vec<Arc<dyn ErasedReader>> = self
            .lock()
            .readers
            .iter()
            .filter(|entry| entry.pattern.intersects(key))
            .map(|entry| Arc::clone(&entry.erased))
            .collect();
        for reader in readers {
            reader.deliver_encoded(key.as_str(), Some(type_name), at);
        }
    }

    /// Readers that have refused a publisher: their topic, the publisher that they refuse now, and
    /// the number of samples refused.
    pub(crate) fn rivals(&self, now: Instant) -> Vec<(String, Option<Rival>, u64)> {
        let state = self.lock();
        let judged = state.readers.iter().map(|entry| {
            let (rival, refused) = entry.erased.rival(now);
            (entry.pattern.to_string(), rival, refused)
        });
        judged.filter(|(.., refused)| *refused > 0).collect()
    }

    /// Whether this process has readers of encoded messages. Takes no lock.
    pub(crate) fn has_raw_readers(&self) -> bool {
        self.raw_readers.load(Ordering::Acquire) > 0
    }

    /// Readers of encoded messages of a key.
    pub(crate) fn raw_readers(&self, key: &OwnedKeyExpr) -> Vec<Arc<RawCore>> {
        self.lock()
            .raw
            .iter()
            .filter(|entry| entry.pattern.intersects(key))
            .map(|entry| Arc::clone(&entry.core))
            .collect()
    }

    /// Remarks of the readers of encoded messages.
    pub(crate) fn raw_remarks(&self) -> Vec<String> {
        let mut all: Vec<String> = {
            let state = self.lock();
            state
                .raw
                .iter()
                .filter_map(|entry| entry.core.remark())
                .collect()
        };
        // A reader of several patterns is listed once for each.
        all.sort();
        all.dedup();
        all
    }

    fn remove_raw(&self, id: u64) {
        let mut state = self.lock();
        state.raw.retain(|entry| entry.id != id);
        self.raw_readers.store(state.raw.len(), Ordering::Release);
    }
}

fn check_type<M: Message>(state: &State, key: &OwnedKeyExpr) -> Result<(), BusError> {
    let channels = state
        .channels
        .iter()
        .filter(|entry| entry.erased.key().intersects(key))
        .map(|entry| entry.erased.message_name());
    let readers = state
        .readers
        .iter()
        .filter(|entry| entry.pattern.intersects(key))
        .map(|entry| entry.erased.message_name());
    match channels.chain(readers).find(|name| *name != M::NAME) {
        Some(present) => Err(BusError::Type {
            key: key.to_string(),
            present,
            asked: M::NAME,
        }),
        None => Ok(()),
    }
}

fn rebuild_matching(state: &State, pattern: &OwnedKeyExpr) {
    for channel in &state.channels {
        if channel.erased.key().intersects(pattern) {
            channel.erased.rebuild(&state.readers);
        }
    }
}

/// Adds a typed reader, which is removed when the handle is dropped.
pub(crate) fn add_reader<M: Message>(
    registry: &Arc<Registry>,
    pattern: &str,
    core: &Arc<ReaderCore<M>>,
) -> Result<Handle, BusError> {
    let pattern = parse_key(pattern)?;
    let mut state = registry.lock();
    check_type::<M>(&state, &pattern)?;
    let id = state.next_id;
    state.next_id += 1;
    state.readers.push(ReaderEntry {
        id,
        pattern: pattern.clone(),
        typed: Arc::clone(core) as _,
        erased: Arc::clone(core) as _,
        first: core.is_callback(),
    });
    rebuild_matching(&state, &pattern);
    drop(state);
    let registry = Arc::downgrade(registry);
    Ok(Handle::new(move || {
        if let Some(registry) = registry.upgrade() {
            registry.remove_reader(id);
        }
    }))
}

/// Adds a reader of encoded messages.
pub(crate) fn add_raw(
    registry: &Arc<Registry>,
    pattern: &OwnedKeyExpr,
    core: &Arc<RawCore>,
) -> Handle {
    let mut state = registry.lock();
    let id = state.next_id;
    state.next_id += 1;
    state.raw.push(RawEntry {
        id,
        pattern: pattern.clone(),
        core: Arc::clone(core),
    });
    registry
        .raw_readers
        .store(state.raw.len(), Ordering::Release);
    drop(state);
    let registry = Arc::downgrade(registry);
    Handle::new(move || {
        if let Some(registry) = registry.upgrade() {
            registry.remove_raw(id);
        }
    })
}
