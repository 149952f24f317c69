//! Why a tare is refused.

use crate::Validity;

/// Why a tare was refused. The zero before it stays in force.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TareRefusal {
    /// A reading was not usable.
    #[error("a reading was unusable ({}): correct that first", .0.reason())]
    BadReading(Validity),
    /// There is a payload, and the orientation of the arm is not known.
    #[error(
        "the arm's orientation is {}: without it the payload's weight cannot be separated from the zero; is the robot's \
         bridge running?",
        .0.reason()
    )]
    NoOrientation(Validity),
    /// The tool moved.
    #[error(
        "the tool moved by {travel_m:.4} m and {turn_rad:.4} rad during the average: hold it still"
    )]
    Moving {
        /// Distance moved, m.
        travel_m: f64,
        /// Rotation, rad.
        turn_rad: f64,
    },
    /// The standard deviation of the readings is too large.
    #[error(
        "the readings scatter by {force_n:.3} N and {torque_nm:.4} Nm (standard deviation, worst axis): the tool vibrates \
         or touches something"
    )]
    Scattered {
        /// Standard deviation in the worst axis, N.
        force_n: f64,
        /// Standard deviation in the worst axis, Nm.
        torque_nm: f64,
    },
    /// The mean changed from the first half to the second.
    #[error(
        "the readings drifted by {force_n:.3} N and {torque_nm:.4} Nm during the average: something pulls at the tool, or \
         it has not settled"
    )]
    Wandering {
        /// Change of the mean in the worst axis, N.
        force_n: f64,
        /// Change of the mean in the worst axis, Nm.
        torque_nm: f64,
    },
    /// The new zero differs too much from the last good one.
    #[error(
        "the zero would differ by {force_n:.2} N and {torque_nm:.3} Nm: if the tool hangs free, run `tangent tare --clear`; \
         else it touches something, or was changed. The last good zero is {age_s:.0} s old; drift explains {force_max_n:.2} \
         N and {torque_max_nm:.3} Nm"
    )]
    Jump {
        /// Difference in the worst axis, N.
        force_n: f64,
        /// Largest difference allowed at that age, N.
        force_max_n: f64,
        /// Difference in the worst axis, Nm.
        torque_nm: f64,
        /// Largest difference allowed at that age, Nm.
        torque_max_nm: f64,
        /// Age of the last good zero, s.
        age_s: f64,
    },
    /// The mean force is too large for a zero.
    #[error(
        "the mean force at rest is {force_n:.1} N, and a zero is at most {force_max_n} N: the tool touches something, or \
         its mass is set wrong"
    )]
    TooLarge {
        /// Mean force, N.
        force_n: f64,
        /// Largest mean force allowed, N.
        force_max_n: f64,
    },
    /// The zero would take too large a share of the sensor's rating.
    #[error(
        "the sensor reads {:.0} % of its rating beyond the payload, and a zero is at most {:.0} %: the tool touches \
         something, or the payload is wrong. If you see that it hangs free, run `tangent tare --clear`",
        100.0 * .share, 100.0 * .share_max
    )]
    Loaded {
        /// Share of the rating in the worst axis, from 0; above 1 beyond the rating.
        share: f64,
        /// Largest share allowed.
        share_max: f64,
    },
}
