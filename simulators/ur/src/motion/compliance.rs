//! Force mode and freedrive: along some axes of a task frame the tool moves with the force that
//! acts on it, along the others with the program's motion.
//!
//! Along a compliant axis the tool behaves as a mass with viscous damping, pulled by the force
//! missing to the wanted one: `m v' = g (w + f) - d v`, with the wanted force `w` of the tool on
//! its surroundings, the force `f` of these on the tool, and `m = d T`. In contact the force
//! settles at `f = -w`. The damping `d` keeps that stable on surfaces of up to about 10 kN/m (CB3)
//! or 30 kN/m (e-Series), whose arms follow after about 35 and 12 ms.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3, Vector6};
use tangent_urscript::pose::{SixPose, isometry};
use tangent_urscript::{Compliance, ForceModeTuning, TaskFrame};

/// Damping of the force mode, N s/m and Nm s/rad.
const DAMPING: [f64; 2] = [1000.0, 20.0];
/// Damping of a hand-guided arm, N s/m and Nm s/rad.
const GUIDED_DAMPING: [f64; 2] = [200.0, 5.0];
/// Ratio of mass and damping, s.
const TIME_CONSTANT_S: f64 = 0.02;

/// Settings of the force mode.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    damping: f64,
    gain: f64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self {
            damping: 0.005,
            gain: 1.0,
        }
    }
}

impl Tuning {
    /// Changes one of them.
    pub fn set(&mut self, tuning: ForceModeTuning) {
        match tuning {
            ForceModeTuning::Damping(damping) => self.damping = damping,
            ForceModeTuning::Gain(gain) => self.gain = gain,
        }
    }
}

/// An active force mode or freedrive.
#[derive(Debug)]
pub struct ForceControl {
    compliance: Compliance,
    base_from_task: UnitQuaternion<f64>,
    /// Speed along and about the compliant axes, task axes, m/s and rad/s.
    speed: Vector6<f64>,
}

impl ForceControl {
    /// Begins at rest.
    pub fn new(compliance: Compliance) -> Self {
        Self {
            compliance,
            base_from_task: UnitQuaternion::identity(),
            speed: Vector6::zeros(),
        }
    }

    /// Changes the wrench, the axes or the limits; the tool keeps its speed.
    pub fn with(self, compliance: Compliance) -> Self {
        Self { compliance, ..self }
    }

    /// Takes the pose of the tool centre point and its speed, base axes, which some task frames
    /// follow.
    pub fn look(&mut self, pose: &SixPose, speed: &SixPose) {
        let here = isometry(pose);
        self.base_from_task = match &self.compliance.frame {
            TaskFrame::Fixed(frame) => isometry(frame).rotation,
            TaskFrame::Tool => here.rotation,
            TaskFrame::TowardsOrigin(frame) => {
                let frame = isometry(frame);
                let towards = frame.translation.vector - here.translation.vector;
                with_y_along(&towards, &frame.rotation)
            }
            TaskFrame::AlongMotion(frame) => {
                let frame = isometry(frame).rotation;
                with_x_along(&Vector3::new(speed[0], speed[1], speed[2]), &frame)
            }
        };
    }

    /// The part of a twist along and about the other axes, base axes.
    pub fn along_others(&self, twist: &Vector6<f64>) -> Vector6<f64> {
        let mut part = self.to_task(twist);
        for (x, compliant) in part.iter_mut().zip(self.compliance.selection) {
            if compliant {
                *x = 0.0;
            }
        }
        self.to_base(&part)
    }

    /// Twist of the tool centre point, base axes, m/s and rad/s, given the twist that the program
    /// wants and the force on the tool centre point, base axes, N and Nm.
    pub fn step(
        &mut self,
        planned: &Vector6<f64>,
        force: &[f64; 6],
        tuning: &Tuning,
        dt: f64,
    ) -> Vector6<f64> {
        let force = self.to_task(&Vector6::from(*force));
        let mut twist = self.to_task(planned);
        let share = 1.0 - (-dt / TIME_CONSTANT_S).exp();
        for i in 0..6 {
            if !self.compliance.selection[i] {
                self.speed[i] = 0.0;
                continue;
            }
            let limit = self.compliance.speed_max[i];
            let missing = self.compliance.wrench[i] + force[i];
            let settled = if self.compliance.hand_guided {
                missing / GUIDED_DAMPING[i / 3]
            } else {
                tuning.gain * missing / (DAMPING[i / 3] * (1.0 + tuning.damping))
            };
            self.speed[i] += (settled.clamp(-limit, limit) - self.speed[i]) * share;
            twist[i] = self.speed[i];
        }
        self.to_base(&twist)
    }

