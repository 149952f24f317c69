//! The bridge, a scripted robot, and the bytes between them, one cycle at a time.

use allocation_counter::measure;
use nalgebra::{Matrix6, Vector3, Vector6};
use tangent_actuation::velocity::{Posture, VelocityLimits};
use tangent_actuation::{Command, MotionLimits};

use crate::bridge::*;
use crate::codec::*;
use crate::link::OwnWrench;
use crate::link_error::LinkError;
use crate::program::RegisterMap;
use crate::scripted_robot::Robot;

/// Only the joints count here.
pub fn posture(bridge: &Bridge) -> Posture<6> {
    Posture {
        q: Vector6::from(bridge.sample().q),
        tool_m: Vector3::zeros(),
        tool_jacobian: Matrix6::zeros(),
    }
}

/// A bridge and its scripted robot.
pub struct Cell {
    pub bridge: Bridge,
    pub robot: Robot,
    framer: Framer,
    pub now_s: f64,
    to_robot: Vec<u8>,
    pub uploads: u32,
    pub activation: u64,
    /// Packets are not answered.
    pub mute: bool,
    /// Allocations between packet and command, all cycles so far.
    pub allocations: u64,
    wanted: Option<[f64; 6]>,
}

impl Cell {
    pub fn new(robot: Robot, series: Option<Series>) -> Self {
        Self::with_wrench(robot, series, None)
    }

    pub fn with_wrench(robot: Robot, series: Option<Series>, wrench: Option<OwnWrench>) -> Self {
        let config = BridgeConfig {
            registers: RegisterMap::new(24).unwrap(),
            model: "ur5".into(),
            series,
            rate_hz: None,
            wrench,
            limits: VelocityLimits {
                motion: MotionLimits {
                    speed_rad_per_s: Vector6::repeat(1.0),
                    position_lower_rad: Vector6::repeat(-6.0),
                    position_upper_rad: Vector6::repeat(6.0),
                    tool_speed_max_m_per_s: 0.25,
                    tool_turn_rate_max_rad_per_s: 1.0,
                    workspace_lower_m: Vector3::repeat(-1.0),
                    workspace_upper_m: Vector3::repeat(1.0),
                },
                acceleration_rad_per_s2: Vector6::repeat(8.0),
                response_s: 0.04,
                patience_cycles: 2,
                silence_latch_s: 0.1,
            },
            speed_scaling_min: 0.3,
            seed: 42,
        };
        Self {
            bridge: Bridge::new(config),
            robot,
            framer: Framer::new(PACKAGE_BYTES_MAX),
            now_s: 0.0,
            to_robot: Vec::new(),
            uploads: 0,
            activation: 0,
            mute: false,
            allocations: 0,
            wanted: None,
        }
    }

    pub fn connect(&mut self) {
        self.to_robot.clear();
        self.framer = Framer::new(PACKAGE_BYTES_MAX);
        self.bridge.open(self.now_s, &mut self.to_robot).unwrap();
    }

    /// One robot cycle: the bytes in both directions, and the bridge's answer.
    pub fn step(&mut self) -> Result<bool, LinkError> {
        self.now_s += self.robot.version.series().period_s();
        let mut bytes = Vec::new();
        let sent = std::mem::replace(&mut self.to_robot, Vec::with_capacity(4096));
        self.robot.receive(&sent, &mut bytes);
        self.robot.cycle(&mut bytes);
        assert_eq!(self.framer.push(&bytes), bytes.len());
        let mut finished = false;
        while let Some(package) = self.framer.next_package()? {
            let (bridge, now_s, to_robot) = (&mut self.bridge, self.now_s, &mut self.to_robot);
            let mut event = Ok(BridgeEvent::None);
            let taking_in = measure(|| event = bridge.package(package, now_s, to_robot));
            match event? {
                BridgeEvent::Cycle => {
                    let cycle = bridge.cycle();
                    let values = self.wanted.unwrap_or_default();
                    let wanted = (!self.mute).then_some(Command {
                        cycle,
                        kind: u8::from(self.wanted.is_some()),
                        values: &values,
                        acceleration: 0.0,
                        activation: self.activation,
                    });
                    let posture = posture(bridge);
                    let mut done = Ok(());
                    let commanding = measure(|| {
                        done = bridge.command(&posture, wanted.as_ref(), now_s, to_robot);
                    });
                    done?;
                    self.allocations += taking_in.count_total + commanding.count_total;
                    if let Some(session) = self.bridge.take_upload() {
                        self.uploads += 1;
                        self.robot.upload(session);
                    }
                }
                BridgeEvent::Finished => finished = true,
                _ => {}
            }
        }
        self.bridge.check(self.now_s)?;
        Ok(finished)
    }

    pub fn steps(&mut self, n: usize) {
        for _ in 0..n {
            self.step().unwrap();
        }
    }

    pub fn until(&mut self, what: &str, condition: impl Fn(&Self) -> bool) {
        for _ in 0..3000 {
            if condition(self) {
                return;
            }
            self.step().unwrap();
        }
        panic!("{what} never came; reason {:?}", self.bridge.reason());
    }

    pub fn ready(series: Series) -> Self {
        let version = match series {
            Series::Cb3 => ControllerVersion::new(3, 15, 8),
            Series::ESeries => ControllerVersion::new(5, 11, 0),
        };
        let mut cell = Self::new(Robot::new(version), Some(series));
        cell.connect();
        cell.until("ready", |c| c.bridge.is_ready());
        cell
    }

    /// A task is started.
    pub fn task(&mut self) {
        self.activation = self
            .bridge
            .gate()
            .admission
            .activation_latched()
            .max(self.activation)
            + 1;
        self.wanted = Some([0.1, 0.0, 0.0, 0.0, 0.0, -0.1]);
    }

    pub fn moves(&self) -> bool {
        self.robot.sample.qd_commanded == [0.1, 0.0, 0.0, 0.0, 0.0, -0.1]
    }

    pub fn rests(&self) -> bool {
        self.robot.sample.qd_commanded == [0.0; 6]
    }
}
