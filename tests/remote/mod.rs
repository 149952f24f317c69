//! Another host, and the network link to it.

mod relay;

use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use relay::Relay;

/// Disturbance of the link, in each direction.
#[derive(Clone, Copy, Debug)]
pub struct Wire {
    /// Delay in one direction, ms.
    pub delay_ms: f64,
    /// Largest deviation from the delay, ms.
    pub jitter_ms: f64,
    /// Share of packets that are lost.
    pub loss: f64,
    /// Share of packets that are reordered.
    pub reorder: f64,
}

/// Another host: a network namespace if possible, otherwise this host.
pub struct Host {
    namespace: Option<Namespace>,
    relay: Option<Relay>,
}

struct Namespace {
    name: String,
    /// Our end of the pair of devices, and the addresses of both ends.
    device: String,
    ours: String,
    netem: bool,
}

/// A process on the other host; it ends with the test.
pub struct Remote(Child);

impl Drop for Remote {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn sh(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    Command::new(words[0])
        .args(&words[1..])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

impl Namespace {
    /// `None` without the privileges or the tools.
    fn new() -> Option<Self> {
        // Each test of this process has one, and other processes have theirs.
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let id = (std::process::id() * 16 + number % 16) % 60_000;
        let name = format!("tangent{id}");
        let (device, peer) = (format!("tga{id}"), format!("tgb{id}"));
        let net = format!("10.213.{}", id % 250);
        let ours = format!("{net}.1");
        if !sh(&format!("ip netns add {name}")) {
            return None;
        }
        let mut made = Self {
            name,
            device,
            ours,
            netem: false,
        };
        let (name, device) = (&made.name, &made.device);
        let up = sh(&format!("ip link add {device} type veth peer name {peer}"))
            && sh(&format!("ip link set {peer} netns {name}"))
            && sh(&format!("ip addr add {net}.1/24 dev {device}"))
            && sh(&format!("ip link set {device} up"))
            && sh(&format!(
                "ip netns exec {name} ip addr add {net}.2/24 dev {peer}"
            ))
            && sh(&format!("ip netns exec {name} ip link set {peer} up"))
            && sh(&format!("ip netns exec {name} ip link set lo up"));
        made.netem = up
            && sh(&format!(
                "tc qdisc replace dev {device} root netem delay 0ms"
            ));
        up.then_some(made)
    }

    fn impair(&self, wire: &Wire) {
        let peer = self.device.replace("tga", "tgb");
        let rule = format!(
            "root netem limit 10000 delay {}ms {}ms loss {}% reorder {}%",
            wire.delay_ms.max(0.01),
            wire.jitter_ms,
            100.0 * wire.loss,
            100.0 * wire.reorder,
        );
        assert!(
            sh(&format!("tc qdisc replace dev {} {rule}", self.device)),
            "{rule}"
        );
        assert!(
            sh(&format!(
                "ip netns exec {} tc qdisc replace dev {peer} {rule}",
                self.name
            )),
            "{rule}"
        );
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        sh(&format!("ip netns del {}", self.name));
        sh(&format!("ip link del {}", self.device));
    }
}

impl Host {
    /// Tries for a namespace.
    pub fn new() -> Self {
        Self {
            namespace: Namespace::new(),
            relay: None,
        }
    }

    /// Description for the output.
    pub fn describe(&self) -> &'static str {
        match &self.namespace {
            Some(namespace) if namespace.netem => "a network namespace, its link impaired by netem",
            Some(_) => {
                "a network namespace behind a relay (skipped netem, because this kernel has none)"
            }
            None => {
                "a process behind a relay (skipped namespaces, because `ip netns add` is not allowed or not there)"
            }
        }
    }

    /// Disturbs the link to the router on `port` from now on.
    pub fn impair(&mut self, wire: &Wire, port: u16) {
        match &self.namespace {
            Some(namespace) if namespace.netem => namespace.impair(wire),
            _ => self.relay = Some(Relay::to(port, *wire)),
        }
    }

    /// The router's endpoint as seen from the other host.
    pub fn router(&self, port: u16) -> String {
        let address = self
            .namespace
            .as_ref()
            .map_or("127.0.0.1", |n| n.ours.as_str());
        let port = self.relay.as_ref().map_or(port, Relay::port);
        format!("tcp/{address}:{port}")
    }

    /// Starts the program on the other host.
    pub fn run(&self, args: &[&str]) -> Remote {
        let program = env!("CARGO_BIN_EXE_tangent");
        let mut command = match &self.namespace {
            Some(namespace) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", &namespace.name, program]);
                command
            }
            None => Command::new(program),
        };
        let child = command
            .args(args)
            .env_remove("TANGENT_CELL")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn();
        Remote(child.unwrap())
    }
}
