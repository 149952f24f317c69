//! What outlasts the service: the controller's last word on contact, and the sensor's last good zero.
//!
//! The tare's desk asks it for signs of contact, a side thread writes it down, and the receiving thread begins with its zero.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tangent_control::{ContactSign, ControllerWord, Phase};
use tangent_mechanics::Wrench;
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Bus, BusError, Latest, StateFolder, Stop};
use tangent_schemas::tangent::ControlState;
use tangent_schemas::topics;
use tangent_sensing::Tare;

/// Name of the file.
const FILE: &str = "netft";
/// A controller that says nothing for so long is silent.
const FRESH: Duration = Duration::from_millis(500);
/// Between two looks at what is to be written down.
const PERIOD: Duration = Duration::from_millis(100);
/// Zeros that wait to be written down.
const ZEROS: usize = 4;

/// As it stands in the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    /// The last good zero.
    zero: Option<KeptZero>,
    /// What the controller said last.
    controller: Option<KeptWord>,
}

/// A zero with the sensor that it belongs to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct KeptZero {
    /// As the box tells it.
    serial: String,
    /// N and Nm, sensor axes.
    bias: [f64; 6],
    /// Scatter of the readings that it is the mean of.
    std: [f64; 6],
    samples: u32,
    /// When it was taken, ns since the Unix epoch on this host.
    taken_ns: i64,
    /// On a person's word that the tool hung free.
    said_clear: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeptWord {
    /// Code of `ControlState.phase`.
    phase: u8,
    contact_possible: bool,
}

impl KeptWord {
    fn word(self) -> Option<ControllerWord> {
        Some(ControllerWord {
            phase: Phase::from_code(self.phase)?,
            contact_possible: self.contact_possible,
        })
    }
}

/// The file, and what stands in it.
pub(crate) struct Memory {
    folder: Option<StateFolder>,
    inner: Mutex<Inner>,
    zeros: Mutex<Receiver<Option<KeptZero>>>,
}

struct Inner {
    control: Latest<ControlState>,
    kept: Kept,
    failed: bool,
}

/// For the receiving thread, which does not wait for the disk.
pub(crate) struct ZeroNotes(SyncSender<Option<KeptZero>>);

impl ZeroNotes {
    /// This zero is the last good one from now on.
    pub(crate) fn keep(&self, serial: &str, tare: &Tare, age_s: f64) {
        // The side thread takes them ten times a second: there is room.
        let _ = self.0.try_send(Some(KeptZero {
            serial: serial.to_owned(),
            bias: tare.bias.vector().into(),
            std: tare.std.vector().into(),
            samples: tare.samples,
            taken_ns: now_ns() - (age_s * 1e9) as i64,
            said_clear: tare.said_clear,
        }));
    }

    /// There is no good zero any more.
    pub(crate) fn forget(&self) {
        let _ = self.0.try_send(None);
    }
}

impl KeptZero {
    /// On the clock of [`tangent_sensing::Reading::time_s`], which says `now_s` now; none of another sensor, or older than
    /// `age_max_s`.
    pub(crate) fn tare(&self, serial: &str, now_s: f64, age_max_s: f64) -> Option<Tare> {
        let age_s = (now_ns() - self.taken_ns) as f64 * 1e-9;
        let finite = self.bias.iter().chain(&self.std).all(|x| x.is_finite());
        (self.serial == serial && finite && (0.0..=age_max_s).contains(&age_s)).then(|| Tare {
            bias: Wrench::from_vector(&self.bias.into()),
            std: Wrench::from_vector(&self.std.into()),
            samples: self.samples,
            time_s: now_s - age_s,
            said_clear: self.said_clear,
        })
    }
}

impl Memory {
    /// Reads what the service before knew. A file that cannot be read is said, and counts as a controller that pressed.
    pub(crate) fn open(
        bus: &Bus,
        folder: Option<StateFolder>,
    ) -> Result<(Self, ZeroNotes), BusError> {
        let read = folder
            .as_ref()
            .map_or(Ok(None), |folder| folder.read::<Kept>(FILE));
        let kept = match read {
            Ok(kept) => kept.unwrap_or_default(),
            Err(error) => {
                tracing::warn!(
                    "{error}: until the controller says otherwise, the tool may touch something"
                );
                Kept {
                    zero: None,
                    controller: Some(KeptWord {
                        phase: Phase::Fault as u8,
                        contact_possible: true,
                    }),
                }
            }
        };
        let (sender, receiver) = sync_channel(ZEROS);
        let memory = Self {
            folder,
            inner: Mutex::new(Inner {
                control: bus.latest(&topics::CONTROL_STATE)?,
                kept,
                failed: false,
            }),
            zeros: Mutex::new(receiver),
        };
        Ok((memory, ZeroNotes(sender)))
    }

