//! The figures of a recorded run: the same definitions as `tangent evaluate`, from messages instead of a closed loop.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use tangent_control::Phase;
use tangent_mechanics::{Base, Pose, Tool};
use tangent_schemas::tangent::{ArmState, ContactTruth, ControlState, NormalEstimate};
use tangent_simulation::metrics::object_pose::ObjectPoseFigures;
use tangent_simulation::metrics::tactile::TactileFigures;
use tangent_simulation::metrics::{CycleSample, EstimateSample, Figures, TruthSample};

use super::comparison::{self, EstimatorFigures, Switch};
use super::run::{Growth, Run};

/// A run goes on this long after its task has ended, s; as `evaluate` has it.
const AFTER_END_S: f64 = 0.2;
/// A truth further from its cycle than this says nothing about it, ns.
const TRUTH_REACH_NS: i64 = 20_000_000;

/// What `report --json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Name of the simulated scenario; null for a real cell.
    pub scenario: Option<String>,
    /// Preset of the control law.
    pub controller: Option<String>,
    /// Estimator in use at the end.
    pub estimator: Option<String>,
    /// Seed of the simulator's noise.
    pub seed: Option<u64>,
    /// From the task's start to its end, s.
    pub duration_s: f64,
    /// Robot cycles of the task.
    pub steps: u64,
    /// Of `evaluate` only.
    pub wall_s: Option<f64>,
    /// Of `evaluate` only.
    pub real_time_factor: Option<f64>,
    /// Everything that follows from the cycles.
    #[serde(flatten)]
    pub figures: Figures,
    /// Of object estimators only.
    pub object_pose: Option<ObjectPoseFigures>,
    /// Of laws that shape stiffness and force only; without what no topic tells.
    pub tactile: Option<TactileFigures>,
    /// How the live loop fared.
    pub r#loop: LoopFigures,
    /// Phase at the end of the task.
    pub phase: Option<&'static str>,
    /// Last fault of the task.
    pub fault: Option<String>,
    /// Of `evaluate` only.
    pub state_digest: Option<String>,
    /// Each recorded estimator over the same cycles.
    pub estimators: BTreeMap<String, EstimatorFigures>,
    /// Changes of the estimator in use.
    pub estimator_switches: Vec<Switch>,
    /// About the recording itself.
    pub recording: RecordingFigures,
}

/// How the live loop fared, over the whole recording.
#[derive(Clone, Debug, Serialize)]
pub struct LoopFigures {
    /// From a robot packet's arrival to the command's departure.
    pub packet_to_command_us: Option<Quantiles>,
    /// Packets of the robot that no fresh command answered while one was due.
    pub missed_cycles: Option<u64>,
    /// Packets of the robot that were late themselves.
    pub late_states: Option<u64>,
    /// Sensor records lost.
    pub wrench_records_lost: Option<u64>,
    /// Messages missing in the recording.
    pub messages_dropped: Option<u64>,
    /// Greatest age of the sensor's zero while the tool pressed, s.
    pub zero_age_max_s: Option<f64>,
    /// Error of the zero that its age and the sensor's stated drift imply, at its greatest then, N.
    pub zero_bound_max_n: Option<f64>,
}

/// Nearest-rank quantiles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct Quantiles {
    pub p50: f64,
    pub p99: f64,
    pub p999: f64,
    pub max: f64,
}

impl Quantiles {
    /// None of an empty list.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let max = *values.last()?;
        let rank = |q: f64| {
            let rank = (q * values.len() as f64).ceil() as usize;
            values[rank.clamp(1, values.len()) - 1]
        };
        Some(Self {
            p50: rank(0.5),
            p99: rank(0.99),
            p999: rank(0.999),
            max,
        })
    }
}

/// About the recording itself.
#[derive(Clone, Debug, Serialize)]
pub struct RecordingFigures {
    /// Files that were read.
    pub files: Vec<String>,
    /// Messages in them.
    pub messages: u64,
    /// Messages that did not decode.
    pub undecodable: u64,
    /// Some file lacks its end or is damaged.
    pub truncated: bool,
    /// Tasks in the recording; the figures are those of the last one.
    pub tasks: usize,
    /// Program that recorded it.
    pub version: Option<String>,
}

/// One cycle with everything that was said about it.
pub struct Cycle<'a> {
    /// Since the task's start, s.
    pub time_s: f64,
    /// What the arm said.
    pub arm: &'a ArmState,
    /// What the controller answered.
    pub control: &'a ControlState,
    /// What was true.
    pub truth: Option<&'a ContactTruth>,
    /// As the figures want it.
    pub sample: CycleSample,
}

/// The last task of a recording.
pub struct TaskRun<'a> {
    /// Its cycles, in order.
    pub cycles: Vec<Cycle<'a>>,
    /// Stamp of its start, ns since the Unix epoch.
    pub start_ns: i64,
    /// Tasks in the recording.
    pub tasks: usize,
}

