//! Health of a service, published once a second and at once when its state changes, and its
//! liveliness token.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

use tangent_schemas::Text;
use tangent_schemas::convert::{cut, cut_format};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::Health;
use tangent_schemas::topics;

use crate::bus::{AliveToken, Bus, BusError, Handle, Publisher, Refused};
use crate::clock;
use crate::clock_offset;
use crate::log;
use crate::meter::{Age, Counter, Gauge, Histogram, Rate};
use crate::realtime::RealtimeReport;
use crate::ring::Ring;
use crate::usage::ProcessUsage;

/// `Health.state`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// Not ready yet: connecting or waiting.
    Starting = 0,
    /// Works without restrictions.
    Running = 1,
    /// Works, but with a problem.
    Degraded = 2,
    /// Does not work.
    Fault = 3,
    /// Is shutting down.
    Stopping = 4,
}

/// Interval between two health messages.
const PERIOD: Duration = Duration::from_secs(1);

/// Publishes the health of one service until it is dropped. Clones of its meters may be passed to
/// real-time threads.
pub struct HealthReporter {
    shared: Arc<Shared>,
    thread: Option<Thread>,
    join: Option<JoinHandle<()>>,
    _token: AliveToken,
    _ping: Handle,
    _names: Handle,
}

struct Shared {
    service: String,
    instance: String,
    host: String,
    /// State changes in transit to the reporting thread.
    changes: Ring<(State, Text)>,
    stopping: AtomicBool,
    missed_cycles: Counter,
    lost: Counter,
    figures: Mutex<Figures>,
}

#[derive(Default)]
struct Figures {
    rates: Vec<(String, Rate, u64)>,
    ages: Vec<(String, Age)>,
    gauges: Vec<(String, Gauge)>,
    histograms: Vec<(String, Histogram)>,
    realtime: String,
}

/// Host and process, which distinguish the instances of a service.
pub fn instance_name() -> String {
    format!("{}-{}", host_name(), std::process::id())
}

/// Name of this host; `localhost` if it has none that is valid in a key.
pub fn host_name() -> String {
    let name = nix::unistd::gethostname()
        .ok()
        .and_then(|name| name.into_string().ok())
        .unwrap_or_default();
    let good: String = name
        .chars()
        .filter(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'))
        .take(40)
        .collect();
    if good.is_empty() {
        "localhost".to_owned()
    } else {
        good
    }
}

impl HealthReporter {
    /// Declares the service as running and begins to report, in state [`State::Starting`].
    ///
    /// # Errors
    /// The bus refused the topic or the token.
    pub fn start(bus: &Bus, service: &str) -> Result<Self, BusError> {
        let instance = instance_name();
        let token = bus.declare_alive(service, &instance)?;
        Self::with_token(bus, service, instance, token)
    }

    /// Starts the health reports of a service that may run only once in a cell.
    ///
    /// # Errors
    /// [`BusError::Taken`], with the place where it already runs; see also
    /// [`HealthReporter::start`].
    pub fn start_only(bus: &Bus, service: &str) -> Result<Self, BusError> {
        let instance = instance_name();
        let token = bus.claim_alive(service, &instance)?;
        Self::with_token(bus, service, instance, token)
    }

    fn with_token(
        bus: &Bus,
        service: &str,
        instance: String,
        token: AliveToken,
    ) -> Result<Self, BusError> {
        let ping = clock_offset::answer(bus, service, &instance)?;
        let names = bus.learn_names()?;
        let publisher = bus.publisher(&topics::health(service))?;
        let shared = Arc::new(Shared {
            service: service.to_owned(),
            instance,
            host: host_name(),
            changes: Ring::new(16),
            stopping: AtomicBool::new(false),
            missed_cycles: Counter::default(),
            lost: Counter::default(),
            figures: Mutex::default(),
        });
        let reported = Arc::clone(&shared);
        let join = std::thread::Builder::new()
            .name(format!("health-{service}").chars().take(15).collect())
            .spawn({
                let bus = bus.clone();
                move || report(&reported, &bus, &publisher)
            })
            .map_err(|error| BusError::Zenoh {
                action: "starting a thread".into(),
                reason: error.to_string(),
            })?;
        Ok(Self {
            shared,
            thread: Some(join.thread().clone()),
            join: Some(join),
            _token: token,
            _ping: ping,
            _names: names,
        })
    }

    /// Instance in the liveliness token: host and process.
    pub fn instance(&self) -> &str {
        &self.shared.instance
    }

    /// Adds a rate with this name, Hz in the message.
    pub fn rate(&self, name: &str) -> Rate {
        let rate = Rate::default();
        self.figures()
            .rates
            .push((name.to_owned(), rate.clone(), 0));
        rate
    }

    /// Adds an age with this name, s in the message.
    pub fn age(&self, name: &str) -> Age {
        let age = Age::default();
        self.figures().ages.push((name.to_owned(), age.clone()));
        age
    }

    /// Adds a number with this name, which includes the unit.
    pub fn gauge(&self, name: &str) -> Gauge {
        let gauge = Gauge::default();
        self.figures().gauges.push((name.to_owned(), gauge.clone()));
        gauge
    }

    /// Adds a distribution with this name; the message has `NAME_p50_us`, `_p99_us`, `_p999_us`,
    /// `_max_us` and `_n`.
    pub fn histogram(&self, name: &str) -> Histogram {
        let histogram = Histogram::default();
        self.figures()
            .histograms
            .push((name.to_owned(), histogram.clone()));
        histogram
    }

    /// Counter of the cycles in which the service could not do what was due.
    pub fn missed_cycles(&self) -> Counter {
        self.shared.missed_cycles.clone()
    }

    /// Counter of inputs or outputs that were lost.
    pub fn lost(&self) -> Counter {
        self.shared.lost.clone()
    }

    /// Adds the result of a real-time set-up; several results are listed together.
    pub fn realtime(&self, report: &RealtimeReport) {
        let mut figures = self.figures();
        if !figures.realtime.is_empty() {
            figures.realtime.push_str(" | ");
        }
        figures.realtime.push_str(&report.words);
    }

    /// Reports that the service works without restrictions, at once if that is a change. Takes no
    /// lock and allocates nothing: for real-time threads.
    pub fn running(&self) {
        self.set(State::Running, Text::new());
    }

    /// Reports the state and its reason, cut off at 128 bytes, at once if they have changed. Takes
    /// no lock and allocates nothing: for real-time threads.
    pub fn set(&self, state: State, reason: Text) {
        self.shared.changes.force_push((state, reason), drop);
        if let Some(thread) = &self.thread {
            thread.unpark();
        }
    }

    /// Reports that the service does not work, and why:
    /// `health.fault(format_args!("no packet for {age} s"))`. Takes no lock and allocates nothing.
    pub fn fault(&self, reason: std::fmt::Arguments<'_>) {
        self.set(State::Fault, cut_format(reason));
    }

    /// Reports that the service works, but with a problem. Takes no lock and allocates nothing.
    pub fn degraded(&self, reason: std::fmt::Arguments<'_>) {
        self.set(State::Degraded, cut_format(reason));
    }

    fn figures(&self) -> MutexGuard<'_, Figures> {
        lock(&self.shared.figures)
    }
}

