//! Wrenches in arrays are restored exactly, and take little space.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;
use tangent_recorder::{FileOptions, Record, RecordedMessage, Recording, RecordingWriter, repair};
use tangent_schemas::standard::{Header, Vector3, Wrench, WrenchStamped};
use tangent_schemas::tangent::WrenchBatch;
use tangent_schemas::{Message, cdr};

const START_NS: u64 = 1_795_260_245_000_000_000;
/// The box's default: counts per newton and per newton metre.
const COUNTS: f64 = 1e6;
/// N and Nm per count.
const SI: [f64; 2] = [1.0 / COUNTS, 1.0 / COUNTS];

fn options(pack: bool) -> FileOptions {
    FileOptions {
        compress: true,
        pack,
    }
}

fn bytes_of(wrench: &WrenchStamped) -> Vec<u8> {
    let mut bytes = Vec::new();
    cdr::encode(wrench, &mut bytes).unwrap();
    bytes
}

fn wrench(stamp_ns: u64, frame: &str, values: [f64; 6]) -> WrenchStamped {
    let vector = |at: usize| Vector3 {
        x: values[at],
        y: values[at + 1],
        z: values[at + 2],
    };
    WrenchStamped {
        header: Header::new(stamp_ns as i64, frame),
        wrench: Wrench {
            force: vector(0),
            torque: vector(3),
        },
    }
}

/// A sensor at 7 kHz as a box sends it: whole counts, receipts in bursts, and every third cycle a
/// message of the arm.
fn sensor(samples: u32, force_noise_n: f64, steps: [f64; 2]) -> Vec<RecordedMessage> {
    let mut random = Pcg64::seed_from_u64(7);
    let noise = Normal::new(0.0, force_noise_n).unwrap();
    let mut messages = Vec::new();
    for i in 0..samples {
        let publish_time_ns = START_NS + u64::from(i) * 1_000_000 / 7 + random.random_range(0..300);
        let log_time_ns = publish_time_ns + 200_000 + u64::from(i % 7) * 20_000;
        let load = [1.0, -2.0, -3.0, 0.05, 0.1, -0.2];
        let values = std::array::from_fn(|axis| {
            let (scale, step) = if axis < 3 {
                (1.0, steps[0])
            } else {
                (0.02, steps[1])
            };
            let value: f64 = load[axis] + scale * noise.sample(&mut random);
            (value / step).round() * step
        });
        let bytes = bytes_of(&wrench(publish_time_ns, "sensor", values));
        messages.push(RecordedMessage {
            topic: "/wrench/raw".to_owned(),
            type_name: WrenchStamped::NAME.to_owned(),
            log_time_ns,
            publish_time_ns,
            publisher: [1; 16],
            sequence: (u32::MAX - 100).wrapping_add(i),
            bytes,
        });
        if i % 56 == 0 {
            messages.push(RecordedMessage {
                topic: "/other".to_owned(),
                type_name: "x/msg/Y".to_owned(),
                log_time_ns: log_time_ns + 1,
                publish_time_ns,
                publisher: [2; 16],
                sequence: i / 56,
                bytes: vec![0, 1, 0, 0, i as u8],
            });
        }
    }
    messages
}

fn write(path: &Path, messages: &[RecordedMessage], pack: bool) -> u64 {
    let mut writer = RecordingWriter::create_with(path, options(pack)).unwrap();
    let definition = WrenchStamped::definition();
    let mut flushed_ns = 0;
    for message in messages {
        let record = Record {
            topic: &message.topic,
            type_name: &message.type_name,
            definition: (message.type_name == WrenchStamped::NAME).then_some(&definition),
            publisher: message.publisher,
            sequence: message.sequence,
            log_time_ns: message.log_time_ns,
            publish_time_ns: message.publish_time_ns,
            bytes: &message.bytes,
        };
        writer.write(&record).unwrap();
        // As often as the recorder.
        if message.log_time_ns > flushed_ns + 400_000_000 {
            writer.flush().unwrap();
            flushed_ns = message.log_time_ns;
        }
    }
    assert_eq!(writer.messages(), messages.len() as u64);
    writer.finish().unwrap();
    fs::metadata(path).unwrap().len()
}

