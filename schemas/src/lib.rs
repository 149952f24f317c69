//! Interfaces between services: messages, topics, frames and units.
//!
//! Every message is a Rust type, a ROS 2 `.msg` definition and CDR bytes, and the three are tested
//! against each other. Services publish and subscribe through the typed constants in [`topics`].
//!
//! ```
//! use tangent_schemas::tangent::ArmCommand;
//! use tangent_schemas::{CommandKind, Message, cdr, topics};
//!
//! let command = ArmCommand {
//!     cycle: 7,
//!     kind: CommandKind::JointVelocity.number(),
//!     values: [0.1; 6].into_iter().collect(),
//!     ..ArmCommand::default()
//! };
//! let mut bytes = Vec::new();
//! cdr::encode(&command, &mut bytes)?;
//! assert_eq!(cdr::decode::<ArmCommand>(&bytes)?, command);
//! assert_eq!(ArmCommand::NAME, "tangent_msgs/msg/ArmCommand");
//! assert_eq!(topics::ARM_COMMAND.key(), "arm/command");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod arm_modes;
pub mod cdr;
mod command_kind;
pub mod convert;
mod covariance;
pub mod definition;
pub mod standard;
pub mod tangent;
pub mod topics;

pub use command_kind::CommandKind;
pub use covariance::Covariance;

use arrayvec::{ArrayString, ArrayVec};

/// Name of a frame. Its capacity is fixed, so that a message can be copied in a real-time thread.
pub type FrameId = ArrayString<32>;
/// A short name.
pub type Name = ArrayString<64>;
/// A sentence.
pub type Text = ArrayString<128>;
/// One number per joint; arms have at most seven.
pub type JointArray = ArrayVec<f64, 7>;
/// Names and ages of the estimators that a controller reads: at most 16.
pub type EstimatorArray<T> = ArrayVec<T, 16>;

/// One number per round of a task with coverage; a task has at most 20.
pub type RoundArray = ArrayVec<f64, 20>;

/// A message type: its ROS 2 name, and CDR through serde.
pub trait Message:
    Clone + Default + Send + Sync + serde::Serialize + serde::de::DeserializeOwned + 'static
{
    /// Name as `PACKAGE/msg/NAME`.
    const NAME: &'static str;

    /// The `.msg` text with those of all messages that it contains, as the schema of a recording
    /// (`ros2msg`).
    fn definition() -> String {
        definition::definition(Self::NAME).expect("a test checks that every message has its file")
    }
}

macro_rules! message {
    ($(#[$doc:meta])* pub struct $name:ident: $ros:literal { $($(#[$fdoc:meta])* pub $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[allow(missing_docs)]
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        pub struct $name { $($(#[$fdoc])* pub $field: $type,)* }

        impl crate::Message for $name {
            const NAME: &'static str = $ros;
        }
    };
}
pub(crate) use message;
