use super::*;
use crate::Recording;
use tangent_runtime::bus::answer::done_with;
use tangent_runtime::{CellConfig, Parameters, Role};
use tangent_schemas::tangent::ArmState;

fn config(folder: &std::path::Path) -> RecorderConfig {
    RecorderConfig {
        folder: folder.to_owned(),
        free_min_bytes: 0,
        ..RecorderConfig::default()
    }
}

/// Waits for another thread; fails after half a minute.
fn until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < Duration::from_secs(30), "never: {what}");
        std::thread::yield_now();
    }
}

#[test]
fn every_topic_is_recorded_with_what_belongs_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::in_process("cell1");
    let parameters = Parameters::new(&bus, "netft").unwrap();
    parameters.number("cutoff_hz", 50.0, 1.0..=100.0, "Hz", "Filter.");
    let _task = bus
        .answer(topics::queries::CONTROL_SHOW, |_, _| {
            done_with("wipe", &serde_json::json!({"task_toml": "name = \"wipe\""}))
        })
        .unwrap();
    let mut service = Service::new(config(folder.path()), &bus, &bus).unwrap();
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
    let foreign = bus.raw_publisher("camera/odd", "odd_msgs/msg/Odd").unwrap();
    let mut sent = Vec::new();
    for cycle in 0..50 {
        let state = ArmState {
            cycle,
            ..ArmState::default()
        };
        arm.publish(&state);
        sent.push(state);
        foreign.publish(&[0, 1, 0, 0, cycle as u8]);
    }
    control.publish(&ControlState {
        activation: 3,
        ..ControlState::default()
    });
    // 101 messages of this test, and the first health message.
    until("messages arrive", || service.messages.waiting() >= 102);
    while let Some(message) = service.messages.try_recv() {
        service.take(&message);
    }
    assert_eq!(service.activations[""], 3);
    let summary = service.finish();
    assert_eq!(summary.lost(), 0);
    assert_eq!(summary.files.len(), 1);

    let recording = Recording::open(&summary.files[0]).unwrap();
    assert!(!recording.is_truncated());
    let messages: Vec<_> = recording.messages().collect();
    assert_eq!(messages.len() as u64, summary.recorded);
    let states: Vec<ArmState> = messages
        .iter()
        .filter(|m| m.topic == "/arm/state")
        .map(|m| cdr::decode(&m.bytes).unwrap())
        .collect();
    assert_eq!(states, sent);
    let odd: Vec<_> = messages
        .iter()
        .filter(|m| m.type_name == "odd_msgs/msg/Odd")
        .collect();
    assert_eq!(odd.len(), 50);
    assert_eq!(odd[49].bytes, [0, 1, 0, 0, 49]);
    assert!(messages.iter().any(|m| m.topic == "/health/recorder"));
    assert!(messages.iter().all(|m| m.publish_time_ns > 0));
    assert_eq!(recording.attachments()["task-3.toml"], "name = \"wipe\"");
    let metadata = recording.metadata();
    assert_eq!(metadata["parameters"]["netft/cutoff_hz"], "50 Hz");
    assert_eq!(metadata["losses"]["queue_dropped"], "0");
    assert_eq!(metadata["losses"]["recorded"], summary.recorded.to_string());
    assert_eq!(metadata["tangent"]["version"], env!("CARGO_PKG_VERSION"));
}

#[test]
fn a_queue_that_overflows_costs_messages_that_are_counted_and_no_publisher_waits() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::in_process("cell1");
    let service = Service::new(
        RecorderConfig {
            queue: 10,
            include: vec!["arm/state".to_owned()],
            ..config(folder.path())
        },
        &bus,
        &bus,
    )
    .unwrap();
    // No message is taken from the queue, as with a disk that hangs.
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    for i in 1..=100 {
        arm.publish(&ArmState::default());
        until("one more arrives", || {
            service.messages.counts().received == i
        });
    }
    let summary = service.finish();
    assert_eq!((summary.recorded, summary.queue_dropped), (10, 90));
    assert_eq!(summary.lost(), 90);
    let recording = Recording::open(&summary.files[0]).unwrap();
    assert_eq!(recording.metadata()["losses"]["queue_dropped"], "90");
}

#[test]
fn the_last_messages_are_recorded_even_if_they_did_not_arrive() {
    let patience = Duration::from_secs(20);
    let port = tangent_live::ports::free();
    let mut cell = CellConfig::default_cell();
    cell.cell.name = format!("test{port}");
    cell.zenoh.connect = vec![format!("tcp/127.0.0.1:{port}")];
    cell.zenoh.listen = cell.zenoh.connect.clone();
    let _router = Bus::open_within(&cell, Role::Router, patience).unwrap();
    let robot = Bus::open_within(&cell, Role::Client, patience).unwrap();
    let recorder = Bus::open_within(&cell, Role::Client, patience).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let config = RecorderConfig {
        include: vec!["arm/state".to_owned()],
        ..config(folder.path())
    };
    let arm = robot.publisher(&topics::ARM_STATE).unwrap();
    let mut service = Service::new(config, &recorder, &recorder).unwrap();
    until("it is read", || arm.is_read_remotely());
    for _ in 0..10 {
        arm.publish(&ArmState::default());
    }
    until("messages arrive", || service.messages.waiting() == 10);
    for _ in 0..6 {
        service.take(&service.messages.try_recv().unwrap());
    }
    // The last four are lost on their way, and none comes behind them.
    while service.messages.try_recv().is_some() {}
    let summary = service.finish();
    assert_eq!((summary.recorded, summary.recovered), (10, 4));
    assert_eq!((summary.missing, summary.lost()), (0, 0));
}

#[test]
fn only_what_is_included_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::in_process("cell1");
    let mut service = Service::new(
        RecorderConfig {
            include: vec!["arm/*".to_owned(), "arm/state".to_owned()],
            ..config(folder.path())
        },
        &bus,
        &bus,
    )
    .unwrap();
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
    control.publish(&ControlState::default());
    arm.publish(&ArmState::default());
    until("messages arrive", || service.messages.waiting() >= 2);
    while let Some(message) = service.messages.try_recv() {
        service.take(&message);
    }
    assert_eq!(service.finish().recorded, 1);
}

#[test]
fn what_is_excluded_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::in_process("cell1");
    let config = RecorderConfig {
        // The recorder's own health must not be counted here.
        include: vec!["arm/*".to_owned(), "control/*".to_owned()],
        exclude: vec!["control/*".to_owned()],
        ..config(folder.path())
    };
    let mut service = Service::new(config, &bus, &bus).unwrap();
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
    control.publish(&ControlState::default());
    arm.publish(&ArmState::default());
    until("messages arrive", || service.messages.waiting() >= 2);
    while let Some(message) = service.messages.try_recv() {
        service.take(&message);
    }
    let summary = service.finish();
    assert_eq!((summary.recorded, summary.lost()), (1, 0));
}
