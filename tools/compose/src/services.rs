//! The services of a cell by their names.

use std::path::PathBuf;
use std::time::Duration;

use tangent_runtime::config::Law;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, HealthReporter, Stop};

use crate::error::ComposeError;
use crate::model::model;
use crate::running::Running;

/// Timeout for a second session; the router has just answered the first.
const NETWORK_PATIENCE: Duration = Duration::from_secs(10);

/// Contents of a recording besides the topics.
#[derive(Clone, Debug, Default)]
pub struct RecorderExtra {
    /// Folder in place of the one in the cell file.
    pub folder: Option<PathBuf>,
    /// Files to store in the recording: name and text.
    pub attachments: Vec<(String, String)>,
}

/// Publishes the health of this process as the cell's router, until the reporter is dropped.
///
/// # Errors
/// The bus refuses it.
pub fn router(bus: &Bus) -> Result<HealthReporter, ComposeError> {
    let health = HealthReporter::start(bus, roles::ROUTER)?;
    health.running();
    Ok(health)
}

/// Starts one service by its name.
///
/// # Errors
/// The cell file does not fit the service.
pub fn service(
    name: &str,
    config: &CellConfig,
    bus: &Bus,
    process_stop: &Stop,
    extra: &RecorderExtra,
) -> Result<Running, ComposeError> {
    let bus = bus.clone();
    match name {
        "netft" => {
            let config = tangent_netft::Config::from_cell(config);
            Running::start("netft", process_stop, move |stop| {
                Ok(tangent_netft::run(config, bus, stop)?)
            })
        }
        "rtde" => {
            let config = tangent_rtde::Config::from_cell(config).map_err(ComposeError::refused)?;
            Running::start("rtde", process_stop, move |stop| {
                Ok(tangent_rtde::run(config, bus, stop)?)
            })
        }
        "franka" => {
            let config =
                tangent_franka::Config::from_cell(config).map_err(ComposeError::refused)?;
            Running::start("franka", process_stop, move |stop| {
                Ok(tangent_franka::run(config, bus, stop)?)
            })
        }
        "estimator" => {
            let config = tangent_estimator::Config::from_cell(config, model(config)?)
                .map_err(ComposeError::refused)?;
            Running::start("estimator", process_stop, move |stop| {
                Ok(tangent_estimator::run(config, bus, stop)?)
            })
        }
        "camera" => {
            let config =
                tangent_camera::Config::from_cell(config).map_err(ComposeError::refused)?;
            Running::start("camera", process_stop, move |stop| {
                Ok(tangent_camera::run(config, bus, stop)?)
            })
        }
        "controller" if config.controller.law != Law::HybridAdmittance => {
            let config = tangent_controller::TorqueConfig::from_cell(config, &model(config)?)
                .map_err(ComposeError::refused)?;
            Running::start("controller", process_stop, move |stop| {
                Ok(tangent_controller::run_torque(config, bus, stop)?)
            })
        }
        "controller" => {
            let config = tangent_controller::Config::from_cell(config, model(config)?)
                .map_err(ComposeError::refused)?;
            Running::start("controller", process_stop, move |stop| {
                Ok(tangent_controller::run(config, bus, stop)?)
            })
        }
        "recorder" => {
            let recorder = recorder(config, extra);
            let zenoh = config.zenoh.clone();
            Running::start("recorder", process_stop, move |stop| {
                if recorder.cells.is_empty() {
                    tangent_recorder::run(recorder, bus, stop)?;
                } else {
                    // Besides the cell's own session, it needs one that receives from all cells.
                    let network = Bus::open_network(&zenoh, NETWORK_PATIENCE)?;
                    tangent_recorder::run_for(recorder, bus, network, stop)?;
                }
                Ok(())
            })
        }
        "ros2" => {
            let joints = model(config)?.joint_names;
            let config =
                tangent_ros2::Config::from_cell(config, &joints).map_err(ComposeError::refused)?;
            Running::start("ros2", process_stop, move |stop| {
                Ok(tangent_ros2::run(config, bus, stop)?)
            })
        }
        "foxglove" => {
            let config = tangent_foxglove::Config::from_cell(config);
            Running::start("foxglove", process_stop, move |stop| {
                Ok(tangent_foxglove::run(&config, &bus, &stop, |_| {})?)
            })
        }
        "ui" => {
            let config = tangent_ui::Config::from_cell(config, &model(config)?)
                .map_err(ComposeError::refused)?;
            if config.tokens.is_empty() {
                tracing::warn!(
                    "nobody has a token, so the page only shows the cell, and stops it: name a file as ui.tokens, or \
                     use `tangent ui`"
                );
            }
            Running::start("ui", process_stop, move |stop| {
                Ok(tangent_ui::run(
                    config,
                    &bus,
                    &stop,
                    tangent_ui::Tools::default(),
                    |_| {},
                )?)
            })
        }
        other => Err(ComposeError::UnknownService(other.to_owned())),
    }
}

fn recorder(config: &CellConfig, extra: &RecorderExtra) -> tangent_recorder::RecorderConfig {
    let mut recorder = tangent_recorder::RecorderConfig::from_cell(config)
        .with_attachment("cell.toml", config.text());
    if let Some(folder) = &extra.folder {
        recorder.folder.clone_from(folder);
    }
    recorder.attachments.extend(extra.attachments.clone());
    recorder
}
