//! The service on a wrench that another program publishes, on a bus without a network.

#![allow(clippy::unwrap_used)]

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_netft::{Config, NetftError};
use tangent_runtime::{Bus, CellConfig, Latest, Publisher, Stop};
use tangent_schemas::standard::{Header, Vector3, Wrench, WrenchStamped};
use tangent_schemas::tangent::{Health, Request, WrenchStatus};
use tangent_schemas::topics::{self, Delivery, Topic, queries};

const PATIENCE: Duration = Duration::from_secs(20);
const PERIOD: Duration = Duration::from_millis(2);
const KEY: &str = "my_sensor/wrench";

struct Rig {
    bus: Bus,
    stop: Stop,
    service: Option<JoinHandle<Result<(), NetftError>>>,
    publisher: Publisher<WrenchStamped>,
    wrench: Latest<WrenchStamped>,
    raw: Latest<WrenchStamped>,
    status: Latest<WrenchStatus>,
    health: Latest<Health>,
    count: u32,
}

impl Rig {
    fn start(inverted: bool) -> Self {
        let cell = CellConfig::default_cell()
            .changed("the test's cell", |table| {
                let text = format!(
                    "driver = \"topic\"\nrate_hz = 500.0\nforce_range_n = [60.0, 60.0, 60.0]\n\
                     torque_range_nm = [6.0, 6.0, 6.0]\n\
                     topic = {{ key = \"{KEY}\", frame = \"ft\", inverted = {inverted} }}"
                );
                let sensor: toml::Table = text.parse().unwrap();
                table.insert("sensor".to_owned(), sensor.into());
                let tool = table["tool"].as_table_mut().unwrap();
                tool.insert("mass_kg".to_owned(), 0.0.into());
            })
            .unwrap();
        let mut config = Config::from_cell(&cell);
        config.realtime_priority = None;
        config.state = None;
        let bus = Bus::in_process("test");
        let stop = Stop::new();
        let (own, until) = (bus.clone(), stop.clone());
        let mut rig = Self {
            publisher: publisher(&bus),
            wrench: bus.latest(&topics::WRENCH_TOOL).unwrap(),
            raw: bus.latest(&topics::WRENCH_RAW).unwrap(),
            status: bus.latest(&topics::WRENCH_STATUS).unwrap(),
            health: bus.latest(&topics::health("netft")).unwrap(),
            bus,
            stop,
            service: Some(std::thread::spawn(move || {
                tangent_netft::run(config, own, until)
            })),
            count: 0,
        };
        rig.until("a wrench", -5.0, |rig| rig.wrench.get().is_some());
        rig
    }

    /// A sample with this force along z, with a little noise, as every sensor has.
    fn sample(&mut self, force_z: f64) -> WrenchStamped {
        self.count += 1;
        let noise = |i: u32| f64::from((self.count * 7919 + i * 104_729) % 1009) * 2e-5;
        WrenchStamped {
            header: Header::new(tangent_runtime::clock::now_ns(), "ft"),
            wrench: Wrench {
                force: Vector3 {
                    x: noise(0),
                    y: noise(1),
                    z: force_z + noise(2),
                },
                torque: Vector3 {
                    x: 0.1 * noise(3),
                    y: 0.1 * noise(4),
                    z: 0.1 * noise(5),
                },
            },
        }
    }

