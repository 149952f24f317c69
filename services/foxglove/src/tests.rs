//! A client of the Foxglove WebSocket protocol against the service, on a bus in this process.

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::sync::mpsc;

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tangent_schemas::standard::{Header, JointState, StdString};
use tangent_schemas::{Message as _, cdr, topics};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::*;

const PATIENCE: Duration = Duration::from_secs(30);

/// Everything is forwarded, on loopback; port 0 is any free one.
fn at_port(port: u16) -> Config {
    Config {
        name: "cell".to_owned(),
        address: (Ipv4Addr::LOCALHOST, port).into(),
        include: vec!["**".to_owned()],
        exclude: Vec::new(),
        queue: 8192,
        viewer_queue: 1024,
    }
}

/// A running service and the bus that it reads.
struct Served {
    bus: Bus,
    port: u16,
    stop: Stop,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Served {
    fn start(change: impl FnOnce(&mut Config)) -> Self {
        let mut config = at_port(0);
        change(&mut config);
        let (bus, stop) = (Bus::in_process("cell1"), Stop::new());
        let (tell, told) = mpsc::channel();
        let (own, ended) = (bus.clone(), stop.clone());
        let thread = std::thread::spawn(move || {
            run(&config, &own, &ended, |port| tell.send(port).unwrap()).unwrap();
        });
        Self {
            bus,
            port: told.recv_timeout(PATIENCE).unwrap(),
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.trigger();
        let ended = self.thread.take().map(std::thread::JoinHandle::join);
        if !std::thread::panicking() {
            ended.unwrap().unwrap();
        }
    }
}

/// A viewer, by the protocol's documentation (foxglove/ws-protocol).
struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>,
    /// Advertised channels by topic.
    channels: BTreeMap<String, Value>,
}

impl Viewer {
    async fn connect(port: u16) -> Self {
        let mut request = format!("ws://127.0.0.1:{port}/")
            .into_client_request()
            .unwrap();
        let protocol = "foxglove.sdk.v1".parse().unwrap();
        request
            .headers_mut()
            .insert("Sec-WebSocket-Protocol", protocol);
        let (socket, _) = connect_async(request).await.unwrap();
        Self {
            socket,
            channels: BTreeMap::new(),
        }
    }

    async fn next(&mut self) -> Result<Message, tungstenite::Error> {
        let next = tokio::time::timeout(PATIENCE, self.socket.next()).await;
        let message = next.expect("a message").expect("an open connection")?;
        if let Message::Text(text) = &message {
            let value: Value = serde_json::from_str(text).unwrap();
            if value["op"] == "advertise" {
                for channel in value["channels"].as_array().unwrap() {
                    let topic = channel["topic"].as_str().unwrap().to_owned();
                    self.channels.insert(topic, channel.clone());
                }
            }
        }
        Ok(message)
    }

    /// Reads until the topic is advertised.
    async fn advertised(&mut self, topic: &str) -> Value {
        while !self.channels.contains_key(topic) {
            self.next().await.unwrap();
        }
        self.channels[topic].clone()
    }

    async fn subscribe(&mut self, topic: &str, id: u32) {
        let channel = self.advertised(topic).await;
        let wanted = json!({
            "op": "subscribe",
            "subscriptions": [{"id": id, "channelId": channel["id"]}],
        });
        let text = Message::Text(wanted.to_string().into());
        self.socket.send(text).await.unwrap();
    }

