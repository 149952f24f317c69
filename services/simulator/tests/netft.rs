//! The sensor service against the simulated box: real sockets, real time, faults on the way.

#![allow(clippy::unwrap_used)]

use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_live::timed;
use tangent_mechanics::{Pose, Tool};
use tangent_netft::{BoxConfig, Config, NetftError, RdtSocket};
use tangent_runtime::config::DEFAULT_CELL;
use tangent_runtime::{Bus, CellConfig, Stop, Subscription};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{Answer, ArmState, Health, Request, WrenchStatus};
use tangent_schemas::topics::{self, queries};
use tangent_simulator::netb::{BoxSample, NetbBox, NetbConfig, NetbFault};

/// Far beyond what anything here takes, on any machine.
const PATIENCE: Duration = Duration::from_secs(60);
const VALID: u8 = 0;
const STALE: u8 = 2;
const SATURATED: u8 = 3;
const FROZEN: u8 = 11;
const AXIS_STUCK: u8 = 12;
const IMPLAUSIBLE: u8 = 14;

/// The service beside a box, on a bus of its own.
struct Rig {
    simulated: NetbBox,
    bus: Bus,
    /// All of `wrench/raw` from the first record on.
    raw: Subscription<WrenchStamped>,
    stop: Stop,
    service: Option<JoinHandle<Result<(), NetftError>>>,
}

impl Rig {
    fn start(simulated: NetbConfig, change: impl FnOnce(&mut Config)) -> Self {
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

    fn statuses(&self) -> Subscription<WrenchStatus> {
        self.bus.subscribe(&topics::WRENCH_STATUS, 4096).unwrap()
    }

    fn tare(&self) -> Answer {
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

/// Nothing hangs on the sensor, and no real-time scheduling: a test must not starve the machine.
fn config(rdt_port: u16, http_port: u16) -> Config {
    let cell = CellConfig::parse("cell.toml", DEFAULT_CELL).unwrap();
    let mut config = Config::from_cell(&cell);
    config.address = "127.0.0.1".into();
    config.rdt_port = rdt_port;
    config.http_port = http_port;
    config.realtime_priority = None;
    config.payload.mass_kg = 0.0;
    config
}

fn serve(config: &Config, bus: &Bus, stop: &Stop) -> JoinHandle<Result<(), NetftError>> {
    let (config, bus, stop) = (config.clone(), bus.clone(), stop.clone());
    std::thread::spawn(move || tangent_netft::run(config, bus, stop))
}

/// The first message for which `good` holds.
fn wait_for<M: tangent_schemas::Message>(
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

fn newton(x: f64, y: f64, z: f64) -> BoxSample {
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

#[test]
fn at_7_khz_nothing_is_lost_and_every_record_is_published() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        rig.simulated.feed().hold(newton(0.0, 0.0, -3.0));
        // Five seconds of records, in the box's own time.
        let last = wait_for(&statuses, "35000 records", |s| s.records >= 35_000);
        assert_eq!((last.records_lost, last.records_out_of_order), (0, 0));
        assert_eq!((last.restarts, last.reconnects), (0, 0));
        let mut stamps = Vec::new();
        while let Some(received) = rig.raw.try_recv() {
            assert_eq!(received.message.header.frame_id.as_str(), "sensor");
            stamps.push(received.message.header.stamp.to_ns());
        }
        assert_eq!(rig.raw.lost(), 0);
        assert!(stamps.len() as u64 >= last.records, "{}", stamps.len());
        // Once the clock is known, a record's time is that of the box's count, whatever this
        // machine did meanwhile.
        let late = &stamps[stamps.len() / 2..];
        let span = (late[late.len() - 1] - late[0]) as f64 * 1e-9;
        let rate = (late.len() - 1) as f64 / span;
        assert!((rate / 7000.0 - 1.0).abs() < 0.01, "{rate} Hz");
    });
}

#[test]
fn a_second_of_stall_loses_nothing_when_the_kernel_grants_the_buffer() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let config = config(rig.simulated.rdt_address().port(), 1);
        let socket = RdtSocket::connect(
            &config.address,
            config.rdt_port,
            config.socket_buffer_bytes,
            Duration::from_millis(1),
        )
        .unwrap();
        if socket.buffer_records() < 9000 {
            println!(
                "skipped, because {}",
                socket.buffer_words(7000.0, config.socket_buffer_bytes)
            );
            return;
        }
        let statuses = rig.statuses();
        wait_for(&statuses, "the stream", |s| s.records > 7000);
        // A callback runs in the receiving thread: it holds the reader up.
        let stalled = AtomicBool::new(false);
        let handle = rig
            .bus
            .on(&topics::WRENCH_RAW, move |_| {
                if !stalled.swap(true, Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_secs(1));
                }
            })
            .unwrap();
        let after = wait_for(&statuses, "records after the stall", |s| s.records > 21_000);
        drop(handle);
        assert_eq!(after.records_lost, 0);
        assert_eq!((after.restarts, after.reconnects), (0, 0));
    });
}

