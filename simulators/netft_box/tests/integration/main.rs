//! The sensor service against the simulated box: real sockets, real time, faults in between.

#![allow(clippy::unwrap_used)]

mod clients;
mod faults;
mod rig;
mod tare;

use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tangent_live::timed;
use tangent_mechanics::{Pose, Tool};
use tangent_netft::{BoxConfig, RdtSocket};
use tangent_runtime::{Bus, Stop, Subscription};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, Health, Request, WrenchStatus};
use tangent_schemas::topics::{self, queries};
use tangent_simulated_netft::{BoxSample, NetbBox, NetbConfig};

use rig::*;

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
        // Once the clock is known, a record's time follows the box's count, independent of the load
        // of this machine.
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
        // A callback runs in the receiving thread and therefore delays the reader.
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
        // The tool's origin is ahead of the sensor's: the force is equal, the moment differs.
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
            config.rate_asked_hz = Some(1000.0);
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
            // Until the client closes the connection.
            while stream.write_all(&[b'a'; 4096]).is_ok() {}
        });
        assert!(BoxConfig::fetch("127.0.0.1", port, PATIENCE).is_err());
        server.join().unwrap();
    });
}

#[test]
fn a_tare_zeroes_the_wrench_and_returns_its_figures() {
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
        // The arm publishes nothing, so its orientation is missing.
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
