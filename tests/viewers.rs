//! What viewers show: a live cell through the Foxglove protocol, its recording read by other
//! people's programs, and the layout files of `deploy/viewers` against that recording.

#![allow(clippy::unwrap_used)]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::Duration;

use common::{Process, port_offset, root, wait_for};
use futures_util::{SinkExt, StreamExt};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use tangent_live::{interop, live_beside_others};
use tangent_recorder::Recording;
use tangent_schemas::definition::{Base, Count, definition, fields, file};
use tangent_schemas::standard::{JointState, MarkerArray, TFMessage, Transform};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{Message as _, cdr};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

const PATIENCE: Duration = Duration::from_secs(120);
/// What the viewers need, and the types.
const VIEWED: [(&str, &str); 5] = [
    ("/joint_states", "sensor_msgs/msg/JointState"),
    ("/markers", "visualization_msgs/msg/MarkerArray"),
    ("/robot_description", "std_msgs/msg/String"),
    ("/tf", "tf2_msgs/msg/TFMessage"),
    ("/tf_static", "tf2_msgs/msg/TFMessage"),
];

#[test]
fn a_cell_is_seen_live_and_in_its_recording() {
    live_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = port.local_addr().unwrap().to_string();
        drop(port);
        let recordings = folder.path().join("recordings");
        let mut up = Process::start(
            "up",
            &[
                "up",
                "--scenario",
                "pipe_ideal",
                "--folder",
                recordings.to_str().unwrap(),
                "--port-offset",
                &port_offset().to_string(),
                "--foxglove",
                &address,
            ],
        );
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder
            .enable_all()
            .build()
            .unwrap()
            .block_on(seen_live(&address));
        let code = wait_for("the task's end", PATIENCE, || up.code());
        // Code 3: a busy machine may miss a cycle, which this test does not check.
        assert!(code == 0 || code == 3, "{code}");

        let path = recording(&recordings);
        let recording = Recording::open(&path).unwrap();
        let types: BTreeMap<String, String> = recording
            .messages()
            .map(|m| (m.topic.clone(), m.type_name.clone()))
            .collect();
        for (topic, of) in VIEWED {
            assert_eq!(types.get(topic).map(String::as_str), Some(of), "{topic}");
        }
        the_frames_end_at_the_recorded_tool(&recording);
        the_markers_show_the_task(&recording);
        the_layouts_name_what_is_there(&types);
        other_programs_read_it(&path, folder.path());
    });
}

fn recording(folder: &Path) -> PathBuf {
    let paths = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut found: Vec<PathBuf> = paths
        .filter(|p| p.extension().is_some_and(|e| e == "mcap"))
        .collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found.remove(0)
}

