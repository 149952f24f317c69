//! Tests of the whole cell: weight, stiffness, energy, saturation of the sensor, and
//! reproducibility.

use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;
use tangent_mechanics::{Joints, Tip};

use super::*;
use crate::contact::{ComplianceConfig, ContactConfig, FrictionConfig, FrictionModel, PadConfig};
use crate::sensors::force_torque::SensorConfig;
use crate::start::StartConfig;
use crate::surfaces::ShapeConfig;
use crate::surfaces::SurfaceConfig;
use crate::tool::ToolConfig;

fn on_a_plane() -> AdmittancePlantConfig {
    AdmittancePlantConfig {
        robot: "ur5".to_owned(),
        arm: crate::arms::servo::ServoConfig::cb3(),
        substep_max_s: 0.001,
        surface: SurfaceConfig {
            position_m: [0.0, 0.0, 0.1],
            roll_pitch_yaw_rad: [0.0; 3],
            shape: ShapeConfig::Plane {},
        },
        tool: ToolConfig::default(),
        contact: ContactConfig::default(),
        sensor: SensorConfig::ideal(),
        start: StartConfig {
            near_m: [0.45, 0.1, 0.1],
            clearance_m: 0.001,
            tilt_rad: 0.0,
            tilt_direction_rad: 0.0,
            yaw_rad: 0.0,
            seed_rad: None,
        },
        base: None,
        depth_camera: None,
        arm_force: Default::default(),
        errors: Default::default(),
    }
}

/// Steps the plant with commands that move the tool's origin at `velocity` (base axes, m/s).
fn drive(plant: &mut AdmittancePlant, velocity: Vector3<f64>) {
    let jacobian = plant
        .arm
        .jacobian_at(&plant.joints(), &plant.flange_from_tool);
    let twist = Vector6::new(velocity.x, velocity.y, velocity.z, 0.0, 0.0, 0.0);
    let qd: Joints<6> = jacobian.lu().solve(&twist).unwrap();
    plant.step(&VelocityCommand {
        qd,
        acceleration: 10.0,
    });
}

fn rest(plant: &mut AdmittancePlant, seconds: f64) {
    for _ in 0..(seconds / plant.period_s()) as usize {
        plant.step(&VelocityCommand::hold());
    }
}

fn reading(plant: &AdmittancePlant) -> [f64; 6] {
    let counts = plant.sensor_samples().last().unwrap().counts;
    counts.map(|c| f64::from(c) / 1e6)
}

#[test]
fn it_starts_square_over_the_surface_by_the_clearance() {
    let plant = AdmittancePlant::new(&on_a_plane(), 1).unwrap();
    let truth = plant.truth();
    assert!((truth.distance_m - 0.001).abs() < 1e-9);
    assert!((truth.base_from_tool.z_axis() + truth.normal).norm() < 1e-9);
    let mut tilted = on_a_plane();
    tilted.start.tilt_rad = 0.2;
    let truth = AdmittancePlant::new(&tilted, 1).unwrap().truth();
    let angle = (-truth.base_from_tool.z_axis()).dot(&truth.normal).acos();
    assert!((angle - 0.2).abs() < 1e-9);
}

#[test]
fn at_rest_the_sensor_reads_the_weight_it_carries() {
    let mut config = on_a_plane();
    config.tool.payload_error.mass_kg = 0.02;
    let mut plant = AdmittancePlant::new(&config, 1).unwrap();
    rest(&mut plant, 0.1);
    // The tool points down, so its weight acts along the sensor's z axis, out of the tool.
    let got = reading(&plant);
    assert!((got[2] - 0.32 * 9.80665).abs() < 2e-6, "{got:?}");
    assert!(got[0].abs() < 2e-6 && got[1].abs() < 2e-6);
    assert!(got[3].abs() < 2e-6 && got[4].abs() < 2e-6);
}

