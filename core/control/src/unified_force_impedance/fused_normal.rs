//! The normal in use: the camera's, early and slow, carried along the surface by the curvature it saw, and touch's, late and fast, each
//! weighted by how sure it is.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_sensing::Validity;

use super::config::FusionConfig;
use super::interface::VisionInput;

/// Way over which an error of the curvature stays the same, m.
const CURVATURE_LENGTH_M: f64 = 0.01;
/// Share of a new frame's curvature that is taken over.
const CURVATURE_SHARE: f64 = 0.2;
/// No frame surprises by less than this, rad.
const GATE_LEAST_RAD: f64 = 0.1;
/// How fast a normal that nobody measures becomes doubtful, rad²/s.
const DOUBT_PER_S: f64 = 1e-4;
/// Touch's age beyond which it says nothing, s.
const TOUCH_PATIENCE_S: f64 = 0.1;

/// The normal in use and how it moves under the tool.
#[derive(Clone, Copy, Debug)]
pub(super) struct NormalInUse {
    /// Unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// rad², base axes.
    pub covariance: Matrix3<f64>,
    /// Valid while somebody measures it.
    pub validity: Validity,
    /// 1/m, base axes.
    pub curvature: Matrix3<f64>,
    /// l_s of the newest frame; 0 without one.
    pub variation: f64,
}

/// Memory of both senses.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FusedNormal {
    seen: Option<Seen>,
    fused: Option<(Vector3<f64>, f64)>,
    last_at: Option<Vector3<f64>>,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    normal: Vector3<f64>,
    variance: f64,
    curvature: Matrix3<f64>,
    variation: f64,
    frame_s: f64,
    surprises: u32,
}

impl FusedNormal {
    /// One period with the tool's origin at `at` (base axes, m) and its axis `tool_z`.
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
            self.carry(config, &moved, dt_s);
        }
        let touch = touch
            .filter(|(t, age)| config.touch && t.validity.is_valid() && *age <= TOUCH_PATIENCE_S)
            .filter(|(t, _)| is_unit(&t.normal) && t.covariance.iter().all(|x| x.is_finite()))
            .map(|(t, _)| {
                let floor = config.touch_floor_rad.powi(2);
                (t.normal, 0.5 * t.covariance.trace().max(0.0) + floor)
            });
        if let Some(frame) = vision.filter(|v| usable(v)) {
            self.look(config, frame, at, touch);
        }
        let sees = self
            .seen
            .filter(|s| time_s - s.frame_s <= config.vision_patience_s);
        let eye = sees.map(|s| (s.normal, s.variance + config.vision_floor_rad.powi(2)));
        let fused = match (eye, touch) {
            (Some(a), Some(b)) => Some(weighted(a, b)),
            (one, other) => one.or(other),
        };
        let (normal, variance) = fused.or(self.fused).unwrap_or((-tool_z, 1.0));
        self.fused = Some((normal, variance));
        NormalInUse {
            normal,
            covariance: (Matrix3::identity() - normal * normal.transpose()) * variance,
            validity: match (fused, self.seen) {
                (Some(_), _) => Validity::Valid,
                (None, Some(_)) => Validity::Stale,
                (None, None) => Validity::Missing,
            },
            curvature: sees.map_or_else(Matrix3::zeros, |s| s.curvature),
            variation: sees.map_or(0.0, |s| s.variation),
        }
    }

    /// The tool moved: the normal turns with the curvature, and is known less well.
    fn carry(&mut self, config: &FusionConfig, moved: &Vector3<f64>, dt_s: f64) {
        let grown = config.curvature_sd_per_m.powi(2) * moved.norm() * CURVATURE_LENGTH_M
            + DOUBT_PER_S * dt_s;
        let Some(seen) = &mut self.seen else {
            if let Some((_, variance)) = &mut self.fused {
                *variance += grown;
            }
            return;
        };
        seen.normal = turned(&seen.normal, &(seen.curvature * moved));
        seen.variance += grown;
        if let Some((normal, variance)) = &mut self.fused {
            *normal = turned(normal, &(seen.curvature * moved));
            *variance += grown;
        }
    }

    /// A frame that is not known yet.
    fn look(
        &mut self,
        config: &FusionConfig,
        frame: &VisionInput,
        at: &Vector3<f64>,
        touch: Option<(Vector3<f64>, f64)>,
    ) {
        let variance = 0.5 * frame.covariance.trace().max(0.0) + 1e-8;
        let fresh = Seen {
            normal: frame.normal,
            variance,
            curvature: frame.curvature.unwrap_or_else(Matrix3::zeros),
            variation: frame.surface_variation.max(0.0),
            frame_s: frame.time_s,
            surprises: 0,
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
        // What the frame says about here: it was taken where the tool is no longer.
        let since = at - frame.point;
        let since = since - frame.normal * frame.normal.dot(&since);
        let bend = fresh.curvature;
        let bend = seen.curvature + (bend - seen.curvature) * CURVATURE_SHARE;
        let here = turned(&frame.normal, &(bend * since));
        let noise = variance + (config.curvature_sd_per_m * since.norm()).powi(2);
        let surprise = here
            .cross(&seen.normal)
            .norm()
            .atan2(here.dot(&seen.normal));
        let expected = config.gate_sd * (seen.variance + noise).sqrt();
        seen.frame_s = frame.time_s;
        if surprise > expected.max(GATE_LEAST_RAD) {
            seen.surprises += 1;
            // Touch has a veto: a hand before the lens is a smooth surface too.
            let denied = touch.is_some_and(|(n, v)| {
                n.angle(&here) > (config.gate_sd * (v + noise).sqrt()).max(GATE_LEAST_RAD)
            });
            if seen.surprises < config.gate_frames || denied {
                return;
            }
            *seen = Seen {
                normal: here,
                curvature: bend,
                ..fresh
            };
            return;
        }
        let share = seen.variance / (seen.variance + noise);
        seen.normal = (seen.normal + (here - seen.normal) * share).normalize();
        seen.variance *= 1.0 - share;
        seen.curvature = bend;
        seen.variation = fresh.variation;
        seen.surprises = 0;
    }
}