#[test]
fn a_wrench_is_published_at_its_rate_with_its_status_before_it() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        rig.simulated.feed().hold(newton(1.0, 2.0, -3.0));
        let statuses = rig.statuses();
        let wrenches: Subscription<WrenchStamped> =
            rig.bus.subscribe(&topics::WRENCH_TOOL, 4096).unwrap();
        let wrench = wait_for(&wrenches, "the contact", |w| {
            (w.wrench.force.z + 3.0).abs() < 1e-6
        });
        assert_eq!(wrench.header.frame_id.as_str(), "tool");
        assert!((wrench.wrench.force.x - 1.0).abs() < 1e-6);
        // The tip is ahead of the sensor's origin: the same force, another moment.
        let lever = config(1, 1).sensor_from_tool.translation().z;
        assert!(lever > 0.01);
        assert!((wrench.wrench.torque.x - lever * 2.0).abs() < 1e-6);
        let status = wait_for(&statuses, "its status", |s| {
            s.header.stamp == wrench.header.stamp
        });
        assert_eq!(status.validity, VALID);
        assert!(status.bias_age_s < 0.0, "a tare nobody asked for");
        assert!((status.filter_delay_s - 0.2251 / 50.0).abs() < 1e-5);
        assert!(status.rate_hz > 6000.0);
        drop(rig);
    });
}

#[test]
fn buffered_streams_and_other_rates_work_too() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |config| {
            config.rate_hz = 1000.0;
            config.buffer_records = Some(10);
        });
        let statuses = rig.statuses();
        let last = wait_for(&statuses, "2000 records", |s| s.records >= 2000);
        assert_eq!(last.records_lost, 0);
        assert!(
            (last.rate_hz / 1000.0 - 1.0).abs() < 0.05,
            "{}",
            last.rate_hz
        );
    });
}

#[test]
fn faults_on_the_way_are_counted_as_what_they_are() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        wait_for(&statuses, "the stream", |s| s.records > 100);
        rig.simulated.inject(NetbFault::Drop(5));
        wait_for(&statuses, "5 lost", |s| s.records_lost == 5);
        rig.simulated.inject(NetbFault::Duplicate(3));
        rig.simulated.inject(NetbFault::Reorder);
        let seen = wait_for(&statuses, "one out of order", |s| {
            s.records_out_of_order == 1
        });
        assert_eq!(seen.records_lost, 5);
        let healths = rig.bus.subscribe(&topics::health("netft"), 64).unwrap();
        rig.simulated.inject(NetbFault::Corrupt(4));
        wait_for(&healths, "4 malformed datagrams", |h: &Health| {
            let found = h
                .figure_names
                .iter()
                .position(|n| n == "datagrams_malformed");
            found.is_some_and(|i| h.figures[i] == 4.0)
        });
        rig.simulated
            .inject(NetbFault::Restart(Duration::from_millis(100)));
        let again = wait_for(&statuses, "the restart", |s| {
            s.restarts == 1 && s.validity == VALID
        });
        assert_eq!(again.records_lost, 5);
    });
}

