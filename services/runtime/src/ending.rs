//! What ends the process: a panic in any of its threads, or a loop that stands still. One place
//! decides how.
//!
//! `main` calls [`on_panic`] once; a command that runs services hands over its [`Stop`] with
//! [`in_order`]. From then on the first thing that goes wrong is written to the log with its name,
//! everybody is told to stop, and what has not ended after [`GRACE`] is cut off. A process that
//! lives on without one of its threads would look well and do nothing.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::panic::PanicHookInfo;
use std::sync::OnceLock;
use std::time::Duration;

use signal_hook::low_level;

use crate::{Stop, log};

/// Time that the other services get to end in order: the recorder closes its file, the bridge
/// brings the arm to rest.
pub const GRACE: Duration = Duration::from_secs(5);
/// Time that the log gets to be written before the process is gone.
const LAST_WORDS: Duration = Duration::from_secs(1);
/// Exit code: failed.
const FAILED: i32 = 1;

static EVERYBODY: OnceLock<Stop> = OnceLock::new();
static CAUSE: OnceLock<String> = OnceLock::new();

/// From now on a panic in any thread ends the process. Once, at the start of `main`.
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

/// From now on everybody who holds `stop` is told to end before the process does.
pub fn in_order(stop: &Stop) {
    let _ = EVERYBODY.set(stop.clone());
}

/// Why the process ends, where it does for one of the reasons above.
pub fn cause() -> Option<&'static str> {
    CAUSE.get().map(String::as_str)
}

/// Ends the process with an error in `words`: at once where no supervisor has to be notified, else
/// when everybody has ended or [`GRACE`] is over.
pub fn end(words: String) {
    log::line(&format!("ERROR {words}"));
    let first = CAUSE.set(words).is_ok();
    let Some(stop) = EVERYBODY.get() else {
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
            "ERROR not everything ended within {GRACE:?}: the process is cut off"
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
