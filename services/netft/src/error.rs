//! Errors of the service other than those of the stream, which reconnects by itself.

use tangent_runtime::BusError;
use tangent_sensing::SensingError;

/// Why the service cannot work.
#[derive(Debug, thiserror::Error)]
pub enum NetftError {
    /// The bus refused a topic or a query.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A parameter of the conditioning is out of range.
    #[error("[sensor] and [tool]: {0}")]
    Conditioning(#[from] SensingError),
    /// The box does not answer.
    #[error(
        "no Net F/T box answers at {address} ({reason}): check its address, its cable and its power"
    )]
    Unreachable {
        /// Host and port.
        address: String,
        /// Error of the system.
        reason: String,
    },
    /// The answer of the box cannot be used.
    #[error("the box at {address} cannot be used: {reason}")]
    Configuration {
        /// Host and port.
        address: String,
        /// The problem.
        reason: BoxConfigError,
    },
    /// A socket or a thread could not be created.
    #[error("{action}: {source}")]
    System {
        /// Attempted action.
        action: &'static str,
        /// Error of the system.
        source: std::io::Error,
    },
}

/// Why the answer of a box cannot be used: the element, its value and what is allowed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BoxConfigError {
    /// The box answers with another HTTP status than success.
    #[error("{path} is answered with HTTP status {status}: is this a Net F/T box?")]
    HttpStatus {
        /// Path of the request.
        path: String,
        /// The status.
        status: u16,
    },
    /// The text is not XML.
    #[error("/netftapi2.xml is not XML: {0}")]
    NotXml(#[from] roxmltree::Error),
    /// An element does not exist or is empty.
    #[error("<{tag}> is missing")]
    Missing {
        /// Name of the element.
        tag: String,
    },
    /// An element is not a finite number.
    #[error("<{tag}> is `{text}`, not a number")]
    NotANumber {
        /// Name of the element.
        tag: String,
        /// Its text.
        text: String,
    },
    /// Counts per unit are zero or negative.
    #[error("<{tag}> is {counts}: counts per unit must be positive")]
    CountsNotPositive {
        /// Name of the element.
        tag: String,
        /// Counts per unit.
        counts: f64,
    },
    /// Counts per unit that no sensor has.
    #[error(
        "<{tag}> is {counts}: one count would be {value:e} N or Nm; sensors have from {least:e} to {most}"
    )]
    CountOutOfRange {
        /// Name of the element.
        tag: String,
        /// Counts per unit.
        counts: f64,
        /// One count, N or Nm.
        value: f64,
        /// Least plausible count, N or Nm.
        least: f64,
        /// Greatest plausible count, N or Nm.
        most: f64,
    },
    /// A rate of records that no box has.
    #[error("<comrdtrate> is {rate_hz:?}: a box sends from {least} to {most} records per second")]
    RateOutOfRange {
        /// Records per second.
        rate_hz: f64,
        /// Least rate, Hz.
        least: f64,
        /// Greatest rate, Hz.
        most: f64,
    },
    /// A unit of force or torque that is not known.
    #[error("<{tag}> is `{text}`, which is not a known unit; known are {}", known.join(", "))]
    UnknownUnit {
        /// Name of the element.
        tag: String,
        /// The unit.
        text: String,
        /// Known units, in lower case.
        known: Vec<&'static str>,
    },
}
