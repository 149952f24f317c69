use super::belief::tangents;
use super::*;

fn frame(time_s: f64, normal: Vector3<f64>, curvature: Option<Matrix3<f64>>) -> VisionInput {
    VisionInput {
        time_s,
        point: Vector3::zeros(),
        normal,
        covariance: (Matrix3::identity() - normal * normal.transpose()) * 1e-4,
        surface_variation: Some(0.002),
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
    // Camera: 0.01 and a floor of 0.006; touch: its own value and a floor of 0.03.
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
    // No source: the last normal, with an invalid status.
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
        let bar =
            |sd: [f64; 2]| Matrix3::from_diagonal(&Vector3::new(sd[0] * sd[0], sd[1] * sd[1], 0.0));
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
        // The touch estimates end here.
        let felt = (i < 35).then_some((&touch, 0.0));
        last = Some(fused.step(&config, time, &here, &DOWN, Some(&view), felt, 0.033));
    }
    let mut last = last.unwrap();
    assert_eq!(last.curvature, Matrix3::zeros());
    // Touch no longer contradicts the view, which was present all the time.
    assert!(last.validity.is_valid() && last.normal.angle(&tilted(0.6)) < 0.05);
    // Inconsistent views do not count as consecutive.
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
    // Without touch to contradict it, a persistent view is accepted in the end.
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

#[test]
fn a_lost_segment_is_not_a_flat_surface() {
    let config = FusionConfig::default();
    let mut fused = FusedNormal::default();
    let mut look = |time_s: f64, surface_variation: Option<f64>| {
        let seen = VisionInput {
            surface_variation,
            ..frame(time_s, Vector3::z(), None)
        };
        let at = Vector3::zeros();
        fused
            .step(
                &config,
                time_s,
                &at,
                &-Vector3::z(),
                Some(&seen),
                None,
                1e-3,
            )
            .variation
    };
    assert_eq!(look(0.0, None), SurfaceVariation::Unknown);
    assert_eq!(look(0.03, Some(0.02)), SurfaceVariation::Known(0.02));
    // The next frames have no segment: the previous value holds for a limited time.
    assert_eq!(look(0.06, None), SurfaceVariation::Known(0.02));
    let late = 0.03 + config.vision_patience_s + 0.01;
    assert_eq!(look(late, None), SurfaceVariation::Unknown);
    assert_eq!(look(late + 0.03, Some(0.01)), SurfaceVariation::Known(0.01));
    let dark = FusedNormal::default().step(
        &config,
        0.0,
        &Vector3::zeros(),
        &-Vector3::z(),
        None,
        None,
        1e-3,
    );
    assert_eq!(dark.variation, SurfaceVariation::NotSeen);
}