    /// Publishes samples of this force until the condition holds.
    fn until(&mut self, what: &str, force_z: f64, mut holds: impl FnMut(&mut Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        let pause = Stop::new();
        while Instant::now() < end {
            let sample = self.sample(force_z);
            self.publisher.publish(&sample);
            self.refresh();
            if holds(self) {
                return;
            }
            pause.wait(PERIOD);
        }
        panic!(
            "{what} never came: {:?} {:?}",
            self.status.get(),
            self.health.get()
        );
    }

    /// Waits without a sample until the condition holds.
    fn silent_until(&mut self, what: &str, mut holds: impl FnMut(&mut Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        let pause = Stop::new();
        while Instant::now() < end {
            self.refresh();
            if holds(self) {
                return;
            }
            pause.wait(PERIOD);
        }
        panic!(
            "{what} never came: {:?} {:?}",
            self.status.get(),
            self.health.get()
        );
    }

    fn refresh(&mut self) {
        self.wrench.refresh();
        self.raw.refresh();
        self.status.refresh();
        self.health.refresh();
    }

    fn force_z(&mut self) -> f64 {
        self.wrench.get().unwrap().message.wrench.force.z
    }

    fn validity(&mut self) -> u8 {
        self.status
            .get()
            .map_or(1, |status| status.message.validity)
    }

    fn reason(&mut self) -> String {
        let health = self.health.get();
        health.map_or_else(String::new, |health| format!("{:?}", health.message))
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.stop.trigger();
        let ended = self.service.take().unwrap().join();
        assert!(std::thread::panicking() || ended.unwrap().is_ok());
    }
}

fn publisher(bus: &Bus) -> Publisher<WrenchStamped> {
    let topic: Topic<WrenchStamped> = Topic::named(KEY.to_owned(), Delivery::RealTime);
    bus.publisher(&topic).unwrap()
}

#[test]
fn it_is_conditioned_tared_and_reported_silent() {
    let mut rig = Rig::start(false);
    rig.until("the filtered force", -5.0, |rig| {
        (rig.force_z() + 5.0).abs() < 0.05
    });
    assert_eq!(rig.validity(), 0);
    assert!((rig.raw.get().unwrap().message.wrench.force.z + 5.0).abs() < 0.05);
    let stamp = |message: &WrenchStamped| message.header.stamp.to_ns();
    let (wrench, status) = (rig.wrench.get().cloned(), rig.status.get().cloned());
    let about = status.unwrap().message.header.stamp.to_ns();
    assert_eq!(stamp(&wrench.unwrap().message), about);

    // The tare is answered while samples arrive, and sets the zero.
    let bus = rig.bus.clone();
    let asked = std::thread::spawn(move || {
        let request = Request {
            action: "tare".into(),
            argument: "clear".into(),
        };
        bus.ask(queries::NETFT_TARE, &request, PATIENCE).unwrap()
    });
    rig.until("the answer to the tare", -5.0, |_| asked.is_finished());
    let answer = asked.join().unwrap();
    assert!(answer.done, "{}", answer.message);
    rig.until("the zero", -5.0, |rig| rig.force_z().abs() < 0.05);
    assert!(rig.status.get().unwrap().message.bias_age_s >= 0.0);

    // Silence is reported, and ends by itself.
    rig.silent_until("stale", |rig| rig.validity() == 2);
    rig.silent_until("the fault", |rig| {
        rig.reason().contains("no wrench on my_sensor/wrench")
    });
    rig.until("the wrench again", -5.0, |rig| {
        rig.validity() == 0 && rig.force_z().abs() < 0.05
    });
    assert_eq!(rig.status.get().unwrap().message.reconnects, 1);
    rig.until("a load beyond the range", -70.0, |rig| rig.validity() == 3);
}

#[test]
fn the_sign_can_be_reversed() {
    let mut rig = Rig::start(true);
    rig.until("the filtered force", 5.0, |rig| {
        (rig.force_z() + 5.0).abs() < 0.05
    });
}

#[test]
fn another_frame_and_a_second_publisher_are_refused() {
    let mut rig = Rig::start(false);
    rig.until("the filtered force", -5.0, |rig| {
        (rig.force_z() + 5.0).abs() < 0.05
    });
    // A second program publishes another force in between.
    let second = publisher(&rig.bus);
    for _ in 0..100 {
        let mine = rig.sample(-5.0);
        rig.publisher.publish(&mine);
        let theirs = rig.sample(20.0);
        second.publish(&theirs);
    }
    rig.refresh();
    assert!((rig.force_z() + 5.0).abs() < 0.05, "{}", rig.force_z());

    let taken = rig.status.get().unwrap().message.records;
    let mut wrong = rig.sample(-5.0);
    wrong.header = Header::new(tangent_runtime::clock::now_ns(), "base");
    rig.publisher.publish(&wrong);
    rig.silent_until("the reason", |rig| {
        rig.reason()
            .contains("in frame \\\"base\\\", [sensor.topic] frame = \\\"ft\\\"")
    });
    rig.silent_until("stale", |rig| rig.validity() == 2);
    assert_eq!(rig.status.get().unwrap().message.records, taken);
}

#[test]
fn a_frozen_sensor_is_noticed() {
    let mut rig = Rig::start(false);
    let end = Instant::now() + Duration::from_secs(3);
    rig.until("three seconds of noise", -5.0, |_| Instant::now() > end);
    assert_eq!(rig.validity(), 0);
    let mut frozen = rig.sample(-5.0);
    let pause = Stop::new();
    for _ in 0..1000 {
        frozen.header.stamp = Header::new(tangent_runtime::clock::now_ns(), "ft").stamp;
        rig.publisher.publish(&frozen);
        rig.refresh();
        if rig.validity() == 11 {
            return;
        }
        pause.wait(PERIOD);
    }
    panic!("the frozen sensor was not noticed: {:?}", rig.status.get());
}
