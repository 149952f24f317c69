//! One run of a program: the state that is reset with every task, and the phase machine's
//! decisions.
//!
//! Called by the controller each cycle: `perceive` first, then `decide`; `controller` turns the
//! outcome into motion.

use nalgebra::Vector3;

use super::acting_point::ActingPoint;
use super::config::ControllerConfig;
use super::force_law::ForceLaw;
use super::hops::Hops;
use super::interface::ControlInput;
use super::joint_way::JointWay;
use super::ledge::Ledge;
use super::losses::{Felt, Losses, Touch};
use super::pace::Exploration;
use super::percept::Percept;
use super::route::Lifting;
use super::side_load::SideLoad;
use super::surface::Surface;
use super::touchdown::{seek_speed, stiffness_of_touch};
use super::tracking::Tracking;
use super::zero_doubt::ZeroDoubt;
use crate::estimator_choice::EstimatorChoice;
use crate::leaving::clearance::Clearance;
use crate::leaving::leave_watch::{LeaveWatch, Leaving};
use crate::leaving::yielding::Yielding;
use crate::limits::arm_force::ArmForceGuard;
use crate::limits::faults::Fault;
use crate::limits::response_guard::ResponseGuard;
use crate::limits::turn_guard::TurnGuard;
use crate::limits::wrench_guard::WrenchGuard;
use crate::phase_machine::Phase;
use crate::task::program::Program;

/// Why the tool stands on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HoldReason {
    Paused,
    PathEnd,
    NoEstimate,
    /// The motion of the base is not known.
    NoBase,
    /// Not even the force is controlled: nothing moves. Returns to the interrupted phase when the
    /// wrench is valid again.
    NoWrench(Phase),
}

/// One run of a program.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    pub phase: Phase,
    pub hold: HoldReason,
    pub fault: Option<Fault>,
    pub choice: EstimatorChoice,
    pub surface: Surface,
    pub tracking: Tracking,
    pub lift: Lifting,
    pub force: ForceLaw,
    pub exploration: Exploration,
    /// Where the force acts on the tool in this contact.
    pub acting: ActingPoint,
    pub side: SideLoad,
    /// Whether something along the surface stands in the way, or pushes.
    pub gives_way: bool,
    /// Whether a load along the surface slows the path.
    pub brakes: bool,
    /// Whether earlier passes have shown the surface: the normal does not wander.
    pub knows_surface: bool,
    pub ledge: Ledge,
    pub in_contact: bool,
    pub lost_count: u32,
    pub losses: Losses,
    pub hops: Hops,
    pub felt: Felt,
    pub touch: Touch,
    pub approach: Vector3<f64>,
    /// Direction away from the surface that replaces the last good normal.
    pub way_off: Option<Vector3<f64>>,
    pub retract: Vector3<f64>,
    pub guard: WrenchGuard,
    pub response: ResponseGuard,
    pub turn: TurnGuard,
    pub arm_force: ArmForceGuard,
    /// Whether the arm feels a force that the sensor does not show.
    pub is_unread: bool,
    pub begun: bool,
    pub touched: bool,
    pub estimated: bool,
    pub in_phase_s: f64,
    pub elapsed_s: f64,
    pub settled_s: f64,
    /// Mean force that the sensor shows above the surface, N, during a lift and the way down after
    /// it.
    pub above_n: f64,
    /// Time for which the force has been too low for contact, s.
    pub low_s: f64,
    /// Time for which the path has waited for the arm, s.
    pub stalled_s: f64,
    /// Time without a usable normal while pressing, s; an intermittent wrench does not reset it.
    pub blind_s: f64,
    /// Time for which the motion of the base has been unknown, s.
    pub adrift_s: f64,
    /// Reason, time and start position of the phase that a missing wrench interrupted.
    pub interrupted: (HoldReason, f64, Vector3<f64>),
    pub phase_start: Vector3<f64>,
    /// Whether a person paused the task: nothing moves except to keep the force.
    pub paused: bool,
    /// Part of `in_phase_s` that was spent paused, s.
    pub paused_s: f64,
    /// Whether a retraction has covered its distance since the last touch.
    pub off: bool,
    /// Whether the phase begins at the tool's position in the next cycle.
    pub starts_here: bool,
    /// Whether the tool may touch something, base axes: persists after the run.
    pub clearance: Clearance,
    pub leave: LeaveWatch,
    pub left: Leaving,
    /// How the tool gives way to what it has met on its way off.
    pub yielding: Option<Yielding>,
    /// Position of the tool when the zero in force was taken, m; `None` once contact was detected
    /// after it.
    pub tared_at: Option<Vector3<f64>>,
    /// Whether phase `seek` follows a loss, and not a lift or a new zero.
    pub seeks_lost: bool,
    /// Whether the tool has lifted off for a new zero in this run.
    pub renewed: bool,
    /// Whether the zero may have jumped.
    pub zero_doubt: ZeroDoubt,
    /// Whether the zero in force turned out to have been taken in contact.
    pub zero_withdrawn: bool,
    /// The way in joint space to the start pose, or home.
    pub travel: JointWay,
}

