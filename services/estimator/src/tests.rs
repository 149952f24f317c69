//! The service on an in-process bus: inputs and outputs on its topics.

use std::thread;

use nalgebra::{UnitQuaternion, Vector3};
use tangent_estimation::EstimatorConfig;
use tangent_mechanics::{Base, ModelData, Pose, Tool};
use tangent_schemas::convert::joint_array;
use tangent_schemas::standard::{Header, PoseWithCovarianceStamped};
use tangent_schemas::tangent::NormalEstimate;

use super::*;

mod depth;

const PATIENCE: Duration = Duration::from_secs(10);

fn config(names: &[&str]) -> Config {
    let choice = |name: &&str| EstimatorChoice {
        name: (*name).to_owned(),
        settings: EstimatorConfig::default(),
    };
    Config {
        estimators: names.iter().map(choice).collect(),
        objects: Vec::new(),
        depth: None,
        camera: None,
        model: ModelData::builtin("ur5").unwrap(),
        flange_from_tool: Pose::identity(),
        // Tests run on loaded machines; staleness has its own test.
        realtime_priority: None,
        wrench_source: tangent_runtime::config::WrenchSource::Measured,
        wrench_patience_s: 1.0,
        base: tangent_sensing::BaseConfig::default(),
    }
}

/// Tool pointing down onto a plane, sliding along x from cycle 100 on.
struct Cell {
    arm: tangent_runtime::Publisher<ArmState>,
    wrench: tangent_runtime::Publisher<WrenchStamped>,
    status: tangent_runtime::Publisher<WrenchStatus>,
    cycle: u64,
    x: f64,
}

impl Cell {
    fn new(bus: &Bus) -> Self {
        Self {
            arm: bus.publisher(&topics::ARM_STATE).unwrap(),
            wrench: bus.publisher(&topics::WRENCH_TOOL).unwrap(),
            status: bus.publisher(&topics::WRENCH_STATUS).unwrap(),
            cycle: 0,
            x: 0.3,
        }
    }

    fn cycle(&mut self, force_n: f64, validity: Validity) {
        self.cycle += 1;
        let stamp = self.cycle as i64 * 8_000_000;
        let speed = if self.cycle > 100 { 0.02 } else { 0.0 };
        self.x += speed * 0.008;
        let status = WrenchStatus {
            header: Header::new(stamp, "tool"),
            validity: validity as u8,
            ..Default::default()
        };
        self.status.publish(&status);
        let mut wrench = WrenchStamped {
            header: Header::new(stamp, "tool"),
            ..Default::default()
        };
        wrench.wrench.force.z = -force_n;
        // The tool's x axis is the base's; friction points back.
        wrench.wrench.force.x = if speed > 0.0 { -0.3 * force_n } else { 0.0 };
        self.wrench.publish(&wrench);
        let down = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
        let pose: Pose<Base, Tool> = Pose::new(Vector3::new(self.x, 0.0, 0.1), down);
        let mut arm = ArmState {
            header: Header::new(stamp, "base"),
            cycle: self.cycle,
            robot_time_s: self.cycle as f64 * 0.008,
            period_s: 0.008,
            q: joint_array(&tangent_mechanics::Joints::<6>::zeros()),
            qd_target: joint_array(&tangent_mechanics::Joints::<6>::zeros()),
            tool_pose: (&pose).into(),
            ..Default::default()
        };
        arm.tool_twist.linear.x = speed;
        self.arm.publish(&arm);
    }
}

struct Running {
    stop: Stop,
    thread: Option<thread::JoinHandle<Result<(), EstimatorError>>>,
}

impl Running {
    /// Returns once the service has subscribed.
    fn start(bus: &Bus, config: Config) -> Self {
        let stop = Stop::new();
        let heard = bus.subscribe(&topics::health(SERVICE), 8).unwrap();
        let (inner_bus, inner_stop) = (bus.clone(), stop.clone());
        let thread = thread::spawn(move || run(config, inner_bus, inner_stop));
        let deadline = Instant::now() + PATIENCE;
        // The first report of its loop is that no arm state arrives.
        while !heard
            .recv_timeout(PATIENCE)
            .unwrap()
            .message
            .fault
            .contains("arm/state")
        {
            assert!(Instant::now() < deadline);
        }
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.trigger();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap().unwrap();
        }
    }
}

fn next(estimates: &Subscription<NormalEstimate>) -> NormalEstimate {
    estimates
        .recv_timeout(PATIENCE)
        .expect("an estimate")
        .message
}

