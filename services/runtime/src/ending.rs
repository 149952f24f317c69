//! Ends the process after a panic in any thread, or after a loop has stopped running.
//!
//! `main` calls [`on_panic`] once; a command that runs services passes its [`Stop`] to
//! [`in_order`]. From then on the first failure is written to the log with its name, all services
//! are asked to stop, and the process exits after [`GRACE`] at the latest. A process that continued
//! without one of its threads would seem healthy and do nothing.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::panic::PanicHookInfo;
use std::sync::OnceLock;
use std::time::Duration;

use signal_hook::low_level;

use crate::log;
use crate::stop::Stop;

/// Time for the other services to stop in order: the recorder closes its file, the bridge brings
/// the arm to rest.
pub const GRACE: Duration = Duration::from_secs(5);
/// Time for the log to be written before the process exits.
const LAST_WORDS: Duration = Duration::from_secs(1);
/// Exit code of a failure.
const FAILED: i32 = 1;

static PROCESS_STOP: OnceLock<Stop> = OnceLock::new();
static CAUSE: OnceLock<String> = OnceLock::new();

/// Makes a panic in any thread end the process. Call it once, at the start of `main`.
pub fn on_panic() {
    std::panic::set_hook(Box::new(|panic| {
        let words = describe(panic);
        let trace = Backtrace::capture();
        if trace.status() == BacktraceStatus::Captured {
            for line in trace.to_string().lines() {
                log::line(line);
            }
        }
        end(words);
    }));
}

/// Makes [`end`] trigger `stop` and wait before it ends the process.
pub fn in_order(stop: &Stop) {
    let _ = PROCESS_STOP.set(stop.clone());
}

/// Reason why the process ends; `None` if it has not failed.
pub fn cause() -> Option<&'static str> {
    CAUSE.get().map(String::as_str)
}

/// Ends the process with the error `words`. It exits at once if [`in_order`] was not called, else
/// when all services have stopped or [`GRACE`] is over.
pub fn end(words: String) {
    log::line(&format!("ERROR {words}"));
    let first = CAUSE.set(words).is_ok();
    let Some(stop) = PROCESS_STOP.get() else {
        log::flush(LAST_WORDS);
        low_level::exit(FAILED);
    };
    stop.trigger();
    if !first {
        return;
    }
    let cut_off = std::thread::Builder::new().name("end".into()).spawn(|| {
        Stop::new().wait(GRACE);
        log::line(&format!(
            "ERROR not all threads ended within {} s: the process is killed",
            GRACE.as_secs()
        ));
        log::flush(LAST_WORDS);
        low_level::exit(FAILED);
    });
    if cut_off.is_err() {
        log::flush(LAST_WORDS);
        low_level::exit(FAILED);
    }
}

fn describe(panic: &PanicHookInfo<'_>) -> String {
    let payload = panic.payload();
    let said = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    let thread = std::thread::current();
    let place = panic
        .location()
        .map_or_else(String::new, |place| format!(" at {place}"));
    format!(
        "thread `{}` panicked{place}: {said}; this is a defect, and the process ends",
        thread.name().unwrap_or("without a name")
    )
}