    /// The last good zero that was written down.
    pub(crate) fn zero(&self) -> Option<KeptZero> {
        self.lock().kept.zero.clone()
    }

    /// What the controller's word says against a tare, now.
    pub(crate) fn contact_sign(&self) -> Option<ContactSign> {
        let mut inner = self.lock();
        let now = inner.listen();
        let last = inner.kept.controller.and_then(KeptWord::word);
        ContactSign::of(now.and_then(KeptWord::word), last)
    }

    /// Writes down what changes, until `stop`.
    pub(crate) fn follow(&self, stop: &Stop) {
        let mut written = self.lock().kept.clone();
        loop {
            let stopped = stop.wait(PERIOD);
            let kept = self.gather();
            // What stands and what moves: the phases in between say no more.
            let word = |kept: &Kept| {
                let word = kept.controller?.word()?;
                Some(ContactSign::of(Some(word), None).is_some())
            };
            if kept.zero != written.zero || word(&kept) != word(&written) {
                self.write(&kept);
                written = kept;
            }
            if stopped {
                return;
            }
        }
    }

    fn gather(&self) -> Kept {
        let zeros = self.zeros.lock().unwrap_or_else(PoisonError::into_inner);
        let mut inner = self.lock();
        while let Ok(zero) = zeros.try_recv() {
            inner.kept.zero = zero;
        }
        inner.listen();
        inner.kept.clone()
    }

    fn write(&self, kept: &Kept) {
        let Some(folder) = &self.folder else {
            return;
        };
        let written = folder.write(FILE, kept);
        let before = std::mem::replace(&mut self.lock().failed, written.is_err());
        if let (Err(error), false) = (written, before) {
            tracing::warn!("a restart would not know the last good zero: {error}");
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// The controller's word, if it speaks.
    fn listen(&mut self) -> Option<KeptWord> {
        let heard = self.control.fresh(FRESH)?;
        let word = KeptWord {
            phase: heard.message.phase,
            contact_possible: heard.message.contact_possible,
        };
        self.kept.controller = Some(word);
        Some(word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SERIAL: &str = "FT12345";

    fn zero(taken_ns: i64) -> KeptZero {
        KeptZero {
            serial: SERIAL.to_owned(),
            bias: [1.0, -2.0, 3.0, 0.1, 0.2, 0.3],
            std: [0.01; 6],
            samples: 500,
            taken_ns,
            said_clear: false,
        }
    }

    #[test]
    fn a_zero_is_taken_over_with_its_age_and_never_by_another_sensor() {
        let kept = zero(now_ns() - 90_000_000_000);
        let tare = kept.tare(SERIAL, 10.0, 3600.0).unwrap();
        assert!((tare.time_s - (10.0 - 90.0)).abs() < 1.0);
        assert_eq!(tare.bias.force.z, 3.0);
        assert!(kept.tare("FT99999", 10.0, 3600.0).is_none());
        assert!(kept.tare(SERIAL, 10.0, 60.0).is_none());
    }

    #[test]
    fn the_controllers_last_word_outlasts_the_service() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let bus = Bus::in_process("test");
        let open = || Memory::open(&bus, Some(state.clone())).unwrap().0;
        assert_eq!(open().contact_sign(), None);
        state
            .write(
                FILE,
                &Kept {
                    zero: Some(zero(0)),
                    controller: Some(KeptWord {
                        phase: Phase::Slide as u8,
                        contact_possible: true,
                    }),
                },
            )
            .unwrap();
        let memory = open();
        assert_eq!(memory.zero(), Some(zero(0)));
        let silent = ContactSign::Remembered(Phase::Slide);
        assert_eq!(memory.contact_sign(), Some(silent));
        // A controller that speaks knows better.
        let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
        control.publish(&ControlState {
            phase: Phase::Done as u8,
            ..ControlState::default()
        });
        assert_eq!(memory.contact_sign(), None);
        std::fs::write(folder.path().join("netft.json"), "{").unwrap();
        let torn = ContactSign::Remembered(Phase::Fault);
        assert_eq!(open().contact_sign(), Some(torn));
    }
}
