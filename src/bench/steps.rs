//! Each step of the cell by itself: the inputs of a whole simulated wipe, played to one step after
//! another.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use tangent_control::{ControlInput, Controller, Program};
use tangent_estimation::depth_normal::{
    DepthImage, DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample, ToolTarget,
    metres_from_millimetres,
};
use tangent_estimation::{ContactSample, build, estimator_names};
use tangent_mechanics::{Pose, Wrench};
use tangent_sensing::{
    Payload, Reading, SensorCondition, WrenchConditioner, WrenchConditionerState,
};
use tangent_simulation::depth_camera::{DepthCamera, DepthCameraConfig};
use tangent_simulation::karacan::{System, replay, step_inputs};
use tangent_simulation::{ClosedLoop, PoseConfig, Scenario, ShapeConfig, Surface};

use super::Row;
use crate::scenarios;

/// What the services saw during a wipe.
#[derive(Default)]
struct Inputs {
    control: Vec<ControlInput>,
    contact: Vec<ContactSample>,
}

/// Times every step.
///
/// # Errors
/// A built-in scenario that does not run, which is a defect.
pub fn run() -> Result<Vec<Row>> {
    let scenario = scenarios::load(scenarios::DEFAULT, &[])?;
    let inputs = record(&scenario)?;
    let mut rows = vec![
        conditioning(&scenario)?,
        kinematics(&scenario, &inputs)?,
        control(&scenario, &inputs)?,
    ];
    rows.push(unified_force_impedance()?);
    for name in estimator_names() {
        let mut estimator = build(name, &scenario.estimation)?;
        rows.push(timed(
            &format!("estimator {name}"),
            inputs.contact.iter(),
            |sample| {
                black_box(estimator.update(sample));
            },
        ));
    }
    rows.extend(depth_normal([640, 480])?);
    rows.extend(depth_normal([848, 480])?);
    let mut closed_loop = ClosedLoop::new(&scenario)?;
    rows.push(timed(
        "closed loop: plant, sensing, estimators, control",
        inputs.control.iter(),
        |_| {
            black_box(closed_loop.step(&mut |_| ()));
        },
    ));
    rows.into_iter()
        .collect::<Option<_>>()
        .context("the wipe had no cycles")
}

