//! Tasks of `unified_force_impedance`: made ready for the loop, with the estimators of normals that they name.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use tangent_control::{
    BendChange, ControlError, EstimatorName, MAX_ESTIMATORS, Phase, SwitchCause, SwitchRefusal,
    Task, UnifiedForceImpedance, UnifiedInput, UnifiedOutput, VisionInput,
};
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_mechanics::Arm;
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::convert::{cut_format, joint_array, joints};
use tangent_schemas::tangent::{
    ControlState, NormalEstimate, ShapingState, SurfaceAhead, SurfaceSegment,
};
use tangent_schemas::topics;
use tangent_sensing::Validity;

use super::config::UnifiedConfig;
use super::cycle::Boxed;
use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use crate::desk::{Kind, one_speaks};
use crate::inputs::{EstimateReader, normal_estimate, read_estimate};
use crate::mailbox::Mailbox;

/// Periods between a packet of the arm and the torque that answers it: the arm waits for the answer.
const DELAY_PERIODS: usize = 0;

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
        let mut readers = ArrayVec::new();
        for name in task.estimators.iter().take(MAX_ESTIMATORS) {
            let short = EstimatorName::from(name)
                .map_err(|_| format!("estimators: \"{name}\" is longer than 64 bytes"))?;
            let newest = self.bus.latest(&topics::estimate_normal(name));
            readers.push(EstimateReader::new(
                short,
                newest.map_err(|e| e.to_string())?,
            ));
        }
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
            active: 0,
            cause: SwitchCause::Task,
            switches: 0,
            patience_s: law.patience.estimate_s,
            weighed: self.config.gravity_by_arm.then_some(self.config.arm),
            law: UnifiedForceImpedance::new(
                self.config.arm,
                self.config.flange_from_tool,
                self.config.limits,
                &law,
                &task,
                DELAY_PERIODS,
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
    active: usize,
    cause: SwitchCause,
    switches: u32,
    patience_s: f64,
    /// The arm's model, where the arm adds what holds it against gravity itself.
    weighed: Option<Arm<7>>,
}

impl UnifiedProgram {
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
        // Silence of the one in use takes the next that speaks; what each says of itself, the law judges.
        let newest: ArrayVec<_, MAX_ESTIMATORS> = self
            .readers
            .iter_mut()
            .map(|reader| read_estimate(reader, input.arm))
            .collect();
        let speaks = |i: usize| {
            let estimate = newest.get(i).copied().flatten();
            estimate.filter(|e| e.age_s <= self.patience_s)
        };
        if speaks(self.active).is_none()
            && let Some(other) = (0..newest.len()).find(|i| speaks(*i).is_some())
        {
            self.active = other;
            self.cause = SwitchCause::FellBack(Validity::Stale);
            self.switches += 1;
        }
        let touch = speaks(self.active);
        let wrench = &input.wrench;
        let vision = self.look(input);
        let q = joints(&input.arm.q).ok()?;
        let output = self.law.step(&UnifiedInput {
            time_s: input.time_s,
            dt_s: input.arm.period_s,
            q,
            qd: joints(&input.arm.qd).ok()?,
            arm_ready: input.arm_ready,
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            vision,
            touch: touch.map(|t| t.estimate),
            touch_age_s: touch.map_or(f64::INFINITY, |t| t.age_s),
        });
        let torque = match &self.weighed {
            Some(arm) => output.torque - arm.gravity(&q),
            None => output.torque,
        };
        let (what, why) = self.cause.text();
        let name = self.readers.get(self.active).map(|reader| reader.name);
        Some(TorqueAnswer {
            torque: joint_array(&torque),
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
            estimator: (
                name.unwrap_or_default(),
                self.switches,
                cut_format(format_args!("{what}{why}")),
            ),
        })
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.law.pause(paused)
    }

    fn stop(&mut self) {
        self.law.stop();
    }

    fn select(&mut self, name: &EstimatorName, _force: bool) -> Result<(), SwitchRefusal> {
        let index = self
            .readers
            .iter()
            .position(|reader| reader.name == *name)
            .ok_or(SwitchRefusal::Unknown)?;
        if index != self.active {
            // The law fuses what it is given by covariance and turns at a bounded rate: a newcomer that is wrong is gated there.
            self.active = index;
            self.cause = SwitchCause::Asked;
            self.switches += 1;
        }
        Ok(())
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
