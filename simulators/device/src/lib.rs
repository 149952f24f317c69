//! Common parts of the simulated devices: the ports that they listen on, the thread that they run
//! in, the listener for the records of a force/torque sensor, the depth camera on an arm's flange,
//! and the simulator's messages on the bus.
//!
//! Called by the device crates in `simulators/` and by the service `tangent-simulator`, which
//! composes cells out of them.
//!
//! ```
//! use tangent_simulated_device::Ports;
//!
//! // A second cell on the same host: every port is 100 above the real one.
//! assert_eq!(Ports::Offset(100).of(30004), Some(30104));
//! // Any free port, for tests.
//! assert_eq!(Ports::Ephemeral.of(30004), Some(0));
//! ```

mod bus;
mod depth_eye;
mod device_thread;
mod ports;
mod records;

pub use bus::{FAULT_KEY, fault_answer, truth_message};
pub use depth_eye::{Shutter, ShutterError};
pub use device_thread::{DeviceLink, DeviceThread};
pub use ports::{PastLastPort, Ports};
pub use records::RecordListener;
