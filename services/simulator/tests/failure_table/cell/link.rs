//! Robot, bridge and controller, with the bytes and commands between them.

use tangent_actuation::Command;
use tangent_actuation::lease::SILENCE_S;
use tangent_actuation::velocity::Posture;
use tangent_estimation::build;
use tangent_rtde::bridge::{Bridge, BridgeConfig, BridgeEvent};
use tangent_rtde::codec::Framer;
use tangent_simulated_ur::rtde_server::{Effect, Ownership, Session};

use super::{Cell, PACKAGE_BYTES_MAX, law};
use crate::fault::Fault;
use crate::table::{TableCell, source};

impl Cell {
    /// Starts the bridge's process, or restarts it, with the controller in it.
    pub(super) fn start_bridge(&mut self) {
        self.starts += 1;
        // State that the service keeps over restarts: whether the tool may be in contact.
        let known = self.law.clearance();
        self.law = law(&self.scenario, &self.plant);
        self.law.set_clearance(known).unwrap();
        self.estimator = build("blend", &self.scenario.estimation).unwrap();
        self.estimate = None;
        self.output = None;
        self.bridge = Bridge::new(BridgeConfig {
            seed: self.starts,
            ..self.settings.bridge.clone()
        });
        self.connect();
    }

    /// Opens a new connection between bridge and robot.
    pub(super) fn connect(&mut self) {
        self.at_bridge = Framer::new(PACKAGE_BYTES_MAX);
        self.at_robot = Framer::new(PACKAGE_BYTES_MAX);
        self.starts += 1;
        self.session = Session::new(self.starts, self.robot.config().flavour.version());
        self.ownership = Ownership::default();
        self.to_robot.clear();
        let now_s = self.now_s();
        self.bridge.open(now_s, &mut self.to_robot).unwrap();
    }

    pub(super) fn bridge_cycle(&mut self) {
        let now_s = self.now_s();
        while let Some(package) = self.at_bridge.next_package().unwrap() {
            let event = self
                .bridge
                .package(package, now_s, &mut self.to_robot)
                .unwrap();
            if event == BridgeEvent::Cycle {
                self.answer(now_s);
            }
        }
        if let Some(session) = self.bridge.take_upload() {
            let series = self.bridge.link().version().series();
            let program = self.settings.program(session, series);
            self.robot.upload(&program.render().unwrap());
        }
    }

    pub(super) fn robot_hears(&mut self) {
        let sent = std::mem::take(&mut self.to_robot);
        assert_eq!(self.at_robot.push(&sent), sent.len());
        let mut answers = Vec::new();
        while let Some(package) = self.at_robot.next_package().unwrap() {
            let effect = self.session.handle(
                package.kind,
                package.payload,
                &mut self.ownership,
                &mut answers,
            );
            if let Effect::Inputs(names, values) = effect {
                self.robot.write_inputs(&names, &values);
            }
        }
        if !self.has(Fault::BridgeDead) {
            assert_eq!(self.at_bridge.push(&answers), answers.len());
        }
    }

    /// The controller answers the current packet, and the bridge writes the commands that it
    /// accepts.
    fn answer(&mut self, now_s: f64) {
        let (tool, jacobian) = self.tool();
        let posture = Posture {
            q: self.plant.arm().q,
            tool_m: tool.translation(),
            tool_jacobian: jacobian,
        };
        if self.has(Fault::SecondSource) {
            let admitted = self
                .bridge
                .admit(&source("controller/other-2", 2), 99, now_s);
            assert!(
                !admitted || now_s - self.spoke_s > SILENCE_S,
                "a second source is let in beside the first"
            );
        }
        if self.has(Fault::NoCommand) {
            self.bridge
                .command(&posture, None, now_s, &mut self.to_robot)
                .unwrap();
            return;
        }
        let output = self.law_step(tool, &jacobian, now_s);
        let mut values: [f64; 6] = output.qd.into();
        let mut cycle = self.bridge.cycle();
        if self.has(Fault::CommandNan) {
            values[2] = f64::NAN;
        }
        if self.has(Fault::CommandFast) {
            values[0] = 50.0;
        }
        if self.has(Fault::CommandOld) {
            cycle = cycle.saturating_sub((1.0 / self.period_s()) as u64);
        }
        let wanted = Command {
            cycle,
            kind: output.kind as u8,
            values: &values,
            acceleration: output.acceleration,
            activation: output.activation,
        };
        let admitted = self.bridge.admit(&self.source, output.activation, now_s);
        if admitted {
            self.spoke_s = now_s;
        }
        self.bridge
            .command(
                &posture,
                admitted.then_some(&wanted),
                now_s,
                &mut self.to_robot,
            )
            .unwrap();
    }
}
