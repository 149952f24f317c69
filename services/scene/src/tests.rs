use std::collections::BTreeMap;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use tangent_mechanics::{Arm, Joints, ModelData};
use tangent_runtime::CellConfig;
use tangent_schemas::standard::{Header, Transform, TransformStamped};

use super::*;

const STAMP: i64 = 1_795_260_245_000_000_000;

struct Stage {
    bus: Bus,
    scene: Scene,
    config: SceneConfig,
    model: ModelData,
    cell: CellConfig,
}

fn stage(change: impl FnOnce(&mut CellConfig)) -> Stage {
    let mut cell = CellConfig::default_cell();
    change(&mut cell);
    let model = ModelData::builtin(&cell.robot.model).unwrap();
    let config = SceneConfig::from_cell(&cell, &model).unwrap();
    let bus = Bus::in_process("test");
    let scene = Scene::new(&bus, &config).unwrap();
    Stage {
        bus,
        scene,
        config,
        model,
        cell,
    }
}

/// A state of the cell's UR5 with the pose of its tool.
fn arm_state(stage: &Stage, q: [f64; 6]) -> ArmState {
    let arm = Arm::<6>::new(&stage.model).unwrap();
    let flange = arm.base_from_flange(&Joints::from(q));
    let tool: Pose<Base, Tool> = flange * stage.cell.tool.flange_from_tool();
    ArmState {
        header: Header::new(STAMP, "base"),
        q: q.into_iter().collect(),
        qd: [0.1; 6].into_iter().collect(),
        tool_pose: (&tool).into(),
        ..ArmState::default()
    }
}

fn pose(transform: &Transform) -> Isometry3<f64> {
    let r = &transform.rotation;
    Isometry3::from_parts(
        Vector3::from([
            transform.translation.x,
            transform.translation.y,
            transform.translation.z,
        ])
        .into(),
        UnitQuaternion::new_normalize(nalgebra::Quaternion::new(r.w, r.x, r.y, r.z)),
    )
}

/// The tree by child. A child with two parents fails.
fn tree(messages: &[&TFMessage]) -> BTreeMap<String, TransformStamped> {
    let mut tree: BTreeMap<String, TransformStamped> = BTreeMap::new();
    for one in messages.iter().flat_map(|m| &m.transforms) {
        let child = one.child_frame_id.to_string();
        if let Some(other) = tree.insert(child.clone(), one.clone()) {
            assert_eq!(other.header.frame_id, one.header.frame_id, "{child}");
        }
    }
    tree
}

/// Pose of a frame in the root, and the root's name.
fn root_from(tree: &BTreeMap<String, TransformStamped>, frame: &str) -> (String, Isometry3<f64>) {
    let (mut at, mut pose_so_far, mut steps) = (frame.to_owned(), Isometry3::identity(), 0);
    while let Some(one) = tree.get(&at) {
        pose_so_far = pose(&one.transform) * pose_so_far;
        at = one.header.frame_id.to_string();
        steps += 1;
        assert!(steps <= tree.len(), "a cycle above {frame}");
    }
    (at, pose_so_far)
}

#[test]
fn the_frames_are_one_tree_that_ends_at_the_recorded_tool() {
    let mut stage = stage(|cell| {
        let camera = "flange_from_camera = { translation_m = [0.07, 0.0, -0.05] }";
        let camera = format!(
            "{camera}\nsize_px = [640, 480]\nfocal_px = 400.0\nprincipal_px = [320.0, 240.0]"
        );
        let changed = cell.changed("a cell with a camera", |table| {
            let camera: toml::Table = camera.parse().unwrap();
            table.insert("camera".to_owned(), camera.into());
        });
        *cell = changed.unwrap();
    });
    let tf = stage.bus.subscribe(&topics::TF, 10).unwrap();
    let fixed = stage.bus.subscribe(&topics::TF_STATIC, 10).unwrap();
    let joints = stage.bus.subscribe(&topics::JOINT_STATES, 10).unwrap();
    let described = stage.bus.subscribe(&topics::ROBOT_DESCRIPTION, 10).unwrap();
    let control = stage.bus.publisher(&topics::CONTROL_STATE).unwrap();
    control.publish(&ControlState {
        normal: (&Vector3::new(0.1, 0.2, 0.97).normalize()).into(),
        ..ControlState::default()
    });
    let arm = stage.bus.publisher(&topics::ARM_STATE).unwrap();
    let state = arm_state(&stage, [0.3, -1.2, 1.4, -0.7, 0.9, 2.1]);
    arm.publish(&state);
    stage.scene.draw(Instant::now());

    let (tf, fixed) = (tf.try_recv().unwrap(), fixed.try_recv().unwrap());
    let tree = tree(&[&tf.message, &fixed.message]);
    let mut frames: Vec<String> = stage
        .config
        .chain
        .links()
        .iter()
        .map(|l| l.name.clone())
        .collect();
    frames.extend(["base", "flange", "sensor", "tool", "camera", "contact"].map(str::to_owned));
    assert_eq!(tree.len(), frames.len(), "{:?}", tree.keys());
    for frame in &frames {
        assert_eq!(root_from(&tree, frame).0, "world", "{frame}");
    }
    let expected = Pose::<Base, Tool>::try_from(&state.tool_pose).unwrap();
    let found = root_from(&tree, "tool").1;
    assert!((found.translation.vector - expected.translation()).norm() < 1e-9);
    assert!(found.rotation.angle_to(&expected.rotation()) < 1e-9);
    let contact = root_from(&tree, "contact").1;
    let normal = contact.rotation * Vector3::z();
    assert!((normal - Vector3::new(0.1, 0.2, 0.97).normalize()).norm() < 1e-9);

    // The links of the description are the frames of the arm.
    let urdf = described.try_recv().unwrap().message.data.clone();
    for frame in frames.iter().filter(|frame| *frame != "contact") {
        assert!(
            urdf.contains(&format!("<link name=\"{frame}\">")),
            "{frame}"
        );
    }
    let joints = joints.try_recv().unwrap().message.clone();
    assert_eq!(joints.name, stage.model.joint_names);
    assert_eq!(joints.position, state.q.to_vec());
    assert_eq!(joints.velocity, [0.1; 6]);
}

