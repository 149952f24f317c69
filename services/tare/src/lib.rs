//! The answer to `netft/tare`, shared by the services that publish a wrench: `netft` and `franka`.
//!
//! [`open`] answers the query. Whether a tare is allowed is judged at once, in the bus's urgent
//! lane, by what the controller says of contact; the average is taken by the service's loop through
//! its [`Taring`], and waited for in the slow lane. What a restart must not forget (the last good
//! zero, the controller's last word) stands in one file of the cell's state folder.

#![deny(missing_docs)]

mod keeper;
mod memory;
mod requests;
mod taring;

use std::sync::Arc;

use tangent_runtime::{Bus, BusError, Handle, StateFolder};
use tangent_schemas::topics::queries;

pub use keeper::Keeper;
pub use taring::{Taring, tell_zero};

use memory::Memory;
use requests::tare_requests;

/// What differs from service to service.
#[derive(Clone, Debug)]
pub struct TareSetup {
    /// The service's name, and that of its file in the state folder.
    pub service: &'static str,
    /// Where the file is; none: nothing is kept.
    pub state: Option<StateFolder>,
    /// Time over which the zero is averaged, s.
    pub duration_s: f64,
    /// What is wrong when no reading comes to average, and where to look.
    pub silence: &'static str,
}

/// The query is answered, and nothing is written down yet.
pub struct Opened {
    taring: Taring,
    memory: Arc<Memory>,
    answering: Handle,
}

/// Reads the memory and begins to answer `netft/tare`.
///
/// # Errors
/// The bus refuses the query or the controller's topic.
pub fn open(bus: &Bus, setup: &TareSetup) -> Result<Opened, BusError> {
    let (memory, notes) = Memory::open(bus, setup.service, setup.state.clone())?;
    let memory = Arc::new(memory);
    let (requests, work) = tare_requests(setup, &memory);
    let judge = requests.clone();
    let answering = bus.answer_judged(
        queries::NETFT_TARE,
        move |asked| judge.judge(&asked.request),
        move |asked| requests.respond(&asked).into(),
    )?;
    let taring = Taring::new(work, notes, memory.zero());
    Ok(Opened {
        taring,
        memory,
        answering,
    })
}

impl Opened {
    /// Starts the thread that writes the memory down. The query is answered while the second part
    /// is kept.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn start(self) -> std::io::Result<(Taring, Keeper)> {
        let keeper = Keeper::start(self.memory, self.answering)?;
        Ok((self.taring, keeper))
    }
}
