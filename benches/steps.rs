//! Each step of a cell by itself, on the inputs of a whole simulated wipe: what
//! `tangent bench steps` times once, with criterion's statistics and its comparison with the run
//! before.
//!
//! ```sh
//! cargo bench --bench steps                 # all of them
//! cargo bench --bench steps -- estimator    # those with this word in their names
//! ```

// The macro writes a function without documentation.
#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{UnitQuaternion, Vector3, Vector6};
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
use tangent_simulation::karacan::{replay, step_inputs};
use tangent_simulation::{
    ClosedLoop, ObjectLoop, ObjectScenario, Plant, PoseConfig, Scenario, ShapeConfig, Surface,
    TactileLoop, TactileScenario,
};

const PIPE: &str = include_str!("../scenarios/pipe_realistic.toml");
const OBJECT: &str = include_str!("../scenarios/lippiello/lippiello_realistic.toml");
const WAVE: &str = include_str!("../scenarios/karacan/karacan_wave.toml");

fn pipe() -> Scenario {
    Scenario::parse("pipe_realistic", PIPE, &[], &|_| Err(String::new())).unwrap()
}

fn wave() -> TactileScenario {
    TactileScenario::parse("karacan_wave", WAVE, &[]).unwrap()
}

/// What controller and estimators read during the wipe.
fn inputs(scenario: &Scenario) -> (Vec<ControlInput>, Vec<ContactSample>) {
    let (mut control, mut contact) = (Vec::new(), Vec::new());
    let mut commanded = None;
    tangent_simulation::evaluate_with(scenario, |cycle| {
        let i = cycle.input;
        control.push(*i);
        contact.push(ContactSample {
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
    })
    .unwrap();
    (control, contact)
}

fn sensing(c: &mut Criterion) {
    let scenario = pipe();
    let plant = Plant::new(&scenario.plant, scenario.seed).unwrap();
    let tool = &scenario.plant.tool;
    let payload = Payload {
        mass_kg: tool.payload.mass_kg,
        com_in_sensor_m: tool.payload.com_in_sensor_m,
        inertia_kg_m2: tool.payload.inertia_kg_m2,
    };
    let sensor_from_tool = plant.flange_from_sensor().inverse() * plant.flange_from_tool();
    let rate_hz = scenario.plant.sensor.rate_hz;
    let conditioner =
        WrenchConditioner::new(&scenario.sensing, &payload, sensor_from_tool, rate_hz).unwrap();
    let mut state = WrenchConditionerState::default();
    let pose = plant.model().base_from_flange(&plant.arm().q) * plant.flange_from_tool();
    let mut record = 0.0;
    c.bench_function("wrench conditioning, one record", |b| {
        b.iter(|| {
            record += 1.0;
            let time_s = record / rate_hz;
            let reading = Reading {
                time_s,
                wrench: Wrench::from_vector(&Vector6::repeat((time_s * 7.0).sin())),
                condition: SensorCondition::Good,
                missed: 0,
                base_from_tool: Some((pose, 0.001)),
                motion: None,
            };
            conditioner.update(&mut state, &reading)
        });
    });
}

fn estimators(c: &mut Criterion) {
    let scenario = pipe();
    let (_, contact) = inputs(&scenario);
    for name in estimator_names() {
        let mut estimator = build(name, &scenario.estimation).unwrap();
        let mut next = 0;
        c.bench_function(&format!("estimator {name}"), |b| {
            b.iter(|| {
                if next == contact.len() {
                    estimator.reset();
                    next = 0;
                }
                next += 1;
                estimator.update(&contact[next - 1])
            });
        });
    }
}

fn laws(c: &mut Criterion) {
    let scenario = pipe();
    let (control, _) = inputs(&scenario);
    let plant = Plant::new(&scenario.plant, scenario.seed).unwrap();
    let tool = plant.flange_from_tool();
    let mut cycles = control.iter().cycle();
    c.bench_function("forward kinematics and Jacobian", |b| {
        b.iter(|| {
            let input = cycles.next().unwrap();
            plant.model().tool_and_jacobian(&input.q, &tool)
        });
    });
    let config = scenario.controller_config().unwrap();
    let mut task = scenario.task.clone();
    task.controller = None;
    c.bench_function("law hybrid_admittance", |b| {
        b.iter_custom(|iterations| {
            let mut spent = Duration::ZERO;
            let mut left = iterations;
            while left > 0 {
                let mut law =
                    Controller::new(*plant.model(), tool, scenario.limits, config).unwrap();
                law.start(Program::new(&task, &config).unwrap(), 1).unwrap();
                let cycles = control.len().min(left as usize);
                let begin = Instant::now();
                for input in &control[..cycles] {
                    black_box(law.step(input));
                }
                spent += begin.elapsed();
                left -= cycles as u64;
            }
            spent
        });
    });
    let scenario = wave();
    let inputs = step_inputs(&scenario).unwrap();
    c.bench_function("law unified_force_impedance", |b| {
        b.iter_custom(|iterations| {
            let mut spent = Duration::ZERO;
            let mut left = iterations as usize;
            while left > 0 {
                let cycles = inputs.len().min(left);
                replay(&scenario, &inputs[..cycles], |step| {
                    let begin = Instant::now();
                    step();
                    spent += begin.elapsed();
                })
                .unwrap();
                left -= cycles;
            }
            spent
        });
    });
}

/// Frames from half a metre over a waved sheet: the surface at the tool with its map ahead, and a
/// normal for every pixel.
fn depth_normal(c: &mut Criterion) {
    let shape = ShapeConfig::Sheet {
        amplitude_m: [0.0, 0.02],
        wavelength_m: [1.0, 0.38],
    };
    let surface = Surface::new(&shape, &PoseConfig::default()).unwrap();
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.1, 0.0);
    let over = Pose::new(Vector3::new(0.0, 0.0, 0.5), down);
    for size_px in [[640, 480], [848, 480]] {
        let config = DepthCameraConfig {
            image_px: size_px,
            ..DepthCameraConfig::default()
        };
        let mut camera = DepthCamera::new(&config, &Pose::identity(), 1).unwrap();
        let frame = camera.picture(0.0, 0, &over, &surface);
        let mut depth_m = Vec::new();
        metres_from_millimetres(&frame.depth_mm, &mut depth_m);
        let image = DepthImage::new(frame.width, frame.height, &depth_m).unwrap();
        let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
        let mut state = DepthNormalState::default();
        let sample = DepthSample {
            time_s: 0.0,
            image,
            intrinsics: frame.intrinsics,
            target: ToolTarget::Pixel(size_px.map(|n| 0.5 * n as f64)),
            left_out: None,
            travel: Some(Vector3::x()),
        };
        let [width, height] = size_px;
        c.bench_function(
            &format!("depth_normal, one frame {width} x {height}"),
            |b| {
                b.iter(|| black_box(step.update(&mut state, &sample)));
            },
        );
        let mut normals = vec![[0.0; 3]; depth_m.len()];
        let name = format!("depth_normal, a normal for every pixel {width} x {height}");
        c.bench_function(&name, |b| {
            b.iter(|| black_box(step.normals(&state, &image, &mut normals)));
        });
    }
}

/// Plant, sensing, estimators and law of each system together, one cycle.
fn closed_loops(c: &mut Criterion) {
    let mut pipe = ClosedLoop::new(&pipe()).unwrap();
    c.bench_function("closed loop pipe_realistic", |b| {
        b.iter(|| pipe.step(&mut |_| ()));
    });
    let object = ObjectScenario::parse("lippiello_realistic", OBJECT, &[]).unwrap();
    let mut object = ObjectLoop::new(&object).unwrap();
    c.bench_function("closed loop lippiello_realistic", |b| {
        b.iter(|| object.step(&mut tangent_simulation::Undisturbed, &mut |_| ()));
    });
    let mut wave = TactileLoop::new(&wave()).unwrap();
    c.bench_function("closed loop karacan_wave", |b| {
        b.iter(|| wave.step(&mut tangent_simulation::Calm, &mut |_| ()));
    });
}

criterion_group! {
    name = steps;
    config = Criterion::default()
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2));
    targets = sensing, estimators, laws, depth_normal, closed_loops
}
criterion_main!(steps);
