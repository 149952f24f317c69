//! What teaching from the page asks of the program that runs it.

use serde::{Deserialize, Serialize};

/// What the program that runs the page does for teaching. All calls block for some seconds at most.
pub trait Teacher: Send + Sync {
    /// Carries out a step of `who`, and returns what happened, in words.
    ///
    /// # Errors
    /// Why nothing happened, in words.
    fn step(&self, who: &str, step: TeachStep) -> Result<String, String>;
    /// The task file of what `who` has shown.
    ///
    /// # Errors
    /// Why there is none, in words.
    fn draft(&self, who: &str, wish: &TaskWish) -> Result<TaughtTask, String>;
    /// What is being taught, if anything.
    fn state(&self) -> Option<TeachState>;
    /// What was shown so far, base axes.
    fn marks(&self) -> Vec<TaughtMark>;
}

/// A step of teaching.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TeachStep {
    /// Makes the arm free, and begins or goes on.
    Begin,
    /// Begins or goes on, with an arm that is moved by its own means.
    BeginHeld,
    /// The person is still there.
    Keep,
    /// The arm holds itself; what was shown stays.
    Hold,
    /// Takes the place where the tool is.
    Point,
    /// Begins or ends a stroke.
    Stroke,
    /// Takes this pose as home.
    Home,
    /// Forgets what was taken last.
    Undo,
    /// Forgets everything; the arm holds itself.
    Discard,
}

impl TeachStep {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Begin => "begin",
            Self::BeginHeld => "begin_held",
            Self::Keep => "keep",
            Self::Hold => "hold",
            Self::Point => "point",
            Self::Stroke => "stroke",
            Self::Home => "home",
            Self::Undo => "undo",
            Self::Discard => "discard",
        }
    }
}

/// Shape of the path through what was shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaughtShape {
    /// Through the points and along the strokes.
    #[default]
    Open,
    /// Along an outline, back to the first point.
    Outline,
    /// The region inside the outline.
    Region,
}

/// The task file that a person wants.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskWish {
    /// Name of the task, and of its file without `.toml`.
    pub name: String,
    /// Shape of the path.
    #[serde(default)]
    pub shape: TaughtShape,
    /// Distance between the rows of a region, m.
    #[serde(default)]
    pub spacing_m: f64,
    /// Pressing force, N.
    pub force_n: f64,
    /// Speed along the path, m/s.
    pub speed_m_per_s: f64,
    /// Height of the start pose above the first place, m.
    pub clearance_m: f64,
    /// Largest distance of a stroke from the path that is made of it, m.
    pub tolerance_m: f64,
    /// Whether a file of this name is replaced.
    #[serde(default)]
    pub replace: bool,
}

/// A task file from what was shown.
#[derive(Clone, Debug, PartialEq)]
pub struct TaughtTask {
    /// Its text.
    pub text: String,
    /// Number of places of the path.
    pub places: usize,
    /// Length of the path, m.
    pub length_m: f64,
    /// What the person should know.
    pub notes: Vec<String>,
}

/// State of what is being taught.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TeachState {
    /// Who teaches.
    pub who: String,
    /// Whether a hand can guide the arm.
    pub free: bool,
    /// Why it cannot any more; empty without a reason.
    pub held_because: String,
    /// Number of points.
    pub points: usize,
    /// Number of finished strokes.
    pub strokes: usize,
    /// Whether a stroke is being taken.
    pub stroking: bool,
    /// Whether a home was taken.
    pub home: bool,
    /// Counts changes of what was shown.
    pub revision: u64,
}

/// A part of what was shown.
#[derive(Clone, Debug, PartialEq)]
pub struct TaughtMark {
    /// `point`, `stroke` or `home`.
    pub kind: &'static str,
    /// Places of the tool, base axes, m.
    pub places_m: Vec<[f64; 3]>,
}
