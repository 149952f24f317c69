//! Files that people write: cell, task, scenario and robot model, all TOML.

use std::str::FromStr;

use tangent_control::{ControllerConfig, Program, Task};
use tangent_mechanics::{Arm, ModelData};
use tangent_runtime::CellConfig;
use tangent_simulation::{FileError, Scenario};

fn text(data: &[u8], check: impl FnOnce(&str)) {
    if let Ok(text) = std::str::from_utf8(data) {
        check(text);
    }
}

/// Reads a cell file. A refusal must name the file.
pub fn cell_file(data: &[u8]) {
    text(data, |text| {
        if let Err(error) = CellConfig::parse("cell.toml", text) {
            assert!(!error.to_string().is_empty());
        }
    });
}

/// Reads a task file. An accepted task becomes a program whose path is finite, or is refused with a
/// message.
pub fn task_file(data: &[u8]) {
    text(data, |text| {
        let Ok(task) = Task::from_str(text) else {
            return;
        };
        if let Err(error) = Program::new(&task, &ControllerConfig::default()) {
            assert!(!error.to_string().is_empty());
        }
    });
}

/// Reads a scenario file. It must not make the decoder read any other file.
pub fn scenario_file(data: &[u8]) {
    text(data, |text| {
        let no_file = |name: &str| Err(FileError::new(format!("{name} is not read here")));
        if let Err(error) = Scenario::parse("scenario.toml", text, &[], &no_file) {
            assert!(!error.to_string().is_empty());
        }
    });
}

/// Reads a robot model. An accepted model has finite kinematics at rest.
pub fn model_file(data: &[u8]) {
    text(data, |text| {
        let Ok(model) = ModelData::from_toml(text) else {
            return;
        };
        if let Ok(arm) = Arm::<6>::new(&model) {
            let pose = arm.base_from_flange(&nalgebra::SVector::zeros());
            assert!(pose.translation().iter().all(|x| x.is_finite()));
        }
    });
}
