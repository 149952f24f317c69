use nalgebra::{Rotation3, UnitQuaternion};
use tangent_control::PathSpec;
use tangent_mechanics::{Arm, Joints, inverse_kinematics};

use super::*;
use crate::lesson::Key;

fn tool() -> Pose<Flange, Tool> {
    Pose::new(Vector3::new(0.0, 0.0, 0.165), UnitQuaternion::identity())
}

/// A lesson of the tool at places of a plane that leans by 0.2 rad, and the arm's model.
struct Teacher {
    model: ModelData,
    arm: Arm<6>,
    lesson: Lesson,
}

impl Teacher {
    fn new() -> Self {
        let model = ModelData::builtin("ur5").unwrap();
        let arm = Arm::new(&model).unwrap();
        Self {
            model,
            arm,
            lesson: Lesson::default(),
        }
    }

    /// The arm with its tool at (x, y) of the plane, `height_m` above it.
    fn at(&self, x: f64, y: f64, height_m: f64) -> Shown {
        let lean = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.2);
        let down = lean * Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let rotation = UnitQuaternion::from_rotation_matrix(&down);
        // y of the path is against y of a tool that points down.
        let place = Vector3::new(0.4, 0.1, 0.2) + down * Vector3::new(x, -y, -height_m);
        let target = Pose::new(place, rotation);
        let q = inverse_kinematics(&self.arm, &tool(), &target, &self.arm.home()).unwrap();
        Shown {
            joints_rad: q.as_slice().to_vec(),
            base_from_tool: self.arm.base_from_flange(&q) * tool(),
        }
    }

    fn point(&mut self, x: f64, y: f64) {
        let shown = self.at(x, y, 0.0);
        self.lesson.press(Key::Point, &shown);
    }

    fn draft(&self, change: impl FnOnce(&mut DraftOptions<'_>)) -> Result<Draft, TeachError> {
        let tool = tool();
        let mut options = DraftOptions {
            name: "lid",
            shown_on: "cell1 (ur5)",
            shape: Shape::Open,
            force_n: 5.0,
            speed_m_per_s: 0.02,
            clearance_m: 0.03,
            tolerance_m: 0.002,
            travels: true,
            model: &self.model,
            flange_from_tool: &tool,
        };
        change(&mut options);
        draft(&self.lesson, &options)
    }
}