impl Run {
    /// State before the first `perceive` of an active phase.
    pub fn idle() -> Self {
        Self {
            phase: Phase::Idle,
            hold: HoldReason::Paused,
            fault: None,
            choice: EstimatorChoice::default(),
            surface: Surface::new(Vector3::z()),
            tracking: Tracking::new(Vector3::z(), Vector3::x(), Vector3::zeros()),
            lift: Lifting::idle(),
            force: ForceLaw::new(1e4),
            exploration: Exploration::default(),
            acting: ActingPoint::default(),
            side: SideLoad::default(),
            gives_way: false,
            brakes: false,
            knows_surface: false,
            ledge: Ledge::default(),
            in_contact: false,
            lost_count: 0,
            losses: Losses::default(),
            hops: Hops::default(),
            felt: Felt::default(),
            touch: Touch::default(),
            approach: -Vector3::z(),
            way_off: None,
            retract: Vector3::z(),
            guard: WrenchGuard::default(),
            response: ResponseGuard::default(),
            turn: TurnGuard::default(),
            arm_force: ArmForceGuard::default(),
            is_unread: false,
            begun: false,
            touched: false,
            estimated: false,
            in_phase_s: 0.0,
            elapsed_s: 0.0,
            settled_s: 0.0,
            above_n: 0.0,
            low_s: 0.0,
            stalled_s: 0.0,
            blind_s: 0.0,
            adrift_s: 0.0,
            interrupted: (HoldReason::Paused, 0.0, Vector3::zeros()),
            phase_start: Vector3::zeros(),
            paused: false,
            paused_s: 0.0,
            off: false,
            starts_here: false,
            clearance: Clearance::Assumed,
            leave: LeaveWatch::default(),
            left: Leaving::Going,
            yielding: None,
            tared_at: None,
            seeks_lost: false,
            renewed: false,
            zero_doubt: ZeroDoubt::default(),
            zero_withdrawn: false,
            travel: JointWay::default(),
        }
    }

    /// Ready for the first cycle of `program`. Unless the tool is known to be free, it first moves
    /// off the surface.
    pub fn start(program: &Program, clearance: Clearance) -> Self {
        Self {
            phase: if !clearance.is_free() {
                Phase::Clear
            } else {
                program.first_phase()
            },
            clearance,
            ..Self::idle()
        }
    }

