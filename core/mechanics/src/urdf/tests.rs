//! Reads the URDFs with an independent parser and compares their kinematics with [`Arm`] and with
//! the golden values.

use nalgebra::{Isometry3, SVector, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;
use urdf_rs::{Geometry, JointType, Robot};

use super::*;
use crate::{Arm, Joints};

const GOLDEN: [&str; 2] = [
    include_str!("../../tests/golden/golden.json"),
    include_str!("../../tests/golden/golden_ur.json"),
];

/// Pose of a link in the root, at the angles of all joints by name.
fn root_from(robot: &Robot, link: &str, angle: &dyn Fn(&str) -> f64) -> Isometry3<f64> {
    let Some(joint) = robot.joints.iter().find(|j| j.child.link == link) else {
        return Isometry3::identity();
    };
    let [roll, pitch, yaw] = joint.origin.rpy.0;
    let origin = Isometry3::from_parts(
        Translation3::from(Vector3::from(joint.origin.xyz.0)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    );
    let turn = match joint.joint_type {
        JointType::Revolute => Vector3::from(joint.axis.xyz.0) * angle(&joint.name),
        _ => Vector3::zeros(),
    };
    root_from(robot, &joint.parent.link, angle) * origin * UnitQuaternion::from_scaled_axis(turn)
}

/// Pose of a link at the angles `q` of the model's joints.
fn at(robot: &Robot, model: &ModelData, link: &str, q: &[f64]) -> Isometry3<f64> {
    let angle = |name: &str| {
        let i = model.joint_names.iter().position(|n| n == name).unwrap();
        q[i]
    };
    root_from(robot, link, &angle)
}

fn far(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let apart = (a.translation.vector - b.translation.vector).norm();
    apart.max(a.rotation.angle_to(&b.rotation))
}

fn mounted() -> Mounted {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.3));
    Mounted {
        flange_from_sensor: Some(Pose::new(Vector3::new(0.0, 0.0, 0.045), turn)),
        flange_from_tool: Some(Pose::new(Vector3::new(0.01, -0.02, 0.165), turn)),
        flange_from_camera: Some(Pose::new(Vector3::new(0.07, 0.0, -0.05), turn)),
        tip: Tip::Soft { radius_m: 0.012 },
    }
}

/// Deterministic angles over the joints' ranges (a Weyl sequence).
fn angles(model: &ModelData, draw: usize) -> Vec<f64> {
    (0..model.dof)
        .map(|i| {
            let share = ((draw * model.dof + i + 1) as f64 * 0.618_033_988_749_895).fract();
            let (low, high) = (
                model.limits.position_lower_rad[i],
                model.limits.position_upper_rad[i],
            );
            low + share * (high - low)
        })
        .collect()
}

fn same_as_arm<const N: usize>(model: &ModelData) {
    let arm = Arm::<N>::new(model).unwrap();
    let mounted = mounted();
    let robot = urdf_rs::read_from_string(&urdf(model, &mounted).unwrap()).unwrap();
    for draw in 0..200 {
        let q = angles(model, draw);
        let joints: Joints<N> = SVector::from_column_slice(&q);
        let flange = arm.base_from_flange(&joints);
        let found = at(&robot, model, "flange", &q);
        assert!(
            far(&found, flange.isometry()) < 2e-7,
            "{} {q:?}: {found} for {}",
            model.name,
            flange.isometry()
        );
        for (name, pose) in mounted.frames() {
            let expected = flange.isometry() * pose;
            let found = at(&robot, model, name, &q);
            assert!(far(&found, &expected) < 2e-7, "{} {name}", model.name);
        }
    }
}

#[test]
fn another_parser_finds_our_forward_kinematics_in_every_model() {
    for name in ModelData::builtin_names() {
        let model = ModelData::builtin(name).unwrap();
        match model.dof {
            2 => same_as_arm::<2>(&model),
            6 => same_as_arm::<6>(&model),
            7 => same_as_arm::<7>(&model),
            other => panic!("{name} has {other} joints"),
        }
    }
}

/// A model of a user's file: turned base, offsets in all joints, names that a URDF cannot have.
#[test]
fn a_model_from_a_file_is_described_as_well() {
    let text = ModelData::builtin_text("panda").unwrap();
    let mut model = ModelData::from_toml(text).unwrap();
    let turn = UnitQuaternion::from_euler_angles(0.3, -0.4, 1.2).to_homogeneous();
    model.dh.base_from_dh0 = std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)]));
    model.dh.base_from_dh0[1][3] = 0.25;
    for (i, row) in model.dh.rows.iter_mut().enumerate() {
        row.theta_offset_rad = 0.2 * i as f64 - 0.5;
    }
    model.links[0].name = "base".to_owned();
    model.name = "my \"arm\" & <more>".to_owned();
    same_as_arm::<7>(&model);
    let robot = urdf_rs::read_from_string(&urdf(&model, &mounted()).unwrap()).unwrap();
    assert_eq!(robot.name, model.name);
}

