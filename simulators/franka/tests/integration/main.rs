//! Tests of the simulated robot with another client, and of the Franka bridge on it, over real
//! sockets with real faults. A torque law runs in the same process.

#![allow(clippy::unwrap_used)]

mod client;
mod examples;
mod rig;
mod tare;

use std::sync::atomic::Ordering;

use tangent_franka::fci::RobotMode;
use tangent_franka::queries;
use tangent_live::timed;
use tangent_runtime::{Bus, Stop};
use tangent_schemas::topics;
use tangent_simulated_franka::{FciFault, PlantConfig, Snapshot};

use rig::*;

#[test]
fn it_holds_then_follows_a_torque_law_for_seconds() {
    timed(|| {
        let cell = Cell::new();
        let first = cell.ready();
        cell.states(500);
        let held = cell.until("a state", |_| true);
        for (now, before) in held.q.iter().zip(&first.q) {
            assert!((now - before).abs() < 1e-3);
        }
        let q0 = held.q[0];
        cell.start(IMPEDANCE);
        cell.until("the way out", |s| s.q[0] - q0 > 0.18);
        cell.until("the way back", |s| s.q[0] - q0 < 0.02);
        let state = cell.until("the way out again", |s| s.q[0] - q0 > 0.18);
        assert!(state.ready);
        assert_eq!(state.commanded_by.as_str(), "test/0");
        // Before it was ready, the arm sank a little under a tool that was not declared, and an arm
        // that moves cannot be taken over.
        assert_eq!(
            state.commands_refused, first.commands_refused,
            "{}",
            state.refusal_reason
        );
        assert_eq!(state.missed_cycles, 0);
        assert!(state.command_latency_s > 0.0);
        let snapshot = cell.simulated.snapshot().unwrap();
        assert_eq!(snapshot.state.control_command_success_rate, 1.0);
        assert_eq!(snapshot.answers_lost, 0);
        cell.no_step();
    });
}

#[test]
fn silence_brings_it_to_rest_and_the_old_task_moves_nothing_more() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        let activation = cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.act.store(SILENT, Ordering::Release);
        let latched = cell.until("the latch", |s| s.activation_latched >= activation);
        assert!(latched.missed_cycles > 0);
        cell.until("rest", |s| s.qd.iter().all(|v| v.abs() < 0.01));
        // The same task is refused again; a new one is followed.
        cell.act.store(IMPEDANCE, Ordering::Release);
        let refused = cell.until("a refusal", |s| s.refusal_reason.contains("latched out"));
        assert!(refused.commands_refused > latched.commands_refused);
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.no_step();
    });
}

#[test]
fn without_a_commander_the_motion_ends_and_begins_again_with_one() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.act.store(SILENT, Ordering::Release);
        cell.until("the motion's end", |s| s.runtime_state == 1 && s.ready);
        assert!(
            cell.simulated
                .wait_for(PATIENCE, |s| s.state.mode() == RobotMode::Idle)
        );
        cell.act.store(STILL, Ordering::Release);
        cell.ready();
    });
}

#[test]
fn what_is_no_number_is_refused_and_a_step_leaves_as_a_ramp() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.act.store(NAN, Ordering::Release);
        let state = cell.until("a refusal", |s| s.commands_refused > 20);
        assert!(
            state.refusal_reason.contains("not a finite number"),
            "{}",
            state.refusal_reason
        );
        cell.until("rest", |s| s.qd.iter().all(|v| v.abs() < 0.02));
        cell.start(STEPS);
        for way in [1.0, -1.0, 1.0] {
            let reached = |s: &Snapshot| s.state.tau_j_d[0] * way == 8.0;
            assert!(cell.simulated.wait_for(PATIENCE, reached));
        }
        assert_eq!(cell.mode(), RobotMode::Move);
        cell.no_step();
    });
}

#[test]
fn lost_packets_are_counted_and_tolerated() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::DropAnswers(10));
        assert!(cell.simulated.wait_for(PATIENCE, |s| s.answers_lost >= 10));
        cell.states(200);
        assert_eq!(cell.mode(), RobotMode::Move);
        cell.states(200);
        // The robot's state stayed constant during the gap, and so did the next torque: there is no
        // step after the gap either.
        let snapshot = cell.simulated.snapshot().unwrap();
        assert!(snapshot.torque_step_max_nm <= 0.9 + 1e-9);
        let before = cell.until("a state", |_| true);
        cell.act.store(STILL, Ordering::Release);
        // The robot does not wait for an answer to a state that it did not send: the bridge sees
        // the gap.
        let sim = &cell.simulated;
        cell.act.store(SILENT, Ordering::Release);
        cell.until("the motion's end", |s| s.runtime_state == 1);
        sim.fault(FciFault::DropStates(7));
        let after = cell.until("the gap", |s| s.packets_lost > before.packets_lost);
        assert_eq!(after.packets_lost - before.packets_lost, 7);
    });
}

#[test]
fn answers_that_never_come_are_a_violation_and_a_person_recovers() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::DropAnswers(20));
        let state = cell.until("the reflex", |s| {
            s.not_ready_reason
                .contains("communication_constraints_violation")
        });
        assert!(!state.ready);
        assert_eq!(state.robot_mode, i32::from(RobotMode::Reflex.number()));
        assert_eq!(state.safety_mode, 3);
        cell.act.store(STILL, Ordering::Release);
        cell.ask(queries::RECOVER);
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
    });
}

