//! Writes the file of a new cell from a few answers: model, sensor, addresses.
//!
//! `tangent cell new` asks for a [`NewCell`] and calls [`fn@write`]. The file has only what such a
//! cell needs, each value that has to be measured is marked "set", and it passes `tangent check`.
//!
//! ```
//! use tangent_new_cell::{NewCell, Sensor, text};
//!
//! let cell = NewCell {
//!     name: "kitchen".to_owned(),
//!     model: "ur5".to_owned(),
//!     robot_address: "192.168.1.10".to_owned(),
//!     sensor: Sensor::Netft { address: "192.168.1.1".to_owned() },
//! };
//! assert!(text(&cell).contains("address = \"192.168.1.10\""));
//! ```

mod answers;
mod error;
mod file;
mod text;

pub use answers::{NewCell, Ranges, Sensor, SensorKind, is_franka, kinds_of, ranges_of};
pub use error::NewCellError;
pub use file::write;
pub use text::text;
