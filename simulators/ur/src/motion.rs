//! Converts the motions of a program to joint velocities, one control cycle at a time.

use nalgebra::{Vector3, Vector6};
use tangent_mechanics::Joints;
use tangent_simulation::{ArmMeasurement, VelocityCommand};
use tangent_urscript::Motion;
use tangent_urscript::pose::isometry;

use crate::kinematics::Kinematics;

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
    Line {
        from: [f64; 6],
        to: [f64; 6],
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
                let from = kinematics.pose(&arm.q_target);
                let (linear, angular) = apart(&from, &pose);
                // A turn on the spot runs at as many rad/s as a line at m/s.
                Plan::Line {
                    from,
                    to: pose,
                    profile: Trapezoid::new(linear.norm().max(angular.norm()), v, a, t),
                    time: 0.0,
                }
            }
            Motion::Stop { a } => Plan::Hold { a },
        };
    }

    /// The command of this cycle. `slider` is the speed slider, 0 to 1.
    pub fn step(
        &mut self,
        arm: &ArmMeasurement,
        kinematics: &Kinematics,
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
            Plan::Line {
                from,
                to,
                profile,
                time,
            } => {
                let before = profile.at(*time).0;
                *time += dt * slider;
                let (after, _) = profile.at(*time);
                let (linear, angular) = apart(from, to);
                let reference = between(from, to, before);
                let (error, turn) = apart(&kinematics.pose(&q), &reference);
                let rate = (after - before) / dt;
                let linear = linear * rate + error * POSITION_GAIN;
                let angular = angular * rate + turn * POSITION_GAIN;
                let twist = Vector6::new(
                    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
                );
                kinematics.joint_velocity(&q, &twist)
            }
        };
        self.limiter = (0..6)
            .map(|i| speed_max[i] / wanted[i].abs().max(speed_max[i]))
            .fold(1.0, f64::min);
        let command = wanted * self.limiter;
        self.done = match &self.plan {
            Plan::Hold { .. } => qd.amax() < STILL_RAD_PER_S,
            Plan::SpeedJ { .. } | Plan::SpeedL { .. } => (command - qd).amax() < STILL_RAD_PER_S,
            Plan::ServoJ { .. } => true,
            Plan::Joints {
                to, profile, time, ..
            } => *time >= profile.duration() && (to - q).amax() < 1e-4,
            Plan::Line {
                to, profile, time, ..
            } => {
                let (error, turn) = apart(&kinematics.pose(&q), to);
                let arrived = error.norm() < 1e-4 && turn.norm() < 1e-3;
                // A target out of reach is approached as far as possible.
                *time >= profile.duration() + 1.0 || (*time >= profile.duration() && arrived)
            }
        };
        if self.done && matches!(self.plan, Plan::Joints { .. } | Plan::Line { .. }) {
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

/// From one pose to another: translation and rotation vector, base axes.
fn apart(from: &[f64; 6], to: &[f64; 6]) -> (Vector3<f64>, Vector3<f64>) {
    let (from, to) = (isometry(from), isometry(to));
    (
        to.translation.vector - from.translation.vector,
        (to.rotation * from.rotation.inverse()).scaled_axis(),
    )
}

/// The pose a share of the way.
fn between(from: &[f64; 6], to: &[f64; 6], share: f64) -> [f64; 6] {
    let (linear, angular) = apart(from, to);
    let start = isometry(from);
    let turned = nalgebra::UnitQuaternion::from_scaled_axis(angular * share) * start.rotation;
    let p = start.translation.vector + linear * share;
    let r = turned.scaled_axis();
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// A share of the way, 0 to 1, over time: constant acceleration, constant speed, constant
/// deceleration.
#[derive(Clone, Copy, Debug)]
struct Trapezoid {
    /// 1/s²
    a: f64,
    /// s
    ramp: f64,
    /// s
    total: f64,
}

impl Trapezoid {
    fn new(distance: f64, v: f64, a: f64, t: f64) -> Self {
        if distance < 1e-9 {
            return Self {
                a: 0.0,
                ramp: 0.0,
                total: 0.0,
            };
        }
        let (v, a) = (v / distance, a / distance);
        if t > 0.0 {
            // A third up, a third down.
            let ramp = t / 3.0;
            return Self {
                a: 1.0 / (ramp * (t - ramp)),
                ramp,
                total: t,
            };
        }
        let ramp = (v / a).min((1.0 / a).sqrt());
        Self {
            a,
            ramp,
            total: ramp + 1.0 / (a * ramp),
        }
    }

    fn duration(&self) -> f64 {
        self.total
    }

    /// Share of the way and its rate, 1/s.
    fn at(&self, time: f64) -> (f64, f64) {
        if time >= self.total {
            (1.0, 0.0)
        } else if time < self.ramp {
            (0.5 * self.a * time * time, self.a * time)
        } else if time <= self.total - self.ramp {
            let v = self.a * self.ramp;
            (v * (time - 0.5 * self.ramp), v)
        } else {
            let left = self.total - time;
            (1.0 - 0.5 * self.a * left * left, self.a * left)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trapezoid_goes_all_the_way_within_its_bounds() {
        for (distance, v, a, t) in [
            (2.0, 1.0, 1.4, 0.0),
            (0.01, 1.0, 1.4, 0.0),
            (1.0, 0.0, 0.0, 2.0),
        ] {
            let p = Trapezoid::new(distance, v, a, t);
            let n = 1000;
            let dt = p.duration() / f64::from(n);
            let mut way = 0.0;
            for i in 0..n {
                let (_, rate) = p.at((f64::from(i) + 0.5) * dt);
                way += rate * dt;
                assert!(t > 0.0 || rate * distance <= v * (1.0 + 1e-9));
            }
            assert!((way - 1.0).abs() < 1e-3, "{way}");
            assert_eq!(p.at(p.duration()), (1.0, 0.0));
        }
        assert_eq!(Trapezoid::new(0.0, 1.0, 1.0, 0.0).duration(), 0.0);
    }
}
