use nalgebra::{Rotation3, Vector2};
use proptest::prelude::*;
use tangent_mechanics::{ModelData, inverse_kinematics};

use super::*;

const TASK: &str = r#"
    name = "line"
    force.reference_n = 3.0
    [path]
    kind = "line"
    to_m = [0.1, 0.0]
    speed_m_per_s = 0.02
"#;

fn arm<const N: usize>(name: &str) -> Arm<N> {
    Arm::new(&ModelData::builtin(name).unwrap()).unwrap()
}

fn tool() -> Pose<Flange, Tool> {
    Pose::new(Vector3::new(0.0, 0.0, 0.165), UnitQuaternion::identity())
}

/// Tool pose pointing down at a position, base axes.
fn down(position: Vector3<f64>) -> Pose<Base, Tool> {
    let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Pose::new(position, UnitQuaternion::from_rotation_matrix(&turn))
}

fn workspace() -> Limits {
    Limits {
        workspace_min_m: [-1.2, -1.2, -0.5],
        workspace_max_m: [1.2, 1.2, 1.5],
        ..Limits::default()
    }
}

/// Refusals of a task for an arm whose tool points down at `start`.
fn from<const N: usize>(model: &str, start: [f64; 3], limits: &Limits, task: &str) -> Vec<Refusal> {
    refusals::<N>(model, start, limits, task, true)
}

/// As [`from`], for a law that moves the arm to a start pose or does not.
fn refusals<const N: usize>(
    model: &str,
    standing: [f64; 3],
    limits: &Limits,
    task: &str,
    travels: bool,
) -> Vec<Refusal> {
    let arm = arm::<N>(model);
    let q = inverse_kinematics(&arm, &tool(), &down(standing.into()), &arm.home()).unwrap();
    let task: Task = task.parse().unwrap();
    let path = Path::new(&task.path, 0.1, 1.0).unwrap();
    let preflight = Preflight {
        task: &task,
        path: &path,
        limits,
        arm: &arm,
        flange_from_tool: &tool(),
        travels,
    };
    preflight.refusals(Some(&q))
}

fn ur5(start: [f64; 3], limits: &Limits, task: &str) -> Vec<Refusal> {
    from::<6>("ur5", start, limits, task)
}

#[test]
fn a_task_that_fits_is_not_refused() {
    assert_eq!(ur5([0.4, 0.0, 0.3], &workspace(), TASK), []);
    assert_eq!(from::<7>("panda", [0.5, 0.0, 0.3], &workspace(), TASK), []);
    let found = from::<6>("smart3s_substitute", [0.8, 0.0, 0.7], &workspace(), TASK);
    assert_eq!(found, []);
}

#[test]
fn a_force_at_the_limit_is_refused_with_both_numbers() {
    for (force, refused) in [("39.9", false), ("40.0", true), ("55.0", true)] {
        let task = TASK.replace("3.0", force);
        let found = ur5([0.4, 0.0, 0.3], &workspace(), &task);
        assert_eq!(!found.is_empty(), refused, "{force}: {found:?}");
        if refused {
            let words = words(&found).unwrap();
            let force: f64 = force.parse().unwrap();
            for part in [
                &format!("{force} N"),
                "40 N",
                "limits.force_max_n",
                "force.reference_n",
            ] {
                assert!(words.contains(part), "{part}: {words}");
            }
        }
    }
}

#[test]
fn every_speed_is_held_against_the_limit() {
    let limits = Limits {
        speed_max_m_per_s: 0.01,
        ..workspace()
    };
    let task = format!("approach.speed_m_per_s = 0.03\nend.retract_speed_m_per_s = 0.009\n{TASK}");
    let found = ur5([0.4, 0.0, 0.3], &limits, &task);
    let keys: Vec<_> = found
        .iter()
        .map(|refusal| match refusal {
            Refusal::Speed { key, .. } => *key,
            other => panic!("{other}"),
        })
        .collect();
    assert_eq!(keys, ["path.speed_m_per_s", "approach.speed_m_per_s"]);
}

