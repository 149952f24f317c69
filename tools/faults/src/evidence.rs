//! Messages of the cell and the simulated truth, each with its time, and what is measured from
//! them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tangent_control::Phase;
use tangent_runtime::{Bus, Handle, Received};
use tangent_schemas::Message;
use tangent_schemas::tangent::{ArmState, ContactTruth, ControlState, Health, WrenchStatus};
use tangent_schemas::topics::{self, Topic};

use crate::error::Result;

/// Speed below which a tool on the surface counts as standing, m/s.
const STANDS_M_PER_S: f64 = 2e-3;
/// Force below which the contact counts as lost, N, as for the controller's estimators
/// (`contact.force_off_n`).
const BRUSHES_N: f64 = 0.3;

/// Messages with their times, ns since the Unix epoch.
type Log<T> = Arc<Mutex<Vec<(i64, T)>>>;

/// True state of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// Whether the tool touches the surface.
    pub in_contact: bool,
    /// Speed of the tool along the surface, m/s.
    pub sliding_m_per_s: f64,
    /// Speed of the tool away from the surface, m/s.
    pub lifting_m_per_s: f64,
    /// Force of the surface on the tool, N.
    pub force_n: f64,
    /// Component of that force along the surface's normal, N; pressing is positive.
    pub pressing_n: f64,
}

impl Truth {
    /// Whether the tool slides. A tool that lifts off faster than it slides is leaving; a compliant
    /// wrist slips a little as it lets go.
    fn slides(&self) -> bool {
        self.in_contact && self.sliding_m_per_s > STANDS_M_PER_S.max(self.lifting_m_per_s)
    }
}

/// State of the controller, as published.
#[derive(Clone, Debug)]
pub struct Control {
    /// Phase of the task.
    pub phase: Phase,
    /// Estimator in use.
    pub estimator: String,
    /// Fault that ended the task; empty if there is none.
    pub fault: String,
    /// Pressing force that the controller shows, N; pressing is positive.
    pub force_n: f64,
}

/// State of the bridge, as published.
#[derive(Clone, Copy, Debug)]
pub struct Arm {
    /// Whether a command would move the arm.
    pub ready: bool,
    /// Position of the tool's origin along x, base axes, m.
    pub tool_x_m: f64,
    /// Number of commands refused since its start.
    pub refused: u64,
    /// Number of cycles missed since its start.
    pub missed: u64,
    /// Number of robot packets lost since its start.
    pub lost: u64,
}

/// Status of the sensor service, as published.
#[derive(Clone, Copy, Debug)]
pub struct Sensor {
    /// Validity of the wrench; 0: valid.
    pub validity: u8,
    /// Number of records lost since its start.
    pub lost: u64,
    /// Number of records out of order since its start.
    pub out_of_order: u64,
    /// Number of records left out since its start, as no load can cause their jump.
    pub implausible: u64,
}

/// Health of a service, as published.
#[derive(Clone, Debug)]
pub struct Service {
    /// Name of the service.
    pub name: String,
    /// `Health.state`.
    pub state: u8,
    /// Its figures, by name.
    pub figures: Vec<(String, f64)>,
}

/// All messages received since the cell was started.
pub struct Evidence {
    truths: Log<Truth>,
    controls: Log<Control>,
    arms: Log<Arm>,
    sensors: Log<Sensor>,
    services: Log<Service>,
    _handles: Vec<Handle>,
}

impl Evidence {
    /// Subscribes to the messages of the cell. The truth comes from this process, everything else
    /// over the router.
    ///
    /// # Errors
    /// The bus refuses a topic.
    pub fn gather(bus: &Bus) -> Result<Self> {
        let (truths, controls, arms) = (Log::default(), Log::default(), Log::default());
        let (sensors, services) = (Log::default(), Log::default());
        let handles = vec![
            keep(bus, &topics::TRUTH_CONTACT, &truths, truth)?,
            keep(bus, &topics::CONTROL_STATE, &controls, control)?,
            keep(bus, &topics::ARM_STATE, &arms, arm)?,
            keep(bus, &topics::WRENCH_STATUS, &sensors, sensor)?,
            keep(bus, &topics::HEALTHS, &services, service)?,
        ];
        Ok(Self {
            truths,
            controls,
            arms,
            sensors,
            services,
            _handles: handles,
        })
    }

    /// The controller's last state, if it is not older than `since_ns`.
    pub fn control(&self, since_ns: i64) -> Option<Control> {
        self.control_at(since_ns).map(|(_, control)| control)
    }

    /// The controller's last state and its time, ns since the Unix epoch, if it is not older than
    /// `since_ns`.
    pub fn control_at(&self, since_ns: i64) -> Option<(i64, Control)> {
        lock(&self.controls)
            .last()
            .filter(|(at, _)| *at >= since_ns)
            .cloned()
    }

