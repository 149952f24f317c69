//! Reads the selected messages of a recording in several threads: each unpacks whole chunks and
//! decodes their messages, and the calling thread puts them in order.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use mcap::McapError;
use mcap::read::ChannelAccumulator;
use mcap::records::Record;
use tangent_schemas::Message as _;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::WrenchBatch;

use crate::RecorderError;
use crate::message::RecordedMessage;
use crate::order::{Lines, Numbered, Order};
use crate::outline::Piece;
use crate::packing::{self, packed_topic};
use crate::publisher::of_channel;
use crate::records::RawRecords;
use crate::unpacker::Unpacker;
use crate::walk::{Found, Walked};

/// Largest number of threads that unpack.
const THREADS_MAX: usize = 8;
/// Number of unpacked chunks that may wait for the calling thread, for each of the threads.
const WAITING: usize = 2;
/// What a channel of a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contents<'a> {
    /// Topic of the messages, with its leading slash; of packed messages, that of the bus.
    pub topic: &'a str,
    /// Their ROS 2 message type.
    pub type_name: &'a str,
}

/// A message in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored<'a> {
    /// Time of receipt by the recorder, ns since the Unix epoch.
    pub log_time_ns: u64,
    /// Time of measurement, ns since the Unix epoch.
    pub publish_time_ns: u64,
    /// CDR.
    pub bytes: &'a [u8],
}

/// Number of messages of a topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Held {
    /// Topic, with its leading slash.
    pub topic: String,
    /// ROS 2 message type.
    pub type_name: String,
    /// Number of messages, those in batches counted one by one.
    pub count: u64,
}

/// A file, and where its messages are.
pub(crate) struct Source<'a> {
    pub path: &'a Path,
    pub file: &'a File,
    pub pieces: &'a [Piece],
}

/// A channel, as every thread sees it.
struct Known<S> {
    topic: String,
    type_name: String,
    publisher: [u8; 16],
    /// Number of its topic and publisher.
    line: Option<usize>,
    /// Topic of the channel in the file, if its messages are packed.
    packed_topic: Option<String>,
    selected: Option<S>,
}

type Table<S> = Vec<Option<Arc<Known<S>>>>;

/// The channels that were defined in the pieces so far.
struct Channels<S> {
    accumulator: ChannelAccumulator<'static>,
    lines: Lines,
    table: Arc<Table<S>>,
}

/// Piece by piece, the channels are taken in the order of the file.
struct Turns<S> {
    state: Mutex<Turn<S>>,
    next: Condvar,
}

struct Turn<S> {
    number: usize,
    channels: Channels<S>,
    /// A thread ended early: the others must not wait for it.
    broken: bool,
}

/// What was read from one piece.
struct Batch<T> {
    messages: Vec<(Numbered, T)>,
    /// Number of messages by channel.
    counts: Vec<u64>,
    damage: Option<McapError>,
}

