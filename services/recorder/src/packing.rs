//! Packs wrenches into arrays: at 7000 per second, the overhead of a message in a file is as large
//! as its content.
//!
//! A sensor counts in steps of a decimal fraction of its unit, so that a force is a whole number of
//! steps. A wrench that is not restored from the arrays bit for bit stays a separate message.

use tangent_schemas::standard::{Header, Time, Vector3, Wrench, WrenchStamped};
use tangent_schemas::tangent::WrenchBatch;
use tangent_schemas::{Message, cdr, topics};

use crate::message::{Record, RecordedMessage};
use crate::publisher::UNKNOWN_PUBLISHER;

/// Suffix of the topic with the packed messages of another topic.
const SUFFIX: &str = "/packed";
/// Largest number of wrenches in one message.
const BATCH_MAX: usize = 4096;
/// Steps are units of force or torque divided by powers of ten, up to this exponent.
const DECIMALS: i32 = 9;
/// N: newton, pound-force, kilogram-force.
const FORCE_UNITS: [f64; 3] = [1.0, POUND_FORCE_N, KILOGRAM_FORCE_N];
/// Nm: newton metre, pound-force inch and foot, kilogram-force centimetre.
const TORQUE_UNITS: [f64; 4] = [
    1.0,
    POUND_FORCE_N * 0.0254,
    POUND_FORCE_N * 12.0 * 0.0254,
    KILOGRAM_FORCE_N / 100.0,
];
const POUND_FORCE_N: f64 = 4.448_221_615_260_5;
const KILOGRAM_FORCE_N: f64 = 9.806_65;

/// A topic and a publisher on it.
type Place = (String, [u8; 16]);

/// Incomplete batches. The list is short, since few publishers send wrenches, and is emptied with
/// each flush, since unknown processes may send some.
#[derive(Default)]
pub(crate) struct Packer {
    waiting: Vec<(Place, Waiting)>,
    /// Step sizes that fitted last, N and Nm.
    steps: (f64, f64),
}

/// Result for one record.
pub(crate) enum Packed {
    /// The record is in a batch; returns a batch that is complete.
    Taken(Option<Whole>),
    /// The record must be written unpacked, after the returned batch.
    Not(Option<Whole>),
}

/// A batch to be written.
pub(crate) struct Whole {
    pub topic: String,
    pub publisher: [u8; 16],
    pub sequence: u32,
    pub log_time_ns: u64,
    pub publish_time_ns: u64,
    pub bytes: Vec<u8>,
}

impl Packer {
    /// Adds a record to a batch, or reports that it cannot be packed.
    pub fn take(&mut self, record: &Record<'_>) -> Packed {
        if !is_packable(record) {
            return Packed::Not(None);
        }
        let known = self.waiting.iter().position(|((topic, publisher), _)| {
            topic == record.topic && *publisher == record.publisher
        });
        let at = known.unwrap_or_else(|| {
            let place = (record.topic.to_owned(), record.publisher);
            self.waiting.push((place, Waiting::new(self.steps)));
            self.waiting.len() - 1
        });
        let (place, waiting) = &mut self.waiting[at];
        let Some(one) = One::of(record) else {
            return Packed::Not(waiting.end(place));
        };
        if waiting.push(&one) {
            return Packed::Taken(None);
        }
        let ended = waiting.end(place);
        if waiting.push(&one) || (waiting.find_steps(&one) && waiting.push(&one)) {
            self.steps = waiting.steps();
            Packed::Taken(ended)
        } else {
            Packed::Not(ended)
        }
    }

    /// Ends all incomplete batches.
    pub fn end_all(&mut self) -> Vec<Whole> {
        let waiting = self.waiting.drain(..);
        waiting
            .filter_map(|(place, mut waiting)| waiting.end(&place))
            .collect()
    }
}

/// Whether the record is a raw wrench of a publisher that numbers its messages.
fn is_packable(record: &Record<'_>) -> bool {
    let raw = topics::WRENCH_RAW.key();
    let of_cell = || record.topic.strip_suffix(raw)?.strip_suffix('/');
    record.type_name == WrenchStamped::NAME
        && record.publisher != UNKNOWN_PUBLISHER
        && of_cell().is_some()
}

/// A wrench and its times.
struct One<'a> {
    record: &'a Record<'a>,
    wrench: WrenchStamped,
    stamp_ns: i64,
    published_after_ns: i32,
}

impl<'a> One<'a> {
    fn of(record: &'a Record<'a>) -> Option<Self> {
        let wrench: WrenchStamped = cdr::decode(record.bytes).ok()?;
        let stamp_ns = wrench.header.stamp.to_ns();
        let published_ns = i64::try_from(record.publish_time_ns).ok()?;
        Some(Self {
            record,
            stamp_ns,
            published_after_ns: narrow(published_ns.checked_sub(stamp_ns)?)?,
            wrench,
        })
    }
}

