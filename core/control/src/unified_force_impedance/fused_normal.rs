//! The normal in use: the camera's, early and slow, carried along the surface by the curvature it saw, and touch's, late and fast, each
//! weighted by how sure it is in each direction.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_sensing::Validity;

use super::config::FusionConfig;
use super::interface::{BendChange, VisionInput};

/// Way over which an error of the curvature stays the same, m.
const CURVATURE_LENGTH_M: f64 = 0.01;
/// How fast a curvature seen becomes doubtful as the tool moves on: variance per way, 1/m² per m. A wave of 0.38 m changes by 90 1/m²,
/// one of 0.15 m by 220 1/m².
const CURVATURE_DOUBT_PER_M: f64 = 100.0;
/// Share of a frame's change of the bend that is taken over.
const CHANGE_SHARE: f64 = 0.2;
/// No frame surprises by less than this, rad.
const GATE_LEAST_RAD: f64 = 0.1;
/// How fast a normal that nobody measures becomes doubtful, rad²/s.
const DOUBT_PER_S: f64 = 1e-4;
/// No normal is surer than this, rad².
const VARIANCE_LEAST: f64 = 1e-8;
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
    /// Shape operator where the tool is, 1/m, base axes.
    pub curvature: Matrix3<f64>,
    /// How that goes on changing, where the camera saw what comes.
    pub change: Option<BendChange>,
    /// l_s of the newest frame; 0 without one.
    pub variation: f64,
}

/// A normal and how well it is known.
#[derive(Clone, Copy, Debug)]
struct Belief {
    normal: Vector3<f64>,
    /// rad², base axes; nothing along the normal.
    covariance: Matrix3<f64>,
}

/// Memory of both senses.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FusedNormal {
    seen: Option<Seen>,
    fused: Option<Belief>,
    last_at: Option<Vector3<f64>>,
}

/// What the camera showed, carried to where the tool is.
#[derive(Clone, Copy, Debug)]
struct Seen {
    belief: Belief,
    curvature: Matrix3<f64>,
    curvature_variance: f64,
    change: Option<BendChange>,
    variation: f64,
    /// Of the newest frame, and of the newest that was believed.
    frame_s: f64,
    believed_s: f64,
    /// Frames in a row that surprised alike, and what the last of them said.
    surprises: u32,
    surprise: Vector3<f64>,
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
            self.carry(config, time_s, &moved, dt_s);
        }
        let touch = touch
            .filter(|(t, age)| config.touch && t.validity.is_valid() && *age <= TOUCH_PATIENCE_S)
            .filter(|(t, _)| is_unit(&t.normal) && t.covariance.iter().all(|x| x.is_finite()))
            .map(|(t, _)| {
                Belief {
                    normal: t.normal,
                    covariance: t.covariance,
                }
                .doubted(config.touch_floor_rad.powi(2))
            });
        if let Some(frame) = vision.filter(|v| usable(v)) {
            self.look(config, frame, at, touch.as_ref());
        }
        let sees = self.seen.filter(|s| s.is_fresh(config, time_s));
        let eye = sees.map(|s| s.belief.doubted(config.vision_floor_rad.powi(2)));
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
            variation: sees.map_or(0.0, |s| s.variation),
        }
    }

    /// The tool moved: the normal turns with the curvature, the curvature changes as it was seen to, and both are known less well.
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

    /// A frame that is not known yet.
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
            variation: frame.surface_variation.max(0.0),
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
        // What the frame says about here: it was taken where the tool is no longer.
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
            // Touch has a veto: a hand before the lens is a smooth surface too.
            let denied = touch.is_some_and(|t| {
                let most = config.gate_sd * (t.variance() + here.variance()).sqrt();
                t.normal.angle(&here.normal) > most.max(GATE_LEAST_RAD)
            });
            if seen.surprises >= config.gate_frames && !denied {
                *seen = Seen {
                    belief: here,
                    curvature: said,
                    ..fresh
                };
            }
            return;
        }
        seen.belief = seen.belief.with(&here);
        seen.curvature = bend;
        seen.curvature_variance *= 1.0 - trust;
        seen.change = change;
        seen.variation = fresh.variation;
        seen.believed_s = frame.time_s;
        seen.surprises = 0;
    }
}