#[test]
fn a_platform_says_where_the_base_is() {
    for required in [false, true] {
        let mut stage = stage(|cell| cell.base.required = required);
        let tf = stage.bus.subscribe(&topics::TF, 10).unwrap();
        let arm = stage.bus.publisher(&topics::ARM_STATE).unwrap();
        let base = stage.bus.publisher(&topics::BASE_POSE).unwrap();
        let mut bases = |said: Option<f64>| {
            if let Some(x) = said {
                let mut message = PoseWithCovarianceStamped {
                    header: Header::new(STAMP + 7, "world"),
                    ..PoseWithCovarianceStamped::default()
                };
                message.pose.pose.position.x = x;
                message.pose.pose.orientation.w = 1.0;
                base.publish(&message);
            }
            arm.publish(&arm_state(&stage, [0.1; 6]));
            stage.scene.draw(Instant::now());
            let message = tf.try_recv().unwrap().message.clone();
            let of_base = |t: &&TransformStamped| &*t.child_frame_id == "base";
            let found: Vec<_> = message.transforms.iter().filter(of_base).cloned().collect();
            found
                .iter()
                .map(|t| (t.header.stamp.to_ns() - STAMP, t.transform.translation.x))
                .collect::<Vec<_>>()
        };
        // A base that need not move is where the world is, until a platform says otherwise.
        let still: &[(i64, f64)] = if required { &[] } else { &[(0, 0.0)] };
        assert_eq!(bases(None), still);
        assert_eq!(bases(Some(1.5)), [(7, 1.5)]);
        assert_eq!(bases(None), []);
        assert_eq!(bases(Some(1.6)), [(7, 1.6)]);
    }
}

#[test]
fn what_holds_is_published_again_for_those_who_come_late() {
    let mut stage = stage(|_| {});
    let described = stage
        .bus
        .subscribe(&topics::ROBOT_DESCRIPTION, 100)
        .unwrap();
    let arm = stage.bus.publisher(&topics::ARM_STATE).unwrap();
    let begun = Instant::now();
    for tick in 0..100 {
        arm.publish(&arm_state(&stage, [0.1; 6]));
        stage.scene.draw(begun + Duration::from_millis(50) * tick);
    }
    let count = std::iter::from_fn(|| described.try_recv()).count();
    assert_eq!(count, 3, "in 5 s");
}

/// The path of the task is read from the controller, as it is drawn in the task file.
#[test]
fn the_planned_path_lies_in_its_plane_where_the_tool_begins_to_slide() {
    let mut stage = stage(|_| {});
    let task = "name = \"wipe\"\n[force]\nreference_n = 5.0\n[approach]\ndirection = \"tool_z\"\n\
                [path]\nkind = \"line\"\nto_m = [0.03, 0.04]\nspeed_m_per_s = 0.02\nstrokes = 1\n";
    let _task = stage
        .bus
        .answer(queries::CONTROL_SHOW, move |_, _| {
            tangent_runtime::bus::answer::done_with("wipe", &serde_json::json!({"task_toml": task}))
        })
        .unwrap();
    let markers = stage.bus.subscribe(&topics::MARKERS, 100).unwrap();
    let control = stage.bus.publisher(&topics::CONTROL_STATE).unwrap();
    let arm = stage.bus.publisher(&topics::ARM_STATE).unwrap();
    let state = arm_state(&stage, [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]);
    let start = Vector3::new(0.4, 0.1, 0.2);
    for phase in [1, 3] {
        control.publish(&ControlState {
            activation: 1,
            phase,
            path_reference: (&start).into(),
            ..ControlState::default()
        });
        arm.publish(&state);
        stage.scene.draw(Instant::now());
    }
    let drawn = std::iter::from_fn(|| markers.try_recv());
    let lines: Vec<_> = drawn
        .flat_map(|m| m.message.markers.clone())
        .filter(|m| &*m.ns == "path/planned")
        .collect();
    assert_eq!(lines.len(), 1);
    let tool = Pose::<Base, Tool>::try_from(&state.tool_pose).unwrap();
    let points: Vec<Vector3<f64>> = lines[0].points.iter().map(Vector3::from).collect();
    assert!((points[0] - start).norm() < 1e-9);
    let end = points.last().unwrap() - start;
    assert!((end.norm() - 0.05).abs() < 1e-6, "{end}");
    assert!(end.dot(&tool.z_axis()).abs() < 1e-6);
}
