//! Checks a task against the cell before anything moves: its force and speeds against the limits,
//! its start pose and its whole path against the workspace and the arm's reach, on the expected
//! surface if the task has one, else on a plane. Each refusal states
//! the number, the limit and the place.
//!
//! Called by the controller service before a task is started, and by `tangent up` and `tangent
//! check`. Allocates; not for the robot's cycle.

mod refusal;
mod travel;

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use tangent_mechanics::{
    Arm, Base, Flange, InverseKinematics, InverseKinematicsError, Joints, Pose, Tool,
    smallest_singular_value,
};

use crate::contact::alignment::plane_axes;
use crate::limits::Limits;
use crate::task::path::{Path, PathPlace};
use crate::task::{Task, normal_of};

pub use refusal::{Edge, Place, REFUSED, Refusal, words};

/// Distance between the places of the path that are checked, m.
const SPACING_M: f64 = 0.005;
/// Possible depths of the surface, as shares of the approach: the plane of the path is known only
/// after touchdown.
const DEPTHS: [f64; 3] = [0.0, 0.5, 1.0];
/// Threshold below which a path cannot be followed, as a share of the singular value at which
/// damping begins: below it, damping takes more than half of the commanded velocity.
const FLOOR_SHARE: f64 = 0.5;
/// Number of attempts of a redundant arm to reach a place that is not reached from the nearest
/// posture.
const REDUNDANT_STARTS: usize = 24;
/// Tolerance of the tool pose at a place of the path, m and rad.
const TOLERANCE: (f64, f64) = (1e-4, 1e-3);

/// A task and the cell that is to run it.
#[derive(Clone, Copy, Debug)]
pub struct Preflight<'a, const N: usize> {
    /// The task.
    pub task: &'a Task,
    /// Its path, as the law runs it.
    pub path: &'a Path,
    /// Limits of the cell.
    pub limits: &'a Limits,
    /// The arm.
    pub arm: &'a Arm<N>,
    /// Pose of the tool on the flange.
    pub flange_from_tool: &'a Pose<Flange, Tool>,
    /// Whether the law moves the arm to the task's start pose.
    pub travels: bool,
}

