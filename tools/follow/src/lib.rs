//! One task of a live cell from its start to its end.
//!
//! [`start_when_ready`] waits until robot, sensor and controller are ready, and starts the task.
//! [`follow()`] does so too, then reports the controller's state to a [`FollowView`] until the task
//! ends. On a stop before the end, it retracts the tool. `tangent up` and `tangent task start` call
//! these functions and print the reports.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use std::time::Duration;
//!
//! use tangent_follow::{Start, start_when_ready};
//! use tangent_runtime::Stop;
//!
//! let bus = tangent_client::session::join(&tangent_runtime::CellConfig::default_cell())?;
//! let task = std::fs::read_to_string("deploy/tasks/raster.toml")?;
//! let start = Start {
//!     action: "start",
//!     task: &task,
//!     patience: Duration::from_secs(3),
//! };
//! let message = start_when_ready(&bus, &start, &Stop::new(), &mut |reason| println!("{reason}"))?;
//! println!("{message}");
//! # Ok(())
//! # }
//! ```

mod error;
mod follow;
mod start;
mod view;

pub use error::FollowError;
pub use follow::{Ended, follow};
pub use start::{Start, start_when_ready};
pub use view::FollowView;
