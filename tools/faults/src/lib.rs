//! Provokes every failure of the table in `docs/architecture.md` on a private simulated cell, and
//! measures which service detects it when, and when the arm is safe.
//!
//! A [`Campaign`] plays the faults of the catalogue one after the other and returns a [`Row`] for
//! each. The services run in processes of their own, so that they can be killed and stopped;
//! simulator, cables and clocks are part of this process. The simulator's ground truth shows
//! whether the arm is safe, and the recording shows what is lost. `tangent faults` prints the rows;
//! `tangent bench requests` measures on the same [`PrivateCell`].
//!
//! From a fault's definition to its figures:
//!
//! | file | contents |
//! |---|---|
//! | `catalogue/` | every fault: what is done, which service must detect it and how soon |
//! | `campaign`, `play`, `row` | faults in order; one fault; its times against the bounds |
//! | `stage` | a cell, and the ways to disturb it |
//! | `private_cell`, `layout`, `cell_files` | the cell: processes, spread over hosts, files |
//! | `wire`, `host_clock`, `disk` | faults of cables, clocks and the disk |
//! | `processors`, `impostor` | occupied cores, forged messages |
//! | `evidence`, `losses` | messages of the cell meanwhile; messages missing in its recording |

mod campaign;
mod catalogue;
mod cell_files;
mod disk;
mod error;
mod evidence;
mod host_clock;
mod impostor;
mod layout;
mod losses;
mod play;
mod private_cell;
mod processors;
mod row;
mod stage;
mod wire;

pub use campaign::{Campaign, known};
pub use catalogue::Outcome;
pub use error::FaultsError;
pub use layout::Layout;
pub use private_cell::{PrivateCell, Setup};
pub use row::{Again, FORCE_MAX_N, Row, SHOWN_MAX_N};