impl<const N: usize> Preflight<'_, N> {
    /// Why the task cannot run from joint positions `start` (rad): all reasons found; empty if it
    /// can. Without a start pose, only checks that do not depend on it are made.
    ///
    /// The surface is not known yet. The path's plane is assumed perpendicular to the approach, at
    /// the start, half way along the approach, or at its end; a path is refused if it fits at none
    /// of the three.
    pub fn refusals(&self, start: Option<&Joints<N>>) -> Vec<Refusal> {
        let mut found = self.numbers();
        let travel = self.travel(start);
        found.extend(travel.refusals);
        if let Some(q) = travel.start.as_ref().or(start) {
            found.extend(self.places(q));
        }
        found
    }

    /// Checks the task's numbers against the cell's limits.
    fn numbers(&self) -> Vec<Refusal> {
        let (task, limits) = (self.task, self.limits);
        let mut found = Vec::new();
        let strokes_n = self.path.force_max_n();
        for (key, force_n) in [
            ("force.reference_n", Some(task.force.reference_n)),
            ("path.strokes.force_n", strokes_n),
        ] {
            if let Some(reference_n) = force_n.filter(|n| *n >= limits.force_max_n) {
                found.push(Refusal::Force {
                    key,
                    reference_n,
                    limit_n: limits.force_max_n,
                });
            }
        }
        let speeds = [
            ("path.speed_m_per_s", task.path.speed_m_per_s()),
            ("approach.speed_m_per_s", task.approach.speed_m_per_s),
            ("end.retract_speed_m_per_s", task.end.retract_speed_m_per_s),
        ];
        let travel = (self.path.lifts() > 0)
            .then(|| ("path.travel_speed_m_per_s", self.path.rise().speed_m_per_s));
        for (key, speed_m_per_s) in speeds.into_iter().chain(travel) {
            if speed_m_per_s > limits.speed_max_m_per_s {
                found.push(Refusal::Speed {
                    key,
                    speed_m_per_s,
                    limit_m_per_s: limits.speed_max_m_per_s,
                });
            }
        }
        found
    }

    fn places(&self, q: &Joints<N>) -> Vec<Refusal> {
        let start = self.arm.base_from_flange(q) * *self.flange_from_tool;
        let position = start.translation();
        if !position.iter().all(|x| x.is_finite()) {
            // The arm's state is invalid; that is refused elsewhere, with the reason.
            return Vec::new();
        }
        if let Some(edge) = Edge::crossed(self.limits, &position) {
            return vec![Refusal::StartOutside {
                in_base_m: position.into(),
                edge,
            }];
        }
        let approach = self.task.approach.direction.in_base(&start);
        let angle_rad = approach.angle(&start.z_axis());
        if angle_rad > std::f64::consts::FRAC_PI_2 {
            return vec![Refusal::ApproachBackwards { angle_rad }];
        }
        let places = self.path.places(SPACING_M);
        let mut furthest: Option<Failed> = None;
        for share in DEPTHS {
            let depth_m = share * self.task.approach.distance_max_m;
            let Some(failed) = self.run(&places, &start, &approach, depth_m, q) else {
                return Vec::new();
            };
            if furthest.as_ref().is_none_or(|f| failed.way_m > f.way_m) {
                furthest = Some(failed);
            }
        }
        furthest.map_or_else(Vec::new, |failed| failed.refusals)
    }

    /// Checks the whole path on the plane met after `depth_m` of approach, m; `None` if every place
    /// can be reached.
    fn run(
        &self,
        places: &[PathPlace],
        start: &Pose<Base, Tool>,
        approach: &Vector3<f64>,
        depth_m: f64,
        q: &Joints<N>,
    ) -> Option<Failed> {
        let normal = -approach;
        let (x, y) = plane_axes(&normal, &self.task.plane.x_axis.in_base(start));
        let origin = start.translation() + approach * depth_m;
        let square = UnitQuaternion::rotation_between(&start.z_axis(), approach)
            .map_or(start.rotation(), |turn| turn * start.rotation());
        let mut failed = Failed::default();
        let mut q = *q;
        for place in places {
            let mut position = origin + x * place.position.x + y * place.position.y;
            let mut square = square;
            if let Some(surface) = self.task.path.expected_surface() {
                let start_m = surface.height_m(&Vector2::zeros());
                position += normal * (surface.height_m(&place.position) - start_m);
                let n = normal_of(&surface.slope(&place.position));
                let expected = x * n.x + y * n.y + normal * n.z;
                let turn = UnitQuaternion::rotation_between(&normal, &expected);
                square = turn.unwrap_or_default() * square;
            }
            let at = Place {
                way_m: place.way_m,
                on_path_m: place.position.into(),
                in_base_m: position.into(),
            };
            if let Some(edge) = Edge::crossed(self.limits, &position) {
                failed.push(Refusal::Outside { at, edge });
            }
            match self.posture(&Pose::new(position, square), &q) {
                Ok(reached) => q = reached,
                Err(left_m) => {
                    failed.push(Refusal::OutOfReach { at, left_m });
                    // There is no posture from which to continue.
                    break;
                }
            }
            if let Some(refusal) = self.posture_refusal(&q, at) {
                failed.push(refusal);
            }
        }
        (!failed.refusals.is_empty()).then_some(failed)
    }

    /// Joint positions for a tool pose, starting from those of the previous place: the arm follows
    /// the path without changing its posture. Otherwise the remaining distance of the tool, m.
    fn posture(&self, target: &Pose<Base, Tool>, before: &Joints<N>) -> Result<Joints<N>, f64> {
        let search = |starts_max| InverseKinematics {
            position_tolerance_m: TOLERANCE.0,
            angle_tolerance_rad: TOLERANCE.1,
            starts_max,
            ..InverseKinematics::default()
        };
        let solve = |starts| {
            search(starts)
                .solve(self.arm, self.flange_from_tool, target, before)
                .map_err(|error| match error {
                    InverseKinematicsError::Unreachable {
                        position_error_m, ..
                    } => position_error_m,
                    InverseKinematicsError::NotFinite => f64::INFINITY,
                })
        };
        let near = solve(1);
        if near.is_err() && N > 6 {
            return solve(REDUNDANT_STARTS);
        }
        near
    }

    /// Refuses a joint within the margin before its end stop, or an arm near a singularity.
    fn posture_refusal(&self, q: &Joints<N>, at: Place) -> Option<Refusal> {
        let bounds = self.arm.limits();
        let margin = self.limits.joint_margin_rad;
        for i in 0..N {
            let (lower, upper) = (
                bounds.position_lower[i] + margin,
                bounds.position_upper[i] - margin,
            );
            if N == 6 && !(lower..=upper).contains(&q[i]) {
                return Some(Refusal::EndStop {
                    at,
                    joint: i + 1,
                    angle_rad: q[i],
                    limit_rad: if q[i] < lower { lower } else { upper },
                });
            }
        }
        let smallest = smallest_singular_value(&self.arm.jacobian_at(q, self.flange_from_tool));
        let floor = FLOOR_SHARE * self.limits.singularity.threshold;
        (smallest < floor).then_some(Refusal::Singular {
            at,
            smallest,
            floor,
        })
    }
}

/// First refusal of each kind along one run of the path.
#[derive(Default)]
struct Failed {
    refusals: Vec<Refusal>,
    /// Distance of the first one along the path, m.
    way_m: f64,
}

impl Failed {
    fn push(&mut self, refusal: Refusal) {
        let same = |r: &Refusal| std::mem::discriminant(r) == std::mem::discriminant(&refusal);
        if self.refusals.iter().any(same) {
            return;
        }
        if self.refusals.is_empty() {
            self.way_m = refusal.place().map_or(0.0, |at| at.way_m);
        }
        self.refusals.push(refusal);
    }
}

#[cfg(test)]
mod tests;
