//! Differences between an identified payload and the cell file.

use tangent_runtime::CellConfig;
use tangent_sensing::IdentifiedPayload;

/// Rotation between the identified sensor mounting and the cell file's from which a warning is
/// given, rad.
const MOUNTING_OFF_RAD: f64 = 0.035;
/// Relative spread of the fit's singular values from which a warning is given.
const ANISOTROPY_MAX: f64 = 0.05;

/// Warnings about an identified payload, as text.
pub fn warnings(found: &IdentifiedPayload, config: &CellConfig) -> Vec<String> {
    let mut all = Vec::new();
    let off = mounting_error_rad(found, config);
    if off > MOUNTING_OFF_RAD {
        let vector = found.flange_from_sensor.scaled_axis();
        all.push(format!(
            "the sensor is turned by {:.1} deg relative to [sensor.flange_from_sensor] rotation_vector_rad; the readings \
             give [{:.4}, {:.4}, {:.4}]",
            off.to_degrees(),
            vector.x,
            vector.y,
            vector.z
        ));
    }
    if found.anisotropy > ANISOTROPY_MAX {
        all.push(format!(
            "the weight of the payload differs by {:.0} % between the sensor's axes: a wrong calibration is loaded, or \
             something touched the tool",
            100.0 * found.anisotropy
        ));
    }
    if found.drift.is_none() {
        all.push(
            "the last pose is not the first one again: the drift between them is unknown"
                .to_owned(),
        );
    }
    all
}

/// Angle between the identified sensor mounting and the cell file's, rad.
pub fn mounting_error_rad(found: &IdentifiedPayload, config: &CellConfig) -> f64 {
    found
        .flange_from_sensor
        .angle_to(&config.sensor.flange_from_sensor().rotation())
}