#[test]
fn saturation_is_seen_by_a_slow_reader_and_its_numbers_by_nobody() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        let wrenches: Subscription<WrenchStamped> =
            rig.bus.subscribe(&topics::WRENCH_TOOL, 8192).unwrap();
        wait_for(&statuses, "the stream", |s| s.records > 100);
        rig.simulated.inject(NetbFault::Saturate(1));
        wait_for(&statuses, "saturation", |s| s.validity == SATURATED);
        wait_for(&statuses, "its end", |s| s.validity == VALID);
        while let Some(received) = wrenches.try_recv() {
            assert!(received.message.wrench.force.z.abs() < 1e-9);
        }
        // A threshold that tripped is a warning: the reading is right.
        rig.simulated.inject(NetbFault::Status {
            word: 0x8001_0000,
            records: u32::MAX,
        });
        let warned = wait_for(&statuses, "the warning", |s| s.status == 0x8001_0000);
        assert_eq!(warned.validity, VALID);
        assert_eq!(warned.status_text.as_str(), "force threshold tripped");
        // A load that the sensor cannot bear, unreported.
        rig.simulated.feed().hold(newton(0.0, 0.0, 500.0));
        wait_for(&statuses, "overload", |s| s.validity == SATURATED);
    });
}

#[test]
fn silence_is_told_and_the_stream_taken_back() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        wait_for(&statuses, "the stream", |s| s.records > 100);
        rig.simulated
            .inject(NetbFault::Silence(Duration::from_millis(400)));
        wait_for(&statuses, "silence", |s| s.validity == STALE);
        let back = wait_for(&statuses, "the stream again", |s| s.validity == VALID);
        assert!(back.reconnects >= 1);
        // Another client has the stream now; it is asked for again.
        rig.simulated.inject(NetbFault::ForgetClient);
        wait_for(&statuses, "the stream back", |s| {
            s.reconnects > back.reconnects && s.validity == VALID
        });
        // Gone for longer than anybody waits: found again from the beginning.
        rig.simulated
            .inject(NetbFault::Silence(Duration::from_millis(2500)));
        wait_for(&statuses, "long silence", |s| s.validity == STALE);
        wait_for(&statuses, "the box found again", |s| s.validity == VALID);
    });
}

/// A box with the noise of a real one, and the stream known to it: 2.5 s of records.
fn noisy_rig() -> (Rig, Subscription<WrenchStatus>) {
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
fn stands_since_ns(
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

#[test]
fn a_frozen_sensor_is_noticed_within_two_cycles_and_until_it_lives_again() {
    timed(|| {
        let (rig, statuses) = noisy_rig();
        rig.simulated.inject(NetbFault::Freeze(true));
        let told = wait_for(&statuses, "the frozen sensor", |s| s.validity > SATURATED);
        assert_eq!((told.validity, told.stuck_axes), (FROZEN, 0x3f));
        // By the stamps of measurement: two cycles of a robot at 125 Hz, whatever this machine does
        // meanwhile.
        let at_ns = told.header.stamp.to_ns();
        let since_ns = stands_since_ns(&rig.raw, at_ns, |a, b| a.wrench == b.wrench);
        assert!(at_ns - since_ns <= 16_000_000, "{} ns", at_ns - since_ns);
        assert!(!rig.tare().done, "a frozen sensor has no zero");
        rig.simulated.inject(NetbFault::Freeze(false));
        wait_for(&statuses, "the living sensor", |s| s.validity == VALID);
    });
}

#[test]
fn a_stuck_axis_is_noticed_within_two_cycles_and_named() {
    timed(|| {
        let (rig, statuses) = noisy_rig();
        rig.simulated.inject(NetbFault::StickAxis(Some(2)));
        let told = wait_for(&statuses, "the stuck axis", |s| s.validity > SATURATED);
        assert_eq!((told.validity, told.stuck_axes), (AXIS_STUCK, 1 << 2));
        let at_ns = told.header.stamp.to_ns();
        let since_ns =
            stands_since_ns(&rig.raw, at_ns, |a, b| a.wrench.force.z == b.wrench.force.z);
        assert!(at_ns - since_ns <= 16_000_000, "{} ns", at_ns - since_ns);
        rig.simulated.inject(NetbFault::StickAxis(None));
        wait_for(&statuses, "the living axis", |s| s.validity == VALID);
    });
}

#[test]
fn plausible_looking_damage_is_left_out_and_too_much_of_it_is_a_fault() {
    timed(|| {
        let (rig, statuses) = noisy_rig();
        let tool = rig.bus.subscribe(&topics::WRENCH_TOOL, 100_000).unwrap();
        rig.simulated.inject(NetbFault::Implausible { one_of: 20 });
        let told = wait_for(&statuses, "records left out", |s| {
            s.records_implausible > 200
        });
        assert_eq!(told.validity, VALID);
        while let Some(received) = tool.try_recv() {
            let force = &received.message.wrench.force;
            let off = force.x.abs().max(force.y.abs()).max((force.z + 3.0).abs());
            assert!(off < 0.5, "{force:?}");
        }
        rig.simulated.inject(NetbFault::Implausible { one_of: 2 });
        wait_for(&statuses, "too many", |s| s.validity == IMPLAUSIBLE);
        rig.simulated.inject(NetbFault::Implausible { one_of: 0 });
        wait_for(&statuses, "an end of it", |s| s.validity == VALID);
    });
}

#[test]
fn a_sensor_without_noise_is_never_called_frozen() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        rig.simulated.feed().hold(newton(0.0, 0.0, -3.0));
        let last = wait_for(&statuses, "four seconds of the same record", |s| {
            // A machine that is busy may let the stream pause.
            assert!(s.validity <= STALE, "{}", s.validity);
            s.records >= 28_000
        });
        assert_eq!(last.stuck_axes, 0);
    });
}

