//! Converts the motions of a program to joint velocities, one control cycle at a time.

mod compliance;
mod path;
mod trapezoid;

use nalgebra::Vector6;
use tangent_mechanics::Joints;
use tangent_simulation::{ArmMeasurement, VelocityCommand};
use tangent_urscript::{Compliance, ForceModeTuning, Motion};

use crate::kinematics::Kinematics;

use compliance::{ForceControl, Tuning};
use path::{Path, apart};
use trapezoid::Trapezoid;

/// Correction of position errors in planned motions, 1/s.
const POSITION_GAIN: f64 = 12.0;
/// Bound handed to the servo where the plan itself bounds acceleration, rad/s².
const UNBOUNDED: f64 = 1e3;
/// Deceleration with which the controller itself stops the arm, rad/s².
pub const BRAKE_RAD_PER_S2: f64 = 12.0;
/// Joint speed below which the arm stands, rad/s.
const STILL_RAD_PER_S: f64 = 1e-3;

/// The motion under way.
#[derive(Debug)]
pub struct Planner {
    plan: Plan,
    done: bool,
    limiter: f64,
    compliance: Option<ForceControl>,
    tuning: Tuning,
}

#[derive(Debug)]
enum Plan {
    Hold {
        a: f64,
    },
    SpeedJ {
        qd: Joints<6>,
        a: f64,
    },
    SpeedL {
        xd: Vector6<f64>,
        now: Vector6<f64>,
        a: f64,
    },
    ServoJ {
        q: Joints<6>,
        lookahead_s: f64,
    },
    Joints {
        from: Joints<6>,
        to: Joints<6>,
        profile: Trapezoid,
        time: f64,
    },
    Path {
        path: Path,
        profile: Trapezoid,
        time: f64,
    },
}

impl Default for Planner {
    /// Standing still.
    fn default() -> Self {
        Self {
            plan: Plan::Hold {
                a: BRAKE_RAD_PER_S2,
            },
            done: true,
            limiter: 1.0,
            compliance: None,
            tuning: Tuning::default(),
        }
    }
}

impl Planner {
    /// Whether the motion begun last has ended.
    pub fn done(&self) -> bool {
        self.done
    }

    /// Share of the requested velocity that the joint limits allow, 0 to 1.
    pub fn limiter(&self) -> f64 {
        self.limiter
    }

    /// Whether `speedj` or `speedl` is active; they continue until another motion is requested.
    pub fn holds_speed(&self) -> bool {
        matches!(self.plan, Plan::SpeedJ { .. } | Plan::SpeedL { .. })
    }

    /// Whether the arm yields to forces.
    pub fn is_compliant(&self) -> bool {
        self.compliance.is_some()
    }

    /// Begins, changes or ends compliance. A motion under way continues along the other axes.
    pub fn set_compliance(&mut self, compliance: Option<Compliance>) {
        self.compliance = compliance.map(|c| match self.compliance.take() {
            Some(control) => control.with(c),
            None => ForceControl::new(c),
        });
    }

    /// Changes a setting of the force mode, which lasts until the program ends.
    pub fn tune_force_mode(&mut self, tuning: ForceModeTuning) {
        self.tuning.set(tuning);
    }

    /// Ends compliance and its settings, as the end of a program does.
    pub fn reset_compliance(&mut self) {
        self.compliance = None;
        self.tuning = Tuning::default();
    }

    /// Stops with the controller's own deceleration.
    pub fn brake(&mut self) {
        self.plan = Plan::Hold {
            a: BRAKE_RAD_PER_S2,
        };
        self.done = false;
    }

    /// Begins `motion` from where the arm is.
    pub fn start(&mut self, motion: Motion, arm: &ArmMeasurement, kinematics: &Kinematics) {
        self.done = false;
        let limits = kinematics.arm().limits();
        self.plan = match motion {
            Motion::SpeedJ { qd, a } => Plan::SpeedJ { qd: qd.into(), a },
            Motion::SpeedL { xd, a } => Plan::SpeedL {
                xd: xd.into(),
                now: kinematics.speed(&arm.q_target, &arm.qd_target).into(),
                a,
            },
            Motion::ServoJ { q, lookahead_s } => Plan::ServoJ {
                q: limits.clamp(&q.into()),
                lookahead_s,
            },
            Motion::MoveJ { q, a, v, t } => {
                let to = limits.clamp(&q.into());
                let distance = (to - arm.q_target).amax();
                let v = v.min(limits.velocity.min());
                Plan::Joints {
                    from: arm.q_target,
                    to,
                    profile: Trapezoid::new(distance, v, a, t),
                    time: 0.0,
                }
            }
            Motion::MoveL { pose, a, v, t } => {
                let path = Path::line(kinematics.pose(&arm.q_target), pose);
                Plan::Path {
                    profile: Trapezoid::new(path.length(), v, a, t),
                    path,
                    time: 0.0,
                }
            }
            Motion::MoveC {
                via,
                to,
                a,
                v,
                follows_arc,
            } => {
                let path = Path::arc(kinematics.pose(&arm.q_target), &via, to, follows_arc);
                Plan::Path {
                    profile: Trapezoid::new(path.length(), v, a, 0.0),
                    path,
                    time: 0.0,
                }
            }
            Motion::Stop { a } => Plan::Hold { a },
        };
    }