#[test]
fn each_estimator_answers_every_arm_state_on_its_own_topic() {
    let bus = Bus::in_process("test");
    let names = ["reactive", "quadratic", "gaussian_process", "blend"];
    let topics: Vec<_> = names
        .iter()
        .map(|n| bus.subscribe(&topics::estimate_normal(n), 8).unwrap())
        .collect();
    let _service = Running::start(&bus, config(&names));
    let mut cell = Cell::new(&bus);
    for _ in 0..400 {
        cell.cycle(3.0, Validity::Valid);
        for (name, topic) in names.iter().zip(&topics) {
            let estimate = next(topic);
            assert_eq!(estimate.cycle, cell.cycle);
            assert_eq!(estimate.estimator.as_str(), *name);
            assert_eq!(estimate.header.stamp.to_ns(), cell.cycle as i64 * 8_000_000);
            assert_eq!(estimate.validity, 0, "{}", estimate.reason);
        }
    }
    cell.cycle(3.0, Validity::Valid);
    for (name, topic) in names.iter().zip(&topics) {
        let estimate = next(topic);
        assert!(estimate.normal.z > 0.9999, "{name}: {:?}", estimate.normal);
        assert!(
            (estimate.friction - 0.3).abs() < 0.02,
            "{name}: {}",
            estimate.friction
        );
        assert!(estimate.covariance[0] > 0.0 && estimate.update_s < 1.0);
    }
}

#[test]
fn a_wrench_is_used_only_when_its_status_says_valid() {
    let bus = Bus::in_process("test");
    let estimates = bus.subscribe(&topics::estimate_normal("blend"), 8).unwrap();
    let _service = Running::start(&bus, config(&["blend"]));
    let mut cell = Cell::new(&bus);
    for (validity, expected) in [
        (Validity::Valid, Validity::Valid),
        (Validity::Saturated, Validity::Saturated),
        (Validity::SensorError, Validity::SensorError),
        (Validity::Valid, Validity::Valid),
    ] {
        cell.cycle(3.0, validity);
        let estimate = next(&estimates);
        assert_eq!(Validity::from(estimate.validity), expected);
        assert_eq!(estimate.reason.as_str(), expected.reason());
    }
}

#[test]
fn a_new_task_forgets_the_last_surface() {
    let bus = Bus::in_process("test");
    let estimates = bus
        .subscribe(&topics::estimate_normal("reactive"), 8)
        .unwrap();
    let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
    let _service = Running::start(&bus, config(&["reactive"]));
    let mut cell = Cell::new(&bus);
    for _ in 0..300 {
        cell.cycle(3.0, Validity::Valid);
        next(&estimates);
    }
    cell.cycle(3.0, Validity::Valid);
    assert!(next(&estimates).friction > 0.25);
    control.publish(&ControlState {
        activation: 1,
        ..Default::default()
    });
    cell.cycle(0.0, Validity::Valid);
    let after = next(&estimates);
    assert!(after.friction < 0.0, "{}", after.friction);
    assert_eq!(Validity::from(after.validity), Validity::NoContact);
    // Free space: the tool's own axis.
    assert!((after.normal.z - 1.0).abs() < 1e-9);
}

#[test]
fn a_missing_wrench_is_reported() {
    let bus = Bus::in_process("test");
    let estimates = bus.subscribe(&topics::estimate_normal("blend"), 8).unwrap();
    let _service = Running::start(&bus, config(&["blend"]));
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let mut state = ArmState {
        robot_time_s: 1.0,
        period_s: 0.008,
        ..Default::default()
    };
    state.tool_pose.orientation.w = 1.0;
    arm.publish(&state);
    assert_eq!(Validity::from(next(&estimates).validity), Validity::Missing);
}

