//! Tasks of `unified_force_impedance`: made ready for the loop, with the estimators of normals that
//! they name.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use tangent_control::{
    BendChange, Clearance, ControlError, EstimatorName, MAX_ESTIMATORS, Path, Phase, SwitchRefusal,
    Task, UnifiedForceImpedance, UnifiedInput, UnifiedOutput, VisionInput,
};
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::convert::{cut_format, joint_array, joints};
use tangent_schemas::tangent::{
    ControlState, NormalEstimate, ShapingState, SurfaceAhead, SurfaceSegment,
};
use tangent_schemas::topics;

use super::choice::{Choice, rules};
use super::config::UnifiedConfig;
use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use super::runner::Boxed;
use crate::inputs::{EstimateReader, age_told, normal_estimate, read_estimate};
use crate::mailbox::{Mailbox, Time};
use crate::messages::{no_wrench, tell_ages};
use crate::requests::{Kind, one_speaks};
use crate::runner::Report;
use crate::start_check::StartCheck;

/// Prepares tasks outside the loop.
pub struct Unified {
    bus: Bus,
    config: UnifiedConfig,
    check: StartCheck<7>,
}

impl Unified {
    /// For the cell's arm.
    ///
    /// # Errors
    /// Where `arm/state` cannot be read.
    pub fn new(bus: &Bus, config: UnifiedConfig) -> Result<Self, BusError> {
        Ok(Self {
            check: StartCheck::new(
                bus,
                config.arm,
                config.flange_from_tool,
                config.limits,
                config.estimators.clone(),
            )?,
            bus: bus.clone(),
            config,
        })
    }

    fn program(&self, text: &str) -> Result<UnifiedProgram, String> {
        let words = |e: ControlError| e.to_string();
        let task: Task = text.parse().map_err(words)?;
        let law = self.config.law(task.controller.as_deref()).map_err(words)?;
        let bounds = &law.path;
        let path = Path::new(
            &task.path,
            bounds.acceleration_m_per_s2,
            bounds.jerk_m_per_s3,
        );
        self.check.task(&task, &path.map_err(words)?)?;
        self.check
            .estimators(&self.bus, &task.estimators, topics::estimate_normal)?;
        self.program_of(&task)
    }

    /// The law with what it reads; nothing is checked that depends on where the arm stands.
    fn program_of(&self, task: &Task) -> Result<UnifiedProgram, String> {
        let words = |e: ControlError| e.to_string();
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
        let rules = rules(&law.patience, &task.switching, true);
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
            choice: Choice::new(names, rules),
            normal: None,
            patience_s: law.patience.estimate_s,
            law: UnifiedForceImpedance::new(
                self.config.arm,
                self.config.flange_from_tool,
                self.config.limits,
                &law,
                task,
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

    fn leave(&self) -> Result<Boxed, String> {
        Ok(Box::new(self.program_of(&self.check.leave())?))
    }

    fn check_estimates(&self, program: &Boxed, _: &Mailbox<Boxed>, _: Time) -> Result<(), String> {
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
    choice: Choice,
    /// In use in the cycle before, base axes.
    normal: Option<Vector3<f64>>,
    patience_s: f64,
}

impl UnifiedProgram {
    /// The newest frame. It is about a moment ago, which its arm state tells; the law places it
    /// there, and sees when it grows old.
    fn look(&mut self, input: &TorqueInput<'_>) -> Option<VisionInput> {
        if let Some(new) = self.frames.take_new() {
            let seen = normal_estimate(&new.message);
            // Said just before the normal of the same image; what was lost on the way is done
            // without.
            let cycle = new.message.cycle;
            self.segments.refresh();
            let segment = self.segments.get().map(|segment| &segment.message);
            let surface_variation = segment
                .filter(|segment| segment.cycle == cycle)
                .map(|segment| segment.surface_variation);
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

    fn check_start(
        &self,
        clearance: &Clearance,
        position: &Vector3<f64>,
    ) -> Result<(), ControlError> {
        self.law.check_start(clearance, position)
    }

    fn begin(&mut self, clearance: Clearance) {
        self.law.begin(clearance);
    }

    fn step(&mut self, input: &TorqueInput<'_>) -> Option<TorqueAnswer> {
        let way_m = input.slid_m(self.law.phase());
        let said = self
            .readers
            .iter_mut()
            .map(|reader| read_estimate(reader, input.arm, input.since_packet));
        let touch = self.choice.step(said, self.normal, way_m, input.dt_s);
        let touch = touch.filter(|e| e.age_s <= self.patience_s);
        let wrench = &input.wrench;
        let vision = self.look(input);
        let output = self.law.step(&UnifiedInput {
            time_s: input.time_s,
            dt_s: input.dt_s,
            q: joints(&input.arm.q).ok()?,
            qd: joints(&input.arm.qd).ok()?,
            arm_ready: input.arm_ready,
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            untared: wrench.untared,
            vision,
            touch: touch.map(|t| t.estimate),
            touch_age_s: touch.map_or(f64::INFINITY, |t| t.age_s),
        });
        // Until the tare is done the law may stand on no estimate at all.
        let goes_by_it = output.phase.is_active() && output.phase != Phase::Tare;
        self.normal = goes_by_it.then_some(output.normal);
        let (name, switches, cause) = self.choice.in_use();
        let (what, why) = cause.text();
        let mut state = state(&output, input, touch.map(|t| t.age_s));
        tell_ages(&mut state, self.choice.ages());
        Some(TorqueAnswer {
            torque: joint_array(&output.torque),
            report: Report {
                state,
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
                clearance: output.clearance,
                zero_withdrawn: false,
                estimator: Some((name, switches, cut_format(format_args!("{what}{why}")))),
            },
        })
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.law.pause(paused)
    }

    fn is_left_on_surface(&self) -> bool {
        self.law.is_left_on_surface()
    }

    fn leave_surface(&mut self) {
        self.law.leave_surface();
    }

    fn is_paused(&self) -> bool {
        self.law.is_paused()
    }

    fn stop(&mut self) {
        self.law.stop();
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        self.choice.select(name, force)
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
    ControlState {
        normal: (&output.normal).into(),
        force_reference_n: output.force_reference_n,
        force_n: output.force_n.unwrap_or(f64::NAN),
        wrench: (&output.wrench.unwrap_or(no_wrench())).into(),
        path_reference: (&output.path_reference).into(),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: age_told(Some(input.wrench.age_s)),
        estimate_age_s: age_told(estimate_age_s),
        motion_tank_j: output.tanks.motion_j,
        force_tank_j: output.tanks.force_j,
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        wrench_validity: input.wrench.validity as u8,
        zero_age_s: output.zero_age_s.unwrap_or(-1.0),
        zero_bound_n: output.zero_age_s.and(output.zero_bound_n).unwrap_or(-1.0),
        ..ControlState::default()
    }
}