/// Reads a file. See [`Recording::decode_selected`](crate::Recording::decode_selected).
pub(crate) fn decode_selected<S: Send + Sync, T: Send>(
    source: &Source<'_>,
    select: impl Fn(&Contents<'_>) -> Option<S> + Sync,
    decode: impl Fn(&S, &Stored<'_>) -> T + Sync,
    mut take: impl FnMut(Result<T, RecorderError>),
) -> Vec<Held> {
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.min(THREADS_MAX).min(source.pieces.len());
    let (turns, claimed) = (Turns::default(), AtomicUsize::new(0));
    let (sender, batches) = sync_channel::<(usize, Batch<T>)>(WAITING * threads.max(1));
    let (mut counts, mut damage) = (Vec::<u64>::new(), None);
    thread::scope(|scope| {
        for _ in 0..threads {
            let sender = sender.clone();
            let (turns, claimed, select, decode) = (&turns, &claimed, &select, &decode);
            scope.spawn(move || work(source, claimed, turns, &sender, select, decode));
        }
        drop(sender);
        let (mut order, mut early, mut next) = (Order::default(), BTreeMap::new(), 0);
        'pieces: for (number, batch) in batches {
            early.insert(number, batch);
            while let Some(batch) = early.remove(&next) {
                next += 1;
                add(&mut counts, &batch.counts);
                for (numbered, content) in batch.messages {
                    order.push(&numbered, content);
                    while let Some(content) = order.pop_settled() {
                        take(Ok(content));
                    }
                }
                if batch.damage.is_some() {
                    damage = batch.damage;
                    // The threads end, because nobody receives any more.
                    break 'pieces;
                }
            }
        }
        while let Some(content) = order.pop() {
            take(Ok(content));
        }
    });
    if let Some(damage) = damage {
        take(Err(RecorderError::mcap(source.path, damage)));
    }
    held(&turns.lock().channels.table, &counts)
}

/// The work of one thread: takes pieces until there are none left, or nobody receives any more.
fn work<S: Send + Sync, T: Send>(
    source: &Source<'_>,
    claimed: &AtomicUsize,
    turns: &Turns<S>,
    batches: &SyncSender<(usize, Batch<T>)>,
    select: &impl Fn(&Contents<'_>) -> Option<S>,
    decode: &impl Fn(&S, &Stored<'_>) -> T,
) {
    let _guard = BreaksOnPanic(turns);
    let (mut unpacker, mut bytes) = (Unpacker::default(), Vec::new());
    loop {
        let number = claimed.fetch_add(1, Ordering::Relaxed);
        let Some(piece) = source.pieces.get(number) else {
            return;
        };
        bytes.resize(usize::try_from(piece.length).unwrap_or(usize::MAX), 0);
        let read = source.file.read_exact_at(&mut bytes, piece.at);
        let chunk = RawRecords::of(&bytes).next().filter(|_| piece.is_chunk);
        let (plain, damage) = match (read, chunk) {
            (Err(error), _) => (&[][..], Some(McapError::Io(error))),
            (Ok(()), Some(chunk)) => unpacker.unpack(&chunk),
            (Ok(()), None) => (&bytes[..], None),
        };
        let mut walked = Walked::through(plain, damage);
        let Some(table) = turns.define(number, plain, &mut walked, select) else {
            return;
        };
        let batch = decoded(plain, walked, &table, decode);
        if batches.send((number, batch)).is_err() {
            return;
        }
    }
}

fn decoded<S, T>(
    plain: &[u8],
    walked: Walked,
    table: &Table<S>,
    decode: &impl Fn(&S, &Stored<'_>) -> T,
) -> Batch<T> {
    let mut batch = Batch {
        messages: Vec::new(),
        counts: vec![0; table.len()],
        damage: walked.damage,
    };
    for one in walked.messages {
        let Some(known) = table.get(usize::from(one.channel)).and_then(Option::as_ref) else {
            batch.damage = Some(McapError::UnknownChannel(one.sequence, one.channel));
            break;
        };
        let bytes = &plain[one.data.clone()];
        let channel = usize::from(one.channel);
        let Some(selected) = &known.selected else {
            batch.counts[channel] += match &known.packed_topic {
                Some(topic) => packing::count(topic, WrenchBatch::NAME, bytes),
                None => 1,
            };
            continue;
        };
        if let Some(topic) = &known.packed_topic {
            batch.counts[channel] += batch.unpack(topic, known, selected, &one, bytes, decode);
            continue;
        }
        batch.counts[channel] += 1;
        let stored = Stored {
            log_time_ns: one.log_time_ns,
            publish_time_ns: one.publish_time_ns,
            bytes,
        };
        let numbered = Numbered {
            line: known.line,
            packed: false,
            log_time_ns: one.log_time_ns,
            publish_time_ns: one.publish_time_ns,
            sequence: one.sequence,
        };
        batch.messages.push((numbered, decode(selected, &stored)));
    }
    batch
}

impl<T> Batch<T> {
    /// Takes the messages of a batch one by one. Returns their number.
    fn unpack<S>(
        &mut self,
        packed_topic: &str,
        known: &Known<S>,
        selected: &S,
        one: &Found,
        bytes: &[u8],
        decode: &impl Fn(&S, &Stored<'_>) -> T,
    ) -> u64 {
        let message = RecordedMessage {
            topic: packed_topic.to_owned(),
            type_name: WrenchBatch::NAME.to_owned(),
            log_time_ns: one.log_time_ns,
            publish_time_ns: one.publish_time_ns,
            publisher: known.publisher,
            sequence: one.sequence,
            bytes: bytes.to_vec(),
        };
        let unpacked = packing::unpack(message);
        let count = unpacked.len() as u64;
        for packing::Unpacked { message, packed } in unpacked {
            let stored = Stored {
                log_time_ns: message.log_time_ns,
                publish_time_ns: message.publish_time_ns,
                bytes: &message.bytes,
            };
            let numbered = Numbered {
                line: known.line,
                packed,
                log_time_ns: message.log_time_ns,
                publish_time_ns: message.publish_time_ns,
                sequence: message.sequence,
            };
            self.messages.push((numbered, decode(selected, &stored)));
        }
        count
    }
}

impl<S> Default for Turns<S> {
    fn default() -> Self {
        Self {
            state: Mutex::new(Turn {
                number: 0,
                channels: Channels {
                    accumulator: ChannelAccumulator::default(),
                    lines: Lines::default(),
                    table: Arc::default(),
                },
                broken: false,
            }),
            next: Condvar::new(),
        }
    }
}

impl<S> Turns<S> {
    fn lock(&self) -> MutexGuard<'_, Turn<S>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the pieces before this one, and takes the channels that it defines. Returns all
    /// channels so far; `None` if another thread has ended early.
    fn define(
        &self,
        number: usize,
        plain: &[u8],
        walked: &mut Walked,
        select: &impl Fn(&Contents<'_>) -> Option<S>,
    ) -> Option<Arc<Table<S>>> {
        let mut turn = self.lock();
        while turn.number != number && !turn.broken {
            turn = self.next.wait(turn).unwrap_or_else(PoisonError::into_inner);
        }
        if turn.broken {
            return None;
        }
        for (messages, opcode, body) in std::mem::take(&mut walked.definitions) {
            if let Err(damage) = turn.channels.define(opcode, &plain[body], select) {
                walked.cut(messages, damage);
                break;
            }
        }
        turn.number += 1;
        let table = Arc::clone(&turn.channels.table);
        drop(turn);
        self.next.notify_all();
        Some(table)
    }
}

/// Sets the other threads free if this one panics.
struct BreaksOnPanic<'a, S>(&'a Turns<S>);

impl<S> Drop for BreaksOnPanic<'_, S> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.lock().broken = true;
            self.0.next.notify_all();
        }
    }
}

impl<S> Channels<S> {
    /// Takes a schema or a channel.
    fn define(
        &mut self,
        opcode: u8,
        body: &[u8],
        select: &impl Fn(&Contents<'_>) -> Option<S>,
    ) -> Result<(), McapError> {
        match mcap::parse_record(opcode, body)? {
            Record::Schema { header, data } => {
                self.accumulator.add_schema_from_slice(header, &data)
            }
            Record::Channel(channel) => {
                let id = channel.id;
                self.accumulator.add_channel(channel)?;
                self.know(id, select);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn know(&mut self, id: u16, select: &impl Fn(&Contents<'_>) -> Option<S>) {
        let at = usize::from(id);
        let is_known = self.table.get(at).is_some_and(Option::is_some);
        let Some(channel) = self.accumulator.get(id).filter(|_| !is_known) else {
            return;
        };
        let schema = channel.schema.as_ref();
        let type_name = schema.map_or("", |schema| schema.name.as_str());
        let packed = packed_topic(&channel.topic).filter(|_| type_name == WrenchBatch::NAME);
        let contents = match packed {
            Some(topic) => Contents {
                topic,
                type_name: WrenchStamped::NAME,
            },
            None => Contents {
                topic: &channel.topic,
                type_name,
            },
        };
        let publisher = of_channel(&channel.metadata);
        let known = Known {
            topic: contents.topic.to_owned(),
            type_name: contents.type_name.to_owned(),
            publisher,
            line: self.lines.number(contents.topic, &publisher),
            packed_topic: packed.map(|_| channel.topic.clone()),
            selected: select(&contents),
        };
        let mut table = Table::clone(&self.table);
        if table.len() <= at {
            table.resize(at + 1, None);
        }
        table[at] = Some(Arc::new(known));
        self.table = Arc::new(table);
    }
}

fn add(sums: &mut Vec<u64>, more: &[u64]) {
    if sums.len() < more.len() {
        sums.resize(more.len(), 0);
    }
    for (sum, more) in sums.iter_mut().zip(more) {
        *sum += more;
    }
}

/// The counts by topic, in the order of the channels.
fn held<S>(table: &Table<S>, counts: &[u64]) -> Vec<Held> {
    let mut held = Vec::<Held>::new();
    for (known, &count) in table.iter().zip(counts) {
        let Some(known) = known.as_ref().filter(|_| count > 0) else {
            continue;
        };
        match held.iter_mut().find(|one| one.topic == known.topic) {
            Some(one) => one.count += count,
            None => held.push(Held {
                topic: known.topic.clone(),
                type_name: known.type_name.clone(),
                count,
            }),
        }
    }
    held
}
