//! State that survives a restart of the service: the controller's last state of contact, and the
//! sensor's last good zero.
//!
//! The tare's request handler checks it for signs of contact, a side thread stores it, and the
//! service's loop starts with its zero.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tangent_control::{ContactSign, ControllerWord, Phase};
use tangent_mechanics::Wrench;
use tangent_runtime::clock::now_ns;
use tangent_runtime::ring::Ring;
use tangent_runtime::{Bus, BusError, Latest, Refused, StateFolder, Stop};
use tangent_schemas::convert::cut;
use tangent_schemas::tangent::ControlState;
use tangent_schemas::{Text, topics};
use tangent_sensing::{Tare, TareGround, ZeroPoint};

/// Time without messages after which the controller counts as silent.
const FRESH: Duration = Duration::from_millis(500);
/// Interval between two checks for changes to store.
const PERIOD: Duration = Duration::from_millis(100);
/// Number of zeros that may wait to be stored.
const ZEROS: usize = 4;

/// Contents of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    /// The last good zero.
    zero: Option<KeptZero>,
    /// The controller's last state.
    controller: Option<KeptWord>,
}

/// A zero with the sensor that it belongs to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct KeptZero {
    /// Serial number of the sensor, or another identity.
    serial: String,
    /// Zero, N and Nm, sensor axes.
    bias: [f64; 6],
    /// Standard deviation of the averaged readings.
    std: [f64; 6],
    samples: u32,
    /// Time of the tare, ns since the Unix epoch on this host.
    taken_ns: i64,
    /// Evidence that nothing pressed during the tare.
    ground: TareGround,
    /// As in [`Tare::vouched`] and [`Tare::shown`].
    vouched: KeptPoint,
    shown: KeptPoint,
}

/// A zero, N and Nm, sensor axes, and its time, ns since the Unix epoch on this host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeptPoint {
    bias: [f64; 6],
    taken_ns: i64,
}

impl KeptPoint {
    /// `taken_ns` is the time of the tare; both times in the tare are on one clock.
    fn of(point: &ZeroPoint, tare: &Tare, taken_ns: i64) -> Self {
        Self {
            bias: point.bias.vector().into(),
            taken_ns: taken_ns - ((tare.time_s - point.time_s) * 1e9) as i64,
        }
    }

