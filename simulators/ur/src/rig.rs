//! Controller and bare arm without sockets and clock, for tests.

use tangent_rtde::codec::Value;
use tangent_simulation::ServoConfig;

use crate::config::{ControllerConfig, Flavour};
use crate::controller::{Controller, Message};
use crate::plant::{ArmPlant, BareArm};

pub struct Rig {
    pub controller: Controller,
    pub arm: BareArm,
    pub messages: Vec<Message>,
}

impl Rig {
    pub fn new(config: ControllerConfig) -> Self {
        let servo: ServoConfig = match config.flavour {
            Flavour::Cb3 => ServoConfig::cb3(),
            Flavour::ESeries => ServoConfig::e_series(),
        };
        let arm = BareArm::builtin("ur5", &servo).unwrap();
        let controller = Controller::new(&config, "ur5", arm.arm()).unwrap();
        Self {
            controller,
            arm,
            messages: Vec::new(),
        }
    }

    pub fn cb3() -> Self {
        Self::new(ControllerConfig {
            program_start_s: 0.0,
            compile_s_per_line: 0.0,
            ..ControllerConfig::default()
        })
    }

    pub fn cycle(&mut self) {
        let command = self.controller.cycle(self.arm.arm(), [0.0; 6]);
        self.arm.step(&command);
        self.messages.extend(self.controller.take_messages());
    }

    pub fn cycles(&mut self, n: usize) {
        for _ in 0..n {
            self.cycle();
        }
    }

    /// Uploads the program and runs this number of cycles.
    pub fn run(&mut self, program: &str, cycles: usize) {
        self.controller.upload(program);
        self.cycles(cycles);
    }

    pub fn out(&self, n: usize) -> i32 {
        self.controller.registers.output.integers[n]
    }

    pub fn out_double(&self, n: usize) -> f64 {
        self.controller.registers.output.doubles[n]
    }

    pub fn set(&mut self, name: &str, value: Value) {
        self.controller.write_inputs(&[name.to_owned()], &[value]);
    }

    pub fn speed(&self) -> f64 {
        self.arm.arm().qd_target.amax()
    }

    pub fn exceptions(&self) -> Vec<&str> {
        self.messages
            .iter()
            .filter_map(|m| match m {
                Message::Exception(_, _, text) => Some(text.as_str()),
                _ => None,
            })
            .collect()
    }
}
