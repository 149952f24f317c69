//! Flange pose and pressing force over the last moments: a frame is processed with the state of the
//! arm at its exposure.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use tangent_mechanics::{Base, Flange, Pose};

/// Number of entries kept: a quarter of a second at 1 kHz.
const ENTRIES: usize = 256;

/// State of the arm at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct ArmMoment {
    pub time_s: f64,
    pub base_from_flange: Pose<Base, Flange>,
    /// Deflection of the object, expressed as the force that causes it (N, along the normal, base
    /// axes).
    pub yielding_n: Vector3<f64>,
}

/// Ring buffer of the last moments, in order of time.
#[derive(Clone, Debug, Default)]
pub(super) struct ArmHistory {
    ring: ArrayVec<ArmMoment, ENTRIES>,
    next: usize,
}

impl ArmHistory {
    pub fn clear(&mut self) {
        self.ring.clear();
        self.next = 0;
    }

    /// Adds a moment; ignored unless it is later than the last one.
    pub fn push(&mut self, moment: ArmMoment) {
        if self
            .newest()
            .is_some_and(|last| moment.time_s <= last.time_s)
        {
            return;
        }
        if self.ring.is_full() {
            self.ring[self.next] = moment;
            self.next = (self.next + 1) % ENTRIES;
        } else {
            self.ring.push(moment);
        }
    }

    pub fn newest(&self) -> Option<&ArmMoment> {
        let count = self.ring.len();
        let last = (self.next + count).checked_sub(1)?;
        self.ring.get(last.checked_rem(count)?)
    }

    fn nth(&self, i: usize) -> &ArmMoment {
        &self.ring[(self.next + i) % self.ring.len()]
    }

    /// State of the arm at `time_s`, interpolated between its neighbours; `None` outside the stored
    /// time.
    pub fn at(&self, time_s: f64) -> Option<ArmMoment> {
        let (mut low, mut high) = (0, self.ring.len().checked_sub(1)?);
        // Rounding of the clock must not reject a frame of the current cycle.
        let slack = 1e-6;
        if !(time_s >= self.nth(low).time_s - slack && time_s <= self.nth(high).time_s + slack) {
            return None;
        }
        while high - low > 1 {
            let middle = (low + high) / 2;
            if self.nth(middle).time_s <= time_s {
                low = middle;
            } else {
                high = middle;
            }
        }
        let (a, b) = (self.nth(low), self.nth(high));
        let span = b.time_s - a.time_s;
        let share = if span > 0.0 {
            ((time_s - a.time_s) / span).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let (from, to) = (&a.base_from_flange, &b.base_from_flange);
        Some(ArmMoment {
            time_s,
            base_from_flange: Pose::new(
                from.translation().lerp(&to.translation(), share),
                from.rotation().nlerp(&to.rotation(), share),
            ),
            yielding_n: a.yielding_n.lerp(&b.yielding_n, share),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn moment(time_s: f64) -> ArmMoment {
        ArmMoment {
            time_s,
            base_from_flange: Pose::new(Vector3::x() * time_s, UnitQuaternion::identity()),
            yielding_n: Vector3::z() * time_s,
        }
    }

    #[test]
    fn it_answers_for_all_it_remembers_and_nothing_else() {
        let mut history = ArmHistory::default();
        assert!(history.at(0.0).is_none());
        for i in 0..1000 {
            history.push(moment(f64::from(i) * 1e-3));
            let newest = history.newest().unwrap().time_s;
            assert_eq!(newest, f64::from(i) * 1e-3);
        }
        for t in [0.9985, 0.75, 0.7441, 0.999] {
            let at = history.at(t).unwrap();
            assert!(
                (at.base_from_flange.translation().x - t).abs() < 1e-12,
                "{t}"
            );
            assert!((at.yielding_n.z - t).abs() < 1e-12);
        }
        assert!(history.at(0.7).is_none(), "forgotten");
        assert!(history.at(1.01).is_none(), "not yet");
        history.push(moment(0.5));
        assert_eq!(history.newest().unwrap().time_s, 0.999);
    }
}