/// A client of the protocol sees every topic with its schema, and receives frames and joints.
async fn seen_live(address: &str) {
    let end = tokio::time::Instant::now() + PATIENCE;
    let mut socket = loop {
        let mut request = format!("ws://{address}/").into_client_request().unwrap();
        let protocol = "foxglove.sdk.v1".parse().unwrap();
        request
            .headers_mut()
            .insert("Sec-WebSocket-Protocol", protocol);
        match connect_async(request).await {
            Ok((socket, _)) => break socket,
            Err(error) => assert!(tokio::time::Instant::now() < end, "{address}: {error}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    let mut advertised: BTreeMap<String, Value> = BTreeMap::new();
    let mut received: BTreeMap<u32, Vec<u8>> = BTreeMap::new();
    while received.len() < VIEWED.len() {
        let message = tokio::time::timeout_at(end, socket.next()).await;
        let message = message.unwrap_or_else(|_| {
            let topics: Vec<_> = advertised.keys().collect();
            panic!("received only {:?} of {topics:?}", received.keys())
        });
        match message.unwrap().unwrap() {
            Message::Text(text) => {
                let value: Value = serde_json::from_str(&text).unwrap();
                for channel in value["channels"].as_array().into_iter().flatten() {
                    let topic = channel["topic"].as_str().unwrap();
                    advertised.insert(topic.to_owned(), channel.clone());
                    if let Some(id) = VIEWED.iter().position(|(viewed, _)| *viewed == topic) {
                        let wanted = json!({
                            "op": "subscribe",
                            "subscriptions": [{"id": id, "channelId": channel["id"]}],
                        });
                        let wanted = Message::Text(wanted.to_string().into());
                        socket.send(wanted).await.unwrap();
                    }
                }
            }
            Message::Binary(bytes) if bytes[0] == 1 => {
                let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                received.insert(id, bytes[13..].to_vec());
            }
            _ => {}
        }
    }
    for topic in ["/arm/state", "/control/state", "/wrench/tool", "/tf"] {
        let channel = &advertised[topic];
        let of = channel["schemaName"].as_str().unwrap();
        assert_eq!(channel["encoding"], "cdr", "{topic}");
        assert_eq!(channel["schemaEncoding"], "ros2msg", "{topic}");
        assert_eq!(channel["schema"], definition(of).unwrap(), "{topic}");
    }
    for (id, (topic, of)) in VIEWED.iter().enumerate() {
        assert_eq!(advertised[*topic]["schemaName"], *of, "{topic}");
        assert!(received.contains_key(&(id as u32)), "{topic}");
    }
    let joints: JointState = cdr::decode(&received[&0]).unwrap();
    assert_eq!(joints.position.len(), 6);
    let tf: TFMessage = cdr::decode(&received[&3]).unwrap();
    assert!(tf.transforms.iter().any(|t| &*t.child_frame_id == "base"));
}

fn isometry(transform: &Transform) -> Isometry3<f64> {
    let (t, r) = (&transform.translation, &transform.rotation);
    let turn = UnitQuaternion::new_normalize(Quaternion::new(r.w, r.x, r.y, r.z));
    Isometry3::from_parts(Vector3::new(t.x, t.y, t.z).into(), turn)
}

/// The tree is whole, and from the base to the tool it is the pose that the arm states.
fn the_frames_end_at_the_recorded_tool(recording: &Recording) {
    let mut parents: BTreeMap<String, String> = BTreeMap::new();
    let mut fixed = BTreeMap::new();
    let mut moving = Vec::new();
    let mut tools = BTreeMap::new();
    for message in recording.messages() {
        if message.topic == "/arm/state" {
            let arm: ArmState = cdr::decode(&message.bytes).unwrap();
            tools.insert(arm.header.stamp.to_ns(), arm.tool_pose);
        }
        if message.type_name != TFMessage::NAME {
            continue;
        }
        let tf: TFMessage = cdr::decode(&message.bytes).unwrap();
        let mut now = BTreeMap::new();
        for one in &tf.transforms {
            let (child, parent) = (
                one.child_frame_id.to_string(),
                one.header.frame_id.to_string(),
            );
            let other = parents.insert(child.clone(), parent.clone());
            assert!(
                other.is_none_or(|other| other == parent),
                "parents of {child}"
            );
            now.insert(child, isometry(&one.transform));
        }
        if message.topic == "/tf_static" {
            fixed.extend(now);
        } else {
            moving.push((tf.transforms[0].header.stamp.to_ns(), now));
        }
    }
    let chain = |frame: &str| {
        let mut chain = vec![frame.to_owned()];
        while let Some(parent) = parents.get(&chain[chain.len() - 1]) {
            assert!(!chain.contains(parent), "a cycle: {chain:?} {parent}");
            chain.push(parent.clone());
        }
        chain
    };
    let links = ["shoulder_link", "upper_arm_link", "forearm_link"];
    let wrists = ["wrist_1_link", "wrist_2_link", "wrist_3_link"];
    let cell = ["base", "flange", "sensor", "tool", "contact"];
    for frame in links.iter().chain(&wrists).chain(&cell) {
        assert_eq!(chain(frame).last().unwrap(), "world", "{frame}");
    }
    assert_eq!(parents.len(), 11, "{parents:?}");

    let to_tool = chain("tool");
    let mut compared = 0;
    for (stamp, now) in &moving {
        let Some(there) = tools.get(stamp) else {
            continue;
        };
        let links = to_tool.iter().take_while(|frame| *frame != "base");
        let tool = links.fold(Isometry3::identity(), |tool, frame| {
            now.get(frame).unwrap_or_else(|| &fixed[frame]) * tool
        });
        let there = Vector3::new(there.position.x, there.position.y, there.position.z);
        let away = (tool.translation.vector - there).norm();
        assert!(away < 1e-6, "{away} m at {stamp}");
        compared += 1;
    }
    assert!(compared > 50, "{compared} of {}", moving.len());
}

fn the_markers_show_the_task(recording: &Recording) {
    let (mut names, mut bytes, mut first, mut last) = (BTreeSet::new(), 0, u64::MAX, 0);
    for message in recording.messages().filter(|m| m.topic == "/markers") {
        let markers: MarkerArray = cdr::decode(&message.bytes).unwrap();
        names.extend(markers.markers.iter().map(|m| m.ns.to_string()));
        for marker in &markers.markers {
            let numbers = marker.points.iter().flat_map(|p| [p.x, p.y, p.z]);
            assert!(numbers.into_iter().all(f64::is_finite), "{}", marker.ns);
        }
        bytes += message.bytes.len() as u64;
        (first, last) = (
            first.min(message.log_time_ns),
            last.max(message.log_time_ns),
        );
    }
    for name in [
        "normal",
        "force",
        "estimate/blend",
        "uncertainty/blend",
        "path/planned",
        "path/wanted",
        "path/tool",
        "surface",
        "coverage",
    ] {
        assert!(names.contains(name), "{name} is not in {names:?}");
    }
    let rate = bytes as f64 / ((last - first) as f64 * 1e-9);
    println!("markers: {:.1} kB/s before compression", rate * 1e-3);
    assert!(rate < 100e3, "{rate} B/s");
}

/// Whether a message has the field, given by names and array indices: `q[3]`, `normal`, `x`.
fn has_field(type_name: &str, path: &[&str]) -> bool {
    let [first, rest @ ..] = path else {
        return true;
    };
    let (name, index) = match first.split_once('[') {
        Some((name, index)) => (name, index.trim_end_matches(']').parse::<usize>().ok()),
        None => (*first, None),
    };
    let package = type_name.split('/').next().unwrap();
    let all = fields(file(type_name).unwrap(), package);
    let Some(field) = all.iter().find(|field| field.name == name) else {
        return false;
    };
    let counted = match (field.count, index) {
        (Count::One, None) | (Count::Sequence, Some(_)) => true,
        (Count::Fixed(length), Some(index)) => index < length,
        _ => false,
    };
    counted
        && match &field.base {
            Base::Message(inner) => has_field(inner, rest),
            Base::Primitive(_) => rest.is_empty(),
        }
}

#[test]
fn a_field_that_is_not_there_is_noticed() {
    let state = "tangent_msgs/msg/ControlState";
    assert!(has_field(state, &["normal", "x"]) && has_field(state, &["force_n"]));
    assert!(has_field("tangent_msgs/msg/ArmState", &["q[3]"]));
    for wrong in [
        &["force"][..],
        &["normal", "w"],
        &["force_n", "x"],
        &["force_n[0]"],
    ] {
        assert!(!has_field(state, wrong), "{wrong:?}");
    }
    assert!(!has_field("tangent_msgs/msg/ArmState", &["q"]));
}

/// All texts of a JSON value that are topics or message paths.
fn topics_in(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::String(text) if text.starts_with('/') => found.push(text.clone()),
        Value::Array(all) => all.iter().for_each(|one| topics_in(one, found)),
        Value::Object(all) => {
            for (key, one) in all {
                if key.starts_with('/') {
                    found.push(key.clone());
                }
                topics_in(one, found);
            }
        }
        _ => {}
    }
}

fn the_layouts_name_what_is_there(types: &BTreeMap<String, String>) {
    let read = |name: &str| fs::read_to_string(root().join("deploy/viewers").join(name)).unwrap();
    let holds = |layout: &str, topic: &str, path: &[&str]| {
        let of = types.get(topic);
        let of = of.unwrap_or_else(|| panic!("{layout}: {topic} is not recorded"));
        assert!(has_field(of, path), "{layout}: {topic} has no {path:?}");
    };

    let foxglove: Value = serde_json::from_str(&read("foxglove.json")).unwrap();
    let mut found = Vec::new();
    topics_in(&foxglove["configById"], &mut found);
    assert!(found.len() >= 14, "{found:?}");
    for text in &found {
        let mut parts = text.split('.');
        let topic = parts.next().unwrap();
        holds("foxglove.json", topic, &parts.collect::<Vec<_>>());
    }
    // Every panel has a place, and every place a panel.
    let mut placed = Vec::new();
    panels(&foxglove["layout"], &mut placed);
    let configured = foxglove["configById"].as_object().unwrap();
    let configured: BTreeSet<&str> = configured.keys().map(String::as_str).collect();
    assert_eq!(placed.iter().copied().collect::<BTreeSet<_>>(), configured);

    let text = read("plotjuggler.xml");
    let plotjuggler = roxmltree::Document::parse(&text).unwrap();
    let curves: Vec<&str> = plotjuggler
        .descendants()
        .filter(|node| node.has_tag_name("curve"))
        .map(|node| node.attribute("name").unwrap())
        .collect();
    assert!(curves.len() >= 20, "{curves:?}");
    for curve in curves {
        let topic = types.keys().filter(|topic| {
            let rest = curve.strip_prefix(topic.as_str());
            rest.is_some_and(|rest| rest.starts_with('/'))
        });
        let topic = topic.max_by_key(|topic| topic.len());
        let topic = topic.unwrap_or_else(|| panic!("plotjuggler.xml: {curve} is not recorded"));
        let path: Vec<&str> = curve[topic.len() + 1..].split('/').collect();
        holds("plotjuggler.xml", topic, &path);
    }

    let rviz = read("tangent.rviz");
    let named = |line: &'_ str| {
        line.trim()
            .strip_prefix("Value: /")
            .map(|t| format!("/{t}"))
    };
    let rviz: BTreeSet<String> = rviz.lines().filter_map(named).collect();
    let expected = ["/markers", "/robot_description"].map(str::to_owned);
    assert_eq!(rviz, BTreeSet::from(expected));
    let qos = read("qos.yaml");
    let latched: BTreeSet<&str> = qos
        .lines()
        .filter(|line| line.starts_with('/'))
        .map(|line| line.trim_end_matches(':'))
        .collect();
    assert_eq!(
        latched,
        BTreeSet::from(["/robot_description", "/tf_static"])
    );
    for topic in rviz.iter().map(String::as_str).chain(latched) {
        holds("tangent.rviz", topic, &[]);
    }
}

/// Names of the panels in a Foxglove layout.
fn panels<'v>(layout: &'v Value, found: &mut Vec<&'v str>) {
    match layout {
        Value::String(name) => found.push(name),
        _ => {
            panels(&layout["first"], found);
            panels(&layout["second"], found);
        }
    }
}

