//! How the tool leaves what it touches: off before the zero is taken where it may touch, and the retraction at the end.
//!
//! Called by `advance`; what the force says of the motion is judged in `clearance`.

use nalgebra::Vector3;

use super::super::law::ArmNow;
use super::{Felt, UnifiedForceImpedance, Wanted};
use crate::clearance::Leaving;
use crate::wrench_guard::WrenchVerdict;
use crate::{Clearance, Fault, Phase, Profile};

/// Share of its way that a retraction really has to go to count.
const GONE_SHARE: f64 = 0.5;

impl UnifiedForceImpedance {
    /// Age of the zero that this run has taken, s.
    pub(super) fn zero_age_s(&self) -> Option<f64> {
        self.run.zeroed_s.map(|at_s| self.run.since_s - at_s)
    }

    /// Error of the zero that its age implies, N.
    pub(super) fn zero_bound_n(&self) -> Option<f64> {
        self.zero_age_s()
            .map(|age_s| self.config.touch.zero_drift_n_per_min * age_s / 60.0)
    }

    /// Keeps in mind where the tool may touch, and which way is away.
    pub(super) fn remember(&mut self, now: &ArmNow) {
        let phase = self.run.phase;
        if phase.is_active() && !matches!(phase, Phase::Tare | Phase::Clear) {
            let retracting = self.run.retract.filter(|_| phase == Phase::Retract);
            self.run.clearance = Clearance::Possible {
                normal: retracting.map_or_else(|| self.smooth_normal(now), |(normal, _)| normal),
                position: now.tool.translation(),
            };
        }
    }

    /// Phase `clear`: off along the last known normal until the force has been steady over some way. In any doubt it stands, and
    /// without a wrench until there is one again.
    pub(super) fn clear(&mut self, now: &ArmNow, felt: &Felt, dt: f64) -> Wanted {
        let leave = self.config.leave;
        let start = *self.run.held.get_or_insert(now.tool.translation());
        let way_out = self.run.clearance.way_out(&leave, &start);
        let (normal, fault) = match (way_out, felt.verdict) {
            (Ok(_), WrenchVerdict::Retract(why)) => (Vector3::zeros(), Some(Fault::Wrench(why))),
            (Ok(Some(normal)), _) => (normal, None),
            _ => (Vector3::zeros(), Some(Fault::NotClear)),
        };
        if let Some(fault) = fault {
            self.fail(fault);
            return self.hold(now);
        }
        let good = felt.verdict == WrenchVerdict::Good;
        let (mut way, mut speed) = self.run.clear;
        // A tool that does not feel what it meets waits.
        let goes = good && !self.run.paused;
        let wanted = if goes { leave.speed_m_per_s } else { 0.0 };
        let change = self.config.path.acceleration_m_per_s2 * dt;
        speed += (wanted - speed).clamp(-change, change);
        way += speed * dt;
        self.run.clear = (way, speed);
        if let Some(wrench) = felt.wrench.filter(|_| good) {
            let force = now.tool.rotate(&wrench.fixed_rows::<3>(0).into_owned());
            let gone_m = (now.tool.translation() - start).dot(&normal);
            let release_max_n = (2.0 * self.task.force.reference_n).max(10.0);
            match self
                .run
                .leave
                .clear(&leave, &normal, gone_m, &force, release_max_n)
            {
                Leaving::Free => {
                    self.run.clearance = Clearance::Free;
                    self.run.held = None;
                    self.enter(Phase::Tare);
                    return self.hold(now);
                }
                Leaving::Going if way <= leave.distance_max_m => {}
                Leaving::Going | Leaving::Opposed => {
                    self.fail(Fault::NotClear);
                    return self.hold(now);
                }
            }
        }
        let wanted = self.hold(now);
        moved(wanted, &normal, way, speed)
    }

    /// The retraction: slow where nothing is felt, and it stops where something is in the way.
    pub(super) fn retract(&mut self, now: &ArmNow, felt: &Felt, dt: f64) -> Wanted {
        let start = self.hold(now);
        let (leave, end) = (self.config.leave, self.task.end);
        let away = self.smooth_normal(now);
        let (direction, profile) = *self.run.retract.get_or_insert_with(|| {
            let profile = Profile::new(
                end.retract_distance_m,
                end.retract_speed_m_per_s,
                self.config.path.acceleration_m_per_s2,
                self.config.path.jerk_m_per_s3,
            );
            (away, profile)
        });
        let gone_m = (now.tool.translation() - start.reference.position).dot(&direction);
        let good = felt.verdict == WrenchVerdict::Good;
        let rate = if let Some(wrench) = felt.wrench.filter(|_| good) {
            let force = now.tool.rotate(&wrench.fixed_rows::<3>(0).into_owned());
            let moment_nm = wrench.fixed_rows::<3>(3).norm();
            self.run.left = self.run.leave.retract(&leave, gone_m, &force, moment_nm);
            1.0
        } else {
            self.run.leave.blind();
            self.run.left = Leaving::Going;
            (leave.blind_speed_m_per_s / end.retract_speed_m_per_s).min(1.0)
        };
        if self.run.left == Leaving::Opposed {
            // On along the same way it would press harder; which way is away is not known now.
            self.run.clearance = Clearance::Unknown;
            self.run.fault = self.run.fault.or(Some(Fault::RetractOpposed));
            self.run.held = None;
            self.run.push_n = 0.0;
            self.enter(Phase::Fault);
            return self.hold(now);
        }
        self.run.retract_s += rate * dt;
        let (way, speed) = profile.at(self.run.retract_s);
        let wanted = moved(start, &direction, way, rate * speed);
        if self.run.retract_s > profile.duration_s() + 0.1 {
            // An arm that did not follow has left nothing.
            self.run.off = gone_m > GONE_SHARE * end.retract_distance_m;
            if self.run.off && self.run.left == Leaving::Free {
                self.run.clearance = Clearance::Free;
            }
            self.run.held = Some(wanted.reference.position);
            let then = self.run.after_retract;
            self.enter(then);
        }
        wanted
    }
}

/// The reference, so far and so fast along `direction`.
fn moved(mut wanted: Wanted, direction: &Vector3<f64>, way_m: f64, speed_m_per_s: f64) -> Wanted {
    wanted.reference.position += direction * way_m;
    wanted.reference.velocity = direction * speed_m_per_s;
    wanted.policy = wanted.reference.position;
    wanted
}
