//! The UR cell as a service: its ground truth, the odometry of its moving base and the images of
//! its depth camera on the bus, and faults on request.

use std::time::Duration;

use tangent_mechanics::{Base, Pose, World};
use tangent_runtime::{Bus, BusError, HealthReporter, Stop, clock};
use tangent_schemas::Covariance;
use tangent_schemas::standard::{Header, PoseWithCovariance, PoseWithCovarianceStamped};
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::{BASE_POSE, SIMULATED_IMAGE, TRUTH_CONTACT};
use tangent_simulated_device::{FAULT_KEY, Shutter, ShutterError, fault_answer, truth_message};
use tangent_simulated_ur::{Fault, FlangeListener, Listeners, OdometryListener};
use tangent_simulation::{AdmittancePlant, OdometrySample};

use crate::cell::{CellError, SimulatedCell};
use crate::config::Config;

/// Why the service ended.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The cell could not start.
    #[error("simulator: {0}")]
    Start(#[from] CellError),
    /// The bus refused a topic or key.
    #[error("simulator: {0}")]
    Bus(#[from] BusError),
    /// The depth camera could not start.
    #[error("simulator: {0}")]
    Camera(#[from] ShutterError),
    /// The cell's thread died.
    #[error("simulator: the simulated cell stopped by itself; see the log for the reason")]
    Ended,
}

/// Runs a cell until it is stopped.
///
/// # Errors
/// The configuration is wrong, a port is taken, or the bus refuses.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), Error> {
    let health = HealthReporter::start_only(&bus, "simulator")?;
    let cycles = health.rate("cycles");
    let publisher = bus.publisher(&TRUTH_CONTACT)?;
    let told = cycles.clone();
    let platform = match &config.plant.base {
        Some(_) => Some(bus.publisher(&BASE_POSE)?),
        None => None,
    };
    let plant = AdmittancePlant::new(&config.plant, config.seed).map_err(CellError::from)?;
    let camera = match &config.plant.depth_camera {
        Some(camera) => Some(Shutter::start(
            camera,
            &plant.true_flange_from_tool(),
            config.seed,
            plant.surface(),
            bus.publisher(&SIMULATED_IMAGE)?,
            config.realtime_priority.is_some(),
        )?),
        None => None,
    };
    let cell = SimulatedCell::start_around(
        plant,
        &config,
        Listeners {
            truth: Some(Box::new(move |truth| {
                told.tick();
                publisher.publish(&truth_message(truth));
            })),
            odometry: platform.map(|publisher| -> OdometryListener {
                Box::new(move |sample, age_s| {
                    publisher.publish(&base_pose(sample, age_s));
                })
            }),
            flange: camera.map(|mut camera| -> FlangeListener {
                Box::new(move |time_s, base_from_flange| camera.look(time_s, base_from_flange))
            }),
            records: None,
        },
    )?;
    let faults = cell.robot().faults();
    let _answering = bus.answer(FAULT_KEY, move |_, request: Request| {
        let fault = Fault::parse(&request.action, &request.argument);
        fault_answer(fault.map(|fault| {
            faults(fault);
            format!("{fault:?}")
        }))
    })?;
    tracing::info!(target: "simulator", "robot at {}, sensor at {}", cell.robot().endpoints().rtde,
        cell.sensor_box().rdt_address());
    health.running();
    let missed = health.missed_cycles();
    while !stop.wait(Duration::from_millis(200)) {
        if let Some(snapshot) = cell.robot().snapshot() {
            missed.set(snapshot.missed);
        }
        if cell.robot().has_ended() {
            return Err(Error::Ended);
        }
    }
    Ok(())
}

/// Odometry as a platform would publish it: stamped with the time of measurement.
fn base_pose(sample: &OdometrySample, age_s: f64) -> PoseWithCovarianceStamped {
    let pose: Pose<World, Base> = Pose::from_isometry(sample.world_from_base);
    let mut covariance = Covariance::default();
    for axis in 0..6 {
        covariance.0[7 * axis] = if axis < 3 {
            sample.position_variance_m2
        } else {
            sample.orientation_variance_rad2
        };
    }
    let stamp_ns = clock::now_ns() - (age_s * 1e9) as i64;
    PoseWithCovarianceStamped {
        header: Header::in_frame::<World>(stamp_ns),
        pose: PoseWithCovariance {
            pose: (&pose).into(),
            covariance,
        },
    }
}
