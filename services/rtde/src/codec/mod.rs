//! The RTDE protocol, bytes to types and back, for both ends of the wire.
//!
//! Pure: no socket, no clock. The bridge uses the client's side, the simulator the controller's
//! side. A [`Framer`] cuts a byte stream into packages, [`Request`] and [`Reply`] are decoded
//! packages, and a [`Recipe`] reads and writes the fields of a data package. Everything on the
//! wire is big-endian.

mod field;
mod frame;
mod package;
mod recipe;
mod reply;
mod request;
mod text;
mod value;
mod version;

pub use field::{Availability, Field, input_field, output_field};
pub use frame::{FrameError, Framer, HEADER_BYTES, PACKAGE_BYTES_MAX, Package};
pub use package::{DecodeError, EncodeError, NAMES_BYTES_MAX, PackageKind, Slot};
pub use recipe::{Recipe, RecipeError};
pub use reply::Reply;
pub use request::Request;
pub use text::{TextLevel, TextMessage};
pub use value::{DataType, Value};
pub use version::{ControllerVersion, Protocol, Series, output_cycles};

/// TCP port of the dashboard server (text lines).
pub const PORT_DASHBOARD: u16 = 29999;
/// TCP port of the primary interface: state and messages at 10 Hz; takes URScript.
pub const PORT_PRIMARY: u16 = 30001;
/// TCP port of the secondary interface: state at 10 Hz; takes URScript.
pub const PORT_SECONDARY: u16 = 30002;
/// TCP port of the real-time client interface; takes URScript.
pub const PORT_REALTIME: u16 = 30003;
/// TCP port of RTDE.
pub const PORT_RTDE: u16 = 30004;
