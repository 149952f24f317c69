//! Paths as specified in a task file.

use serde::{Deserialize, Serialize};

use super::ranges::{PAUSE_S, REACH_M, SPEED_M_PER_S, check_point};
use super::strokes::Strokes;
use crate::error::{ControlError, check_range};
use crate::task::ExpectedSurface;
use crate::task::region::Region;

/// A path specified in a task file, chosen by `kind`.
///
/// ```
/// use tangent_control::PathSpec;
///
/// let text = "kind = 'line'\nto_m = [0.04, 0.0]\nspeed_m_per_s = 0.02";
/// let line: PathSpec = toml::from_str(text)?;
/// assert_eq!(line.speed_m_per_s(), 0.02);
///
/// // A key of another kind is an error.
/// let text = "kind = 'circle'\nradius_m = 0.05\nspeed_m_per_s = 0.02\nto_m = [0.04, 0.0]";
/// let error = toml::from_str::<PathSpec>(text).unwrap_err();
/// assert!(error.to_string().contains("to_m"));
/// # Ok::<(), toml::de::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum PathSpec {
    /// Back and forth in x, stepping in y (Tugal et al., V.A).
    Raster(Raster),
    /// A circle through the start.
    Circle(Circle),
    /// A straight line from the start, there and perhaps back.
    Line(Line),
    /// Straight lines through points, stopping at each.
    Waypoints(Waypoints),
    /// Loops that advance across (Karacan et al., III.A).
    Loops(Loops),
    /// Stay at the touchdown point.
    Stay(Stay),
    /// Strokes with a force and a speed each, and lifts between them.
    Strokes(Strokes),
    /// A polygon with holes, filled with strokes.
    Region(Region),
}

/// Back and forth in x, stepping in y. The paper's path: 0.02 m/s, 10 s (0.2 m) per axis, with
/// pauses between.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Raster {
    /// Length of a line along x, m.
    pub length_m: f64,
    /// Step along y between lines, m; negative steps the other way.
    pub step_m: f64,
    /// Number of lines along x.
    #[serde(default = "two")]
    pub lines: u32,
    /// Speed, m/s.
    pub speed_m_per_s: f64,
    /// Pause at every corner, s.
    #[serde(default)]
    pub pause_s: f64,
    /// Repeat the whole pattern backwards until this time, s; 0 runs it once.
    #[serde(default)]
    pub duration_s: f64,
}

/// A circle through the start, its centre along +x from there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Radius, m.
    pub radius_m: f64,
    /// Number of turns; negative is clockwise seen from outside.
    #[serde(default = "one")]
    pub turns: f64,
    /// Speed, m/s.
    pub speed_m_per_s: f64,
}

/// A straight line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// End point relative to the start, m.
    pub to_m: [f64; 2],
    /// Speed, m/s.
    pub speed_m_per_s: f64,
    /// Number of strokes; after an even number the path ends at its start.
    #[serde(default = "one_stroke")]
    pub strokes: u32,
    /// Pause between strokes, s.
    #[serde(default)]
    pub pause_s: f64,
}

/// Straight lines through points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoints {
    /// Points relative to the start, m.
    pub points_m: Vec<[f64; 2]>,
    /// Speed, m/s.
    pub speed_m_per_s: f64,
    /// Pause at every point, s.
    #[serde(default)]
    pub pause_s: f64,
}

/// Loops: `x = r sin(w t)`, `y = r (cos(w t) - 1) - v t`. The paper's wiping policy has r = 0.04 m,
/// w = 2 rad/s, v = 0.005 m/s.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loops {
    /// `r`, m.
    pub radius_m: f64,
    /// `w`, rad/s; negative turns in the other direction.
    pub turn_rate_rad_per_s: f64,
    /// `v`, m/s, against y.
    pub advance_m_per_s: f64,
    /// Range of `t`, s; the times of acceleration and deceleration are added.
    pub duration_s: f64,
}

/// Stands still under force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stay {
    /// Duration, s.
    pub duration_s: f64,
}

fn two() -> u32 {
    2
}

