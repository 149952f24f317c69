//! The task file of a lesson: a path in the plane of the first point, and the start pose above it.

use std::ops::RangeInclusive;

use nalgebra::{Vector2, Vector3};
use tangent_control::Task;
use tangent_control::contact::alignment::plane_axes;
use tangent_control::fill::{area_m2, simplify};
use tangent_mechanics::{Flange, ModelData, Pose, Tool};

use crate::error::TeachError;
use crate::lesson::{Lesson, Mark, Shown};
use crate::start_pose;

/// Distance below which two places of the path are one, m.
const SAME_M: f64 = 0.0005;
/// Longest coordinate of a path, m.
const REACH_M: f64 = 2.0;
/// Distance from the plane from which the person is told, m.
const UNEVEN_M: f64 = 0.01;
/// The approach continues this far below the height at which the first point was shown, m.
const BELOW_M: f64 = 0.03;

/// Allowed heights of the start pose above the first place, m.
pub const CLEARANCE_M: RangeInclusive<f64> = 0.005..=0.3;
/// Allowed distances between the rows of a region, m.
pub const SPACING_M: RangeInclusive<f64> = 0.0005..=0.5;
/// Allowed distances of a stroke from the path that is made of it, m.
pub const TOLERANCE_M: RangeInclusive<f64> = 0.0002..=0.02;

/// Shape of the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Shape {
    /// Through the points and along the strokes, in the order in which they were shown.
    #[default]
    Open,
    /// Along an outline: back to the first point at the end.
    Polygon,
    /// The region inside an outline, filled with rows.
    Region {
        /// Distance between the rows, m.
        spacing_m: f64,
    },
}

/// What the file states besides what was shown.
#[derive(Clone, Debug, PartialEq)]
pub struct DraftOptions<'a> {
    /// Name of the task.
    pub name: &'a str,
    /// Where it was shown, for a comment in the file.
    pub shown_on: &'a str,
    /// Shape of the path.
    pub shape: Shape,
    /// Pressing force, N.
    pub force_n: f64,
    /// Speed along the path, m/s.
    pub speed_m_per_s: f64,
    /// Height of the start pose above the first point, m.
    pub clearance_m: f64,
    /// Largest distance of a stroke's samples from the path, m.
    pub tolerance_m: f64,
    /// Whether the cell's law moves the arm to a start pose.
    pub travels: bool,
    /// Model of the arm.
    pub model: &'a ModelData,
    /// Pose of the tool on the flange.
    pub flange_from_tool: &'a Pose<Flange, Tool>,
}

/// A task file, and remarks for the person.
#[derive(Clone, Debug, PartialEq)]
pub struct Draft {
    /// Text of the file.
    pub text: String,
    /// The task as read back from it.
    pub task: Task,
    /// Places of the path, the first one included.
    pub places: usize,
    /// Length of the path, m.
    pub length_m: f64,
    /// Joint positions of the start pose, rad; empty without one.
    pub start_joints_rad: Vec<f64>,
    /// What the person should know.
    pub notes: Vec<String>,
}

/// Makes the task file of a lesson. The task begins with the tool as it was at the first point,
/// `clearance_m` above it.
///
/// # Errors
/// Too little was shown, a place is too far away, the arm cannot stand above the first point, or an
/// option is out of its range.
pub fn draft(lesson: &Lesson, options: &DraftOptions<'_>) -> Result<Draft, TeachError> {
    check_options(options)?;
    let first = first(lesson).ok_or(TeachError::TooFew {
        shown: "nothing".to_owned(),
        wanted: "a path needs two places: Enter takes one, `s` begins and ends a stroke",
    })?;
    let plane = Plane::of(first);
    let mut places: Vec<Vector2<f64>> = Vec::new();
    for mark in &lesson.marks {
        let more = match mark {
            Mark::Point(shown) => vec![plane.place(shown)],
            Mark::Stroke(samples) => {
                let samples: Vec<_> = samples.iter().map(|s| plane.place(s)).collect();
                simplify(&samples, options.tolerance_m)
            }
        };
        for place in more {
            if places
                .last()
                .is_none_or(|last| (last - place).norm() > SAME_M)
            {
                places.push(place);
            }
        }
    }
    check(&places, options.shape)?;
    if options.shape == Shape::Polygon {
        places.push(Vector2::zeros());
    }
    let start_joints_rad = if options.travels {
        let (model, tool) = (options.model, options.flange_from_tool);
        start_pose::above(model, tool, first, options.clearance_m)?
    } else {
        Vec::new()
    };
    let text = text(lesson, options, &places, &start_joints_rad);
    Ok(Draft {
        task: text.parse()?,
        text,
        places: places.len(),
        length_m: places
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).norm())
            .sum(),
        start_joints_rad,
        notes: notes(lesson, &plane, options.travels),
    })
}

fn check_options(options: &DraftOptions<'_>) -> Result<(), TeachError> {
    let spacing = match options.shape {
        Shape::Region { spacing_m } => Some(("spacing_m", spacing_m, SPACING_M)),
        Shape::Open | Shape::Polygon => None,
    };
    let others = [
        ("clearance_m", options.clearance_m, CLEARANCE_M),
        ("tolerance_m", options.tolerance_m, TOLERANCE_M),
    ];
    for (option, value, allowed) in others.into_iter().chain(spacing) {
        if !allowed.contains(&value) {
            return Err(TeachError::Option {
                option,
                value,
                least: *allowed.start(),
                most: *allowed.end(),
            });
        }
    }
    Ok(())
}

fn first(lesson: &Lesson) -> Option<&Shown> {
    lesson.marks.first().and_then(|mark| match mark {
        Mark::Point(shown) => Some(shown),
        Mark::Stroke(samples) => samples.first(),
    })
}