    /// Whether a task ran in the controller's last state before `at_ns`.
    pub fn has_task_at(&self, at_ns: i64) -> bool {
        let controls = lock(&self.controls);
        let before = controls.iter().rev().find(|(at, _)| *at < at_ns);
        before.is_some_and(|(_, control)| control.phase.is_active())
    }

    /// The bridge's last state, if it is not older than `since_ns`.
    pub fn arm(&self, since_ns: i64) -> Option<Arm> {
        last_since(&self.arms, since_ns)
    }

    /// Whether a service has published its health since `since_ns`.
    pub fn heard(&self, name: &str, since_ns: i64) -> bool {
        let services = lock(&self.services);
        services
            .iter()
            .rev()
            .take_while(|(at, _)| *at >= since_ns)
            .any(|(_, service)| service.name == name)
    }

    /// Whether the tool has been sliding all the time since `from_ns`.
    pub fn slid_throughout(&self, from_ns: i64) -> bool {
        let truths = lock(&self.truths);
        let lately = span(&truths, from_ns, i64::MAX);
        lately.len() > 10 && lately.iter().all(|(_, truth)| truth.slides())
    }

    /// Whether the tool has been sliding at some time since `from_ns`; it may have stopped at a
    /// corner of its path.
    pub fn slid_at_all(&self, from_ns: i64) -> bool {
        first(&lock(&self.truths), from_ns, Truth::slides).is_some()
    }

    /// Highest force within a span, N.
    pub fn peak_n(&self, from_ns: i64, to_ns: i64) -> f64 {
        let truths = lock(&self.truths);
        span(&truths, from_ns, to_ns)
            .iter()
            .map(|(_, truth)| truth.force_n)
            .fold(0.0, f64::max)
    }

    /// Mean force shown by the controller minus the mean true force while the tool slides, within a
    /// span, N; `None` if it does not slide.
    pub fn shown_minus_true_n(&self, from_ns: i64, to_ns: i64) -> Option<f64> {
        let shown = mean(
            span(&lock(&self.controls), from_ns, to_ns)
                .iter()
                .filter(|(_, control)| control.phase == Phase::Slide)
                .map(|(_, control)| control.force_n),
        )?;
        let pressed = mean(
            span(&lock(&self.truths), from_ns, to_ns)
                .iter()
                .filter(|(_, truth)| truth.slides())
                .map(|(_, truth)| truth.pressing_n),
        )?;
        Some(shown - pressed)
    }

    /// Whether the tool does not touch anything, by the last true state; `None` if there is none
    /// since `since_ns`.
    pub fn is_off_the_surface(&self, since_ns: i64) -> Option<bool> {
        last_since(&self.truths, since_ns).map(|truth| !truth.in_contact)
    }

    /// Time from which the tool no longer slides on the surface, up to `to_ns`.
    pub fn safe_ns(&self, from_ns: i64, to_ns: i64) -> Option<i64> {
        let truths = lock(&self.truths);
        let all = span(&truths, from_ns, to_ns);
        let slid = all.iter().rposition(|(_, truth)| truth.slides());
        match slid {
            None => Some(from_ns),
            Some(index) => all.get(index + 1).map(|(at, _)| *at),
        }
    }

    /// Whether the last health message of a service reports that it works without restrictions.
    pub fn is_well(&self, name: &str) -> bool {
        let services = lock(&self.services);
        services
            .iter()
            .rev()
            .find(|(_, service)| service.name == name)
            .is_some_and(|(_, service)| service.state == 1)
    }

    /// Time at which the sliding speed first falls below 70 % of that before `from_ns`.
    pub fn slowed_ns(&self, from_ns: i64) -> Option<i64> {
        let truths = lock(&self.truths);
        let before = truths
            .iter()
            .rev()
            .find(|(at, _)| *at < from_ns)
            .map_or(0.0, |(_, t)| t.sliding_m_per_s);
        first(&truths, from_ns, |t| t.sliding_m_per_s < 0.7 * before)
    }

    /// Time at which the contact is first lost; a force of a pad that only brushes an edge is no
    /// contact.
    pub fn lost_contact_ns(&self, from_ns: i64) -> Option<i64> {
        first(&lock(&self.truths), from_ns, |t| {
            !t.in_contact || t.force_n < BRUSHES_N
        })
    }

    /// Time at which the controller first leaves the sliding phase.
    pub fn left_path_ns(&self, from_ns: i64) -> Option<i64> {
        first(&lock(&self.controls), from_ns, |c| c.phase != Phase::Slide)
    }

    /// Time at which the controller is first in this phase.
    pub fn phase_ns(&self, phase: Phase, from_ns: i64) -> Option<i64> {
        first(&lock(&self.controls), from_ns, |c| c.phase == phase)
    }

    /// Time at which another estimator than before `from_ns` is first in use.
    pub fn fallen_back_ns(&self, from_ns: i64) -> Option<i64> {
        changed(&lock(&self.controls), from_ns, |before, now| {
            now.estimator != before.estimator
        })
    }