    fn point(&self, zero: &KeptZero, time_s: f64) -> ZeroPoint {
        ZeroPoint {
            bias: Wrench::from_vector(&self.bias.into()),
            time_s: time_s - (zero.taken_ns - self.taken_ns) as f64 * 1e-9,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeptWord {
    /// Code of `ControlState.phase`.
    phase: u8,
    contact_possible: bool,
}

impl KeptWord {
    /// A phase that is unknown here, from a controller of another version, may be one with contact.
    fn word(self) -> ControllerWord {
        match Phase::from_code(self.phase) {
            Some(phase) => ControllerWord {
                phase,
                contact_possible: self.contact_possible,
            },
            None => ControllerWord {
                phase: Phase::Fault,
                contact_possible: true,
            },
        }
    }
}

/// The file and its contents.
pub(crate) struct Memory {
    /// Name of the file.
    file: &'static str,
    folder: Option<StateFolder>,
    bus: Bus,
    inner: Mutex<Inner>,
    zeros: Arc<Ring<Option<Note>>>,
}

struct Inner {
    control: Latest<ControlState>,
    kept: Kept,
    failed: bool,
}

/// The last good zero, as passed on by the loop.
#[derive(Clone, Copy, Debug)]
struct Note {
    serial: Text,
    tare: Tare,
    taken_ns: i64,
}

/// Used by the service's loop, which neither waits for the disk nor allocates.
pub(crate) struct ZeroNotes(Arc<Ring<Option<Note>>>);

impl ZeroNotes {
    /// Makes this zero of the sensor `serial`, taken `age_s` seconds ago, the last good one.
    pub(crate) fn keep(&self, serial: &str, tare: &Tare, age_s: f64) {
        self.say(Some(Note {
            serial: cut(serial),
            tare: *tare,
            taken_ns: now_ns() - (age_s * 1e9) as i64,
        }));
    }

    /// Removes the last good zero.
    pub(crate) fn forget(&self) {
        self.say(None);
    }

    fn say(&self, note: Option<Note>) {
        // The side thread takes the notes ten times a second, so there is room; only the newest
        // matters.
        self.0.force_push(note, drop);
    }
}

impl From<Note> for KeptZero {
    fn from(note: Note) -> Self {
        Self {
            serial: note.serial.to_string(),
            bias: note.tare.bias.vector().into(),
            std: note.tare.std.vector().into(),
            samples: note.tare.samples,
            taken_ns: note.taken_ns,
            ground: note.tare.ground,
            vouched: KeptPoint::of(&note.tare.vouched, &note.tare, note.taken_ns),
            shown: KeptPoint::of(&note.tare.shown, &note.tare, note.taken_ns),
        }
    }
}

impl KeptZero {
    /// The zero as a tare on the clock of [`tangent_sensing::Reading::time_s`], which is now
    /// `now_s`; `None` if it is of another sensor, or older than `age_max_s`.
    pub(crate) fn tare(&self, serial: &str, now_s: f64, age_max_s: f64) -> Option<Tare> {
        let age_s = (now_ns() - self.taken_ns) as f64 * 1e-9;
        let numbers = [&self.bias, &self.std, &self.vouched.bias, &self.shown.bias];
        let finite = numbers.into_iter().flatten().all(|x| x.is_finite());
        let time_s = now_s - age_s;
        (self.serial == cut::<128>(serial).as_str() && finite && (0.0..=age_max_s).contains(&age_s))
            .then(|| Tare {
                bias: Wrench::from_vector(&self.bias.into()),
                std: Wrench::from_vector(&self.std.into()),
                samples: self.samples,
                time_s,
                ground: self.ground,
                vouched: self.vouched.point(self, time_s),
                shown: self.shown.point(self, time_s),
            })
    }
}

impl Memory {
    /// Reads the stored state. A file that cannot be read is logged, and counts as a controller in
    /// contact.
    pub(crate) fn open(
        bus: &Bus,
        file: &'static str,
        folder: Option<StateFolder>,
    ) -> Result<(Self, ZeroNotes), BusError> {
        let read = folder
            .as_ref()
            .map_or(Ok(None), |folder| folder.read::<Kept>(file));
        let kept = match read {
            Ok(kept) => kept.unwrap_or_default(),
            Err(error) => {
                tracing::warn!(
                    "{error}: until the controller reports free space, the tool is assumed to touch something"
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
        let zeros = Arc::new(Ring::new(ZEROS));
        let memory = Self {
            file,
            folder,
            bus: bus.clone(),
            inner: Mutex::new(Inner {
                control: bus.latest(&topics::CONTROL_STATE)?,
                kept,
                failed: false,
            }),
            zeros: Arc::clone(&zeros),
        };
        Ok((memory, ZeroNotes(zeros)))
    }

    /// The last good zero that was stored.
    pub(crate) fn zero(&self) -> Option<KeptZero> {
        self.lock().kept.zero.clone()
    }

    /// Sign of contact that the controller's state gives now, if any.
    pub(crate) fn contact_sign(&self) -> Option<ContactSign> {
        let mut inner = self.lock();
        let now = inner.listen();
        let last = inner.kept.controller.map(KeptWord::word);
        ContactSign::of(now.map(KeptWord::word), last)
    }

    /// Describes a second publisher of the controller's state, if any; it is not known which of
    /// them is the controller.
    pub(crate) fn second_controller(&self) -> Option<String> {
        let refused = self.bus.refused();
        let second = |refused: &&Refused| {
            refused.topic == topics::CONTROL_STATE.key() && refused.who.is_some()
        };
        refused.iter().find(second).map(Refused::to_string)
    }

    /// Stores changes until `stop`.
    pub(crate) fn follow(&self, stop: &Stop) {
        let mut written = self.lock().kept.clone();
        loop {
            let stopped = stop.wait(PERIOD);
            let kept = self.gather();
            // Contact and motion only; other changes of phase are not stored.
            let word = |kept: &Kept| {
                let word = kept.controller?.word();
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
        let mut inner = self.lock();
        while let Some(note) = self.zeros.pop() {
            inner.kept.zero = note.map(KeptZero::from);
        }
        inner.listen();
        inner.kept.clone()
    }

    fn write(&self, kept: &Kept) {
        let Some(folder) = &self.folder else {
            return;
        };
        let written = folder.write(self.file, kept);
        let before = std::mem::replace(&mut self.lock().failed, written.is_err());
        if let (Err(error), false) = (written, before) {
            tracing::warn!("the last good zero is not stored for a restart: {error}");
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// The controller's state, if messages arrive.
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

    const FILE: &str = "netft";
    const SERIAL: &str = "FT12345";

    fn zero(taken_ns: i64) -> KeptZero {
        KeptZero {
            serial: SERIAL.to_owned(),
            bias: [1.0, -2.0, 3.0, 0.1, 0.2, 0.3],
            std: [0.01; 6],
            samples: 500,
            taken_ns,
            ground: TareGround::Assumed,
            vouched: KeptPoint {
                bias: [0.9, -2.0, 3.0, 0.1, 0.2, 0.3],
                taken_ns: taken_ns - 5_000_000_000,
            },
            shown: KeptPoint {
                bias: [0.0; 6],
                taken_ns: taken_ns - 60_000_000_000,
            },
        }
    }

    #[test]
    fn a_zero_is_taken_over_with_its_age_and_never_by_another_sensor() {
        let kept = zero(now_ns() - 90_000_000_000);
        let tare = kept.tare(SERIAL, 10.0, 3600.0).unwrap();
        assert!((tare.time_s - (10.0 - 90.0)).abs() < 1.0);
        assert_eq!(tare.bias.force.z, 3.0);
        assert_eq!(tare.vouched.bias.force.x, 0.9);
        assert!((tare.time_s - tare.vouched.time_s - 5.0).abs() < 1e-6);
        assert!((tare.time_s - tare.shown.time_s - 60.0).abs() < 1e-6);
        assert!(kept.tare("FT99999", 10.0, 3600.0).is_none());
        assert!(kept.tare(SERIAL, 10.0, 60.0).is_none());
    }

    #[test]
    fn the_controllers_last_report_is_kept_across_restarts() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let bus = Bus::in_process("test");
        let open = || Memory::open(&bus, FILE, Some(state.clone())).unwrap().0;
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
        // A running controller takes precedence.
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

    #[test]
    fn a_phase_that_is_not_known_may_press() {
        let bus = Bus::in_process("test");
        let memory = Memory::open(&bus, FILE, None).unwrap().0;
        let control = bus.publisher(&topics::CONTROL_STATE).unwrap();
        control.publish(&ControlState {
            phase: 200,
            ..ControlState::default()
        });
        let sign = Some(ContactSign::Possible(Phase::Fault));
        assert_eq!(memory.contact_sign(), sign);
    }
}
