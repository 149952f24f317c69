//! One draw of the suite: a scenario from the suite's seed, the surface and a number.

use std::fmt;

use nalgebra::Vector3;
use tangent_control::{
    Circle, Direction, ForceSpec, Limits, Line, PathSpec, PlaneSpec, Raster, Task, Tolerances,
};
use tangent_estimation::EstimatorConfig;
use tangent_mechanics::Tip;

use super::conditions::Conditions;
use super::dice::Dice;
use super::placement::{Crossing, Placement};
use super::ranges;
use super::surface_kind::SurfaceKind;
use crate::arms::servo::{Lag, ServoConfig};
use crate::contact::{ComplianceConfig, ContactConfig, FrictionConfig, FrictionVariation};
use crate::hardware_errors::{ArmErrors, FrameErrors, HardwareErrors, WrenchErrors};
use crate::scenario_file::{ScenarioError, no_files};
use crate::sensors::arm_force::ArmForceConfig;
use crate::sensors::force_torque::SensorConfig;
use crate::systems::admittance::{AdmittancePlantConfig, AdmittanceScenario, PipelineConfig};
use crate::tool::{PayloadConfig, PayloadErrorConfig, ToolConfig};

/// One draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// Seed of the suite.
    pub seed: u64,
    /// Surface.
    pub surface: SurfaceKind,
    /// Number of the draw, from 0.
    pub number: u64,
    /// Cell and task.
    pub scenario: AdmittanceScenario,
    /// Whether the path leaves the surface, so that the task has to end early.
    pub leaves_surface: bool,
}

impl Draw {
    /// The draw with single values changed, `key=value` with dotted keys as in a scenario: another
    /// law, another estimator, one error more or less.
    ///
    /// # Errors
    /// The override is not usable; the error says why.
    pub fn with_overrides(self, overrides: &[String]) -> Result<Self, ScenarioError> {
        if overrides.is_empty() {
            return Ok(self);
        }
        let name = &self.scenario.name;
        let text = toml::to_string(&self.scenario).map_err(|error| ScenarioError::Text {
            file: name.clone(),
            message: error.to_string(),
        })?;
        let scenario = AdmittanceScenario::parse(name, &text, overrides, &no_files)?;
        Ok(Self { scenario, ..self })
    }

    /// What the suite's second table tells apart.
    pub fn conditions(&self) -> Conditions {
        let scenario = &self.scenario;
        let (plant, task) = (&scenario.plant, &scenario.task);
        Conditions {
            reference_n: task.force.reference_n,
            stiffness_kn_per_m: plant.contact.stiffness_n_per_m / 1e3,
            tip: plant.tool.tip.as_ref().map_or("pad", Tip::name),
            stated_tip: scenario.estimation.contact.tip.name(),
            landed_deg: plant.start.tilt_rad.to_degrees(),
            friction: plant.contact.friction.coulomb_coefficient,
            speed_mm_per_s: task.path.speed_m_per_s() * 1e3,
            robot: plant.robot.clone(),
        }
    }
}

impl fmt::Display for Draw {
    /// What was drawn, in a few lines.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plant = &self.scenario.plant;
        let drawn = self.conditions();
        let tip = |tip: &Tip| match tip.radius_m() {
            Some(radius_m) => format!("{} {:.1} mm", tip.name(), radius_m * 1e3),
            None => tip.name().to_owned(),
        };
        writeln!(
            f,
            "draw {} on {}, seed {}: {} at {:.0} Hz",
            self.number,
            self.surface.name(),
            self.seed,
            drawn.robot,
            1.0 / plant.arm.period_s
        )?;
        writeln!(
            f,
            "  {:.1} kN/m, friction {:.2}, {:.1} N, landed {:.1} deg off",
            drawn.stiffness_kn_per_m, drawn.friction, drawn.reference_n, drawn.landed_deg
        )?;
        write!(
            f,
            "  tip {}, stated as {}",
            plant.tool.tip.as_ref().map_or_else(String::new, tip),
            tip(&self.scenario.estimation.contact.tip)
        )
    }
}

