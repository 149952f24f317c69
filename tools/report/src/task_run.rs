//! One task of a recording, by default the last, cycle by cycle, with the messages that belong to
//! each cycle.

use nalgebra::{Matrix3, Vector3};
use tangent_control::Phase;
use tangent_mechanics::{Base, Pose, Tool};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmState, ContactTruth, ControlState, NormalEstimate};
use tangent_simulation::metrics::{CycleSample, EstimateSample, TruthSample};

use crate::run::{BESIDE_NS, Run};
use crate::tasks::phase_of;

/// Time for which a run continues after its task has ended, s; as in `evaluate`.
const AFTER_END_S: f64 = 0.2;
/// Largest time between a truth and the cycle to which it is assigned, ns.
const TRUTH_REACH_NS: i64 = 20_000_000;

/// One cycle with all messages that belong to it.
pub struct Cycle<'a> {
    /// Time since the task's start, s.
    pub time_s: f64,
    /// State of the arm.
    pub arm: &'a ArmState,
    /// Answer of the controller.
    pub control: &'a ControlState,
    /// Ground truth, if there is one.
    pub truth: Option<&'a ContactTruth>,
    /// The cycle in the form that the figures need.
    pub sample: CycleSample,
}

/// One task of a recording: the one that is kept, or the last.
pub struct TaskRun<'a> {
    /// Cycles of the task, in order.
    pub cycles: Vec<Cycle<'a>>,
    /// Stamp of its start, ns since the Unix epoch.
    pub start_ns: i64,
    /// Stamps of the messages that belong to it, first and last, ns since the Unix epoch. Cycle
    /// numbers repeat when the bridge restarts.
    pub(crate) window_ns: (i64, i64),
}

impl<'a> TaskRun<'a> {
    /// Joins the messages of all services on the cycles of the task.
    pub fn of(run: &'a Run) -> Self {
        let Some(states) = run.tasks.last().map(|task| match run.kept {
            None => task.states.clone(),
            Some(_) => 0..run.control.len(),
        }) else {
            return Self {
                cycles: Vec::new(),
                start_ns: run.arm.first().map_or(0, |a| a.header.stamp.to_ns()),
                window_ns: (i64::MIN, i64::MAX),
            };
        };
        let control = &run.control[states];
        let start_ns = control.first().map_or(0, |c| c.header.stamp.to_ns());
        let end_ns = control.last().map_or(0, |c| c.header.stamp.to_ns());
        let window_ns = (start_ns - BESIDE_NS, end_ns + BESIDE_NS);
        let window = |ns: i64| (window_ns.0..=window_ns.1).contains(&ns);
        let of_task = run.arm.iter().filter(|a| window(a.header.stamp.to_ns()));
        let mut arms: Vec<&ArmState> = of_task.collect();
        arms.sort_by_key(|a| a.cycle);
        let (mut arm_at, mut truth_at, mut estimate_at) = (0, 0, 0);
        let (mut used, mut estimates) = ("", &[][..]);

        let mut origin_ns = None;
        let mut cycles = Vec::new();
        let mut ended_at = None;
        for state in control {
            let Some(arm) = newest(&arms, &mut arm_at, |a| a.cycle, state.cycle)
                .copied()
                .filter(|arm| arm.cycle == state.cycle)
            else {
                continue;
            };
            let stamp_ns = arm.header.stamp.to_ns();
            // The first packet of a task ends its first period.
            let origin = *origin_ns.get_or_insert(stamp_ns - (arm.period_s * 1e9).round() as i64);
            let time_s = (stamp_ns - origin) as f64 * 1e-9;
            let truth = nearest(&run.truth, &mut truth_at, |t| &t.header, stamp_ns);
            if used != state.estimator.as_str() {
                used = state.estimator.as_str();
                let all = run.estimates.get(used).map_or(&[][..], Vec::as_slice);
                estimates = within(all, |e| &e.header, window_ns);
            }
            let estimate = newest(estimates, &mut estimate_at, |e| e.cycle, state.cycle);
            cycles.push(Cycle {
                time_s,
                arm,
                control: state,
                truth,
                sample: sample(time_s, arm, state, truth, estimate),
            });
            if !phase_of(state).is_active() {
                let since: f64 = *ended_at.get_or_insert(time_s);
                // Stamps are whole nanoseconds: their rounding must not add a cycle.
                if time_s - since >= AFTER_END_S - 1e-6 {
                    break;
                }
            }
        }
        Self {
            cycles,
            start_ns: origin_ns.unwrap_or(start_ns),
            window_ns,
        }
    }

    /// Task file of this task; `None` if the recording has none.
    pub fn file(&self, run: &Run) -> Option<toml::Table> {
        let activation = self.cycles.last()?.control.activation;
        let text = run.attachments.get(&format!("task-{activation}.toml"))?;
        text.parse().ok()
    }

    /// The cycles on the path and at rest at its end, in contact.
    pub fn sliding(&self) -> Vec<&Cycle<'a>> {
        let slides = |c: &&Cycle<'_>| matches!(c.sample.phase, Phase::Slide | Phase::Hold);
        self.cycles.iter().filter(slides).collect()
    }

    /// The newest estimate of `estimator` at each cycle.
    pub fn estimates_of(&self, run: &Run, estimator: &str) -> Vec<Option<EstimateSample>> {
        let estimates = run.estimates.get(estimator);
        let estimates = estimates.map(|all| within(all, |e| &e.header, self.window_ns));
        let (estimates, mut at) = (estimates.unwrap_or_default(), 0);
        self.cycles
            .iter()
            .map(|cycle| {
                newest(estimates, &mut at, |e| e.cycle, cycle.control.cycle).map(estimate_sample)
            })
            .collect()
    }
}

