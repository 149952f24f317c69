//! The normal in use. It combines the camera's normal (early and slow, carried along the surface by
//! the measured curvature) with touch's normal (late and fast), each weighted by its certainty in
//! each direction.

mod belief;
mod mounting;

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Base, Pose, Tool};
use tangent_sensing::Validity;

use super::config::FusionConfig;
use super::interface::{BendChange, VisionInput};
use crate::limits::plausibility::{is_covariance, is_curvature, is_point};
use belief::{Belief, VARIANCE_LEAST};
use mounting::MountingTilt;

/// Distance over which an error of the curvature stays correlated, m.
const CURVATURE_LENGTH_M: f64 = 0.01;
/// Growth of the curvature's variance with distance, 1/m² per m. The curvature of a wave of 0.38 m
/// changes by 90 1/m², that of a wave of 0.15 m by 220 1/m².
const CURVATURE_DOUBT_PER_M: f64 = 100.0;
/// Share of the change of curvature in a frame that is adopted.
const CHANGE_SHARE: f64 = 0.2;
/// Minimum deviation of a frame that counts as an outlier, rad.
const GATE_LEAST_RAD: f64 = 0.1;
/// Growth rate of a normal's variance without measurements, rad²/s.
const DOUBT_PER_S: f64 = 1e-4;
/// Tolerated rounding difference between the time of a frame and that of the loop, s.
const AHEAD_MAX_S: f64 = 0.01;
/// Age beyond which touch is not used, s.
const TOUCH_PATIENCE_S: f64 = 0.1;

/// The normal in use and how it changes under the tool.
#[derive(Clone, Copy, Debug)]
pub(super) struct NormalInUse {
    /// Unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, rad², base axes.
    pub covariance: Matrix3<f64>,
    /// Valid while camera or touch measures it.
    pub validity: Validity,
    /// Shape operator at the tool, 1/m, base axes.
    pub curvature: Matrix3<f64>,
    /// Change of the curvature ahead, if the camera saw it.
    pub change: Option<BendChange>,
    /// Surface variation l_s from the camera.
    pub variation: SurfaceVariation,
}

/// Surface variation l_s, eq. (16), at the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum SurfaceVariation {
    /// No camera: the law uses touch alone and ignores l_s.
    NotSeen,
    /// A camera is used, but segments are missing.
    Unknown,
    /// λ₃ / tr Σ of the newest segment.
    Known(f64),
}

/// State of both sources.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FusedNormal {
    seen: Option<Seen>,
    fused: Option<Belief>,
    mounting: MountingTilt,
    /// Small rotation (rad, base axes) from the camera's normal to the true one.
    correction: Vector3<f64>,
    last_at: Option<Vector3<f64>>,
}

/// What the camera measured, moved to the tool's position.
#[derive(Clone, Copy, Debug)]
struct Seen {
    belief: Belief,
    curvature: Matrix3<f64>,
    curvature_variance: f64,
    change: Option<BendChange>,
    /// l_s of the newest frame that had one, and the time of that frame, s.
    variation: Option<(f64, f64)>,
    /// Time of the newest frame, and of the newest accepted frame, s.
    frame_s: f64,
    believed_s: f64,
    /// Number of consecutive, consistent outliers, and the normal of the last one.
    surprises: u32,
    surprise: Vector3<f64>,
}

impl FusedNormal {
    /// Learns the tilt of the camera's mounting from the motion of the tool; called before
    /// [`Self::step`]. `pressing`: the tool is on the surface.
    pub fn calibrate(
        &mut self,
        config: &FusionConfig,
        time_s: f64,
        tool: &Pose<Base, Tool>,
        pressing: bool,
        dt_s: f64,
    ) {
        let fresh = self.seen.filter(|s| s.is_fresh(config, time_s));
        let seen = fresh.filter(|_| pressing).map(|s| s.belief.normal);
        self.mounting
            .step(config.mounting_sd_rad, tool, seen.as_ref(), dt_s);
        self.correction = self.mounting.correction(tool);
    }

