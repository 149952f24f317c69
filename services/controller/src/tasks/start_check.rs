//! Checks a task before it is started: numbers, workspace and reach from the arm's present
//! position, and the names of its estimators. Called when a task is prepared, in the requester's
//! thread.

use std::sync::mpsc::sync_channel;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use tangent_control::preflight::{Preflight, words};
use tangent_control::{Limits, Path, Task};
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_estimation::estimator_names;
use tangent_estimation::object_pose::OBJECT_ESTIMATORS;
use tangent_mechanics::names::nearest;
use tangent_mechanics::{Arm, Flange, Pose, Tool};
use tangent_runtime::{Bus, BusError, Latest, Received};
use tangent_schemas::Message;
use tangent_schemas::convert::joints;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics::{self, Topic};

use crate::error::TaskRefusal;
use crate::requests::{FIRST_ESTIMATE, FRESH};

/// Cell-specific data of the check.
pub struct StartCheck<const N: usize> {
    arm: Arm<N>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    /// Estimators that the cell file names.
    own_estimators: Vec<String>,
    /// Whether the law moves the arm to a task's start pose.
    travels: bool,
    seen: Mutex<Latest<ArmState>>,
}

impl<const N: usize> StartCheck<N> {
    /// Check for the cell's arm; `own_estimators` are known in addition to the built-in ones.
    /// `travels`: the law moves the arm to a task's start pose.
    ///
    /// # Errors
    /// `arm/state` cannot be read.
    pub fn new(
        bus: &Bus,
        arm: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        own_estimators: Vec<String>,
        travels: bool,
    ) -> Result<Self, BusError> {
        Ok(Self {
            arm,
            flange_from_tool,
            limits,
            own_estimators,
            travels,
            seen: Mutex::new(bus.latest(&topics::ARM_STATE)?),
        })
    }

    /// Task that only moves a tool off a surface that it may touch.
    pub fn leave(&self) -> Task {
        Task::leave(self.limits.force_max_n)
    }

    /// Checks the task's numbers, and its path from the arm's present position. Without a state of
    /// the arm only the numbers are checked: the start is then refused because the arm is missing.
    ///
    /// # Errors
    /// All reasons found, as text with numbers and places.
    pub fn task(&self, task: &Task, path: &Path) -> Result<(), TaskRefusal> {
        let standing = self
            .seen
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .fresh(FRESH)
            .and_then(|arm| joints::<N>(&arm.message.q).ok());
        let refusals = Preflight {
            task,
            path,
            limits: &self.limits,
            arm: &self.arm,
            flange_from_tool: &self.flange_from_tool,
            travels: self.travels,
        }
        .refusals(standing.as_ref());
        words(&refusals).map_or(Ok(()), |words| Err(TaskRefusal::Preflight(words)))
    }

    /// Checks that every estimator that the task names is built in, named in the cell file, or
    /// publishes on `topic` now. All other names are subscribed to together, for
    /// [`FIRST_ESTIMATE`].
    ///
    /// # Errors
    /// All unknown names, each with the nearest known name.
    pub fn estimators<M: Message>(
        &self,
        bus: &Bus,
        names: &[String],
        topic: impl Fn(&str) -> Topic<M>,
    ) -> Result<(), TaskRefusal> {
        let known = known_estimators(&self.own_estimators);
        let strange: Vec<&str> = names
            .iter()
            .map(String::as_str)
            .filter(|name| !known.contains(name))
            .collect();
        let silent = silent(bus, &strange, topic)?;
        unknown_estimators(&silent, &known)
            .map_or(Ok(()), |names| Err(TaskRefusal::UnknownEstimators(names)))
    }
}

/// Names of all built-in estimators and of those in the cell file.
pub fn known_estimators(own: &[String]) -> Vec<&str> {
    let built_in = [&estimator_names()[..], &OBJECT_ESTIMATORS, &[DEPTH_NORMAL]].concat();
    let own = own.iter().map(String::as_str);
    let more: Vec<&str> = own.filter(|name| !built_in.contains(name)).collect();
    [built_in, more].concat()
}

/// The error that lists all unknown names; `None` if every name is known.
pub fn unknown_estimators(names: &[&str], known: &[&str]) -> Option<String> {
    if names.is_empty() {
        return None;
    }
    let each: Vec<String> = names
        .iter()
        .map(|name| match nearest(name, known.iter().copied()) {
            Some(near) => format!("\"{name}\" (did you mean \"{near}\"?)"),
            None => format!("\"{name}\""),
        })
        .collect();
    Some(format!(
        "`estimators`: no estimator is called {}, and none publishes under such a name; there are: {}",
        each.join(", "),
        known.join(", ")
    ))
}

/// Those of `names` on whose topic no message arrives within [`FIRST_ESTIMATE`].
fn silent<'a, M: Message>(
    bus: &Bus,
    names: &[&'a str],
    topic: impl Fn(&str) -> Topic<M>,
) -> Result<Vec<&'a str>, TaskRefusal> {
    let (heard, who) = sync_channel(names.len());
    let mut readers = Vec::new();
    for (index, name) in names.iter().enumerate() {
        let heard = heard.clone();
        let reader = bus.on(&topic(name), move |_: &Received<M>| {
            // If the channel is full, it already holds enough.
            let _ = heard.try_send(index);
        });
        readers.push(reader?);
    }
    let until = Instant::now() + FIRST_ESTIMATE;
    let mut speaks = vec![false; names.len()];
    while !speaks.iter().all(|s| *s) {
        let left = until.saturating_duration_since(Instant::now());
        let Ok(index) = who.recv_timeout(left) else {
            break;
        };
        speaks[index] = true;
    }
    let quiet = names.iter().zip(&speaks).filter(|(_, speaks)| !**speaks);
    Ok(quiet.map(|(name, _)| *name).collect())
}
