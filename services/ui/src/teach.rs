//! Teaching from a page: what a person shows with the arm by hand becomes a task file in the folder
//! of the tasks.

use std::sync::Arc;
use std::time::Instant;

use serde_json::{Value, json};
use tangent_mechanics::{Base, Pose, World};
use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::clock;

use crate::commands::Who;
use crate::lock;
use crate::shared::Shared;
use crate::snapshot::round;
use crate::tasks::{self, SaveError};
use crate::teacher::{TaskWish, TaughtMark, TaughtTask, TeachStep, Teacher};

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