fn all(lesson: &Lesson) -> impl Iterator<Item = &Shown> {
    lesson.marks.iter().flat_map(|mark| match mark {
        Mark::Point(shown) => std::slice::from_ref(shown),
        Mark::Stroke(samples) => samples.as_slice(),
    })
}

/// The path's plane: through the first place, perpendicular to the tool's axis there.
struct Plane {
    origin: Vector3<f64>,
    x: Vector3<f64>,
    y: Vector3<f64>,
    normal: Vector3<f64>,
}

impl Plane {
    /// As the law sets it up: `approach.direction = "tool_z"`, `plane.x_axis = "tool_x"`.
    fn of(first: &Shown) -> Self {
        let pose = &first.base_from_tool;
        let normal = -pose.z_axis();
        let (x, y) = plane_axes(&normal, &pose.rotate(&Vector3::x()));
        Self {
            origin: pose.translation(),
            x,
            y,
            normal,
        }
    }

    fn place(&self, shown: &Shown) -> Vector2<f64> {
        let way = shown.base_from_tool.translation() - self.origin;
        Vector2::new(way.dot(&self.x), way.dot(&self.y))
    }

    fn height_m(&self, shown: &Shown) -> f64 {
        (shown.base_from_tool.translation() - self.origin).dot(&self.normal)
    }
}

fn check(places: &[Vector2<f64>], shape: Shape) -> Result<(), TeachError> {
    let shown = match places.len() {
        1 => "one place was".to_owned(),
        count => format!("{count} places were"),
    };
    if shape != Shape::Open {
        if places.len() < 3 || area_m2(places).abs() < 1e-5 {
            return Err(TeachError::TooFew {
                shown,
                wanted: "an outline needs three places around at least 10 mm²",
            });
        }
    } else if places.len() < 2 {
        return Err(TeachError::TooFew {
            shown,
            wanted: "a path needs two that differ by 0.5 mm",
        });
    }
    match places.iter().position(|place| place.amax() > REACH_M) {
        Some(index) => Err(TeachError::TooFar {
            place: index + 1,
            away_m: places[index].norm(),
        }),
        None => Ok(()),
    }
}

fn notes(lesson: &Lesson, plane: &Plane, travels: bool) -> Vec<String> {
    let mut notes = Vec::new();
    let heights = all(lesson).map(|shown| plane.height_m(shown));
    let (low, high) = heights.fold((0.0_f64, 0.0_f64), |(low, high), h| {
        (low.min(h), high.max(h))
    });
    if high - low > UNEVEN_M {
        notes.push(format!(
            "the places lie up to {:.0} mm above and {:.0} mm below the plane of the first one: the tool follows the \
             surface that it feels, and lengths are measured in the plane",
            high * 1e3,
            -low * 1e3
        ));
    }
    if !travels {
        notes.push(
            "the law of this cell does not move the arm to a start pose: before each start, guide the tool to where the \
             first place was shown, a little above it"
                .to_owned(),
        );
    }
    notes
}

fn text(
    lesson: &Lesson,
    options: &DraftOptions<'_>,
    places: &[Vector2<f64>],
    start_joints_rad: &[f64],
) -> String {
    let (points, strokes) = lesson.counts();
    let written = |places: &[Vector2<f64>]| -> String {
        let line = |place: &Vector2<f64>| {
            format!("    [{}, {}],\n", rounded(place.x, 4), rounded(place.y, 4))
        };
        places.iter().map(line).collect()
    };
    let (outline, path) = match options.shape {
        Shape::Region { spacing_m } => (
            ", around a region",
            format!(
                "kind = \"region\"\nspacing_m = {spacing_m:?}\noutline_m = [\n{}]\n",
                written(places)
            ),
        ),
        // The path begins where the tool touches down: the first place is not written.
        shape => (
            if shape == Shape::Polygon {
                ", closed to an outline"
            } else {
                ""
            },
            format!(
                "kind = \"waypoints\"\npoints_m = [\n{}]\n",
                written(&places[1..])
            ),
        ),
    };
    let mut text = format!(
        "# Shown by hand on {}: {points} points and {strokes} strokes{outline}.\n\
         name = {}\n\
         force.reference_n = {:?}\n\n\
         [approach]\n\
         direction = \"tool_z\"\n\
         distance_max_m = {:.4}\n\n\
         [plane]\n\
         x_axis = \"tool_x\"\n\n\
         # Relative to the first place, at which the tool touches down.\n\
         [path]\n\
         speed_m_per_s = {:?}\n\
         {path}",
        options.shown_on.replace(['\n', '\r'], " "),
        quoted(options.name),
        options.force_n,
        options.clearance_m + BELOW_M,
        options.speed_m_per_s,
    );
    if !start_joints_rad.is_empty() {
        text += &format!(
            "\n# {:.0} mm above the first place.\n[start]\njoints_rad = {}\n",
            options.clearance_m * 1e3,
            joints(start_joints_rad)
        );
        if let Some(home) = &lesson.home {
            text += &format!("\n[home]\njoints_rad = {}\n", joints(&home.joints_rad));
        }
    }
    text
}

fn joints(joints_rad: &[f64]) -> String {
    let each: Vec<String> = joints_rad.iter().map(|q| rounded(*q, 5)).collect();
    format!("[{}]", each.join(", "))
}

/// A number without a negative zero.
fn rounded(value: f64, digits: i32) -> String {
    let unit = 10f64.powi(digits);
    format!("{:?}", (value * unit).round() / unit + 0.0)
}

/// A TOML string.
fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

#[cfg(test)]
mod tests;
