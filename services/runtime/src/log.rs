//! Log of the process: lines go through a lock-free ring to one writing thread, so that no other
//! thread waits for the output.
//!
//! `main` starts it and passes it to `tracing`. A pipe without a reader blocks the thread that
//! writes to it; here only the writing thread blocks. Lines are dropped and counted while the ring
//! is full, and the count is logged as soon as lines can be written again.

use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;
use std::time::{Duration, Instant};

use crate::places::without_places;
use crate::ring::Ring;

/// Largest length of a line, bytes; longer lines are cut off.
const LINE_BYTES: usize = 1024;
/// Number of lines that may wait to be written.
const LINES: usize = 512;
/// End of a line that was cut off.
const CUT: &[u8] = "…\n".as_bytes();
/// Interval between two checks of [`Log::flush`].
const LOOK: Duration = Duration::from_millis(1);

/// A line in the ring.
struct Line {
    length: usize,
    bytes: [u8; LINE_BYTES],
}

struct Shared {
    ring: Ring<Line>,
    pushed: AtomicU64,
    written: AtomicU64,
    dropped: AtomicU64,
    writer: OnceLock<Thread>,
}

/// A log. Clones write to the same one.
#[derive(Clone)]
pub struct Log {
    shared: Arc<Shared>,
}

static INSTALLED: OnceLock<Log> = OnceLock::new();

impl Log {
    /// Starts a log whose thread writes to `sink`, line by line.
    ///
    /// # Errors
    /// The system refused a thread.
    pub fn start(sink: impl Write + Send + 'static) -> io::Result<Self> {
        let shared = Arc::new(Shared {
            ring: Ring::new(LINES),
            pushed: AtomicU64::new(0),
            written: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            writer: OnceLock::new(),
        });
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("log".into())
            .spawn(move || write_lines(&own, sink))?;
        let _ = shared.writer.set(thread.thread().clone());
        Ok(Self { shared })
    }

    /// Makes this the process's log, for [`line()`] and [`dropped`]. Only the first call has an
    /// effect.
    pub fn install(&self) {
        let _ = INSTALLED.set(self.clone());
    }

    /// Writes one line, which ends with a newline. Takes no lock, allocates nothing and never
    /// waits: for real-time threads too.
    pub fn line(&self, text: &[u8]) {
        let mut line = Line {
            length: text.len().min(LINE_BYTES),
            bytes: [0; LINE_BYTES],
        };
        if text.len() <= LINE_BYTES {
            line.bytes[..text.len()].copy_from_slice(text);
        } else {
            let kept = LINE_BYTES - CUT.len();
            line.bytes[..kept].copy_from_slice(&text[..kept]);
            line.bytes[kept..].copy_from_slice(CUT);
        }
        // Counted before it can be written, so that the count of written lines is never greater.
        self.shared.pushed.fetch_add(1, Ordering::AcqRel);
        if self.shared.ring.push(line).is_err() {
            self.shared.written.fetch_add(1, Ordering::AcqRel);
            self.shared.dropped.fetch_add(1, Ordering::AcqRel);
            return;
        }
        if let Some(writer) = self.shared.writer.get() {
            writer.unpark();
        }
    }

    /// Number of lines that were dropped since the start.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Acquire)
    }

    /// Waits until all earlier lines are written, for at most `at_most`; false if the time is up.
    /// Call it before the process ends.
    pub fn flush(&self, at_most: Duration) -> bool {
        let until = self.shared.pushed.load(Ordering::Acquire);
        let deadline = Instant::now() + at_most;
        while self.shared.written.load(Ordering::Acquire) < until {
            if Instant::now() >= deadline {
                return false;
            }
            std::thread::park_timeout(LOOK);
        }
        true
    }

    /// Writer for `tracing`.
    pub fn writer(&self) -> LineWriter {
        LineWriter(self.clone())
    }
}

/// Writes each buffer as one line, without places in Zenoh's source code.
pub struct LineWriter(Log);

