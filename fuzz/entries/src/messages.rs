//! Messages on the bus: CDR bytes to each type, and back.

use serde::Serialize;
use serde::de::DeserializeOwned;
use tangent_schemas::cdr::{decode, encode};
use tangent_schemas::{standard, tangent};

/// The first byte selects the type. A decoded message is encoded again; the result decodes to the
/// same message and encodes to the same bytes.
pub fn cdr(data: &[u8]) {
    let Some((&kind, bytes)) = data.split_first() else {
        return;
    };
    let check: fn(&[u8]) = match kind % 22 {
        0 => check::<tangent::ArmState>,
        1 => check::<tangent::ArmCommand>,
        2 => check::<tangent::WrenchStatus>,
        3 => check::<tangent::NormalEstimate>,
        4 => check::<tangent::FeatureArray>,
        5 => check::<tangent::ObjectEstimate>,
        6 => check::<tangent::SurfaceSegment>,
        7 => check::<tangent::SurfaceAhead>,
        8 => check::<tangent::ControlState>,
        9 => check::<tangent::ShapingState>,
        10 => check::<tangent::Health>,
        11 => check::<tangent::ContactTruth>,
        12 => check::<tangent::Request>,
        13 => check::<tangent::Answer>,
        14 => check::<standard::WrenchStamped>,
        15 => check::<standard::PoseWithCovarianceStamped>,
        16 => check::<standard::Image>,
        17 => check::<standard::CameraInfo>,
        18 => check::<standard::MarkerArray>,
        19 => check::<standard::TFMessage>,
        20 => check::<tangent::OperatorCommand>,
        _ => check::<tangent::CoverageState>,
    };
    check(bytes);
}

fn check<T: Serialize + DeserializeOwned>(bytes: &[u8]) {
    let Ok(message) = decode::<T>(bytes) else {
        return;
    };
    let mut first = Vec::new();
    if encode(&message, &mut first).is_err() {
        return;
    }
    let again: T = decode(&first).expect("what was just written can be read");
    let mut second = Vec::new();
    encode(&again, &mut second).expect("what was written once can be written again");
    assert_eq!(first, second);
}
