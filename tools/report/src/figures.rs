//! Figures of a recorded run. They are defined as in `tangent evaluate`, but computed from messages
//! instead of a closed loop.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;
use tangent_control::{CoverageResult, Path, PathSpec, Phase};
use tangent_schemas::tangent::ControlState;
use tangent_simulation::metrics::object::ObjectFigures;
use tangent_simulation::metrics::visuo_tactile::VisuoTactileFigures;
use tangent_simulation::metrics::{CycleSample, Figures};

use crate::acceptance::{self, Judged};
use crate::comparison::{self, EstimatorFigures, Switch};
use crate::events::Events;
use crate::run::{Growth, Run};
use crate::task_run::{Cycle, TaskRun};
use crate::tasks::{TaskEntry, phase_of};
use crate::{coverage, object, tactile};

/// Time at the end of a retraction over which the force of a free tool is averaged, s, and the way
/// after which a tool is free, m: a soft surface has let go by then.
const FREE_MEAN_S: f64 = 0.3;
const FREE_WAY_M: f64 = 0.02;

/// Output of `report --json`.
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
    /// Time from the task's start to its end, s.
    pub duration_s: f64,
    /// Robot cycles of the task.
    pub steps: u64,
    /// Only from `evaluate`.
    pub wall_s: Option<f64>,
    /// Only from `evaluate`.
    pub real_time_factor: Option<f64>,
    /// All figures that are computed from the cycles.
    #[serde(flatten)]
    pub figures: Figures,
    /// Only for object estimators.
    pub object_pose: Option<ObjectFigures>,
    /// Only for laws that shape stiffness and force; figures that no topic provides are left out.
    pub tactile: Option<VisuoTactileFigures>,
    /// What the controller has covered, of tasks with `[coverage]` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<CoverageResult>,
    /// Timing and losses of the live loop.
    pub r#loop: LoopFigures,
    /// Phase at the end of the task. A task that is stopped ends in `done` as well: see `verdict`.
    pub phase: Option<&'static str>,
    /// Verdict, progress, interruptions, and what was passed over.
    #[serde(flatten)]
    pub events: Events,
    /// Last fault of the task.
    pub fault: Option<String>,
    /// Whether the result keeps every tolerance of the task file; null if it has none.
    pub accepted: Option<bool>,
    /// Every tolerance of the task file, with the value of this run.
    pub tolerances: Vec<Judged>,
    /// Number of the task within the recording, from 1; null without a task.
    pub task: Option<usize>,
    /// All tasks of the recording.
    pub tasks: Vec<TaskEntry>,
    /// Only from `evaluate`.
    pub state_digest: Option<String>,
    /// Figures of each recorded estimator over the same cycles.
    pub estimators: BTreeMap<String, EstimatorFigures>,
    /// Changes of the estimator in use.
    pub estimator_switches: Vec<Switch>,
    /// Figures of the recording itself.
    pub recording: RecordingFigures,
}

/// Timing and losses of the live loop over the whole recording, and the sensor's zero.
#[derive(Clone, Debug, Serialize)]
pub struct LoopFigures {
    /// Time from a robot packet's arrival to the command's departure, µs.
    pub packet_to_command_us: Option<Quantiles>,
    /// Number of robot packets without a fresh command in answer while one was due.
    pub missed_cycles: Option<u64>,
    /// Number of robot packets that were late themselves.
    pub late_states: Option<u64>,
    /// Number of sensor records lost.
    pub wrench_records_lost: Option<u64>,
    /// Number of messages missing in the recording.
    pub messages_dropped: Option<u64>,
    /// Greatest age of the sensor's zero while the tool pressed, s.
    pub zero_age_max_s: Option<f64>,
    /// Largest bound on the error of that zero from its age and the sensor's stated drift, N.
    pub zero_bound_max_n: Option<f64>,
    /// Mean force that the sensor still showed at the end of this task, N: a zero that has
    /// moved since the tare, or a payload that is not the stated one.
    pub force_when_free_n: Option<f64>,
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
    /// Computes the quantiles; `None` for an empty list.
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

/// Figures of the recording itself.
#[derive(Clone, Debug, Serialize)]
pub struct RecordingFigures {
    /// Files that were read.
    pub files: Vec<String>,
    /// Number of messages in them.
    pub messages: u64,
    /// Number of messages that could not be decoded.
    pub undecodable: u64,
    /// Whether any file lacks its end or is damaged.
    pub truncated: bool,
    /// Number of tasks in the recording.
    pub tasks: usize,
    /// Program that recorded it.
    pub version: Option<String>,
}

impl Report {
    /// The task that the figures are of.
    pub fn task_entry(&self) -> Option<&TaskEntry> {
        self.tasks.get(self.task?.checked_sub(1)?)
    }