fn points(task: &Task) -> Vec<[f64; 2]> {
    match &task.path {
        PathSpec::Waypoints(path) => path.points_m.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn points_become_a_path_in_their_own_plane_with_a_start_above_the_first() {
    let mut teacher = Teacher::new();
    for (x, y) in [(0.0, 0.0), (0.06, 0.0), (0.06, 0.0), (0.06, 0.04)] {
        teacher.point(x, y);
    }
    let home = teacher.at(-0.05, 0.0, 0.1);
    teacher.lesson.press(Key::Home, &home);
    let draft = teacher.draft(|_| {}).unwrap();
    assert_eq!(points(&draft.task), [[0.06, 0.0], [0.06, 0.04]]);
    assert_eq!((draft.places, draft.notes.len()), (3, 0));
    assert!((draft.length_m - 0.1).abs() < 1e-6);
    assert_eq!(draft.task.force.reference_n, 5.0);

    // The task starts 30 mm above the first point, with the tool as it was there.
    let start = draft.task.start.as_ref().unwrap();
    let q = Joints::<6>::from_column_slice(&start.joints_rad);
    let pose = teacher.arm.base_from_flange(&q) * tool();
    let wanted = teacher.at(0.0, 0.0, 0.03).base_from_tool;
    assert!((pose.translation() - wanted.translation()).norm() < 1e-4);
    assert!(pose.rotation().angle_to(&wanted.rotation()) < 1e-4);
    let home = draft.task.home.as_ref().unwrap();
    assert_eq!(home.joints_rad.len(), 6);
    // The approach reaches the surface from there.
    assert!(draft.task.approach.distance_max_m >= 0.05);
}

#[test]
fn an_outline_is_closed_and_needs_an_area() {
    let mut teacher = Teacher::new();
    teacher.point(0.0, 0.0);
    teacher.point(0.05, 0.0);
    let error = teacher.draft(|o| o.shape = Shape::Polygon).unwrap_err();
    assert!(error.to_string().contains("2 places were shown"), "{error}");
    teacher.point(0.05, 0.05);
    let draft = teacher.draft(|o| o.shape = Shape::Polygon).unwrap();
    assert_eq!(points(&draft.task), [[0.05, 0.0], [0.05, 0.05], [0.0, 0.0]]);
    assert!(draft.text.contains("closed to an outline"));
}

#[test]
fn an_outline_is_filled_and_must_not_cross_itself() {
    let region = |o: &mut DraftOptions<'_>| o.shape = Shape::Region { spacing_m: 0.008 };
    let mut teacher = Teacher::new();
    for (x, y) in [(0.0, 0.0), (0.05, 0.0), (0.05, 0.04), (0.0, 0.04)] {
        teacher.point(x, y);
    }
    let draft = teacher.draft(region).unwrap();
    let PathSpec::Region(found) = &draft.task.path else {
        panic!("{}", draft.text);
    };
    assert_eq!(found.spacing_m, 0.008);
    let outline = [[0.0, 0.0], [0.05, 0.0], [0.05, 0.04], [0.0, 0.04]];
    assert_eq!(found.outline_m, outline);
    teacher.point(0.06, 0.01);
    let error = teacher.draft(region).unwrap_err().to_string();
    assert!(error.contains("outline_m"), "{error}");
}

#[test]
fn a_stroke_keeps_its_shape_and_few_points() {
    let mut teacher = Teacher::new();
    let first = teacher.at(0.0, 0.0, 0.0);
    teacher.lesson.press(Key::Stroke, &first);
    for i in 1..=30 {
        let x = 0.002 * f64::from(i);
        let shown = teacher.at(x, 0.02 * (x / 0.06).powi(2), 0.0);
        teacher.lesson.sample(&shown);
    }
    let last = teacher.at(0.06, 0.02, 0.0);
    teacher.lesson.press(Key::Stroke, &last);
    let draft = teacher.draft(|_| {}).unwrap();
    let found = points(&draft.task);
    assert!((2..=5).contains(&found.len()), "{found:?}");
    assert_eq!(found.last(), Some(&[0.06, 0.02]));
}

#[test]
fn what_is_not_enough_or_not_flat_is_said() {
    let mut teacher = Teacher::new();
    let error = teacher.draft(|_| {}).unwrap_err().to_string();
    assert!(error.starts_with("nothing shown"), "{error}");
    teacher.point(0.0, 0.0);
    let error = teacher.draft(|_| {}).unwrap_err().to_string();
    assert!(error.starts_with("one place was shown"), "{error}");
    let high = teacher.at(0.05, 0.0, 0.02);
    teacher.lesson.press(Key::Point, &high);
    let draft = teacher.draft(|o| o.travels = false).unwrap();
    assert!(draft.task.start.is_none() && draft.start_joints_rad.is_empty());
    let notes = draft.notes.join("; ");
    assert!(
        notes.contains("20 mm above") && notes.contains("does not move the arm"),
        "{notes}"
    );
    // Ranges are those of any task.
    let error = teacher
        .draft(|o| o.force_n = 500.0)
        .unwrap_err()
        .to_string();
    assert!(error.contains("force.reference_n"), "{error}");
}

#[test]
fn any_name_is_a_name_in_the_file() {
    let mut teacher = Teacher::new();
    teacher.point(0.0, 0.0);
    teacher.point(0.03, 0.0);
    let draft = teacher
        .draft(|o| (o.name, o.shown_on) = ("a \"lid\" \\ b", "x\nname = 3"))
        .unwrap();
    assert_eq!(draft.task.name, "a \"lid\" \\ b");
}
