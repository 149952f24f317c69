//! The simulated robot controller: modes, motions, reflexes and its own position hold, one
//! millisecond per step, without sockets and clock.
//!
//! The server passes requests and answers to it as they arrive, sends the
//! [`FciRobot::state`] of every cycle and calls [`FciRobot::step`].

mod state;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix4, SMatrix, UnitQuaternion, Vector6};
use tangent_franka::fci::{
    Command, ConnectStatus, ErrorFlags, LOST_MAX, MoveController, MoveGenerator, MoveStatus,
    PERIOD_S, RecoveryStatus, Reply, ReplyBody, Request, RobotCommand, RobotMode, SetterStatus,
    StopStatus, VERSION,
};
use tangent_mechanics::{Arm, Flange, Joints, ModelData, ModelError, Pose, Tool};

use crate::config::FciConfig;
use crate::plant::TorquePlant;
use crate::protection::{Felt, commanded, moving, wrench_of};
use crate::settings::{RobotSettings, column_major, matrix};

/// Bandwidth, rad/s, and damping ratio of the robot's own position control in a motion. It acts on
/// accelerations, so they are equal for all joints.
const TRACK_RAD_PER_S: f64 = 60.0;
/// Bandwidth of the robot's hold outside of motions, rad/s. With a higher one, the limited rate of
/// the motor torques makes an arm that was pushed oscillate with growing amplitude.
const HOLD_RAD_PER_S: f64 = 30.0;
const HOLD_DAMPING: f64 = 1.0;
/// Time constant with which the motion and its torques fade into the hold, s, so that neither
/// jumps.
const HOLD_FADE_S: f64 = 0.05;
/// Damping while the arm is guided by hand, 1/s.
const GUIDING_DAMPING_PER_S: f64 = 5.0;

#[derive(Clone, Copy, Debug)]
struct Motion {
    id: u32,
    controller: MoveController,
    generator: MoveGenerator,
    age_cycles: u32,
}

/// The simulated robot controller, with the arm that it moves.
pub struct FciRobot {
    plant: Box<dyn TorquePlant>,
    model: Arm<7>,
    loaded: Arm<7>,
    start_cycles: u32,
    recovery_cycles: u64,
    message_id: u64,
    motion: Option<Motion>,
    user_stop: bool,
    guiding: bool,
    recovering: Option<(u32, u64)>,
    errors: ErrorFlags,
    reflex_reason: ErrorFlags,
    tau_d: Joints<7>,
    q_d: Joints<7>,
    dq_d: Joints<7>,
    /// Remaining part of the torques before the hold, Nm.
    fading: Joints<7>,
    tau_motor: Joints<7>,
    tau_motor_rate: Joints<7>,
    lost_in_row: u32,
    /// The last answers, one bit each, the newest in the lowest bit: 1 if it arrived in time.
    answered: u128,
    settings: RobotSettings,
    felt: Felt,
    wrench_o: Vector6<f64>,
    wrench_k: Vector6<f64>,
    replies: Vec<Reply>,
}

impl FciRobot {
    /// A robot at rest, idle, without a client.
    ///
    /// # Errors
    /// The built-in model is not valid.
    pub fn new(config: &FciConfig, plant: Box<dyn TorquePlant>) -> Result<Self, ModelError> {
        let model = Arm::<7>::new(&ModelData::builtin("panda")?)?;
        let q = plant.reading().q;
        let settings = RobotSettings::with_load(&plant.declared_load());
        let loaded = model.with_payload(&settings.payload());
        Ok(Self {
            loaded,
            model,
            plant,
            start_cycles: config.start_cycles,
            recovery_cycles: (config.recovery_s / PERIOD_S).max(1.0) as u64,
            message_id: 1,
            motion: None,
            user_stop: false,
            guiding: false,
            recovering: None,
            errors: ErrorFlags::default(),
            reflex_reason: ErrorFlags::default(),
            tau_d: Joints::zeros(),
            q_d: q,
            dq_d: Joints::zeros(),
            fading: Joints::zeros(),
            tau_motor: loaded.gravity(&q),
            tau_motor_rate: Joints::zeros(),
            lost_in_row: 0,
            answered: 0,
            settings,
            felt: Felt::default(),
            wrench_o: Vector6::zeros(),
            wrench_k: Vector6::zeros(),
            replies: Vec::new(),
        })
    }