#[test]
fn a_collision_is_a_reflex_and_a_fresh_task_recovers() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::Push([0.0, 0.0, 100.0]));
        let state = cell.until("the reflex", |s| !s.ready);
        assert!(
            state.not_ready_reason.contains("reflex"),
            "{}",
            state.not_ready_reason
        );
        cell.simulated.fault(FciFault::Push([0.0; 3]));
        // The interrupted task continues to send commands: nothing recovers by itself.
        cell.states(500);
        assert_eq!(cell.mode(), RobotMode::Reflex);
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
    });
}

#[test]
fn user_stop_and_guiding_are_reported_and_leave_no_trace() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        let activation = cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::UserStop(true));
        let state = cell.until("the stop", |s| !s.ready && s.safety_mode == 5);
        assert!(
            state.not_ready_reason.contains("user stop"),
            "{}",
            state.not_ready_reason
        );
        cell.simulated.fault(FciFault::UserStop(false));
        let state = cell.ready();
        assert!(state.activation_latched >= activation);
        cell.states(300);
        let state = cell.until("a state", |_| true);
        assert!(
            state.qd.iter().all(|v| v.abs() < 0.02),
            "the old task moves nothing"
        );
        cell.act.store(SILENT, Ordering::Release);
        cell.until("the motion's end", |s| s.runtime_state == 1 && s.ready);
        cell.simulated.fault(FciFault::Guiding(true));
        cell.until("guiding", |s| s.not_ready_reason.contains("guided by hand"));
        cell.simulated.fault(FciFault::Guiding(false));
        cell.until("the end of guiding", |s| s.ready);
    });
}

#[test]
fn a_cut_connection_is_made_again_and_a_frozen_robot_too() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        for (fault, connections) in [(FciFault::Disconnect, 2), (FciFault::Freeze(2.5), 3)] {
            let activation = cell.start(IMPEDANCE);
            cell.until("motion", |s| s.qd[0] > 0.1);
            cell.simulated.fault(fault);
            assert!(
                cell.simulated
                    .wait_for(PATIENCE, |s| s.connections >= connections)
            );
            // A disconnection rejects the previous activation. Older states may still be in the
            // queue here.
            cell.until("ready again", |s| {
                s.activation_latched >= activation && s.ready && s.runtime_state == 2
            });
            cell.states(200);
            let state = cell.until("a state", |_| true);
            assert!(state.qd.iter().all(|v| v.abs() < 0.02));
            assert!(state.cycle > 0);
        }
    });
}

#[test]
fn an_end_in_order_leaves_the_robot_idle() {
    timed(|| {
        let mut cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.stop.trigger();
        cell.bridge.take().unwrap().join().unwrap().unwrap();
        assert!(
            cell.simulated
                .wait_for(PATIENCE, |s| s.state.mode() == RobotMode::Idle)
        );
        let snapshot = cell.simulated.snapshot().unwrap();
        assert!(
            snapshot.state.reflex_reason.is_empty(),
            "{}",
            snapshot.state.reflex_reason
        );
        cell.no_step();
    });
}

/// Another protocol version is reported by its number, and the connection is retried with pauses.
#[test]
fn a_port_that_is_none_of_ours_is_tried_again() {
    timed(|| {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let simulated = simulated(PlantConfig::default());
        let mut config = config(&simulated);
        config.port = listener.local_addr().unwrap().port();
        let stop = Stop::new();
        let (bus, s) = (Bus::in_process("test"), stop.clone());
        let bridge = std::thread::spawn(move || tangent_franka::run(config, bus, s));
        // Answers each connection with version 10, as an FR3 does.
        for _ in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 16];
            std::io::Read::read_exact(&mut stream, &mut request).unwrap();
            let mut reply = vec![0, 0, 0, 0];
            reply.extend_from_slice(&request[4..8]);
            reply.extend([15, 0, 0, 0, 1, 10, 0]);
            std::io::Write::write_all(&mut stream, &reply).unwrap();
            // Held until the bridge closes it.
            let _ = std::io::Read::read(&mut stream, &mut request);
        }
        stop.trigger();
        bridge.join().unwrap().unwrap();
    });
}

/// A client that sends invalid data is disconnected, and the next client is served.
#[test]
fn the_robot_survives_hostile_clients() {
    timed(|| {
        let simulated = simulated(PlantConfig::default());
        let mut seed = 0x2545_F491_4F6C_DD1Du64;
        for round in 0..40 {
            let mut stream = std::net::TcpStream::connect(simulated.address()).unwrap();
            let mut bytes = vec![0u8; 16 + round * 40];
            for byte in &mut bytes {
                seed ^= seed << 13;
                seed ^= seed >> 7;
                seed ^= seed << 17;
                *byte = seed as u8;
            }
            if round % 2 == 0 {
                // A valid header for an existing command, and an invalid payload.
                bytes[..4].copy_from_slice(&(round as u32 % 14).to_le_bytes());
                let size = bytes.len() as u32;
                bytes[8..12].copy_from_slice(&size.to_le_bytes());
            }
            let _ = std::io::Write::write_all(&mut stream, &bytes);
        }
        assert!(!simulated.has_ended());
        let stop = Stop::new();
        let (bus, s, c) = (Bus::in_process("test"), stop.clone(), config(&simulated));
        let states = bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        let bridge = std::thread::spawn(move || tangent_franka::run(c, bus, s));
        while !states.recv_timeout(PATIENCE).unwrap().message.ready {}
        stop.trigger();
        bridge.join().unwrap().unwrap();
    });
}
