//! Why the estimator service could not start.

use tangent_estimation::EstimationError;
use tangent_mechanics::ModelError;
use tangent_runtime::BusError;
use thiserror::Error;

/// What the person who starts the service can act on.
#[derive(Debug, Error)]
pub enum EstimatorError {
    /// An estimator's name or setting.
    #[error(transparent)]
    Estimation(#[from] EstimationError),
    /// The bus refused a topic.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The arm model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// `[estimators.settings.NAME]` of the cell file.
    #[error("estimators.settings.{name}: {reason}")]
    Settings {
        /// Estimator they are for.
        name: String,
        /// What is wrong: key, value, what is allowed.
        reason: String,
    },
    /// No estimator at all.
    #[error("estimator: the list of estimators is empty; name at least one of: {0}")]
    NoEstimators(String),
    /// The pose of an object is estimated from a camera.
    #[error("estimator: \"{0}\" needs a camera, and the cell file has no [camera] section")]
    NoCamera(String),
    /// Normals are read from depth images.
    #[error(
        "estimator: \"depth_normal\" needs a depth camera: the cell file has no [camera] section of kind = \"depth\""
    )]
    NoDepthCamera,
    /// No thread to be had.
    #[error("estimator: starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A defect.
    #[error("estimator: the thread of depth_normal panicked; this is a defect")]
    DepthFailed,
    /// The same estimator twice: both would publish on one topic.
    #[error("estimator: \"{0}\" is listed twice; each publishes on a topic of its own name")]
    Twice(String),
    /// An arm with another number of joints than there is code for.
    #[error("estimator: arm model \"{name}\" has {dof} joints; 6 and 7 are supported")]
    Joints {
        /// Name of the model.
        name: String,
        /// Its number of joints.
        dof: usize,
    },
}