#[test]
fn a_path_that_leaves_the_box_is_refused_where_it_does() {
    let mut limits = workspace();
    limits.workspace_max_m[0] = 0.45;
    let found = ur5([0.4, 0.0, 0.3], &limits, TASK);
    let [Refusal::Outside { at, edge }] = found.as_slice() else {
        panic!("{found:?}");
    };
    // 5 cm in x are allowed; the path is checked every 5 mm.
    assert!((0.05..0.0551).contains(&at.way_m), "{at:?}");
    assert!((at.in_base_m[0] - 0.4 - at.way_m).abs() < 1e-9, "{at:?}");
    assert_eq!((edge.axis, edge.limit_m), ('x', 0.45));
    let words = words(&found).unwrap();
    for part in [
        "m along the path",
        "base axes",
        "begins where the tool stands",
        "limits.workspace_max_m = 0.450 m",
    ] {
        assert!(words.contains(part), "{part}: {words}");
    }
}

#[test]
fn a_tool_that_stands_outside_is_refused() {
    let mut limits = workspace();
    limits.workspace_min_m[2] = 0.35;
    let found = ur5([0.4, 0.0, 0.3], &limits, TASK);
    let [Refusal::StartOutside { in_base_m, edge }] = found.as_slice() else {
        panic!("{found:?}");
    };
    assert!((in_base_m[2] - 0.3).abs() < 1e-6);
    assert_eq!((edge.axis, edge.key), ('z', "limits.workspace_min_m"));
}

#[test]
fn a_path_beyond_the_arm_is_refused_before_its_end() {
    for (arm, task, start) in [
        ("ur5", "to_m = [0.9, 0.0]", [0.4, 0.0, 0.3]),
        ("panda", "to_m = [0.9, 0.0]", [0.5, 0.0, 0.3]),
    ] {
        let limits = Limits {
            workspace_min_m: [-2.0; 3],
            workspace_max_m: [2.0; 3],
            ..Limits::default()
        };
        let task = TASK.replace("to_m = [0.1, 0.0]", task);
        let found = match arm {
            "ur5" => from::<6>(arm, start, &limits, &task),
            _ => from::<7>(arm, start, &limits, &task),
        };
        let stopped = found.iter().find_map(|refusal| match refusal {
            Refusal::OutOfReach { at, .. } => Some(at.way_m),
            _ => None,
        });
        let way_m = stopped.unwrap_or_else(|| panic!("{arm}: {found:?}"));
        assert!((0.1..0.7).contains(&way_m), "{arm}: {way_m}");
    }
}

#[test]
fn the_plane_may_lie_anywhere_along_the_approach() {
    // At the start's height the path is above the box's lid; 4 cm below it is inside.
    let mut limits = workspace();
    limits.workspace_max_m[2] = 0.31;
    let tilted = "approach.direction = [0.0, 0.2, -1.0]\nplane.x_axis = [1.0, 0.0, 0.0]";
    let up_the_slope = TASK.replace("to_m = [0.1, 0.0]", "to_m = [0.0, -0.1]");
    let task = format!("{tilted}\n{up_the_slope}");
    assert_eq!(ur5([0.4, 0.0, 0.3], &limits, &task), []);
    limits.workspace_max_m[2] = 0.305;
    limits.workspace_min_m[2] = 0.295;
    let found = ur5([0.4, 0.0, 0.3], &limits, &task);
    assert!(
        matches!(found.as_slice(), [Refusal::Outside { .. }]),
        "{found:?}"
    );
}

#[test]
fn an_approach_that_leads_away_is_refused() {
    let task = format!("approach.direction = [0.0, 0.0, 1.0]\n{TASK}");
    let found = ur5([0.4, 0.0, 0.3], &workspace(), &task);
    assert!(
        matches!(found.as_slice(), [Refusal::ApproachBackwards { .. }]),
        "{found:?}"
    );
}

#[test]
fn an_arm_that_stretches_out_is_refused_for_the_singularity() {
    let limits = Limits {
        workspace_min_m: [-2.0; 3],
        workspace_max_m: [2.0; 3],
        ..Limits::default()
    };
    // Between well within reach and out of reach, the arm still arrives but is nearly singular.
    let refused = (11_500..14_000).find_map(|steps| {
        let to_x = f64::from(steps) * 2e-5;
        let task = TASK.replace("to_m = [0.1, 0.0]", &format!("to_m = [{to_x}, 0.0]"));
        let found = ur5([0.4, 0.0, 0.3], &limits, &task);
        found.first().cloned()
    });
    let Some(Refusal::Singular {
        at,
        smallest,
        floor,
    }) = refused
    else {
        panic!("{refused:?}");
    };
    assert!(smallest < floor, "{smallest}");
    assert!(at.way_m > 0.2, "{at:?}");
}

