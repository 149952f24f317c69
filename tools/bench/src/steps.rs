//! Time of each processing step by itself, on the inputs of a whole simulated wipe.

use std::hint::black_box;
use std::time::Instant;

use tangent_estimation::depth_normal::{DepthNormal, DepthNormalConfig, DepthNormalState};
use tangent_estimation::{build, estimator_names};
use tangent_simulation::systems::visuo_tactile::reproduction::{replay, step_inputs};
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario};

use crate::error::BenchError;
use crate::fixtures::{self, Conditioning, DEPTH_SIZES_PX, DepthInput, Inputs, Made};
use crate::row::Row;

/// Times every step.
///
/// # Errors
/// A built-in scenario does not run, which is a defect.
pub fn run() -> Result<Vec<Row>, BenchError> {
    Ok(measured()?)
}

fn measured() -> Made<Vec<Row>> {
    let scenario = fixtures::pipe()?;
    let inputs = Inputs::of(&scenario)?;
    let mut rows = vec![
        conditioning(&scenario)?,
        kinematics(&scenario, &inputs)?,
        control(&scenario, &inputs)?,
        unified_force_impedance()?,
    ];
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
    for size_px in DEPTH_SIZES_PX {
        rows.extend(depth_normal(size_px)?);
    }
    let mut closed_loop = AdmittanceLoop::new(&scenario)?;
    rows.push(timed(
        "closed loop: plant, sensing, estimators, control",
        inputs.control.iter(),
        |_| {
            black_box(closed_loop.step(&mut |_| ()));
        },
    ));
    rows.into_iter()
        .collect::<Option<_>>()
        .ok_or_else(|| "the wipe had no cycles".into())
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

fn conditioning(scenario: &AdmittanceScenario) -> Made<Option<Row>> {
    let mut conditioning = Conditioning::new(scenario)?;
    let name = "wrench conditioning, one record";
    Ok(timed(name, 0..50_000, |_| conditioning.step()))
}

fn kinematics(scenario: &AdmittanceScenario, inputs: &Inputs) -> Made<Option<Row>> {
    let plant = fixtures::plant(scenario)?;
    let tool = plant.flange_from_tool();
    Ok(timed(
        "forward kinematics and Jacobian",
        inputs.control.iter(),
        |input| {
            black_box(plant.model().tool_and_jacobian(&input.q, &tool));
        },
    ))
}

fn control(scenario: &AdmittanceScenario, inputs: &Inputs) -> Made<Option<Row>> {
    let mut law = fixtures::law(scenario)?;
    Ok(timed("control law", inputs.control.iter(), |input| {
        black_box(law.step(input));
    }))
}

/// The law with its monitor and energy tanks, over one simulated wipe with camera and touch.
fn unified_force_impedance() -> Made<Option<Row>> {
    let scenario = fixtures::wave()?;
    let inputs = step_inputs(&scenario)?;
    let mut us = Vec::with_capacity(inputs.len());
    replay(&scenario, &inputs, |step| {
        let begin = Instant::now();
        step();
        us.push(begin.elapsed().as_secs_f64() * 1e6);
    })?;
    Ok(Row::of("control law unified_force_impedance", us))
}

/// Times of the surface at the tool with its map ahead, of a normal for every pixel, and of both.
fn depth_normal(size_px: [usize; 2]) -> Made<[Option<Row>; 3]> {
    let [width, height] = size_px;
    let input = DepthInput::new(size_px)?;
    let (image, sample) = (input.image()?, input.sample()?);
    let step = DepthNormal::new(&DepthNormalConfig::default())?;
    let mut state = DepthNormalState::default();
    let size = format!("{width} x {height}");
    let at_tool = timed(&format!("depth_normal, one frame {size}"), 0..200, |_| {
        black_box(step.update(&mut state, &sample));
    });
    let mut normals = input.normals();
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
