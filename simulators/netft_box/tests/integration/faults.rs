//! Faults between box and client: they are counted, marked in the validity, and end.

use std::net::UdpSocket;
use std::time::Duration;

use tangent_live::timed;
use tangent_netft::codec::{Command, Request};
use tangent_runtime::Subscription;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::Health;
use tangent_schemas::topics;
use tangent_simulated_netft::{NetbConfig, NetbFault};

use crate::rig::*;

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
fn saturation_reaches_a_slow_reader_and_its_numbers_reach_no_reader() {
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
        // An exceeded threshold is only a warning: the reading is right.
        rig.simulated.inject(NetbFault::Status {
            word: 0x8001_0000,
            records: u32::MAX,
        });
        let warned = wait_for(&statuses, "the warning", |s| s.status == 0x8001_0000);
        assert_eq!(warned.validity, VALID);
        assert_eq!(warned.status_text.as_str(), "force threshold tripped");
        // A load beyond the sensor's range that the box does not report.
        rig.simulated.feed().hold(newton(0.0, 0.0, 500.0));
        wait_for(&statuses, "overload", |s| s.validity == SATURATED);
    });
}

#[test]
fn silence_is_reported_and_the_stream_requested_again() {
    timed(|| {
        let rig = Rig::start(NetbConfig::default(), |_| {});
        let statuses = rig.statuses();
        wait_for(&statuses, "the stream", |s| s.records > 100);
        rig.simulated
            .inject(NetbFault::Silence(Duration::from_millis(400)));
        wait_for(&statuses, "silence", |s| s.validity == STALE);
        let back = wait_for(&statuses, "the stream again", |s| s.validity == VALID);
        assert!(back.reconnects >= 1);
        // Another client has taken over the stream; the service requests it again.
        rig.simulated.inject(NetbFault::ForgetClient);
        wait_for(&statuses, "the stream back", |s| {
            s.reconnects > back.reconnects && s.validity == VALID
        });
        // A silence longer than all timeouts: the box is discovered again from the beginning.
        rig.simulated
            .inject(NetbFault::Silence(Duration::from_millis(2500)));
        wait_for(&statuses, "long silence", |s| s.validity == STALE);
        wait_for(&statuses, "the box found again", |s| s.validity == VALID);
    });
}

#[test]
fn a_frozen_sensor_is_detected_within_two_cycles_until_it_recovers() {
    timed(|| {
        let (rig, statuses) = noisy_rig();
        rig.simulated.inject(NetbFault::Freeze(true));
        let told = wait_for(&statuses, "the frozen sensor", |s| s.validity > SATURATED);
        assert_eq!((told.validity, told.stuck_axes), (FROZEN, 0x3f));
        // Measured by the stamps: two cycles of a robot at 125 Hz, independent of the load of this
        // machine.
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

/// Another program sets the box's software bias while the tool presses: it applies to all clients.
#[test]
fn a_software_bias_of_another_client_is_a_zero_that_jumped() {
    timed(|| {
        let (rig, statuses) = noisy_rig();
        let other = UdpSocket::bind(("127.0.0.1", 0)).unwrap();
        let request = Request {
            command: Command::SetSoftwareBias,
            sample_count: 0,
        };
        other
            .send_to(&request.to_bytes(), rig.simulated.rdt_address())
            .unwrap();
        let told = wait_for(&statuses, "the jump", |s| s.validity != VALID);
        assert_eq!(told.validity, ZERO_JUMPED);
        wait_for(&statuses, "the reading after it", |s| s.validity == VALID);
        let answer = rig.tare();
        assert!(answer.done, "there was no zero before: {answer:?}");
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
            // On a busy machine the stream may pause.
            assert!(s.validity <= STALE, "{}", s.validity);
            s.records >= 28_000
        });
        assert_eq!(last.stuck_axes, 0);
    });
}
