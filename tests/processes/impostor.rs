//! An unauthorized publisher on an unencrypted cell network that sends messages of the sensor.

use std::time::{Duration, Instant};

use tangent_runtime::clock::now_ns;
use tangent_runtime::{Bus, CellConfig, HealthReporter, RawPublisher, RawSubscription, Role, Stop};
use tangent_schemas::standard::{Header, Image, WrenchStamped};
use tangent_schemas::tangent::WrenchStatus;
use tangent_schemas::topics::{self, Delivery, Topic};
use tangent_schemas::{Message, cdr};

use crate::cell::{Cell, PATIENCE};
use crate::common::{json, stderr, wait_for};
use crate::failures::{APART, FORCE_MAX_N, sliding};
use tangent_live::live_beside_others;

/// Period of the false messages: 1.9 kHz.
const PERIOD: Duration = Duration::from_micros(526);
/// Number of false messages, which takes a few seconds beside the true ones.
const MANY: u64 = 2000;

/// Publishes zero wrenches, under an id of its own or under the sensor's.
struct Impostor {
    bus: Bus,
    /// Declares it as a service while it publishes.
    health: HealthReporter,
    status: RawPublisher,
    wrench: RawPublisher,
    heard: Option<[RawSubscription; 2]>,
}

impl Impostor {
    fn join(cell: &Cell, copies_ids: bool) -> Self {
        let config = CellConfig::load(&cell.file()).unwrap();
        let bus = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let keys = [topics::WRENCH_STATUS.key(), topics::WRENCH_TOOL.key()];
        let health = HealthReporter::start(&bus, "visitor").unwrap();
        health.running();
        Self {
            status: bus.raw_publisher(keys[0], WrenchStatus::NAME).unwrap(),
            wrench: bus.raw_publisher(keys[1], WrenchStamped::NAME).unwrap(),
            heard: copies_ids.then(|| keys.map(|key| bus.subscribe_raw(key, 64).unwrap())),
            health,
            bus,
        }
    }

    /// Publishes in a thread of its own until `stop`; returns the number of messages.
    fn speak(self, stop: Stop) -> std::thread::JoinHandle<u64> {
        std::thread::spawn(move || {
            // Ends with this thread.
            let _named = &self.health;
            let mut newest = [None; 2];
            let mut said = 0;
            let mut due = Instant::now();
            while !stop.is_stopped() {
                if let Some(heard) = &self.heard {
                    for (newest, heard) in newest.iter_mut().zip(heard) {
                        while let Some(message) = heard.try_recv() {
                            *newest = Some((message.publisher, message.sequence));
                        }
                    }
                }
                let header = Header::new(now_ns(), "tool");
                let status = WrenchStatus {
                    header: header.clone(),
                    ..WrenchStatus::default()
                };
                let wrench = WrenchStamped {
                    header,
                    ..WrenchStamped::default()
                };
                say(&self.status, &status, newest[0].as_mut());
                say(&self.wrench, &wrench, newest[1].as_mut());
                said += 1;
                due += PERIOD;
                std::thread::park_timeout(due.saturating_duration_since(Instant::now()));
            }
            self.bus.close();
            said
        })
    }
}

/// Publishes a message as itself, or as the next message of another publisher.
fn say<M: Message>(publisher: &RawPublisher, message: &M, other: Option<&mut ([u8; 16], u64)>) {
    let mut bytes = Vec::new();
    cdr::encode(message, &mut bytes).unwrap();
    match other {
        Some((id, sequence)) => {
            *sequence += 1;
            publisher.publish_as(&bytes, *id, *sequence);
        }
        None => publisher.publish(&bytes),
    }
}

/// The fault in a service's health, and the number of samples of `wrench/tool` that it refused.
fn told(cell: &Cell, service: &str) -> Option<(String, f64)> {
    let status = json(&cell.cli(&["status", "--json"]));
    let services = status["services"].as_array().unwrap();
    let health = services.iter().find(|s| s["name"] == service)?;
    let fault = health["fault"].as_str().unwrap_or_default().to_owned();
    let refused = health["figures"]["wrench/tool_refused"]
        .as_f64()
        .unwrap_or(0.0);
    Some((fault, refused))
}

