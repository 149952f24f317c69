//! The answer to `netft/tare`, shared by the services that publish a wrench: `netft` and `franka`.
//!
//! [`open`] answers the query. Whether a tare is allowed follows from the controller's contact
//! state and is decided at once, in the urgent lane of the bus. The service's loop takes the
//! average through its [`Taring`], and the slow lane waits for it. The last good zero and the
//! controller's last state survive a restart in one file of the cell's state folder.

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

/// Settings that differ between the services.
#[derive(Clone, Debug)]
pub struct TareSetup {
    /// Name of the service and of its file in the state folder.
    pub service: &'static str,
    /// Folder of the file; `None` to store nothing.
    pub state: Option<StateFolder>,
    /// Time over which the zero is averaged, s.
    pub duration_s: f64,
    /// Text for the operator if no reading arrives during the average: the cause and what to check.
    pub silence: &'static str,
}

/// A tare service that answers the query and does not store its memory yet.
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
    /// Starts the thread that stores the memory. The query is answered until the [`Keeper`] is
    /// dropped.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn start(self) -> std::io::Result<(Taring, Keeper)> {
        let keeper = Keeper::start(self.memory, self.answering)?;
        Ok((self.taring, keeper))
    }
}
