//! Faults of a force/torque sensor whose records keep arriving: for tests, and for `tangent
//! evaluate --set`.

use std::collections::VecDeque;

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use super::sample::SensorSample;

/// The `[plant.sensor.fault]` table. Times are the plant's, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum SensorFault {
    /// Every record repeats the last one before `from_s`.
    Frozen {
        /// Start of the fault, s.
        from_s: f64,
    },
    /// One axis keeps its value; the others work.
    StuckAxis {
        /// Axis, 0 (Fx) to 5 (Tz).
        axis: usize,
        /// Start of the fault, s.
        from_s: f64,
    },
    /// New records contain old readings, delayed by `delay_s`.
    Slow {
        /// Age of the readings, s.
        delay_s: f64,
        /// Start of the fault, s.
        from_s: f64,
    },
    /// The zero jumps.
    BiasStep {
        /// Size of the jump in counts, in the order of the axes.
        counts: [i32; 6],
        /// Start of the fault, s.
        from_s: f64,
    },
    /// Two axes are exchanged, as by a wrong connection: each has the other's value.
    SwappedAxes {
        /// The two axes, 0 (Fx) to 5 (Tz).
        axes: [usize; 2],
        /// Start of the fault, s.
        from_s: f64,
    },
    /// The reading no longer responds to load: the load stays at its value at `from_s`, while
    /// noise, drift and steps of a working sensor continue.
    Deaf {
        /// Axis without response, 0 (Fx) to 5 (Tz); all axes if absent.
        #[serde(default)]
        axis: Option<usize>,
        /// Offset of the constant load from its value at `from_s`, N along x, y and z.
        #[serde(default)]
        offset_n: [f64; 3],
        /// Start of the fault, s.
        from_s: f64,
    },
}

impl SensorFault {
    /// Key, value and allowed range of the first wrong setting, if any.
    pub(crate) fn mistake(&self) -> Option<(&'static str, f64, &'static str)> {
        match *self {
            Self::StuckAxis { axis, .. } if axis > 5 => {
                Some(("sensor.fault.axis", axis as f64, "0 (Fx) to 5 (Tz)"))
            }
            Self::SwappedAxes { axes: [a, b], .. } if a.max(b) > 5 => {
                Some(("sensor.fault.axes", a.max(b) as f64, "0 (Fx) to 5 (Tz)"))
            }
            Self::Deaf {
                axis: Some(axis), ..
            } if axis > 5 => Some(("sensor.fault.axis", axis as f64, "0 (Fx) to 5 (Tz)")),
            Self::Deaf { offset_n, .. } => offset_n
                .into_iter()
                .find(|n| !(-1000.0..=1000.0).contains(n))
                .map(|n| ("sensor.fault.offset_n", n, "-1000 to 1000 N")),
            Self::Slow { delay_s, .. } if !(0.0..=10.0).contains(&delay_s) => {
                Some(("sensor.fault.delay_s", delay_s, "0 to 10 s"))
            }
            _ => None,
        }
    }

    fn begins_s(&self) -> f64 {
        match *self {
            Self::Frozen { from_s }
            | Self::StuckAxis { from_s, .. }
            | Self::Slow { from_s, .. }
            | Self::BiasStep { from_s, .. }
            | Self::SwappedAxes { from_s, .. }
            | Self::Deaf { from_s, .. } => from_s,
        }
    }
}

/// An active fault and its state.
#[derive(Clone, Debug)]
pub(crate) struct FaultySensor {
    fault: SensorFault,
    /// The last sample before the fault.
    last: Option<SensorSample>,
    /// Samples of the last `delay_s`, oldest first.
    past: VecDeque<SensorSample>,
    /// Constant load of a sensor that does not respond, N and Nm.
    held: Option<Vector6<f64>>,
}

impl FaultySensor {
    pub fn new(fault: SensorFault, rate_hz: f64) -> Self {
        let kept = match fault {
            SensorFault::Slow { delay_s, .. } => (delay_s * rate_hz) as usize + 2,
            _ => 0,
        };
        Self {
            fault,
            last: None,
            past: VecDeque::with_capacity(kept),
            held: None,
        }
    }

