//! The recorder service: takes every message from the bus, passes it to the disk, and stores task
//! texts and parameters with the messages.

mod definitions;
mod summary;

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::time::{Duration, Instant};

use tangent_runtime::{
    Beat, Bus, Counter, Gauge, HealthReporter, Rate, RawMessage, RawSubscription, State, Stop,
    clock,
};
use tangent_schemas::convert::cut;
use tangent_schemas::tangent::ControlState;
use tangent_schemas::{Message, cdr, topics};

pub use self::definitions::Definitions;
pub use self::summary::Summary;

use crate::cells::Cells;
use crate::config::RecorderConfig;
use crate::disk::Disk;
use crate::error::RecorderError;
use crate::former::Former;
use crate::inquiry::{Finding, Inquirer};
use crate::keeper::Keeper;
use crate::ledger::{Entry, Ledger, Origin};
use crate::message::Record;
use crate::pattern::matches_any;
use crate::recall::Recaller;
use crate::repair::Repair;

/// Name of the service in topics and health messages.
pub const SERVICE: &str = "recorder";
/// Interval of the periodic work, and longest wait for a message.
const LOOK: Duration = Duration::from_millis(50);
/// Longest time of one iteration: it may write new definitions and look for files, and a disk may
/// be slow.
const TURN_MAX: Duration = Duration::from_secs(30);
/// Time that services have to start before they are asked for their parameters.
const ASK_AFTER: Duration = Duration::from_secs(1);
/// Time after a stop during which messages in transit are still taken.
const LATE: Duration = Duration::from_millis(200);
/// Time that publishers then have to send missing messages again.
const LAST_QUESTION: Duration = Duration::from_millis(1000);
/// Largest number of messages sent again that are taken between two checks for live messages.
const RECALLED_MAX: usize = 4000;
/// Time span before the end of the former recording that is requested again, ns: the newest
/// messages may not have reached its disk.
const BEFORE_NS: i64 = 1_000_000_000;

/// Records until `stop`, then writes what is still queued and closes the file. Blocks.
///
/// # Errors
/// The folder can neither be found nor created, or the bus refuses a topic. A disk that refuses
/// later is no error: the service keeps running, counts the messages and tries again.
pub fn run(config: RecorderConfig, bus: Bus, stop: Stop) -> Result<Summary, RecorderError> {
    run_for(config, bus.clone(), bus, stop)
}

/// Records the cells of `config.cells`, received on `network`, a bus outside any cell, until
/// `stop`. `bus` is that of the recorder's own cell, where it publishes its health.
///
/// # Errors
/// Those of [`run`].
pub fn run_for(
    config: RecorderConfig,
    bus: Bus,
    network: Bus,
    stop: Stop,
) -> Result<Summary, RecorderError> {
    let mut service = Service::new(config, &bus, &network)?;
    let beat = Beat::new(SERVICE);
    while !stop.is_stopped() {
        beat.within(TURN_MAX);
        if let Some(message) = service.messages.recv_timeout(LOOK) {
            service.take(&message);
        }
        service.tend();
    }
    drop(beat);
    Ok(service.finish())
}

/// Continues the cell's former recording, if it ended recently.
fn go_on_after(config: &RecorderConfig, now_ns: i64, ledger: &mut Ledger, recaller: &mut Recaller) {
    let now = Instant::now();
    let now_ns = u64::try_from(now_ns).unwrap_or(0);
    let former = Former::read(&config.folder, &config.prefix, now_ns);
    if former.newest_ns == 0 {
        return;
    }
    for ((key, publisher), heard) in former.heard {
        ledger.seed(&key, publisher, heard.sequences, heard.torn, now);
    }
    let newest_ns = i64::try_from(former.newest_ns).unwrap_or(i64::MAX);
    ledger.since(newest_ns - BEFORE_NS);
    recaller.ask_since(newest_ns - BEFORE_NS, now);
}

struct Service {
    messages: RawSubscription,
    /// Capacity of the message queue.
    queue: usize,
    /// Patterns that each key is checked against; empty if the subscription itself selects.
    include: Vec<String>,
    /// Patterns of what is recorded, for messages that did not come through the subscription.
    wanted: Vec<String>,
    exclude: Vec<String>,
    cells: Cells,
    disk: Disk,
    ledger: Ledger,
    recaller: Recaller,
    keeper: Keeper,
    /// Number of files closed when the keeper was last notified.
    ended: usize,
    definitions: Definitions,
    inquirer: Inquirer,
    /// Time at which to ask for parameters; `None` once asked.
    ask_at: Option<Instant>,
    /// Newest activation by cell; the key is the prefix of the cell's keys.
    activations: HashMap<String, u64>,
    mended: Vec<Repair>,
    health: HealthReporter,
    meters: Meters,
    tended: Instant,
}

