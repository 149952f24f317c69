//! Tasks of `unified_force_impedance`: made ready for the loop, with the estimators of normals that they name.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use tangent_control::{
    BendChange, ControlError, EstimateInput, EstimatorName, MAX_ESTIMATORS, Phase, SwitchRefusal,
    Task, UnifiedForceImpedance, UnifiedInput, UnifiedOutput, VisionInput,
};
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::convert::{cut_format, joint_array, joints};
use tangent_schemas::tangent::{
    ControlState, NormalEstimate, ShapingState, SurfaceAhead, SurfaceSegment,
};
use tangent_schemas::topics;
use tangent_sensing::Validity;

use super::choice::{Choice, Judged, SWITCH_GATE_RAD, judge};
use super::config::UnifiedConfig;
use super::cycle::Boxed;
use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use crate::desk::{Kind, one_speaks};
use crate::inputs::{EstimateReader, normal_estimate, read_estimate};
use crate::mailbox::Mailbox;

/// Makes tasks ready. In the desk.
pub struct Unified {
    bus: Bus,
    config: UnifiedConfig,
}

impl Unified {
    /// For the cell's arm.
    pub fn new(bus: &Bus, config: UnifiedConfig) -> Self {
        Self {
            bus: bus.clone(),
            config,
        }
    }

    fn program(&self, text: &str) -> Result<UnifiedProgram, String> {
        let words = |e: ControlError| e.to_string();
        let task: Task = text.parse().map_err(words)?;
        let law = self.config.law(task.controller.as_deref()).map_err(words)?;
        let (mut names, mut readers) = (Vec::new(), ArrayVec::new());
        for name in task.estimators.iter().take(MAX_ESTIMATORS) {
            let short = EstimatorName::from(name)
                .map_err(|_| format!("estimators: \"{name}\" is longer than 64 bytes"))?;
            let newest = self.bus.latest(&topics::estimate_normal(name));
            names.push(short);
            readers.push(EstimateReader::new(
                short,
                newest.map_err(|e| e.to_string())?,
            ));
        }
        let gate_rad = task
            .switching
            .disagreement_max_rad
            .unwrap_or(SWITCH_GATE_RAD);
        let bus = |e: BusError| e.to_string();
        let frames = self.bus.latest(&topics::estimate_normal(DEPTH_NORMAL));
        let segments = self.bus.latest(&topics::estimate_segment(DEPTH_NORMAL));
        let maps = self.bus.latest(&topics::estimate_ahead(DEPTH_NORMAL));
        Ok(UnifiedProgram {
            frames: frames.map_err(bus)?,
            segments: segments.map_err(bus)?,
            maps: maps.map_err(bus)?,
            seen: None,
            readers,
            newest: ArrayVec::new(),
            choice: Choice::new(names, gate_rad),
            normal: None,
            patience_s: law.patience.estimate_s,
            law: UnifiedForceImpedance::new(
                self.config.arm,
                self.config.flange_from_tool,
                self.config.limits,
                &law,
                &task,
                self.config.interface,
            )
            .map_err(words)?,
        })
    }
}

impl Kind for Unified {
    type Program = Boxed;

    fn prepare(&self, text: &str) -> Result<(String, Boxed), String> {
        let program = self.program(text)?;
        Ok((program.law.task().name.clone(), Box::new(program)))
    }

    fn check_estimates(&self, program: &Boxed, _: &Mailbox<Boxed>) -> Result<(), String> {
        let names = &program.task().estimators;
        let topics = names.iter().map(|name| topics::estimate_normal(name));
        if one_speaks(&self.bus, topics)? {
            return Ok(());
        }
        Err(format!(
            "none of the task's estimators publishes: {}; is the estimator running, with these in [estimators] run?",
            names.join(", ")
        ))
    }
}

/// `unified_force_impedance` with what it reads.
struct UnifiedProgram {
    law: UnifiedForceImpedance,
    frames: Latest<NormalEstimate>,
    segments: Latest<SurfaceSegment>,
    maps: Latest<SurfaceAhead>,
    /// The newest frame, on the loop's clock.
    seen: Option<VisionInput>,
    readers: ArrayVec<EstimateReader, MAX_ESTIMATORS>,
    /// As read in this cycle.
    newest: ArrayVec<Option<EstimateInput>, MAX_ESTIMATORS>,
    choice: Choice,
    /// In use in the cycle before, base axes.
    normal: Option<Vector3<f64>>,
    patience_s: f64,
}

impl UnifiedProgram {
    fn judged(&self) -> Judged {
        let said = |e: &Option<EstimateInput>| e.map(|e| (e.estimate.validity, e.age_s));
        self.newest
            .iter()
            .map(|e| judge(said(e), self.patience_s))
            .collect()
    }