impl Seen {
    /// Something that was believed is new enough to be in use.
    fn is_fresh(&self, config: &FusionConfig, time_s: f64) -> bool {
        time_s - self.believed_s <= config.vision_patience_s
    }
}

impl Belief {
    /// As sure in every direction.
    fn round(normal: Vector3<f64>, variance: f64) -> Self {
        Self {
            normal,
            covariance: across(&normal) * variance,
        }
    }

    /// Of one direction, on average, rad².
    fn variance(&self) -> f64 {
        0.5 * self.covariance.trace().max(0.0)
    }

    /// Less sure by `variance` (rad²) in every direction.
    fn doubted(&self, variance: f64) -> Self {
        Self {
            normal: self.normal,
            covariance: self.covariance + across(&self.normal) * variance,
        }
    }

    /// The normal turned; what was known of it goes along.
    fn turned(&self, by: &Vector3<f64>) -> Self {
        let n = &self.normal;
        let normal = (n + by - n * n.dot(by)).normalize();
        let plane = across(&normal);
        Self {
            normal,
            covariance: plane * self.covariance * plane,
        }
    }

    /// Both together, by their covariances in the plane between them.
    fn with(&self, other: &Self) -> Self {
        let surer = if self.variance() <= other.variance() {
            self
        } else {
            other
        };
        let sum = self.normal + other.normal;
        // Opposite normals are no surface.
        if sum.norm() < 0.2 {
            return *surer;
        }
        let plane = tangents(&sum.normalize());
        let (a, b) = (
            planar(&self.covariance, &plane),
            planar(&other.covariance, &plane),
        );
        let Some(inverse) = (a + b).try_inverse() else {
            return *surer;
        };
        let gain = a * inverse;
        let away = plane.tr_mul(&(other.normal - self.normal));
        let normal = (self.normal + plane * (gain * away)).normalize();
        let left = (Matrix2::identity() - gain) * a;
        let left = plane * ((left + left.transpose()) * 0.5) * plane.transpose();
        let flat = across(&normal);
        Self {
            normal,
            covariance: flat * left * flat,
        }
    }
}

/// The plane that a vector is normal to.
fn across(normal: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - normal * normal.transpose()
}

/// Two directions in that plane.
fn tangents(normal: &Vector3<f64>) -> Matrix3x2<f64> {
    let least = normal.iamin();
    let u = normal.cross(&Vector3::ith(least, 1.0)).normalize();
    Matrix3x2::from_columns(&[u, normal.cross(&u)])
}

/// A covariance in a plane. One that is none there is taken for one that is the same in every direction.
fn planar(covariance: &Matrix3<f64>, plane: &Matrix3x2<f64>) -> Matrix2<f64> {
    let m = plane.transpose() * covariance * plane;
    let m = (m + m.transpose()) * 0.5 + Matrix2::identity() * VARIANCE_LEAST;
    if m.m11 > 0.0 && m.determinant() > 0.0 {
        m
    } else {
        Matrix2::identity() * (0.5 * covariance.trace()).max(VARIANCE_LEAST)
    }
}

/// The shape operator further on.
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