/// The phase a message names; a number of a later version is taken for idle.
pub fn phase_of(control: &ControlState) -> Phase {
    Phase::ALL
        .into_iter()
        .find(|phase| *phase as u8 == control.phase)
        .unwrap_or_default()
}

impl<'a> TaskRun<'a> {
    /// Joins what the services said about the cycles of the last task.
    pub fn of(run: &'a Run) -> Self {
        let mut activations: Vec<u64> = run.control.iter().map(|c| c.activation).collect();
        activations.dedup();
        activations.retain(|a| *a > 0);
        let Some(&last) = activations.last() else {
            return Self {
                cycles: Vec::new(),
                start_ns: run.arm.first().map_or(0, |a| a.header.stamp.to_ns()),
                tasks: 0,
            };
        };
        let from = run
            .control
            .iter()
            .rposition(|c| c.activation != last)
            .map_or(0, |i| i + 1);
        let control = &run.control[from..];
        let start_ns = control.first().map_or(0, |c| c.header.stamp.to_ns());
        let window = |ns: i64| ns > start_ns - 1_000_000_000;
        let arms: HashMap<u64, &ArmState> = run
            .arm
            .iter()
            .filter(|a| window(a.header.stamp.to_ns()))
            .map(|a| (a.cycle, a))
            .collect();

        let mut origin_ns = None;
        let mut cycles = Vec::new();
        let mut ended_at = None;
        for state in control {
            let Some(arm) = arms.get(&state.cycle).copied() else {
                continue;
            };
            let stamp_ns = arm.header.stamp.to_ns();
            // The first packet of a task ends its first period.
            let origin = *origin_ns.get_or_insert(stamp_ns - (arm.period_s * 1e9).round() as i64);
            let time_s = (stamp_ns - origin) as f64 * 1e-9;
            let truth = nearest(&run.truth, stamp_ns);
            let estimate = newest(run.estimates.get(state.estimator.as_str()), state.cycle);
            cycles.push(Cycle {
                time_s,
                arm,
                control: state,
                truth,
                sample: sample(time_s, arm, state, truth, estimate),
            });
            if !phase_of(state).is_active() {
                let since: f64 = *ended_at.get_or_insert(time_s);
                // Stamps are whole nanoseconds: half a cycle's rounding must not add a cycle.
                if time_s - since >= AFTER_END_S - 1e-6 {
                    break;
                }
            }
        }
        Self {
            cycles,
            start_ns: origin_ns.unwrap_or(start_ns),
            tasks: activations.len(),
        }
    }

    /// The cycles as the figures want them, with the estimates of `estimator` in place of those in use.
    pub fn samples_with(&self, run: &Run, estimator: &str) -> Vec<CycleSample> {
        let estimates = run.estimates.get(estimator);
        self.cycles
            .iter()
            .map(|cycle| CycleSample {
                estimate: newest(estimates, cycle.control.cycle).map(estimate_sample),
                ..cycle.sample
            })
            .collect()
    }
}

/// The truth nearest in stamp.
fn nearest(truth: &[ContactTruth], stamp_ns: i64) -> Option<&ContactTruth> {
    let after = truth.partition_point(|t| t.header.stamp.to_ns() < stamp_ns);
    let distance = |t: &&ContactTruth| (t.header.stamp.to_ns() - stamp_ns).abs();
    [after.checked_sub(1), Some(after)]
        .into_iter()
        .flatten()
        .filter_map(|i| truth.get(i))
        .min_by_key(distance)
        .filter(|t| distance(t) <= TRUTH_REACH_NS)
}

/// The newest estimate that was made by then; estimates are in order.
fn newest(estimates: Option<&Vec<NormalEstimate>>, cycle: u64) -> Option<&NormalEstimate> {
    let estimates = estimates?;
    let after = estimates.partition_point(|e| e.cycle <= cycle);
    estimates.get(after.checked_sub(1)?)
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
        // Without a truth: contact as the controller holds it is what its pressing phases say.
        in_contact: phase.is_pressing(),
        path_reference: (&control.path_reference).into(),
        path_error_m: control.path_error_m,
        joint_speed_rad_per_s: arm.qd.iter().fold(0.0, |most, qd| qd.abs().max(most)),
        // A controller that holds the arm computes none.
        manipulability: if control.manipulability > 0.0 {
            control.manipulability
        } else {
            f64::INFINITY
        },
        motion_tank_j: tank(control.motion_tank_j),
        force_tank_j: tank(control.force_tank_j),
    }
}

/// A law without this tank publishes zero.
fn tank(energy_j: f64) -> Option<f64> {
    (energy_j != 0.0).then_some(energy_j)
}