proptest! {
    /// A path that leaves the box is refused, and a place that is reported as outside is outside.
    #[test]
    fn a_refusal_by_the_workspace_is_true(
        x in 0.3f64..0.5, y in -0.2f64..0.2, to_x in -0.3f64..0.3, to_y in -0.3f64..0.3, lid in 0.3f64..0.7,
    ) {
        let mut limits = workspace();
        limits.workspace_max_m[0] = lid;
        let task = TASK.replace("to_m = [0.1, 0.0]", &format!("to_m = [{to_x}, {to_y}]"));
        let found = ur5([x, y, 0.3], &limits, &task);
        // The tool's x axis is the base's: the tool points down, turned about x.
        let leaves = x > lid || x + to_x > lid;
        let outside = |r: &Refusal| matches!(r, Refusal::Outside { .. } | Refusal::StartOutside { .. });
        // Far out the arm's reach may end before the box does.
        prop_assert!(leaves || !found.iter().any(outside), "{:?}", found);
        prop_assert!(!leaves || !found.is_empty());
        for refusal in &found {
            if let Refusal::Outside { at, .. } = refusal {
                prop_assert!(at.in_base_m[0] > lid);
                let way = Vector2::from(at.on_path_m).norm();
                prop_assert!((way - at.way_m).abs() < 1e-9);
            }
        }
    }
}

/// Refusals of a task with a start pose for an arm that stands with its tool at `standing`.
fn to_start(
    limits: &Limits,
    law_travels: bool,
    standing: [f64; 3],
    start: &[f64],
    more: &str,
) -> Vec<Refusal> {
    let text = format!("{TASK}\n[start]\njoints_rad = {start:?}\n{more}");
    refusals::<6>("ur5", standing, limits, &text, law_travels)
}

fn joints_at(place: [f64; 3]) -> Vec<f64> {
    let arm = arm::<6>("ur5");
    let q = inverse_kinematics(&arm, &tool(), &down(place.into()), &arm.home()).unwrap();
    q.as_slice().to_vec()
}

#[test]
fn the_path_is_checked_from_the_start_pose_and_not_from_where_the_arm_stands() {
    let (inner, outer) = ([0.4, 0.0, 0.3], [0.45, 0.0, 0.3]);
    let limits = Limits {
        workspace_max_m: [0.52, 1.2, 1.5],
        ..workspace()
    };
    // The path of 0.1 m along x leaves the workspace from the outer pose only.
    let found = ur5(outer, &limits, TASK);
    assert!(matches!(found[..], [Refusal::Outside { .. }]), "{found:?}");
    assert_eq!(to_start(&limits, true, outer, &joints_at(inner), ""), []);
    assert_eq!(to_start(&limits, true, inner, &joints_at(outer), ""), found);
}

#[test]
fn a_start_beyond_an_end_stop_or_of_another_arm_is_refused_by_key() {
    let mut bad = joints_at([0.4, 0.0, 0.3]);
    bad[5] = 6.27;
    let words = words(&to_start(&workspace(), true, [0.4, 0.0, 0.3], &bad, "")).unwrap();
    for part in ["`start.joints_rad`", "joint 6 is 6.270 rad", "6.2"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    let good = joints_at([0.4, 0.0, 0.3]);
    let home = "[home]\njoints_rad = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]";
    let words = super::words(&to_start(&workspace(), true, [0.4, 0.0, 0.3], &good, home)).unwrap();
    assert!(words.contains("`home.joints_rad` has 7 numbers"), "{words}");
}

#[test]
fn a_law_that_does_not_travel_refuses_a_start_that_is_away() {
    let good = joints_at([0.4, 0.0, 0.3]);
    assert_eq!(
        to_start(&workspace(), false, [0.4, 0.0, 0.3], &good, ""),
        []
    );
    let words = words(&to_start(&workspace(), false, [0.4, 0.02, 0.3], &good, "")).unwrap();
    assert!(
        words.contains("start.tolerance_rad") && words.contains("guide it there by hand"),
        "{words}"
    );
}

#[test]
fn a_way_out_of_the_workspace_is_refused_with_its_place() {
    // Half a turn of the base between the two: the way leads around, beside the workspace.
    let mut start = joints_at([0.4, 0.0, 0.3]);
    start[0] += if start[0] > 0.0 { -6.0 } else { 6.0 };
    let limits = Limits {
        workspace_min_m: [0.1, -1.2, -0.5],
        ..workspace()
    };
    let found = to_start(&limits, true, [0.4, 0.0, 0.3], &start, "");
    assert!(
        matches!(found.first(), Some(Refusal::WayOutside { share, .. }) if *share > 0.0),
        "{found:?}"
    );
}
