//! `tangent bench requests`: from a stop to its answer and to a tool that slows down, in a cell of
//! its own, idle and flooded with every other request.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Bus, CellConfig, Role, Subscription};
use tangent_schemas::tangent::{ContactTruth, Request};
use tangent_schemas::topics::{self, queries};

use super::Row;
use crate::cli::BenchRequests;
use crate::faults::private_cell::{Layout, PrivateCell};

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// A tool that is slower than it ever was in so long before the stop slows down.
const BEFORE: Duration = Duration::from_millis(500);
/// And stays so: one that is slow for a moment by itself does not.
const STAYS: Duration = Duration::from_millis(40);

/// What the flood asks, without end: requests that wait, and some that are quick.
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

/// Measures.
///
/// # Errors
/// A cell that cannot be started, a tool that does not slide, a stop that is refused.
pub fn run(options: &BenchRequests) -> Result<Vec<Row>> {
    let folder = std::env::temp_dir().join(format!("tangent-bench-{}", std::process::id()));
    let mut cell = PrivateCell::start(&folder, options.port_offset, Layout::Apart, 1)?;
    let measured = measure(&mut cell, options.stops, &folder.join("cell.toml"));
    cell.end();
    std::fs::remove_dir_all(&folder).with_context(|| format!("removing {}", folder.display()))?;
    measured
}

fn measure(cell: &mut PrivateCell, stops: u32, file: &std::path::Path) -> Result<Vec<Row>> {
    let config = CellConfig::load(file)?;
    let truths = cell.bus.subscribe(&topics::TRUTH_CONTACT, 16_384)?;
    let mut rows = Vec::new();
    for flooded in [false, true] {
        let under = if flooded { "flooded" } else { "idle" };
        let (mut answers, mut falls) = (Vec::new(), Vec::new());
        for number in 1..=stops {
            eprintln!("{under}: stop {number} of {stops}");
            cell.slide()?;
            // Steadily.
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

/// Stops a tool that slides: times to the answer and to less speed, us.
fn stop(bus: &Bus, truths: &Subscription<ContactTruth>) -> Result<(f64, f64)> {
    let from_ns = now_ns() - BEFORE.as_nanos() as i64;
    let mut slowest = f64::INFINITY;
    while let Some(truth) = truths.try_recv() {
        if truth.source_time_ns >= from_ns {
            slowest = slowest.min(truth.message.sliding_speed_m_per_s);
        }
    }
    if !slowest.is_finite() {
        bail!("the simulator tells no truth");
    }
    let request = Request {
        action: "stop".to_owned(),
        argument: String::new(),
    };
    let (asked, asked_ns) = (Instant::now(), now_ns());
    let answer = bus.ask(queries::CONTROL_STOP, &request, PATIENCE)?;
    let answer_us = asked.elapsed().as_secs_f64() * 1e6;
    if !answer.done {
        bail!("the stop was refused: {}", answer.message);
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
    bail!("the tool does not slow down")
}

/// Everybody else who asks, each over a session of its own.
struct Flood {
    going: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Flood {
    /// Returns once each has had an answer or is under way with a slow request.
    fn start(config: &CellConfig) -> Result<Self> {
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
                    // Refusals are what most of it meets.
                    let _ = bus.ask(key, &request, PATIENCE);
                }
            }));
        }
        // The slow lanes are full by then.
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
