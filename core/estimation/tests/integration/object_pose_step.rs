//! The object-pose estimators do not allocate in a step, for any input.

// A whole file of tests: what fails here is the test.
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use tangent_estimation::object_pose::{
    CameraFrame, CameraModel, Corner, OBJECT_ESTIMATORS, ObjectPoseConfig, ObjectPoseEstimator,
    ObjectSample, build_object_estimator,
};
use tangent_mechanics::{Object, Pose, Wrench};
use tangent_sensing::Validity;

fn camera() -> CameraModel {
    CameraModel {
        flange_from_camera: Pose::new(Vector3::new(0.07, 0.0, -0.05), UnitQuaternion::identity()),
        focal_px: 400.0,
        principal_px: Vector2::new(320.0, 240.0),
        pixel_m: 2e-5,
    }
}

/// A flange that looks down on a target at the base's origin and approaches it; from the third
/// second on, the tip touches.
fn sample(step: u32, with_frame: bool) -> ObjectSample {
    let time_s = f64::from(step) * 1e-3;
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let height = (0.4 - 0.05 * time_s).max(0.25);
    let base_from_flange = Pose::new(Vector3::new(-0.1, 0.01, height), down);
    let tool = Pose::new(Vector3::new(0.0, 0.0, 0.25), UnitQuaternion::identity());
    let base_from_object: Pose<_, Object> = Pose::identity();
    let camera_from_object =
        (base_from_flange * camera().flange_from_camera).inverse() * base_from_object;
    let frame = with_frame.then(|| CameraFrame {
        time_s,
        sequence: u64::from(step),
        corners: ObjectPoseConfig::default().target.corners().map(|corner| {
            camera()
                .project(&camera_from_object.transform_point(&corner))
                .map(|pixel_px| Corner { pixel_px })
        }),
    });
    ObjectSample {
        time_s,
        base_from_flange,
        base_from_tool: base_from_flange * tool,
        wrench: if height > 0.25 {
            Wrench::zero()
        } else {
            Wrench::new(Vector3::new(0.0, 0.0, -20.0), Vector3::zeros())
        },
        wrench_delay_s: 0.002,
        wrench_validity: Validity::Valid,
        wrench_bias_age_s: Some(1.0),
        frame,
    }
}

fn estimators() -> impl Iterator<Item = Box<dyn ObjectPoseEstimator>> {
    OBJECT_ESTIMATORS
        .iter()
        .map(|name| build_object_estimator(name, &ObjectPoseConfig::default(), &camera()).unwrap())
}

#[test]
fn a_step_allocates_nothing() {
    for mut estimator in estimators() {
        let mut touched = false;
        for step in 0..4000 {
            let sample = sample(step, step % 20 == 0);
            let mut estimate = None;
            let count = allocation_counter::measure(|| {
                estimate = Some(estimator.update(&sample));
            });
            assert_eq!(count.count_total, 0, "{} step {step}", estimator.name());
            touched |= estimate.unwrap().in_contact;
        }
        assert!(touched);
    }
}

#[test]
fn an_exact_world_is_found_exactly() {
    for mut estimator in estimators() {
        let last = (0..4000)
            .map(|step| estimator.update(&sample(step, step % 20 == 0)))
            .last()
            .unwrap();
        assert!(last.validity.is_valid(), "{}", estimator.name());
        let pose = last.base_from_object;
        assert!(
            pose.translation().norm() < 2e-4,
            "{}: {pose:?}",
            estimator.name()
        );
        assert!(
            pose.rotation().angle() < 1e-3,
            "{}: {pose:?}",
            estimator.name()
        );
    }
}

#[test]
fn nonsense_is_answered_with_a_reason_and_does_no_harm() {
    for mut estimator in estimators() {
        for step in 0..1000 {
            estimator.update(&sample(step, step % 20 == 0));
        }
        let mut bad = sample(1000, true);
        bad.base_from_flange = Pose::new(Vector3::repeat(f64::NAN), UnitQuaternion::identity());
        assert_eq!(estimator.update(&bad).validity, Validity::NotFinite);
        let mut bad = sample(1001, true);
        bad.wrench = Wrench::new(Vector3::repeat(f64::INFINITY), Vector3::zeros());
        assert!(!estimator.update(&bad).in_contact);
        let mut bad = sample(1020, true);
        if let Some(frame) = &mut bad.frame {
            frame.corners = [Some(Corner {
                pixel_px: Vector2::new(f64::NAN, f64::INFINITY),
            }); 4];
        }
        estimator.update(&bad);
        let after = estimator.update(&sample(1040, true));
        assert!(after.validity.is_valid(), "{}", estimator.name());
        assert!(after.base_from_object.translation().norm() < 1e-3);
        // A camera that stops is noticed.
        let late = (1041..1300)
            .map(|step| estimator.update(&sample(step, false)))
            .last();
        assert_eq!(late.unwrap().validity, Validity::Stale);
        estimator.reset();
        let fresh = estimator.update(&sample(1300, false));
        assert_eq!(fresh.validity, Validity::Missing);
    }
}
