//! Measures the time of the Franka bridge from the robot's packet to its answer, over real sockets
//! and under load. A torque law with the controller's cost runs in the same thread.
//!
//! ```text
//! cargo run --release -p tangent-simulated-franka --example franka_latency -- SECONDS LOAD_THREADS
//! ```
//!
//! The clock is read after the answer has been sent. Real-time scheduling is requested as in the
//! cell's `[realtime]`; the granted scheduling is printed first.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tangent_franka::Config;
use tangent_mechanics::{Arm, Joints, ModelData};
use tangent_runtime::config::{FrankaConfig, RobotDriver};
use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_schemas::tangent::ArmCommand;
use tangent_schemas::topics;
use tangent_simulated_device::Ports;
use tangent_simulated_franka::{FciConfig, SimulatedFranka};

const STIFFNESS: [f64; 7] = [150.0, 150.0, 120.0, 120.0, 40.0, 30.0, 10.0];
const DAMPING: [f64; 7] = [30.0, 30.0, 20.0, 20.0, 4.0, 3.0, 1.0];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let seconds: u64 = arguments.next().map_or(Ok(30), |word| word.parse())?;
    let load: usize = arguments.next().map_or(Ok(2), |word| word.parse())?;
    let mut cell = CellConfig::default_cell();
    let simulated = SimulatedFranka::start(&FciConfig {
        ports: Ports::Ephemeral,
        realtime_priority: Some(cell.realtime.simulator_priority),
        ..FciConfig::default()
    })?;
    cell.robot.model = "panda".into();
    cell.robot.driver = RobotDriver::Franka;
    cell.robot.franka = Some(FrankaConfig {
        fci_port: simulated.address().port(),
        ..FrankaConfig::default()
    });
    let bus = Bus::in_process("latency");
    let commands = bus.publisher(&topics::ARM_COMMAND)?;
    let arm = Arm::<7>::new(&ModelData::builtin("panda")?)?;
    let start: Mutex<Option<(f64, Joints<7>)>> = Mutex::new(None);
    let _controller = bus.on(&topics::ARM_STATE, move |received| {
        let state = &received.message;
        let moves = state.ready && state.runtime_state == 2;
        let (Ok(q), Ok(qd)) = (
            <[f64; 7]>::try_from(state.q.as_slice()),
            <[f64; 7]>::try_from(state.qd.as_slice()),
        ) else {
            return;
        };
        let (q, qd) = (Joints::from(q), Joints::from(qd));
        let Ok(mut start) = start.lock() else {
            return;
        };
        let (since_s, q_start) = *start.get_or_insert((state.robot_time_s, q));
        // A model-based law: dynamics once per cycle, as the controller's own laws take them.
        let coriolis = arm.coriolis(&q, &qd);
        let mut goal = q_start;
        goal[0] += 0.1 * (1.0 - (1.5 * (state.robot_time_s - since_s)).cos());
        let torque = Joints::from(STIFFNESS).component_mul(&(goal - q))
            - Joints::from(DAMPING).component_mul(&qd)
            + coriolis;
        commands.publish(&ArmCommand {
            cycle: state.cycle,
            kind: if moves { 2 } else { 0 },
            values: torque.iter().copied().collect(),
            activation: u64::from(moves),
            ..ArmCommand::default()
        });
    })?;
    let healths = bus.subscribe(&topics::health("franka"), 16)?;
    let config = Config::from_cell(&cell)?;
    let stop = Stop::new();
    let (b, s) = (bus.clone(), stop.clone());
    let bridge = std::thread::spawn(move || tangent_franka::run(config, b, s));
    let quiet = Arc::new(AtomicBool::new(false));
    let workers: Vec<_> = (0..load)
        .map(|n| {
            let quiet = Arc::clone(&quiet);
            std::thread::spawn(move || {
                // Loads the processor and its caches.
                let mut memory = vec![n as u64; 1 << 20];
                while !quiet.load(Ordering::Relaxed) {
                    for i in 0..memory.len() {
                        memory[i] = memory[(i * 7919) % (1 << 20)].wrapping_add(i as u64);
                    }
                }
                memory.iter().fold(0, |sum: u64, x| sum.wrapping_add(*x))
            })
        })
        .collect();
    let end = Instant::now() + Duration::from_secs(seconds);
    let mut last = None;
    while let Some(left) = end.checked_duration_since(Instant::now()) {
        if let Some(health) = healths.recv_timeout(left) {
            last = Some(health.message);
        }
    }
    let snapshot = simulated.snapshot();
    quiet.store(true, Ordering::Relaxed);
    stop.trigger();
    bridge.join().map_err(|_| "the bridge panicked")??;
    for worker in workers {
        worker.join().map_err(|_| "the load panicked")?;
    }
    let health = last.ok_or("no health of the bridge")?;
    println!("{}", health.realtime);
    println!("lost {}, missed {}", health.lost, health.missed_cycles);
    for (name, figure) in health.figure_names.iter().zip(&health.figures) {
        println!("{name:<40} {figure:.3}");
    }
    if let Some(s) = snapshot {
        println!(
            "robot: {} cycles, {} deadlines missed, {} answers lost, mode {}",
            s.cycles,
            s.missed,
            s.answers_lost,
            s.state.mode()
        );
    }
    Ok(())
}