fn narrow(number: i64) -> Option<i32> {
    i32::try_from(number).ok()
}

/// A batch that is not full yet.
#[derive(Default)]
struct Waiting {
    batch: WrenchBatch,
    last: Last,
    /// Bytes of a wrench as restored from the arrays.
    bytes: Vec<u8>,
}

/// Data of the newest wrench.
#[derive(Clone, Copy, Default)]
struct Last {
    stamp_ns: i64,
    received_ns: u64,
    published_ns: u64,
}

impl Waiting {
    fn new((force_step_n, torque_step_nm): (f64, f64)) -> Self {
        Self {
            batch: WrenchBatch {
                force_step_n,
                torque_step_nm,
                ..WrenchBatch::default()
            },
            ..Self::default()
        }
    }

    fn steps(&self) -> (f64, f64) {
        (self.batch.force_step_n, self.batch.torque_step_nm)
    }

    /// Adds a wrench. False if it does not continue the batch, or would not be restored exactly.
    fn push(&mut self, one: &One<'_>) -> bool {
        let size = self.batch.force_x.len();
        if size == BATCH_MAX {
            return false;
        }
        if size == 0 {
            self.batch.header = one.wrench.header.clone();
            self.batch.sequence = one.record.sequence;
            self.batch.received_ns = one.record.log_time_ns;
            self.last = Last {
                stamp_ns: one.stamp_ns,
                received_ns: one.record.log_time_ns,
                published_ns: one.record.publish_time_ns,
            };
        }
        self.append(one).is_some()
    }

    fn append(&mut self, one: &One<'_>) -> Option<()> {
        let batch = &mut self.batch;
        let record = one.record;
        let place = batch.force_x.len() as u32;
        let goes_on = record.sequence == batch.sequence.wrapping_add(place)
            && one.wrench.header.frame_id == batch.header.frame_id;
        if !goes_on {
            return None;
        }
        let stamp_step = narrow(one.stamp_ns.checked_sub(self.last.stamp_ns)?)?;
        let received_step = record.log_time_ns.wrapping_sub(self.last.received_ns) as i64;
        let received_step = narrow(received_step)?;
        let felt = &one.wrench.wrench;
        let force = numbers(&felt.force, batch.force_step_n)?;
        let torque = numbers(&felt.torque, batch.torque_step_nm)?;
        let again = wrench(batch, one.stamp_ns, force, torque);
        self.bytes.clear();
        cdr::encode(&again, &mut self.bytes).ok()?;
        if self.bytes != record.bytes {
            return None;
        }
        batch.stamp_step_ns.push(stamp_step);
        batch.received_step_ns.push(received_step);
        batch.published_after_ns.push(one.published_after_ns);
        batch.force_x.push(force[0]);
        batch.force_y.push(force[1]);
        batch.force_z.push(force[2]);
        batch.torque_x.push(torque[0]);
        batch.torque_y.push(torque[1]);
        batch.torque_z.push(torque[2]);
        self.last = Last {
            stamp_ns: one.stamp_ns,
            received_ns: record.log_time_ns,
            published_ns: record.publish_time_ns,
        };
        Some(())
    }

    /// Finds the coarsest steps of which this wrench is a whole number, for an empty batch; false
    /// if there are none.
    fn find_steps(&mut self, one: &One<'_>) -> bool {
        let felt = &one.wrench.wrench;
        let steps = step(&felt.force, &FORCE_UNITS).zip(step(&felt.torque, &TORQUE_UNITS));
        if let Some(steps) = steps {
            *self = Self::new(steps);
        }
        steps.is_some()
    }

    /// Ends the batch and returns it; the steps are kept for the next one.
    fn end(&mut self, (topic, publisher): &Place) -> Option<Whole> {
        if self.batch.force_x.is_empty() {
            return None;
        }
        let mut bytes = Vec::new();
        cdr::encode(&self.batch, &mut bytes)
            .expect("arrays of some thousand numbers can be written");
        let whole = Whole {
            topic: format!("{topic}{SUFFIX}"),
            publisher: *publisher,
            sequence: self.batch.sequence,
            log_time_ns: self.last.received_ns,
            publish_time_ns: self.last.published_ns,
            bytes,
        };
        *self = Self::new(self.steps());
        Some(whole)
    }
}

fn step(vector: &Vector3, units: &[f64]) -> Option<f64> {
    let mut steps = units
        .iter()
        .flat_map(|unit| (0..=DECIMALS).map(move |decimals| unit / 10f64.powi(decimals)));
    steps.find(|step| numbers(vector, *step).is_some())
}

