//! A program of ROS 2 for the tests of the ROS 2 service: what `ros2 node list`, `topic list`,
//! `topic echo`, `topic pub` and `service call` do, with hiroz in place of rmw_zenoh_cpp.
//!
//! usage: ros2-peer ENDPOINT DOMAIN COMMAND [ARGUMENT...]; every output is one JSON object a line.

#[allow(clippy::all, dead_code, unused)]
mod generated {
    include!(concat!(env!("OUT_DIR"), "/generated.rs"));
}

// The generated types look for it here.
use hiroz_msgs::size_estimation;

use std::collections::BTreeMap;
use std::io::BufRead;
use std::time::{Duration, Instant, SystemTime};

use generated::ros::tangent_msgs;
use hiroz::attachment::Attachment;
use hiroz::context::{ZContext, ZContextBuilder};
use hiroz::msg::{ZDeserializer, ZMessage};
use hiroz::node::ZNode;
use hiroz::{Builder, MessageTypeInfo, Result, ServiceTypeInfo};
use hiroz_msgs::ros::{builtin_interfaces, geometry_msgs, sensor_msgs, std_srvs, tf2_msgs};
use hiroz_protocol::entity::{EndpointKind, Entity};
use hiroz_protocol::{KeyExprFormatter, RmwZenohFormatter};
use serde_json::{Value, json};

/// Wait for something that must come.
const PATIENCE: Duration = Duration::from_secs(20);

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let [endpoint, domain, command, rest @ ..] = &words[..] else {
        return Err("usage: ros2-peer ENDPOINT DOMAIN COMMAND [ARGUMENT...]".into());
    };
    match *command {
        "hashes" => return hashes(),
        "tokens" => return tokens(),
        _ => {}
    }
    let context = ZContextBuilder::default()
        .with_domain_id(domain.parse()?)
        .with_mode("client")
        .with_connect_endpoints([*endpoint])
        .disable_multicast_scouting()
        .keyexpr_format(hiroz_protocol::KeyExprFormat::RmwZenoh)
        .build()?;
    let node = context.create_node("peer").without_parameters().build()?;
    match (*command, rest) {
        ("graph", [namespace, name]) => graph(&context, namespace, name),
        ("echo", [kind, topic, count]) => {
            let count = count.parse()?;
            match *kind {
                "ArmState" => echo::<tangent_msgs::ArmState>(&node, topic, count),
                "ControlState" => echo::<tangent_msgs::ControlState>(&node, topic, count),
                "Health" => echo::<tangent_msgs::Health>(&node, topic, count),
                "NormalEstimate" => echo::<tangent_msgs::NormalEstimate>(&node, topic, count),
                "JointState" => echo::<sensor_msgs::JointState>(&node, topic, count),
                "WrenchStamped" => echo::<geometry_msgs::WrenchStamped>(&node, topic, count),
                "TFMessage" => echo::<tf2_msgs::TFMessage>(&node, topic, count),
                other => Err(format!("no echo for {other}").into()),
            }
        }
        ("pose", [topic, hz, seconds]) => poses(&node, topic, hz.parse()?, seconds.parse()?),
        ("wrench", [topic, hz, seconds]) => wrenches(&node, topic, hz.parse()?, seconds.parse()?),
        ("image", [topic, hz, seconds]) => images(&node, topic, hz.parse()?, seconds.parse()?),
        ("trigger", [service]) => trigger(&node, service),
        ("start", [service, task, clear]) => start(&node, service, task, *clear == "clear"),
        ("select", [service, estimator]) => select(&node, service, estimator),
        ("soak", [prefix, pose_topic, seconds]) => soak(
            &node,
            prefix,
            pose_topic,
            Duration::from_secs_f64(seconds.parse()?),
        ),
        _ => Err(format!("no command {command} with {} arguments", rest.len()).into()),
    }
}

fn say(value: &Value) {
    println!("{value}");
}