/// By their inverse variances.
fn weighted(a: (Vector3<f64>, f64), b: (Vector3<f64>, f64)) -> (Vector3<f64>, f64) {
    let (wa, wb) = (1.0 / a.1, 1.0 / b.1);
    let sum = a.0 * wa + b.0 * wb;
    // Opposite normals are no surface: the surer one.
    if sum.norm() < 0.1 * (wa + wb) {
        return if wa >= wb { a } else { b };
    }
    (sum.normalize(), 1.0 / (wa + wb))
}

fn turned(normal: &Vector3<f64>, by: &Vector3<f64>) -> Vector3<f64> {
    (normal + by - normal * normal.dot(by)).normalize()
}

fn is_unit(v: &Vector3<f64>) -> bool {
    (v.norm() - 1.0).abs() < 1e-6
}

fn usable(v: &VisionInput) -> bool {
    v.validity.is_valid()
        && is_unit(&v.normal)
        && v.time_s.is_finite()
        && v.surface_variation.is_finite()
        && v.point.iter().all(|x| x.is_finite())
        && v.covariance.iter().all(|x| x.is_finite())
        && v.curvature.is_none_or(|c| c.iter().all(|x| x.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(time_s: f64, normal: Vector3<f64>, curvature: Option<Matrix3<f64>>) -> VisionInput {
        VisionInput {
            time_s,
            point: Vector3::zeros(),
            normal,
            covariance: (Matrix3::identity() - normal * normal.transpose()) * 1e-4,
            surface_variation: 0.002,
            curvature,
            validity: Validity::Valid,
        }
    }

    fn felt(normal: Vector3<f64>, sd: f64) -> NormalEstimate {
        NormalEstimate {
            point: Vector3::zeros(),
            normal,
            covariance: (Matrix3::identity() - normal * normal.transpose()) * (sd * sd),
            validity: Validity::Valid,
            friction: None,
            curvature: None,
        }
    }

    fn tilted(rad: f64) -> Vector3<f64> {
        Vector3::new(0.0, rad.sin(), rad.cos())
    }

    const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

    #[test]
    fn on_a_cylinder_the_normal_turns_with_the_tool_between_frames() {
        let config = FusionConfig::default();
        let mut fused = FusedNormal::default();
        let bend = Matrix3::from_diagonal(&Vector3::new(0.0, 5.0, 0.0));
        let mut at = Vector3::zeros();
        let first = frame(0.0, Vector3::z(), Some(bend));
        fused.step(&config, 0.0, &at, &DOWN, Some(&first), None, 1e-3);
        let mut last = Vector3::z();
        for i in 1..=30 {
            at.y = f64::from(i) * 1e-4;
            let time = f64::from(i) * 1e-3;
            last = fused
                .step(&config, time, &at, &DOWN, Some(&first), None, 1e-3)
                .normal;
        }
        // 3 mm at 5 1/m.
        assert!(last.angle(&tilted(0.015)) < 1e-4);
    }

    #[test]
    fn the_surer_sense_has_the_greater_say_and_each_goes_on_alone() {
        let config = FusionConfig::default();
        let (seen, here) = (frame(0.0, tilted(0.0), None), Vector3::zeros());
        for (sd, least, most) in [(0.5, 0.0, 0.002), (0.01, 0.003, 0.03)] {
            let mut fused = FusedNormal::default();
            let touch = felt(tilted(0.05), sd);
            let n = fused.step(
                &config,
                0.0,
                &here,
                &DOWN,
                Some(&seen),
                Some((&touch, 0.0)),
                1e-3,
            );
            let turn = n.normal.angle(&tilted(0.0));
            assert!(turn >= least && turn <= most, "{turn}");
        }
        let mut fused = FusedNormal::default();
        let touch = felt(tilted(0.05), 0.02);
        let n = fused.step(&config, 0.0, &here, &DOWN, None, Some((&touch, 0.0)), 1e-3);
        assert!(n.validity.is_valid() && n.normal.angle(&tilted(0.05)) < 1e-9);
        // Nobody: the last one, and it says so.
        let n = fused.step(&config, 1.0, &here, &DOWN, Some(&seen), None, 1e-3);
        assert_eq!(n.validity, Validity::Stale);
    }

    #[test]
    fn one_wild_frame_is_ignored_and_a_hand_before_the_lens_is_vetoed_by_touch() {
        let config = FusionConfig::default();
        let here = Vector3::zeros();
        let run = |touching: bool| {
            let mut fused = FusedNormal::default();
            let touch = felt(tilted(0.0), 0.03);
            let mut worst = 0.0_f64;
            let mut last = 0.0;
            for i in 0..40 {
                let time = f64::from(i) * 0.033;
                let wild = i == 5 || i >= 20;
                let view = frame(time, tilted(if wild { 0.6 } else { 0.0 }), None);
                let felt = touching.then_some((&touch, 0.0));
                let n = fused.step(&config, time, &here, &DOWN, Some(&view), felt, 0.033);
                last = n.normal.angle(&tilted(0.0));
                if i < 20 {
                    worst = worst.max(last);
                }
            }
            (worst, last)
        };
        let (worst, last) = run(true);
        assert!(worst < 1e-6 && last < 0.01, "{worst} {last}");
        // Without touch to deny it, a view that stays is believed in the end.
        let (worst, last) = run(false);
        assert!(worst < 1e-6 && last > 0.5, "{worst} {last}");
    }

    #[test]
    fn nonsense_is_not_seen() {
        let config = FusionConfig::default();
        let mut fused = FusedNormal::default();
        let mut bad = frame(0.0, Vector3::repeat(f64::NAN), None);
        let here = Vector3::zeros();
        let n = fused.step(&config, 0.0, &here, &DOWN, Some(&bad), None, 1e-3);
        assert_eq!(n.validity, Validity::Missing);
        bad = frame(0.0, Vector3::z(), Some(Matrix3::repeat(f64::INFINITY)));
        let n = fused.step(&config, 0.0, &here, &DOWN, Some(&bad), None, 1e-3);
        assert!(n.normal == Vector3::z() && n.validity == Validity::Missing);
    }
}
