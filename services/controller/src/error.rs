//! Why the controller service cannot start.

use tangent_control::ControlError;
use tangent_mechanics::ModelError;
use tangent_runtime::BusError;
use thiserror::Error;

/// What the person who starts the service can act on.
#[derive(Debug, Error)]
pub enum ControllerError {
    /// A gain, limit or preset.
    #[error("[controller] or [limits] of the cell file: {0}")]
    Control(#[from] ControlError),
    /// A task that does not fit the cell's law.
    #[error("{0}")]
    Task(ControlError),
    /// What the estimators are told of the object.
    #[error("estimators.settings of an object's pose: {0}")]
    Object(String),
    /// The arm's model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A topic or query.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A thread could not be started.
    #[error("starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// An arm that this law cannot drive.
    #[error(
        "controller: arm model \"{name}\" has {dof} joints; [controller] law is for arms with {wanted}"
    )]
    Joints {
        /// Name of the model.
        name: String,
        /// Its number of joints.
        dof: usize,
        /// Those of the law's arms.
        wanted: usize,
    },
}