/// The partition point of `all`, which the search of the next cycle finds a few places behind that
/// of the last one, `at`.
fn partition_from<T>(all: &[T], at: &mut usize, is_before: impl Fn(&T) -> bool) -> usize {
    const NEAR: usize = 8;
    let from = (*at).min(all.len());
    let near = &all[from..all.len().min(from + NEAR)];
    let moved = near.iter().take_while(|one| is_before(one)).count();
    let is_behind = from == 0 || is_before(&all[from - 1]);
    *at = match is_behind && moved < NEAR {
        true => from + moved,
        false => all.partition_point(is_before),
    };
    *at
}

/// The truth with the nearest stamp; `truth` must be in order. `at` is where the last one was.
pub(crate) fn nearest<'a, T>(
    truth: &'a [T],
    at: &mut usize,
    stamp: impl Fn(&T) -> &Header,
    stamp_ns: i64,
) -> Option<&'a T> {
    let stamp_of = |t: &T| stamp(t).stamp.to_ns();
    let after = partition_from(truth, at, |t| stamp_of(t) < stamp_ns);
    let distance = |t: &&T| (stamp_of(t) - stamp_ns).abs();
    [after.checked_sub(1), Some(after)]
        .into_iter()
        .flatten()
        .filter_map(|i| truth.get(i))
        .min_by_key(distance)
        .filter(|t| distance(t) <= TRUTH_REACH_NS)
}

/// Messages with a stamp within the window; `all` must be in order.
pub(crate) fn within<E>(all: &[E], header: impl Fn(&E) -> &Header, window_ns: (i64, i64)) -> &[E] {
    let stamp = |e: &E| header(e).stamp.to_ns();
    let from = all.partition_point(|e| stamp(e) < window_ns.0);
    let to = all.partition_point(|e| stamp(e) <= window_ns.1);
    &all[from..to.max(from)]
}

/// The newest one made by `cycle`; `all` must be in order. `at` is where the last one was.
pub(crate) fn newest<'a, E>(
    all: &'a [E],
    at: &mut usize,
    made_at: impl Fn(&E) -> u64,
    cycle: u64,
) -> Option<&'a E> {
    let after = partition_from(all, at, |e| made_at(e) <= cycle);
    all.get(after.checked_sub(1)?)
}

fn estimate_sample(estimate: &NormalEstimate) -> EstimateSample {
    EstimateSample {
        normal: (&estimate.normal).into(),
        covariance: Matrix3::from_row_slice(&estimate.covariance),
        valid: estimate.validity == 0,
    }
}

fn sample(
    time_s: f64,
    arm: &ArmState,
    control: &ControlState,
    truth: Option<&ContactTruth>,
    estimate: Option<&NormalEstimate>,
) -> CycleSample {
    let phase = phase_of(control);
    let z_axis = |pose: &tangent_schemas::standard::Pose| {
        Pose::<Base, Tool>::try_from(pose).map_or(Vector3::z(), |p| p.z_axis())
    };
    CycleSample {
        time_s,
        phase,
        estimate: estimate.map(estimate_sample),
        truth: truth.map(|t| {
            let normal = Vector3::from(&t.normal);
            TruthSample {
                normal,
                tool_z: z_axis(&t.tool_pose),
                in_contact: t.in_contact,
                force_n: Vector3::from(&t.wrench.force).dot(&normal),
            }
        }),
        tool_position: (&arm.tool_pose.position).into(),
        tool_z: z_axis(&arm.tool_pose),
        force_n: Some(control.force_n).filter(|n| n.is_finite()),
        force_reference_n: control.force_reference_n,
        // Without a truth, the controller's pressing phases count as contact.
        in_contact: phase.is_pressing(),
        path_reference: (&control.path_reference).into(),
        path_error_m: control.path_error_m,
        joint_speed_rad_per_s: arm.qd.iter().fold(0.0, |most, qd| qd.abs().max(most)),
        // A controller that holds the arm computes no manipulability.
        manipulability: if control.manipulability > 0.0 {
            control.manipulability
        } else {
            f64::INFINITY
        },
        motion_tank_j: tank(control.motion_tank_j),
        force_tank_j: tank(control.force_tank_j),
    }
}

/// Energy of a tank, J; a law without this tank publishes zero.
fn tank(energy_j: f64) -> Option<f64> {
    (energy_j != 0.0).then_some(energy_j)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_from_the_last_place_finds_what_a_search_of_all_finds() {
        let all: Vec<u64> = (0..100).map(|i| i / 3).collect();
        for from in 0..110 {
            for wanted in 0..40 {
                let mut at = from;
                let found = partition_from(&all, &mut at, |x| *x < wanted);
                assert_eq!(
                    found,
                    all.partition_point(|x| *x < wanted),
                    "{from} {wanted}"
                );
                assert_eq!(found, at);
            }
        }
    }

    #[test]
    fn the_truth_nearest_in_stamp_is_taken_and_none_that_is_far() {
        let at = |ms: i64| ContactTruth {
            header: tangent_schemas::standard::Header::new(ms * 1_000_000, "base"),
            penetration_m: ms as f64,
            ..ContactTruth::default()
        };
        let truth = [at(0), at(8), at(16), at(500)];
        let found = |ms: i64| {
            nearest(&truth, &mut 0, |t| &t.header, ms * 1_000_000).map(|t| t.penetration_m)
        };
        assert_eq!(found(5), Some(8.0));
        assert_eq!(found(3), Some(0.0));
        assert_eq!(found(30), Some(16.0));
        assert_eq!(found(200), None);
        assert_eq!(found(510), Some(500.0));
    }
}