/// Type hashes as hiroz's generator computes them.
fn hashes() -> Result<()> {
    let mut all = BTreeMap::new();
    let mut message = |info: hiroz::entity::TypeInfo| {
        all.insert(info.name.clone(), info.hash.to_rihs_string());
    };
    macro_rules! messages {
        ($($path:path),* $(,)?) => { $(message(<$path as MessageTypeInfo>::type_info());)* };
    }
    messages!(
        tangent_msgs::Answer,
        tangent_msgs::ArmCommand,
        tangent_msgs::ArmState,
        tangent_msgs::ContactTruth,
        tangent_msgs::ControlState,
        tangent_msgs::CoverageState,
        tangent_msgs::Feature,
        tangent_msgs::FeatureArray,
        tangent_msgs::Health,
        tangent_msgs::NormalEstimate,
        tangent_msgs::ObjectEstimate,
        tangent_msgs::OperatorCommand,
        tangent_msgs::Request,
        tangent_msgs::ShapingState,
        tangent_msgs::SurfaceAhead,
        tangent_msgs::SurfaceSegment,
        tangent_msgs::WrenchBatch,
        tangent_msgs::WrenchStatus,
        geometry_msgs::PoseWithCovarianceStamped,
        geometry_msgs::WrenchStamped,
        sensor_msgs::CameraInfo,
        sensor_msgs::Image,
        sensor_msgs::JointState,
        tf2_msgs::TFMessage,
        hiroz_msgs::ros::visualization_msgs::MarkerArray,
    );
    for info in [
        std_srvs::srv::Trigger::service_type_info(),
        tangent_msgs::srv::StartTask::service_type_info(),
        tangent_msgs::srv::SelectEstimator::service_type_info(),
    ] {
        all.insert(info.name.clone(), info.hash.to_rihs_string());
    }
    say(&json!(all));
    Ok(())
}

/// Reads liveliness tokens from standard input, and writes what hiroz reads in each, and the token
/// and the topic's key that it would write for the same endpoint.
fn tokens() -> Result<()> {
    for line in std::io::stdin().lock().lines() {
        let key = zenoh::key_expr::KeyExpr::try_from(line?)?;
        match RmwZenohFormatter::parse_liveliness(&key)? {
            Entity::Node(node) => say(&json!({
                "kind": "NN",
                "domain": node.domain_id,
                "namespace": node.namespace,
                "node": node.name,
                "token": RmwZenohFormatter::node_liveliness_key_expr(&node)?.as_str(),
            })),
            Entity::Endpoint(endpoint) => {
                let node = endpoint.node.clone().ok_or("an endpoint without a node")?;
                let of = endpoint
                    .type_info
                    .clone()
                    .ok_or("an endpoint without a type")?;
                say(&json!({
                    "kind": endpoint.kind.to_string(),
                    "domain": node.domain_id,
                    "namespace": node.namespace,
                    "node": node.name,
                    "topic": endpoint.topic,
                    "type": of.name,
                    "hash": of.hash.to_rihs_string(),
                    "reliable": endpoint.qos.reliability == hiroz_protocol::qos::QosReliability::Reliable,
                    "volatile": endpoint.qos.durability == hiroz_protocol::qos::QosDurability::Volatile,
                    "depth": endpoint.qos.history.depth(),
                    "token": RmwZenohFormatter::liveliness_key_expr(&endpoint, &node.z_id)?.as_str(),
                    "key": RmwZenohFormatter::topic_key_expr(&endpoint)?.as_str(),
                }));
            }
        }
    }
    Ok(())
}

