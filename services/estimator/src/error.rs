//! Why the estimator service could not start.

use tangent_estimation::EstimationError;
use tangent_mechanics::ModelError;
use tangent_runtime::BusError;
use thiserror::Error;

/// What the person who starts the service can act on.
#[derive(Debug, Error)]
pub enum EstimatorError {
    /// Unknown name or invalid setting of an estimator.
    #[error(transparent)]
    Estimation(#[from] EstimationError),
    /// The bus refused a topic.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The arm model is not usable.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// An invalid value in `[estimators.settings.NAME]` of the cell file.
    #[error("estimators.settings.{name}: {reason}")]
    Settings {
        /// Estimator that the settings are for.
        name: String,
        /// What is wrong: key, value, what is allowed.
        reason: String,
    },
    /// The list of estimators is empty.
    #[error("estimator: the list of estimators is empty; name at least one of: {0}")]
    NoEstimators(String),
    /// An estimator of an object's pose needs a camera, and there is none.
    #[error("estimator: \"{0}\" needs a camera, and the cell file has no [camera] section")]
    NoCamera(String),
    /// Normals from depth images need a depth camera, and there is none.
    #[error(
        "estimator: \"depth_normal\" needs a depth camera: the cell file has no [camera] section of kind = \"depth\""
    )]
    NoDepthCamera,
    /// A thread could not be started.
    #[error("estimator: starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A defect of the program.
    #[error("estimator: the thread of depth_normal panicked; this is a defect")]
    DepthFailed,
    /// An estimator is listed twice; both would publish on the same topic.
    #[error("estimator: \"{0}\" is listed twice; each publishes on a topic of its own name")]
    Twice(String),
    /// The arm has a number of joints that is not supported.
    #[error("estimator: arm model \"{name}\" has {dof} joints; 6 and 7 are supported")]
    Joints {
        /// Name of the model.
        name: String,
        /// Its number of joints.
        dof: usize,
    },
}
