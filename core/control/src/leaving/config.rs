//! Parameters of a motion away from the surface, the same for every law.

use serde::{Deserialize, Serialize};

/// How the tool leaves a surface, and how it is shown to be free.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LeaveConfig {
    /// Speed in phase `clear`, m/s.
    pub speed_m_per_s: f64,
    /// Distance over which the force must be steady for the tool to count as free, m.
    pub free_m: f64,
    /// Change of the force within that distance that still counts as steady, N.
    pub steady_n: f64,
    /// Maximum distance in phase `clear`, m.
    pub distance_max_m: f64,
    /// Increase of the force against or across the motion, relative to the start of phase `clear`,
    /// that is tolerated in that phase, N.
    pub grow_n: f64,
    /// Increase of the force above the minimum since the start of a retraction that is tolerated,
    /// N.
    pub opposed_n: f64,
    /// Increase of the torque above the minimum since the start of a retraction that is tolerated,
    /// Nm.
    pub opposed_nm: f64,
    /// Highest speed of a retraction without a usable wrench, m/s.
    pub blind_speed_m_per_s: f64,
    /// Maximum distance of the tool from the place of the last known normal at which that normal is
    /// still used, m.
    pub near_m: f64,
    /// A touch within this distance of the place of the tare means that the tare was taken in
    /// contact, m.
    pub touch_at_once_m: f64,
}

impl Default for LeaveConfig {
    fn default() -> Self {
        Self {
            speed_m_per_s: 0.01,
            free_m: 0.005,
            steady_n: 0.5,
            distance_max_m: 0.05,
            grow_n: 2.0,
            opposed_n: 5.0,
            opposed_nm: 1.0,
            blind_speed_m_per_s: 0.01,
            near_m: 0.02,
            touch_at_once_m: 0.0005,
        }
    }
}
