//! Simulated cells: scenarios by name or file, the cell file that fits a scenario, and the threads
//! that play both.
//!
//! [`scenarios::load`] reads a scenario, built in or from a file. Its cell file comes from one of
//! two directions. [`run_scenario`] writes the file that fits the scenario: robot, tool, limits,
//! law and estimators. [`run_cell_file`] takes a file that was written for real devices, fits the
//! scenario's arm and tool to it, and returns which of its keys a simulator cannot honour.
//! [`RunningCell`] then starts the simulated devices, the services and the recorder in this
//! process.
//!
//! `tangent up` uses all of it. `tangent run simulator` calls [`start_simulator`] alone;
//! `tangent check`, `evaluate` and `reproduce` only read scenarios.
//!
//! ```
//! # fn main() -> Result<(), tangent_simulated_cell::SimulatedCellError> {
//! use tangent_simulated_cell::{cell_of_scenario, scenarios};
//!
//! let scenario = scenarios::load("pipe_ideal", &["seed=7".to_owned()])?;
//! let cell = cell_of_scenario(&scenario)?;
//! assert_eq!(cell.robot.model, "ur5");
//! # Ok(())
//! # }
//! ```
//!
//! | file | contents |
//! |---|---|
//! | `scenarios` | the built-in scenarios, and reading one by name or file |
//! | `cell` | the cell as it runs: from a scenario or from a cell file, on local addresses |
//! | `scenario_cell` | the keys of a cell file that follow from a scenario |
//! | `given_cell` | a given cell file against a scenario: what fits and what is not used |
//! | `simulated_plant` | a scenario with the arm and the tool of a cell |
//! | `cell_keys` | single keys of a cell file by dotted name |
//! | `simulator`, `running_cell` | the simulated devices; all threads of the cell |

mod cell;
mod cell_keys;
mod error;
mod given_cell;
mod running_cell;
mod scenario_cell;
pub mod scenarios;
mod simulated_plant;
mod simulator;

pub use cell::{GivenCell, cell_of_scenario, run_cell_file, run_scenario};
pub use error::SimulatedCellError;
pub use running_cell::RunningCell;
pub use simulated_plant::take_arm;
pub use simulator::start as start_simulator;
