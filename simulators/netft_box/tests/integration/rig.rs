//! The sensor service beside a simulated box, on a bus of its own.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_netft::{Config, NetftError};
use tangent_runtime::config::DEFAULT_CELL;
use tangent_runtime::{Bus, CellConfig, Stop, Subscription};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{Answer, Request, WrenchStatus};
use tangent_schemas::topics::{self, queries};
use tangent_simulated_netft::{BoxSample, NetbBox, NetbConfig};

/// Timeout that is far longer than any step here, on any machine.
pub const PATIENCE: Duration = Duration::from_secs(60);
pub const VALID: u8 = 0;
pub const STALE: u8 = 2;
pub const SATURATED: u8 = 3;
pub const FROZEN: u8 = 11;
pub const AXIS_STUCK: u8 = 12;
pub const IMPLAUSIBLE: u8 = 14;
pub const ZERO_JUMPED: u8 = 16;

/// The service beside a box, on a bus of its own.
pub struct Rig {
    pub simulated: NetbBox,
    pub bus: Bus,
    /// All messages of `wrench/raw` from the first record on.
    pub raw: Subscription<WrenchStamped>,
    stop: Stop,
    service: Option<JoinHandle<Result<(), NetftError>>>,
}

impl Rig {
    pub fn start(simulated: NetbConfig, change: impl FnOnce(&mut Config)) -> Self {
        let simulated = NetbBox::start(simulated).unwrap();
        let mut config = config(
            simulated.rdt_address().port(),
            simulated.http_address().port(),
        );
        change(&mut config);
        let (bus, stop) = (Bus::in_process("test"), Stop::new());
        let raw = bus.subscribe(&topics::WRENCH_RAW, 100_000).unwrap();
        let service = serve(&config, &bus, &stop);
        Self {
            simulated,
            bus,
            raw,
            stop,
            service: Some(service),
        }
    }

    pub fn statuses(&self) -> Subscription<WrenchStatus> {
        self.bus.subscribe(&topics::WRENCH_STATUS, 4096).unwrap()
    }

    pub fn tare(&self) -> Answer {
        let request = Request {
            action: "tare".into(),
            argument: String::new(),
        };
        self.bus
            .ask(queries::NETFT_TARE, &request, PATIENCE)
            .unwrap()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.stop.trigger();
        if let Some(service) = self.service.take() {
            let ended = service.join();
            if !std::thread::panicking() {
                ended.unwrap().unwrap();
            }
        }
    }
}

/// Without payload and real-time scheduling, since a test must not starve the machine.
pub fn config(rdt_port: u16, http_port: u16) -> Config {
    let cell = CellConfig::parse("cell.toml", DEFAULT_CELL).unwrap();
    let mut config = Config::from_cell(&cell);
    config.address = "127.0.0.1".into();
    config.rdt_port = rdt_port;
    config.http_port = http_port;
    config.realtime_priority = None;
    config.payload.mass_kg = 0.0;
    config
}

pub fn serve(config: &Config, bus: &Bus, stop: &Stop) -> JoinHandle<Result<(), NetftError>> {
    let (config, bus, stop) = (config.clone(), bus.clone(), stop.clone());
    std::thread::spawn(move || tangent_netft::run(config, bus, stop))
}

/// Waits for the first message for which `good` holds.
pub fn wait_for<M: tangent_schemas::Message>(
    heard: &Subscription<M>,
    what: &str,
    mut good: impl FnMut(&M) -> bool,
) -> M {
    let deadline = Instant::now() + PATIENCE;
    while Instant::now() < deadline {
        if let Some(received) = heard.recv_timeout(Duration::from_millis(100))
            && good(&received.message)
        {
            return received.message;
        }
    }
    panic!("waited in vain for {what}");
}

pub fn newton(x: f64, y: f64, z: f64) -> BoxSample {
    BoxSample {
        counts: [
            (x * 1e6) as i32,
            (y * 1e6) as i32,
            (z * 1e6) as i32,
            0,
            0,
            0,
        ],
        saturated: false,
    }
}

/// A box with the noise of a real one, after 2.5 s of records, in which the service learns its
/// stream.
pub fn noisy_rig() -> (Rig, Subscription<WrenchStatus>) {
    let noisy = NetbConfig {
        noise_counts: 40_000,
        ..NetbConfig::default()
    };
    let rig = Rig::start(noisy, |_| {});
    let statuses = rig.statuses();
    rig.simulated.feed().hold(newton(0.0, 0.0, -3.0));
    let known = wait_for(&statuses, "2.5 s of records", |s| {
        s.records >= 17_500 && s.validity != STALE
    });
    assert_eq!((known.validity, known.records_implausible), (VALID, 0));
    (rig, statuses)
}

/// Stamps of the raw records, ns, from the first of the last run in which `same` holds for
/// neighbours.
pub fn stands_since_ns(
    raw: &Subscription<WrenchStamped>,
    until_ns: i64,
    same: impl Fn(&WrenchStamped, &WrenchStamped) -> bool,
) -> i64 {
    let mut since: Option<WrenchStamped> = None;
    let mut last: Option<WrenchStamped> = None;
    while let Some(received) = raw.try_recv() {
        let record = received.message;
        if record.header.stamp.to_ns() > until_ns {
            break;
        }
        if !last.as_ref().is_some_and(|last| same(last, &record)) {
            since = Some(record.clone());
        }
        last = Some(record);
    }
    since.expect("records came").header.stamp.to_ns()
}