/// mcap's reader, rosbags, yourdfpy and rerun's converter over the recording.
fn other_programs_read_it(recording: &Path, folder: &Path) {
    let Some(said) = interop::output_of("read_viewer_topics.py", &[recording, folder]) else {
        return;
    };
    let found: Value = serde_json::from_str(&said).unwrap();
    for (topic, of) in VIEWED {
        let key = format!("{topic} {of}");
        let count = found["mcap"][&key].as_u64().unwrap_or(0);
        assert!(count > 0, "mcap: no {key} in {}", found["mcap"]);
        assert_eq!(found["rosbags"][&key], count, "rosbags: {key}");
    }
    for (child, parents) in found["frames"].as_object().unwrap() {
        assert_eq!(parents.as_array().unwrap().len(), 1, "{child}: {parents}");
    }
    let urdf = &found["urdf"];
    assert!(urdf["compared"].as_u64().unwrap() > 50, "{urdf}");
    assert!(urdf["farthest_m"].as_f64().unwrap() < 1e-6, "{urdf}");
    for link in urdf["links"].as_array().unwrap() {
        let link = link.as_str().unwrap();
        let frame = found["frames"].as_object().unwrap().contains_key(link);
        assert!(frame || link == "world", "{link} is no frame of /tf");
    }
    let rerun = &found["rerun"];
    if rerun.is_null() {
        assert!(!interop::is_required(), "rerun is not installed");
        println!("rerun: skipped, because it is not installed");
        return;
    }
    assert_eq!(rerun["code"], 0, "{rerun}");
    assert!(rerun["bytes"].as_u64().unwrap() > 10_000, "{rerun}");
    assert_eq!(
        rerun["topics"].as_array().unwrap().len(),
        VIEWED.len(),
        "{rerun}"
    );
    // It reads the description and draws every link: 6 of the arm, base, flange, sensor and tool.
    assert!(rerun["drawn"].as_u64().unwrap() >= 10, "{rerun}");
}
