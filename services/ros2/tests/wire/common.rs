//! A cell with a ROS 2 service, and a Zenoh session that shares no code with it.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_ros2::{Config, Ros2Error, type_hash};
use tangent_runtime::{Bus, CellConfig, Role, Stop, Subscription};
use tangent_schemas::tangent::Health;
use tangent_schemas::topics;
use zenoh::Wait;

/// Timeout far above the duration of any step here, so that only a real failure reaches it.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// The joints of the arm in these tests.
pub const JOINTS: [&str; 2] = ["shoulder", "elbow"];

/// A router, the service as its client, and a session on the same router.
pub struct Cell {
    /// The cell, in the router's process.
    pub bus: Bus,
    /// What a program of ROS 2 would have.
    pub ros: zenoh::Session,
    /// Name of the cell, and prefix in ROS 2.
    pub name: String,
    /// Health of the service.
    pub health: Subscription<Health>,
    stop: Stop,
    service: Option<JoinHandle<Result<(), Ros2Error>>>,
}

impl Cell {
    /// Starts everything; `section` is the text of `[ros2]`, and `more` follows it.
    pub fn start(section: &str, more: &str) -> Self {
        let port = tangent_live::ports::free();
        let name = format!("test{port}");
        let text = format!(
            "[cell]\nname = \"{name}\"\n[robot]\nmodel = \"ur5\"\naddress = \"127.0.0.1\"\n[tool]\nmass_kg = 0.3\n\
             com_in_sensor_m = [0.0, 0.0, 0.05]\nflange_from_tool = {{ translation_m = [0.0, 0.0, 0.15] }}\n\
             [zenoh]\nconnect = [\"tcp/127.0.0.1:{port}\"]\nlisten = [\"tcp/127.0.0.1:{port}\"]\n\
             [realtime]\nenabled = false\n[ros2]\n{section}\n{more}"
        );
        let sensor = "[sensor]\naddress = \"127.0.0.1\"\n";
        let text = if text.contains("[sensor]") {
            text
        } else {
            text + sensor
        };
        let config = CellConfig::parse("cell.toml", &text).unwrap();
        let bus = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let health = bus.subscribe(&topics::health("ros2"), 64).unwrap();
        let own = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let settings = Config::from_cell(&config, &JOINTS.map(str::to_owned)).unwrap();
        let (services, inputs) = (settings.commands.len(), settings.inputs.len());
        let stop = Stop::new();
        let stopping = stop.clone();
        let service = std::thread::spawn(move || tangent_ros2::run(settings, own, stopping));
        let mut foreign = zenoh::Config::default();
        for (key, value) in [
            ("mode", "\"client\"".to_owned()),
            ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
            ("scouting/multicast/enabled", "false".to_owned()),
        ] {
            foreign.insert_json5(key, &value).unwrap();
        }
        let cell = Self {
            bus,
            ros: zenoh::open(foreign).wait().unwrap(),
            name,
            health,
            stop,
            service: Some(service),
        };
        cell.until_health("running", |health| health.state == 1);
        // Health comes in another session than the node, and may be there before it.
        until("the services and inputs in the graph", || {
            let tokens = cell.tokens();
            let count = |kind| tokens.iter().filter(|token| token.contains(kind)).count();
            count("/SS/") == services && count("/MS/") == inputs
        });
        cell
    }

    /// Waits for a health message of the service with this property.
    pub fn until_health(&self, what: &str, holds: impl Fn(&Health) -> bool) -> Health {
        let begin = Instant::now();
        loop {
            let left = PATIENCE.saturating_sub(begin.elapsed());
            let Some(health) = self.health.recv_timeout(left) else {
                panic!("never came: {what}");
            };
            if holds(&health.message) {
                return health.message;
            }
        }
    }

    /// Key of a message's topic in ROS 2.
    pub fn key(topic: &str, type_name: &str) -> String {
        let hash = type_hash::of_message(type_name).unwrap();
        format!("0/{topic}/{}/{hash}", on_the_wire(type_name))
    }

    /// Key of a service in ROS 2.
    pub fn service_key(&self, service: &str, type_name: &str) -> String {
        let hash = type_hash::of_service(type_name).unwrap();
        format!(
            "0/{}/{service}/{}/{hash}",
            self.name,
            on_the_wire(type_name)
        )
    }

    /// Liveliness tokens of ROS 2, now.
    pub fn tokens(&self) -> Vec<String> {
        let replies = self.ros.liveliness().get("@ros2_lv/**").wait().unwrap();
        let mut tokens: Vec<String> = replies
            .iter()
            .filter_map(|reply| Some(reply.into_result().ok()?.key_expr().to_string()))
            .collect();
        tokens.sort();
        tokens
    }

    /// Stops the service, and returns how it ended.
    pub fn end_service(&mut self) -> Result<(), Ros2Error> {
        self.stop.trigger();
        self.service.take().unwrap().join().unwrap()
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        self.stop.trigger();
        if let Some(service) = self.service.take() {
            let _ = service.join();
        }
    }
}

/// `a/msg/B` as `a::msg::dds_::B_`.
fn on_the_wire(type_name: &str) -> String {
    let parts: Vec<&str> = type_name.split('/').collect();
    format!("{}::{}::dds_::{}_", parts[0], parts[1], parts[2])
}

/// An attachment of rmw_zenoh, written down byte by byte.
pub fn attachment(sequence: i64, source_time_ns: i64, gid: [u8; 16]) -> Vec<u8> {
    let mut bytes = sequence.to_le_bytes().to_vec();
    bytes.extend(source_time_ns.to_le_bytes());
    bytes.push(16);
    bytes.extend(gid);
    bytes
}

/// Waits until it holds, looking again each millisecond.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < PATIENCE, "never came: {what}");
        std::thread::park_timeout(Duration::from_millis(1));
    }
}