    fn to_task(&self, v: &Vector6<f64>) -> Vector6<f64> {
        turned(&self.base_from_task.inverse(), v)
    }

    fn to_base(&self, v: &Vector6<f64>) -> Vector6<f64> {
        turned(&self.base_from_task, v)
    }
}

fn turned(rotation: &UnitQuaternion<f64>, v: &Vector6<f64>) -> Vector6<f64> {
    let first = rotation * Vector3::new(v[0], v[1], v[2]);
    let second = rotation * Vector3::new(v[3], v[4], v[5]);
    Vector6::new(first.x, first.y, first.z, second.x, second.y, second.z)
}

/// Axes with y along `y` and x in the xy plane of `frame`; those of `frame` if there are none.
fn with_y_along(y: &Vector3<f64>, frame: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let z = frame * Vector3::z();
    match (y.try_normalize(1e-6), y.cross(&z).try_normalize(1e-6)) {
        (Some(y), Some(x)) => axes(&x, &y),
        _ => *frame,
    }
}

/// Axes with x along the projection of `x` on the xy plane of `frame`; those of `frame` if it is
/// zero.
fn with_x_along(x: &Vector3<f64>, frame: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let z = frame * Vector3::z();
    match (x - z * x.dot(&z)).try_normalize(1e-3) {
        Some(x) => axes(&x, &z.cross(&x)),
        None => *frame,
    }
}

fn axes(x: &Vector3<f64>, y: &Vector3<f64>) -> UnitQuaternion<f64> {
    let columns = Matrix3::from_columns(&[*x, *y, x.cross(y)]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressing(frame: TaskFrame) -> ForceControl {
        ForceControl::new(Compliance {
            frame,
            selection: [false, false, true, false, false, false],
            wrench: [0.0, 0.0, -10.0, 0.0, 0.0, 0.0],
            speed_max: [0.005; 6],
            hand_guided: false,
        })
    }

    #[test]
    fn a_spring_is_pressed_with_the_wrench_and_the_other_axes_follow_the_program() {
        let mut control = pressing(TaskFrame::Fixed([0.0; 6]));
        let planned = Vector6::new(0.1, 0.0, 0.3, 0.0, 0.0, 0.0);
        let (mut depth, mut fastest) = (-0.01, 0.0_f64);
        let dt = 0.008;
        for _ in 0..2000 {
            let push = 5000.0 * f64::max(depth, 0.0);
            let force = [0.0, 0.0, push, 0.0, 0.0, 0.0];
            let twist = control.step(&planned, &force, &Tuning::default(), dt);
            assert!((twist[0] - 0.1).abs() < 1e-12);
            depth -= twist[2] * dt;
            fastest = fastest.max(twist[2].abs());
        }
        assert!(fastest <= 0.005 + 1e-12);
        assert!((5000.0 * depth - 10.0).abs() < 0.01, "{depth}");
    }

    #[test]
    fn task_frames_follow_the_tool() {
        let mut control = pressing(TaskFrame::TowardsOrigin([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        control.look(&[0.0; 6], &[0.0; 6]);
        let y = control.base_from_task * Vector3::y();
        assert!((y - Vector3::x()).norm() < 1e-12);
        let mut control = pressing(TaskFrame::AlongMotion([0.0; 6]));
        control.look(&[0.0; 6], &[0.0, -0.2, 0.1, 0.0, 0.0, 0.0]);
        let x = control.base_from_task * Vector3::x();
        assert!((x + Vector3::y()).norm() < 1e-12);
    }
}
