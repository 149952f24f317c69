//! Callbacks with the state of the plant, once per cycle, in the thread of the controller.

use std::time::Instant;

use tangent_mechanics::{Base, Flange, Pose};
use tangent_simulated_device::RecordListener;
use tangent_simulation::{OdometrySample, SensorSample, True, Truth};

use crate::plant::ArmPlant;

/// Takes the ground truth of the contact.
pub type TruthListener = Box<dyn FnMut(&Truth) + Send>;
/// Takes a sample of the odometry of the moving base, with its age, s.
pub type OdometryListener = Box<dyn FnMut(&OdometrySample, f64) + Send>;
/// Takes the simulated time, s, and the true pose of the flange.
pub type FlangeListener = Box<dyn FnMut(f64, &True<Pose<Base, Flange>>) + Send>;

/// Callbacks of one controller.
#[derive(Default)]
pub struct Listeners {
    /// Ground truth of the contact, if there is a surface.
    pub truth: Option<TruthListener>,
    /// Odometry of the moving base, if there is one.
    pub odometry: Option<OdometryListener>,
    /// True pose of the flange, for a camera on it.
    pub flange: Option<FlangeListener>,
    /// Records of the force/torque sensor.
    pub records: Option<RecordListener>,
}

impl Listeners {
    /// The sensor's records of the period that began at `start`, and at `before_s` on the plant's
    /// clock.
    pub(super) fn hand_over(&mut self, start: Instant, before_s: f64, records: &[SensorSample]) {
        if let Some(listener) = &mut self.records {
            listener(start, before_s, records);
        }
    }

    pub(super) fn tell(&mut self, plant: &dyn ArmPlant, truth: Option<&Truth>) {
        if let (Some(listener), Some(truth)) = (&mut self.truth, truth) {
            listener(truth);
        }
        if let Some(listener) = &mut self.odometry {
            let now_s = plant.arm().time_s;
            for sample in plant.odometry() {
                listener(sample, now_s - sample.stamp_s);
            }
        }
        if let (Some(listener), Some(flange)) = (&mut self.flange, plant.true_base_from_flange()) {
            listener(plant.arm().time_s, &flange);
        }
    }
}
