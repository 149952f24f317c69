//! `tangent bench bus`: round-trip time from a packet to its answer, and age of a message on
//! arrival, within one process and between processes, idle and loaded, with and without SCHED_FIFO.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tangent_runtime::clock::{DeadlineClock, now_ns};
use tangent_runtime::realtime::setup_thread;
use tangent_runtime::{Bus, Latest, Publisher, Role, Stop};
use tangent_schemas::tangent::ArmState;

use crate::error::BenchError;
use crate::load::Load;
use crate::peer::{BACK, OUT, cell, echo};
use crate::python;
use crate::row::Row;

/// Rates of the loop, Hz: a CB3, and a torque-controlled arm.
const RATES_HZ: [f64; 2] = [125.0, 1000.0];
/// SCHED_FIFO priority of the measuring thread, as for the control loop.
const PRIORITY: u8 = 80;
/// An answer that takes longer counts as lost.
const PATIENCE: Duration = Duration::from_millis(500);
/// Longest time to connect; it is not part of the measurement.
const CONNECT: Duration = Duration::from_secs(10);

/// Settings of the measurement.
#[derive(Clone, Debug)]
pub struct Options {
    /// Length of each measurement, s.
    pub seconds: f64,
    /// Python interpreter with eclipse-zenoh installed.
    pub python: String,
    /// The `tangent` program, which runs the other ends.
    pub program: PathBuf,
}

/// Where the answering side runs, and how its messages travel.
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

/// A child process that ends when its standard input is closed.
struct Peer(Child);

impl Peer {
    fn start(mut command: Command) -> Result<Self, BenchError> {
        let child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|source| BenchError::Start {
                command: format!("{command:?}"),
                source,
            })?;
        Ok(Self(child))
    }

    fn tangent(
        program: &Path,
        role: &str,
        endpoint: &str,
        realtime: bool,
    ) -> Result<Self, BenchError> {
        let mut command = Command::new(program);
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
        // The process ends by itself; one that hangs is killed.
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

/// Measures everything that this machine allows. The rest goes to `skipped` with the reason.
///
/// # Errors
/// A process or a bus cannot be started.
pub fn run(options: &Options, skipped: &mut Vec<String>) -> Result<Vec<Row>, BenchError> {
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
                        skipped.push(format!("cyclictest: skipped, because {why}"))
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

/// Runs `body` in a thread with the requested scheduling; reports if that was not granted.
fn on_own_thread(
    realtime: bool,
    body: impl FnOnce() -> Result<Vec<Row>, BenchError> + Send,
    under: &str,
) -> Result<Vec<Row>, BenchError> {
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
        thread.join().unwrap_or(Err(BenchError::Panicked))
    })
}

