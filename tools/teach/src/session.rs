//! A lesson that one person gives and others may look at, as on a page: the arm is free only while
//! signs of life of this person come in.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tangent_runtime::{Bus, Stop};

use crate::arm_lesson::ArmLesson;
use crate::error::TeachError;
use crate::guide::Guide;
use crate::lesson::{Key, Lesson, Places, Pressed};

/// Interval between two looks at the arm.
const LOOK: Duration = Duration::from_millis(20);
/// Time without a sign of life after which the bridge has ended the guiding.
const KEEP_ALIVE: Duration = Duration::from_secs(2);
/// Places of a stroke in a picture.
const STROKE_MAX: usize = 400;

const FREE: &str = "the arm is FREE: hold it, and move it by hand";

/// Which bridge is asked, and what it can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bridge {
    /// Name of the service.
    pub service: &'static str,
    /// The arm is guided with buttons of its own, and no program can make it free.
    pub has_own_buttons: bool,
}

/// State of a session, for a page.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionState {
    /// Who gives the lesson.
    pub who: String,
    /// Whether the bridge lets a hand guide the arm.
    pub is_free: bool,
    /// Why it does not any more, or not at all; empty without a reason.
    pub held_because: String,
    /// Number of points.
    pub points: usize,
    /// Number of finished strokes.
    pub strokes: usize,
    /// Whether a stroke is being taken.
    pub is_stroking: bool,
    /// Whether a home was taken.
    pub has_home: bool,
    /// Counts changes of what was shown.
    pub changes: u64,
}

/// At most one lesson at a time.
pub struct Session {
    bus: Bus,
    bridge: Bridge,
    running: Arc<Mutex<Option<Running>>>,
    /// Lessons so far: their changes must differ.
    begun: Mutex<u64>,
}

/// A lesson that is being given.
struct Running {
    who: String,
    lesson: ArmLesson,
    guided: Option<Guided>,
    held_because: String,
    number: u64,
    /// Ends the thread that looks at the arm.
    stop: Stop,
}

struct Guided {
    guide: Arc<Guide>,
    kept: Instant,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.trigger();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    /// No lesson so far.
    pub fn new(bus: &Bus, bridge: Bridge) -> Self {
        Self {
            bus: bus.clone(),
            bridge,
            running: Arc::default(),
            begun: Mutex::new(0),
        }
    }

    /// Begins a lesson, or goes on with the one that this person gives; with `freedrive`, a hand
    /// can guide the arm from now on. Blocks for some seconds at most.
    ///
    /// # Errors
    /// Another person gives a lesson, no state of the arm arrives, or the bridge's reason.
    pub fn begin(&self, who: &str, freedrive: bool) -> Result<String, TeachError> {
        // One at a time: two would ask the bridge under one name.
        let mut begun = lock(&self.begun);
        if let Some(running) = &*lock(&self.running)
            && running.who != who
            && (running.guided.is_some() || !running.lesson.lesson().is_empty())
        {
            return Err(TeachError::Taken(running.who.clone()));
        }
        let goes_on = matches!(&*lock(&self.running), Some(running) if running.who == who);
        if !goes_on {
            let lesson = ArmLesson::open(&self.bus)?;
            *begun += 1;
            self.start(who, lesson, *begun)?;
        }
        if !freedrive {
            return Ok("move the arm with its own buttons or the pendant".to_owned());
        }
        let is_free = matches!(&*lock(&self.running), Some(running) if running.guided.is_some());
        if is_free {
            return Ok(FREE.to_owned());
        }
        let name = format!("page/{who}/{}", std::process::id());
        let guided = match Guide::begin(&self.bus, self.bridge.service, &name) {
            Ok(guide) => Some(Guided {
                guide: Arc::new(guide),
                kept: Instant::now(),
            }),
            // The arm's own buttons are the only way there.
            Err(TeachError::NotGuided(reason)) if self.bridge.has_own_buttons => {
                return Ok(reason);
            }
            Err(error) => return Err(error),
        };
        let mut running = lock(&self.running);
        if let Some(running) = &mut *running {
            running.guided = guided;
            running.held_because.clear();
        }
        Ok(FREE.to_owned())
    }

    fn start(&self, who: &str, lesson: ArmLesson, number: u64) -> Result<(), TeachError> {
        let stop = Stop::new();
        *lock(&self.running) = Some(Running {
            who: who.to_owned(),
            lesson,
            guided: None,
            held_because: String::new(),
            number,
            stop: stop.clone(),
        });
        let running = Arc::clone(&self.running);
        let looking = std::thread::Builder::new().name("teach-look".into());
        let started = looking.spawn(move || {
            while !stop.wait(LOOK) {
                if let Some(running) = &mut *lock(&running) {
                    running.look();
                }
            }
        });
        if let Err(error) = started {
            *lock(&self.running) = None;
            return Err(TeachError::NotGuided(error.to_string()));
        }
        Ok(())
    }