impl Drop for HealthReporter {
    fn drop(&mut self) {
        self.shared.stopping.store(true, Ordering::Release);
        if let Some(thread) = &self.thread {
            thread.unpark();
        }
        if let Some(join) = self.join.take()
            && join.join().is_err()
        {
            tracing::error!("the health reporter panicked");
        }
    }
}

fn lock(figures: &Mutex<Figures>) -> MutexGuard<'_, Figures> {
    figures.lock().unwrap_or_else(PoisonError::into_inner)
}

fn report(shared: &Shared, bus: &Bus, publisher: &Publisher<Health>) {
    let mut state = (State::Starting, Text::new());
    let mut measured = Instant::now();
    let mut rates_hz = Vec::new();
    let (mut usage, mut cpu_percent) = (ProcessUsage::new(), 0.0);
    let mut due = Instant::now();
    // The session logged these remarks when it was opened.
    let mut remarks = bus.remarks();
    loop {
        let stopping = shared.stopping.load(Ordering::Acquire);
        let mut changed = false;
        while let Some(next) = shared.changes.pop() {
            changed |= next != state;
            state = next;
        }
        if stopping && state.0 != State::Fault {
            state.0 = State::Stopping;
        }
        let elapsed = measured.elapsed();
        if elapsed >= PERIOD {
            rates_hz = rates(&mut lock(&shared.figures), elapsed);
            cpu_percent = usage.cpu_percent();
            measured = Instant::now();
        }
        if changed || stopping || Instant::now() >= due {
            let refused = bus.refused();
            let mut further = vec![
                ("process_cpu_percent".to_owned(), cpu_percent),
                ("process_memory_mib".to_owned(), ProcessUsage::memory_mib()),
                ("log_lines_dropped".to_owned(), log::dropped() as f64),
            ];
            further.extend(refused.iter().map(|r| (refused_name(r), r.samples as f64)));
            let mut told = message(shared, &state, &rates_hz, further);
            told.remarks = bus.remarks();
            for new in told
                .remarks
                .iter()
                .filter(|remark| !remarks.contains(remark))
            {
                tracing::warn!("{new}");
            }
            remarks.clone_from(&told.remarks);
            tell_of(&refused, &mut told);
            publisher.publish(&told);
            due = Instant::now() + PERIOD;
        }
        if stopping {
            return;
        }
        std::thread::park_timeout(due.saturating_duration_since(Instant::now()));
    }
}