fn timed<T>(name: &str, inputs: impl Iterator<Item = T>, mut step: impl FnMut(T)) -> Option<Row> {
    let us = inputs
        .map(|input| {
            let begin = Instant::now();
            step(input);
            begin.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    Row::of(name, us)
}

fn record(scenario: &Scenario) -> Result<Inputs> {
    let mut inputs = Inputs::default();
    let mut commanded = None;
    tangent_simulation::evaluate_with(scenario, |cycle| {
        let i = cycle.input;
        inputs.control.push(*i);
        inputs.contact.push(ContactSample {
            time_s: i.time_s,
            dt_s: i.dt_s,
            base_from_tool: i.base_from_tool,
            twist: i.twist,
            twist_commanded: commanded.unwrap_or(cycle.output.twist_commanded),
            wrench: i.wrench,
            wrench_delay_s: i.wrench_delay_s,
            wrench_validity: i.wrench_validity,
            wrench_bias_age_s: i.bias_age_s,
            base: i.base,
        });
        commanded = Some(cycle.output.twist_commanded);
    })?;
    Ok(inputs)
}

fn conditioning(scenario: &Scenario) -> Result<Option<Row>> {
    let tool = &scenario.plant.tool;
    let payload = Payload {
        mass_kg: tool.payload.mass_kg,
        com_in_sensor_m: tool.payload.com_in_sensor_m,
        inertia_kg_m2: tool.payload.inertia_kg_m2,
    };
    let plant = tangent_simulation::Plant::new(&scenario.plant, scenario.seed)?;
    let sensor_from_tool = plant.flange_from_sensor().inverse() * plant.flange_from_tool();
    let rate_hz = scenario.plant.sensor.rate_hz;
    let conditioner =
        WrenchConditioner::new(&scenario.sensing, &payload, sensor_from_tool, rate_hz)?;
    let mut state = WrenchConditionerState::default();
    let pose = plant.model().base_from_flange(&plant.arm().q) * plant.flange_from_tool();
    let row = timed("wrench conditioning, one record", 0..50_000, |i| {
        let time_s = f64::from(i) / rate_hz;
        let reading = Reading {
            time_s,
            wrench: Wrench::from_vector(&nalgebra::Vector6::repeat((time_s * 7.0).sin())),
            condition: SensorCondition::Good,
            missed: 0,
            base_from_tool: Some((pose, 0.001)),
            motion: None,
        };
        black_box(conditioner.update(&mut state, &reading));
    });
    Ok(row)
}

fn kinematics(scenario: &Scenario, inputs: &Inputs) -> Result<Option<Row>> {
    let plant = tangent_simulation::Plant::new(&scenario.plant, scenario.seed)?;
    let tool = plant.flange_from_tool();
    Ok(timed(
        "forward kinematics and Jacobian",
        inputs.control.iter(),
        |input| {
            black_box(plant.model().tool_and_jacobian(&input.q, &tool));
        },
    ))
}

fn control(scenario: &Scenario, inputs: &Inputs) -> Result<Option<Row>> {
    let plant = tangent_simulation::Plant::new(&scenario.plant, scenario.seed)?;
    let config = scenario.controller_config()?;
    let mut task = scenario.task.clone();
    task.controller = None;
    let mut controller = Controller::new(
        *plant.model(),
        plant.flange_from_tool(),
        scenario.limits,
        config,
    )?;
    controller.start(Program::new(&task, &config)?, 1)?;
    Ok(timed("control law", inputs.control.iter(), |input| {
        black_box(controller.step(input));
    }))
}

/// The law with its monitor and energy tanks, over one simulated wipe by eye and touch.
fn unified_force_impedance() -> Result<Option<Row>> {
    let system = System::Ours;
    let scenario = scenarios::load_tactile(system.scenario(), &system.overrides())?
        .context("a scenario of another kind")?;
    let inputs = step_inputs(&scenario)?;
    let mut us = Vec::with_capacity(inputs.len());
    replay(&scenario, &inputs, |step| {
        let begin = Instant::now();
        step();
        us.push(begin.elapsed().as_secs_f64() * 1e6);
    })?;
    Ok(Row::of("control law unified_force_impedance", us))
}

/// Frames from half a metre over a waved sheet: the surface at the tool with its map ahead, a
/// normal for every pixel, and both.
fn depth_normal(size_px: [usize; 2]) -> Result<[Option<Row>; 3]> {
    let [width, height] = size_px;
    let shape = ShapeConfig::Sheet {
        amplitude_m: [0.0, 0.02],
        wavelength_m: [1.0, 0.38],
    };
    let surface = Surface::new(&shape, &PoseConfig::default())?;
    let config = DepthCameraConfig {
        image_px: size_px,
        ..DepthCameraConfig::default()
    };
    let mut camera = DepthCamera::new(&config, &Pose::identity(), 1)?;
    let down = nalgebra::UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.1, 0.0);
    let over = Pose::new(nalgebra::Vector3::new(0.0, 0.0, 0.5), down);
    let frame = camera.picture(0.0, 0, &over, &surface);
    let mut depth_m = Vec::new();
    metres_from_millimetres(&frame.depth_mm, &mut depth_m);
    let image = DepthImage::new(frame.width, frame.height, &depth_m).context("a whole frame")?;
    let step = DepthNormal::new(&DepthNormalConfig::default())?;
    let mut state = DepthNormalState::default();
    let sample = DepthSample {
        time_s: 0.0,
        image,
        intrinsics: frame.intrinsics,
        target: ToolTarget::Pixel(size_px.map(|n| 0.5 * n as f64)),
        left_out: None,
        travel: Some(nalgebra::Vector3::x()),
    };
    let size = format!("{width} x {height}");
    let at_tool = timed(&format!("depth_normal, one frame {size}"), 0..200, |_| {
        black_box(step.update(&mut state, &sample));
    });
    let mut normals = vec![[0.0; 3]; depth_m.len()];
    let every_pixel = timed(
        &format!("depth_normal, a normal for every pixel {size}"),
        0..200,
        |_| {
            black_box(step.normals(&state, &image, &mut normals));
        },
    );
    let whole = timed(
        &format!("depth_normal, whole frame {size}: both"),
        0..200,
        |_| {
            black_box(step.update(&mut state, &sample));
            black_box(step.normals(&state, &image, &mut normals));
        },
    );
    Ok([at_tool, every_pixel, whole])
}