    /// A sign of life of the person who gives the lesson.
    ///
    /// # Errors
    /// The arm is not free any more: why.
    pub fn keep(&self, who: &str) -> Result<(), TeachError> {
        let guide = self.with(who, |running| {
            running.guided.as_ref().map(|g| Arc::clone(&g.guide))
        })?;
        let Some(guide) = guide else {
            return Ok(());
        };
        let kept = guide.keep();
        let ended = self.with(who, |running| {
            let same = |guided: &&mut Guided| Arc::ptr_eq(&guided.guide, &guide);
            match kept {
                Ok(()) => {
                    if let Some(guided) = running.guided.as_mut().filter(same) {
                        guided.kept = Instant::now();
                    }
                    None
                }
                Err(reason) => {
                    running.held_because = reason;
                    running.guided.take()
                }
            }
        })?;
        drop(ended);
        Ok(())
    }

    /// Handles a key of the person who gives the lesson. `Quit` forgets the lesson; `Done` does
    /// nothing.
    ///
    /// # Errors
    /// This person gives no lesson, nothing was taken, or where the arm stands is not known.
    pub fn press(&self, who: &str, key: Key) -> Result<String, TeachError> {
        match self.with(who, |running| running.lesson.press(key))?? {
            Pressed::Taken(words) => Ok(words),
            Pressed::Refused(words) => Err(TeachError::NotTaken(words)),
            Pressed::Done => Ok(String::new()),
            Pressed::Quit => {
                let ended = lock(&self.running).take();
                drop(ended);
                Ok("the arm holds itself, and what was shown is forgotten".to_owned())
            }
        }
    }

    /// The arm holds itself; what was shown stays.
    ///
    /// # Errors
    /// This person gives no lesson.
    pub fn hold(&self, who: &str) -> Result<String, TeachError> {
        let guided = self.with(who, |running| {
            running.held_because.clear();
            running.guided.take()
        })?;
        drop(guided);
        Ok("the arm holds itself".to_owned())
    }

    /// Reads what this person has shown, with all strokes ended.
    ///
    /// # Errors
    /// This person gives no lesson, or a stroke is being taken.
    pub fn read<T>(&self, who: &str, read: impl FnOnce(&Lesson) -> T) -> Result<T, TeachError> {
        self.with(who, |running| match running.lesson.lesson() {
            lesson if lesson.is_stroking() => Err(TeachError::NotTaken(
                "a stroke is being taken: end it first",
            )),
            lesson => Ok(read(lesson)),
        })?
    }

    fn with<T>(&self, who: &str, work: impl FnOnce(&mut Running) -> T) -> Result<T, TeachError> {
        match &mut *lock(&self.running) {
            Some(running) if running.who == who => Ok(work(running)),
            Some(running) => Err(TeachError::Taken(running.who.clone())),
            None => Err(TeachError::NotBegun),
        }
    }

    /// State of the lesson, if one is given.
    pub fn state(&self) -> Option<SessionState> {
        let running = lock(&self.running);
        let running = running.as_ref()?;
        let lesson = running.lesson.lesson();
        let (points, strokes) = lesson.counts();
        Some(SessionState {
            who: running.who.clone(),
            is_free: running.guided.is_some(),
            held_because: running.held_because.clone(),
            points,
            strokes,
            is_stroking: lesson.is_stroking(),
            has_home: lesson.has_home(),
            changes: (running.number << 32) + lesson.changes(),
        })
    }

    /// What was shown so far, for a picture.
    pub fn places(&self) -> Vec<Places> {
        let running = lock(&self.running);
        let lesson = running.as_ref().map(|running| running.lesson.lesson());
        lesson.map_or_else(Vec::new, |lesson| lesson.places(STROKE_MAX))
    }
}

impl Running {
    /// Takes in how the arm moves, and notes when the person has fallen silent.
    fn look(&mut self) {
        self.lesson.look();
        let is_silent = |guided: &mut Guided| guided.kept.elapsed() > KEEP_ALIVE;
        if let Some(silent) = self.guided.take_if(is_silent) {
            // An `end` that is sent now could end what is begun next.
            silent.guide.leave();
            let seconds = KEEP_ALIVE.as_secs();
            self.held_because = format!("no sign of life of the page for {seconds} s");
        }
    }
}