struct Meters {
    messages: Rate,
    lost: Counter,
    waiting: Gauge,
    recorded: Gauge,
    recovered: Gauge,
    sync: Gauge,
    /// Text of the last reported disk error.
    said: Option<String>,
}

impl Service {
    fn new(config: RecorderConfig, bus: &Bus, network: &Bus) -> Result<Self, RecorderError> {
        let (pattern, include) = match config.include.as_slice() {
            [one] => (one.clone(), Vec::new()),
            // Patterns may overlap; a single subscription receives each message once.
            several => ("**".to_owned(), several.to_vec()),
        };
        let wanted = config.include.clone();
        let exclude = config.exclude.clone();
        let cells = Cells::new(config.cells.clone());
        let patterns: Vec<String> = cells
            .prefixes()
            .iter()
            .map(|prefix| format!("{prefix}{pattern}"))
            .collect();
        let messages = network.subscribe_raw_all(&patterns, config.queue)?;
        let health = HealthReporter::start(bus, SERVICE)?;
        let queue = config.queue;
        let folder = config.folder.clone();
        fs::create_dir_all(&folder).map_err(|source| RecorderError::io(&folder, source))?;
        let start_ns = clock::now_ns();
        let mut ledger = Ledger::new(start_ns);
        let mut recaller = Recaller::start(network.clone(), cells.prefixes())?;
        // Before the former recording is repaired, and before this run writes a file.
        go_on_after(&config, start_ns, &mut ledger, &mut recaller);
        let keeper = Keeper::start(&config)?;
        let disk = Disk::open(config)?;
        let now = Instant::now();
        Ok(Self {
            messages,
            queue,
            include,
            wanted,
            exclude,
            inquirer: Inquirer::start(network.clone(), cells.prefixes())?,
            cells,
            disk,
            ledger,
            recaller,
            keeper,
            ended: 0,
            definitions: Definitions::default(),
            ask_at: Some(now + ASK_AFTER),
            activations: HashMap::new(),
            mended: Vec::new(),
            meters: Meters {
                messages: health.rate("messages"),
                lost: health.lost(),
                waiting: health.gauge("messages_waiting"),
                recorded: health.gauge("messages_recorded"),
                recovered: health.gauge("messages_recovered"),
                sync: health.gauge("sync_ms"),
                said: Some(String::new()),
            },
            health,
            tended: now,
        })
    }

    fn take(&mut self, message: &RawMessage) {
        self.take_from(message, Origin::Live);
    }

    fn take_from(&mut self, message: &RawMessage, origin: Origin) {
        if !self.records(&message.key) {
            return;
        }
        let (prefix, key) = self.cells.split(&message.key);
        let entry = Entry {
            key: &message.key,
            publisher: message.publisher,
            sequence: message.sequence,
            origin,
        };
        if !self.ledger.take(entry, message.received) {
            return;
        }
        self.meters.messages.tick();
        let topic = format!("/{}", message.key);
        let received_ns = u64::try_from(message.received_ns).unwrap_or(0);
        let record = Record {
            topic: &topic,
            type_name: &message.type_name,
            definition: self.definitions.of(&message.type_name),
            publisher: message.publisher,
            sequence: message.sequence as u32,
            log_time_ns: received_ns,
            publish_time_ns: match u64::try_from(message.source_time_ns) {
                Ok(ns) if ns > 0 => ns,
                _ => received_ns,
            },
            bytes: &message.payload,
        };
        self.disk.take(&record, message.received.max(self.tended));
        if origin == Origin::Live && topics::is_latched(key) {
            self.disk.latch(&record);
        }
        // A task text that is requested is that of the current task, so only live messages count.
        if origin == Origin::Live
            && key == topics::CONTROL_STATE.key()
            && message.type_name == ControlState::NAME
        {
            let prefix = prefix.to_owned();
            self.watch_task(prefix, &message.payload);
        }
    }

    /// Requests the text of the task when the activation changes, to store it in the recording.
    fn watch_task(&mut self, prefix: String, payload: &[u8]) {
        let Ok(state) = cdr::decode::<ControlState>(payload) else {
            return;
        };
        let newest = self.activations.entry(prefix.clone()).or_default();
        if state.activation != *newest {
            *newest = state.activation;
            if state.activation > 0 {
                self.inquirer.ask_task(prefix, state.activation);
            }
        }
    }

