//! Time of each processing step by itself, on the inputs of a whole simulated wipe. `tangent bench
//! steps` measures these steps once; this benchmark adds criterion's statistics and its comparison
//! with the previous run.
//!
//! ```sh
//! cargo bench --bench steps                 # all of them
//! cargo bench --bench steps -- estimator    # those with this word in their names
//! ```

// The macro generates a function without documentation.
#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use tangent_bench::fixtures::{
    Conditioning, DEPTH_SIZES_PX, DepthInput, Inputs, law, object, pipe, plant, wave,
};
use tangent_estimation::depth_normal::{DepthNormal, DepthNormalConfig, DepthNormalState};
use tangent_estimation::{build, estimator_names};
use tangent_simulation::systems::visuo_tactile::reproduction::{replay, step_inputs};
use tangent_simulation::{AdmittanceLoop, ObjectLoop, VisuoTactileLoop};

fn sensing(c: &mut Criterion) {
    let mut conditioning = Conditioning::new(&pipe().unwrap()).unwrap();
    c.bench_function("wrench conditioning, one record", |b| {
        b.iter(|| conditioning.step());
    });
}

fn estimators(c: &mut Criterion) {
    let scenario = pipe().unwrap();
    let contact = Inputs::of(&scenario).unwrap().contact;
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
    let scenario = pipe().unwrap();
    let control = Inputs::of(&scenario).unwrap().control;
    let plant = plant(&scenario).unwrap();
    let tool = plant.flange_from_tool();
    let mut cycles = control.iter().cycle();
    c.bench_function("forward kinematics and Jacobian", |b| {
        b.iter(|| {
            let input = cycles.next().unwrap();
            plant.model().tool_and_jacobian(&input.q, &tool)
        });
    });
    c.bench_function("law hybrid_admittance", |b| {
        b.iter_custom(|iterations| {
            let mut spent = Duration::ZERO;
            let mut left = iterations;
            while left > 0 {
                let mut law = law(&scenario).unwrap();
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
    let scenario = wave().unwrap();
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

/// The surface at the tool with its map ahead, and a normal for every pixel.
fn depth_normal(c: &mut Criterion) {
    for size_px in DEPTH_SIZES_PX {
        let input = DepthInput::new(size_px).unwrap();
        let (image, sample) = (input.image().unwrap(), input.sample().unwrap());
        let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
        let mut state = DepthNormalState::default();
        let [width, height] = size_px;
        c.bench_function(
            &format!("depth_normal, one frame {width} x {height}"),
            |b| {
                b.iter(|| black_box(step.update(&mut state, &sample)));
            },
        );
        let mut normals = input.normals();
        let name = format!("depth_normal, a normal for every pixel {width} x {height}");
        c.bench_function(&name, |b| {
            b.iter(|| black_box(step.normals(&state, &image, &mut normals)));
        });
    }
}

/// One cycle of plant, sensing, estimators and law together, for each system.
fn closed_loops(c: &mut Criterion) {
    let mut pipe = AdmittanceLoop::new(&pipe().unwrap()).unwrap();
    c.bench_function("closed loop pipe_realistic", |b| {
        b.iter(|| pipe.step(&mut |_| ()));
    });
    let mut object = ObjectLoop::<6>::new(&object().unwrap()).unwrap();
    c.bench_function("closed loop lippiello_realistic", |b| {
        b.iter(|| object.step(&mut tangent_simulation::Undisturbed, &mut |_| ()));
    });
    let mut wave = VisuoTactileLoop::<7>::new(&wave().unwrap()).unwrap();
    c.bench_function("closed loop karacan_wave", |b| {
        b.iter(|| wave.step(&mut tangent_simulation::Undisturbed, &mut |_| ()));
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
