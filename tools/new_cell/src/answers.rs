//! What has to be known of a new cell.

use tangent_mechanics::ModelData;
use tangent_mechanics::names::did_you_mean;
use tangent_rtde::codec::Series;
use tangent_rtde::settings::series_of;

use crate::error::NewCellError;

/// A new cell.
#[derive(Clone, Debug, PartialEq)]
pub struct NewCell {
    /// Name of the cell: letters, digits, `_` and `-`.
    pub name: String,
    /// Built-in model of the arm.
    pub model: String,
    /// Host name or IP address of the robot's controller.
    pub robot_address: String,
    /// The force/torque sensor.
    pub sensor: Sensor,
}

/// The force/torque sensor of a cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Sensor {
    /// An ATI Net F/T box.
    Netft {
        /// Host name or IP address of the box.
        address: String,
    },
    /// The sensor in the flange of an e-Series arm.
    Ur {
        /// Its ranges.
        ranges: Ranges,
    },
    /// A wrench that another program publishes.
    Topic {
        /// Key of the topic.
        key: String,
        /// Messages per second.
        rate_hz: f64,
        /// Ranges of the sensor.
        ranges: Ranges,
    },
    /// None: the arm estimates the wrench from its joints.
    Joints,
}

/// Kinds of sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorKind {
    /// An ATI Net F/T box.
    Netft,
    /// The sensor in the flange of an e-Series arm.
    Ur,
    /// A wrench that another program publishes.
    Topic,
    /// None: the arm estimates the wrench from its joints.
    Joints,
}

/// Loads beyond which a sensor saturates, each along or about x, y and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranges {
    /// Force, N.
    pub force_n: f64,
    /// Torque, Nm.
    pub torque_nm: f64,
}

impl SensorKind {
    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Netft => "netft",
            Self::Ur => "ur",
            Self::Topic => "topic",
            Self::Joints => "joints",
        }
    }
}

/// Whether the arm is a Franka, by its model.
pub fn is_franka(model: &str) -> bool {
    model == "panda"
}

/// Sensors that fit an arm, the usual one first.
///
/// # Errors
/// There is no such arm.
pub fn kinds_of(model: &str) -> Result<&'static [SensorKind], NewCellError> {
    if ModelData::builtin(model).is_err() {
        let known: Vec<&str> = ModelData::builtin_names().collect();
        return Err(NewCellError::Model {
            model: model.to_owned(),
            suggestion: did_you_mean(model, known.iter().copied()),
            known: known.join(", "),
        });
    }
    Ok(if is_franka(model) {
        &[SensorKind::Joints]
    } else if series_of(model) == Some(Series::ESeries) {
        &[SensorKind::Ur, SensorKind::Netft, SensorKind::Topic]
    } else {
        &[SensorKind::Netft, SensorKind::Topic]
    })
}

/// Ranges of the sensor in the flange of an arm, from its data sheet; `None` for arms without such
/// a sensor, and for those whose ranges are not known here.
pub fn ranges_of(model: &str) -> Option<Ranges> {
    let force_n = match model {
        "ur3e" => 30.0,
        "ur5e" => 50.0,
        "ur10e" => 100.0,
        _ => return None,
    };
    Some(Ranges {
        force_n,
        torque_nm: 10.0,
    })
}
