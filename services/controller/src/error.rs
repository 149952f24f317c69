//! Reasons why the controller service cannot start, or refuses a task.

use tangent_control::ControlError;
use tangent_mechanics::ModelError;
use tangent_runtime::BusError;
use thiserror::Error;

use crate::mailbox::Silence;
use crate::replies::silence_text;

/// Errors on which the person who starts the service can act.
#[derive(Debug, Error)]
pub enum ControllerError {
    /// A gain, limit or preset is invalid.
    #[error("[controller] or [limits] of the cell file: {0}")]
    Control(#[from] ControlError),
    /// A task that does not fit the cell's law.
    #[error("{0}")]
    Task(ControlError),
    /// The object's description for the estimators is invalid.
    #[error("estimators.settings of an object's pose: {0}")]
    Object(String),
    /// The arm's model is invalid.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A topic or query failed.
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
        /// Numbers of joints of the law's arms.
        wanted: &'static str,
    },
}

/// Why a task is not started, or an estimator is not subscribed to. The text says what to do.
#[derive(Debug, Error)]
pub enum TaskRefusal {
    /// The task or a parameter of its law is not valid.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// A topic cannot be read.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The loop does not answer.
    #[error("{}", silence_text(*.0))]
    Silence(Silence),
    /// The task does not fit the cell: all reasons that were found.
    #[error("{0}")]
    Preflight(String),
    /// Estimators that do not exist: all of them, each with the nearest known name.
    #[error("{0}")]
    UnknownEstimators(String),
    /// No estimator of the surface's normal publishes.
    #[error(
        "none of the task's estimators publishes: {}; is the estimator running, with these in [estimators] run?",
        .0.join(", ")
    )]
    NoNormal(Vec<String>),
    /// No estimator of the object's pose publishes.
    #[error(
        "none of the task's estimators publishes an object's pose: {}; are estimator and camera running, with these in \
         [estimators] run?",
        .0.join(", ")
    )]
    NoObject(Vec<String>),
    /// What earlier passes over the part learnt cannot be used.
    #[error("learning.part: {0}")]
    Lessons(String),
    /// A topic has a second publisher.
    #[error("{0}: end the one that does not belong to this cell, and start the task again")]
    SecondPublisher(String),
    /// The state of the arm does not arrive.
    #[error("no arm/state: is the bridge (rtde or franka) running, and is the robot reachable?")]
    NoArm,
    /// Another controller holds the lease of the arm.
    #[error(
        "{0} drives the arm: start the task there, or end that controller and start the task again"
    )]
    DrivenByAnother(String),
    /// The arm does not accept commands, for this reason.
    #[error("the arm is not ready: {0}")]
    ArmNotReady(String),
    /// The wrench does not arrive.
    #[error("no wrench: is netft running, and is the sensor reachable?")]
    NoWrench,
    /// The wrench is invalid.
    #[error("the wrench cannot be used: {reason} ({status})")]
    WrenchInvalid {
        /// Why it is invalid.
        reason: &'static str,
        /// Status from the sensor's service.
        status: String,
    },
}