    /// The command of this cycle. `slider` is the speed slider, 0 to 1; `force` acts on the tool
    /// centre point, base axes, N and Nm.
    pub fn step(
        &mut self,
        arm: &ArmMeasurement,
        kinematics: &Kinematics,
        force: &[f64; 6],
        dt: f64,
        slider: f64,
    ) -> VelocityCommand {
        let speed_max = kinematics.arm().limits().velocity;
        let (q, qd) = (arm.q_target, arm.qd_target);
        let mut acceleration = UNBOUNDED;
        let wanted = match &mut self.plan {
            Plan::Hold { a } => {
                acceleration = *a;
                Joints::<6>::zeros()
            }
            Plan::SpeedJ { qd, a } => {
                acceleration = *a;
                *qd * slider
            }
            Plan::SpeedL { xd, now, a } => {
                let change = *xd * slider - *now;
                let most = *a * dt;
                *now += change * (most / change.amax().max(most));
                kinematics.joint_velocity(&q, now)
            }
            Plan::ServoJ {
                q: goal,
                lookahead_s,
            } => (*goal - q) / lookahead_s.max(3.0 * dt),
            Plan::Joints {
                from,
                to,
                profile,
                time,
            } => {
                let before = profile.at(*time).0;
                *time += dt * slider;
                let (after, _) = profile.at(*time);
                let reference = *from + (*to - *from) * before;
                (*to - *from) * ((after - before) / dt) + (reference - q) * POSITION_GAIN
            }
            Plan::Path {
                path,
                profile,
                time,
            } => {
                let reference = path.at(profile.at(*time).0);
                *time += dt * slider;
                let next = path.at(profile.at(*time).0);
                let (linear, angular) = apart(&reference, &next);
                let (error, turn) = apart(&kinematics.pose(&q), &reference);
                let linear = linear / dt + error * POSITION_GAIN;
                let angular = angular / dt + turn * POSITION_GAIN;
                let twist = Vector6::new(
                    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
                );
                kinematics.joint_velocity(&q, &twist)
            }
        };
        let mut along_others = qd;
        let wanted = match &mut self.compliance {
            None => wanted,
            Some(control) => {
                acceleration = acceleration.max(BRAKE_RAD_PER_S2);
                control.look(&kinematics.pose(&q), &kinematics.speed(&q, &qd));
                let present = kinematics.speed(&q, &qd).into();
                along_others = kinematics.joint_velocity(&q, &control.along_others(&present));
                let planned = kinematics.speed(&q, &wanted).into();
                let twist = control.step(&planned, force, &self.tuning, dt);
                kinematics.joint_velocity(&q, &twist)
            }
        };
        self.limiter = (0..6)
            .map(|i| speed_max[i] / wanted[i].abs().max(speed_max[i]))
            .fold(1.0, f64::min);
        let command = wanted * self.limiter;
        // A compliant arm arrives where the contact lets it: only the plan's time counts.
        let compliant = self.compliance.is_some();
        self.done = match &self.plan {
            Plan::Hold { .. } => along_others.amax() < STILL_RAD_PER_S,
            Plan::SpeedJ { .. } | Plan::SpeedL { .. } => {
                compliant || (command - qd).amax() < STILL_RAD_PER_S
            }
            Plan::ServoJ { .. } => true,
            Plan::Joints {
                to, profile, time, ..
            } => *time >= profile.duration() && (compliant || (to - q).amax() < 1e-4),
            Plan::Path {
                path,
                profile,
                time,
            } => {
                let (error, turn) = apart(&kinematics.pose(&q), &path.at(1.0));
                let arrived = compliant || error.norm() < 1e-4 && turn.norm() < 1e-3;
                // A target out of reach is approached as far as possible.
                *time >= profile.duration() + 1.0 || (*time >= profile.duration() && arrived)
            }
        };
        if self.done && matches!(self.plan, Plan::Joints { .. } | Plan::Path { .. }) {
            self.plan = Plan::Hold {
                a: BRAKE_RAD_PER_S2,
            };
        }
        VelocityCommand {
            qd: command,
            acceleration,
        }
    }
}
