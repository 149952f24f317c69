//! `tangent bench requests`: time from a stop request to its answer, and to a slower tool, in a
//! private cell, idle and flooded with all other requests.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_faults::{Layout, PrivateCell, Setup};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Bus, CellConfig, Role, Subscription};
use tangent_schemas::tangent::{ContactTruth, Request};
use tangent_schemas::topics::{self, queries};

use crate::error::BenchError;
use crate::row::Row;

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// The tool slows down once its speed falls below its minimum in this time before the stop.
const BEFORE: Duration = Duration::from_millis(500);
/// The speed must stay lower for this time: a short dip does not count.
const STAYS: Duration = Duration::from_millis(40);

/// Requests that the flood repeats without end: some that wait, and some that return quickly.
const FLOOD: [(&str, &str, &str); 7] = [
    (queries::CONTROL_TASK, "start", NOBODY),
    (queries::CONTROL_SELECT, "select", "nobody"),
    ("rtde/unlock", "", ""),
    ("param/controller/force_reference_n", "get", ""),
    (queries::CONTROL_TASK, "status", ""),
    (queries::CONTROL_TASK, "resume", ""),
    ("parameters/netft", "list", ""),
];
/// A start that waits for seven estimators that do not exist.
const NOBODY: &str = "name = \"nobody\"\nestimators = [\"n1\", \"n2\", \"n3\", \"n4\", \"n5\", \"n6\", \"n7\"]\n\
    force.reference_n = 3.0\n[path]\nkind = \"line\"\nto_m = [0.01, 0.0]\nspeed_m_per_s = 0.02\n";

/// Settings of the measurement.
#[derive(Clone, Debug)]
pub struct Options {
    /// Number of stops measured with the flood, and again without it.
    pub stops: u32,
    /// Added to all ports of the cell.
    pub port_offset: u16,
    /// The `tangent` program, whose services make up the cell.
    pub program: PathBuf,
}

/// Runs the measurement.
///
/// # Errors
/// The cell cannot be started, the tool does not slide, or a stop is refused.
pub fn run(options: &Options) -> Result<Vec<Row>, BenchError> {
    let setup = Setup {
        program: options.program.clone(),
        port_offset: options.port_offset,
        seed: 1,
    };
    let folder = std::env::temp_dir().join(format!("tangent-bench-{}", std::process::id()));
    let mut cell = PrivateCell::start(&folder, Layout::Apart, &setup)?;
    let measured = measure(&mut cell, options.stops, &folder.join("cell.toml"));
    cell.end();
    match std::fs::remove_dir_all(&folder) {
        Ok(()) => measured,
        Err(source) => Err(BenchError::Remove { folder, source }),
    }
}

fn measure(cell: &mut PrivateCell, stops: u32, file: &Path) -> Result<Vec<Row>, BenchError> {
    let config = CellConfig::load(file)?;
    let truths = cell.bus.subscribe(&topics::TRUTH_CONTACT, 16_384)?;
    let mut rows = Vec::new();
    for flooded in [false, true] {
        let under = if flooded { "flooded" } else { "idle" };
        let (mut answers, mut falls) = (Vec::new(), Vec::new());
        for number in 1..=stops {
            eprintln!("{under}: stop {number} of {stops}");
            cell.slide()?;
            // Lets the tool reach a steady speed.
            std::thread::sleep(2 * BEFORE);
            let flood = flooded.then(|| Flood::start(&config)).transpose()?;
            let (answer_us, fall_us) = stop(&cell.bus, &truths)?;
            answers.push(answer_us);
            falls.push(fall_us);
            if let Some(flood) = flood {
                flood.end();
            }
        }
        rows.extend(Row::of(format!("stop to its answer, {under}"), answers));
        rows.extend(Row::of(format!("stop to a slower tool, {under}"), falls));
    }
    Ok(rows)
}

/// Stops a sliding tool. Returns the times to the answer and to a lower speed, µs.
fn stop(bus: &Bus, truths: &Subscription<ContactTruth>) -> Result<(f64, f64), BenchError> {
    let from_ns = now_ns() - BEFORE.as_nanos() as i64;
    let mut slowest = f64::INFINITY;
    while let Some(truth) = truths.try_recv() {
        if truth.source_time_ns >= from_ns {
            slowest = slowest.min(truth.message.sliding_speed_m_per_s);
        }
    }
    if !slowest.is_finite() {
        return Err(BenchError::Failed(
            "the simulator publishes no truth".to_owned(),
        ));
    }
    let request = Request {
        action: "stop".to_owned(),
        argument: String::new(),
    };
    let (asked, asked_ns) = (Instant::now(), now_ns());
    let answer = bus.ask(queries::CONTROL_STOP, &request, PATIENCE)?;
    let answer_us = asked.elapsed().as_secs_f64() * 1e6;
    if !answer.done {
        let words = format!("the stop was refused: {}", answer.message);
        return Err(BenchError::Failed(words));
    }
    let mut fell_ns = None;
    while let Some(truth) = truths.recv_timeout(PATIENCE) {
        let since_ns = truth.source_time_ns - asked_ns;
        if since_ns <= 0 || truth.message.sliding_speed_m_per_s >= slowest {
            fell_ns = None;
        } else if since_ns - *fell_ns.get_or_insert(since_ns) > STAYS.as_nanos() as i64 {
            return Ok((answer_us, fell_ns.unwrap_or(since_ns) as f64 * 1e-3));
        }
    }
    Err(BenchError::Failed("the tool does not slow down".to_owned()))
}

/// All the other clients, each with a session of its own.
struct Flood {
    going: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Flood {
    /// Returns once each client has had an answer or has a slow request under way.
    fn start(config: &CellConfig) -> Result<Self, BenchError> {
        let going = Arc::new(AtomicBool::new(true));
        let mut threads = Vec::new();
        for (key, action, argument) in FLOOD {
            let bus = Bus::open_within(config, Role::Client, PATIENCE)?;
            let going = Arc::clone(&going);
            let request = Request {
                action: action.to_owned(),
                argument: argument.to_owned(),
            };
            threads.push(std::thread::spawn(move || {
                while going.load(Ordering::Acquire) {
                    // Most of these requests are refused.
                    let _ = bus.ask(key, &request, PATIENCE);
                }
            }));
        }
        // By then, the queues of slow requests are full.
        std::thread::sleep(Duration::from_millis(100));
        Ok(Self { going, threads })
    }

    fn end(self) {
        self.going.store(false, Ordering::Release);
        for thread in self.threads {
            let _ = thread.join();
        }
    }
}