type Facts<'a> = (&'a str, &'a str, u64, u64, [u8; 16], u32, &'a [u8]);

fn facts(message: &RecordedMessage) -> Facts<'_> {
    (
        &message.topic,
        &message.type_name,
        message.log_time_ns,
        message.publish_time_ns,
        message.publisher,
        message.sequence,
        &message.bytes,
    )
}

fn assert_same(expected: &[RecordedMessage], found: &[RecordedMessage]) {
    assert_eq!(expected.len(), found.len());
    for (i, (expected, found)) in expected.iter().zip(found).enumerate() {
        assert_eq!(facts(expected), facts(found), "message {i}");
    }
}

#[test]
fn a_sensors_records_come_out_as_they_went_in_and_in_the_order_in_which_they_came() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.mcap");
    let pound_force_n = 4.448_221_615_260_5;
    for steps in [
        SI,
        [pound_force_n / COUNTS, pound_force_n * 0.0254 / COUNTS],
        [0.01, 0.0005],
    ] {
        let expected = sensor(20_000, 0.03, steps);
        let packed = write(&path, &expected, true);
        let plain = write(&folder.path().join("plain.mcap"), &expected, false);
        assert!(2 * packed < plain, "{packed} of {plain} bytes");
        let recording = Recording::open(&path).unwrap();
        let found: Vec<_> = recording.messages().collect();
        assert_same(&expected, &found);
        fs::remove_file(&path).unwrap();
        fs::remove_file(folder.path().join("plain.mcap")).unwrap();
    }
}

/// Bytes of an hour of the sensor at 7 kHz, alone.
#[test]
fn an_hour_of_the_fastest_sensor_is_small() {
    let folder = tempfile::tempdir().unwrap();
    let samples = 7000 * 20;
    for noise_n in [0.005, 0.02, 0.1] {
        let messages: Vec<_> = sensor(samples, noise_n, SI)
            .into_iter()
            .filter(|message| message.topic == "/wrench/raw")
            .collect();
        let hour = |pack: bool, name: &str| {
            let bytes = write(&folder.path().join(name), &messages, pack);
            bytes as f64 / f64::from(samples) * 7000.0 * 3600.0 / 1e9
        };
        let packed = hour(true, &format!("packed-{noise_n}.mcap"));
        let plain = hour(false, &format!("plain-{noise_n}.mcap"));
        println!("noise of {noise_n} N: {packed:.2} GB/h packed, {plain:.2} as messages");
        assert!(packed < 0.8 && packed < 0.5 * plain);
    }
}

/// Counts that are not decimal fractions are restored from arrays only by chance. Many small
/// batches would then be larger than the messages.
#[test]
fn a_sensor_whose_counts_do_not_fit_takes_no_more_than_before() {
    let folder = tempfile::tempdir().unwrap();
    for counts in [3125.0, 1e6 / 3.0, 4448.2, 65_536.0] {
        let expected = sensor(20_000, 0.03, [1.0 / counts, 1.0 / counts]);
        let size = |pack: bool| {
            let path = folder.path().join("cell.mcap");
            let size = write(&path, &expected, pack);
            let found: Vec<_> = Recording::open(&path).unwrap().messages().collect();
            assert_same(&expected, &found);
            fs::remove_file(&path).unwrap();
            size
        };
        let (packed, plain) = (size(true), size(false));
        println!("{counts} counts: {packed} bytes, {plain} as messages");
        assert!(packed as f64 <= 1.02 * plain as f64, "{packed} of {plain}");
    }
}