    /// The next message of a subscription: time and payload.
    async fn data(&mut self, id: u32) -> (u64, Vec<u8>) {
        loop {
            let Message::Binary(bytes) = self.next().await.unwrap() else {
                continue;
            };
            if bytes[0] == 1 && bytes[1..5] == id.to_le_bytes() {
                let time = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                return (time, bytes[13..].to_vec());
            }
        }
    }
}

fn in_viewer<T>(body: impl Future<Output = T>) -> T {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().build().unwrap().block_on(body)
}

fn joint_state(angle: f64) -> JointState {
    JointState {
        header: Header::new(1_795_260_245_000_000_000, "base"),
        name: vec!["joint".to_owned()],
        position: vec![angle],
        ..JointState::default()
    }
}

#[test]
fn a_viewer_sees_the_topics_with_their_schemas_and_the_bytes_of_the_bus() {
    let served = Served::start(|_| {});
    let joints = served.bus.publisher(&topics::JOINT_STATES).unwrap();
    let odd = served
        .bus
        .raw_publisher("camera/odd", "odd_msgs/msg/Odd")
        .unwrap();
    joints.publish(&joint_state(0.0));
    odd.publish(&[0, 1, 0, 0, 9]);
    in_viewer(async {
        let mut viewer = Viewer::connect(served.port).await;
        let channel = viewer.advertised("/joint_states").await;
        assert_eq!(channel["encoding"], "cdr");
        assert_eq!(channel["schemaName"], JointState::NAME);
        assert_eq!(channel["schemaEncoding"], "ros2msg");
        assert_eq!(channel["schema"], JointState::definition());
        // A type that nobody here knows is there all the same.
        assert_eq!(viewer.advertised("/camera/odd").await["schema"], "");
        viewer.subscribe("/joint_states", 5).await;
        // The subscription is on its way: published until it has arrived.
        let (stop, publisher) = (Stop::new(), served.bus.clone());
        let until = stop.clone();
        let publishing = std::thread::spawn(move || {
            let joints = publisher.publisher(&topics::JOINT_STATES).unwrap();
            let mut angle = 1.0;
            while !until.wait(Duration::from_millis(5)) {
                joints.publish(&joint_state(angle));
                angle += 1.0;
            }
        });
        let mut last = 0.0;
        for _ in 0..20 {
            let (time, bytes) = viewer.data(5).await;
            assert!(time > 1_600_000_000_000_000_000, "{time}");
            let state: JointState = cdr::decode(&bytes).unwrap();
            assert_eq!(state.name, ["joint"]);
            assert!(state.position[0] > last, "in order");
            last = state.position[0];
        }
        stop.trigger();
        publishing.join().unwrap();
    });
}

#[test]
fn a_viewer_that_comes_late_gets_the_description_at_once() {
    let served = Served::start(|_| {});
    let description = served.bus.publisher(&topics::ROBOT_DESCRIPTION).unwrap();
    for text in ["<robot name=\"old\"/>", "<robot name=\"new\"/>"] {
        description.publish(&StdString {
            data: text.to_owned(),
        });
    }
    in_viewer(async {
        for late in [false, true] {
            let mut viewer = Viewer::connect(served.port).await;
            viewer.subscribe("/robot_description", 1).await;
            // The first viewer may come before the service has read both. Nothing is published
            // after that.
            loop {
                let (_, bytes) = viewer.data(1).await;
                let text: StdString = cdr::decode(&bytes).unwrap();
                if late || text.data != "<robot name=\"old\"/>" {
                    assert_eq!(text.data, "<robot name=\"new\"/>");
                    break;
                }
            }
        }
    });
}

#[test]
fn only_what_the_cell_file_says_is_shown() {
    let served = Served::start(|config| {
        config.include = vec!["joint_states".to_owned(), "camera/**".to_owned()];
        config.exclude = vec!["camera/depth".to_owned()];
    });
    let odd = |key| served.bus.raw_publisher(key, "odd_msgs/msg/Odd").unwrap();
    for key in ["camera/depth", "truth/contact", "camera/image"] {
        odd(key).publish(&[0, 1, 0, 0]);
    }
    let joints = served.bus.publisher(&topics::JOINT_STATES).unwrap();
    joints.publish(&joint_state(0.0));
    in_viewer(async {
        let mut viewer = Viewer::connect(served.port).await;
        viewer.advertised("/joint_states").await;
        viewer.advertised("/camera/image").await;
        let topics: Vec<&String> = viewer.channels.keys().collect();
        assert_eq!(topics, ["/camera/image", "/joint_states"]);
    });
}

/// A viewer that reads nothing costs its own messages only: the publisher does not wait, and
/// another viewer receives everything.
#[test]
fn a_viewer_that_sleeps_holds_nobody_up() {
    let served = Served::start(|config| config.viewer_queue = 64);
    let image = served
        .bus
        .raw_publisher("camera/image", "odd_msgs/msg/Odd")
        .unwrap();
    let joints = served.bus.publisher(&topics::JOINT_STATES).unwrap();
    let large = vec![0; 1 << 20];
    image.publish(&large);
    joints.publish(&joint_state(0.0));
    in_viewer(async {
        let mut sleeper = Viewer::connect(served.port).await;
        sleeper.subscribe("/camera/image", 1).await;
        let mut awake = Viewer::connect(served.port).await;
        awake.subscribe("/joint_states", 2).await;
        let mut received = 0;
        // 300 MB do not fit into the sleeper's socket.
        for i in 0..300 {
            image.publish(&large);
            joints.publish(&joint_state(f64::from(i)));
            // The first may be published before the subscription has arrived.
            if i >= 50 && received < 200 {
                awake.data(2).await;
                received += 1;
            }
        }
        assert_eq!(received, 200);
    });
}

#[test]
fn an_address_in_use_is_named() {
    let served = Served::start(|_| {});
    let config = at_port(served.port);
    let bus = Bus::in_process("other");
    let error = run(&config, &bus, &Stop::new(), |_| {})
        .unwrap_err()
        .to_string();
    assert!(error.contains(&served.port.to_string()), "{error}");
    assert!(error.contains("another port"), "{error}");
}