impl Report {
    /// All figures of a run.
    pub fn of(run: &Run, task: &TaskRun<'_>) -> Self {
        let samples: Vec<CycleSample> = task.cycles.iter().map(|c| c.sample).collect();
        let mut figures = Figures::of(&samples);
        let manipulability = figures.joints.manipulability_min;
        figures.joints.manipulability_min = manipulability.filter(|m| m.is_finite());
        let last = task.cycles.last();
        let estimators = comparison::estimators(run, task);
        Self {
            scenario: text_fact(run, "scenario", "name"),
            controller: controller(run),
            estimator: last
                .map(|c| c.control.estimator.to_string())
                .filter(|name| !name.is_empty()),
            seed: text_fact(run, "seed", "seed").and_then(|seed| seed.parse().ok()),
            duration_s: last.map_or(0.0, |c| c.time_s),
            steps: samples.len() as u64,
            wall_s: None,
            real_time_factor: None,
            figures,
            object_pose: super::object::figures(run, task),
            tactile: super::tactile::figures(run, task),
            r#loop: loop_figures(run),
            phase: last.map(|c| c.sample.phase.name()),
            fault: task
                .cycles
                .iter()
                .rev()
                .map(|c| c.control.fault.as_str())
                .find(|fault| !fault.is_empty())
                .map(str::to_owned),
            state_digest: None,
            estimators,
            estimator_switches: comparison::switches(task),
            recording: RecordingFigures {
                files: run.files.iter().map(|f| f.display().to_string()).collect(),
                messages: run.topics.values().map(|(_, count)| count).sum(),
                undecodable: run.undecodable,
                truncated: !run.truncated.is_empty() || !run.damages.is_empty(),
                tasks: task.tasks,
                version: run.fact("version").map(str::to_owned),
            },
        }
    }

    /// Something that should be in the recording is not, or was lost before it.
    pub fn is_lossy(&self) -> bool {
        self.recording.truncated
            || self.recording.undecodable > 0
            || self.r#loop.messages_dropped.is_some_and(|n| n > 0)
            || self.r#loop.wrench_records_lost.is_some_and(|n| n > 0)
    }
}

/// What the recorder was told, else what the scenario stored in the recording says under `key`.
fn text_fact(run: &Run, fact: &str, key: &str) -> Option<String> {
    let told = run.fact(fact).map(str::to_owned);
    told.or_else(|| {
        let scenario: toml::Table = run.attachments.get("scenario.toml")?.parse().ok()?;
        Some(match scenario.get(key)? {
            toml::Value::String(text) => text.clone(),
            other => other.to_string(),
        })
    })
}

/// The preset: the task's own if it names one, else the scenario's or the cell's.
fn controller(run: &Run) -> Option<String> {
    // `task-10.toml` is newer than `task-9.toml`.
    let newest_task = run
        .attachments
        .iter()
        .filter(|(name, _)| name.starts_with("task"))
        .max_by_key(|(name, _)| (name.len(), name.as_str()));
    newest_task
        .and_then(|(_, text)| {
            let table: toml::Table = text.parse().ok()?;
            Some(table.get("controller")?.as_str()?.to_owned())
        })
        .or_else(|| text_fact(run, "controller", "controller"))
}

fn loop_figures(run: &Run) -> LoopFigures {
    let mut missed = Growth::default();
    for arm in &run.arm {
        missed.add(arm.missed_cycles);
    }
    let latencies: Vec<f64> = run
        .arm
        .iter()
        .map(|arm| arm.packet_to_command_s * 1e6)
        .filter(|us| *us > 0.0)
        .collect();
    let pressing = |c: &&ControlState| {
        let phases = [Phase::Contact, Phase::Slide, Phase::Hold].map(|phase| phase as u8);
        phases.contains(&c.phase)
    };
    // Negative where there is no zero, or nothing is known of its drift.
    let greatest = |value: fn(&ControlState) -> f64| {
        let values = run.control.iter().filter(pressing).map(value);
        values.filter(|value| *value >= 0.0).reduce(f64::max)
    };
    LoopFigures {
        packet_to_command_us: Quantiles::of(latencies),
        missed_cycles: missed.seen.then_some(missed.total),
        late_states: run.figure("rtde", "late_states").map(|n| n as u64),
        wrench_records_lost: run.wrench_records_lost,
        messages_dropped: run.messages_dropped(),
        zero_age_max_s: greatest(|c| c.zero_age_s),
        zero_bound_max_n: greatest(|c| c.zero_bound_n),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_nearest_ranks() {
        let found = Quantiles::of((1..=1000).rev().map(f64::from).collect()).unwrap();
        assert_eq!(
            (found.p50, found.p99, found.p999, found.max),
            (500.0, 990.0, 999.0, 1000.0)
        );
        assert_eq!(Quantiles::of(Vec::new()), None);
    }

    #[test]
    fn the_truth_nearest_in_stamp_is_taken_and_none_that_is_far() {
        let at = |ms: i64| ContactTruth {
            header: tangent_schemas::standard::Header::new(ms * 1_000_000, "base"),
            penetration_m: ms as f64,
            ..ContactTruth::default()
        };
        let truth = [at(0), at(8), at(16), at(500)];
        let found = |ms: i64| nearest(&truth, ms * 1_000_000).map(|t| t.penetration_m);
        assert_eq!(found(5), Some(8.0));
        assert_eq!(found(3), Some(0.0));
        assert_eq!(found(30), Some(16.0));
        assert_eq!(found(200), None);
        assert_eq!(found(510), Some(500.0));
    }
}
