//! The whole path of the task as it was drawn: in its plane, from where the tool begins to slide.

use std::time::{Duration, Instant};

use nalgebra::Vector3;
use tangent_control::{Path, Task};
use tangent_mechanics::{Base, Pose, Tool, World};
use tangent_schemas::standard::{Marker, Point};

use super::Seen;
use super::shape::{kind, marker};

/// Distance between two points of the line, m.
const SPACING_M: f64 = 0.005;
/// Largest number of points of the line.
const POINTS_MAX: usize = 1000;
/// Interval at which the line is published again.
const AGAIN: Duration = Duration::from_secs(5);
/// Acceleration and jerk of the path's time law, m/s² and m/s³. They do not change its shape.
const TIME_LAW: (f64, f64) = (0.1, 1.0);

/// The path of a task in base axes; nothing for a task without a path in a plane.
#[derive(Debug, Default)]
pub struct Planned {
    /// Places relative to the path's start, base axes, m.
    places: Vec<Vector3<f64>>,
    /// The path in world axes, m; empty until the tool slides.
    line: Vec<Point>,
    sent: Option<Instant>,
}

impl Planned {
    /// Reads the path of a task that begins with the tool at this pose.
    pub fn of_task(text: Option<&str>, base_from_tool: &Pose<Base, Tool>) -> Self {
        let places = text.and_then(|text| places(text, base_from_tool));
        Self {
            places: places.unwrap_or_default(),
            ..Self::default()
        }
    }

    /// The tool begins to slide here, base axes, m. Only the first call of a task has an effect.
    pub fn begin_at(&mut self, start: &Vector3<f64>, world_from_base: &Pose<World, Base>) {
        if self.line.is_empty() {
            let places = self.places.drain(..);
            let places = places.map(|place| world_from_base.transform_point(&(start + place)));
            self.line = places.map(|place| (&place).into()).collect();
        }
    }

    pub fn draw(&mut self, seen: &Seen) -> Option<Marker> {
        let due = self.sent.is_none_or(|sent| seen.now >= sent + AGAIN);
        if !due || self.line.len() < 2 {
            return None;
        }
        self.sent = Some(seen.now);
        let name = "path/planned";
        let mut line = marker(seen.stamp, "world", name, kind::LINE_STRIP, [0.75; 3]);
        line.scale.x = 0.001;
        line.points.clone_from(&self.line);
        Some(line)
    }
}

fn places(text: &str, base_from_tool: &Pose<Base, Tool>) -> Option<Vec<Vector3<f64>>> {
    let task: Task = text.parse().ok()?;
    let path = Path::new(&task.path, TIME_LAW.0, TIME_LAW.1).ok()?;
    // As the law lays the plane: at right angles to the approach, x as the task says.
    let normal = -task.approach.direction.in_base(base_from_tool);
    let x = task.plane.x_axis.in_base(base_from_tool);
    let x = (x - normal * x.dot(&normal)).try_normalize(1e-6)?;
    let y = normal.cross(&x);
    let all = path.places(SPACING_M);
    let every = all.len().div_ceil(POINTS_MAX).max(1);
    let places = all.iter().step_by(every).chain(all.last());
    Some(
        places
            .map(|place| x * place.position.x + y * place.position.y)
            .collect(),
    )
}
