//! What the requests share, and how many of each kind may wait.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use axum::body::Bytes;
use serde_json::{Value, json};
use tangent_mechanics::{Base, Pose, World};
use tangent_scene::dose::DoseMap;
use tokio::sync::{Semaphore, watch};

use crate::commands::{Command, Desk, Who};
use crate::config::Config;
use crate::lock;
use crate::pages::Pages;
use crate::snapshot::LastCommand;
use crate::task_band::TaskBand;
use crate::tools::Tools;

/// Largest number of streams.
pub const STREAMS_MAX: usize = 32;
/// Largest number of commands other than a stop that wait for the cell.
const COMMANDS_MAX: usize = 3;
/// Largest number of stops that wait for the cell.
const STOPS_MAX: usize = 4;
/// Largest number of signs of life of a teaching person that wait for the cell.
const SIGNS_MAX: usize = 2;
/// Threads for what waits: commands, stops, teaching, a calibration and files.
pub const WAITING_THREADS: usize = COMMANDS_MAX + STOPS_MAX + SIGNS_MAX + 6;

/// What the requests share.
pub struct Shared {
    pub config: Config,
    pub desk: Desk,
    pub dose: Mutex<DoseMap>,
    pub pages: Mutex<Pages>,
    pub snapshots: watch::Sender<Bytes>,
    pub tools: Tools,
    /// Pose of the arm's base, once it is known.
    pub world_from_base: Mutex<Option<Pose<World, Base>>>,
    pub task_band: TaskBand,
    last_command: Mutex<Option<LastCommand>>,
    commands_so_far: AtomicU64,
    /// Streams of snapshots that are open.
    pub streams: Arc<Semaphore>,
    /// What waits for the cell, by kind.
    pub commands: Semaphore,
    pub stops: Semaphore,
    pub reports: Semaphore,
    pub calibrations: Semaphore,
    pub lessons: Semaphore,
    pub signs: Semaphore,
}

impl Shared {
    pub fn new(config: Config, desk: Desk, dose: DoseMap, tools: Tools) -> Self {
        Self {
            pages: Mutex::new(Pages::new(config.lost_page_after)),
            config,
            desk,
            dose: Mutex::new(dose),
            snapshots: watch::channel(Bytes::new()).0,
            tools,
            world_from_base: Mutex::default(),
            task_band: TaskBand::default(),
            last_command: Mutex::default(),
            commands_so_far: AtomicU64::new(0),
            streams: Arc::new(Semaphore::new(STREAMS_MAX)),
            commands: Semaphore::new(COMMANDS_MAX),
            stops: Semaphore::new(STOPS_MAX),
            reports: Semaphore::new(1),
            calibrations: Semaphore::new(1),
            lessons: Semaphore::new(1),
            signs: Semaphore::new(SIGNS_MAX),
        }
    }

    /// Carries a command out, and shows every page what became of it. Blocks.
    pub fn command(&self, who: &Who, command: &Command) -> Value {
        let answer = self.desk.carry_out(who, command);
        if answer.done && command.moves() {
            lock(&self.pages).started(Instant::now());
        }
        let last = LastCommand {
            number: self.commands_so_far.fetch_add(1, Ordering::Relaxed) + 1,
            who: who.name.clone(),
            action: command.action(),
            done: answer.done,
            message: answer.message.clone(),
        };
        *lock(&self.last_command) = Some(last);
        json!({ "done": answer.done, "message": answer.message })
    }

    /// Wanted dose, N*s/cm²: that of the task, else that of the cell file.
    pub fn dose_band(&self) -> Option<[f64; 2]> {
        self.task_band.get().or(self.config.dose_band)
    }

    /// The last command of a page.
    pub fn last_command(&self) -> Option<LastCommand> {
        lock(&self.last_command).clone()
    }
}