#[test]
fn a_box_that_comes_later_is_found() {
    timed(|| {
        let place = NetbBox::start(NetbConfig::default()).unwrap();
        let (rdt_port, http_port) = (place.rdt_address().port(), place.http_address().port());
        drop(place);
        let (bus, stop) = (Bus::in_process("test"), Stop::new());
        let healths = bus.subscribe(&topics::health("netft"), 64).unwrap();
        let service = serve(&config(rdt_port, http_port), &bus, &stop);
        let told = wait_for(&healths, "a fault", |h: &Health| h.state == 3);
        assert!(
            told.fault.contains(&format!("127.0.0.1:{http_port}")),
            "{}",
            told.fault
        );
        let statuses = bus.subscribe(&topics::WRENCH_STATUS, 64).unwrap();
        let simulated = NetbBox::start(NetbConfig {
            rdt_port,
            http_port,
            ..NetbConfig::default()
        });
        wait_for(&statuses, "the stream", |s: &WrenchStatus| {
            s.validity == VALID
        });
        stop.trigger();
        service.join().unwrap().unwrap();
        drop(simulated);
    });
}

#[test]
fn units_are_converted_and_unknown_ones_refused() {
    timed(|| {
        let pounds = NetbConfig {
            force_unit: "lbf".into(),
            torque_unit: "lbf-in".into(),
            counts_per_force: 1000.0,
            ..NetbConfig::default()
        };
        let rig = Rig::start(pounds, |_| {});
        rig.simulated.feed().hold(BoxSample {
            counts: [1000, 0, 0, 0, 0, 0],
            saturated: false,
        });
        wait_for(&rig.raw, "one pound", |w: &WrenchStamped| {
            (w.wrench.force.x - 4.4482216152605).abs() < 1e-9
        });
        drop(rig);

        let strange = NetbBox::start(NetbConfig {
            torque_unit: "firkin".into(),
            ..NetbConfig::default()
        })
        .unwrap();
        let port = strange.http_address().port();
        let error = BoxConfig::fetch("127.0.0.1", port, PATIENCE)
            .unwrap_err()
            .to_string();
        assert!(error.contains("<scfgtu> is `firkin`"), "{error}");
    });
}