    pub(super) fn begin<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        input: &ControlInput<N>,
    ) {
        let pose = &input.base_from_tool;
        let task = &program.task;
        self.begun = true;
        self.approach = task.approach.direction.in_base(pose);
        self.retract = match self.clearance {
            Clearance::Possible { normal, .. } => normal,
            Clearance::Assumed | Clearance::Free | Clearance::Unknown => -self.approach,
        };
        self.tracking = Tracking::new(
            -self.approach,
            task.plane.x_axis.in_base(pose),
            pose.translation(),
        )
        .drawn_over_plane(task.path.expected_surface().is_some());
        self.surface = Surface::new(-pose.z_axis());
        self.force = ForceLaw::new(stiffness_of_touch(program, config));
        self.phase_start = pose.translation();
    }

    /// Whether not even the force is controlled now.
    pub fn stands_without_wrench(&self) -> bool {
        self.phase == Phase::Hold && matches!(self.hold, HoldReason::NoWrench(_))
    }

    /// Leaves the surface along the last good normal; ends at once if nothing has moved yet.
    pub(crate) fn leave(&mut self, percept: &Percept, fault: Option<Fault>) {
        self.fault = fault.or(self.fault);
        let untouched = matches!(self.phase, Phase::Tare | Phase::Clear) && !self.touched;
        if untouched || self.phase == Phase::Travel {
            let phase = if self.fault.is_some() {
                Phase::Fault
            } else {
                Phase::Done
            };
            return self.enter(phase, percept);
        }
        self.retract = self.way_off();
        self.gives_way |= matches!(fault, Some(Fault::ForceLimit(_)));
        self.enter(Phase::Retract, percept);
    }

    /// Direction away from the surface: the last good normal, or against the approach. A force that
    /// misled the normal has not misled the way that the tool came.
    pub(crate) fn way_off(&self) -> Vector3<f64> {
        if let Some(way) = self.way_off {
            way
        } else if self.touched && self.response.is_misdirected() {
            self.turn.way_off(&self.approach)
        } else if self.touched {
            self.surface.normal
        } else {
            -self.approach
        }
    }

    /// Speed towards a lost surface with the tool at `position` (m), m/s: slower where contact was
    /// lost again and again, but not beside it.
    pub(super) fn seek_speed(
        &self,
        config: &ControllerConfig,
        reference_n: f64,
        position: &Vector3<f64>,
    ) -> f64 {
        let stiffness = self.force.stiffness_n_per_m();
        let speed = seek_speed(config, reference_n, stiffness);
        if self.hops.is_under_way() {
            return speed * self.hops.speed_share();
        }
        speed * self.losses.speed_share(position)
    }

    /// Whether contact was detected in this run.
    pub(crate) fn has_touched(&self) -> bool {
        self.touched
    }

    /// Time in the phase, s, without pauses.
    pub(crate) fn time_in_phase_s(&self) -> f64 {
        self.in_phase_s - self.paused_s
    }

    pub(crate) fn enter(&mut self, phase: Phase, percept: &Percept) {
        self.phase = phase;
        self.in_phase_s = 0.0;
        self.paused_s = 0.0;
        self.phase_start = percept.position;
        self.leave = LeaveWatch::default();
        self.left = Leaving::Going;
        self.yielding = None;
        if phase == Phase::Seek {
            self.low_s = 0.0;
        }
    }

    /// Whether the task has ended with the tool possibly still on the surface.
    pub fn is_left_on_surface(&self) -> bool {
        !self.phase.is_active() && self.touched && !self.off && !self.clearance.is_free()
    }

    /// Retracts a tool that the end of the task left on the surface, along the last good normal, as
    /// at the end of any task.
    pub fn leave_again(&mut self) {
        self.retract = self.surface.normal;
        self.phase = Phase::Retract;
        self.in_phase_s = 0.0;
        self.paused_s = 0.0;
        self.starts_here = true;
        self.leave = LeaveWatch::default();
        self.left = Leaving::Going;
        self.yielding = None;
    }

    /// Ends at once, without a motion: the arm cannot be moved.
    pub fn abort(&mut self, fault: Fault) {
        self.phase = Phase::Fault;
        self.fault = Some(fault);
    }
}
