//! The simulated devices of a process: those that the scenario in use needs.

use tangent_compose::{Running, simulators};
use tangent_runtime::config::RobotDriver;
use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_simulation::Scenario;

use crate::error::SimulatedCellError;
use crate::{scenarios, simulated_plant};

/// Starts the simulated devices of a cell: those of the given scenario, or of the one that the cell
/// file names. With neither, a Franka stands above a table, and any other cell plays
/// [`scenarios::DEFAULT`].
///
/// # Errors
/// A scenario that cannot be read, or a device that does not start.
pub fn start(
    config: &CellConfig,
    played: Option<&Scenario>,
    bus: &Bus,
    process_stop: &Stop,
) -> Result<Running, SimulatedCellError> {
    if config.robot.driver == RobotDriver::Franka
        && played.is_none()
        && config.simulator.scenario.is_none()
    {
        return Ok(simulators::franka(config, None, bus, process_stop)?);
    }
    let own;
    let played = match played {
        Some(given) => given,
        None => {
            own = own_scenario(config)?;
            &own
        }
    };
    Ok(match played {
        Scenario::ObjectPose(scenario) => {
            simulators::torque_arm(config, scenario, bus, process_stop)?
        }
        Scenario::VisuoTactile(scenario) => {
            simulators::franka(config, Some(scenario), bus, process_stop)?
        }
        Scenario::Admittance(scenario) => {
            simulators::velocity_arm(config, scenario, bus, process_stop)?
        }
    })
}

/// The scenario that the cell file names, or the default one, with the cell's arm.
fn own_scenario(config: &CellConfig) -> Result<Scenario, SimulatedCellError> {
    let named = config.simulator.scenario.as_ref();
    let name = named.map(|path| path.display().to_string());
    let mut played = scenarios::load(name.as_deref().unwrap_or(scenarios::DEFAULT), &[])?;
    simulated_plant::take_arm(&mut played, config);
    Ok(played)
}
