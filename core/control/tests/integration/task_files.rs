//! Every task file that is shipped is loaded and prepared, and contains what its name promises.

use tangent_control::{ControllerConfig, PathSpec, Program, Task};

fn program(text: &str) -> Program {
    let task: Task = text.parse().unwrap();
    Program::new(&task, &ControllerConfig::default()).unwrap()
}

#[test]
fn the_tasks_that_ship() {
    let raster = program(include_str!("../../../../deploy/tasks/raster.toml"));
    let PathSpec::Raster(path) = &raster.task.path else {
        panic!("{:?}", raster.task.path);
    };
    // Tugal et al., V.A: 10 s per axis at 0.02 m/s.
    assert_eq!(path.length_m / path.speed_m_per_s, 10.0);
    assert!((30.0..35.0).contains(&raster.path.duration_s()));
    let circle = program(include_str!("../../../../deploy/tasks/circle.toml"));
    assert!(matches!(circle.task.path, PathSpec::Circle(_)));
    let loops = program(include_str!("../../../../deploy/tasks/loops.toml"));
    assert!((loops.path.duration_s() - 20.0).abs() < 2.0);
    let object = program(include_str!("../../../../deploy/tasks/object_circle.toml"));
    assert_eq!(object.task.force.reference_n, 20.0);
    let line = program(include_str!("../../../../deploy/tasks/line.toml"));
    assert!(matches!(line.task.path, PathSpec::Line(_)));
    let end = line.path.at(line.path.duration_s()).position;
    assert!(
        end.norm() < 1e-12,
        "an even number of strokes ends at the start"
    );
    let points = program(include_str!("../../../../deploy/tasks/waypoints.toml"));
    assert!(matches!(points.task.path, PathSpec::Waypoints(_)));
    let strokes = program(include_str!("../../../../deploy/tasks/strokes.toml"));
    assert_eq!(
        (strokes.path.lifts(), strokes.path.force_max_n()),
        (1, Some(6.0))
    );
    let region = program(include_str!("../../../../deploy/tasks/region.toml"));
    // From the touch beside the region to its first row.
    assert!(
        (1..=3).contains(&region.path.lifts()),
        "{}",
        region.path.lifts()
    );
    assert_eq!(region.task.coverage.unwrap().rounds_max, 3);
}
