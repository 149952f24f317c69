//! Tares that the sensor's service must refuse, depending on the publisher of the controller's
//! state; and that a refusal is immediate.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_control::Phase;
use tangent_live::timed;
use tangent_netft::{Config, NetftError};
use tangent_runtime::{Bus, CellConfig, Role, Stop};
use tangent_schemas::tangent::{Answer, ControlState, Request};
use tangent_schemas::topics::{self, queries};
use tangent_simulated_netft::{BoxSample, NetbBox, NetbConfig, NetbFault};

/// Timeout that is far longer than any step here, on any machine.
const PATIENCE: Duration = Duration::from_secs(60);
/// Contact force, N.
const PRESSED_N: f64 = 3.0;

/// The service, a box that reads -3 N along z, and the publishers on their bus.
struct Rig {
    cell: CellConfig,
    simulated: NetbBox,
    stop: Stop,
    service: Option<JoinHandle<Result<(), NetftError>>>,
    folder: tempfile::TempDir,
    _router: Bus,
}

impl Rig {
    fn start() -> Self {
        let simulated = NetbBox::start(NetbConfig::default()).unwrap();
        simulated.feed().hold(BoxSample {
            counts: [0, 0, (-PRESSED_N * 1e6) as i32, 0, 0, 0],
            saturated: false,
        });
        let port = tangent_live::ports::free();
        let folder = tempfile::tempdir().unwrap();
        let mut cell = CellConfig::default_cell();
        cell.cell.name = format!("test{port}");
        cell.cell.state_folder = Some(folder.path().to_owned());
        cell.zenoh.connect = vec![format!("tcp/127.0.0.1:{port}")];
        cell.zenoh.listen = cell.zenoh.connect.clone();
        let router = Bus::open_within(&cell, Role::Router, PATIENCE).unwrap();
        let mut config = Config::from_cell(&cell);
        config.address = "127.0.0.1".into();
        config.rdt_port = simulated.rdt_address().port();
        config.http_port = simulated.http_address().port();
        config.realtime_priority = None;
        config.payload.mass_kg = 0.0;
        let stop = Stop::new();
        let bus = Bus::open_within(&cell, Role::Client, PATIENCE).unwrap();
        let until = stop.clone();
        let service = std::thread::spawn(move || tangent_netft::run(config, bus, until));
        Self {
            cell,
            simulated,
            stop,
            service: Some(service),
            folder,
            _router: router,
        }
    }

    fn client(&self) -> Bus {
        Bus::open_within(&self.cell, Role::Client, PATIENCE).unwrap()
    }

    /// Whether the service would know after a crash that the tool may be in contact.
    fn knows_of_contact(&self) -> bool {
        let file = self.folder.path().join("netft.json");
        let kept = std::fs::read_to_string(file).unwrap_or_default();
        kept.contains("\"contact_possible\": true")
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.stop.trigger();
        let ended = self.service.take().unwrap().join();
        assert!(std::thread::panicking() || ended.unwrap().is_ok());
    }
}

/// Publishes a message in each period, until dropped.
struct Speaker {
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

impl Speaker {
    fn start(bus: Bus, phase: Phase, contact_possible: bool, period: Duration) -> Self {
        let stop = Stop::new();
        let until = stop.clone();
        let thread = std::thread::spawn(move || {
            let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
            while !until.wait(period) {
                control.publish(&ControlState {
                    phase: phase as u8,
                    contact_possible,
                    ..ControlState::default()
                });
            }
            bus.close();
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Speaker {
    fn drop(&mut self) {
        self.stop.trigger();
        let _ = self.thread.take().unwrap().join();
    }
}

fn tare(bus: &Bus) -> Answer {
    let request = Request {
        action: "tare".into(),
        argument: String::new(),
    };
    bus.ask(queries::NETFT_TARE, &request, PATIENCE).unwrap()
}

/// Whether the service answers; the request has no effect.
fn answers(bus: &Bus) -> bool {
    let request = Request {
        action: "nothing".into(),
        argument: String::new(),
    };
    let answer = bus.ask(queries::NETFT_TARE, &request, Duration::from_secs(1));
    answer.is_ok_and(|answer| answer.message.contains("unknown action"))
}

fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < PATIENCE, "never came: {what}");
        std::thread::park_timeout(Duration::from_millis(2));
    }
}

/// The bug: any publisher could report that the task was done. The service then allowed a tare
/// while the controller pressed, and stored it.
#[test]
fn an_impostors_control_state_does_not_permit_the_tare() {
    timed(|| {
        let rig = Rig::start();
        let person = rig.client();
        let mut wrench = person.latest(&topics::WRENCH_TOOL).unwrap();
        let mut status = person.latest(&topics::WRENCH_STATUS).unwrap();
        let _controller =
            Speaker::start(rig.client(), Phase::Slide, true, Duration::from_millis(8));
        until("the controller is heard", || rig.knows_of_contact());
        until("the query", || answers(&person));
        let _impostor = Speaker::start(rig.client(), Phase::Done, false, Duration::from_millis(1));
        let reader = rig.client();
        let mut health = reader.latest(&topics::health("netft")).unwrap();
        until("the service names a second publisher", || {
            let refused = tare(&person);
            assert!(!refused.done, "{}", refused.message);
            assert!(refused.message.contains("slide"), "{}", refused.message);
            health
                .get()
                .is_some_and(|health| health.message.fault.contains("control/state: a second"))
        });
        assert!(rig.knows_of_contact());
        // The contact force is still shown, because the tare was refused.
        assert!(status.get().unwrap().message.bias_age_s < 0.0);
        let force = wrench.get().unwrap().message.wrench.force.z;
        assert!((force + PRESSED_N).abs() < 0.01, "{force} N");
    });
}

/// The bug: a refusal waited until the previous average had ended.
#[test]
fn a_tare_in_contact_is_refused_while_another_one_waits_for_records() {
    timed(|| {
        let rig = Rig::start();
        let person = rig.client();
        let mut status = person.latest(&topics::WRENCH_STATUS).unwrap();
        until("the stream", || {
            status.get().is_some_and(|s| s.message.records > 100)
        });
        until("the query", || answers(&person));
        rig.simulated
            .inject(NetbFault::Silence(Duration::from_secs(20)));
        until("silence", || {
            status.get().is_some_and(|s| s.message.validity == 2)
        });
        let first = rig.client();
        let waiting = std::thread::spawn(move || tare(&first));
        // This tare is allowed and begins, but no record arrives.
        std::thread::park_timeout(Duration::from_millis(200));
        let control = rig.client();
        let _controller = Speaker::start(control, Phase::Slide, true, Duration::from_millis(2));
        until("the controller is heard", || rig.knows_of_contact());
        let asked = Instant::now();
        let refused = tare(&person);
        println!("refused after {:?}", asked.elapsed());
        assert!(!waiting.is_finished(), "it waited for the first one");
        assert!(
            !refused.done && refused.message.contains("slide"),
            "{}",
            refused.message
        );
        let first = waiting.join().unwrap();
        assert!(first.message.contains("no records"), "{}", first.message);
    });
}
