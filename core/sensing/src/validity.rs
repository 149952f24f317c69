//! Whether a reading or an estimate can be used, and if not, the reason.

/// Whether an input can be used, and if not, the reason. Messages carry the numeric value.
///
/// ```
/// use tangent_sensing::Validity;
/// assert!(Validity::from(0).is_valid());
/// assert_eq!(Validity::from(3).reason(), "sensor saturated");
/// // A code of a newer version is never usable.
/// assert_eq!(Validity::from(200), Validity::SensorError);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Validity {
    /// Can be used.
    Valid = 0,
    /// Nothing has been received yet.
    #[default]
    Missing = 1,
    /// Older than its reader tolerates.
    Stale = 2,
    /// A strain gauge is saturated: the numbers look plausible and are wrong.
    Saturated = 3,
    /// NaN or infinite.
    NotFinite = 4,
    /// The sensor reports an error.
    SensorError = 5,
    /// The tool is not in contact.
    NoContact = 6,
    /// In contact, but the tool does not slide fast enough for a direction of sliding to exist.
    NotSliding = 7,
    /// Too few or too badly spread samples for a fit.
    Degenerate = 8,
    /// Too far from the estimate in use.
    Disagrees = 9,
    /// The base moves, and its motion is not known.
    BaseUnknown = 10,
    /// Records arrive and are all equal, which the noise of this sensor rules out.
    Frozen = 11,
    /// The value of one axis stays constant while the others vary.
    AxisStuck = 12,
    /// The reading does not follow the motion of the tool against the surface.
    Unresponsive = 13,
    /// Too many readings jump in a way that no load can cause: damaged records.
    Implausible = 14,
    /// The measured force points where no contact can press: further from the normal in use than
    /// friction and the error of that normal allow.
    Misdirected = 15,
    /// The zero of the sensor has jumped: the reading was level, changed within two milliseconds,
    /// and was level again.
    ZeroJumped = 16,
}

impl Validity {
    /// True only for [`Validity::Valid`].
    pub fn is_valid(self) -> bool {
        self == Self::Valid
    }

    /// Whether the fault was found from many readings. Unlike a single bad reading, it does not end
    /// by itself with the next one.
    pub fn is_judged_over_time(self) -> bool {
        matches!(
            self,
            Self::Frozen
                | Self::AxisStuck
                | Self::Unresponsive
                | Self::Implausible
                | Self::Misdirected
                | Self::ZeroJumped
        )
    }

    /// Reason as text for the operator.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::Missing => "nothing received yet",
            Self::Stale => "too old",
            Self::Saturated => "sensor saturated",
            Self::NotFinite => "not a finite number",
            Self::SensorError => "sensor reports an error",
            Self::NoContact => "no contact",
            Self::NotSliding => "not sliding",
            Self::Degenerate => "too few or badly spread samples",
            Self::Disagrees => "too far from the estimate in use",
            Self::BaseUnknown => "the motion of the base is not known",
            Self::Frozen => {
                "sensor frozen: its records repeat; restart the sensor, check its cable and transducer"
            }
            Self::AxisStuck => {
                "one axis of the sensor is stuck: restart the sensor, check its cable and transducer"
            }
            Self::Unresponsive => {
                "the reading does not answer to the tool's motion: check the sensor, its mounting and its delay"
            }
            Self::Implausible => {
                "readings jump as no load can: check the network and the sensor for damaged records"
            }
            Self::Misdirected => {
                "the force points along the surface, not out of it: check the sensor's zero, axes and mounting"
            }
            Self::ZeroJumped => {
                "the sensor's zero jumped: look for another program that sets it, check its cable and transducer"
            }
        }
    }
}

impl From<u8> for Validity {
    /// An unknown code counts as a sensor error: never usable.
    fn from(code: u8) -> Self {
        match code {
            0 => Self::Valid,
            1 => Self::Missing,
            2 => Self::Stale,
            3 => Self::Saturated,
            4 => Self::NotFinite,
            6 => Self::NoContact,
            7 => Self::NotSliding,
            8 => Self::Degenerate,
            9 => Self::Disagrees,
            10 => Self::BaseUnknown,
            11 => Self::Frozen,
            12 => Self::AxisStuck,
            13 => Self::Unresponsive,
            14 => Self::Implausible,
            15 => Self::Misdirected,
            16 => Self::ZeroJumped,
            _ => Self::SensorError,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_comes_back_and_an_unknown_one_is_never_usable() {
        for code in 0..=16 {
            assert_eq!(Validity::from(code) as u8, code);
        }
        for code in 17..=u8::MAX {
            assert_eq!(Validity::from(code), Validity::SensorError);
        }
    }

    #[test]
    fn reasons_fit_a_message_and_differ() {
        for a in 0..=15u8 {
            let reason = Validity::from(a).reason();
            assert!(reason.len() <= 120, "{reason}");
            for b in 0..a {
                assert_ne!(reason, Validity::from(b).reason());
            }
        }
    }
}
