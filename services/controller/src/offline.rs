//! Checks of a task start without a running cell: for `tangent check` and `tangent up`.

use tangent_control::preflight::{Preflight, Refusal};
use tangent_control::{ControlError, ControllerConfig, LawConfig, Limits, Path, Program, Task};
use tangent_mechanics::{Arm, Flange, ModelData, Pose, Tool};
use tangent_runtime::CellConfig;
use tangent_runtime::config::Law;
use tangent_schemas::convert::joints;

use crate::config::Config;
use crate::config::torque::{TorqueCell, TorqueCells, TorqueConfig};
use crate::error::ControllerError;
use crate::tasks::torque::ServedLaw;

/// Why the cell's controller would refuse this task; empty if it would not. `start` are joint
/// positions, rad; without them, only checks that do not depend on the start pose are made.
///
/// # Errors
/// The cell's controller cannot start, the task does not fit its law, or the number of joints
/// differs from the arm's.
pub fn refusals(
    cell: &CellConfig,
    model: &ModelData,
    task: &Task,
    start: Option<&[f64]>,
) -> Result<Vec<Refusal>, ControllerError> {
    if cell.controller.law == Law::HybridAdmittance {
        let config = Config::from_cell(cell, model.clone())?;
        let mut task = task.clone();
        task.complete(&cell.tool.tip.tip());
        let task = &task;
        let program = Program::new(task, &config.control).map_err(ControllerError::Task)?;
        return of_arm(
            task,
            &program.path,
            (&config.arm, &config.flange_from_tool, &config.limits),
            start,
            ControllerConfig::TRAVELS,
        );
    }
    match TorqueConfig::from_cell(cell, model)? {
        TorqueConfig::HybridDynamics(TorqueCells::Six(cell)) => of_cell(task, &cell, start),
        TorqueConfig::HybridDynamics(TorqueCells::Seven(cell)) => of_cell(task, &cell, start),
        TorqueConfig::UnifiedForceImpedance(TorqueCells::Six(cell)) => of_cell(task, &cell, start),
        TorqueConfig::UnifiedForceImpedance(TorqueCells::Seven(cell)) => {
            of_cell(task, &cell, start)
        }
    }
}

fn of_cell<C: ServedLaw, const N: usize>(
    task: &Task,
    cell: &TorqueCell<C, N>,
    start: Option<&[f64]>,
) -> Result<Vec<Refusal>, ControllerError> {
    let parameters = cell.parameters(task.controller.as_deref());
    let parameters = parameters.map_err(ControllerError::Task)?;
    let program = Program::with_config(task, parameters).map_err(ControllerError::Task)?;
    of_arm(
        task,
        &program.path,
        (&cell.arm, &cell.flange_from_tool, &cell.limits),
        start,
        C::TRAVELS,
    )
}

fn of_arm<const N: usize>(
    task: &Task,
    path: &Path,
    (arm, flange_from_tool, limits): (&Arm<N>, &Pose<Flange, Tool>, &Limits),
    start: Option<&[f64]>,
    travels: bool,
) -> Result<Vec<Refusal>, ControllerError> {
    let start = start.map(joints::<N>).transpose().map_err(|error| {
        ControllerError::Task(ControlError::Syntax(format!("start pose: {error}")))
    })?;
    let preflight = Preflight {
        task,
        path,
        limits,
        arm,
        flange_from_tool,
        travels,
    };
    Ok(preflight.refusals(start.as_ref()))
}
