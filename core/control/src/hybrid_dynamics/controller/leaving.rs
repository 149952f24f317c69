//! How the tool leaves what it touches: off before the tare where it may touch, and the retraction at the end.
//!
//! Called by `advance`; what the force says of the motion is judged in `clearance`.

use nalgebra::Vector3;

use super::super::law::{ArmNow, MotionReference};
use super::{Felt, HybridDynamics, Wanted};
use crate::clearance::Leaving;
use crate::wrench_guard::WrenchVerdict;
use crate::{Clearance, Fault, Phase, Profile};

/// Share of its way that a retraction really has to go to count.
const GONE_SHARE: f64 = 0.5;

impl HybridDynamics {
    /// Keeps in mind where the tool may touch, and which way is away.
    pub(super) fn remember(&mut self, normal: &Vector3<f64>, now: &ArmNow) {
        let phase = self.run.phase;
        if phase.is_active() && !matches!(phase, Phase::Tare | Phase::Clear) {
            let retracting = self.run.retract.filter(|_| phase == Phase::Retract);
            self.run.clearance = Clearance::Possible {
                normal: retracting.map_or(*normal, |(normal, _)| normal),
                position: now.tool.translation(),
            };
        }
    }

    /// Phase `clear`: off along the last known normal until the force has been steady over some way. In any doubt it stands, and
    /// without a wrench until there is one again.
    pub(super) fn clear(
        &mut self,
        now: &ArmNow,
        felt: Option<&Felt>,
        verdict: WrenchVerdict,
        dt: f64,
    ) -> Wanted {
        let leave = self.config.leave;
        let pose = *self.run.held.get_or_insert(now.tool);
        let way_out = self.run.clearance.way_out(&leave, &pose.translation());
        let (normal, fault) = match (way_out, verdict) {
            (Ok(_), WrenchVerdict::Retract(why)) => (Vector3::zeros(), Some(Fault::Wrench(why))),
            (Ok(Some(normal)), _) => (normal, None),
            _ => (Vector3::zeros(), Some(Fault::NotClear)),
        };
        if let Some(fault) = fault {
            self.fail(fault);
            return self.hold(now);
        }
        let (mut way, mut speed) = self.run.clear;
        // A tool that does not feel what it meets waits.
        let wanted = if felt.is_some() && !self.paused {
            leave.speed_m_per_s
        } else {
            0.0
        };
        let change = self.config.path.acceleration_m_per_s2 * dt;
        speed += (wanted - speed).clamp(-change, change);
        way += speed * dt;
        self.run.clear = (way, speed);
        if let Some(felt) = felt {
            let gone_m = (now.tool.translation() - pose.translation()).dot(&normal);
            let release_max_n = (2.0 * self.task.force.reference_n).max(10.0);
            let watch = &mut self.run.leave;
            match watch.clear(&leave, &normal, gone_m, &felt.force, release_max_n) {
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
        moved(MotionReference::at_rest(&pose), &normal, way, speed)
    }

    /// The retraction: slow where nothing is felt, and it stops where something is in the way.
    pub(super) fn retract(&mut self, now: &ArmNow, felt: Option<&Felt>, dt: f64) -> Wanted {
        let constraint = self.constraint(now);
        let leave = self.config.leave;
        let pose = *self.run.held.get_or_insert(now.tool);
        let end = self.task.end;
        let (normal, profile) = *self.run.retract.get_or_insert_with(|| {
            let profile = Profile::new(
                end.retract_distance_m,
                end.retract_speed_m_per_s,
                self.config.path.acceleration_m_per_s2,
                self.config.path.jerk_m_per_s3,
            );
            (constraint.normal, profile)
        });
        let gone_m = (now.tool.translation() - pose.translation()).dot(&normal);
        let rate = if let Some(felt) = felt {
            let watch = &mut self.run.leave;
            self.run.left = watch.retract(&leave, gone_m, &felt.force, felt.moment.norm());
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
            self.enter(Phase::Fault);
            return self.hold(now);
        }
        self.run.retract_s += rate * dt;
        let (way, speed) = profile.at(self.run.retract_s);
        if self.run.retract_s > profile.duration_s() + 0.1 {
            // An arm that did not follow has left nothing.
            self.run.off = gone_m > GONE_SHARE * end.retract_distance_m;
            if self.run.off && self.run.left == Leaving::Free {
                self.run.clearance = Clearance::Free;
            }
            let then = self.run.after_retract;
            self.run.held = None;
            self.enter(then);
        }
        moved(MotionReference::at_rest(&pose), &normal, way, rate * speed)
    }
}

/// The reference, so far and so fast along `normal`.
fn moved(
    mut reference: MotionReference,
    normal: &Vector3<f64>,
    way_m: f64,
    speed_m_per_s: f64,
) -> Wanted {
    reference.position += normal * way_m;
    reference.velocity = normal * speed_m_per_s;
    Wanted {
        reference,
        in_object: None,
        pressing: false,
        seek_m_per_s: None,
    }
}
