//! A robot controller for tests, with only the behaviour that they need: set-up, one state per
//! cycle, and the register protocol of the program that the bridge sends. It uses the robot's side
//! of the codec.

use crate::codec::*;
use crate::program::IDENT;
use crate::sample::{Sample, input_types, output_types};

/// State of the program on the scripted robot.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Program {
    None,
    Loading { session: i32, cycles: u32 },
    Running,
}

/// The scripted robot controller.
pub(crate) struct Robot {
    pub version: ControllerVersion,
    pub v2: bool,
    pub protocol: Protocol,
    pub framer: Framer,
    pub inputs: Option<Recipe>,
    pub outputs: bool,
    pub output_names: Vec<String>,
    pub refuse: Option<(&'static str, Slot)>,
    pub streaming: bool,
    pub paused: bool,
    pub registers: Vec<Value>,
    pub sample: Sample,
    /// Identity that the program writes.
    pub ident: i32,
    pub program: Program,
    pub fresh: u32,
    pub rearm_low: bool,
    pub compiled: i32,
}

impl Robot {
    pub fn new(version: ControllerVersion) -> Self {
        Self {
            version,
            v2: true,
            protocol: Protocol::V1,
            framer: Framer::new(2300),
            inputs: None,
            outputs: false,
            output_names: Vec::new(),
            refuse: None,
            streaming: false,
            paused: false,
            registers: vec![Value::Int32(0); 11],
            sample: Sample {
                timestamp_s: 100.0,
                robot_mode: 7,
                safety_mode: 1,
                runtime_state: 1,
                speed_scaling: 1.0,
                target_speed_fraction: 1.0,
                ..Sample::default()
            },
            program: Program::None,
            ident: IDENT,
            fresh: 0,
            rearm_low: false,
            compiled: 0,
        }
    }

    pub fn int(&self, i: usize) -> i32 {
        self.registers[i].as_int32().unwrap()
    }

    pub fn receive(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        assert_eq!(self.framer.push(bytes), bytes.len());
        while let Some(p) = self.framer.next_package().unwrap() {
            let request = Request::decode(p.kind, p.payload, self.protocol).unwrap();
            let reply = match request {
                Request::ProtocolVersion(n) => {
                    let accepted = n == 1 || (n == 2 && self.v2);
                    let reply = Reply::ProtocolVersion { accepted };
                    reply.encode(self.protocol, out).unwrap();
                    if accepted {
                        self.protocol = Protocol::from_number(n).unwrap();
                    }
                    continue;
                }
                Request::ControllerVersion => Reply::ControllerVersion(self.version),
                Request::SetupInputs { names } => {
                    let slots: Vec<Slot> = names
                        .iter()
                        .map(|n| match self.refuse {
                            Some((name, slot)) if name == n => slot,
                            _ => Slot::Type(input_field(n).unwrap().data_type),
                        })
                        .collect();
                    self.inputs = Some(Recipe::new(1, input_types()).unwrap());
                    Reply::SetupInputs {
                        recipe_id: 1,
                        slots,
                    }
                }
                Request::SetupOutputs {
                    frequency_hz,
                    names,
                } => {
                    assert_eq!(frequency_hz.is_some(), self.protocol == Protocol::V2);
                    let slots = names
                        .iter()
                        .map(|n| match self.refuse {
                            Some((name, slot)) if name == n => slot,
                            _ => Slot::Type(output_field(n).unwrap().data_type),
                        })
                        .collect();
                    self.output_names = names;
                    self.outputs = true;
                    Reply::SetupOutputs {
                        recipe_id: Some(7),
                        slots,
                    }
                }
                Request::Start => {
                    self.streaming = self.outputs;
                    Reply::Start {
                        accepted: self.outputs,
                    }
                }
                Request::Pause => {
                    self.streaming = false;
                    self.paused = true;
                    Reply::Pause { accepted: true }
                }
                Request::Data(payload) => {
                    let before = self.registers[1].as_int32();
                    let recipe = self.inputs.as_ref().unwrap();
                    let mut values = Vec::new();
                    recipe.decode(payload, &mut values).unwrap();
                    self.registers = values;
                    assert_ne!(
                        self.registers[1].as_int32(),
                        before,
                        "every package has a new sequence"
                    );
                    continue;
                }
                Request::Text(_) => continue,
            };
            reply.encode(self.protocol, out).unwrap();
        }
    }