/// The draw `number` on a surface, of the suite with a seed. Equal arguments give equal draws.
pub fn draw(surface: SurfaceKind, number: u64, seed: u64) -> Draw {
    let mut dice = Dice::new(seed, surface, number);
    let (tip, stated_tip) = tips(&mut dice);
    let stiffness = dice.within_log(ranges::STIFFNESS_N_PER_M_LOG);
    let force_n = dice.within_log(ranges::FORCE_N_LOG);
    let speed = dice.within(ranges::SPEED_M_PER_S);
    let length =
        (speed * dice.within(ranges::PATH_S)).clamp(ranges::LENGTH_M.0, ranges::LENGTH_M.1);
    let fast = dice.chance(0.5);
    let robot = if fast { "ur5e" } else { "ur5" };
    let tool = tool(&mut dice, tip, stiffness, force_n);
    let contact = contact(&mut dice, stiffness);
    let arm = arm(&mut dice, fast);
    let sensor = SensorConfig {
        drift_n: dice.within(ranges::DRIFT_N),
        ..SensorConfig::gamma()
    };
    let errors = errors(&mut dice);
    let path = path(&mut dice, surface, length, speed);
    let landed = (dice.within(ranges::LANDED_RAD), dice.angle());
    let place = Placement::draw(&mut dice, surface, robot, &tool, &path, landed);
    let start = place.start(landed);
    let plant = AdmittancePlantConfig {
        robot: robot.to_owned(),
        arm,
        substep_max_s: 0.001,
        surface: place.surface,
        tool,
        contact,
        sensor,
        arm_force: ArmForceConfig::default(),
        errors,
        start,
        base: None,
        depth_camera: None,
    };
    let mut estimation = EstimatorConfig::default();
    estimation.contact.tip = stated_tip;
    let scenario = AdmittanceScenario {
        name: format!("{}_{number}", surface.name()),
        title: String::new(),
        seed: dice.next_seed(),
        duration_s: 600.0,
        controller: "default".to_owned(),
        control: toml::Table::new(),
        limits: Limits {
            // A cell that presses with 30 N has limits above that.
            force_max_n: Limits::default().force_max_n.max(2.5 * force_n),
            ..Limits::default()
        },
        estimation,
        sensing: Default::default(),
        base: Default::default(),
        pipeline: PipelineConfig::default(),
        plant,
        task: task(force_n, path, place.x_axis),
    };
    Draw {
        seed,
        surface,
        number,
        scenario,
        leaves_surface: place.crossing == Crossing::Leaves,
    }
}

/// The true tip and the stated one.
fn tips(dice: &mut Dice) -> (Tip, Tip) {
    let kind = dice.one_of(4);
    let radius_m = dice.within(if kind == 0 {
        ranges::ROUND_M
    } else {
        ranges::PAD_M
    });
    let tip = match kind {
        0 => Tip::Round { radius_m },
        1 => Tip::Flat { radius_m },
        2 => Tip::Ring { radius_m },
        _ => Tip::Soft { radius_m },
    };
    let unknown = dice.chance(ranges::UNKNOWN_SHARE);
    (tip, if unknown { Tip::Unknown } else { tip })
}

fn tool(dice: &mut Dice, tip: Tip, stiffness: f64, force_n: f64) -> ToolConfig {
    // Surface and tip give by no more than a tip does; a softer cell is soft in tool and wrist.
    let stiffest = ranges::TIP_OVER_CELL_LOG;
    let of_tip = (stiffness * dice.within_log(stiffest)).max(force_n / ranges::DENT_MAX_M);
    let along = 1.0 / (1.0 / stiffness - 1.0 / of_tip);
    let across = (along * dice.within(ranges::ACROSS_OVER_ALONG)).max(force_n / ranges::GIVE_MAX_M);
    let turning = dice.within_log(ranges::TURNING_NM_PER_RAD_LOG);
    let soft = dice.within_log(ranges::SOFT_STIFFNESS_N_PER_M_LOG);
    ToolConfig {
        tip: Some(tip),
        soft_stiffness_n_per_m: soft.max(force_n / ranges::SOFT_DENT_MAX_M),
        compliance: Some(ComplianceConfig {
            stiffness_n_per_m: [across, across, along],
            stiffness_nm_per_rad: [turning; 3],
            relaxation_s: 0.003,
        }),
        payload: PayloadConfig {
            mass_kg: dice.within(ranges::PAYLOAD_KG),
            ..PayloadConfig::default()
        },
        payload_error: PayloadErrorConfig {
            mass_kg: dice.either_sign(ranges::PAYLOAD_ERROR_KG),
            com_in_sensor_m: [0; 3].map(|_| dice.either_sign(ranges::COM_ERROR_M)),
        },
        ..ToolConfig::default()
    }
}

fn contact(dice: &mut Dice, stiffness_n_per_m: f64) -> ContactConfig {
    let coulomb_coefficient = dice.within(ranges::FRICTION);
    ContactConfig {
        stiffness_n_per_m,
        friction: FrictionConfig {
            coulomb_coefficient,
            static_coefficient: coulomb_coefficient * dice.within(ranges::STATIC_RATIO),
            ..FrictionConfig::default()
        },
        ..ContactConfig::default()
    }
}

fn arm(dice: &mut Dice, fast: bool) -> ServoConfig {
    let (low, high) = ranges::DELAY_CYCLES;
    let cycles = low + dice.one_of(high - low + 1);
    let servo = if fast {
        ServoConfig::e_series()
    } else {
        ServoConfig::cb3()
    };
    ServoConfig {
        input_delay_cycles: cycles - PipelineConfig::default().exchange_cycles,
        lag: Lag::SecondOrder {
            natural_frequency_rad_per_s: std::f64::consts::TAU * dice.within(ranges::SERVO_HZ),
            damping_ratio: dice.within(ranges::SERVO_DAMPING),
        },
        encoder_resolution_rad: 1e-5,
        velocity_resolution_rad_per_s: 1e-4,
        ..servo
    }
}