impl Write for LineWriter {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        match std::str::from_utf8(line) {
            Ok(text) => self.0.line(without_places(text).as_bytes()),
            Err(_) => self.0.line(line),
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes a line to the process's log, or to standard error if there is none yet.
pub fn line(text: &str) {
    match INSTALLED.get() {
        Some(log) => log.line(format!("{text}\n").as_bytes()),
        None => {
            let _ = writeln!(io::stderr(), "{text}");
        }
    }
}

/// [`Log::flush`] of the process's log.
pub fn flush(at_most: Duration) -> bool {
    INSTALLED.get().is_none_or(|log| log.flush(at_most))
}

/// Lines that the process's log has dropped since its start.
pub fn dropped() -> u64 {
    INSTALLED.get().map_or(0, Log::dropped)
}

fn write_lines(shared: &Shared, mut sink: impl Write) {
    let mut told = 0;
    loop {
        while let Some(line) = shared.ring.pop() {
            // There is no place left to report that the log cannot be written.
            let _ = sink.write_all(&line.bytes[..line.length]);
            shared.written.fetch_add(1, Ordering::AcqRel);
        }
        let dropped = shared.dropped.load(Ordering::Acquire);
        if dropped > told {
            let lost = dropped - told;
            told = dropped;
            let _ = writeln!(
                sink,
                "{lost} lines of the log were dropped: the reader of this process's standard error is too slow"
            );
            continue;
        }
        let _ = sink.flush();
        std::thread::park();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Condvar, Mutex};

    const PATIENCE: Duration = Duration::from_secs(20);

    /// A pipe whose reader is blocked until the test lets it read.
    #[derive(Clone, Default)]
    struct Stuck {
        open: Arc<(Mutex<bool>, Condvar)>,
        text: Arc<Mutex<Vec<u8>>>,
    }

    impl Stuck {
        fn open(&self) {
            *self.open.0.lock().unwrap() = true;
            self.open.1.notify_all();
        }

        fn text(&self) -> String {
            String::from_utf8(self.text.lock().unwrap().clone()).unwrap()
        }
    }

    impl Write for Stuck {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut open = self.open.0.lock().unwrap();
            while !*open {
                open = self.open.1.wait(open).unwrap();
            }
            self.text.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn no_thread_waits_for_a_slow_reader_and_lost_lines_are_counted() {
        let stuck = Stuck::default();
        let log = Log::start(stuck.clone()).unwrap();
        let many = 4 * LINES as u64;
        // The loop ends although no line can be written.
        for n in 0..many {
            log.line(format!("line {n}\n").as_bytes());
        }
        assert!(!log.flush(Duration::from_millis(5)));
        let dropped = log.dropped();
        assert!(dropped >= many - LINES as u64 - 1, "{dropped}");
        stuck.open();
        assert!(log.flush(PATIENCE));
        // The count is written after the lines that were kept.
        log.line(b"last\n");
        assert!(log.flush(PATIENCE));
        let text = stuck.text();
        assert!(text.starts_with("line 0\nline 1\n"), "{text}");
        assert!(
            text.contains(&format!("{dropped} lines of the log were dropped")),
            "{text}"
        );
        assert!(text.contains("last\n"));
        assert_eq!(text.matches("line ").count() as u64, many - dropped);
    }

    #[test]
    fn a_long_line_is_cut_and_ends_where_a_line_ends() {
        let stuck = Stuck::default();
        stuck.open();
        let log = Log::start(stuck.clone()).unwrap();
        log.line(&[b'x'; 5000]);
        log.writer().write_all(b"next\n").unwrap();
        assert!(log.flush(PATIENCE));
        let text = stuck.text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2);
        assert!(lines[0].ends_with("x…") && lines[0].len() == LINE_BYTES - 1);
    }

    #[test]
    fn a_path_of_the_machine_that_built_the_program_is_left_out() {
        let stuck = Stuck::default();
        stuck.open();
        let log = Log::start(stuck.clone()).unwrap();
        let line = b" WARN no link at /home/builder/.cargo/zenoh/src/link.rs:36.\n";
        log.writer().write_all(line).unwrap();
        assert!(log.flush(PATIENCE));
        assert_eq!(stuck.text(), " WARN no link\n");
    }
}