    /// Periodic work: flush and rotate files, request missing messages and parameters, report
    /// health.
    fn tend(&mut self) {
        let now = Instant::now();
        if now.duration_since(self.tended) < LOOK {
            return;
        }
        self.tended = now;
        self.disk.tend(now);
        self.recall(now);
        if self.ask_at.is_some_and(|at| now >= at) {
            self.ask_at = None;
            self.inquirer.ask_parameters();
        }
        let findings: Vec<Finding> = self.inquirer.findings().collect();
        for finding in findings {
            self.store(finding, now);
        }
        let ended = self.disk.ended();
        if ended != self.ended {
            self.ended = ended;
            self.keeper.look();
        }
        self.mended.extend(self.keeper.mended());
        self.say();
    }

    /// Requests missing messages, and records those that publishers have sent again.
    fn recall(&mut self, now: Instant) {
        for one in self.messages.pushed_out() {
            if self.records(&one.key) {
                self.ledger
                    .pushed_out(&one.key, one.publisher, one.from, one.to, now);
            }
        }
        // Live messages are lost when the queue is full; messages that were sent again can wait.
        if self.messages.waiting() < (self.queue / 4).max(1) {
            for message in self.recaller.answers(RECALLED_MAX) {
                self.take_again(&message);
            }
        }
        self.recaller.tend(&mut self.ledger, now);
    }

    fn take_again(&mut self, message: &RawMessage) {
        // Publishers send messages of all topics again.
        let (_, key) = self.cells.split(&message.key);
        if matches_any(&self.wanted, key) && self.messages.follows(&message.key) {
            self.take_from(message, Origin::Recalled);
        }
    }

    /// Whether messages on this key are recorded.
    fn records(&self, key: &str) -> bool {
        let (_, key) = self.cells.split(key);
        (self.include.is_empty() || matches_any(&self.include, key))
            && !matches_any(&self.exclude, key)
    }

    fn store(&mut self, finding: Finding, now: Instant) {
        match finding {
            Finding::Parameters(table) if table.is_empty() => {}
            Finding::Parameters(table) => {
                self.disk.metadata("parameters", table, now);
            }
            Finding::Task {
                prefix,
                activation,
                toml,
            } => {
                let name = format!("{prefix}task-{activation}.toml");
                let time_ns = u64::try_from(clock::now_ns()).unwrap_or(0);
                self.disk.attach(&name, &toml, time_ns, now);
            }
        }
    }

    fn say(&mut self) {
        let (recorded, refused) = self.disk.counts();
        self.meters.recovered.set(self.ledger.recovered() as f64);
        self.meters.recorded.set(recorded as f64);
        self.meters
            .sync
            .set(self.disk.sync_took().as_secs_f64() * 1e3);
        self.meters.waiting.set(self.messages.waiting() as f64);
        self.meters.lost.set(refused + self.ledger.missing());
        self.disk.last_words("losses", self.losses());
        let trouble = self.disk.refusal().map(str::to_owned);
        if trouble != self.meters.said {
            match &trouble {
                Some(reason) => self.health.set(State::Degraded, cut(reason)),
                None => self.health.running(),
            }
            self.meters.said = trouble;
        }
    }

    fn losses(&self) -> BTreeMap<String, String> {
        let (recorded, refused) = self.disk.counts();
        let counts = self.messages.counts();
        [
            ("received", counts.received),
            ("recorded", recorded),
            ("recovered", self.ledger.recovered()),
            ("queue_dropped", counts.dropped),
            ("disk_refused", refused),
            ("missing", self.ledger.missing()),
        ]
        .map(|(name, count)| (name.to_owned(), count.to_string()))
        .into()
    }

    fn finish(mut self) -> Summary {
        let stopped = Instant::now();
        self.keeper.finish();
        self.mended.extend(self.keeper.mended());
        self.inquirer.ask_parameters();
        // Messages from before the stop may still be in transit; later ones may arrive without end.
        while let Some(message) = self
            .messages
            .recv_timeout(LATE.saturating_sub(stopped.elapsed()))
        {
            let late = message.received > stopped + LATE;
            self.take(&message);
            if late {
                break;
            }
        }
        self.recall(Instant::now());
        for message in self.recaller.finish(&mut self.ledger, LAST_QUESTION) {
            self.take_again(&message);
        }
        self.ledger.close();
        let now = Instant::now();
        for finding in self.inquirer.finish() {
            self.store(finding, now);
        }
        let counts = self.messages.counts();
        self.disk.last_words("losses", self.losses());
        let (files, recorded, disk_refused) = self.disk.finish(now);
        Summary {
            files,
            recorded,
            recovered: self.ledger.recovered(),
            queue_dropped: counts.dropped,
            disk_refused,
            missing: self.ledger.missing(),
            mended: self.mended,
        }
    }
}

#[cfg(test)]
mod tests;
