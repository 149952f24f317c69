//! Teaching from a page: what a person shows with the arm by hand becomes a task file in the folder
//! of the tasks.

use std::sync::Arc;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tangent_mechanics::{Base, Pose, World};
use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::clock;

use crate::commands::Who;
use crate::lock;
use crate::server::Shared;
use crate::snapshot::round;
use crate::tasks::{self, SaveError};

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
    fn name(self) -> &'static str {
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

/// Carries a step out, and records it unless it is a sign of life. Blocks.
pub(crate) fn step(
    shared: &Shared,
    teacher: &Arc<dyn Teacher>,
    who: &Who,
    step: TeachStep,
) -> Value {
    let began = (clock::now_ns(), Instant::now());
    let happened = teacher.step(&who.name, step);
    let answer = match &happened {
        Ok(words) => done(words.clone()),
        Err(why) => refused(why.clone()),
    };
    if step != TeachStep::Keep {
        shared
            .desk
            .record(who, ("teach", step.name()), &answer, began);
    }
    json!({ "done": answer.done, "message": answer.message })
}

/// Writes the task file of what this person has shown, and ends the lesson. Blocks.
pub(crate) fn save(
    shared: &Shared,
    teacher: &Arc<dyn Teacher>,
    who: &Who,
    wish: &TaskWish,
) -> Value {
    let began = (clock::now_ns(), Instant::now());
    let file = format!("{}.toml", wish.name);
    let (answer, more) = match saved(shared, teacher, who, wish, &file) {
        Ok(task) => {
            let words = format!(
                "{file}: {} places, {:.0} mm",
                task.places,
                task.length_m * 1e3
            );
            (done(words), json!({ "file": file, "notes": task.notes }))
        }
        Err(error) => {
            let exists = matches!(error, SaveError::Exists(_));
            (refused(error.to_string()), json!({ "exists": exists }))
        }
    };
    tracing::info!("{file} by {}: {}", who.name, answer.message);
    let asked = ("teach", &*format!("save {file}"));
    shared.desk.record(who, asked, &answer, began);
    let mut value = json!({ "done": answer.done, "message": answer.message });
    if let (Value::Object(value), Value::Object(more)) = (&mut value, more) {
        value.extend(more);
    }
    value
}

fn saved(
    shared: &Shared,
    teacher: &Arc<dyn Teacher>,
    who: &Who,
    wish: &TaskWish,
    file: &str,
) -> Result<TaughtTask, SaveError> {
    let folder = shared.config.saved_tasks()?;
    tasks::may_save(folder, file, wish.replace)?;
    let draft = teacher.draft(&who.name, wish).map_err(SaveError::Draft)?;
    // The arm holds itself before anything else takes time.
    teacher
        .step(&who.name, TeachStep::Hold)
        .map_err(SaveError::Draft)?;
    tasks::save(folder, file, &draft.text, wish.replace)?;
    // It is written: nothing is left to be shown.
    let _ = teacher.step(&who.name, TeachStep::Discard);
    Ok(draft)
}

/// What was shown so far, world axes, mm: `revision, marks: [{kind, places_mm}]`.
pub(crate) fn marks(shared: &Shared, teacher: &Arc<dyn Teacher>) -> Value {
    let revision = teacher.state().map_or(0, |state| state.revision);
    let world_from_base = *lock(&shared.world_from_base);
    let marks = world_from_base.map(|pose| {
        let marks = teacher.marks().into_iter();
        marks.map(|mark| in_world(&mark, &pose)).collect::<Vec<_>>()
    });
    json!({ "revision": revision, "marks": marks.unwrap_or_default() })
}

fn in_world(mark: &TaughtMark, world_from_base: &Pose<World, Base>) -> Value {
    let place = |place: &[f64; 3]| {
        let place = world_from_base.transform_point(&(*place).into()) * 1e3;
        [place.x, place.y, place.z].map(|x| round(x, 10.0))
    };
    let places: Vec<_> = mark.places_m.iter().map(place).collect();
    json!({ "kind": mark.kind, "places_mm": places })
}
