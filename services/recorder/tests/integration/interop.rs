//! Third-party programs read the recordings: `mcap` with `mcap-ros2-support`, and `rosbags`, from
//! PyPI.

use std::path::Path;

use serde_json::{Value, json};
use tangent_live::interop::output_of;
use tangent_recorder::{FileOptions, Record, RecordingWriter};
use tangent_schemas::standard::{
    CompressedImage, Header, JointState, Marker, MarkerArray, PoseStamped, TFMessage,
    TransformStamped, WrenchStamped,
};
use tangent_schemas::tangent::{
    ArmCommand, ArmState, ContactTruth, ControlState, Health, NormalEstimate, WrenchStatus,
};
use tangent_schemas::{Message, cdr};

/// Messages per topic.
const EACH: u32 = 25;

fn put<M: Message>(writer: &mut RecordingWriter, topic: &str, sequence: u32, message: &M) {
    let mut bytes = Vec::new();
    cdr::encode(message, &mut bytes).unwrap();
    let time_ns = 1_795_260_245_000_000_000 + u64::from(sequence) * 8_000_000;
    writer
        .write(&Record {
            // One that ends, and one in its place.
            publisher: [if sequence < 10 { 1 } else { 2 }; 16],
            topic,
            type_name: M::NAME,
            definition: Some(&M::definition()),
            sequence,
            log_time_ns: time_ns,
            publish_time_ns: time_ns,
            bytes: &bytes,
        })
        .unwrap();
}

/// Values like those of a sensor: whole numbers of micronewtons.
fn raw_wrench(i: u32) -> WrenchStamped {
    let mut wrench = WrenchStamped {
        header: Header::new(1_795_260_245_000_000_000 + i64::from(i) * 142_857, "sensor"),
        ..WrenchStamped::default()
    };
    wrench.wrench.force.z = (f64::from(i) + 1.0) * -1e-6;
    wrench
}

fn record(path: &Path) {
    let options = FileOptions {
        compress: true,
        pack: true,
    };
    let mut writer = RecordingWriter::create_with(path, options).unwrap();
    let facts = [("version".to_owned(), "0.1.0".to_owned())];
    writer.metadata("tangent", facts.into()).unwrap();
    writer
        .attach("cell.toml", "[cell]\nname = \"ä\"\n", 1)
        .unwrap();
    for i in 0..EACH {
        let header = Header::new(1_795_260_245_000_000_000, "base");
        let number = f64::from(i);
        let w = &mut writer;
        put(
            w,
            "/arm/state",
            i,
            &ArmState {
                header: header.clone(),
                cycle: u64::from(i),
                q: [0.5, number, -1.5, 2.0, 0.25, 3.0].into_iter().collect(),
                ..ArmState::default()
            },
        );
        put(
            w,
            "/health/netft",
            i,
            &Health {
                rate_names: vec!["records".to_owned(), "ü".to_owned()],
                rates_hz: vec![7000.0, number],
                fault: format!("fault {i}"),
                ..Health::default()
            },
        );
        put(w, "/arm/command", i, &ArmCommand::default());
        put(w, "/control/state", i, &ControlState::default());
        put(w, "/estimate/blend/normal", i, &NormalEstimate::default());
        put(w, "/truth/contact", i, &ContactTruth::default());
        put(w, "/wrench/tool", i, &WrenchStamped::default());
        put(w, "/wrench/raw", i, &raw_wrench(i));
        put(w, "/wrench/status", i, &WrenchStatus::default());
        put(w, "/joints", i, &JointState::default());
        put(w, "/pose", i, &PoseStamped::default());
        put(w, "/image", i, &CompressedImage::default());
        put(
            w,
            "/tf",
            i,
            &TFMessage {
                transforms: vec![TransformStamped::default(); 2],
            },
        );
        put(
            w,
            "/markers",
            i,
            &MarkerArray {
                markers: vec![Marker::default(); 3],
            },
        );
    }
    writer.finish().unwrap();
}

#[test]
fn third_party_programs_read_every_message() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell1.mcap");
    record(&path);
    let Some(said) = output_of("read_recording.py", &[&path]) else {
        return;
    };
    let found: Value = serde_json::from_str(&said).unwrap();
    let cycles: Vec<u32> = (0..EACH).collect();
    let faults: Vec<String> = cycles.iter().map(|i| format!("fault {i}")).collect();
    for reader in ["mcap", "rosbags"] {
        let counts = found[reader]["counts"].as_object().unwrap();
        assert_eq!(counts.len(), 14, "{reader}: {counts:?}");
        for (topic, count) in counts {
            // Those of `/wrench/raw` are in arrays: one for each publisher.
            let packed = topic.starts_with("/wrench/raw/packed ");
            let expected = if packed { 2 } else { EACH };
            assert_eq!(*count, json!(expected), "{reader}: {topic}");
        }
        let numbers = &found[reader]["numbers"];
        assert_eq!(numbers["cycle"], json!(cycles), "{reader}");
        assert_eq!(numbers["q"][7], json!([0.5, 7.0, -1.5, 2.0, 0.25, 3.0]));
        assert_eq!(numbers["rate_names"][3], json!(["records", "ü"]));
        assert_eq!(numbers["fault"], json!(faults));
        let force_z: Vec<f64> = cycles
            .iter()
            .map(|i| (f64::from(*i) + 1.0) * -1e-6)
            .collect();
        assert_eq!(numbers["raw_force_z"], json!(force_z), "{reader}");
    }
    assert_eq!(found["mcap"]["profile"], "ros2");
    assert_eq!(found["mcap"]["metadata"]["tangent"]["version"], "0.1.0");
    assert_eq!(
        found["mcap"]["attachments"]["cell.toml"],
        "[cell]\nname = \"ä\"\n"
    );
}
