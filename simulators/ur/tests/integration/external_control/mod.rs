//! The three interfaces of the Universal Robots Client Library: the robot's program connects back
//! to its client and takes set points, trajectories and settings from it.

mod client;

use tangent_live::timed;
use tangent_simulated_ur::modes::SafetyMode;
use tangent_simulated_ur::{ControllerConfig, Fault, Flavour};

use crate::common::{PATIENCE, start};
use client::{Client, Mode, Point};

const FLAVOURS: [Flavour; 2] = [Flavour::Cb3, Flavour::ESeries];

fn cell(flavour: Flavour) -> tangent_simulated_ur::SimulatedUr {
    start(ControllerConfig {
        flavour,
        ..ControllerConfig::default()
    })
}

#[test]
fn set_points_of_every_mode_move_the_arm() {
    timed(|| {
        for flavour in FLAVOURS {
            let cell = cell(flavour);
            let mut client = Client::start(&cell);
            let q = client.q();

            let mut goal = q;
            for _ in 0..100 {
                goal[0] += 0.001;
                client.command(goal, Mode::ServoJ);
                client.next_cycle();
            }
            client.hold(goal, Mode::ServoJ, |s| (s.q[0] - q[0] - 0.1).abs() < 1e-3);

            let mut rate = [0.0; 6];
            rate[1] = 0.1;
            client.hold(rate, Mode::SpeedJ, |s| (s.qd[1] - 0.1).abs() < 1e-3);
            client.command([0.0; 6], Mode::Idle);
            assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-3));

            let up = [0.0, 0.0, 0.04, 0.0, 0.0, 0.0];
            client.hold(up, Mode::SpeedL, |s| (s.tcp_speed[2] - 0.04).abs() < 2e-3);
            client.command([0.0; 6], Mode::Idle);
            assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-3));

            client.command([0.0; 6], Mode::Freedrive);
            cell.fault(Fault::Push([0.0, 10.0, 0.0]));
            assert!(cell.wait_for(PATIENCE, |s| s.summary.tcp_speed[1] > 0.04));
            cell.fault(Fault::Push([0.0; 3]));
            client.command([0.0; 6], Mode::Stopped);
            assert!(cell.wait_for(PATIENCE, |s| s.program.is_none()));
            assert_eq!(cell.snapshot().unwrap().summary.safety, SafetyMode::Normal);
        }
    });
}

#[test]
fn trajectories_are_forwarded_and_cancelled() {
    timed(|| {
        for flavour in FLAVOURS {
            let cell = cell(flavour);
            let mut client = Client::start(&cell);
            let q = client.q();
            let mut turned = q;
            turned[0] += 0.2;
            assert_eq!(client.travel(&[Point::joints(q), Point::joints(turned)]), 0);
            assert!((client.q()[0] - turned[0]).abs() < 1e-3);

            let here = client.pose();
            let mut above = here;
            above[2] += 0.04;
            assert_eq!(client.travel(&[Point::line(above), Point::line(here)]), 0);
            let (mut via, mut to) = (here, here);
            (via[1], via[2], to[1]) = (via[1] + 0.03, via[2] + 0.03, to[1] + 0.06);
            assert_eq!(client.travel(&[Point::arc(via, to)]), 0);
            assert!((client.pose()[1] - to[1]).abs() < 1e-3);

            let mut end = client.q();
            end[2] += 0.1;
            assert_eq!(client.travel(&[Point::cubic_spline(end, [0.0; 6], 1.0)]), 0);
            assert!((client.q()[2] - end[2]).abs() < 5e-3);

            // One point too few.
            client.begin(2);
            client.point(&Point::joints(end));
            assert_eq!(client.result(), 2);

            // Cancelled on the way, with points yet to come.
            client.begin(3);
            client.point(&Point::joints(q).slow());
            client.point(&Point::joints(turned));
            assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() > 0.05));
            client.cancel();
            assert_eq!(client.result(), 1);
            assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-3));
            assert_eq!(client.travel(&[Point::joints(q)]), 0);
        }
    });
}

#[test]
fn settings_arrive_while_the_arm_is_commanded() {
    timed(|| {
        let cell = cell(Flavour::ESeries);
        let mut client = Client::start(&cell);
        client.order(10, &[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]);
        assert!(cell.wait_for(PATIENCE, |s| s.summary.tcp_offset[2] == 0.1));
        let frame = [0.0; 6];
        let (axes, wrench) = (
            [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 10.0, 0.0, 0.0, 0.0],
        );
        let order = [&frame[..], &axes, &wrench, &[2.0], &[0.02; 6]].concat();
        client.order(3, &order);
        assert!(cell.wait_for(PATIENCE, |s| s.summary.tcp_speed[2] > 5e-3));
        client.order(4, &[]);
        assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-3));
    });
}

#[test]
fn a_client_that_falls_silent_or_dies_ends_the_program_gently() {
    timed(|| {
        for dies in [false, true] {
            let cell = cell(Flavour::ESeries);
            let mut client = Client::start(&cell);
            client.hold([0.2; 6], Mode::SpeedJ, |s| s.qd[0] > 0.19);
            let rest = (!dies).then_some(client);
            assert!(cell.wait_for(PATIENCE, |s| s.program.is_none()));
            assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-3));
            assert_eq!(cell.snapshot().unwrap().summary.safety, SafetyMode::Normal);
            drop(rest);
        }
    });
}