#[test]
fn what_cannot_be_packed_is_kept_as_it_came() {
    let plain = wrench(START_NS, "sensor", [1.0, -2.0, 0.5, 0.25, 0.0, 3.0]);
    let mut strange_bytes = bytes_of(&plain);
    strange_bytes.push(0);
    let mut big_endian = bytes_of(&plain);
    big_endian[1] = 0;
    let mut far = plain.clone();
    far.header.stamp.nanosec = u32::MAX;
    let values = [0.1f64.sqrt(), f64::NAN, f64::INFINITY, -0.0, 1e300, 5e-324];
    let frame = wrench(START_NS, "another", [1.0; 6]);
    let mut kinds: Vec<Vec<u8>> = values
        .iter()
        .map(|value| {
            bytes_of(&wrench(
                START_NS,
                "sensor",
                [1.0, 0.0, *value, 0.0, 0.0, 0.0],
            ))
        })
        .collect();
    kinds.extend([
        bytes_of(&plain),
        strange_bytes,
        big_endian,
        bytes_of(&far),
        bytes_of(&frame),
        vec![],
        vec![0, 1, 0, 0],
    ]);
    let mut random = Pcg64::seed_from_u64(3);
    let mut sequences = BTreeMap::new();
    let mut expected = Vec::new();
    for i in 0..20_000u64 {
        let publisher = random.random_range(0..3u8);
        let sequence = sequences.entry(publisher).or_insert(0u32);
        *sequence += if random.random_bool(0.99) { 1 } else { 3 };
        let odd = random.random_bool(0.02);
        let bytes = if odd {
            kinds[random.random_range(0..kinds.len())].clone()
        } else {
            bytes_of(&plain)
        };
        let topics = ["/wrench/raw", "/cell2/wrench/raw"];
        let step_ns = if random.random_bool(0.001) {
            3_000_000_000
        } else {
            0
        };
        expected.push(RecordedMessage {
            topic: topics[usize::from(random.random_bool(0.3))].to_owned(),
            type_name: WrenchStamped::NAME.to_owned(),
            log_time_ns: START_NS + i * 1000 + step_ns,
            publish_time_ns: if odd { 0 } else { START_NS + i },
            publisher: [publisher; 16],
            sequence: *sequence,
            bytes,
        });
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.mcap");
    write(&path, &expected, true);
    let recording = Recording::open(&path).unwrap();
    let mut found: Vec<_> = recording.messages().collect();
    // Each publisher's messages are in their order; those of several are set against each other by
    // what they are.
    let order = |m: &RecordedMessage| (m.publisher, m.sequence);
    found.sort_by_key(order);
    expected.sort_by_key(order);
    assert_same(&expected, &found);
}

#[test]
fn a_truncated_file_with_batches_is_repaired_and_loses_at_most_its_last_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.mcap");
    let expected = sensor(20_000, 0.03, SI);
    write(&path, &expected, true);
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() * 2 / 3]).unwrap();
    let torn: Vec<_> = Recording::open(&path).unwrap().messages().collect();
    assert!(torn.len() > 8000);
    let repair = repair::repair(&path).unwrap();
    assert_eq!(repair.messages, torn.len() as u64);
    let mended: Vec<_> = Recording::open(&path).unwrap().messages().collect();
    assert_same(&torn, &mended);
}

/// Arrays of different lengths are not a batch and are not unpacked.
#[test]
fn a_damaged_batch_is_a_message_as_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.mcap");
    let batch = WrenchBatch {
        force_x: vec![1, 2, 3],
        ..WrenchBatch::default()
    };
    let mut bytes = Vec::new();
    cdr::encode(&batch, &mut bytes).unwrap();
    let mut writer = RecordingWriter::create(&path).unwrap();
    for bytes in [&bytes[..], &bytes[..9], &[]] {
        let record = Record {
            topic: "/wrench/raw/packed",
            type_name: WrenchBatch::NAME,
            definition: Some(&WrenchBatch::definition()),
            publisher: [1; 16],
            sequence: 1,
            log_time_ns: 1,
            publish_time_ns: 1,
            bytes,
        };
        writer.write(&record).unwrap();
    }
    writer.finish().unwrap();
    let found: Vec<_> = Recording::open(&path).unwrap().messages().collect();
    assert_eq!(found.len(), 3);
    assert!(found.iter().all(|m| m.topic == "/wrench/raw/packed"));
}