/// Baseline of the machine itself: how late a thread wakes up.
fn wake_up(seconds: f64) -> Result<Vec<Row>, BenchError> {
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

/// Wake-up latency by `cyclictest` on the same machine in the same minute, for comparison, µs.
fn cyclictest(seconds: f64) -> Result<Vec<f64>, BenchError> {
    let loops = (seconds * RATES_HZ[0]).ceil().max(1.0);
    let output = Command::new("cyclictest")
        .args(["-q", "-i", "8000", "-h", "50000"])
        .args(["-l", &format!("{loops}"), "-p", &PRIORITY.to_string()])
        .output()
        .map_err(|error| {
            let words = format!("it cannot be run ({error}); it is in the package rt-tests");
            BenchError::Failed(words)
        })?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(BenchError::Failed(format!("it failed: {}", said.trim())));
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
    options: &Options,
) -> Result<Vec<Row>, BenchError> {
    let endpoint = free_endpoint()?;
    let config = cell(&endpoint, realtime);
    // In the order in which they end: the answering process, then the router.
    let mut peers = Vec::new();
    let bus = match way {
        Way::OneProcess | Way::TwoProcesses => {
            Bus::open_until(&config, Role::Router, Some(CONNECT), &Stop::new())?
        }
        Way::ThroughRouter | Way::Python => {
            peers.push(Peer::tangent(
                &options.program,
                "router",
                &endpoint,
                realtime,
            )?);
            Bus::open_until(&config, Role::Client, Some(CONNECT), &Stop::new())?
        }
    };
    let mut answering = None;
    match way {
        Way::OneProcess => answering = Some(echo(&bus)?),
        Way::Python => peers.push(Peer::start(python::echo(&options.python, &endpoint))?),
        Way::TwoProcesses | Way::ThroughRouter => {
            peers.push(Peer::tangent(
                &options.program,
                "echo",
                &endpoint,
                realtime,
            )?);
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
fn free_endpoint() -> Result<String, BenchError> {
    let listener = TcpListener::bind("127.0.0.1:0").map_err(BenchError::Port)?;
    let address = listener.local_addr().map_err(BenchError::Port)?;
    Ok(format!("tcp/{address}"))
}

fn round_trips(
    out: Publisher<ArmState>,
    mut back: Latest<ArmState>,
    rate_hz: f64,
    seconds: f64,
    name: &str,
    way: Way,
) -> Result<Vec<Row>, BenchError> {
    let mut state = ArmState::default();
    if !echo_answers(&out, &mut back, &mut state) {
        return Err(no_answer(name, CONNECT));
    }
    let mut clock = DeadlineClock::new(Duration::from_secs_f64(1.0 / rate_hz));
    let (mut trips_us, mut ages_us, mut lost) = (Vec::new(), Vec::new(), 0);
    let begin = Instant::now();
    // A short measurement on a disturbed machine goes on until one answer has come.
    let patience = CONNECT.max(Duration::from_secs_f64(seconds));
    while begin.elapsed().as_secs_f64() < seconds || trips_us.is_empty() {
        if trips_us.is_empty() && begin.elapsed() > patience {
            return Err(no_answer(name, patience));
        }
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
    // The Python echo returns the original stamp, so the one-way age is unknown.
    if way != Way::Python {
        rows.extend(Row::of(format!("{name}: age on arrival"), ages_us));
    }
    Ok(rows)
}

fn no_answer(name: &str, within: Duration) -> BenchError {
    BenchError::NoAnswer {
        name: name.to_owned(),
        within,
    }
}

/// Sends until an answer arrives; false after [`CONNECT`].
fn echo_answers(
    out: &Publisher<ArmState>,
    back: &mut Latest<ArmState>,
    state: &mut ArmState,
) -> bool {
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
            return true;
        }
    }
    false
}

/// Arrival time of the answer to `cycle`, and the time at which it was sent.
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
        // Short compared with what is measured; the receiving thread stamps the arrival.
        std::thread::sleep(Duration::from_micros(20));
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Rows of a measurement of 0.1 s whose other end answers the first cycle, and then only those
    /// that `answers` lets pass.
    fn rows(answers: fn(u64) -> bool) -> Result<Vec<Row>, BenchError> {
        let config = cell(&free_endpoint().unwrap(), false);
        let bus = Bus::open_until(&config, Role::Router, Some(CONNECT), &Stop::new()).unwrap();
        let back = bus.publisher(&BACK).unwrap();
        let answering = bus.on(&OUT, move |received| {
            if received.message.cycle == 1 || answers(received.message.cycle) {
                back.publish(&received.message);
            }
        });
        let (out, back) = (bus.publisher(&OUT).unwrap(), bus.latest(&BACK).unwrap());
        let rows = round_trips(out, back, RATES_HZ[0], 0.1, "bus", Way::OneProcess);
        drop(answering);
        bus.close();
        rows
    }

    #[test]
    fn a_stall_longer_than_the_measurement_leaves_no_row_out() {
        let rows = rows(|cycle| cycle > 3).unwrap();
        assert_eq!(rows.len(), 2);
        // Two, unless the machine was disturbed before the measurement began.
        assert!(rows[0].n > 0 && rows[0].lost <= Some(2), "{rows:?}");
    }

    #[test]
    fn an_end_that_stops_answering_is_an_error() {
        let error = rows(|_| false).unwrap_err();
        assert!(
            matches!(&error, BenchError::NoAnswer { name, .. } if name == "bus"),
            "{error}"
        );
    }
}
