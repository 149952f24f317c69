//! `tangent bench bus`: from a packet to its answer, and how old a message is when it arrives,
//! within one process and between processes, idle and loaded, with and without SCHED_FIFO.

use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use tangent_runtime::clock::{DeadlineClock, now_ns};
use tangent_runtime::realtime::setup_thread;
use tangent_runtime::{Bus, Latest, Publisher, Role, Stop};
use tangent_schemas::tangent::ArmState;

use super::load::Load;
use super::peer::{BACK, OUT, cell, echo};
use super::{Row, python};
use crate::cli::BenchBus;

/// Rates of the loop: CB3, and torque-controlled arms.
const RATES_HZ: [f64; 2] = [125.0, 1000.0];
/// SCHED_FIFO priority of the measuring thread: the control loop's.
const PRIORITY: u8 = 80;
/// An answer that takes longer is lost.
const PATIENCE: Duration = Duration::from_millis(500);
/// Time to connect, which is not measured.
const CONNECT: Duration = Duration::from_secs(10);

/// Who answers, and by which way.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    OneProcess,
    TwoProcesses,
    ThroughRouter,
    Python,
}

impl Way {
    const ALL: [Self; 4] = [
        Self::OneProcess,
        Self::TwoProcesses,
        Self::ThroughRouter,
        Self::Python,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::OneProcess => "one process",
            Self::TwoProcesses => "two processes, one of them the router",
            Self::ThroughRouter => "two processes through a router",
            Self::Python => "Python through a router",
        }
    }
}

/// A process that ends with its standard input.
struct Peer(Child);

impl Peer {
    fn start(mut command: Command) -> Result<Self> {
        let child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .with_context(|| format!("starting {command:?}"))?;
        Ok(Self(child))
    }

    fn tangent(role: &str, endpoint: &str, realtime: bool) -> Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["bench", "peer", role, endpoint]);
        if realtime {
            command.arg("--realtime");
        }
        Self::start(command)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        // It ends by itself; a process that hangs must not stay.
        let begin = Instant::now();
        while matches!(self.0.try_wait(), Ok(None)) {
            if begin.elapsed() > Duration::from_secs(3) {
                let _ = self.0.kill();
                let _ = self.0.wait();
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Measures everything that can be measured here; what cannot goes to `skipped` with the reason.
///
/// # Errors
/// A process or a bus that cannot be started.
pub fn run(options: &BenchBus, skipped: &mut Vec<String>) -> Result<Vec<Row>> {
    let python_missing = python::missing(&options.python);
    if let Some(why) = &python_missing {
        skipped.push(format!("Python: skipped, because {why}"));
    }
    let mut rows = Vec::new();
    for loaded in [false, true] {
        let _load = loaded.then(Load::on_every_core);
        for realtime in [true, false] {
            let under = format!(
                "{}, {}",
                if loaded { "every core busy" } else { "idle" },
                if realtime { "SCHED_FIFO" } else { "normal" }
            );
            rows.extend(on_own_thread(
                realtime,
                || wake_up(options.seconds),
                &under,
            )?);
            if realtime {
                match cyclictest(options.seconds) {
                    Ok(us) => {
                        rows.extend(Row::of(format!("cyclictest -p {PRIORITY}, {under}"), us))
                    }
                    Err(why) if !loaded => {
                        skipped.push(format!("cyclictest: skipped, because {why:#}"))
                    }
                    Err(_) => {}
                }
            }
            for way in Way::ALL {
                if way == Way::Python && python_missing.is_some() {
                    continue;
                }
                for rate_hz in RATES_HZ {
                    eprintln!("{}, {rate_hz} Hz, {under}", way.name());
                    rows.extend(measure(way, rate_hz, realtime, &under, options)?);
                }
            }
        }
    }
    Ok(rows)
}

/// Runs `body` in a thread that is scheduled as asked; says when that was not granted.
fn on_own_thread(
    realtime: bool,
    body: impl FnOnce() -> Result<Vec<Row>> + Send,
    under: &str,
) -> Result<Vec<Row>> {
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            let refused = realtime && !setup_thread("bench", PRIORITY).scheduled;
            let mut rows = body()?;
            for row in &mut rows {
                row.name = format!("{}, {under}", row.name);
                if refused {
                    row.name.push_str(" (refused)");
                }
            }
            Ok(rows)
        });
        thread
            .join()
            .unwrap_or_else(|_| Err(anyhow!("the measuring thread panicked; this is a defect")))
    })
}

/// What the machine itself does: how late a thread wakes.
fn wake_up(seconds: f64) -> Result<Vec<Row>> {
    let period = Duration::from_secs_f64(1.0 / RATES_HZ[0]);
    let mut clock = DeadlineClock::new(period);
    let begin = Instant::now();
    let mut late_us = Vec::new();
    let mut deadlines = 0.0;
    while begin.elapsed().as_secs_f64() < seconds {
        let missed = clock.wait();
        deadlines += if missed == 0 { 1.0 } else { missed as f64 };
        if missed == 0 {
            late_us.push(
                (begin.elapsed().as_secs_f64() - deadlines * period.as_secs_f64()).max(0.0) * 1e6,
            );
        }
    }
    Ok(Row::of("timer wake-up", late_us).into_iter().collect())
}

