//! A lesson with the arm that it is shown with.

use tangent_runtime::Bus;

use crate::arm_reader::ArmReader;
use crate::error::TeachError;
use crate::lesson::{Key, Lesson, Pressed, Shown};

/// What was shown so far, and where the arm stands.
pub struct ArmLesson {
    arm: ArmReader,
    lesson: Lesson,
}

impl ArmLesson {
    /// Waits for the first state of the arm.
    ///
    /// # Errors
    /// None arrives.
    pub fn open(bus: &Bus) -> Result<Self, TeachError> {
        Ok(Self {
            arm: ArmReader::open(bus)?,
            lesson: Lesson::default(),
        })
    }

    /// Takes in how the arm has moved. To be called more often than its states fill the queue:
    /// several times a second.
    pub fn look(&mut self) {
        let lesson = &mut self.lesson;
        self.arm.drain(|shown| lesson.sample(shown));
    }

    /// Handles a key, with the arm where it is now.
    ///
    /// # Errors
    /// Where the arm stands is not known: nothing was taken.
    pub fn press(&mut self, key: Key) -> Result<Pressed, TeachError> {
        self.look();
        if key == Key::Quit {
            return Ok(Pressed::Quit);
        }
        let now = self.arm.now()?;
        Ok(self.lesson.press(key, now))
    }

    /// Where the arm stands now.
    ///
    /// # Errors
    /// The bridge publishes nothing, or no usable pose.
    pub fn now(&self) -> Result<&Shown, TeachError> {
        self.arm.now()
    }

    /// What was shown so far.
    pub fn lesson(&self) -> &Lesson {
        &self.lesson
    }
}