fn one() -> f64 {
    1.0
}

fn one_stroke() -> u32 {
    1
}

impl PathSpec {
    /// Checks that every number is in its range.
    pub fn check(&self) -> Result<(), ControlError> {
        let speed = |v| check_range("path.speed_m_per_s", v, SPEED_M_PER_S.0, SPEED_M_PER_S.1);
        let pause = |v| check_range("path.pause_s", v, PAUSE_S.0, PAUSE_S.1);
        match self {
            Self::Raster(r) => {
                check_range("path.length_m", r.length_m, 0.001, REACH_M)?;
                check_range("path.step_m", r.step_m, -REACH_M, REACH_M)?;
                check_range("path.lines", f64::from(r.lines), 1.0, 1000.0)?;
                check_range("path.duration_s", r.duration_s, 0.0, 86_400.0)?;
                pause(r.pause_s)?;
                speed(r.speed_m_per_s)
            }
            Self::Circle(c) => {
                check_range("path.radius_m", c.radius_m, 0.001, REACH_M)?;
                check_range("path.turns", c.turns, -1000.0, 1000.0)?;
                if c.turns == 0.0 {
                    return Err(ControlError::range("path.turns", 0.0, "anything but zero"));
                }
                speed(c.speed_m_per_s)
            }
            Self::Line(l) => {
                check_point("path.to_m", &l.to_m)?;
                check_range("path.strokes", f64::from(l.strokes), 1.0, 10_000.0)?;
                pause(l.pause_s)?;
                speed(l.speed_m_per_s)
            }
            Self::Waypoints(w) => {
                if w.points_m.is_empty() || w.points_m.len() > 100_000 {
                    return Err(ControlError::range(
                        "path.points_m",
                        format!("{} points", w.points_m.len()),
                        "1 to 100000 points",
                    ));
                }
                for point in &w.points_m {
                    check_point("path.points_m", point)?;
                }
                pause(w.pause_s)?;
                speed(w.speed_m_per_s)
            }
            Self::Loops(l) => {
                check_range("path.radius_m", l.radius_m, 0.001, REACH_M)?;
                check_range(
                    "path.turn_rate_rad_per_s",
                    l.turn_rate_rad_per_s,
                    -20.0,
                    20.0,
                )?;
                check_range(
                    "path.advance_m_per_s",
                    l.advance_m_per_s,
                    -SPEED_M_PER_S.1,
                    SPEED_M_PER_S.1,
                )?;
                check_range("path.duration_s", l.duration_s, 0.1, 86_400.0)?;
                check_range(
                    "path: r w + v, m/s",
                    l.speed(),
                    SPEED_M_PER_S.0,
                    SPEED_M_PER_S.1,
                )
            }
            Self::Stay(s) => check_range("path.duration_s", s.duration_s, 0.0, 86_400.0),
            Self::Strokes(s) => s.check(),
            Self::Region(r) => r.check(),
        }
    }

    /// Expected shape of the surface. With it, points of the path are places over its plane.
    pub fn expected_surface(&self) -> Option<&ExpectedSurface> {
        match self {
            Self::Strokes(s) => s.surface.as_ref(),
            _ => None,
        }
    }

    /// Specified speed, m/s: the highest one if strokes have speeds of their own.
    pub fn speed_m_per_s(&self) -> f64 {
        match self {
            Self::Raster(r) => r.speed_m_per_s,
            Self::Circle(c) => c.speed_m_per_s,
            Self::Line(l) => l.speed_m_per_s,
            Self::Waypoints(w) => w.speed_m_per_s,
            Self::Loops(l) => l.speed(),
            Self::Stay(_) => SPEED_M_PER_S.0,
            Self::Strokes(s) => s.speed_max_m_per_s(),
            Self::Region(r) => r.speed_m_per_s,
        }
    }
}

impl Loops {
    /// Maximum speed, m/s.
    pub(super) fn speed(&self) -> f64 {
        self.radius_m * self.turn_rate_rad_per_s.abs() + self.advance_m_per_s.abs()
    }
}