    pub fn upload(&mut self, session: i32) {
        self.program = Program::Loading {
            session,
            cycles: 40,
        };
        self.sample.runtime_state = 1;
    }

    /// Runs one control cycle: a step of the program, then a state package.
    pub fn cycle(&mut self, out: &mut Vec<u8>) {
        self.sample.timestamp_s += self.version.series().period_s();
        match self.program {
            Program::None => {}
            Program::Loading { session, cycles: 0 } => {
                self.program = Program::Running;
                self.compiled = session;
                self.sample.ident = self.ident;
                self.sample.session = session;
                self.sample.program_state = 0;
                self.sample.cause = 0;
                self.sample.runtime_state = 2;
                self.fresh = 0;
            }
            Program::Loading { session, cycles } => {
                self.program = Program::Loading {
                    session,
                    cycles: cycles - 1,
                };
            }
            Program::Running if self.sample.runtime_state == 2 => self.run(),
            Program::Running => {}
        }
        if !self.streaming {
            return;
        }
        let s = &self.sample;
        let mut values: Vec<Value> = vec![
            Value::Double(s.timestamp_s),
            Value::Vector6d(s.q),
            Value::Vector6d(s.qd),
            Value::Vector6d(s.qd_target),
            Value::Int32(s.robot_mode),
            Value::Int32(s.safety_mode),
            Value::Uint32(s.runtime_state),
            Value::Uint32(s.robot_status_bits),
            Value::Uint32(s.safety_status_bits),
            Value::Double(s.speed_scaling),
            Value::Double(s.target_speed_fraction),
        ];
        for i in [
            s.program_state,
            s.sequence_used,
            s.ident,
            s.session,
            s.cause,
            s.loops,
            s.stale_max,
        ] {
            values.push(Value::Int32(i));
        }
        values.extend(s.qd_commanded.map(Value::Double));
        let mut types = output_types();
        if self.output_names.len() > types.len() {
            types.push(DataType::Vector6d);
            values.push(Value::Vector6d([0.0, 0.0, 12.0, 0.0, 0.0, 0.0]));
        }
        let recipe = Recipe::new(7, types).unwrap();
        match self.protocol {
            Protocol::V1 => recipe.encode_without_id(&values, out).unwrap(),
            Protocol::V2 => recipe.encode(&values, out).unwrap(),
        }
    }

    pub fn run(&mut self) {
        let (cmd, seq, session, flags) = (self.int(0), self.int(1), self.int(2), self.int(3));
        let s = &mut self.sample;
        s.loops += 1;
        self.fresh = if seq == s.sequence_used {
            0
        } else {
            self.fresh + 1
        };
        s.sequence_used = seq;
        if session != self.compiled {
            (s.program_state, s.cause) = (4, 4);
        }
        match s.program_state {
            0 if self.fresh >= 3 && cmd == 0 => s.program_state = 1,
            1 | 2 | 5 => match cmd {
                4 => s.program_state = 5,
                1 => {
                    s.program_state = 2;
                    for (i, v) in s.qd_commanded.iter_mut().enumerate() {
                        *v = self.registers[4 + i].as_double().unwrap();
                    }
                }
                0 => (s.program_state, s.qd_commanded) = (1, [0.0; 6]),
                2 => (s.program_state, s.cause, s.qd_commanded) = (4, 3, [0.0; 6]),
                _ => {
                    (s.program_state, s.cause, s.qd_commanded) = (9, 3, [0.0; 6]);
                    s.runtime_state = 1;
                    self.program = Program::None;
                }
            },
            4 if cmd == 0 && flags == 0 => self.rearm_low = true,
            4 if cmd == 0 && flags == 1 && self.rearm_low && self.fresh >= 3 => {
                s.program_state = 1;
                s.cause = 0;
                self.rearm_low = false;
            }
            _ => {}
        }
        s.qd_target = s.qd_commanded;
    }
}