fn rates(figures: &mut Figures, elapsed: Duration) -> Vec<f64> {
    figures
        .rates
        .iter_mut()
        .map(|(_, rate, before)| {
            let count = rate.count();
            let hz = (count - *before) as f64 / elapsed.as_secs_f64();
            *before = count;
            hz
        })
        .collect()
}

fn message(
    shared: &Shared,
    state: &(State, Text),
    rates_hz: &[f64],
    further: Vec<(String, f64)>,
) -> Health {
    let figures = lock(&shared.figures);
    let mut numbers: Vec<(String, f64)> = figures
        .gauges
        .iter()
        .map(|(name, gauge)| (name.clone(), gauge.get()))
        .chain(further)
        .collect();
    for (name, histogram) in &figures.histograms {
        let found = histogram.distribution();
        for (suffix, value) in [
            ("p50_us", found.p50_s * 1e6),
            ("p99_us", found.p99_s * 1e6),
            ("p999_us", found.p999_s * 1e6),
            ("max_us", found.max_s * 1e6),
            ("n", found.n as f64),
        ] {
            numbers.push((format!("{name}_{suffix}"), value));
        }
    }
    let (figure_names, figure_values) = numbers.into_iter().unzip();
    Health {
        header: Header::new(clock::now_ns(), ""),
        service: cut(&shared.service),
        instance: cut(&shared.instance),
        host: cut(&shared.host),
        state: state.0 as u8,
        // A rate that was added since the last measurement has no value yet.
        rate_names: names(&figures.rates[..rates_hz.len()], |(name, ..)| name),
        rates_hz: rates_hz.to_vec(),
        age_names: names(&figures.ages, |(name, _)| name),
        ages_s: figures.ages.iter().map(|(_, age)| age.seconds()).collect(),
        missed_cycles: shared.missed_cycles.get(),
        lost: shared.lost.get(),
        fault: state.1.to_string(),
        realtime: figures.realtime.clone(),
        figure_names,
        figures: figure_values,
        remarks: Vec::new(),
    }
}

fn refused_name(refused: &Refused) -> String {
    format!("{}_refused", refused.topic)
}

/// Adds refused publishers to the message. A second publisher of one of this service's inputs is
/// not the service's own fault, but must not persist.
fn tell_of(refused: &[Refused], told: &mut Health) {
    for refused in refused.iter().filter(|refused| refused.who.is_some()) {
        if told.state == State::Running as u8 {
            told.state = State::Degraded as u8;
        }
        if !told.fault.is_empty() {
            told.fault.push_str("; ");
        }
        told.fault.push_str(&refused.to_string());
    }
}

fn names<T>(items: &[T], name: impl Fn(&T) -> &String) -> Vec<String> {
    items.iter().map(|item| name(item).clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Duration = Duration::from_secs(10);

    #[test]
    fn a_change_is_published_at_once_with_the_figures() {
        let bus = Bus::in_process("test");
        let heard = bus.subscribe(&topics::health("netft"), 16).unwrap();
        let health = HealthReporter::start(&bus, "netft").unwrap();
        let histogram = health.histogram("packet_to_command");
        health.gauge("temperature_c").set(21.5);
        health.missed_cycles().add(3);
        histogram.record(Duration::from_micros(100));
        assert_eq!(bus.alive(PATIENCE).unwrap()[0].service, "netft");

        health.fault(format_args!("no record for {} s", 2));
        let told = loop {
            let told = heard.recv_timeout(PATIENCE).expect("a message").message;
            if told.state == State::Fault as u8 {
                break told;
            }
        };
        assert_eq!(told.fault, "no record for 2 s");
        assert_eq!(told.missed_cycles, 3);
        let figure = |name: &str| {
            let index = told.figure_names.iter().position(|n| n == name).unwrap();
            told.figures[index]
        };
        assert_eq!(figure("temperature_c"), 21.5);
        assert_eq!(figure("packet_to_command_max_us"), 100.0);
        assert_eq!(figure("packet_to_command_n"), 1.0);

        health.running();
        drop(health);
        let mut last = None;
        while let Some(told) = heard.try_recv() {
            last = Some(told.message.state);
        }
        assert_eq!(last, Some(State::Stopping as u8));
        assert_eq!(bus.alive(PATIENCE).unwrap(), []);
    }

    #[test]
    fn rates_are_events_per_second() {
        let mut figures = Figures::default();
        let rate = Rate::default();
        figures.rates.push(("a".into(), rate.clone(), 0));
        for _ in 0..250 {
            rate.tick();
        }
        assert_eq!(rates(&mut figures, Duration::from_secs(2)), [125.0]);
        assert_eq!(rates(&mut figures, Duration::from_secs(2)), [0.0]);
    }
}