/// Waits for a node, then writes nodes, topics and services of the graph.
fn graph(context: &ZContext, namespace: &str, name: &str) -> Result<()> {
    let wanted = (name.to_owned(), namespace.to_owned());
    let begin = Instant::now();
    while !context.graph().get_node_names().contains(&wanted) {
        if begin.elapsed() > PATIENCE {
            return Err(format!("no node {namespace}/{name}").into());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    // The tokens of its endpoints follow that of the node.
    std::thread::sleep(Duration::from_secs(1));
    let graph = context.graph();
    let publishers: BTreeMap<String, usize> = graph
        .get_topic_names_and_types()
        .into_iter()
        .map(|(topic, _)| (topic.clone(), graph.count(EndpointKind::Publisher, topic)))
        .collect();
    say(&json!({
        "nodes": graph.get_node_names(),
        "topics": graph.get_topic_names_and_types(),
        "services": graph.get_service_names_and_types(),
        "publishers": publishers,
    }));
    Ok(())
}

/// Writes `count` messages of a topic as JSON.
fn echo<T>(node: &ZNode, topic: &str, count: usize) -> Result<()>
where
    T: ZMessage + hiroz::WithTypeInfo + serde::Serialize + 'static,
    T::Serdes: for<'a> ZDeserializer<Input<'a> = &'a [u8], Output = T>,
{
    let subscription = node.create_sub::<T>(topic).build()?;
    for _ in 0..count {
        let sample = subscription.recv_serialized_timeout(PATIENCE)?;
        let bytes = sample.payload().to_bytes();
        let message = <T::Serdes as ZDeserializer>::deserialize(&bytes)
            .map_err(|error| format!("{topic}: {error}"))?;
        let attachment = Attachment::try_from(sample.attachment().ok_or("no attachment")?)?;
        say(&json!({
            "message": serde_json::to_value(&message)?,
            "sequence": attachment.sequence_number,
            "source_time_ns": attachment.source_timestamp,
            "gid": attachment.source_gid,
        }));
    }
    Ok(())
}

fn now() -> builtin_interfaces::Time {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let now = now.unwrap_or_default();
    builtin_interfaces::Time {
        sec: now.as_secs() as i32,
        nanosec: now.subsec_nanos(),
    }
}

/// A pose that turns its place slowly, `i` periods of `hz` after the start.
fn pose(i: u64, hz: f64) -> geometry_msgs::PoseWithCovarianceStamped {
    let mut message = geometry_msgs::PoseWithCovarianceStamped::default();
    message.header.stamp = now();
    message.header.frame_id = "world".into();
    message.pose.pose.position.x = 0.005 * (i as f64 / hz).sin();
    message.pose.pose.position.y = 0.25;
    message.pose.pose.orientation.w = 1.0;
    message.pose.covariance[0] = 1e-8;
    message
}

/// Calls `send` at `hz` for `seconds`, and writes how often.
fn steadily(hz: f64, seconds: f64, mut send: impl FnMut(u64) -> Result<()>) -> Result<()> {
    let begin = Instant::now();
    let mut sent = 0;
    while begin.elapsed().as_secs_f64() < seconds {
        send(sent)?;
        sent += 1;
        let due = begin + Duration::from_secs_f64(sent as f64 / hz);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    say(&json!({ "sent": sent }));
    Ok(())
}

fn poses(node: &ZNode, topic: &str, hz: f64, seconds: f64) -> Result<()> {
    let publisher = node
        .create_pub::<geometry_msgs::PoseWithCovarianceStamped>(topic)
        .build()?;
    steadily(hz, seconds, |i| publisher.publish(&pose(i, hz)))
}

fn wrenches(node: &ZNode, topic: &str, hz: f64, seconds: f64) -> Result<()> {
    let publisher = node
        .create_pub::<geometry_msgs::WrenchStamped>(topic)
        .build()?;
    steadily(hz, seconds, |_| {
        let mut message = geometry_msgs::WrenchStamped::default();
        message.header.stamp = now();
        message.header.frame_id = "ft".into();
        message.wrench.force.z = -4.5;
        publisher.publish(&message)
    })
}

fn images(node: &ZNode, topic: &str, hz: f64, seconds: f64) -> Result<()> {
    let publisher = node.create_pub::<sensor_msgs::Image>(topic).build()?;
    steadily(hz, seconds, |i| {
        let mut message = sensor_msgs::Image::default();
        message.header.stamp = now();
        message.header.frame_id = "camera".into();
        message.height = 240;
        message.width = 320;
        message.step = 640;
        message.encoding = "16UC1".into();
        message.data = vec![i as u8; 240 * 640].into();
        publisher.publish(&message)
    })
}

/// Runs one call.
fn wait<T>(call: impl Future<Output = Result<T>>) -> Result<T> {
    tokio::runtime::Runtime::new()?.block_on(call)
}

fn trigger(node: &ZNode, service: &str) -> Result<()> {
    let client = node
        .create_client::<std_srvs::srv::Trigger>(service)
        .build()?;
    let request = std_srvs::TriggerRequest::default();
    let response = wait(client.call_with_timeout(&request, PATIENCE))?;
    say(&serde_json::to_value(&response)?);
    Ok(())
}

fn start(node: &ZNode, service: &str, task: &str, clear: bool) -> Result<()> {
    let client = node
        .create_client::<tangent_msgs::srv::StartTask>(service)
        .build()?;
    let request = tangent_msgs::StartTaskRequest {
        task: task.to_owned(),
        clear,
    };
    let response = wait(client.call_with_timeout(&request, PATIENCE))?;
    say(&serde_json::to_value(&response)?);
    Ok(())
}

fn select(node: &ZNode, service: &str, estimator: &str) -> Result<()> {
    let client = node
        .create_client::<tangent_msgs::srv::SelectEstimator>(service)
        .build()?;
    let request = tangent_msgs::SelectEstimatorRequest {
        estimator: estimator.to_owned(),
        force: false,
    };
    let response = wait(client.call_with_timeout(&request, PATIENCE))?;
    say(&serde_json::to_value(&response)?);
    Ok(())
}

/// Counts of one topic in a soak.
#[derive(Default)]
struct Counts {
    received: u64,
    missing: i64,
    backwards: u64,
    last: Option<(i64, [u8; 16])>,
    publishers: u64,
    silence_s: f64,
    at: Option<Instant>,
}

impl Counts {
    fn take(&mut self, attachment: &Attachment) {
        self.received += 1;
        match self.last {
            Some((last, gid)) if gid == attachment.source_gid => {
                let step = attachment.sequence_number - last;
                if step < 1 {
                    self.backwards += 1;
                } else {
                    self.missing += step - 1;
                }
            }
            _ => self.publishers += 1,
        }
        self.last = Some((attachment.sequence_number, attachment.source_gid));
        let now = Instant::now();
        if let Some(at) = self.at {
            self.silence_s = self.silence_s.max((now - at).as_secs_f64());
        }
        self.at = Some(now);
    }
}

/// Reads topics, publishes poses and calls a service at the same time, and writes the counts.
fn soak(node: &ZNode, prefix: &str, pose_topic: &str, lasts: Duration) -> Result<()> {
    let arm = node
        .create_sub::<tangent_msgs::ArmState>(&format!("/{prefix}/arm/state"))
        .build()?;
    let joints = node
        .create_sub::<sensor_msgs::JointState>(&format!("/{prefix}/joint_states"))
        .build()?;
    let wrench = node
        .create_sub::<geometry_msgs::WrenchStamped>(&format!("/{prefix}/wrench/tool"))
        .build()?;
    let publisher = node
        .create_pub::<geometry_msgs::PoseWithCovarianceStamped>(pose_topic)
        .build()?;
    let client = node
        .create_client::<std_srvs::srv::Trigger>(&format!("/{prefix}/status"))
        .build()?;
    let begin = Instant::now();
    let mut poses = 0_u64;
    let (mut longest_publish, mut longest_turn) = (Duration::ZERO, Duration::ZERO);
    let mut counts: [Counts; 3] = Default::default();
    let count = |sample: &zenoh::sample::Sample, counts: &mut Counts| -> Result<()> {
        let attachment = sample.attachment().ok_or("no attachment")?;
        counts.take(&Attachment::try_from(attachment)?);
        Ok(())
    };
    let (called, unanswered) = std::thread::scope(|scope| {
        let calls = scope.spawn(|| -> Result<(u64, Vec<String>)> {
            let (mut called, mut unanswered) = (0, Vec::new());
            let runtime = tokio::runtime::Runtime::new()?;
            while begin.elapsed() < lasts {
                called += 1;
                let request = std_srvs::TriggerRequest::default();
                let call = client.call_with_timeout(&request, Duration::from_secs(10));
                match runtime.block_on(call) {
                    Ok(response) if response.success => {}
                    Ok(response) => unanswered.push(response.message),
                    Err(error) => unanswered.push(error.to_string()),
                }
                std::thread::sleep(Duration::from_secs(1));
            }
            Ok((called, unanswered))
        });
        while begin.elapsed() < lasts {
            let turn = Instant::now();
            publisher.publish(&pose(poses, 50.0))?;
            longest_publish = longest_publish.max(turn.elapsed());
            poses += 1;
            let due = begin + Duration::from_secs_f64(poses as f64 / 50.0);
            while arm.is_ready() {
                count(&arm.recv_serialized()?, &mut counts[0])?;
            }
            while joints.is_ready() {
                count(&joints.recv_serialized()?, &mut counts[1])?;
            }
            while wrench.is_ready() {
                count(&wrench.recv_serialized()?, &mut counts[2])?;
            }
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            longest_turn = longest_turn.max(turn.elapsed());
        }
        calls.join().map_err(|_| "the calling thread panicked")?
    })?;
    let topics: BTreeMap<&str, Value> = ["arm/state", "joint_states", "wrench/tool"]
        .into_iter()
        .zip(&counts)
        .map(|(topic, counts)| {
            let counts = json!({
                "received": counts.received,
                "missing": counts.missing,
                "backwards": counts.backwards,
                "publishers": counts.publishers,
                "longest_silence_s": counts.silence_s,
            });
            (topic, counts)
        })
        .collect();
    say(&json!({
        "seconds": begin.elapsed().as_secs_f64(),
        "topics": topics,
        "poses": poses,
        "called": called,
        "unanswered": unanswered,
        "longest_publish_s": longest_publish.as_secs_f64(),
        "longest_turn_s": longest_turn.as_secs_f64(),
    }));
    Ok(())
}
