//! Why the RTDE connection cannot be used, with what to do.

use crate::codec::{
    ControllerVersion, DataType, DecodeError, EncodeError, FrameError, RecipeError, Series,
};

/// Why a connection cannot be used; connect again later.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// The upper registers came with 3.9 and 5.3.
    #[error(
        "the controller runs software {version}; the bridge needs 3.9 or later on CB3, 5.3 or later on e-Series \
         (before that, registers 24 to 47 are closed to RTDE): update PolyScope"
    )]
    TooOld {
        /// Version of its software.
        version: ControllerVersion,
    },
    /// The robot is not the one in the cell file.
    #[error(
        "the controller runs software {version}, which is {found}, but [robot] model = \"{model}\" is {expected}: \
         correct the model in the cell file, or the address"
    )]
    WrongSeries {
        /// Version of its software.
        version: ControllerVersion,
        /// Controller family found.
        found: Series,
        /// The cell file's model.
        model: String,
        /// Controller family of that model.
        expected: Series,
    },
    /// Only one client may own an input.
    #[error(
        "{name} is in use by another client, probably {owner}. Stop that client, or set another [robot] register_base"
    )]
    InUse {
        /// The field.
        name: String,
        /// Client that probably uses it.
        owner: &'static str,
    },
    /// The controller does not have the value of its own sensor that the cell file asks for.
    #[error(
        "the controller ({version}) does not have ft_raw_wrench, which came with 5.9: update PolyScope, or set [sensor.ur] reading = \
         \"actual_TCP_force\""
    )]
    NoRawWrench {
        /// Version of the controller's software.
        version: ControllerVersion,
    },
    /// The controller does not have a field.
    #[error("the controller ({version}) does not have {name}")]
    NotFound {
        /// The field.
        name: String,
        /// Version of the controller's software.
        version: ControllerVersion,
    },
    /// A field has another type than it should.
    #[error("the controller gives {name} the type {found}; it should be {expected}")]
    WrongType {
        /// The field.
        name: String,
        /// Type reported by the controller.
        found: DataType,
        /// Type expected.
        expected: DataType,
    },
    /// The controller refused a request.
    #[error("the controller refused to {what}")]
    Refused {
        /// The request.
        what: &'static str,
    },
    /// The controller did not answer a request.
    #[error("the controller did not answer {what} within {after_s} s")]
    NoAnswer {
        /// The request.
        what: &'static str,
        /// Time waited, s.
        after_s: f64,
    },
    /// No package arrived although the stream runs.
    #[error(
        "no package from the controller for {after_s} s: cable, controller overloaded or switched off"
    )]
    Silent {
        /// Time waited, s.
        after_s: f64,
    },
    /// The robot's clock went back, so the controller has restarted.
    #[error("the controller restarted (its clock went from {before_s:.3} s to {now_s:.3} s)")]
    Restarted {
        /// Previous time, s.
        before_s: f64,
        /// Present time, s.
        now_s: f64,
    },
    /// A state has values that are not finite or not plausible.
    #[error("the controller sent a state with a number that is not finite or not possible")]
    NotFinite,
    /// The bytes are not RTDE packages.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A package that cannot be decoded.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// A data package that does not fit its recipe.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// A request that does not fit a package.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

/// Known client that may use this register.
pub(crate) fn likely_owner(name: &str) -> &'static str {
    let index = name
        .rsplit('_')
        .next()
        .and_then(|index| index.parse::<u32>().ok());
    match index {
        Some(0..24) => {
            "a PLC over EtherNet/IP, PROFINET or Modbus, or ur_rtde with its default registers"
        }
        Some(42..48) => "ur_rtde's IO interface with upper-range registers",
        Some(_) => {
            "a second bridge, ur_rtde's control interface with upper-range registers, or an earlier connection of this \
             bridge that the controller has not closed yet"
        }
        None => "another RTDE client",
    }
}