fn usable(v: &VisionInput) -> bool {
    v.validity.is_valid()
        && is_unit(&v.normal)
        && v.time_s.is_finite()
        && v.surface_variation.is_finite()
        && v.point.iter().all(|x| x.is_finite())
        && v.covariance.iter().all(|x| x.is_finite())
        && v.curvature.is_none_or(|c| c.iter().all(|x| x.is_finite()))
        && v.change.is_none_or(|c| c.is_sound())
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
            change: None,
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
        // Camera: 0.01 and a floor of 0.006; touch: its own and a floor of 0.03.
        for (sd, least, most) in [(0.5, 0.0, 1e-4), (0.01, 0.0055, 0.0065)] {
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
    fn each_direction_goes_by_who_knows_it() {
        let config = FusionConfig {
            vision_floor_rad: 0.0,
            touch_floor_rad: 1e-4,
            ..FusionConfig::default()
        };
        let bar = |x: f64, y: f64| Matrix3::from_diagonal(&Vector3::new(x * x, y * y, 0.0));
        let mut fused = FusedNormal::default();
        let seen = VisionInput {
            covariance: bar(0.01, 0.2),
            ..frame(0.0, Vector3::z(), None)
        };
        let touch = NormalEstimate {
            covariance: bar(0.2, 0.01),
            ..felt(Vector3::new(0.05, 0.05, 1.0).normalize(), 0.0)
        };
        let here = Vector3::zeros();
        let n = fused.step(
            &config,
            0.0,
            &here,
            &DOWN,
            Some(&seen),
            Some((&touch, 0.0)),
            1e-3,
        );
        // Inverse variances: 1 to 400.
        assert!(n.normal.x.abs() < 0.001, "{}", n.normal);
        assert!((n.normal.y - 0.05).abs() < 0.001, "{}", n.normal);
        let sd = 0.01 * (400.0f64 / 401.0).sqrt();
        assert!((n.covariance.m11.sqrt() - sd).abs() < 1e-4);
        assert!((n.covariance.m22.sqrt() - sd).abs() < 1e-4);
        assert!((n.covariance * n.normal).norm() < 1e-9);
    }

    #[test]
    fn what_is_fused_says_how_wrong_it_is() {
        use rand::{RngExt, SeedableRng};
        let config = FusionConfig {
            carry: false,
            vision_floor_rad: 0.0,
            touch_floor_rad: 1e-4,
            ..FusionConfig::default()
        };
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        let mut gauss = || (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0;
        let (eye, hand) = ([0.02, 0.06], [0.05, 0.015]);
        let mut sum = 0.0;
        let trials = 4000;
        for _ in 0..trials {
            let mut one =
                |sd: [f64; 2]| Vector3::new(sd[0] * gauss(), sd[1] * gauss(), 1.0).normalize();
            let bar = |sd: [f64; 2]| {
                Matrix3::from_diagonal(&Vector3::new(sd[0] * sd[0], sd[1] * sd[1], 0.0))
            };
            let seen = VisionInput {
                covariance: bar(eye),
                ..frame(0.0, one(eye), None)
            };
            let touch = NormalEstimate {
                covariance: bar(hand),
                ..felt(one(hand), 0.0)
            };
            let n = FusedNormal::default().step(
                &config,
                0.0,
                &Vector3::zeros(),
                &DOWN,
                Some(&seen),
                Some((&touch, 0.0)),
                1e-3,
            );
            let plane = tangents(&n.normal);
            let c = plane.transpose() * n.covariance * plane;
            let e = plane.tr_mul(&(Vector3::z() - n.normal));
            sum += e.dot(&(c.try_inverse().unwrap() * e));
        }
        let nees = sum / f64::from(trials);
        // Two degrees of freedom.
        assert!((nees - 2.0).abs() < 0.15, "{nees}");
    }

    #[test]
    fn a_view_that_is_denied_grows_old() {
        let config = FusionConfig::default();
        let mut fused = FusedNormal::default();
        let here = Vector3::zeros();
        let touch = felt(tilted(0.0), 0.03);
        let mut last = None;
        for i in 0..40 {
            let time = f64::from(i) * 0.033;
            let view = frame(time, tilted(if i < 10 { 0.0 } else { 0.6 }), None);
            // Touch falls silent in the end.
            let felt = (i < 35).then_some((&touch, 0.0));
            last = Some(fused.step(&config, time, &here, &DOWN, Some(&view), felt, 0.033));
        }
        let mut last = last.unwrap();
        assert_eq!(last.curvature, Matrix3::zeros());
        // Nobody denies it any more, and it was there all the time.
        assert!(last.validity.is_valid() && last.normal.angle(&tilted(0.6)) < 0.05);
        // Views that contradict each other are none.
        let mut fused = FusedNormal::default();
        for i in 0..40 {
            let time = f64::from(i) * 0.033;
            let tilt = match i {
                0..10 => 0.0,
                _ if i % 2 == 0 => 0.6,
                _ => -0.6,
            };
            let view = frame(time, tilted(tilt), None);
            last = fused.step(&config, time, &here, &DOWN, Some(&view), None, 0.033);
        }
        assert_eq!(last.validity, Validity::Stale);
        assert!(last.normal.angle(&tilted(0.0)) < 0.01);
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