    /// Processes one period with the tool's origin at `at` (base axes, m) and its axis `tool_z`.
    #[allow(clippy::too_many_arguments)]
    pub fn step(
        &mut self,
        config: &FusionConfig,
        time_s: f64,
        at: &Vector3<f64>,
        tool_z: &Vector3<f64>,
        vision: Option<&VisionInput>,
        touch: Option<(&NormalEstimate, f64)>,
        dt_s: f64,
    ) -> NormalInUse {
        let moved = at - self.last_at.replace(*at).unwrap_or(*at);
        if config.carry {
            self.carry(config, time_s, &moved, dt_s);
        }
        let touch = touch
            .filter(|(t, age)| config.touch && t.validity.is_valid() && *age <= TOUCH_PATIENCE_S)
            .filter(|(t, _)| is_unit(&t.normal) && is_covariance(&t.covariance))
            .map(|(t, _)| {
                Belief {
                    normal: t.normal,
                    covariance: t.covariance,
                }
                .doubted(config.touch_floor_rad.powi(2))
            });
        if let Some(frame) = vision.filter(|v| usable(v, time_s)) {
            self.look(config, frame, at, touch.as_ref());
        }
        let sees = self.seen.filter(|s| s.is_fresh(config, time_s));
        let eye = sees.map(|s| {
            let belief = s.belief.doubted(config.vision_floor_rad.powi(2));
            if self.correction == Vector3::zeros() {
                return belief;
            }
            belief.turned(&self.correction.cross(&belief.normal))
        });
        let found = match (eye, touch) {
            (Some(a), Some(b)) => Some(a.with(&b)),
            (one, other) => one.or(other),
        };
        let validity = match (found, self.fused, self.seen) {
            (Some(_), ..) => Validity::Valid,
            (None, None, None) => Validity::Missing,
            _ => Validity::Stale,
        };
        let known = found.or(self.fused);
        self.fused = known;
        let fused = known.unwrap_or_else(|| Belief::round(-tool_z, 1.0));
        NormalInUse {
            normal: fused.normal,
            covariance: fused.covariance,
            validity,
            curvature: sees.map_or_else(Matrix3::zeros, |s| s.curvature),
            change: sees.and_then(|s| s.change),
            variation: sees.map_or(SurfaceVariation::NotSeen, |s| s.variation(config, time_s)),
        }
    }

    /// Moves the state with the tool: the normal turns with the curvature, the curvature changes as
    /// measured ahead, and the uncertainty of both grows.
    fn carry(&mut self, config: &FusionConfig, time_s: f64, moved: &Vector3<f64>, dt_s: f64) {
        let way = moved.norm();
        let grown =
            config.curvature_sd_per_m.powi(2) * way * CURVATURE_LENGTH_M + DOUBT_PER_S * dt_s;
        let mut turn = Vector3::zeros();
        if let Some(seen) = self.seen.as_mut().filter(|s| s.is_fresh(config, time_s)) {
            let half = bent(&seen.curvature, seen.change.as_ref(), &(moved * 0.5));
            turn = half * moved;
            seen.belief = seen.belief.turned(&turn).doubted(grown);
            seen.curvature = bent(&seen.curvature, seen.change.as_ref(), moved);
            seen.curvature_variance += CURVATURE_DOUBT_PER_M * way;
        }
        if let Some(fused) = &mut self.fused {
            *fused = fused.turned(&turn).doubted(grown);
        }
    }

