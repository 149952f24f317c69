use tangent_recorder::{Record, RecordingWriter};
use tangent_schemas::{Message, cdr};

use crate::testing::{START_NS, cell, image, info, state};

use super::*;

const PATIENCE: Duration = Duration::from_millis(1);

/// Messages of two seconds, in the order of their arrival: images arrive 40 ms after their stamps.
enum Sent {
    Arm(Box<ArmState>),
    Info(Box<CameraInfo>),
    Depth(Image),
}

fn two_seconds() -> Vec<(i64, Sent)> {
    let mut sent = Vec::new();
    for at_ms in (0..2000).step_by(10) {
        let x_m = 0.1 + 5e-5 * at_ms as f64;
        sent.push((at_ms, Sent::Arm(Box::new(state(at_ms, x_m)))));
        if at_ms % 1000 == 500 {
            sent.push((at_ms, Sent::Info(Box::new(info()))));
        }
        if at_ms % 50 == 40 {
            sent.push((at_ms, Sent::Depth(image(at_ms - 40))));
        }
    }
    sent
}

fn put<T: Message>(writer: &mut RecordingWriter, topic: &str, at_ms: i64, message: &T) {
    let time_ns = (START_NS + at_ms * 1_000_000) as u64;
    let mut bytes = Vec::new();
    cdr::encode(message, &mut bytes).unwrap();
    writer
        .write(&Record {
            publisher: [0; 16],
            topic,
            type_name: T::NAME,
            definition: Some(&T::definition()),
            sequence: at_ms as u32 + 1,
            log_time_ns: time_ns,
            publish_time_ns: time_ns,
            bytes: &bytes,
        })
        .unwrap();
}

fn record(sent: &[(i64, Sent)], file: &std::path::Path) {
    let mut writer = RecordingWriter::create(file).unwrap();
    for (at_ms, message) in sent {
        match message {
            Sent::Arm(state) => put(&mut writer, "/arm/state", *at_ms, &**state),
            Sent::Info(info) => put(&mut writer, "/camera/info", *at_ms, &**info),
            Sent::Depth(image) => put(&mut writer, "/camera/depth", *at_ms, image),
        }
    }
    writer.finish().unwrap();
}

/// The bug that it guards against: images of a recording were placed with the time at which they
/// were published, some 40 ms after their exposure.
#[test]
fn a_recording_and_a_running_cell_give_one_scan() {
    let (sent, cell) = (two_seconds(), cell());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scan.mcap");
    record(&sent, &file);
    let recorded = crate::of_recording(&file, &cell).unwrap();

    let bus = Bus::in_process("scan-live");
    let mut live = LiveScan::open(&bus, &cell).unwrap();
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let camera = bus.publisher(&topics::CAMERA_DEPTH).unwrap();
    let infos = bus.publisher(&topics::CAMERA_INFO).unwrap();
    for (_, message) in &sent {
        match message {
            Sent::Arm(state) => arm.publish(state),
            Sent::Info(info) => infos.publish(info),
            Sent::Depth(image) => camera.publish(image),
        };
        live.look(Duration::ZERO);
    }
    let seen = live.seen(Instant::now());
    assert_eq!((seen.tally.received, seen.images), (40, 40));
    assert!(seen.area_cm2 > 700.0, "{}", seen.area_cm2);
    let scanned = live.finish().unwrap();
    assert_eq!(scanned, recorded);
    assert_eq!(scanned.images, 40);
    // The first image: x = 0.1 m.
    let first = &scanned.points[..scanned.points.len() / 40];
    let mean_x = first.iter().map(|p| p.x).sum::<f64>() / first.len() as f64;
    assert!((mean_x - 0.1).abs() < 1e-6, "{mean_x}");
    // `tangent region` reads the file.
    let ply = scanned.to_ply("scanned");
    let header = b"ply\nformat binary_little_endian 1.0\n";
    assert!(ply.starts_with(header) && ply.len() > 12 * scanned.points.len());
}

#[test]
fn what_is_missing_is_said_with_what_to_do() {
    let bus = Bus::in_process("scan-missing");
    let mut live = LiveScan::open(&bus, &cell()).unwrap();
    live.look(PATIENCE);
    assert!(live.seen(live.began).missing.is_empty(), "too early to say");
    let later = live.began + 2 * SILENCE;
    let said = live.seen(later).missing.join("; ");
    assert!(
        said.contains("no camera/depth") && said.contains("no arm/state"),
        "{said}"
    );
    let camera = bus.publisher(&topics::CAMERA_DEPTH).unwrap();
    camera.publish(&image(0));
    live.look(PATIENCE);
    live.began -= 2 * SILENCE;
    let seen = live.seen(Instant::now());
    let said = seen.missing.join("; ");
    assert!(
        said.contains("no arm/state") && said.contains("no camera/info"),
        "{said}"
    );
    assert!(!said.contains("camera/depth"), "{said}");
    assert!(seen.words().contains("no arm"), "{}", seen.words());
    let error = live.finish().unwrap_err().to_string();
    for words in ["cell scanned", "no arm/state", "no camera/info"] {
        assert!(error.contains(words), "{words}: {error}");
    }
}

#[test]
fn a_camera_that_falls_silent_leaves_what_was_seen_and_says_so() {
    let bus = Bus::in_process("scan-silent");
    let mut live = LiveScan::open(&bus, &cell()).unwrap();
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let camera = bus.publisher(&topics::CAMERA_DEPTH).unwrap();
    bus.publisher(&topics::CAMERA_INFO)
        .unwrap()
        .publish(&info());
    arm.publish(&state(0, 0.1));
    arm.publish(&state(10, 0.1));
    camera.publish(&image(5));
    live.look(PATIENCE);
    assert_eq!(live.seen(Instant::now()).images, 1);
    // As if three seconds had passed since.
    let back = |heard: &mut Heard| {
        heard.newest = heard.newest.map(|at| at - Duration::from_secs(3));
    };
    back(&mut live.camera);
    live.began -= Duration::from_secs(3);
    arm.publish(&state(20, 0.1));
    live.look(PATIENCE);
    let said = live.seen(Instant::now()).missing.join("; ");
    assert!(
        said.contains("no camera/depth") && !said.contains("arm/state"),
        "{said}"
    );
    let scan = live.finish().unwrap();
    assert_eq!((scan.images, scan.lost.len()), (1, 1));
    assert!(
        scan.lost[0].contains("camera/depth was silent for 3."),
        "{:?}",
        scan.lost
    );
}

#[test]
fn a_cell_without_a_depth_camera_is_refused() {
    let mut cell = cell();
    let bus = Bus::in_process("scan-none");
    let said = |cell: &CellConfig| match LiveScan::open(&bus, cell) {
        Ok(_) => panic!("it is accepted"),
        Err(error) => error.to_string(),
    };
    cell.camera.as_mut().unwrap().kind = tangent_runtime::config::CameraKind::Target;
    assert!(said(&cell).contains("camera.kind"));
    cell.camera = None;
    assert!(said(&cell).contains("[camera]"));
}