    /// Current mode of the robot.
    pub fn mode(&self) -> RobotMode {
        if self.user_stop {
            RobotMode::UserStopped
        } else if self.recovering.is_some() {
            RobotMode::AutomaticErrorRecovery
        } else if !self.errors.is_empty() {
            RobotMode::Reflex
        } else if self.moving().is_some() {
            RobotMode::Move
        } else if self.guiding {
            RobotMode::Guiding
        } else {
            RobotMode::Idle
        }
    }

    /// Whether the state shows a motion, so that each state must be answered.
    pub fn wants_answer(&self) -> bool {
        self.moving().is_some()
    }

    /// Whether the state is the first that shows a motion. libfranka answers from the second one
    /// on.
    pub fn begins_motion(&self) -> bool {
        self.moving()
            .is_some_and(|motion| motion.age_cycles == self.start_cycles + 1)
    }

    /// The simulated arm and its environment.
    pub fn plant(&self) -> &dyn TorquePlant {
        &*self.plant
    }

    /// Replies since the last call, in order.
    pub fn take_replies(&mut self) -> Vec<Reply> {
        std::mem::take(&mut self.replies)
    }

    /// Ends the motion of a client that has disconnected, and holds the arm.
    pub fn disconnect(&mut self) {
        if self.motion.take().is_some() {
            self.hold_here();
        }
        self.replies.clear();
    }

    /// Presses or releases the user stop.
    pub fn set_user_stop(&mut self, pressed: bool) {
        self.user_stop = pressed;
        if pressed {
            self.end_motion(MoveStatus::EmergencyAborted);
        }
    }

    /// Begins or ends guiding by hand; not possible during a motion.
    pub fn set_guiding(&mut self, guiding: bool) {
        self.guiding = guiding && self.motion.is_none();
        self.hold_here();
    }

    /// Applies an external force to the tool, N, base axes.
    pub fn push(&mut self, force_n: [f64; 3]) {
        self.plant.push(force_n);
    }

    /// Handles a request of the client.
    pub fn request(&mut self, id: u32, request: &Request) {
        let command = request.command();
        let body = match request {
            Request::Connect { version, .. } => Some(ReplyBody::Connect(
                if *version == VERSION {
                    ConnectStatus::Success
                } else {
                    ConnectStatus::IncompatibleVersion
                },
                VERSION,
            )),
            Request::Move {
                controller,
                generator,
                ..
            } => Some(ReplyBody::Move(self.start(id, *controller, *generator))),
            Request::StopMove => Some(ReplyBody::Stop(self.stop())),
            Request::AutomaticErrorRecovery => self.recover(id).map(ReplyBody::Recovery),
            Request::GetCartesianLimit(_) => Some(ReplyBody::Wall(
                SetterStatus::Success,
                [0.0; 3],
                column_major(&Matrix4::identity()),
                false,
            )),
            // The model library is the vendor's code; there is none here.
            Request::LoadModelLibrary(..) => Some(ReplyBody::Model(false)),
            setter => Some(ReplyBody::Setter(self.set(setter))),
        };
        if let Some(body) = body {
            self.replies.push(Reply { command, id, body });
        }
    }

    /// Runs one cycle with the answer to its state, if there is one.
    pub fn step(&mut self, answer: Option<&RobotCommand>) {
        let gravity = self.loaded.gravity(&self.plant.reading().q);
        if let Some(motion) = &mut self.motion {
            motion.age_cycles = motion.age_cycles.saturating_add(1);
            if motion.age_cycles > self.start_cycles + 1 {
                let motion = *motion;
                let answer = answer.filter(|answer| answer.message_id == self.message_id);
                self.answered = self.answered << 1 | u128::from(answer.is_some());
                match answer {
                    Some(answer) => self.obey(&motion, answer, &gravity),
                    None => {
                        self.lost_in_row += 1;
                        if self.lost_in_row >= LOST_MAX {
                            self.reflex(ErrorFlags::COMMUNICATION_CONSTRAINTS);
                        }
                    }
                }
            }
        }
        self.advance_recovery();
        let torque = self.torque() + gravity;
        self.tau_motor_rate = (torque - self.tau_motor) / PERIOD_S;
        self.tau_motor = torque;
        self.plant.step(&torque);
        self.feel();
        self.message_id += 1;
    }