#[test]
fn a_period_gives_its_samples_in_order_at_either_rate() {
    for (rate, want) in [(1000.0, 8), (7000.0, 56)] {
        let mut config = on_a_plane();
        config.sensor.rate_hz = rate;
        let mut plant = AdmittancePlant::new(&config, 1).unwrap();
        let mut last = 0.0;
        for _ in 0..1000 {
            plant.step(&VelocityCommand::hold());
            assert_eq!(plant.sensor_samples().len(), want);
            for sample in plant.sensor_samples() {
                assert!((sample.time_s - last - 1.0 / rate).abs() < 1e-9);
                last = sample.time_s;
            }
            assert!((last - plant.time_s()).abs() < 1e-9);
        }
    }
}

/// Pressing force after moving down by `depth` in 0.4 s and settling, N.
fn pressed(config: &AdmittancePlantConfig, depth: f64) -> f64 {
    let mut plant = AdmittancePlant::new(config, 1).unwrap();
    let goal = plant.truth().base_from_tool.translation().z - 0.001 - depth;
    for _ in 0..400 {
        let tool = plant.arm.base_from_flange(&plant.joints()) * plant.flange_from_tool;
        let away = goal - tool.translation().z;
        drive(
            &mut plant,
            Vector3::new(0.0, 0.0, (away * 4.0).clamp(-0.01, 0.01)),
        );
    }
    plant.truth().wrench.force.z
}

#[test]
fn the_stiffness_felt_is_the_one_configured_rigid_or_compliant() {
    for stiffness in [1_000.0, 5_000.0, 25_000.0] {
        for compliance in [None, Some(ComplianceConfig::default())] {
            let mut config = on_a_plane();
            config.contact.stiffness_n_per_m = stiffness;
            config.tool.compliance = compliance.clone();
            let force = pressed(&config, 0.0005);
            let expected = stiffness * 0.0005;
            assert!(
                (force / expected - 1.0).abs() < 0.01,
                "{stiffness} N/m, {compliance:?}: {force} N, not {expected} N"
            );
        }
    }
}

#[test]
fn friction_stays_in_its_cone_and_slides_at_its_coefficient() {
    for model in [FrictionModel::Coulomb, FrictionModel::Lugre] {
        for compliance in [None, Some(ComplianceConfig::default())] {
            let mut config = on_a_plane();
            config.contact.friction = FrictionConfig {
                model,
                ..FrictionConfig::default()
            };
            config.tool.compliance = compliance;
            let mut plant = AdmittancePlant::new(&config, 1).unwrap();
            for _ in 0..40 {
                drive(&mut plant, Vector3::new(0.0, 0.0, -0.005));
            }
            for _ in 0..250 {
                drive(&mut plant, Vector3::new(0.02, 0.01, 0.0));
                assert!(plant.truth().friction_ratio <= 0.3 + 1e-9);
            }
            let truth = plant.truth();
            assert!(truth.in_contact);
            assert!(
                (truth.friction_ratio - 0.25).abs() < 1e-3,
                "{model:?} {}",
                truth.friction_ratio
            );
            let along = truth.wrench.force - truth.normal * truth.wrench.force.dot(&truth.normal);
            assert!(along.normalize().dot(&truth.twist.linear.normalize()) < -0.999);
        }
    }
}

#[test]
fn a_pad_tilted_on_the_surface_is_turned_square() {
    let mut config = on_a_plane();
    config.start.tilt_rad = 0.1;
    config.contact.friction.model = FrictionModel::None;
    let mut plant = AdmittancePlant::new(&config, 1).unwrap();
    for _ in 0..60 {
        drive(&mut plant, Vector3::new(0.0, 0.0, -0.004));
    }
    let truth = plant.truth();
    assert!(truth.in_contact);
    // A rotation along the torque turns the tool's axis towards the surface.
    let turn = truth.wrench.torque.cross(&truth.base_from_tool.z_axis());
    assert!(turn.dot(&-truth.normal) > 0.0);
    let lever = truth.wrench.torque.norm() / truth.wrench.force.norm();
    assert!(lever > 0.001 && lever <= 0.008 + 1e-9, "lever {lever} m");
}

