//! The terminal on standard error: progress bars, and log lines above them.
//!
//! All bars belong to one [`MultiProgress`]. The log's thread writes through [`LogSink`], which
//! takes the bars away for the moment of a line and draws them again below it, so that neither
//! overwrites the other.

use std::io::{self, IsTerminal, Write};
use std::sync::LazyLock;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use tangent_runtime::log;

static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// A progress bar of one line. `{wide_msg}` in the template is cut to the terminal's width.
pub fn bar(length: u64, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).expect("the template is well formed");
    BARS.add(ProgressBar::new(length)).with_style(style)
}

/// Writes one line to standard error, above any bar, in order with the lines of the log.
pub fn say(text: &str) {
    log::line(text);
}

/// Whether standard error is a terminal that may get colours: not redirected, and the variable
/// NO_COLOR is not set.
pub fn has_colours() -> bool {
    let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    io::stderr().is_terminal() && !refused
}

/// Standard error as the log's thread writes to it.
pub struct LogSink {
    has_bars: bool,
}

impl LogSink {
    /// Sink for this process's standard error.
    pub fn new() -> Self {
        Self {
            has_bars: io::stderr().is_terminal(),
        }
    }
}

impl Write for LogSink {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        // A pipe without a reader blocks this thread; it must not hold the lock of the bars then.
        let write = || io::stderr().write_all(text);
        if self.has_bars {
            BARS.suspend(write)?;
        } else {
            write()?;
        }
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