    /// The motion, once the state shows it.
    fn moving(&self) -> Option<&Motion> {
        self.motion
            .as_ref()
            .filter(|motion| motion.age_cycles > self.start_cycles)
    }

    fn start(
        &mut self,
        id: u32,
        controller: MoveController,
        generator: MoveGenerator,
    ) -> MoveStatus {
        if self.mode() != RobotMode::Idle || self.motion.is_some() {
            return MoveStatus::NotPossible;
        }
        let joints = matches!(
            generator,
            MoveGenerator::JointPosition | MoveGenerator::JointVelocity
        );
        // The robot's own Cartesian motions need the vendor's planning, which is not simulated.
        if controller != MoveController::External && !joints {
            return MoveStatus::InvalidArgument;
        }
        self.reflex_reason = ErrorFlags::default();
        self.motion = Some(Motion {
            id,
            controller,
            generator,
            age_cycles: 0,
        });
        self.tau_d = Joints::zeros();
        self.lost_in_row = 0;
        self.answered = u128::MAX;
        MoveStatus::MotionStarted
    }

    fn stop(&mut self) -> StopStatus {
        if self.user_stop {
            return StopStatus::EmergencyAborted;
        }
        if self.motion.is_none() {
            return StopStatus::NotPossible;
        }
        self.end_motion(MoveStatus::Preempted);
        StopStatus::Success
    }

    fn recover(&mut self, id: u32) -> Option<RecoveryStatus> {
        if self.user_stop || self.motion.is_some() || self.recovering.is_some() {
            return Some(RecoveryStatus::NotPossible);
        }
        if self.errors.0[ErrorFlags::JOINT_POSITION_LIMITS] {
            return Some(RecoveryStatus::ManualRecoveryRequired);
        }
        if self.errors.is_empty() {
            return Some(RecoveryStatus::Success);
        }
        self.recovering = Some((id, self.recovery_cycles));
        None
    }

    fn advance_recovery(&mut self) {
        let Some((id, cycles)) = self.recovering else {
            return;
        };
        let status = if self.user_stop {
            RecoveryStatus::EmergencyAborted
        } else if cycles == 0 {
            self.errors = ErrorFlags::default();
            self.hold_here();
            RecoveryStatus::Success
        } else {
            self.recovering = Some((id, cycles - 1));
            return;
        };
        self.recovering = None;
        self.replies.push(Reply {
            command: Command::AutomaticErrorRecovery,
            id,
            body: ReplyBody::Recovery(status),
        });
    }

    fn set(&mut self, request: &Request) -> SetterStatus {
        if self.motion.is_some() {
            return SetterStatus::NotPossible;
        }
        if !self.settings.set(request) {
            return SetterStatus::InvalidArgument;
        }
        self.loaded = self.model.with_payload(&self.settings.payload());
        SetterStatus::Success
    }

    fn obey(&mut self, motion: &Motion, answer: &RobotCommand, gravity: &Joints<7>) {
        self.lost_in_row = 0;
        if !answer.is_finite() {
            self.end_motion(MoveStatus::InputErrorAborted);
            return;
        }
        if motion.controller == MoveController::External {
            let torque = Joints::from(answer.tau_j_d);
            if let Some(error) = commanded(&torque, &self.tau_d, gravity, self.model.limits()) {
                self.reflex(error);
                return;
            }
            self.tau_d = torque;
        }
        // A client that computes the torques may have its motion generated, too.
        let q_d = match motion.generator {
            MoveGenerator::JointPosition => Some(Joints::from(answer.q_c)),
            MoveGenerator::JointVelocity => Some(self.q_d + Joints::from(answer.dq_c) * PERIOD_S),
            MoveGenerator::CartesianPosition | MoveGenerator::CartesianVelocity => None,
        };
        if let Some(q_d) = q_d {
            let dq_d = (q_d - self.q_d) / PERIOD_S;
            let limits = self.model.limits();
            if (0..7).any(|i| dq_d[i].abs() > limits.velocity[i]) {
                // joint_motion_generator_velocity_limits_violation
                self.reflex(13);
                return;
            }
            (self.q_d, self.dq_d) = (q_d, dq_d);
        }
        if answer.motion_finished {
            self.end_motion(MoveStatus::Success);
        }
    }

