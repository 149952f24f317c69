//! Hand-over of a plant's sensor records to the box that sends them.

use std::time::Instant;

use tangent_simulation::SensorSample;

/// Takes the records of the force/torque sensor once per control period, in the thread of the arm.
///
/// Arguments: start of the period on the host's clock; start of the period on the plant's clock, s;
/// the records of the period, oldest first.
pub type RecordListener = Box<dyn FnMut(Instant, f64, &[SensorSample]) + Send>;
