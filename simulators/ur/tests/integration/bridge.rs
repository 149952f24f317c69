//! The robot bridge on the simulated controller over real sockets: the uploaded program is
//! executed, and faults are real.

use std::net::{IpAddr, Ipv4Addr};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::common::start_model;
use tangent_live::timed;
use tangent_rtde::{Config, queries};
use tangent_runtime::{Bus, CellConfig, Handle, Stop, Subscription};
use tangent_schemas::tangent::{ArmCommand, ArmState, Request};
use tangent_schemas::topics;
use tangent_simulated_device::Ports;
use tangent_simulated_ur::{ControllerConfig, Fault, Flavour, SimulatedUr};

const PATIENCE: Duration = Duration::from_secs(60);
const SPEED: f64 = 0.1;

struct Cell {
    simulated: SimulatedUr,
    bus: Bus,
    stop: Stop,
    states: Subscription<ArmState>,
    bridge: Option<JoinHandle<Result<(), tangent_rtde::Error>>>,
}

impl Cell {
    fn new(flavour: Flavour) -> Self {
        let model = match flavour {
            Flavour::Cb3 => "ur5",
            Flavour::ESeries => "ur5e",
        };
        let controller = ControllerConfig {
            flavour,
            ..ControllerConfig::default()
        };
        let address = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let simulated = start_model(address, Ports::Ephemeral, &controller, model).unwrap();
        let mut cell = CellConfig::default_cell();
        let ports = simulated.endpoints();
        cell.robot.model = model.into();
        cell.robot.rtde_port = ports.rtde.port();
        cell.robot.script_port = ports.primary.port();
        cell.robot.dashboard_port = ports.dashboard.port();
        cell.limits.workspace_min_m = [-2.0; 3];
        cell.limits.workspace_max_m = [2.0; 3];
        cell.realtime.enabled = false;
        let config = Config::from_cell(&cell).unwrap();
        let bus = Bus::in_process("test");
        let states = bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        let stop = Stop::new();
        let (b, s) = (bus.clone(), stop.clone());
        let bridge = std::thread::spawn(move || tangent_rtde::run(config, b, s));
        Self {
            simulated,
            bus,
            stop,
            states,
            bridge: Some(bridge),
        }
    }

    fn until(&self, what: &str, condition: impl Fn(&ArmState) -> bool) -> ArmState {
        let mut last = None;
        for _ in 0..200_000 {
            let Some(received) = self.states.recv_timeout(PATIENCE) else {
                break;
            };
            if condition(&received.message) {
                return received.message;
            }
            last = Some(received.message);
        }
        panic!(
            "{what} never came; last state {last:?}; robot's log {:?}",
            self.simulated.log()
        );
    }

    fn ready(&self) -> ArmState {
        self.until("ready", |s| s.ready)
    }

    /// A controller in this process that turns the last joint, back and forth.
    fn task(&self, activation: u64) -> Handle {
        let commands = self.bus.publisher(&topics::ARM_COMMAND).unwrap();
        self.bus
            .on(&topics::ARM_STATE, move |received| {
                let state = &received.message;
                // Zero velocity until this controller holds the arm; then its task starts.
                let mine = state.commander_id == commands.mark();
                let command = ArmCommand {
                    cycle: state.cycle,
                    kind: u8::from(mine),
                    values: [0.0, 0.0, 0.0, 0.0, 0.0, SPEED].into_iter().collect(),
                    activation: if mine { activation } else { 0 },
                    source: "test/0".try_into().unwrap(),
                    ..ArmCommand::default()
                };
                commands.publish(&command);
            })
            .unwrap()
    }

    fn moving(&self) -> ArmState {
        self.until("motion", |s| (s.qd[5] - SPEED).abs() < 0.02)
    }

    /// Asserts that the arm stays at rest for a while, although commands of the old task continue.
    fn stays_at_rest(&self) {
        let from = self
            .until("rest", |s| s.qd.iter().all(|v| v.abs() < 0.005))
            .cycle;
        let mut cycle = from;
        while cycle < from + 100 {
            let s = self.until("a state", |_| true);
            assert!(s.qd.iter().all(|v| v.abs() < 0.01), "{:?}", s.qd);
            cycle = s.cycle;
        }
    }

    fn end(&mut self) {
        self.stop.trigger();
        self.bridge.take().unwrap().join().unwrap().unwrap();
    }
}

