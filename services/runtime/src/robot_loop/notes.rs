//! Log lines of a robot loop, which another thread writes.

use std::convert::Infallible;
use std::fmt;

use tangent_schemas::Text;

use crate::ring::Ring;

/// Lines that may wait to be written. When there are more, the oldest is dropped.
const NOTES_MAX: usize = 64;

/// One log line. `V` is the type of messages that only one vendor's robot sends.
#[derive(Clone, Copy, Debug)]
pub enum Note<V = Infallible> {
    /// A message of the robot.
    Robot(V),
    /// Information.
    Info(Text),
    /// Why the arm is not ready.
    NotReady(Text),
    /// A source of commands was refused, or its motion was ended.
    Refused(Text),
}

/// Queue of log lines: the loop pushes, another thread writes.
#[derive(Debug)]
pub struct Notes<V = Infallible>(Ring<Note<V>>);

impl<V> Default for Notes<V> {
    fn default() -> Self {
        Self(Ring::new(NOTES_MAX))
    }
}

impl<V: fmt::Display> Notes<V> {
    /// Adds a line. Takes no lock, allocates nothing and never waits.
    pub fn push(&self, note: Note<V>) {
        self.0.force_push(note, drop);
    }

    /// Writes all lines to the log.
    pub fn write(&self) {
        while let Some(note) = self.0.pop() {
            match note {
                Note::Robot(text) => tracing::info!("{text}"),
                Note::Info(text) => tracing::info!("{text}"),
                Note::NotReady(text) => tracing::warn!("not ready: {text}"),
                Note::Refused(text) => tracing::warn!("{text}"),
            }
        }
    }
}
