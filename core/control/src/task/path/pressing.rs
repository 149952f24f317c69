//! Pressing force along a path.

use super::force_profile::{force_at, steepest_n_per_m};
use super::{Path, Pressing, Stretch};

impl Path {
    /// Whether strokes have forces of their own.
    pub fn has_forces(&self) -> bool {
        self.stretches
            .iter()
            .any(|stretch| stretch.pressing != Pressing::OfTask)
    }

    /// Pressing force at `time_s`, N: of its stroke, or of a profile there. `None`: the task's.
    pub(crate) fn force_n(&self, time_s: f64) -> Option<f64> {
        let index = (self.stretches).partition_point(|stretch| stretch.start_s <= time_s);
        let stretch = self.stretches.get(index.checked_sub(1)?)?;
        match stretch.pressing {
            Pressing::OfTask => None,
            Pressing::Constant(force_n) => Some(force_n),
            Pressing::Profile {
                first,
                count,
                offset_m,
            } => {
                let (distance, _) = stretch.profile.at(time_s - stretch.start_s);
                let way_m = offset_m + distance * stretch.shape.metres_per_unit();
                force_at(&self.profiles[first..first + count], way_m)
            }
        }
    }

    /// Gives the whole path a force that varies along it. `profile` counts the ways on the surface,
    /// without those above it.
    pub(crate) fn press_along(&mut self, profile: &[[f64; 2]]) {
        let first = self.profiles.len();
        self.profiles.extend_from_slice(profile);
        let lifts = &self.lifts;
        let above = |stretch: &Stretch| {
            let after = lifts.partition_point(|lift| lift.start_s <= stretch.start_s);
            let lift = after.checked_sub(1).and_then(|k| lifts.get(k));
            lift.is_some_and(|lift| stretch.start_s < lift.end_s)
        };
        let mut offset_m = 0.0;
        for stretch in &mut self.stretches {
            stretch.pressing = Pressing::Profile {
                first,
                count: profile.len(),
                offset_m,
            };
            if !above(stretch) {
                offset_m += stretch.length_m();
            }
        }
    }

    /// Fastest change of a force profile at the speed of the path, N/s.
    pub(crate) fn force_rate_max_n_per_s(&self) -> f64 {
        let rate = |stretch: &Stretch| match stretch.pressing {
            Pressing::OfTask | Pressing::Constant(_) => 0.0,
            Pressing::Profile { first, count, .. } => {
                let profile = &self.profiles[first..first + count];
                let speed = stretch.profile.speed_max() * stretch.shape.metres_per_unit();
                steepest_n_per_m(profile) * speed
            }
        };
        self.stretches.iter().map(rate).fold(0.0, f64::max)
    }

    /// Highest pressing force of a stroke, N; `None` if no stroke has its own.
    pub fn force_max_n(&self) -> Option<f64> {
        let constant = self.stretches.iter().filter_map(|s| match s.pressing {
            Pressing::Constant(force_n) => Some(force_n),
            Pressing::OfTask | Pressing::Profile { .. } => None,
        });
        let along = self.profiles.iter().map(|[_, force_n]| *force_n);
        constant.chain(along).max_by(f64::total_cmp)
    }

    /// Sets the force of the stretches from the index `first`.
    pub(super) fn press_with(&mut self, first: usize, force_n: Option<f64>) {
        for stretch in &mut self.stretches[first..] {
            stretch.pressing = force_n.map_or(Pressing::OfTask, Pressing::Constant);
        }
    }
}