fn errors(dice: &mut Dice) -> HardwareErrors {
    let coloured_n = dice.within(ranges::COLOURED_N);
    let tilt = dice.within(ranges::TIP_TILT_RAD);
    let (sin, cos) = dice.angle().sin_cos();
    HardwareErrors {
        frames: FrameErrors {
            tip_position_m: ranges::TIP_POSITION_M.map(|size| dice.either_sign(size)),
            tip_rotation_rad: [tilt * cos, tilt * sin, 0.0],
            sensor_rotation_rad: dice.vector(ranges::SENSOR_ROTATION_RAD),
        },
        arm: ArmErrors {
            bandwidth_ratio: [0; 6].map(|_| dice.within(ranges::BANDWIDTH_RATIO)),
            velocity_noise_rad_per_s: dice.within_log(ranges::VELOCITY_NOISE_RAD_PER_S_LOG),
            ripple_rad: dice.within(ranges::RIPPLE_RAD),
            offset_rad: [0; 6].map(|_| dice.either_sign(ranges::JOINT_OFFSET_RAD)),
            ..ArmErrors::default()
        },
        wrench: WrenchErrors {
            coloured_n,
            coloured_nm: coloured_n * ranges::COLOURED_LEVER_M,
            correlation_s: dice.within_log(ranges::CORRELATION_S_LOG),
            vibration_n: dice.within(ranges::VIBRATION_N),
            vibration_hz: dice.within(ranges::VIBRATION_HZ),
            cross_talk: dice.within(ranges::CROSS_TALK),
            latency_s: dice.within(ranges::LATENCY_S),
            cable_n_per_rad: dice.within(ranges::CABLE_N_PER_RAD),
        },
        friction: Some(FrictionVariation {
            relative: dice.within(ranges::FRICTION_VARIATION),
            wavelength_m: dice.within(ranges::FRICTION_WAVELENGTH_M),
        }),
    }
}

/// A raster, a circle or strokes of `length` m in all. Where something lies across the path, it is
/// strokes across it.
fn path(dice: &mut Dice, surface: SurfaceKind, length: f64, speed_m_per_s: f64) -> PathSpec {
    let pause_s = dice.within((0.0, 0.5));
    let feature = matches!(
        surface,
        SurfaceKind::Step | SurfaceKind::Gap | SurfaceKind::Edge | SurfaceKind::Seam
    );
    let kind = if feature { 2 } else { dice.one_of(3) };
    match kind {
        0 => {
            // Two strokes and the step between them.
            let step = (0.15 * length).min(0.03);
            let step_m = if dice.chance(0.5) { step } else { -step };
            PathSpec::Raster(Raster {
                length_m: (0.5 * (length - step)).min(0.12),
                step_m,
                lines: 2,
                speed_m_per_s,
                pause_s,
                duration_s: 0.0,
            })
        }
        1 => {
            let radius_m = (length / std::f64::consts::TAU).clamp(0.012, 0.04);
            let turns = (length / (std::f64::consts::TAU * radius_m)).clamp(0.5, 2.0);
            PathSpec::Circle(Circle {
                radius_m,
                turns: if dice.chance(0.5) { turns } else { -turns },
                speed_m_per_s,
            })
        }
        _ => {
            let strokes = if length > 0.12 || dice.chance(0.5) {
                2
            } else {
                1
            };
            let reach = (length / f64::from(strokes)).min(0.12);
            let slant = dice.either_sign(0.3);
            PathSpec::Line(Line {
                to_m: [reach, reach * slant],
                speed_m_per_s,
                strokes,
                pause_s,
            })
        }
    }
}

fn task(force_n: f64, path: PathSpec, x_axis: Vector3<f64>) -> Task {
    Task {
        force: ForceSpec::constant(force_n),
        path,
        plane: PlaneSpec {
            x_axis: Direction::Vector(x_axis.into()),
        },
        name: "suite".to_owned(),
        tare: true,
        tolerances: Tolerances::default(),
        learning: None,
        only_leaves: false,
        ..Task::leave(force_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_those_of_the_run() {
        let overrides = [
            "task.force.reference_n=7",
            "plant.contact.stiffness_n_per_m=20000",
            "task.path={kind='line',to_m=[0.1,0.0],speed_m_per_s=0.04}",
            "estimation.contact.tip={shape='unknown'}",
        ];
        let draw = draw(SurfaceKind::Plane, 0, 1)
            .with_overrides(&overrides.map(str::to_owned))
            .unwrap();
        let conditions = draw.conditions();
        assert_eq!(conditions.reference_n, 7.0);
        assert_eq!(conditions.stiffness_kn_per_m, 20.0);
        assert_eq!(conditions.speed_mm_per_s, 40.0);
        assert_eq!(conditions.stated_tip, "unknown");
        assert_eq!(
            Some(conditions.tip),
            draw.scenario.plant.tool.tip.as_ref().map(Tip::name)
        );
        let text = draw.to_string();
        assert!(text.ends_with("stated as unknown"), "{text}");
    }
}
