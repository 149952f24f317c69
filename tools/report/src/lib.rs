//! The report on a recorded run: figures, plots, and a page that needs nothing else.
//!
//! A recording (`.mcap`, as `tangent record` or `tangent up` makes it) is read into a
//! [`run::Run`], the messages in order. One task, by default the last, is cut out as a [`TaskRun`],
//! one entry per robot cycle. From these come the [`Report`], whose figures are defined as in
//! `tangent evaluate`, and the HTML page. `tangent report` and `tangent up` call [`read`] and
//! [`write_for`]; `tangent estimator` uses the comparison of estimators, and
//! `tangent reproduce` the plots.
//!
//! | module | contents |
//! |---|---|
//! | [`run`] | the messages of a recording, or of a live cell |
//! | [`live`] | the estimators of a live cell, recorded for a while |
//! | [`object`], [`tactile`] | data of a single law or estimator, and the figures of its paper |
//! | [`coverage`] | what a task with `[coverage]` has covered, in words |
//! | [`plot`] | line plots as SVG |

mod acceptance;
mod comparison;
pub mod coverage;
mod difference;
mod error;
mod events;
mod figures;
mod files;
mod html;
pub mod live;
pub mod object;
pub mod plot;
pub mod run;
mod shown_time;
pub mod tactile;
mod task_run;
mod tasks;
#[cfg(test)]
mod tests;
mod words;

pub use acceptance::Judged;
pub use comparison::{EstimatorFigures, Switch, estimators, words as estimator_words};
pub use difference::{Compared, Difference, Setting};
pub use error::ReportError;
pub use figures::{LoopFigures, Quantiles, RecordingFigures, Report};
pub use files::{Part, Read, beside, compare, read, recordings, write_for, write_page};
pub use task_run::{Cycle, TaskRun};
pub use tasks::TaskEntry;
pub use words::words;
