//! Who is told what happens in the cell, once per cycle, in the cell's thread.

use tangent_simulation::{OdometrySample, Truth};

use crate::arm_plant::ArmPlant;

/// Takes the truth about the contact.
pub type TruthListener = Box<dyn FnMut(&Truth) + Send>;
/// Takes what the platform under the arm says, with its age, s.
pub type OdometryListener = Box<dyn FnMut(&OdometrySample, f64) + Send>;

/// Those who listen to a cell.
#[derive(Default)]
pub struct Listeners {
    /// Of the contact.
    pub truth: Option<TruthListener>,
    /// Of the moving base.
    pub odometry: Option<OdometryListener>,
}

impl Listeners {
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
    }
}