#[test]
fn a_web_server_that_never_ends_is_no_box() {
    timed(|| {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = std::thread::spawn(move || {
            use std::io::{Read, Write};
            let (mut stream, _) = listener.accept().unwrap();
            let _ = stream.read(&mut [0; 1024]);
            let _ = stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n\r\n<netft>");
            // Until the client has had enough.
            while stream.write_all(&[b'a'; 4096]).is_ok() {}
        });
        assert!(BoxConfig::fetch("127.0.0.1", port, PATIENCE).is_err());
        server.join().unwrap();
    });
}

#[test]
fn a_tare_zeroes_the_wrench_and_tells_its_figures() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        let wrenches: Subscription<WrenchStamped> =
            rig.bus.subscribe(&topics::WRENCH_TOOL, 4096).unwrap();
        rig.simulated.feed().hold(newton(2.0, 0.0, 1.0));
        wait_for(&wrenches, "the zero's force", |w| {
            (w.wrench.force.x - 2.0).abs() < 1e-6
        });
        let answer = rig.tare();
        assert!(answer.done, "{}", answer.message);
        assert!(answer.data.starts_with("{\"bias\":[2.0"), "{}", answer.data);
        let tared = wait_for(&statuses, "the tare", |s| s.bias_age_s >= 0.0);
        assert!((tared.bias.force.x - 2.0).abs() < 1e-9);
        wait_for(&wrenches, "zero", |w| {
            w.wrench.force.x.abs() < 1e-9 && w.wrench.force.z.abs() < 1e-9
        });
    });
}

#[test]
fn a_tare_that_cannot_be_is_refused_with_the_reason() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |config| config.payload.mass_kg = 0.3);
        let statuses = rig.statuses();
        // The arm says nothing: its orientation is missing.
        wait_for(&statuses, "a missing orientation", |s| s.validity == 1);
        let blind = rig.tare();
        assert!(!blind.done);
        assert!(blind.message.contains("orientation"), "{}", blind.message);

        let arm = rig.bus.publisher(&topics::ARM_STATE).unwrap();
        let stop = Stop::new();
        let (stopped, still) = (stop.clone(), AtomicBool::new(true));
        let still = std::sync::Arc::new(still);
        let keeps_still = std::sync::Arc::clone(&still);
        let mover = std::thread::spawn(move || {
            let mut x = 0.0;
            while !stopped.wait(Duration::from_millis(4)) {
                x += if keeps_still.load(Ordering::Relaxed) {
                    0.0
                } else {
                    1e-4
                };
                let pose: Pose<tangent_mechanics::Base, Tool> =
                    Pose::new([x, 0.0, 0.5].into(), Default::default());
                arm.publish(&ArmState {
                    tool_pose: (&pose).into(),
                    ..ArmState::default()
                });
            }
        });
        wait_for(&statuses, "an orientation", |s| s.validity == VALID);
        still.store(false, Ordering::Relaxed);
        let moving = rig.tare();
        still.store(true, Ordering::Relaxed);
        let resting = rig.tare();
        stop.trigger();
        mover.join().unwrap();
        assert!(!moving.done);
        assert!(moving.message.contains("moved"), "{}", moving.message);
        assert!(resting.done, "{}", resting.message);
    });
}

#[test]
fn the_cut_off_is_set_live() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        wait_for(&statuses, "the stream", |s| s.validity == VALID);
        let request = Request {
            action: "set".into(),
            argument: "25".into(),
        };
        let key = queries::parameter("netft", "filter_cutoff_hz");
        assert!(rig.bus.ask(&key, &request, PATIENCE).unwrap().done);
        wait_for(&statuses, "the longer delay", |s| {
            (s.filter_delay_s - 0.2251 / 25.0).abs() < 1e-5
        });
    });
}

#[test]
fn a_taken_port_is_named() {
    timed(|| {
        let one = NetbBox::start(NetbConfig::default()).unwrap();
        let same = NetbConfig {
            rdt_port: one.rdt_address().port(),
            ..NetbConfig::default()
        };
        let error = NetbBox::start(same).err().unwrap().to_string();
        assert!(
            error.contains(&format!("UDP 127.0.0.1:{}", one.rdt_address().port())),
            "{error}"
        );
    });
}