    /// Torque besides gravity compensation, Nm.
    fn torque(&mut self) -> Joints<7> {
        let reading = self.plant.reading();
        let external = |m: &Motion| m.controller == MoveController::External;
        if self.moving().is_some_and(external) {
            return self.tau_d;
        }
        let motors = SMatrix::from_diagonal(&self.plant.motor_inertia());
        let mass = self.loaded.mass_matrix(&reading.q) + motors;
        if self.guiding && self.motion.is_none() && self.errors.is_empty() && !self.user_stop {
            self.hold_here();
            return mass * (reading.qd * -GUIDING_DAMPING_PER_S);
        }
        let holds = self.moving().is_none();
        let bandwidth = if holds {
            HOLD_RAD_PER_S
        } else {
            TRACK_RAD_PER_S
        };
        let pull = (self.q_d - reading.q) * bandwidth.powi(2);
        let brake = (self.dq_d - reading.qd) * (2.0 * HOLD_DAMPING * bandwidth);
        let torque = mass * (pull + brake) + self.fading;
        let share = PERIOD_S / HOLD_FADE_S;
        self.fading *= 1.0 - share;
        if holds {
            self.q_d += self.dq_d * PERIOD_S;
            self.dq_d *= 1.0 - share;
        }
        match self.model.limits().effort {
            Some(effort) => Joints::from_fn(|i, _| torque[i].clamp(-effort[i], effort[i])),
            None => torque,
        }
    }

    /// Computes the external wrench after the step, and ends the motion if a limit is exceeded.
    fn feel(&mut self) {
        let reading = self.plant.reading();
        let flange_from_k = matrix(&self.settings.ne_t_ee) * matrix(&self.settings.ee_t_k);
        let rotation = flange_from_k.fixed_view::<3, 3>(0, 0).into_owned();
        let turn = UnitQuaternion::from_matrix(&rotation);
        let k =
            Pose::<Flange, Tool>::new(flange_from_k.fixed_view::<3, 1>(0, 3).into_owned(), turn);
        let (base_from_k, jacobian) = self.model.tool_and_jacobian(&reading.q, &k);
        self.wrench_o = wrench_of(&jacobian, &reading.external);
        let force = base_from_k.unrotate(&self.wrench_o.fixed_rows::<3>(0).into_owned());
        let moment = base_from_k.unrotate(&self.wrench_o.fixed_rows::<3>(3).into_owned());
        self.wrench_k.fixed_rows_mut::<3>(0).copy_from(&force);
        self.wrench_k.fixed_rows_mut::<3>(3).copy_from(&moment);
        self.felt = Felt::new(&self.settings.behavior, &reading.external, &self.wrench_o);
        if self.moving().is_some() {
            let error = self
                .felt
                .error()
                .or_else(|| moving(&reading, self.model.limits()));
            if let Some(error) = error {
                self.reflex(error);
            }
        }
    }

    fn reflex(&mut self, error: usize) {
        self.errors = ErrorFlags::only(error);
        self.reflex_reason = self.errors;
        self.end_motion(MoveStatus::ReflexAborted);
    }

    fn end_motion(&mut self, status: MoveStatus) {
        if let Some(motion) = self.motion.take() {
            self.replies.push(Reply {
                command: Command::Move,
                id: motion.id,
                body: ReplyBody::Move(status),
            });
        }
        self.hold_here();
    }

    fn hold_here(&mut self) {
        let reading = self.plant.reading();
        self.fading = self.tau_motor - self.loaded.gravity(&reading.q);
        (self.q_d, self.dq_d) = (reading.q, reading.qd);
        self.tau_d = Joints::zeros();
        self.lost_in_row = 0;
    }
}