#[test]
fn a_single_point_has_no_torque_at_the_tool() {
    let mut config = on_a_plane();
    config.tool.pad = PadConfig {
        rings: 0,
        ..PadConfig::default()
    };
    let mut plant = AdmittancePlant::new(&config, 1).unwrap();
    for _ in 0..60 {
        drive(&mut plant, Vector3::new(0.0, 0.0, -0.004));
    }
    assert!(plant.truth().wrench.force.z > 1.0);
    assert!(plant.truth().wrench.torque.norm() < 1e-12);
}

#[test]
fn a_hard_press_saturates_the_gauges_and_says_so() {
    let mut config = on_a_plane();
    let gamma = SensorConfig::gamma();
    config.sensor.range_n = gamma.range_n;
    config.sensor.range_nm = gamma.range_nm;
    config.contact.stiffness_n_per_m = 25_000.0;
    config.contact.friction.model = FrictionModel::None;
    // A surface inclined to the tool loads a lateral axis, which saturates first.
    config.start.tilt_rad = 0.9;
    let mut plant = AdmittancePlant::new(&config, 1).unwrap();
    let mut seen = false;
    for _ in 0..200 {
        drive(&mut plant, Vector3::new(0.0, 0.0, -0.02));
        seen |= plant.sensor_samples().iter().any(|s| s.saturated);
        let plausible = plant.truth().wrench.force.norm() < 60.0;
        assert!(!(plausible && plant.sensor_samples().iter().any(|s| s.saturated)));
    }
    assert!(seen);
}

