//! Two pages at 20 Hz for a long time, against a cell that slides: the service must not grow.
//!
//! `TANGENT_SOAK_S` is the length in s, 20 without it. The bounds are the same for any length.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tangent_live::live_beside_others;

use crate::{Served, ask, post, processor_s};

/// Length without the variable, s.
const SHORT_S: f64 = 20.0;
/// Time before the first sample: buffers have their size, and the first strokes of the task are in
/// the dose map.
const WARM_UP: Duration = Duration::from_secs(10);
/// Interval of the samples.
const SAMPLE: Duration = Duration::from_millis(500);
/// Time with one page alone at the end.
const ALONE: Duration = Duration::from_secs(10);
/// Largest growth of the memory in the whole time, by the slope of its samples, bytes.
const GROWTH_MAX: f64 = 2e6;
/// Largest growth of the number of descriptors, by the slope of its samples: a connection that is
/// open in one sample is none.
const DESCRIPTORS_MAX: f64 = 2.0;

/// What a browser does: reads the stream, says that it is there, and reads the dose.
struct Page {
    open: Arc<AtomicBool>,
    frames: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl Page {
    fn open(served: &Served, name: &'static str) -> Self {
        let (open, frames) = (Arc::new(AtomicBool::new(true)), Arc::new(AtomicU64::new(0)));
        let (host, token) = (served.host(), served.token());
        let reader = std::thread::spawn({
            let (host, open, frames) = (host.clone(), Arc::clone(&open), Arc::clone(&frames));
            move || read(&host, &open, &frames)
        });
        let asking = std::thread::spawn({
            let open = Arc::clone(&open);
            move || {
                let mut since = (0, 0);
                while open.load(Ordering::Relaxed) {
                    post(&host, &token, "/api/here", &json!({ "page": name }));
                    let path = format!("/api/dose?epoch={}&revision={}", since.0, since.1);
                    let dose = ask(&host, &format!("GET {path} HTTP/1.0"), "");
                    let dose: Value = serde_json::from_str(&dose).unwrap();
                    let number = |key: &str| dose[key].as_u64().unwrap();
                    since = (number("epoch"), number("revision"));
                    std::thread::sleep(Duration::from_millis(600));
                }
            }
        });
        Self {
            open,
            frames,
            threads: vec![reader, asking],
        }
    }

    fn close(self) {
        self.open.store(false, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().unwrap();
        }
    }
}

fn read(host: &str, open: &AtomicBool, frames: &AtomicU64) {
    let mut stream = TcpStream::connect(host).unwrap();
    let head = format!("GET /api/stream HTTP/1.0\r\nHost: {host}\r\n\r\n");
    stream.write_all(head.as_bytes()).unwrap();
    for line in BufReader::new(stream).lines() {
        if line.unwrap().starts_with("data: ") {
            frames.fetch_add(1, Ordering::Relaxed);
        }
        if !open.load(Ordering::Relaxed) {
            return;
        }
    }
    panic!("the stream ended");
}

/// Resident memory of a process, bytes.
fn memory(id: u32) -> f64 {
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    let kb = line.unwrap().split_whitespace().nth(1).unwrap();
    kb.parse::<f64>().unwrap() * 1024.0
}

/// Number of open file descriptors of a process.
fn descriptors(id: u32) -> f64 {
    fs::read_dir(format!("/proc/{id}/fd")).unwrap().count() as f64
}

/// Slope of the samples by time, least squares, per s.
fn slope(samples: &[(f64, f64)]) -> f64 {
    let n = samples.len() as f64;
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| samples.iter().map(of).sum::<f64>() / n;
    let (t, y) = (mean(&|s| s.0), mean(&|s| s.1));
    let covariance = mean(&|s| (s.0 - t) * (s.1 - y));
    covariance / mean(&|s| (s.0 - t).powi(2))
}

#[test]
fn two_pages_for_a_long_time_do_not_let_the_service_grow() {
    live_beside_others(|| {
        let length_s =
            std::env::var("TANGENT_SOAK_S").map_or(SHORT_S, |text| text.parse().unwrap());
        // A stroke takes 2 s at least.
        let strokes = (length_s / 2.0) as u32 + 60;
        let served = Served::start("nothing", &[("long", true, strokes)]);
        served.begin("long.toml");
        served.phase("slide");
        let id = served.ui.id();
        let pages = ["one", "two"].map(|name| Page::open(&served, name));
        std::thread::sleep(WARM_UP);
        let (began, used) = (Instant::now(), processor_s(id));
        let before: Vec<u64> = pages
            .iter()
            .map(|p| p.frames.load(Ordering::Relaxed))
            .collect();
        let (mut memories, mut counts) = (Vec::new(), Vec::new());
        while began.elapsed().as_secs_f64() < length_s {
            let at_s = began.elapsed().as_secs_f64();
            memories.push((at_s, memory(id)));
            counts.push((at_s, descriptors(id)));
            std::thread::sleep(SAMPLE);
        }
        let took_s = began.elapsed().as_secs_f64();
        let share = (processor_s(id) - used) / took_s;
        let rates: Vec<f64> = pages
            .iter()
            .zip(before)
            .map(|(page, before)| (page.frames.load(Ordering::Relaxed) - before) as f64 / took_s)
            .collect();
        let state = served.seen("it still slides", |_| true);
        assert_eq!(state["task"]["active"], true, "{}", state["task"]);

        let [one, two] = pages;
        two.close();
        let (began, used) = (Instant::now(), processor_s(id));
        std::thread::sleep(ALONE);
        let alone = (processor_s(id) - used) / began.elapsed().as_secs_f64();
        one.close();

        let (growth, opened) = (slope(&memories) * took_s, slope(&counts) * took_s);
        let most = |samples: &[(f64, f64)]| samples.iter().map(|s| s.1).fold(0.0, f64::max);
        println!(
            "{took_s:.0} s, pages at {rates:.1?} Hz: memory {:.1} to {:.1} MB, at most {:.1} MB, slope {:.2} MB/h; \
             descriptors at most {}, slope {:.2} per h; {:.1} % of a core with two pages, {:.1} % with one",
            memories[0].1 / 1e6,
            memories.last().unwrap().1 / 1e6,
            most(&memories) / 1e6,
            slope(&memories) * 3600.0 / 1e6,
            most(&counts),
            slope(&counts) * 3600.0,
            100.0 * share,
            100.0 * alone,
        );
        assert!(growth < GROWTH_MAX, "memory grows by {growth:.0} bytes");
        assert!(
            opened < DESCRIPTORS_MAX,
            "{opened:.1} descriptors are left open"
        );
        assert!(rates.iter().all(|hz| *hz > 5.0), "{rates:?}");
    });
}