    /// Time at which the bridge's state first differs from the last one before `from_ns`, by
    /// `differs(before, now)`.
    pub fn arm_ns(&self, from_ns: i64, differs: impl Fn(&Arm, &Arm) -> bool) -> Option<i64> {
        changed(&lock(&self.arms), from_ns, differs)
    }

    /// Time at which the sensor's status first differs from the last one before `from_ns`, by
    /// `differs(before, now)`.
    pub fn sensor_ns(
        &self,
        from_ns: i64,
        differs: impl Fn(&Sensor, &Sensor) -> bool,
    ) -> Option<i64> {
        changed(&lock(&self.sensors), from_ns, differs)
    }

    /// Time at which the health of a service first differs from the last one before `from_ns`, by
    /// `differs(before, now)`.
    pub fn service_ns(
        &self,
        name: &str,
        from_ns: i64,
        differs: impl Fn(&Service, &Service) -> bool,
    ) -> Option<i64> {
        let services = lock(&self.services);
        let own: Vec<_> = services
            .iter()
            .filter(|(_, service)| service.name == name)
            .cloned()
            .collect();
        changed(&own, from_ns, differs)
    }
}

fn lock<T>(log: &Mutex<Vec<(i64, T)>>) -> MutexGuard<'_, Vec<(i64, T)>> {
    log.lock().unwrap_or_else(PoisonError::into_inner)
}

fn keep<M: Message, T: Send + 'static>(
    bus: &Bus,
    topic: &Topic<M>,
    log: &Log<T>,
    of: impl Fn(&M) -> T + Send + 'static,
) -> Result<Handle> {
    let log = Arc::clone(log);
    Ok(bus.on(topic, move |received: &Received<M>| {
        let at = received.source_time_ns;
        let mut log = lock(&log);
        // Nearly always the end; messages of a service that was held up can arrive late.
        let place = log.iter().rposition(|(t, _)| *t <= at).map_or(0, |i| i + 1);
        log.insert(place, (at, of(&received.message)));
    })?)
}

fn span<T>(log: &[(i64, T)], from_ns: i64, to_ns: i64) -> &[(i64, T)] {
    let from = log.partition_point(|(at, _)| *at < from_ns);
    let to = log.partition_point(|(at, _)| *at <= to_ns);
    &log[from..to.max(from)]
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0_u32), |(sum, n), value| (sum + value, n + 1));
    (n > 0).then(|| sum / f64::from(n))
}

fn first<T>(log: &[(i64, T)], from_ns: i64, is: impl Fn(&T) -> bool) -> Option<i64> {
    span(log, from_ns, i64::MAX)
        .iter()
        .find(|(_, said)| is(said))
        .map(|(at, _)| *at)
}

fn changed<T>(log: &[(i64, T)], from_ns: i64, differs: impl Fn(&T, &T) -> bool) -> Option<i64> {
    let at = log.partition_point(|(at, _)| *at < from_ns);
    let (_, before) = log[..at].last()?;
    first(log, from_ns, |now| differs(before, now))
}

fn last_since<T: Copy>(log: &Log<T>, since_ns: i64) -> Option<T> {
    lock(log)
        .last()
        .filter(|(at, _)| *at >= since_ns)
        .map(|(_, said)| *said)
}

fn truth(m: &ContactTruth) -> Truth {
    let f = &m.wrench.force;
    let (v, n) = (&m.tool_twist.linear, &m.normal);
    Truth {
        in_contact: m.in_contact,
        sliding_m_per_s: m.sliding_speed_m_per_s,
        lifting_m_per_s: v.x * n.x + v.y * n.y + v.z * n.z,
        force_n: (f.x * f.x + f.y * f.y + f.z * f.z).sqrt(),
        pressing_n: f.x * n.x + f.y * n.y + f.z * n.z,
    }
}

fn control(m: &ControlState) -> Control {
    Control {
        phase: Phase::from_code(m.phase).unwrap_or_default(),
        estimator: m.estimator.to_string(),
        fault: m.fault.to_string(),
        force_n: m.force_n,
    }
}

fn arm(m: &ArmState) -> Arm {
    Arm {
        ready: m.ready,
        tool_x_m: m.tool_pose.position.x,
        refused: m.commands_refused,
        missed: m.missed_cycles,
        lost: m.packets_lost,
    }
}

fn sensor(m: &WrenchStatus) -> Sensor {
    Sensor {
        validity: m.validity,
        lost: m.records_lost,
        out_of_order: m.records_out_of_order,
        implausible: m.records_implausible,
    }
}

fn service(m: &Health) -> Service {
    Service {
        name: m.service.to_string(),
        state: m.state,
        figures: m
            .figure_names
            .iter()
            .cloned()
            .zip(m.figures.iter().copied())
            .collect(),
    }
}
