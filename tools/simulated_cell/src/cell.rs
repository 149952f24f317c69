//! The cell as it runs, simulated on this machine: the one that fits a scenario, or the one of a
//! given file.

use std::path::Path;

use tangent_runtime::CellConfig;
use tangent_simulation::Scenario;
use toml::{Table, Value};

use crate::cell_keys::{get, set};
use crate::error::SimulatedCellError;
use crate::{given_cell, scenario_cell};

/// A given cell as it runs against the simulator.
#[derive(Clone, Debug)]
pub struct GivenCell {
    /// The cell. Its text is recorded.
    pub config: CellConfig,
    /// Keys of the given file that are not used, each with the reason.
    pub unused: Vec<String>,
}

/// The cell that fits a scenario, made of the built-in one. Its addresses are those of the built-in
/// file.
///
/// # Errors
/// An unknown arm, or a value that no cell may have.
pub fn cell_of_scenario(played: &Scenario) -> Result<CellConfig, SimulatedCellError> {
    let base = CellConfig::default_cell();
    let (config, ()) = changed(&base, &title(played), |cell| {
        scenario_cell::write(cell, &base, played)
    })?;
    Ok(config)
}

/// The cell that fits a scenario, made of `base`, as it runs on this machine. `port_offset` is
/// added to every port.
///
/// # Errors
/// An unknown arm, a value that no cell may have, or a port that is too high.
pub fn run_scenario(
    base: &CellConfig,
    played: &Scenario,
    port_offset: u16,
) -> Result<CellConfig, SimulatedCellError> {
    let (config, ()) = changed(base, &title(played), |cell| {
        scenario_cell::write(cell, base, played)?;
        on_this_machine(cell, port_offset)
    })?;
    Ok(config)
}

/// The cell of the given `file`, read into `base`, as far as it can be simulated. The scenario gets
/// the cell's arm and tool. `port_offset` is added to every port.
///
/// # Errors
/// A cell that this scenario cannot be played with, an arm of the user's own, or a port that is too
/// high.
pub fn run_cell_file(
    base: &CellConfig,
    file: &Path,
    played: &mut Scenario,
    port_offset: u16,
) -> Result<GivenCell, SimulatedCellError> {
    given_cell::fit(base, played)?;
    let title = format!("{} as `tangent up` runs it", file.display());
    let (config, unused) = changed(base, &title, |cell| {
        let unused = given_cell::write(cell, base, played)?;
        on_this_machine(cell, port_offset)?;
        Ok(unused)
    })?;
    Ok(GivenCell { config, unused })
}

fn title(played: &Scenario) -> String {
    format!("the cell of scenario {}", played.name())
}

/// Returns `base` with changes that can fail, and the result of the change.
fn changed<T: Default>(
    base: &CellConfig,
    title: &str,
    change: impl FnOnce(&mut Table) -> Result<T, SimulatedCellError>,
) -> Result<(CellConfig, T), SimulatedCellError> {
    let mut written = Ok(T::default());
    let config = base.changed(title, |cell| written = change(cell));
    // The cause is reported before the errors of a partly changed file.
    let written = written?;
    Ok((config.map_err(SimulatedCellError::Cell)?, written))
}

/// Addresses and ports of a cell that is simulated here.
fn on_this_machine(cell: &mut Table, port_offset: u16) -> Result<(), SimulatedCellError> {
    set(cell, "robot.address", "127.0.0.1")?;
    set(cell, "sensor.address", "127.0.0.1")?;
    set(cell, "simulator.address", "127.0.0.1")?;
    for key in ["robot.port_offset", "sensor.port_offset"] {
        let own = get(cell, key).and_then(Value::as_integer).unwrap_or(0);
        let own = u16::try_from(own).unwrap_or(u16::MAX);
        set(cell, key, offset(own, port_offset)?)?;
    }
    if port_offset > 0 {
        let tls = get(cell, "zenoh.tls").is_some();
        let protocol = if tls { "quic" } else { "tcp" };
        let port = offset(7447, port_offset)?;
        let endpoint = format!("{protocol}/127.0.0.1:{port}");
        set(cell, "zenoh.listen", [&endpoint])?;
        set(cell, "zenoh.connect", [&endpoint])?;
    }
    Ok(())
}

fn offset(port: u16, by: u16) -> Result<u16, SimulatedCellError> {
    // The highest port in use is the sensor's, 49152.
    match port.checked_add(by) {
        Some(sum) if sum <= u16::MAX - 49_152 || port >= 7447 => Ok(sum),
        _ => Err(SimulatedCellError::PortOffset { by }),
    }
}