/// Zeros at 1.9 kHz beside the true wrench, while the tool slides: no service uses them, and every
/// reader reports their publisher. A task is not started beside them.
#[test]
fn an_impostors_wrench_is_refused_by_name() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&APART);
        let from = now_ns();
        let stop = Stop::new();
        let impostor = Impostor::join(&cell, false).speak(stop.clone());
        for service in ["controller", "estimator"] {
            wait_for(&format!("{service} names the impostor"), PATIENCE, || {
                let (fault, refused) = told(&cell, service)?;
                eprintln!("{service}: {refused} refused; {fault}");
                (fault.contains("wrench/tool: a second publisher, visitor/")
                    && refused > MANY as f64)
                    .then_some(())
            });
        }
        // The true force was regulated throughout.
        for control in observer.controls(from) {
            assert_eq!(control.message.fault.as_str(), "");
            // A machine that stalls for some cycles makes the arm hold for that time.
            let phase = control.message.phase_text;
            assert!(matches!(phase.as_str(), "slide" | "hold"), "{phase}");
        }
        observer.pressed_at_most(FORCE_MAX_N, from);
        let touching = observer.truths(from).iter().all(|t| t.message.in_contact);
        assert!(touching, "the tool left the surface");

        assert!(cell.cli(&["task", "stop"]).status.success());
        observer.phase("done", from);
        let task = cell.long_task();
        let refused = cell.cli(&["task", "start", task.to_str().unwrap()]);
        assert_eq!(refused.status.code(), Some(1));
        let said = String::from_utf8_lossy(&refused.stdout).into_owned() + &stderr(&refused);
        assert!(said.contains("a second publisher, visitor/"), "{said}");

        stop.trigger();
        assert!(impostor.join().unwrap() > MANY);
        wait_for("the controller is well again", PATIENCE, || {
            let (fault, _) = told(&cell, "controller")?;
            fault.is_empty().then_some(())
        });
        cell.assert_running(&APART);
    });
}

/// A publisher that copies the ids it receives cannot be distinguished from the sensor: neither is
/// trusted, and the arm leaves the surface.
#[test]
fn a_copied_id_stops_the_task_and_steers_nothing() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&APART);
        let from = now_ns();
        let stop = Stop::new();
        let impostor = Impostor::join(&cell, true).speak(stop.clone());
        let faulted = observer.phase("fault", from);
        assert!(
            faulted.message.fault.contains("wrench"),
            "{}",
            faulted.message.fault
        );
        wait_for("the controller says why", PATIENCE, || {
            let (fault, _) = told(&cell, "controller")?;
            fault
                .contains("two publishers use the id of netft/")
                .then_some(())
        });
        observer.pressed_at_most(FORCE_MAX_N, from);
        stop.trigger();
        impostor.join().unwrap();
        cell.assert_running(&APART);
    });
}

/// Large messages sent.
const MESSAGES: usize = 20;
/// A router with a bound of 8 MB grew by 23 MB here, one without by 62 MB.
const GROWTH_MAX_MB: f64 = 45.0;

/// The most memory that a process has had in RAM so far, MB.
fn most_memory_mb(id: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kib: f64 = line
        .and_then(|line| line.split_whitespace().nth(1)?.parse().ok())
        .unwrap();
    kib * 1024.0 * 1e-6
}

/// A client without a size limit sends messages of 100 MB to another one that subscribes to them.
#[test]
fn large_messages_do_not_fill_the_router() {
    live_beside_others(|| {
        const LARGE: Topic<Image> = Topic::new("camera/large", Delivery::Bulk);
        let mut cell = Cell::new(|_| {});
        cell.start("router");
        let mut config = CellConfig::load(&cell.file()).unwrap();
        assert_eq!(config.zenoh.message_max_mb, 8.0);
        config.zenoh.message_max_mb = 1000.0;
        let join = || Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let (reader, sender) = (join(), join());
        let heard = reader.subscribe(&LARGE, 1).unwrap();
        let publisher = sender.publisher(&LARGE).unwrap();
        let image = |bytes: usize| Image {
            data: vec![7; bytes],
            ..Image::default()
        };
        let small_passes = || {
            let small = image(1000);
            wait_for("a small one passes", PATIENCE, || {
                publisher.publish(&small);
                let received = heard.try_recv()?;
                assert_eq!(received.message.data.len(), small.data.len());
                Some(())
            });
        };
        small_passes();
        let router = cell.process("router").id();
        let before = most_memory_mb(router);
        let large = image(100_000_000);
        for _ in 0..MESSAGES {
            publisher.publish(&large);
            small_passes();
        }
        let grown = most_memory_mb(router) - before;
        println!("the router grew by {grown:.0} MB");
        assert!(grown < GROWTH_MAX_MB, "{grown} MB");
        cell.assert_running(&["router"]);
    });
}
