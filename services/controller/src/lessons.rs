//! What tasks learn of a part: one file per part in the cell's state folder, `learnt-PART.json`.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tangent_control::{Memory, Program};
use tangent_runtime::StateFolder;

use crate::error::TaskRefusal;
use crate::mailbox::Mailbox;

/// The memories of all parts.
pub struct Lessons {
    folder: Option<StateFolder>,
    /// Memories of a service without a folder; they end with it.
    known: Mutex<BTreeMap<String, Memory>>,
}

impl Lessons {
    /// Memories in the cell's state folder.
    pub fn new(folder: Option<StateFolder>) -> Self {
        Self {
            folder,
            known: Mutex::default(),
        }
    }

    /// Gives the program what earlier passes over its part learnt. No effect on a task that does
    /// not learn.
    ///
    /// # Errors
    /// The memory cannot be read, or is of another path. The text says what to do.
    pub fn recall(&self, program: &mut Program) -> Result<(), TaskRefusal> {
        let Some(learning) = &program.task.learning else {
            return Ok(());
        };
        let part = learning.part.clone();
        let known = self.known();
        let memory = match &self.folder {
            Some(folder) => folder
                .read(&file(&part))
                .map_err(|error| TaskRefusal::Lessons(error.to_string()))?,
            None => known.get(&part).cloned(),
        };
        match memory {
            Some(memory) => program.remember(memory).map_err(|error| {
                TaskRefusal::Lessons(format!("part \"{part}\": {error}{}", self.place(&part)))
            }),
            None => Ok(()),
        }
    }

    /// Learns from the pass that has ended, if there is one, and stores the memory. Takes
    /// milliseconds, and waits for the disk.
    pub fn take<P>(&self, mailbox: &Mailbox<P>) {
        // Whoever recalls the part meanwhile waits for what it learnt.
        let mut known = self.known();
        let Some(pass) = mailbox.pass.pop() else {
            return;
        };
        let part = pass.learner.part().to_owned();
        if !pass.completed {
            tracing::info!("part {part}: nothing is learnt from a path that was not completed");
            return;
        }
        let memory = pass.finish();
        tracing::info!("part {part}: pass {} learnt", memory.passes());
        let Some(folder) = &self.folder else {
            known.insert(part, memory);
            return;
        };
        if let Err(error) = folder.write(&file(&part), &memory) {
            tracing::warn!("part {part}: what this pass learnt is lost: {error}");
        }
    }

    /// Where the memory of a part is, for a person who wants to delete it.
    fn place(&self, part: &str) -> String {
        self.folder.as_ref().map_or_else(String::new, |folder| {
            let file = folder.path().join(format!("{}.json", file(part)));
            format!(" ({})", file.display())
        })
    }

    fn known(&self) -> MutexGuard<'_, BTreeMap<String, Memory>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn file(part: &str) -> String {
    format!("learnt-{part}")
}

#[cfg(test)]
mod tests {
    use tangent_control::{ControllerConfig, EndedPass, Learner, LearningSpec};

    use super::*;

    const TASK: &str = "name = \"a\"\nforce.reference_n = 3.0\nlearning.part = \"lid\"\n\
                        path = { kind = \"line\", to_m = [0.02, 0.0], speed_m_per_s = 0.02 }";

    fn program(text: &str) -> Program {
        Program::new(&text.parse().unwrap(), &ControllerConfig::default()).unwrap()
    }

    fn pass(completed: bool) -> EndedPass {
        let memory = Memory::new(&program(TASK).path);
        EndedPass {
            learner: Box::new(Learner::new(LearningSpec::of("lid"), memory)),
            completed,
        }
    }

    #[test]
    fn a_part_is_kept_across_restarts_and_only_for_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("learnt-lid.json");
        let lessons = || Lessons::new(Some(StateFolder::new(folder.path())));
        let mailbox = Mailbox::<()>::default();
        lessons().recall(&mut program(TASK)).unwrap();

        let _ = mailbox.pass.push(pass(false));
        lessons().take(&mailbox);
        assert!(!file.exists());

        let _ = mailbox.pass.push(pass(true));
        lessons().take(&mailbox);
        assert!(file.exists() && mailbox.pass.is_empty());
        lessons().recall(&mut program(TASK)).unwrap();

        let longer = program(&TASK.replace("0.02, 0.0", "0.03, 0.0"));
        let error = lessons().recall(&mut { longer }).unwrap_err().to_string();
        assert!(
            error.contains("another path") && error.contains("learnt-lid.json"),
            "{error}"
        );
        std::fs::write(&file, "{\"version\": 7").unwrap();
        let error = lessons()
            .recall(&mut program(TASK))
            .unwrap_err()
            .to_string();
        assert!(error.contains("learnt-lid.json"), "{error}");
    }

    #[test]
    fn without_a_folder_a_part_is_known_until_the_service_ends() {
        let (lessons, mailbox) = (Lessons::new(None), Mailbox::<()>::default());
        let _ = mailbox.pass.push(pass(true));
        lessons.take(&mailbox);
        assert!(lessons.known().contains_key("lid"));
        lessons.recall(&mut program(TASK)).unwrap();
    }
}
