//! A measured zero of the sensor, and the ground on which it was taken.

use serde::{Deserialize, Serialize};
use tangent_mechanics::{Sensor, Wrench};

/// A measured zero of the sensor: its reading without payload and contact.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_mechanics::{Sensor, Wrench};
/// use tangent_sensing::{Tare, TareConfig, TareGround, TareRefusal};
///
/// let zero = |force_n: f64, time_s: f64| {
///     let bias = Wrench::<Sensor>::new(Vector3::new(0.0, 0.0, force_n), Vector3::zeros());
///     Tare::first(bias, Wrench::zero(), 500, time_s)
/// };
/// let (before, now) = (zero(12.0, 0.0), zero(15.0, 60.0));
/// // A jump of 3 N within a minute may be a load, unless a person confirms that the tool is free.
/// let config = TareConfig::default();
/// let refusal = config.judge(&now, TareGround::Assumed, Some(&before)).unwrap_err();
/// assert!(matches!(refusal, TareRefusal::Jump { .. }));
/// assert!(config.judge(&now, TareGround::SaidClear, Some(&before)).is_ok());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tare {
    /// Wrench to subtract from every reading, besides that of the payload, N and Nm.
    pub bias: Wrench<Sensor>,
    /// Standard deviation of the averaged readings, N and Nm.
    pub std: Wrench<Sensor>,
    /// Number of readings averaged.
    pub samples: u32,
    /// Time at which the average was complete, on the clock of [`crate::Reading::time_s`], s.
    pub time_s: f64,
    /// Evidence that the tool was free of contact meanwhile.
    pub ground: TareGround,
    /// The zero that later ones are judged against: the last one that a person or a motion has
    /// confirmed. Small jumps therefore do not add up.
    pub vouched: ZeroPoint,
    /// The last zero after a motion had shown that the tool was free of contact, or the first zero
    /// of all. The limit on the untared reading is relative to it, so that no later zero can hide a
    /// load.
    pub shown: ZeroPoint,
}

impl Tare {
    /// First zero of a sensor, without another to judge it by.
    pub fn first(bias: Wrench<Sensor>, std: Wrench<Sensor>, samples: u32, time_s: f64) -> Self {
        let zero = ZeroPoint { bias, time_s };
        Self {
            bias,
            std,
            samples,
            time_s,
            ground: TareGround::Assumed,
            vouched: zero,
            shown: zero,
        }
    }

    /// This zero as the successor of the one before it.
    pub fn following(self, ground: TareGround, before: Option<&Self>) -> Self {
        let (vouched, shown) = match (ground, before) {
            (TareGround::Shown, _) | (_, None) => (self.zero(), self.zero()),
            (TareGround::SaidClear, Some(before)) => (self.zero(), before.shown),
            (TareGround::Assumed, Some(before)) => (before.vouched, before.shown),
        };
        Self {
            ground,
            vouched,
            shown,
            ..self
        }
    }

    /// Bias and time of this zero.
    pub fn zero(&self) -> ZeroPoint {
        ZeroPoint {
            bias: self.bias,
            time_s: self.time_s,
        }
    }
}

/// Evidence that the tool is free of contact while a zero is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TareGround {
    /// None, except that the zero is near the one before.
    #[default]
    Assumed,
    /// A person has confirmed that the tool is free.
    SaidClear,
    /// A motion away from the surface has shown it.
    Shown,
}

/// A zero and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZeroPoint {
    /// Reading of the sensor without the payload, N and Nm.
    pub bias: Wrench<Sensor>,
    /// Time on the clock of [`crate::Reading::time_s`], s.
    pub time_s: f64,
}