    /// Load (N, Nm) that acts on the gauges at `time_s` in place of `wrench`. Noise, drift and
    /// steps are added later.
    pub fn load(&mut self, time_s: f64, wrench: &Vector6<f64>) -> Vector6<f64> {
        match self.fault {
            SensorFault::Deaf {
                axis,
                offset_n,
                from_s,
            } if time_s >= from_s => {
                let [x, y, z] = offset_n;
                let held = *self
                    .held
                    .get_or_insert(wrench + Vector6::new(x, y, z, 0.0, 0.0, 0.0));
                match axis {
                    None => held,
                    Some(axis) => {
                        let mut felt = *wrench;
                        felt[axis] = held[axis];
                        felt
                    }
                }
            }
            _ => *wrench,
        }
    }

    /// Record that the sensor delivers in place of `sample`.
    pub fn distort(&mut self, sample: SensorSample) -> SensorSample {
        if let SensorFault::Slow { delay_s, .. } = self.fault {
            self.past.push_back(sample);
            while self
                .past
                .get(1)
                .is_some_and(|next| next.time_s <= sample.time_s - delay_s)
            {
                self.past.pop_front();
            }
        }
        if sample.time_s < self.fault.begins_s() {
            self.last = Some(sample);
            return sample;
        }
        let mut counts = sample.counts;
        match self.fault {
            SensorFault::Frozen { .. } => counts = self.last.map_or(counts, |last| last.counts),
            SensorFault::StuckAxis { axis, .. } => {
                counts[axis] = self.last.map_or(counts, |last| last.counts)[axis];
            }
            SensorFault::Deaf { .. } => {}
            SensorFault::SwappedAxes { axes: [a, b], .. } => counts.swap(a, b),
            SensorFault::Slow { .. } => {
                counts = self.past.front().map_or(counts, |old| old.counts);
            }
            SensorFault::BiasStep { counts: step, .. } => {
                counts = std::array::from_fn(|i| counts[i].saturating_add(step[i]));
            }
        }
        SensorSample { counts, ..sample }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(fault: SensorFault) -> Vec<[i32; 6]> {
        let mut faulty = FaultySensor::new(fault, 1000.0);
        (0..10)
            .map(|k| {
                let sample = SensorSample {
                    time_s: f64::from(k) * 1e-3,
                    counts: [k; 6],
                    saturated: false,
                };
                faulty.distort(sample).counts
            })
            .collect()
    }

    #[test]
    fn faults_are_what_they_say() {
        let from_s = 4.5e-3;
        let at = |found: &[[i32; 6]], axis: usize| -> Vec<i32> {
            found.iter().map(|counts| counts[axis]).collect()
        };
        let frozen = read(SensorFault::Frozen { from_s });
        assert_eq!(at(&frozen, 2), [0, 1, 2, 3, 4, 4, 4, 4, 4, 4]);
        let stuck = read(SensorFault::StuckAxis { axis: 2, from_s });
        assert_eq!(at(&stuck, 2), at(&frozen, 2));
        assert_eq!(at(&stuck, 1), [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        let slow = read(SensorFault::Slow {
            delay_s: 3e-3,
            from_s,
        });
        assert_eq!(at(&slow, 0)[5..], [2, 3, 4, 5, 6]);
        let deaf = |axis| {
            let fault = SensorFault::Deaf {
                axis,
                offset_n: [0.0, 0.0, -1.0],
                from_s,
            };
            let mut faulty = FaultySensor::new(fault, 1000.0);
            (0..10)
                .map(|k| faulty.load(f64::from(k) * 1e-3, &Vector6::repeat(f64::from(k))))
                .collect::<Vec<_>>()
        };
        let z = |all: &[Vector6<f64>]| all.iter().map(|load| load[2]).collect::<Vec<_>>();
        let stays = [0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0];
        assert_eq!(z(&deaf(None)), stays);
        assert_eq!(z(&deaf(Some(2))), stays);
        assert_eq!(deaf(Some(2))[9][1], 9.0);
        let swapped = SensorFault::SwappedAxes {
            axes: [0, 2],
            from_s: 0.0,
        };
        let sample = SensorSample {
            time_s: 1.0,
            counts: [1, 2, 3, 4, 5, 6],
            saturated: false,
        };
        let found = FaultySensor::new(swapped, 1000.0).distort(sample);
        assert_eq!(found.counts, [3, 2, 1, 4, 5, 6]);
        let step = read(SensorFault::BiasStep {
            counts: [0, 0, -100, 0, 0, 0],
            from_s,
        });
        assert_eq!(at(&step, 2), [0, 1, 2, 3, 4, -95, -94, -93, -92, -91]);
    }
}