/// Corrections of metres along parallel axes, as a real arm's calibration has them, are not drawn.
#[test]
fn a_calibrated_arm_is_drawn_as_the_arm_it_is() {
    let zeros = "[0, 0, 0, 0, 0, 0]";
    let text = format!(
        "[mounting]\ndelta_theta = {zeros}\ndelta_a = {zeros}\n\
         delta_d = [0, -6.3, 8.6, -2.3, 0, 0]\ndelta_alpha = {zeros}\n"
    );
    let table = ModelData::builtin("ur5e").unwrap();
    let model = table.calibrated(&text).unwrap();
    same_as_arm::<6>(&model);
    let shapes = |model: &ModelData| {
        let robot = urdf_rs::read_from_string(&urdf(model, &mounted()).unwrap()).unwrap();
        let visuals = robot.links.into_iter().flat_map(|link| link.visual);
        let sizes: Vec<f64> = visuals
            .flat_map(|visual| match visual.geometry {
                Geometry::Cylinder { radius, length } => vec![radius, length],
                Geometry::Sphere { radius } => vec![radius],
                Geometry::Box { size } => size.0.to_vec(),
                other => panic!("{other:?}"),
            })
            .collect();
        sizes
    };
    let (drawn, expected) = (shapes(&model), shapes(&table));
    assert_eq!(drawn.len(), expected.len());
    for (size, expected) in drawn.iter().zip(&expected) {
        assert!((size - expected).abs() < 1e-6, "{drawn:?} for {expected:?}");
    }
}

#[test]
fn golden_poses_are_those_of_the_urdf() {
    let mut compared = 0;
    for text in GOLDEN {
        let golden: Value = serde_json::from_str(text).unwrap();
        for (name, cases) in golden["models"].as_object().unwrap() {
            let model = ModelData::builtin(name).unwrap();
            let robot =
                urdf_rs::read_from_string(&urdf(&model, &Mounted::default()).unwrap()).unwrap();
            let cases = cases.as_array().or_else(|| cases["cases"].as_array());
            for case in cases.unwrap() {
                let number = |v: &Value| v.as_f64().unwrap();
                let q: Vec<f64> = case["q"].as_array().unwrap().iter().map(number).collect();
                let found = at(&robot, &model, "flange", &q).to_homogeneous();
                for r in 0..4 {
                    for c in 0..4 {
                        let expected = number(&case["base_from_flange"][r][c]);
                        assert!((found[(r, c)] - expected).abs() < 1e-6, "{name} {q:?}");
                    }
                }
                compared += 1;
            }
        }
    }
    assert!(compared >= 50, "{compared}");
}

/// The tree has one root and every link is drawn with shapes of a sensible size.
#[test]
fn every_link_is_seen_and_hangs_on_the_base() {
    for name in ModelData::builtin_names() {
        let model = ModelData::builtin(name).unwrap();
        let robot = urdf_rs::read_from_string(&urdf(&model, &mounted()).unwrap()).unwrap();
        assert_eq!(robot.links.len(), model.dof + 5, "{name}");
        assert_eq!(robot.joints.len(), robot.links.len() - 1, "{name}");
        for link in &robot.links {
            let parents = robot.joints.iter().filter(|j| j.child.link == link.name);
            assert_eq!(parents.count(), usize::from(link.name != "base"), "{name}");
            assert!(!link.visual.is_empty(), "{name} {}", link.name);
            for visual in &link.visual {
                let largest = match &visual.geometry {
                    Geometry::Cylinder { radius, length } => {
                        assert!(*radius > 1e-3 && *length >= 1e-3, "{name} {}", link.name);
                        radius.max(*length)
                    }
                    Geometry::Sphere { radius } => *radius,
                    Geometry::Box { size } => size.0[0],
                    other => panic!("{name} {}: {other:?}", link.name),
                };
                assert!(largest < 2.0, "{name} {}: {largest} m", link.name);
            }
        }
    }
}

/// The masses of the moving links, where the arm's dynamics have them.
#[test]
fn the_links_have_the_masses_of_the_model() {
    let model = ModelData::builtin("ur10e").unwrap();
    let robot = urdf_rs::read_from_string(&urdf(&model, &Mounted::default()).unwrap()).unwrap();
    let arm = Arm::<6>::new(&model).unwrap();
    let q = angles(&model, 3);
    // Torque of gravity about each joint, from the centres of mass of the links beyond it.
    let torques = arm.gravity(&SVector::from_column_slice(&q));
    for i in 0..model.dof {
        let joint = at(&robot, &model, &model.links[i].name, &q);
        let axis = joint.rotation * Vector3::z();
        let mut torque = 0.0;
        for data in &model.links[i..] {
            let link = robot.links.iter().find(|l| l.name == data.name).unwrap();
            let frame = at(&robot, &model, &data.name, &q);
            let com = frame
                .transform_point(&Vector3::from(link.inertial.origin.xyz.0).into())
                .coords;
            let weight = Vector3::from(model.gravity_m_per_s2) * link.inertial.mass.value;
            torque -= axis.dot(&(com - joint.translation.vector).cross(&weight));
        }
        assert!((torque - torques[i]).abs() < 1e-6, "joint {i}: {torque}");
    }
}