/// Number of steps; `None` if it is not whole.
fn numbers(vector: &Vector3, step: f64) -> Option<[i32; 3]> {
    let number = |value: f64| {
        let number = (value / step).round();
        let whole = number.abs() <= f64::from(i32::MAX) && number * step == value;
        whole.then_some(number as i32)
    };
    Some([number(vector.x)?, number(vector.y)?, number(vector.z)?])
}

fn times([x, y, z]: [i32; 3], step: f64) -> Vector3 {
    Vector3 {
        x: f64::from(x) * step,
        y: f64::from(y) * step,
        z: f64::from(z) * step,
    }
}

/// A wrench of the batch, as restored from the arrays.
fn wrench(batch: &WrenchBatch, stamp_ns: i64, force: [i32; 3], torque: [i32; 3]) -> WrenchStamped {
    WrenchStamped {
        header: Header {
            stamp: Time::from_ns(stamp_ns),
            frame_id: batch.header.frame_id,
        },
        wrench: Wrench {
            force: times(force, batch.force_step_n),
            torque: times(torque, batch.torque_step_nm),
        },
    }
}

/// Topic whose messages are packed on this one; `None` if this is not a packed topic.
pub(crate) fn packed_topic(topic: &str) -> Option<&str> {
    topic.strip_suffix(SUFFIX)
}

/// The batch in a message; `None` if the message is not a complete batch.
fn batch_of(topic: &str, type_name: &str, bytes: &[u8]) -> Option<WrenchBatch> {
    (type_name == WrenchBatch::NAME)
        .then(|| batch(topic, bytes))
        .flatten()
}

/// Decodes a batch; `None` if the bytes are not one.
pub(crate) fn batch(topic: &str, bytes: &[u8]) -> Option<WrenchBatch> {
    packed_topic(topic)?;
    let batch: WrenchBatch = cdr::decode(bytes).ok()?;
    let size = batch.force_x.len();
    let arrays = [
        &batch.stamp_step_ns,
        &batch.received_step_ns,
        &batch.published_after_ns,
        &batch.force_y,
        &batch.force_z,
        &batch.torque_x,
        &batch.torque_y,
        &batch.torque_z,
    ];
    (arrays.iter().all(|array| array.len() == size)).then_some(batch)
}

/// Number of messages in a message of a recording; 1 if it is not a batch.
pub(crate) fn count(topic: &str, type_name: &str, bytes: &[u8]) -> u64 {
    size(topic, type_name, bytes).unwrap_or(1)
}

/// Number of messages in a batch; `None` if the message is not a batch.
pub(crate) fn size(topic: &str, type_name: &str, bytes: &[u8]) -> Option<u64> {
    batch_of(topic, type_name, bytes).map(|batch| batch.force_x.len() as u64)
}

/// A message as it came from the bus.
pub(crate) struct Unpacked {
    pub message: RecordedMessage,
    /// Whether it was in a batch: in the file, it then follows messages received after it.
    pub packed: bool,
}

/// The messages of a batch as received from the bus; any other message unchanged.
pub(crate) fn unpack(message: RecordedMessage) -> Vec<Unpacked> {
    let found = batch_of(&message.topic, &message.type_name, &message.bytes);
    let (Some(batch), Some(topic)) = (found, packed_topic(&message.topic)) else {
        return vec![Unpacked {
            message,
            packed: false,
        }];
    };
    let mut stamp_ns = batch.header.stamp.to_ns();
    let mut received_ns = batch.received_ns;
    let mut messages = Vec::with_capacity(batch.force_x.len());
    for i in 0..batch.force_x.len() {
        stamp_ns = stamp_ns.wrapping_add(i64::from(batch.stamp_step_ns[i]));
        received_ns = received_ns.wrapping_add_signed(i64::from(batch.received_step_ns[i]));
        let after_ns = i64::from(batch.published_after_ns[i]);
        let force = [batch.force_x[i], batch.force_y[i], batch.force_z[i]];
        let torque = [batch.torque_x[i], batch.torque_y[i], batch.torque_z[i]];
        let mut bytes = Vec::new();
        cdr::encode(&wrench(&batch, stamp_ns, force, torque), &mut bytes)
            .expect("a wrench can be written");
        messages.push(Unpacked {
            message: RecordedMessage {
                topic: topic.to_owned(),
                type_name: WrenchStamped::NAME.to_owned(),
                log_time_ns: received_ns,
                publish_time_ns: stamp_ns.wrapping_add(after_ns) as u64,
                publisher: message.publisher,
                sequence: batch.sequence.wrapping_add(i as u32),
                bytes,
            },
            packed: true,
        });
    }
    messages
}