    /// Processes a frame that is new.
    fn look(
        &mut self,
        config: &FusionConfig,
        frame: &VisionInput,
        at: &Vector3<f64>,
        touch: Option<&Belief>,
    ) {
        let told = Belief {
            normal: frame.normal,
            covariance: frame.covariance,
        }
        .doubted(VARIANCE_LEAST);
        let curvature_variance = config.curvature_sd_per_m.powi(2);
        let fresh = Seen {
            belief: told,
            curvature: frame.curvature.unwrap_or_else(Matrix3::zeros),
            curvature_variance,
            change: frame.change,
            variation: frame
                .surface_variation
                .map(|variation| (variation.max(0.0), frame.time_s)),
            frame_s: frame.time_s,
            believed_s: frame.time_s,
            surprises: 0,
            surprise: frame.normal,
        };
        let Some(seen) = &mut self.seen else {
            self.seen = Some(fresh);
            return;
        };
        if frame.time_s <= seen.frame_s {
            return;
        }
        if !config.carry {
            *seen = fresh;
            return;
        }
        seen.frame_s = frame.time_s;
        // Moves the frame's normal to here: the tool has moved since the frame was taken.
        let since = at - frame.point;
        let since = since - frame.normal * frame.normal.dot(&since);
        let change = match (frame.change, seen.change) {
            (Some(new), Some(old)) => Some(old.towards(&new, CHANGE_SHARE)),
            (new, _) => new,
        };
        let said = bent(&fresh.curvature, change.as_ref(), &since);
        let trust = seen.curvature_variance / (seen.curvature_variance + curvature_variance);
        let bend = seen.curvature + (said - seen.curvature) * trust;
        let halfway = bent(&bend, change.as_ref(), &(since * -0.5));
        let here = told
            .turned(&(halfway * since))
            .doubted((config.curvature_sd_per_m * since.norm()).powi(2));
        let expected = config.gate_sd * (seen.belief.variance() + here.variance()).sqrt();
        if angle(&here.normal, &seen.belief.normal) > expected.max(GATE_LEAST_RAD) {
            let alike = seen.surprises > 0
                && angle(&here.normal, &seen.surprise) <= expected.max(GATE_LEAST_RAD);
            seen.surprises = if alike { seen.surprises + 1 } else { 1 };
            seen.surprise = here.normal;
            // Touch can veto a frame: a hand in front of the lens is a smooth surface too.
            let denied = touch.is_some_and(|t| {
                let most = config.gate_sd * (t.variance() + here.variance()).sqrt();
                t.normal.angle(&here.normal) > most.max(GATE_LEAST_RAD)
            });
            if seen.surprises >= config.gate_frames && !denied {
                *seen = Seen {
                    belief: here,
                    curvature: said,
                    variation: fresh.variation.or(seen.variation),
                    ..fresh
                };
            }
            return;
        }
        seen.belief = seen.belief.with(&here);
        seen.curvature = bend;
        seen.curvature_variance *= 1.0 - trust;
        seen.change = change;
        seen.variation = fresh.variation.or(seen.variation);
        seen.believed_s = frame.time_s;
        seen.surprises = 0;
    }
}

impl Seen {
    /// Whether an accepted frame is recent enough to be used.
    fn is_fresh(&self, config: &FusionConfig, time_s: f64) -> bool {
        time_s - self.believed_s <= config.vision_patience_s
    }

    /// A frame without a segment leaves the previous value valid for a moment; then it is unknown.
    fn variation(&self, config: &FusionConfig, time_s: f64) -> SurfaceVariation {
        match self.variation {
            Some((variation, at_s)) if time_s - at_s <= config.vision_patience_s => {
                SurfaceVariation::Known(variation)
            }
            _ => SurfaceVariation::Unknown,
        }
    }
}

/// The shape operator after a displacement.
fn bent(
    curvature: &Matrix3<f64>,
    change: Option<&BendChange>,
    moved: &Vector3<f64>,
) -> Matrix3<f64> {
    change.map_or(*curvature, |c| c.after(curvature, moved))
}

fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

fn is_unit(v: &Vector3<f64>) -> bool {
    (v.norm() - 1.0).abs() < 1e-6
}

/// Whether a frame can be used. A frame with a future time would stay fresh indefinitely; finite
/// but implausible values would overflow in later steps.
fn usable(v: &VisionInput, time_s: f64) -> bool {
    v.validity.is_valid()
        && is_unit(&v.normal)
        && v.time_s <= time_s + AHEAD_MAX_S
        && v.time_s.is_finite()
        && v.surface_variation
            .is_none_or(|l| (-1e-9..=1.0).contains(&l))
        && is_point(&v.point)
        && is_covariance(&v.covariance)
        && v.curvature.is_none_or(|c| is_curvature(&c))
        && v.change.is_none_or(|c| c.is_sound())
}

#[cfg(test)]
mod tests;
