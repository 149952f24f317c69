//! Errors of teaching a task.

use tangent_control::ControlError;
use tangent_mechanics::{InverseKinematicsError, ModelError};
use tangent_runtime::BusError;

/// Why a task cannot be taught. Each error says what to do.
#[derive(Debug, thiserror::Error)]
pub enum TeachError {
    /// The bridge does not let a hand guide the arm.
    #[error("the arm is not given to the hand: {0}")]
    NotGuided(String),
    /// Another person teaches.
    #[error("{0} teaches with this arm: wait until that is saved or discarded")]
    Taken(String),
    /// No lesson was begun.
    #[error("nothing is being taught: begin first")]
    NotBegun,
    /// A key did nothing.
    #[error("not taken: {0}")]
    NotTaken(&'static str),
    /// An option is out of its range.
    #[error("{option} = {value} is not allowed: {least} to {most}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// Its value.
        value: f64,
        /// Least value.
        least: f64,
        /// Greatest value.
        most: f64,
    },
    /// No state of the arm is received.
    #[error("no arm/state received: is the bridge connected to the robot? See `tangent status`")]
    NoArm,
    /// A pose of the arm is not usable.
    #[error("the arm's pose is not usable: {0}")]
    NoPose(String),
    /// Too little was shown.
    #[error("{shown} shown, and {wanted}")]
    TooFew {
        /// What was shown.
        shown: String,
        /// What the path needs.
        wanted: &'static str,
    },
    /// A place is too far from the first one.
    #[error(
        "place {place} is {away_m:.2} m from the first one, and a path reaches 2 m: show a smaller path"
    )]
    TooFar {
        /// Number of the place, from 1.
        place: usize,
        /// Distance, m.
        away_m: f64,
    },
    /// The arm cannot stand above the first point.
    #[error(
        "no start pose {clearance_m} m above the first point: {source}; use a smaller --clearance-m, or show the first \
         point in another posture"
    )]
    NoStart {
        /// Height above the first point, m.
        clearance_m: f64,
        /// Why not.
        source: InverseKinematicsError,
    },
    /// The joints of the arm are not those of the cell's model.
    #[error("arm/state has {read} joints, and the cell's model has {model}: correct [robot] model")]
    Joints {
        /// Joints read.
        read: usize,
        /// Joints of the model.
        model: usize,
    },
    /// The cell's model cannot be used.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The task would not be accepted.
    #[error(transparent)]
    Task(#[from] ControlError),
    /// The bus cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
}