    /// The newest frame. It is about a moment ago, which its arm state tells; the law places it there, and sees when it grows old.
    fn look(&mut self, input: &TorqueInput<'_>) -> Option<VisionInput> {
        if let Some(new) = self.frames.take_new() {
            let seen = normal_estimate(&new.message);
            // Said just before the normal of the same image; what was lost on the way is done without.
            let cycle = new.message.cycle;
            self.segments.refresh();
            let segment = self.segments.get().map(|segment| &segment.message);
            let surface_variation = segment
                .filter(|segment| segment.cycle == cycle)
                .map_or(0.0, |segment| segment.surface_variation);
            self.maps.refresh();
            let map = self.maps.get().map(|map| &map.message);
            let change = map.filter(|map| map.cycle == cycle).and_then(bend_change);
            // One of an earlier run of the bridge, whose count was higher, is of no use.
            let behind = input.arm.cycle.checked_sub(new.message.cycle);
            self.seen = behind.map(|cycles| VisionInput {
                time_s: input.time_s - cycles as f64 * input.arm.period_s,
                point: seen.point,
                normal: seen.normal,
                covariance: seen.covariance,
                surface_variation,
                curvature: seen.curvature,
                change,
                validity: seen.validity,
            });
        }
        self.seen
    }
}

impl TorqueProgram for UnifiedProgram {
    fn task(&self) -> &Task {
        self.law.task()
    }

    fn step(&mut self, input: &TorqueInput<'_>) -> Option<TorqueAnswer> {
        self.newest = self
            .readers
            .iter_mut()
            .map(|reader| read_estimate(reader, input.arm))
            .collect();
        let mut judged = self.judged();
        if self.law.phase() != Phase::Slide {
            // Nobody feels a surface that is not slid on: only silence counts.
            for said in &mut judged {
                *said = said.or_else(|why| match why {
                    Validity::Missing | Validity::Stale => Err(why),
                    _ => Ok(()),
                });
            }
        }
        let active = self.choice.fall_back(&judged);
        let touch = self.newest.get(active).copied().flatten();
        let touch = touch.filter(|e| e.age_s <= self.patience_s);
        let wrench = &input.wrench;
        let vision = self.look(input);
        let output = self.law.step(&UnifiedInput {
            time_s: input.time_s,
            dt_s: input.arm.period_s,
            q: joints(&input.arm.q).ok()?,
            qd: joints(&input.arm.qd).ok()?,
            arm_ready: input.arm_ready,
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            vision,
            touch: touch.map(|t| t.estimate),
            touch_age_s: touch.map_or(f64::INFINITY, |t| t.age_s),
        });
        self.normal = Some(output.normal);
        let (name, switches, cause) = self.choice.in_use();
        let (what, why) = cause.text();
        Some(TorqueAnswer {
            torque: joint_array(&output.torque),
            state: state(&output, input, touch.map(|t| t.age_s)),
            shaping: Some(ShapingState {
                monitor: output.monitor,
                monitor_margin: output.monitor_margin,
                rho_align: output.rho_align,
                rho_force: output.rho_force,
                ..ShapingState::default()
            }),
            phase: output.phase,
            fault: output.fault,
            // The law takes the zero itself, at rest before it moves.
            tare_requested: false,
            estimator: (name, switches, cut_format(format_args!("{what}{why}"))),
        })
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.law.pause(paused)
    }

    fn stop(&mut self) {
        self.law.stop();
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        let judged = self.judged();
        let (used, newest) = (self.normal, &self.newest);
        self.choice.select(name, force, &judged, |index| {
            let told = newest.get(index)?.as_ref()?;
            Some(used?.angle(&told.estimate.normal))
        })
    }

    fn set_force_reference(&mut self, force_n: f64) {
        self.law.set_force_reference(force_n);
    }

    fn phase(&self) -> Phase {
        self.law.phase()
    }
}

/// How the surface bends on, as far as the map says.
fn bend_change(map: &SurfaceAhead) -> Option<BendChange> {
    let [first, second, ..] = map.points.as_slice() else {
        return None;
    };
    let way = Vector3::from(second) - Vector3::from(first);
    let stations = map.distance.iter().zip(&map.bend).zip(&map.bend_sd);
    BendChange::of(&way, stations.map(|((d, bend), sd)| (*d, *bend, *sd)))
}

fn state(
    output: &UnifiedOutput,
    input: &TorqueInput<'_>,
    estimate_age_s: Option<f64>,
) -> ControlState {
    let age = |age_s: f64| if age_s.is_finite() { age_s } else { -1.0 };
    ControlState {
        normal: (&output.normal).into(),
        force_reference_n: output.force_reference_n,
        force_n: output.force_n,
        wrench: (&output.wrench).into(),
        path_reference: (&output.path_reference).into(),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: age(input.wrench.age_s),
        estimate_age_s: estimate_age_s.map_or(-1.0, age),
        motion_tank_j: output.tanks.motion_j,
        force_tank_j: output.tanks.force_j,
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        ..ControlState::default()
    }
}
