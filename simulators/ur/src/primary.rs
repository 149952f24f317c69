//! Packages of the robot-state ports: the primary and secondary client's, and the real-time
//! client's. All big-endian.

use nalgebra::Vector3;
use tangent_mechanics::{Arm, ModelData};
use tangent_rtde::dashboard::ur_size;

use crate::config::Flavour;
use crate::controller::{Message, Summary};
use crate::modes::{RobotMode, RuntimeState, SafetyMode};

const ROBOT_STATE: u8 = 16;
const ROBOT_MESSAGE: u8 = 20;

/// Denavit-Hartenberg rows: a (m), d (m), alpha (rad), theta (rad) of each joint.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// a, d, alpha, theta, six each.
    pub rows: [[f64; 6]; 4],
    /// Lower and upper joint limits, rad.
    pub position: [[f64; 2]; 6],
    /// Joint speed limit, rad/s.
    pub speed: [f64; 6],
    /// Robot type: 1 for a UR5.
    pub robot_type: i32,
}

impl Geometry {
    /// Geometry of a model. An arm of another maker is presented as a UR5.
    pub fn of(model: &ModelData) -> Self {
        let mut geometry = Geometry {
            // The numbers that the manufacturer assigned.
            robot_type: match ur_size(&model.name) {
                Some(3) => 3,
                Some(10) => 2,
                Some(16) => 4,
                Some(18) => 5,
                Some(20) => 7,
                Some(30) => 8,
                Some(15) => 9,
                _ => 1,
            },
            ..Geometry::default()
        };
        for (i, row) in model.dh.rows.iter().take(6).enumerate() {
            geometry.rows[0][i] = row.a_m;
            geometry.rows[1][i] = row.d_m;
            geometry.rows[2][i] = row.alpha_rad;
            geometry.rows[3][i] = row.theta_offset_rad;
        }
        if let Ok(arm) = Arm::<6>::new(model) {
            let limits = arm.limits();
            for i in 0..6 {
                geometry.position[i] = [limits.position_lower[i], limits.position_upper[i]];
                geometry.speed[i] = limits.velocity[i];
            }
        }
        geometry
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn u8(&mut self, x: u8) -> &mut Self {
        self.0.push(x);
        self
    }
    fn u32(&mut self, x: u32) -> &mut Self {
        self.0.extend_from_slice(&x.to_be_bytes());
        self
    }
    fn i32(&mut self, x: i32) -> &mut Self {
        self.u32(x as u32)
    }
    fn u64(&mut self, x: u64) -> &mut Self {
        self.0.extend_from_slice(&x.to_be_bytes());
        self
    }
    fn f32(&mut self, x: f64) -> &mut Self {
        self.0.extend_from_slice(&(x as f32).to_be_bytes());
        self
    }
    fn f64(&mut self, x: f64) -> &mut Self {
        self.0.extend_from_slice(&x.to_be_bytes());
        self
    }
    fn f64s(&mut self, xs: &[f64]) -> &mut Self {
        for x in xs {
            self.f64(*x);
        }
        self
    }
    fn text(&mut self, text: &str) -> &mut Self {
        self.0.extend_from_slice(text.as_bytes());
        self
    }
    /// A text of at most 255 bytes with its length before it.
    fn counted(&mut self, text: &str) -> &mut Self {
        let bytes = &text.as_bytes()[..text.len().min(255)];
        self.0.push(bytes.len() as u8);
        self.0.extend_from_slice(bytes);
        self
    }
}

fn package(kind: u8, body: impl FnOnce(&mut Writer)) -> Vec<u8> {
    let mut out = Vec::new();
    lengthened(&mut out, |w| {
        w.u8(kind);
        body(w);
    });
    out
}

/// Fills `out` with a length and a body; the length counts both. The memory of `out` is reused.
fn lengthened(out: &mut Vec<u8>, body: impl FnOnce(&mut Writer)) {
    let mut w = Writer(std::mem::take(out));
    w.0.clear();
    w.u32(0);
    body(&mut w);
    let length = w.0.len() as u32;
    w.0[..4].copy_from_slice(&length.to_be_bytes());
    *out = w.0;
}

/// A part of the robot state: length of itself, type, body.
fn part(w: &mut Writer, kind: u8, body: impl FnOnce(&mut Writer)) {
    let start = w.0.len();
    w.u32(0).u8(kind);
    body(w);
    let length = (w.0.len() - start) as u32;
    w.0[start..start + 4].copy_from_slice(&length.to_be_bytes());
}

fn microseconds(s: f64) -> u64 {
    (s.max(0.0) * 1e6) as u64
}

/// First package to a client: name and version of the software.
pub fn version(flavour: Flavour, time_s: f64) -> Vec<u8> {
    let version = flavour.version();
    package(ROBOT_MESSAGE, |w| {
        w.u64(microseconds(time_s)).u8(254).u8(3);
        w.counted("URControl")
            .u8(version.major as u8)
            .u8(version.minor as u8)
            .i32(version.bugfix as i32)
            .i32(version.build as i32)
            .text("20-06-2022, 00:00:00");
    })
}

/// A message in the form in which it is sent to all clients.
pub fn message(message: &Message, time_s: f64) -> Vec<u8> {
    package(ROBOT_MESSAGE, |w| {
        w.u64(microseconds(time_s)).u8(253);
        match message {
            Message::Key(title, text) => {
                w.u8(7).i32(0).i32(0).counted(title).text(text);
            }
            Message::Text(text) => {
                w.u8(0).text(text);
            }
            Message::Error(code, argument, text) => {
                w.u8(6)
                    .i32(*code)
                    .i32(*argument)
                    .i32(3)
                    .u32(0)
                    .u32(0)
                    .text(text);
            }
            Message::Exception(line, column, text) => {
                w.u8(10).u32(*line).u32(*column).text(text);
            }
            Message::Safety(mode) => {
                w.u8(5).i32(0).i32(0).u8(mode.number() as u8).u32(0).u32(0);
            }
        }
    })
}

/// Writes the robot state that clients need at 10 Hz into `out`: mode, joints, tool pose,
/// calibration and configuration. The memory of `out` is reused.
pub fn robot_state(out: &mut Vec<u8>, s: &Summary, flavour: Flavour, geometry: &Geometry) {
    lengthened(out, |w| {
        w.u8(ROBOT_STATE);
        part(w, 0, |w| {
            let powered = s.robot_mode != RobotMode::PowerOff;
            let emergency = matches!(
                s.safety,
                SafetyMode::RobotEmergencyStop | SafetyMode::SystemEmergencyStop
            );
            w.u64(microseconds(s.time_s))
                .u8(1)
                .u8(1)
                .u8(u8::from(powered));
            w.u8(u8::from(emergency))
                .u8(u8::from(s.safety == SafetyMode::ProtectiveStop))
                .u8(u8::from(s.runtime == RuntimeState::Playing))
                .u8(u8::from(s.runtime == RuntimeState::Paused))
                .u8(s.robot_mode.number() as u8)
                .u8(0)
                .f64s(&[s.speed_slider, s.speed_scaling, 1.0])
                .u8(0);
        });
        part(w, 1, |w| {
            for i in 0..6 {
                w.f64s(&[s.q[i], s.q_target[i], s.qd[i]]);
                w.f32(0.0).f32(48.0).f32(25.0).f32(0.0).u8(253);
            }
        });
        part(w, 4, |w| {
            w.f64s(&s.tcp_pose).f64s(&s.tcp_offset);
        });
        // Kinematics: unlike the configuration below, theta comes before a, d and alpha.
        part(w, 5, |w| {
            for _ in 0..6 {
                w.u32(0);
            }
            let [a, d, alpha, theta] = &geometry.rows;
            for row in [theta, a, d, alpha] {
                w.f64s(row);
            }
            w.u32(1);
        });
        part(w, 6, |w| {
            for limits in &geometry.position {
                w.f64s(limits);
            }
            for speed in &geometry.speed {
                w.f64s(&[*speed, 15.0]);
            }
            w.f64s(&[1.05, 1.4, 0.25, 1.2, 0.25]);
            for row in &geometry.rows {
                w.f64s(row);
            }
            // Master board, controller box, robot type and sub type.
            w.i32(2)
                .i32(if flavour == Flavour::Cb3 { 2 } else { 5 })
                .i32(geometry.robot_type)
                .i32(0);
        });
    });
}

/// Writes the real-time client's package into `out`: 139 doubles on CB3 (1116 bytes), 152 on
/// e-Series (1220 bytes). The memory of `out` is reused.
pub fn realtime(out: &mut Vec<u8>, s: &Summary, flavour: Flavour, joint_mode: f64) {
    lengthened(out, |w| realtime_body(w, s, flavour, joint_mode));
}

fn realtime_body(w: &mut Writer, s: &Summary, flavour: Flavour, joint_mode: f64) {
    let zero = [0.0; 6];
    w.f64(s.time_s);
    for q in [&s.q_target, &s.qd_target, &s.qdd_target] {
        w.f64s(q.as_slice());
    }
    w.f64s(&zero).f64s(&zero);
    w.f64s(s.q.as_slice()).f64s(s.qd.as_slice());
    w.f64s(&zero).f64s(&zero);
    w.f64s(&s.tcp_pose).f64s(&s.tcp_speed).f64s(&s.tcp_force);
    w.f64s(&s.tcp_pose_target).f64s(&s.tcp_speed_target);
    w.f64(0.0).f64s(&[25.0; 6]).f64(0.0).f64(0.0);
    w.f64(f64::from(s.robot_mode.number()))
        .f64s(&[joint_mode; 6])
        .f64(f64::from(s.safety.number()));
    w.f64s(&zero).f64s(&[0.0, 0.0, -9.806_65]).f64s(&zero);
    w.f64s(&[s.speed_scaling, 0.0, 0.0, 0.0, 48.0, 48.0, 0.0]);
    w.f64s(&[48.0; 6]);
    w.f64s(&[0.0, f64::from(s.runtime.number())]);
    let elbow = Vector3::<f64>::zeros();
    w.f64s(elbow.as_slice()).f64s(elbow.as_slice());
    w.f64(f64::from(s.safety.number()));
    if flavour == Flavour::ESeries {
        w.f64s(&[0.0; 13]);
    }
}
