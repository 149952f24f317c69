//! States out: key, payload, attachment and tokens.

use std::sync::mpsc::channel;

use tangent_runtime::clock::now_ns;
use tangent_schemas::standard::{Header, JointState};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{Message, cdr, topics};
use zenoh::Wait;
use zenoh::sample::Sample;

use crate::common::{Cell, JOINTS, PATIENCE, until};

fn arm(cycle: u64) -> ArmState {
    ArmState {
        header: Header::new(1_700_000_000_000_000_000 + cycle as i64, "base"),
        cycle,
        q: [0.1, -0.2].into_iter().collect(),
        qd: [0.01, 0.02].into_iter().collect(),
        ..ArmState::default()
    }
}

/// Publishes states until `count` samples of a key came.
fn samples(cell: &Cell, key: &str, count: usize) -> Vec<Sample> {
    let (sender, samples) = channel();
    let _reader = cell
        .ros
        .declare_subscriber(key.to_owned())
        .callback(move |sample| {
            let _ = sender.send(sample);
        })
        .wait()
        .unwrap();
    let publisher = cell.bus.publisher(&topics::ARM_STATE).unwrap();
    let mut taken = Vec::new();
    let mut cycle = 0;
    until("the samples", || {
        cycle += 1;
        publisher.publish(&arm(cycle));
        taken.extend(samples.try_iter());
        taken.len() >= count
    });
    taken
}

#[test]
fn a_state_has_the_key_the_bytes_and_the_attachment_of_rmw_zenoh() {
    let cell = Cell::start("rate_max_hz = 0.0", "");
    let before_ns = now_ns();
    let key = Cell::key(&format!("{}/arm/state", cell.name), ArmState::NAME);
    let taken = samples(&cell, &key, 5);
    let mut former: Option<(i64, u64)> = None;
    let gid = taken[0].attachment().unwrap().to_bytes()[17..].to_vec();
    for sample in &taken {
        assert_eq!(sample.key_expr().as_str(), key);
        let message: ArmState = cdr::decode(&sample.payload().to_bytes()).unwrap();
        assert_eq!(message, arm(message.cycle));
        let bytes = sample.attachment().unwrap().to_bytes();
        assert_eq!(bytes.len(), 33);
        let sequence = i64::from_le_bytes(bytes[..8].try_into().unwrap());
        let source_ns = i64::from_le_bytes(bytes[8..16].try_into().unwrap());
        assert_eq!(bytes[16], 16);
        assert_eq!(&bytes[17..], gid, "one id for the life of a publisher");
        assert!((before_ns..=now_ns()).contains(&source_ns));
        if let Some((last, cycle)) = former {
            assert_eq!(sequence - last, 1, "the sequence has no gap");
            assert!(message.cycle > cycle);
        }
        former = Some((sequence, message.cycle));
    }
    assert_ne!(gid, [0; 16]);
}

#[test]
fn the_arm_is_a_joint_state_too() {
    let cell = Cell::start("publish = []", "");
    let key = Cell::key(&format!("{}/joint_states", cell.name), JointState::NAME);
    let taken = samples(&cell, &key, 2);
    let message: JointState = cdr::decode(&taken[0].payload().to_bytes()).unwrap();
    assert_eq!(message.name, JOINTS);
    assert_eq!(message.position, [0.1, -0.2]);
    assert_eq!(message.velocity, [0.01, 0.02]);
    assert!(message.header.stamp.to_ns() > 1_700_000_000_000_000_000);
    let arm = format!("{}/arm/state", cell.name);
    assert!(
        !cell
            .tokens()
            .iter()
            .any(|token| token.contains(&arm.replace('/', "%")))
    );
}

#[test]
fn the_graph_has_the_node_and_its_endpoints_as_long_as_it_runs() {
    let mut cell = Cell::start("domain_id = 0\ninputs = { base_pose = \"/odom/pose\" }", "");
    let publisher = cell.bus.publisher(&topics::ARM_STATE).unwrap();
    let name = cell.name.clone();
    let mut cycle = 0;
    until("the topic", || {
        cycle += 1;
        publisher.publish(&arm(cycle));
        let tokens = cell.tokens();
        tokens.iter().any(|token| token.contains("%arm%state/"))
    });
    let tokens = cell.tokens();
    let node: Vec<&str> = tokens
        .iter()
        .map(String::as_str)
        .filter(|token| token.contains("/NN/"))
        .collect();
    let [node] = node[..] else {
        panic!("{tokens:?}")
    };
    let parts: Vec<&str> = node.split('/').collect();
    let session = parts[2];
    assert_eq!(
        node,
        format!("@ros2_lv/0/{session}/0/0/NN/%/%{name}/tangent")
    );
    let hash = tangent_ros2::type_hash::of_message(ArmState::NAME).unwrap();
    let ends = |kind: &str, end: &str| {
        let begin = format!("@ros2_lv/0/{session}/0/");
        let middle = format!("/{kind}/%/%{name}/tangent/{end}");
        let count = tokens
            .iter()
            .filter(|token| token.starts_with(&begin) && token.ends_with(&middle))
            .count();
        assert_eq!(count, 1, "{middle} in {tokens:#?}");
    };
    ends(
        "MP",
        &format!("%{name}%arm%state/tangent_msgs::msg::dds_::ArmState_/{hash}/::,10:,:,:,,"),
    );
    ends(
        "MS",
        "%odom%pose/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/\
         RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e/2::,5:,:,:,,",
    );
    for command in ["stop", "pause", "status"] {
        ends(
            "SS",
            &format!(
                "%{name}%{command}/std_srvs::srv::dds_::Trigger_/\
                 RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f/::,10:,:,:,,"
            ),
        );
    }
    for command in ["start", "resume", "select", "tare"] {
        let part = format!("%{name}%{command}/");
        assert!(
            !tokens.iter().any(|token| token.contains(&part)),
            "{command}"
        );
    }
    // Every endpoint has a number of its own.
    let mut ids: Vec<&str> = tokens
        .iter()
        .filter_map(|token| token.split('/').nth(4))
        .collect();
    let all = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), all);
    cell.end_service().unwrap();
    until("the end of the tokens", || cell.tokens().is_empty());
}

/// A second service in the cell would carry out each command twice.
#[test]
fn a_cell_has_one_bridge_to_ros() {
    let cell = Cell::start("", "");
    let begin = std::time::Instant::now();
    let second = tangent_runtime::HealthReporter::start_only(&cell.bus, "ros2");
    assert!(second.is_err() && begin.elapsed() < PATIENCE);
}
