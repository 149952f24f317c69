//! The sensor's zero: averaged on request while the tool is at rest and without contact, and
//! refused otherwise.

pub(crate) mod averaging;
mod config;
mod refusal;
mod zero;

pub use config::TareConfig;
pub use refusal::TareRefusal;
pub use zero::{Tare, TareGround, ZeroPoint};
