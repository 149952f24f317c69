//! State that persists after the controller ends: whether the tool may touch something, the
//! direction away from it, and what tasks learnt.
//!
//! The request handler writes it before a task starts, a side thread stores the loop's updates, and
//! the next controller starts with it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_control::Clearance;
use tangent_runtime::clock::now_ns;
use tangent_runtime::{StateError, StateFolder, Stop};

use crate::lessons::Lessons;
use crate::mailbox::Mailbox;

/// Name of the file.
const FILE: &str = "controller";
/// Interval between two checks for updates from the loop: the position of a sliding tool is then
/// stored every few millimetres.
const PERIOD: Duration = Duration::from_millis(100);

/// Content of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    /// Whether the tool may touch something.
    contact_possible: bool,
    /// Time of the entry, ns since the Unix epoch on this host; for people.
    since_ns: i64,
    /// Direction away from the surface (unit, base axes), and position of the tool (base axes, m).
    /// `None`: not known.
    way_out: Option<([f64; 3], [f64; 3])>,
}

impl Kept {
    fn of(clearance: &Clearance, since_ns: i64) -> Self {
        Self {
            contact_possible: !clearance.is_free(),
            since_ns,
            way_out: match clearance {
                Clearance::Possible { normal, position } => {
                    Some(((*normal).into(), (*position).into()))
                }
                Clearance::Assumed | Clearance::Free | Clearance::Unknown => None,
            },
        }
    }

    fn clearance(&self) -> Clearance {
        let Some((normal, position)) = self.way_out.filter(|_| self.contact_possible) else {
            return if self.contact_possible {
                Clearance::Unknown
            } else {
                Clearance::Assumed
            };
        };
        let normal = Vector3::from(normal);
        let unit = (normal.norm() - 1.0).abs() < 1e-6;
        if unit && position.iter().all(|x| x.is_finite()) {
            Clearance::Possible {
                normal,
                position: position.into(),
            }
        } else {
            Clearance::Unknown
        }
    }
}

/// The file and its content.
pub struct Memory {
    folder: Option<StateFolder>,
    known: Mutex<Known>,
    lessons: Arc<Lessons>,
}

struct Known {
    clearance: Clearance,
    since_ns: i64,
    /// Whether a write failed; reported only the first time.
    failed: bool,
}

impl Memory {
    /// Reads the state of the previous controller. A file that cannot be read counts as possible
    /// contact, and is reported.
    pub fn open(folder: Option<StateFolder>) -> Self {
        let read = folder
            .as_ref()
            .map_or(Ok(None), |folder| folder.read::<Kept>(FILE));
        let (clearance, since_ns) = match read {
            Ok(None) => (Clearance::Assumed, now_ns()),
            Ok(Some(kept)) => (kept.clearance(), kept.since_ns),
            Err(error) => {
                tracing::warn!("{error}: the tool is assumed to touch something");
                (Clearance::Unknown, now_ns())
            }
        };
        if !clearance.is_free() {
            tracing::warn!(
                "the last task did not end in free space: the next one moves off first, if the tool is still where it was"
            );
        }
        Self {
            lessons: Arc::new(Lessons::new(folder.clone())),
            folder,
            known: Mutex::new(Known {
                clearance,
                since_ns,
                failed: false,
            }),
        }
    }

    /// What tasks learnt.
    pub fn lessons(&self) -> &Arc<Lessons> {
        &self.lessons
    }

    /// The stored clearance.
    pub fn known(&self) -> Clearance {
        self.lock().clearance
    }

    /// Stores before a task starts that the tool may touch something. An earlier stored doubt
    /// stays.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn expect_contact(
        &self,
        normal: Vector3<f64>,
        position: Vector3<f64>,
    ) -> Result<(), StateError> {
        let mut known = self.lock();
        if !known.clearance.is_free() {
            return Ok(());
        }
        self.write(&mut known, Clearance::Possible { normal, position })
    }

    /// Stores `clearance` after a start was refused, or after a person's confirmation.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn set(&self, clearance: Clearance) -> Result<(), StateError> {
        let mut known = self.lock();
        if known.clearance == clearance {
            return Ok(());
        }
        self.write(&mut known, clearance)
    }

    /// Stores the loop's updates until `stop`, and once more after it.
    pub fn follow<P>(&self, mailbox: &Mailbox<P>, stop: &Stop) {
        loop {
            let stopped = stop.wait(PERIOD);
            self.take(mailbox);
            if stopped {
                return;
            }
        }
    }

    /// Stores the newest update from the loop.
    pub fn take<P>(&self, mailbox: &Mailbox<P>) {
        self.lessons.take(mailbox);
        let Some(clearance) = mailbox.clearance.pop() else {
            return;
        };
        let mut known = self.lock();
        if known.clearance == clearance {
            return;
        }
        let failed = known.failed;
        let written = self.write(&mut known, clearance);
        known.failed = written.is_err();
        if let (Err(error), false) = (written, failed) {
            tracing::warn!(
                "that the tool may touch something is not stored for a restart: {error}"
            );
        }
    }

    fn write(&self, known: &mut Known, clearance: Clearance) -> Result<(), StateError> {
        if known.clearance.is_free() != clearance.is_free() {
            known.since_ns = now_ns();
        }
        known.clearance = clearance;
        let kept = Kept::of(&clearance, known.since_ns);
        self.folder
            .as_ref()
            .map_or(Ok(()), |folder| folder.write(FILE, &kept))
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_contact_is_kept_across_restarts_and_a_damaged_file_means_contact() {
        let folder = tempfile::tempdir().unwrap();
        let state = || Some(StateFolder::new(folder.path()));
        let memory = Memory::open(state());
        assert_eq!(memory.known(), Clearance::Assumed);
        let possible = Clearance::Possible {
            normal: Vector3::z(),
            position: Vector3::new(0.4, -0.1, 0.2),
        };
        memory
            .expect_contact(Vector3::z(), Vector3::new(0.4, -0.1, 0.2))
            .unwrap();
        assert_eq!(Memory::open(state()).known(), possible);
        // In doubt, the older direction is the better one.
        memory
            .expect_contact(Vector3::x(), Vector3::zeros())
            .unwrap();
        assert_eq!(Memory::open(state()).known(), possible);
        memory.set(Clearance::Free).unwrap();
        assert_eq!(Memory::open(state()).known(), Clearance::Assumed);
        for text in ["{\"contact_possible\":", "", "{}"] {
            std::fs::write(folder.path().join("controller.json"), text).unwrap();
            assert_eq!(Memory::open(state()).known(), Clearance::Unknown);
        }
        let bent = "{\"contact_possible\": true, \"since_ns\": 0, \"way_out\": [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]}";
        std::fs::write(folder.path().join("controller.json"), bent).unwrap();
        assert_eq!(Memory::open(state()).known(), Clearance::Unknown);
    }
}