/// The kernel people's own measure, of the same machine in the same minute.
fn cyclictest(seconds: f64) -> Result<Vec<f64>> {
    let loops = (seconds * RATES_HZ[0]).ceil().max(1.0);
    let output = Command::new("cyclictest")
        .args(["-q", "-i", "8000", "-h", "50000"])
        .args(["-l", &format!("{loops}"), "-p", &PRIORITY.to_string()])
        .output()
        .map_err(|error| anyhow!("it cannot be run ({error}): it is in the package rt-tests"))?;
    if !output.status.success() {
        bail!(
            "it failed: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let mut us = Vec::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let mut words = line.split_whitespace().map(str::parse::<u32>);
        if let (Some(Ok(bin)), Some(Ok(count))) = (words.next(), words.next()) {
            us.extend(std::iter::repeat_n(f64::from(bin), count as usize));
        }
    }
    Ok(us)
}

fn measure(
    way: Way,
    rate_hz: f64,
    realtime: bool,
    under: &str,
    options: &BenchBus,
) -> Result<Vec<Row>> {
    let endpoint = free_endpoint()?;
    let config = cell(&endpoint, realtime);
    // In the order in which they end: the answering process, then the router.
    let mut peers = Vec::new();
    let bus = match way {
        Way::OneProcess | Way::TwoProcesses => {
            Bus::open_until(&config, Role::Router, Some(CONNECT), &Stop::new())?
        }
        Way::ThroughRouter | Way::Python => {
            peers.push(Peer::tangent("router", &endpoint, realtime)?);
            Bus::open_until(&config, Role::Client, Some(CONNECT), &Stop::new())?
        }
    };
    let mut answering = None;
    match way {
        Way::OneProcess => answering = Some(echo(&bus)?),
        Way::Python => peers.push(Peer::start(python::echo(&options.python, &endpoint))?),
        Way::TwoProcesses | Way::ThroughRouter => {
            peers.push(Peer::tangent("echo", &endpoint, realtime)?);
        }
    }
    peers.reverse();
    let out = bus.publisher(&OUT)?;
    let back = bus.latest(&BACK)?;
    let name = format!("{}, {rate_hz} Hz", way.name());
    let rows = on_own_thread(
        realtime,
        move || round_trips(out, back, rate_hz, options.seconds, &name, way),
        under,
    );
    drop(answering);
    bus.close();
    drop(peers);
    rows
}

/// A free port, for the router of one measurement.
fn free_endpoint() -> Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0").context("finding a free port")?;
    Ok(format!("tcp/{}", listener.local_addr()?))
}

fn round_trips(
    out: Publisher<ArmState>,
    mut back: Latest<ArmState>,
    rate_hz: f64,
    seconds: f64,
    name: &str,
    way: Way,
) -> Result<Vec<Row>> {
    let mut state = ArmState::default();
    wait_for_echo(&out, &mut back, &mut state)
        .with_context(|| format!("{name}: nobody answers"))?;
    let mut clock = DeadlineClock::new(Duration::from_secs_f64(1.0 / rate_hz));
    let (mut trips_us, mut ages_us, mut lost) = (Vec::new(), Vec::new(), 0);
    let begin = Instant::now();
    while begin.elapsed().as_secs_f64() < seconds {
        clock.wait();
        state.cycle += 1;
        let (sent, sent_ns) = (Instant::now(), now_ns());
        out.publish(&state);
        match answer(&mut back, state.cycle, sent + PATIENCE) {
            Some((received, source_ns)) => {
                trips_us.push(received.duration_since(sent).as_secs_f64() * 1e6);
                ages_us.push((source_ns - sent_ns) as f64 * 1e-3);
            }
            None => lost += 1,
        }
    }
    let mut rows: Vec<Row> = Row::of(format!("{name}: there and back"), trips_us)
        .into_iter()
        .collect();
    for row in &mut rows {
        row.lost = Some(lost);
    }
    // Python hands our own stamp back, so it says nothing of the way there.
    if way != Way::Python {
        rows.extend(Row::of(format!("{name}: age on arrival"), ages_us));
    }
    Ok(rows)
}

fn wait_for_echo(
    out: &Publisher<ArmState>,
    back: &mut Latest<ArmState>,
    state: &mut ArmState,
) -> Result<()> {
    let begin = Instant::now();
    while begin.elapsed() < CONNECT {
        state.cycle += 1;
        out.publish(state);
        if answer(
            back,
            state.cycle,
            Instant::now() + Duration::from_millis(50),
        )
        .is_some()
        {
            return Ok(());
        }
    }
    bail!("no answer within {CONNECT:?}")
}

/// When the answer to `cycle` arrived here, and when it was sent.
fn answer(back: &mut Latest<ArmState>, cycle: u64, until: Instant) -> Option<(Instant, i64)> {
    loop {
        if let Some(received) = back.take_new()
            && received.message.cycle == cycle
        {
            return Some((received.received, received.source_time_ns));
        }
        if Instant::now() >= until {
            return None;
        }
        // Short against what is measured: the arrival was stamped by the thread that brought it.
        std::thread::sleep(Duration::from_micros(20));
    }
}