/// The base's pose was received once, and then only invalid ones: the samples cannot be used.
#[test]
fn a_base_of_unknown_motion_makes_the_estimate_unusable_with_the_reason() {
    let bus = Bus::in_process("test");
    let estimates = bus
        .subscribe(&topics::estimate_normal("reactive"), 8)
        .unwrap();
    let base = bus.publisher(&topics::BASE_POSE).unwrap();
    let _service = Running::start(&bus, config(&["reactive"]));
    let mut cell = Cell::new(&bus);
    for _ in 0..200 {
        cell.cycle(3.0, Validity::Valid);
        next(&estimates);
    }
    let mut pose = PoseWithCovarianceStamped {
        header: Header::new(1_000_000_000, "world"),
        ..PoseWithCovarianceStamped::default()
    };
    // A message that cannot be decoded has no effect.
    base.publish(&pose);
    cell.cycle(3.0, Validity::Valid);
    assert_eq!(Validity::from(next(&estimates).validity), Validity::Valid);
    pose.pose.pose.orientation.w = 1.0;
    base.publish(&pose);
    cell.cycle(3.0, Validity::Valid);
    let unusable = next(&estimates);
    assert_eq!(Validity::from(unusable.validity), Validity::BaseUnknown);
    assert_eq!(unusable.reason.as_str(), Validity::BaseUnknown.reason());
}

#[test]
fn a_configuration_that_cannot_run_is_refused_with_the_reason() {
    let refuse = |names: &[&str]| {
        let bus = Bus::in_process("test");
        run(config(names), bus, Stop::new())
            .err()
            .unwrap()
            .to_string()
    };
    assert!(refuse(&[]).contains("empty"));
    assert!(refuse(&["blend", "blend"]).contains("twice"));
    assert!(refuse(&["kalman"]).contains("no estimator is called \"kalman\""));
}

/// The tool hangs 0.4 m over the target; the camera looks along the tool.
mod objects {
    use super::*;
    use nalgebra::Vector2;
    use tangent_estimation::ObjectPoseConfig;
    use tangent_estimation::object_pose::CameraModel;
    use tangent_schemas::tangent::{Feature, FeatureArray, ObjectEstimate};

    fn camera() -> CameraModel {
        CameraModel {
            flange_from_camera: Pose::identity(),
            focal_px: 400.0,
            principal_px: Vector2::new(320.0, 240.0),
            pixel_m: 2e-5,
        }
    }

    fn with_objects(camera: Option<CameraModel>) -> Config {
        Config {
            objects: vec![ObjectChoice {
                name: "object_pose".to_owned(),
                settings: ObjectPoseConfig::default(),
            }],
            camera,
            ..config(&[])
        }
    }

    #[test]
    fn a_pose_needs_a_camera_and_the_list_a_name() {
        let bus = Bus::in_process("no-camera");
        let error = Service::new(&with_objects(None), &bus).err().unwrap();
        assert!(error.to_string().contains("[camera]"), "{error}");
        let error = Service::new(&config(&[]), &bus).err().unwrap();
        assert!(error.to_string().contains("object_pose"), "{error}");
    }

    #[test]
    fn features_become_a_pose_and_its_normal() {
        let bus = Bus::in_process("objects");
        let mut service = Service::new(&with_objects(Some(camera())), &bus).unwrap();
        let found = bus.publisher(&topics::CAMERA_FEATURES).unwrap();
        let object = topics::estimate_object("object_pose");
        let poses = bus.subscribe::<ObjectEstimate>(&object, 64).unwrap();
        let normals = bus
            .subscribe(&topics::estimate_normal("object_pose"), 64)
            .unwrap();
        let mut cell = super::Cell::new(&bus);
        cell.x = 0.3;
        let square = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]];
        let (mut pose, mut normal) = (None, None);
        for cycle in 1..=60_u64 {
            cell.cycle(0.0, Validity::Valid);
            if cycle % 3 == 0 {
                let stamp = cycle as i64 * 8_000_000;
                let features = square.iter().zip(0..).map(|([x, y], id)| Feature {
                    id,
                    // The camera looks down with its y axis against that of the base.
                    u: 320.0 + 400.0 * x / 0.4,
                    v: 240.0 - 400.0 * y / 0.4,
                });
                found.publish(&FeatureArray {
                    header: Header::new(stamp, "camera"),
                    sequence: cycle,
                    features: features.collect(),
                    detect_s: 0.0,
                });
            }
            service.turn(PATIENCE);
            pose = poses.try_recv().or(pose);
            normal = normals.try_recv().or(normal);
        }
        let (pose, normal) = (pose.unwrap().message, normal.unwrap().message);
        assert_eq!(pose.validity, 0, "{}", pose.reason);
        assert_eq!(pose.cycle, 60);
        assert!((normal.normal.z - 1.0).abs() < 0.01, "{:?}", normal.normal);
        assert!(pose.covariance.0[0] > 0.0 && normal.covariance[0] > 0.0);
        assert!(pose.vision_age_s >= 0.0 && pose.vision_age_s < 0.05);
    }
}