#[test]
fn it_becomes_ready_moves_and_ends_in_order_on_both_series() {
    timed(|| {
        for flavour in [Flavour::Cb3, Flavour::ESeries] {
            let mut cell = Cell::new(flavour);
            let ready = cell.ready();
            let _task = cell.task(ready.activation_latched + 1);
            let moving = cell.moving();
            assert_eq!(moving.program_state, 2);
            // Takes effect in the next cycle or the one after: measured, and plausible.
            assert!(
                moving.command_latency_s > 0.0 && moving.command_latency_s < 0.1,
                "{}",
                moving.command_latency_s
            );
            eprintln!(
                "{flavour:?}: latency {:.4} s, packet to command {:.6} s, missed {}, lost {}",
                moving.command_latency_s,
                moving.packet_to_command_s,
                moving.missed_cycles,
                moving.packets_lost
            );
            cell.end();
            assert!(cell.simulated.wait_for(PATIENCE, |s| s.program.is_none()));
            let snapshot = cell.simulated.snapshot().unwrap();
            assert_eq!(
                snapshot.summary.safety,
                tangent_simulated_ur::modes::SafetyMode::Normal
            );
        }
    });
}

#[test]
fn a_protective_stop_is_reported_unlocked_and_never_resumed() {
    timed(|| {
        let mut cell = Cell::new(Flavour::Cb3);
        let ready = cell.ready();
        let _task = cell.task(ready.activation_latched + 1);
        cell.moving();
        cell.simulated.fault(Fault::ProtectiveStop);
        let stopped = cell.until("the stop", |s| s.safety_mode == 3);
        assert_eq!(stopped.not_ready_reason.as_str(), "protective stop");
        let unlock = || {
            cell.bus
                .ask(queries::UNLOCK, &Request::default(), PATIENCE)
                .unwrap()
        };
        // With the next packet, the stop has reached all services, including those that judge
        // requests by it.
        let shown = stopped.cycle;
        cell.until("the packet after it", |s| s.cycle > shown);
        let early = unlock();
        assert!(
            !early.done && early.message.contains("5s"),
            "{}",
            early.message
        );
        let since = stopped.robot_time_s;
        cell.until("5 s on the robot's clock", |s| s.robot_time_s > since + 5.1);
        let answer = unlock();
        assert!(answer.done, "{}", answer.message);
        cell.ready();
        cell.stays_at_rest();
        cell.end();
    });
}

#[test]
fn a_cut_connection_and_a_restart_are_survived_at_rest() {
    timed(|| {
        let mut cell = Cell::new(Flavour::Cb3);
        let ready = cell.ready();
        let activation = ready.activation_latched + 1;
        let task = cell.task(activation);
        cell.moving();
        for fault in [Fault::Disconnect, Fault::Restart] {
            cell.simulated.fault(fault);
            cell.until("not ready", |s| !s.ready);
            if fault == Fault::Restart {
                // A robot that has booted is powered off.
                let on = cell
                    .bus
                    .ask(queries::POWER_ON, &Request::default(), PATIENCE);
                assert!(on.unwrap().done);
            }
            cell.ready();
            cell.stays_at_rest();
        }
        drop(task);
        let _task = cell.task(activation + 1);
        cell.moving();
        cell.end();
    });
}

#[test]
fn lost_packets_a_pause_and_the_slider_are_distinguished() {
    timed(|| {
        let mut cell = Cell::new(Flavour::Cb3);
        let ready = cell.ready();
        let activation = ready.activation_latched + 1;
        let task = cell.task(activation);
        cell.moving();
        cell.simulated.fault(Fault::DropPackets {
            probability: 0.05,
            burst: 1,
        });
        let lost = cell.until("losses", |s| s.packets_lost > 5);
        assert!(lost.ready, "{}", lost.not_ready_reason);
        cell.simulated.fault(Fault::DropPackets {
            probability: 0.0,
            burst: 1,
        });
        cell.simulated.fault(Fault::SpeedSlider(0.1));
        let slow = cell.until("the slider", |s| !s.ready);
        assert!(
            slow.not_ready_reason.contains("10 % speed"),
            "{}",
            slow.not_ready_reason
        );
        cell.simulated.fault(Fault::SpeedSlider(1.0));
        cell.ready();
        cell.stays_at_rest();
        cell.simulated.fault(Fault::PauseProgram);
        cell.until("the pause", |s| s.not_ready_reason.contains("paused"));
        cell.simulated.fault(Fault::ResumeProgram);
        cell.ready();
        cell.stays_at_rest();
        drop(task);
        cell.end();
    });
}