    /// Computes all figures of a run.
    pub fn of(run: &Run, task: &TaskRun<'_>) -> Self {
        let samples: Vec<CycleSample> = task.cycles.iter().map(|c| c.sample).collect();
        let mut figures = Figures::of(&samples);
        let manipulability = figures.joints.manipulability_min;
        figures.joints.manipulability_min = manipulability.filter(|m| m.is_finite());
        let last = task.cycles.last();
        let estimators = comparison::estimators(run, task);
        let events = Events::of(task, lifts(run, task));
        let tolerances = acceptance::judge(&acceptance::tolerances(run, task), &figures);
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
            object_pose: object::figures(run, task),
            tactile: tactile::figures(run, task),
            coverage: coverage::result(run, task),
            r#loop: loop_figures(run, task),
            phase: last.map(|c| c.sample.phase.name()),
            accepted: acceptance::accepted(&tolerances, &events),
            tolerances,
            task: run.kept.or(run.tasks.last().map(|task| task.number)),
            tasks: run.tasks.clone(),
            events,
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
                tasks: run.tasks.len(),
                version: run.fact("version").map(str::to_owned),
            },
        }
    }

    /// Whether something is missing in the recording, or was lost before it.
    pub fn is_lossy(&self) -> bool {
        self.recording.truncated
            || self.recording.undecodable > 0
            || self.r#loop.messages_dropped.is_some_and(|n| n > 0)
            || self.r#loop.wrench_records_lost.is_some_and(|n| n > 0)
    }
}

/// Number of lifts that the path of the task's file asks for; `None` without a file, or where the
/// rounds of a coverage add more.
fn lifts(run: &Run, task: &TaskRun<'_>) -> Option<usize> {
    let file = task.file(run)?;
    if file.contains_key("coverage") {
        return None;
    }
    let spec: PathSpec = file.get("path")?.clone().try_into().ok()?;
    // The bounds do not change the number of strokes.
    Path::new(&spec, 0.1, 1.0).ok().map(|path| path.lifts())
}

/// The fact given to the recorder, else the value under `key` in the scenario that the recording
/// contains.
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

/// The preset: the task's own if it names one, else that of the scenario or the cell.
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

fn loop_figures(run: &Run, task: &TaskRun<'_>) -> LoopFigures {
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
    let pressing = |c: &&ControlState| phase_of(c).is_pressing();
    // The value is negative if there is no zero, or its drift is unknown.
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
        force_when_free_n: force_when_free_n(&leaving(task)),
    }
}

/// One cycle of a retraction.
#[derive(Clone, Copy, Debug)]
struct Leaving {
    time_s: f64,
    /// Position of the tool, m.
    at: Vector3<f64>,
    /// Force on the tool, N, if it is usable.
    force: Option<Vector3<f64>>,
}

/// The last retraction of a task.
fn leaving(task: &TaskRun<'_>) -> Vec<Leaving> {
    let is_leaving = |cycle: &&Cycle<'_>| cycle.sample.phase == Phase::Retract;
    let back = task.cycles.iter().rev();
    let mut cycles: Vec<Leaving> = back
        .skip_while(|cycle| !is_leaving(cycle))
        .take_while(is_leaving)
        .map(|cycle| Leaving {
            time_s: cycle.time_s,
            at: cycle.sample.tool_position,
            force: (cycle.control.wrench_validity == 0)
                .then(|| Vector3::from(&cycle.control.wrench.force)),
        })
        .collect();
    cycles.reverse();
    cycles
}

/// Mean force over the end of a retraction, N, if the tool has moved off far enough.
fn force_when_free_n(leaving: &[Leaving]) -> Option<f64> {
    let (first, last) = (leaving.first()?, leaving.last()?);
    let late = leaving.iter().filter(|cycle| {
        cycle.time_s > last.time_s - FREE_MEAN_S && (cycle.at - first.at).norm() > FREE_WAY_M
    });
    let forces: Vec<Vector3<f64>> = late.filter_map(|cycle| cycle.force).collect();
    let sum: Vector3<f64> = forces.iter().sum();
    (!forces.is_empty()).then(|| sum.norm() / forces.len() as f64)
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
    fn a_zero_that_has_moved_shows_when_the_tool_hangs_free() {
        let (pressed, moved) = (Vector3::z() * -2.0, Vector3::new(0.6, 0.0, -0.8));
        let cycle = |i: u32, still_m: f64| {
            let way_m = 1e-3 * f64::from(i);
            Leaving {
                time_s: 0.02 * f64::from(i),
                at: Vector3::z() * way_m.min(still_m),
                force: (!i.is_multiple_of(3)).then_some(if i < 20 { pressed } else { moved }),
            }
        };
        let off: Vec<_> = (0..50).map(|i| cycle(i, 1.0)).collect();
        assert!((force_when_free_n(&off).unwrap() - 1.0).abs() < 1e-9);
        // Off by 10 mm only; without a usable reading; no retraction.
        let near: Vec<_> = (0..50).map(|i| cycle(i, 0.01)).collect();
        assert_eq!(force_when_free_n(&near), None);
        let silent: Vec<_> = off.iter().map(|c| Leaving { force: None, ..*c }).collect();
        assert_eq!(force_when_free_n(&silent), None);
        assert_eq!(force_when_free_n(&[]), None);
    }
}
