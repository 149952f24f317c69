//! The orderly shutdown: ramp to rest, end the program, pause the stream.

/// Time allowed at shutdown for the program to end, s.
const EXIT_S: f64 = 2.0;
/// Time allowed at shutdown for the ramp to rest, s.
const REST_S: f64 = 3.0;

/// Where the shutdown is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Ending {
    /// Not asked for.
    No,
    /// The arm comes to rest.
    ToRest {
        /// When that began, s.
        since_s: f64,
    },
    /// The program ends.
    Exit {
        /// When that began, s.
        since_s: f64,
    },
    /// The stream of states is paused.
    Pausing,
    /// The connection can be closed.
    Finished,
}

impl Ending {
    /// The next step, one cycle later. `rests`: nothing is commanded; `gone`: the program has
    /// ended. Neither is waited for without limit.
    pub fn advance(self, rests: bool, gone: bool, now_s: f64) -> Self {
        match self {
            Self::ToRest { since_s } if rests || now_s - since_s > REST_S => {
                Self::Exit { since_s: now_s }
            }
            Self::Exit { since_s } if gone || now_s - since_s > EXIT_S => Self::Pausing,
            _ => self,
        }
    }
}
