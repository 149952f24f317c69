//! Follows the cell: adds up the dose with every state of the controller, and forms the snapshots.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use tangent_control::Phase;
use tangent_mechanics::{Base, Pose, Tool, World};
use tangent_runtime::config::OnLostPage;
use tangent_runtime::{Bus, Counter, Gauge, HealthReporter, Latest, Rate, Received, Subscription};
use tangent_scene::Pressed;
use tangent_schemas::standard::PoseWithCovarianceStamped;
use tangent_schemas::tangent::{ArmState, ControlState, Health, NormalEstimate};
use tangent_schemas::topics;

use crate::UiError;
use crate::commands::{Command, Who};
use crate::lock;
use crate::shared::Shared;
use crate::snapshot::{Estimator, Force, Snapshot, Space, Task, lights, round};

/// Interval of the snapshots.
const FRAME: Duration = Duration::from_millis(50);
/// Longest wait for a message.
const LOOK: Duration = Duration::from_millis(20);
/// Number of states that may wait: two seconds of the fastest robot.
const QUEUE: usize = 2048;
/// Number of healths that may wait.
const HEALTHS: usize = 256;
/// Number of services whose health is shown.
const SERVICES_MAX: usize = 64;
/// Time after which a service that fell silent is no longer shown.
const FORGET: Duration = Duration::from_secs(60);
/// Number of states of the arm that are kept for the state of the controller of the same cycle.
const ARMS: usize = 64;

/// Reader of the cell.
pub struct Watcher {
    shared: Arc<Shared>,
    bus: Bus,
    arms: Subscription<ArmState>,
    controls: Subscription<ControlState>,
    base: Latest<PoseWithCovarianceStamped>,
    estimates: Vec<(String, Latest<NormalEstimate>)>,
    healths: Subscription<Health>,
    recent: VecDeque<Received<ArmState>>,
    control: Option<Received<ControlState>>,
    by_service: BTreeMap<String, Received<Health>>,
    world_from_base: Option<Pose<World, Base>>,
    /// Stamp of the last state in contact, ns.
    pressed_ns: Option<i64>,
    force: Force,
    frames: u64,
    next: Instant,
    began: Instant,
    meters: Meters,
}

struct Meters {
    snapshots: Rate,
    pages: Gauge,
    lost: Counter,
}

impl Watcher {
    /// Subscribes to what is shown.
    ///
    /// # Errors
    /// The bus refuses a topic.
    pub fn new(bus: &Bus, shared: &Arc<Shared>, health: &HealthReporter) -> Result<Self, UiError> {
        let scene = &shared.config.scene;
        let world_from_base = (!scene.base_required).then(Pose::identity);
        *lock(&shared.world_from_base) = world_from_base;
        let mut estimates = Vec::new();
        for name in &scene.estimators {
            estimates.push((name.clone(), bus.latest(&topics::estimate_normal(name))?));
        }
        Ok(Self {
            arms: bus.subscribe(&topics::ARM_STATE, QUEUE)?,
            controls: bus.subscribe(&topics::CONTROL_STATE, QUEUE)?,
            base: bus.latest(&topics::BASE_POSE)?,
            estimates,
            healths: bus.subscribe(&topics::HEALTHS, HEALTHS)?,
            recent: VecDeque::with_capacity(ARMS),
            control: None,
            by_service: BTreeMap::new(),
            world_from_base,
            pressed_ns: None,
            force: Force::default(),
            frames: 0,
            next: Instant::now(),
            began: Instant::now(),
            meters: Meters {
                snapshots: health.rate("snapshots"),
                pages: health.gauge("pages"),
                lost: health.lost(),
            },
            shared: Arc::clone(shared),
            bus: bus.clone(),
        })
    }

    /// Takes in what has arrived, and forms a snapshot when it is due.
    pub fn turn(&mut self) {
        let left = self.next.saturating_duration_since(Instant::now());
        let first = self.controls.recv_timeout(left.min(LOOK));
        while let Some(arm) = self.arms.try_recv() {
            if self.recent.len() == ARMS {
                self.recent.pop_front();
            }
            self.recent.push_back(arm);
        }
        if let Some(first) = first {
            self.take(first);
        }
        while let Some(control) = self.controls.try_recv() {
            self.take(control);
        }
        let now = Instant::now();
        if now >= self.next {
            // After a standstill, no snapshots are made up for.
            self.next = (self.next + FRAME).max(now);
            self.answer_lost_pages(now);
            self.frame();
        }
    }

    fn take(&mut self, control: Received<ControlState>) {
        let state = &control.message;
        self.force.take(state);
        let is_new = |old: &Received<ControlState>| old.message.activation != state.activation;
        if state.activation != 0 && self.control.as_ref().is_none_or(is_new) {
            lock(&self.shared.dose).clear();
            self.shared.task_band.learn(&self.bus, state.activation);
            self.pressed_ns = None;
        }
        self.add_dose(state);
        self.control = Some(control);
    }

