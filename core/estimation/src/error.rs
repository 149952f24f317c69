//! Errors when an estimator is built.

use tangent_mechanics::names::did_you_mean;
use thiserror::Error;

/// Why an estimator could not be built.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum EstimationError {
    /// The registry has no such estimator.
    #[error(
        "no estimator is called \"{name}\"{}; there are: {allowed}",
        did_you_mean(name, allowed.split(", "))
    )]
    Unknown {
        /// The name given.
        name: String,
        /// All names, separated by commas.
        allowed: String,
    },
    /// A setting is out of its range.
    #[error("estimator setting {key} = {value} is out of range: {lower} to {upper} is allowed")]
    OutOfRange {
        /// Dotted key, as in the configuration file.
        key: &'static str,
        /// Value given.
        value: f64,
        /// Smallest value allowed.
        lower: f64,
        /// Largest value allowed.
        upper: f64,
    },
    /// The corners of a target do not span a plane.
    #[error(
        "estimator setting target.corners_m: the corners lie on a line; give four corners of a flat target, counter-clockwise seen from outside"
    )]
    CollinearCorners,
}
