//! Checks the ranges of the plant's numbers.

use super::plant_config::AdmittancePlantConfig;
use crate::arms::servo::DELAY_CYCLES_MAX;
use crate::arms::servo::Lag;
use crate::plant_error::PlantError;

pub(super) fn check(config: &AdmittancePlantConfig) -> Result<(), PlantError> {
    let value = PlantError::unless;
    let (arm, contact, sensor, tool) = (&config.arm, &config.contact, &config.sensor, &config.tool);
    value(
        "arm.period_s",
        arm.period_s,
        "0.0005 to 0.1 s",
        (5e-4..=0.1).contains(&arm.period_s),
    )?;
    value(
        "arm.input_delay_cycles",
        arm.input_delay_cycles as f64,
        "0 to 31",
        arm.input_delay_cycles < DELAY_CYCLES_MAX,
    )?;
    value(
        "arm.acceleration_max_rad_per_s2",
        arm.acceleration_max_rad_per_s2,
        "above 0",
        arm.acceleration_max_rad_per_s2 > 0.0,
    )?;
    match arm.lag {
        Lag::FirstOrder { time_constant_s: t } => {
            value("arm.lag.time_constant_s", t, "above 0", t > 0.0)?;
        }
        Lag::SecondOrder {
            natural_frequency_rad_per_s: w,
            damping_ratio: z,
        } => {
            value("arm.lag.natural_frequency_rad_per_s", w, "above 0", w > 0.0)?;
            value("arm.lag.damping_ratio", z, "above 0", z > 0.0)?;
        }
    }
    value(
        "substep_max_s",
        config.substep_max_s,
        "0.00001 to 0.002 s",
        (1e-5..=2e-3).contains(&config.substep_max_s),
    )?;
    config.errors.check()?;
    config.arm_force.check()?;
    contact.check_stiffness()?;
    value(
        "contact.exponent",
        contact.exponent,
        "1 to 2",
        (1.0..=2.0).contains(&contact.exponent),
    )?;
    value(
        "contact.dissipation_s_per_m",
        contact.dissipation_s_per_m,
        "0 or above",
        contact.dissipation_s_per_m >= 0.0,
    )?;
    let friction = &contact.friction;
    value(
        "contact.friction.coulomb_coefficient",
        friction.coulomb_coefficient,
        "above 0 to 2 (use model = \"none\" for a frictionless surface)",
        friction.coulomb_coefficient > 0.0 && friction.coulomb_coefficient <= 2.0,
    )?;
    value(
        "contact.friction.static_coefficient",
        friction.static_coefficient,
        "at least coulomb_coefficient",
        friction.static_coefficient >= friction.coulomb_coefficient,
    )?;
    value(
        "contact.friction.stribeck_m_per_s",
        friction.stribeck_m_per_s,
        "above 0",
        friction.stribeck_m_per_s > 0.0,
    )?;
    value(
        "contact.friction.bristle_stiffness_per_m",
        friction.bristle_stiffness_per_m,
        "above 0",
        friction.bristle_stiffness_per_m > 0.0,
    )?;
    sensor.check()?;
    value(
        "sensor.drift_time_constant_s",
        sensor.drift_time_constant_s,
        "above 0",
        sensor.drift_time_constant_s > 0.0,
    )?;
    value(
        "tool.pad.radius_m",
        tool.pad.radius_m,
        "0 to 0.1",
        (0.0..=0.1).contains(&tool.pad.radius_m),
    )?;
    value(
        "tool.pad.rings",
        tool.pad.rings as f64,
        "0 to 8",
        tool.pad.rings <= 8,
    )?;
    if let Some(tip) = tool.tip {
        value(
            "tool.tip.radius_m",
            tip.radius_m().unwrap_or_default(),
            "0 to 0.1",
            (0.0..=0.1).contains(&tip.radius_m().unwrap_or_default()),
        )?;
    }
    value(
        "tool.soft_stiffness_n_per_m",
        tool.soft_stiffness_n_per_m,
        "10 to 100000 N/m",
        (10.0..=1e5).contains(&tool.soft_stiffness_n_per_m),
    )?;
    let mass = tool.payload.mass_kg + tool.payload_error.mass_kg;
    value(
        "tool.payload.mass_kg (with its error)",
        mass,
        "0 to 10",
        (0.0..=10.0).contains(&mass),
    )?;
    if let Some((key, value, allowed)) = config.base.as_ref().and_then(|base| base.wrong()) {
        return Err(PlantError::Value {
            key,
            value,
            allowed,
        });
    }
    if let Some(camera) = &config.depth_camera {
        camera.check()?;
        if config.base.is_some() {
            return Err(PlantError::CameraOnPlatform);
        }
    }
    if let Some(compliance) = &tool.compliance {
        let z = compliance.stiffness_n_per_m[2];
        value(
            "tool.compliance.stiffness_n_per_m[2]",
            z,
            "above contact.stiffness_n_per_m, which is the stiffness of tool and pad in series",
            z > contact.stiffness_n_per_m,
        )?;
        value(
            "tool.compliance.relaxation_s",
            compliance.relaxation_s,
            "above 0",
            compliance.relaxation_s > 0.0,
        )?;
        let all = compliance
            .stiffness_n_per_m
            .iter()
            .chain(&compliance.stiffness_nm_per_rad);
        for &stiffness in all {
            value(
                "tool.compliance stiffness",
                stiffness,
                "above 0",
                stiffness > 0.0,
            )?;
        }
    }
    Ok(())
}