    fn add_dose(&mut self, control: &ControlState) {
        if let Some(base) = self.base.take_new() {
            self.world_from_base = Pose::try_from(&base.message.pose.pose).ok();
            *lock(&self.shared.world_from_base) = self.world_from_base;
        }
        let stamp = control.header.stamp.to_ns();
        let pressed = self.pressed(control);
        let since = self.pressed_ns.take();
        if let Some(pressed) = pressed {
            self.pressed_ns = Some(stamp);
            if let Some(since) = since {
                let dt_s = (stamp - since) as f64 * 1e-9;
                lock(&self.shared.dose).press(&pressed, dt_s);
            }
        }
    }

    fn pressed(&self, control: &ControlState) -> Option<Pressed> {
        let same = |arm: &&Received<ArmState>| arm.message.cycle == control.cycle;
        let arm = self.recent.iter().rev().find(same);
        let arm = arm.or(self.recent.back())?;
        let base_from_tool = Pose::<Base, Tool>::try_from(&arm.message.tool_pose).ok()?;
        let tip = &self.shared.config.scene.mounted.tip;
        Pressed::of(
            control,
            &base_from_tool,
            self.world_from_base.as_ref()?,
            tip,
        )
    }

    fn is_active(&self) -> bool {
        let phase = self.control.as_ref().map(|c| c.message.phase);
        phase
            .and_then(Phase::from_code)
            .is_some_and(Phase::is_active)
    }

    /// Carries out what the cell file says about the loss of every page that may command.
    fn answer_lost_pages(&mut self, now: Instant) {
        let active = self.is_active();
        if !lock(&self.shared.pages).are_lost(active, now) {
            return;
        }
        let command = match self.shared.config.on_lost_page {
            OnLostPage::Nothing => return,
            OnLostPage::Pause => Command::Pause,
            OnLostPage::Stop => Command::Stop,
        };
        let shared = Arc::clone(&self.shared);
        let started = std::thread::Builder::new()
            .name("ui-lost-page".to_owned())
            .spawn(move || {
                let who = Who {
                    name: "lost page".to_owned(),
                    role: Some(crate::access::Role::Operator),
                    address: String::new(),
                };
                shared.command(&who, &command);
            });
        if let Err(error) = started {
            tracing::error!("the lost page is not answered: {error}");
        }
    }

    fn frame(&mut self) {
        while let Some(health) = self.healths.try_recv() {
            let name = health.message.service.to_string();
            if self.by_service.len() < SERVICES_MAX || self.by_service.contains_key(&name) {
                self.by_service.insert(name, health);
            }
        }
        self.by_service.retain(|_, health| health.age() < FORGET);
        let pages = lock(&self.shared.pages).count(Instant::now());
        self.meters.pages.set(pages.0 as f64);
        let dropped = [self.arms.counts(), self.controls.counts()];
        self.meters
            .lost
            .set(dropped.iter().map(|c| c.dropped).sum());
        self.frames += 1;
        // Nobody reads: the snapshot costs nothing.
        if self.shared.snapshots.receiver_count() > 0
            && let Some(text) = self.snapshot(pages)
        {
            self.meters.snapshots.tick();
            self.shared
                .snapshots
                .send_replace(Bytes::from(format!("data: {text}\n\n")));
        }
        self.force.next();
    }

    fn snapshot(&mut self, pages: (usize, usize)) -> Option<String> {
        let arm = self.recent.back().map(|arm| (&arm.message, arm.age()));
        let control = self.control.as_ref().map(|c| (&c.message, c.age()));
        let state = control.map(|(state, _)| state);
        let scene = &self.shared.config.scene;
        let healths = self.by_service.values().map(|h| (&h.message, h.age()));
        let healths: Vec<_> = healths.collect();
        let dose = {
            let dose = lock(&self.shared.dose);
            [dose.epoch(), dose.revision()]
        };
        let estimators = self.estimates.iter_mut().map(|(name, newest)| {
            newest.refresh();
            let newest = newest.get().map(|e| (&e.message, e.age()));
            Estimator::of(name, newest, state)
        });
        let snapshot = Snapshot {
            number: self.frames,
            time_s: round(self.began.elapsed().as_secs_f64(), 1e3),
            task: state.map(Task::of),
            force: self.force,
            space: arm.and_then(|(arm, _)| {
                Space::of(&scene.chain, self.world_from_base.as_ref()?, arm, state)
            }),
            estimators: estimators.collect(),
            lights: lights(arm, control, &healths),
            dose,
            pages: pages.into(),
            teach: self.shared.tools.teach.as_ref().and_then(|t| t.state()),
            last_command: self.shared.last_command(),
        };
        serde_json::to_string(&snapshot).ok()
    }
}
