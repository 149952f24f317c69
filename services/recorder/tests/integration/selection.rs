//! Messages that are decoded in several threads are those that are read one by one, in the same
//! order, whatever the file has suffered.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use tangent_recorder::{FileOptions, Record, Recording, RecordingWriter};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::{Message, cdr};

const S: u64 = 1_000_000_000;

/// Topic, type, time of receipt and bytes.
type Read = (String, String, u64, Vec<u8>);

/// Three topics, one of them packed, and messages that were requested again; a chunk each 0.4 s.
fn write(path: &Path, compress: bool) {
    let options = FileOptions {
        compress,
        pack: true,
    };
    let mut writer = RecordingWriter::create_with(path, options).unwrap();
    let mut wrench = Vec::new();
    cdr::encode(&WrenchStamped::default(), &mut wrench).unwrap();
    let mut late = Vec::new();
    for tick in 0..400_u32 {
        let at_ns = 1000 * S + u64::from(tick) * S / 100;
        let text = [0, 1, 0, 0, tick as u8, (tick >> 8) as u8];
        for (topic, type_name, publisher, bytes) in [
            ("/a", "x/msg/A", 1, &text[..]),
            ("/wrench/raw", WrenchStamped::NAME, 2, &wrench),
            ("/foreign", "x/msg/F", 0, &text),
        ] {
            // A topic that begins later, in a chunk of its own.
            let topic = if tick > 200 && topic == "/foreign" {
                "/later"
            } else {
                topic
            };
            let record = Record {
                topic,
                type_name,
                definition: None,
                publisher: [publisher; 16],
                sequence: tick,
                log_time_ns: at_ns,
                publish_time_ns: at_ns - 1000,
                bytes,
            };
            if topic == "/a" && (100..140).contains(&tick) {
                late.push((tick, at_ns, text));
                continue;
            }
            writer.write(&record).unwrap();
        }
        if tick % 40 == 39 {
            writer.flush().unwrap();
        }
        if tick == 300 {
            for (sequence, published_ns, text) in late.drain(..) {
                let again = Record {
                    topic: "/a",
                    type_name: "x/msg/A",
                    definition: None,
                    publisher: [1; 16],
                    sequence,
                    log_time_ns: at_ns,
                    publish_time_ns: published_ns - 1000,
                    bytes: &text,
                };
                writer.write(&again).unwrap();
            }
        }
    }
    writer.finish().unwrap();
}

/// What both ways read, and whether they found damage; and the counts by topic.
fn read(path: &Path) -> Option<(Vec<Read>, bool, BTreeMap<String, u64>)> {
    let recording = Recording::open(path).ok()?;
    let (mut found, mut is_damaged) = (Vec::new(), false);
    let held = recording.decode_selected(
        |contents| Some((contents.topic.to_owned(), contents.type_name.to_owned())),
        |(topic, type_name), stored| {
            let (topic, type_name) = (topic.clone(), type_name.clone());
            (topic, type_name, stored.log_time_ns, stored.bytes.to_vec())
        },
        |read| match read {
            Ok(message) => found.push(message),
            Err(_) => is_damaged = true,
        },
    );
    let counts = held.into_iter().map(|held| (held.topic, held.count));
    Some((found, is_damaged, counts.collect()))
}

fn one_by_one(path: &Path) -> (Vec<Read>, bool, BTreeMap<String, u64>) {
    let recording = Recording::open(path).unwrap();
    let (mut found, mut is_damaged, mut counts) = (Vec::new(), false, BTreeMap::new());
    for message in recording.try_messages() {
        let Ok(message) = message else {
            is_damaged = true;
            continue;
        };
        *counts.entry(message.topic.clone()).or_default() += 1;
        found.push((
            message.topic,
            message.type_name,
            message.log_time_ns,
            message.bytes,
        ));
    }
    (found, is_damaged, counts)
}

#[test]
fn decoding_in_threads_reads_what_is_read_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    for compress in [true, false] {
        let path = folder.path().join(format!("{compress}.mcap"));
        write(&path, compress);
        let (found, is_damaged, counts) = read(&path).unwrap();
        assert_eq!((found.len(), is_damaged), (1200, false));
        let expected = [
            ("/a", 400),
            ("/foreign", 201),
            ("/later", 199),
            ("/wrench/raw", 400),
        ];
        let expected = expected.map(|(topic, count)| (topic.to_owned(), count));
        assert_eq!(counts, BTreeMap::from(expected));
        assert!((found, is_damaged, counts) == one_by_one(&path));
    }
}

#[test]
fn only_what_is_selected_is_decoded_and_everything_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.mcap");
    write(&path, true);
    let mut times = Vec::new();
    let held = Recording::open(&path).unwrap().decode_selected(
        |contents| (contents.topic == "/a").then_some(()),
        |(), stored| (stored.publish_time_ns, stored.bytes.len()),
        |read| times.push(read.unwrap()),
    );
    assert_eq!(times.len(), 400);
    assert!(times.is_sorted() && times.iter().all(|(_, bytes)| *bytes == 6));
    assert_eq!(held.iter().map(|held| held.count).sum::<u64>(), 1200);
}

#[test]
fn a_file_that_is_cut_or_damaged_anywhere_is_read_at_least_as_far_as_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    for compress in [true, false] {
        let path = folder.path().join(format!("{compress}.mcap"));
        write(&path, compress);
        let whole = fs::read(&path).unwrap();
        let step = whole.len() / 150 + 1;
        let mut shorter = 0;
        for at in (8..whole.len()).step_by(step) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x40;
            for bytes in [&whole[..at], &damaged] {
                fs::write(&path, bytes).unwrap();
                let Some(found) = read(&path) else {
                    continue;
                };
                let expected = one_by_one(&path);
                // Damage outside the chunks ends only the reading one by one.
                let all: BTreeSet<&Read> = found.0.iter().collect();
                assert!(
                    expected.0.iter().all(|one| all.contains(one)),
                    "{compress}, byte {at}"
                );
                if expected.0.len() == found.0.len() {
                    assert!(found.0 == expected.0, "{compress}, byte {at}");
                    assert_eq!(found.2, expected.2, "{compress}, byte {at}");
                }
                assert!(expected.1 || !found.1, "{compress}, byte {at}");
                assert!(
                    expected.1 || found.0.len() == expected.0.len(),
                    "{compress}, byte {at}"
                );
                shorter += usize::from(found.0.len() < 1200);
            }
        }
        assert!(shorter > 100, "{shorter}");
    }
}
