//! All threads of a simulated cell: the simulated devices, the services and the recorder.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use tangent_compose::{RecorderExtra, Running, service};
use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_simulation::Scenario;

use crate::error::SimulatedCellError;
use crate::simulator;

/// A simulated cell that runs in threads of this process.
pub struct RunningCell {
    began: Instant,
    /// In the order in which they are ended.
    services: Vec<Running>,
}

impl RunningCell {
    /// Starts the simulated devices, the recorder and the services that the scenario's system
    /// needs. A thread that ends by itself triggers `process_stop`.
    ///
    /// # Errors
    /// A service or a simulated device that does not start.
    pub fn start(
        config: &CellConfig,
        played: &Scenario,
        bus: &Bus,
        process_stop: &Stop,
        extra: &RecorderExtra,
    ) -> Result<Self, SimulatedCellError> {
        let began = Instant::now();
        let simulator = simulator::start(config, Some(played), bus, process_stop)?;
        let recorder = service("recorder", config, bus, process_stop, extra)?;
        let mut services = Vec::new();
        // A controller that is registered before the arm's own service answers each packet within
        // the publish of that service.
        let names: &[&str] = match played {
            Scenario::Admittance(_) => &["controller", "estimator", "netft", "rtde"],
            // This arm is on the bus itself.
            Scenario::ObjectPose(_) => &["controller", "estimator", "camera", "netft"],
            // This arm measures wrenches itself.
            Scenario::VisuoTactile(_) if config.camera.is_some() => {
                &["controller", "estimator", "camera", "franka"]
            }
            Scenario::VisuoTactile(_) => &["controller", "estimator", "franka"],
        };
        for name in names {
            services.push(service(name, config, bus, process_stop, extra)?);
        }
        // The bridge ends before the simulated robot, so that it can still send its last bytes. The
        // recorder ends last and records the last messages of all.
        services.reverse();
        services.push(simulator);
        services.push(recorder);
        Ok(Self { began, services })
    }

    /// Ends everything and returns the recordings in `folder` that were made meanwhile.
    ///
    /// # Errors
    /// The first service that ended with an error; a folder that cannot be listed or has no new
    /// recording.
    pub fn end(self, folder: &Path) -> Result<Vec<PathBuf>, SimulatedCellError> {
        let mut failed = None;
        for service in self.services {
            if let Err(error) = service.end() {
                failed.get_or_insert(error);
            }
        }
        if let Some(error) = failed {
            return Err(error.into());
        }
        let age = self.began.elapsed();
        let mut files = Vec::new();
        let entries = fs::read_dir(folder).map_err(|source| SimulatedCellError::Recordings {
            folder: folder.to_owned(),
            source,
        })?;
        for entry in entries.flatten() {
            let path = entry.path();
            let recent = entry
                .metadata()
                .and_then(|m| m.modified())
                .is_ok_and(|at| at.elapsed().is_ok_and(|e| e <= age));
            if path.extension().is_some_and(|e| e == "mcap") && recent {
                files.push(path);
            }
        }
        files.sort();
        if files.is_empty() {
            return Err(SimulatedCellError::NoRecording {
                folder: folder.to_owned(),
            });
        }
        Ok(files)
    }
}