#[test]
fn equal_seeds_give_equal_bits_and_others_do_not() {
    let mut config = on_a_plane();
    config.sensor = SensorConfig::gamma();
    config.tool.compliance = Some(ComplianceConfig::default());
    let run = |seed| {
        let mut plant = AdmittancePlant::new(&config, seed).unwrap();
        let mut all = Vec::new();
        for i in 0..200 {
            let z = if i < 60 { -0.004 } else { 0.0 };
            drive(&mut plant, Vector3::new(0.01, 0.0, z));
            all.extend(plant.sensor_samples().iter().flat_map(|s| s.counts));
            all.extend(
                plant
                    .truth()
                    .wrench
                    .force
                    .iter()
                    .map(|f| f.to_bits() as i32),
            );
        }
        all
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
}

#[test]
fn bad_numbers_are_refused_with_key_and_range() {
    let error = |change: &dyn Fn(&mut AdmittancePlantConfig)| {
        let mut config = on_a_plane();
        change(&mut config);
        AdmittancePlant::new(&config, 1).unwrap_err().to_string()
    };
    assert!(error(&|c| c.robot = "ur7".to_owned()).contains("ur7"));
    assert!(
        error(&|c| c.contact.stiffness_n_per_m = f64::NAN).contains("contact.stiffness_n_per_m")
    );
    assert!(error(&|c| c.start.near_m = [3.0, 0.0, 0.1]).contains("start"));
    assert!(error(&|c| c.sensor.rate_hz = 9000.0).contains("125 to 7000"));
    assert!(
        error(&|c| c.tool.compliance = Some(ComplianceConfig {
            stiffness_n_per_m: [1e4, 1e4, 4e3],
            ..ComplianceConfig::default()
        }))
        .contains("in series")
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// The tool moves into contact, roughly along the surface and back to its start: the surface
    /// must have taken energy in total.
    #[test]
    fn a_closed_tour_never_gains_energy(speed in 0.002f64..0.03, angle in 0.0f64..std::f64::consts::TAU, tilt in -0.15f64..0.15,
                                        stiffness in 1_000.0f64..25_000.0, compliant: bool, lugre: bool) {
        let mut config = on_a_plane();
        config.contact.stiffness_n_per_m = stiffness;
        config.contact.friction.model = if lugre { FrictionModel::Lugre } else { FrictionModel::Coulomb };
        config.start.tilt_rad = tilt;
        config.tool.compliance = compliant.then(ComplianceConfig::default);
        let mut plant = AdmittancePlant::new(&config, 1).unwrap();
        let mut work = 0.0;
        let mut scale = 0.0f64;
        let mut go = |plant: &mut AdmittancePlant, velocity: Vector3<f64>, periods: usize| {
            for _ in 0..periods {
                // Sub-steps are run one by one, so that force and motion belong to the same
                // instant.
                let jacobian = plant.arm.jacobian_at(&plant.joints(), &plant.flange_from_tool);
                let twist = Vector6::new(velocity.x, velocity.y, velocity.z, 0.0, 0.0, 0.0);
                let qd: Joints<6> = jacobian.lu().solve(&twist).unwrap();
                let active = plant.servo.exchange(&VelocityCommand { qd, acceleration: 10.0 });
                for i in 0..plant.sub_steps {
                    let before = plant.touch.contact;
                    let rigid_before = plant.arm.base_from_flange(&plant.joints()) * plant.flange_from_tool;
                    plant.servo.step(&active, plant.dt);
                    plant.sub_step(plant.time_s() + i as f64 * plant.dt);
                    let rigid = plant.arm.base_from_flange(&plant.joints()) * plant.flange_from_tool;
                    let moved = rigid.translation() - rigid_before.translation();
                    let turned = small_rotation(&(rigid.rotation() * rigid_before.rotation().inverse()));
                    // At the rigid tool, on the arm's side of the spring.
                    let lever = plant.touch.motion.origin - rigid.translation();
                    let torque = plant.touch.contact.torque + lever.cross(&plant.touch.contact.force);
                    let force = (before.force + plant.touch.contact.force) * 0.5;
                    work += force.dot(&moved) + torque.dot(&turned);
                    scale = scale.max(force.norm());
                }
                plant.periods += 1;
            }
        };
        let depth = (6.0 / stiffness).min(0.003);
        let down = ((0.001 + depth) / speed / 0.008) as usize + 1;
        go(&mut plant, Vector3::new(0.0, 0.0, -speed), down);
        let along = Vector3::new(angle.cos(), angle.sin(), 0.0) * speed;
        go(&mut plant, along, 50);
        go(&mut plant, -along, 100);
        go(&mut plant, along, 50);
        go(&mut plant, Vector3::new(0.0, 0.0, speed), down + 60);
        prop_assert!(!plant.truth().in_contact);
        prop_assert!(scale > 1.0, "it never pressed");
        prop_assert!(work < 1e-6, "the surface gave {work} J");
    }
}

#[test]
fn a_tilted_ball_touches_beside_its_foremost_point_by_its_radius_times_the_sine() {
    let (radius_m, tilt) = (0.01, 0.3_f64);
    let mut config = on_a_plane();
    config.tool.tip = Some(Tip::Round { radius_m });
    config.contact.friction.model = FrictionModel::None;
    config.start.tilt_rad = tilt;
    let mut plant = AdmittancePlant::new(&config, 1).unwrap();
    let gap = 0.001 - radius_m * (1.0 - tilt.cos());
    assert!((plant.truth().distance_m - gap).abs() < 1e-9);
    for _ in 0..60 {
        drive(&mut plant, Vector3::new(0.0, 0.0, -0.004));
    }
    let truth = plant.truth();
    assert!(truth.in_contact);
    let lever = truth.wrench.torque.norm() / truth.wrench.force.norm();
    assert!((lever - radius_m * tilt.sin()).abs() < 1e-6, "{lever} m");
    let normal_in_tool = truth.base_from_tool.rotation().inverse() * truth.normal;
    let point = Tip::Round { radius_m }.contact_in_tool(&normal_in_tool);
    let arm = truth.base_from_tool.rotate(&point);
    assert!((arm.cross(&truth.wrench.force) - truth.wrench.torque).norm() < 1e-9);
}

#[test]
fn a_soft_tip_gives_in_series_with_the_contact_and_the_others_have_its_stiffness() {
    for (tip, stiffness) in [
        (Tip::Flat { radius_m: 0.01 }, 6_000.0),
        (Tip::Ring { radius_m: 0.01 }, 6_000.0),
        (Tip::Round { radius_m: 0.01 }, 6_000.0),
        (Tip::Soft { radius_m: 0.01 }, 1_200.0),
    ] {
        let mut config = on_a_plane();
        config.tool.tip = Some(tip);
        config.contact.stiffness_n_per_m = 6_000.0;
        let force = pressed(&config, 0.0005);
        let expected = stiffness * 0.0005;
        assert!((force / expected - 1.0).abs() < 0.01, "{tip:?}: {force} N");
    }
}

/// What the plant reports is what the cell file states; the truth is elsewhere.
#[test]
fn nothing_that_the_plant_tells_shows_its_errors() {
    let mut config = on_a_plane();
    config.errors.frames.tip_position_m = [0.001, -0.001, 0.002];
    config.errors.frames.tip_rotation_rad = [0.01, 0.0, 0.0];
    config.errors.frames.sensor_rotation_rad = [0.0, 0.0, 0.02];
    config.errors.arm.offset_rad = [3e-4, 0.0, 0.0, -3e-4, 0.0, 0.0];
    let plant = AdmittancePlant::new(&config, 1).unwrap();
    let stated = on_a_plane();
    assert_eq!(
        *plant.flange_from_tool().isometry(),
        stated.tool.flange_from_tool.isometry()
    );
    assert_eq!(
        *plant.flange_from_sensor().isometry(),
        stated.tool.flange_from_sensor.isometry()
    );
    // The true tool is where it should start; the measured one is not.
    let truth = plant.truth();
    assert!((truth.distance_m - 0.001).abs() < 1e-9);
    let off = plant.arm().q - plant.joints();
    assert!((off[0] - 3e-4).abs() < 1e-12 && (off[3] + 3e-4).abs() < 1e-12);
    let measured = plant.arm.base_from_flange(&plant.arm().q) * plant.flange_from_tool();
    let away = measured.translation() - truth.base_from_tool.translation();
    assert!((0.002..0.004).contains(&away.norm()), "{away}");
}

#[test]
fn a_turned_sensor_reads_the_same_load_in_its_own_axes() {
    let read = |turn: f64| {
        let mut config = on_a_plane();
        config.errors.frames.sensor_rotation_rad = [turn, 0.0, 0.0];
        let mut plant = AdmittancePlant::new(&config, 1).unwrap();
        rest(&mut plant, 0.1);
        let [fx, fy, fz, tx, ty, tz] = reading(&plant);
        (Vector3::new(fx, fy, fz), Vector3::new(tx, ty, tz))
    };
    let (straight, turned) = (read(0.0), read(0.05));
    assert!((straight.0.norm() - turned.0.norm()).abs() < 3e-6);
    assert!(
        (straight.1 - turned.1).norm() < 3e-6,
        "the payload stays where it is"
    );
    assert!((turned.0.y.atan2(turned.0.z).abs() - 0.05).abs() < 1e-5);
}

#[test]
fn errors_out_of_their_ranges_are_named() {
    let refused = |change: &dyn Fn(&mut AdmittancePlantConfig)| {
        let mut config = on_a_plane();
        change(&mut config);
        AdmittancePlant::new(&config, 1).unwrap_err().to_string()
    };
    for (text, key) in [
        (
            refused(&|c| c.errors.frames.tip_position_m[1] = 1.0),
            "errors.frames.tip_position_m",
        ),
        (
            refused(&|c| c.errors.arm.bandwidth_ratio[2] = 0.0),
            "errors.arm.bandwidth_ratio",
        ),
        (
            refused(&|c| c.errors.wrench.latency_s = 1.0),
            "errors.wrench.latency_s",
        ),
        (
            refused(&|c| c.tool.tip = Some(Tip::Flat { radius_m: -1.0 })),
            "tool.tip.radius_m",
        ),
    ] {
        assert!(text.contains(key) && text.contains("must be"), "{text}");
    }
}
