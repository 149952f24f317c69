//! One cell, and the ways to disturb it.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tangent_compose::with_causes;
use tangent_runtime::BusError;
use tangent_runtime::clock;
use tangent_schemas::tangent::Answer;

use crate::disk::SmallDisk;
use crate::error::{Context, FaultsError, Result, bail};
use crate::host_clock::Host;
use crate::impostor::{Impostor, Lie};
use crate::layout::Layout;
use crate::losses::{self, Gap};
use crate::private_cell::{PrivateCell, Setup};
use crate::processors::Takers;
use crate::wire::Damage;

/// A cell, with the state of the faults.
pub struct Stage {
    /// The cell under test.
    pub cell: PrivateCell,
    disk: Result<SmallDisk>,
    lie: Option<Lie>,
    impostor: Option<Impostor>,
    takers: Option<Takers>,
    /// Time at which the fault really began, if its preparation took time, ns since the Unix epoch.
    began_ns: Option<i64>,
}

impl Stage {
    /// Starts a cell in `folder`.
    ///
    /// # Errors
    /// The cell cannot be started, see [`PrivateCell::start`].
    pub fn start(folder: &Path, layout: Layout, setup: &Setup) -> Result<Self> {
        std::fs::create_dir_all(folder)?;
        let disk = SmallDisk::mount(&folder.join("disk.img"), &folder.join("recordings"));
        Ok(Self {
            cell: PrivateCell::start(folder, layout, setup)?,
            disk,
            lie: None,
            impostor: None,
            takers: None,
            began_ns: None,
        })
    }

    /// Returns the recorder's disk.
    ///
    /// # Errors
    /// Reason why there is no small disk.
    pub fn disk(&mut self) -> Result<&mut SmallDisk> {
        match &mut self.disk {
            Ok(disk) => Ok(disk),
            Err(error) => Err(FaultsError::Failed(format!(
                "mounting a file system needs root: {}",
                with_causes(error)
            ))),
        }
    }

    /// Damages the sensor's cable.
    ///
    /// # Errors
    /// This function returns no error.
    pub fn wire(&mut self, damage: Damage) -> Result<()> {
        self.cell.sensor.set(damage);
        Ok(())
    }

    /// Steps the clock of a host forward by `by_s` (s), or backward if it is negative.
    ///
    /// # Errors
    /// The layout has no clock for this host.
    pub fn step_clock(&mut self, host: Host, by_s: f64) -> Result<()> {
        self.cell
            .clocks
            .get(&host)
            .with_context(|| format!("no host of {} has a clock of its own", host.process()))?
            .step(by_s);
        Ok(())
    }

    /// Occupies every core with SCHED_FIFO and `priority` for half a second.
    ///
    /// # Errors
    /// SCHED_FIFO is not granted.
    pub fn take_processors(&mut self, priority: u8) -> Result<()> {
        let takers = self.takers.insert(Takers::ready(priority)?);
        self.began_ns = Some(clock::now_ns());
        takers.start();
        Ok(())
    }

    /// Waits until the cores are free again.
    ///
    /// # Errors
    /// This function returns no error.
    pub fn leave_processors(&mut self) -> Result<()> {
        self.takers = None;
        Ok(())
    }

    /// Publishes this false message periodically from now on.
    ///
    /// # Errors
    /// The bus refuses.
    pub fn lie(&mut self, lie: Lie) -> Result<()> {
        let mut impostor = Impostor::new(&self.cell.bus)?;
        let until = Instant::now() + Duration::from_secs(5);
        while !(impostor.is_heard(lie) && impostor.knows_the_controller()) {
            if Instant::now() > until {
                bail!("no subscriber receives the impostor's messages");
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        if lie.as_the_controller() {
            self.cell.signal("controller", "STOP")?;
            impostor.knows_the_controller();
        }
        self.impostor = Some(impostor);
        self.lie = Some(lie);
        self.began_ns = Some(clock::now_ns());
        Ok(())
    }

    /// Stops publishing false messages.
    ///
    /// # Errors
    /// This function returns no error.
    pub fn tell_no_more_lies(&mut self) -> Result<()> {
        self.lie = None;
        self.impostor = None;
        Ok(())
    }

    /// Leaves a protective stop as an operator does on the pendant, which takes at least five
    /// seconds.
    ///
    /// # Errors
    /// It is not unlocked in time.
    pub fn unlock(&mut self) -> Result<()> {
        let request = tangent_schemas::tangent::Request::default();
        let until = Instant::now() + Duration::from_secs(15);
        // After the release there is no stop left, and the next request is refused.
        let mut released = false;
        loop {
            std::thread::sleep(Duration::from_millis(500));
            let answer = self.cell.bus.ask(
                tangent_rtde::queries::UNLOCK,
                &request,
                Duration::from_secs(3),
            );
            released |= answer.as_ref().is_ok_and(|a| a.done);
            if released
                && self
                    .cell
                    .evidence
                    .arm(clock::now_ns() - 300_000_000)
                    .is_some_and(|arm| arm.ready)
            {
                return Ok(());
            }
            if Instant::now() > until {
                bail!("the protective stop is not unlocked: {}", reason(&answer));
            }
        }
    }

    /// Powers the robot on as `tangent robot power-on` does, until the bridge has done it.
    ///
    /// # Errors
    /// The bridge refuses for too long.
    pub fn power_on(&mut self) -> Result<()> {
        let request = tangent_schemas::tangent::Request::default();
        let until = Instant::now() + Duration::from_secs(15);
        loop {
            let answer = self.cell.bus.ask(
                tangent_rtde::queries::POWER_ON,
                &request,
                Duration::from_secs(5),
            );
            if answer.as_ref().is_ok_and(|answer| answer.done) {
                return Ok(());
            }
            if Instant::now() > until {
                bail!("the robot is not powered on: {}", reason(&answer));
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Waits for a fault that the surface itself causes.
    ///
    /// # Errors
    /// The tool does not reach the edge.
    pub fn wait_for_the_edge(&mut self) -> Result<()> {
        let from = clock::now_ns();
        let until = Instant::now() + Duration::from_secs(20);
        while self.cell.evidence.lost_contact_ns(from).is_none() {
            if Instant::now() > until {
                bail!("the tool did not reach the edge");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        self.began_ns = self.cell.evidence.lost_contact_ns(from);
        Ok(())
    }

    /// Observes the cell for `time`, and meanwhile publishes the false message if there is one.
    pub fn watch(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until {
            let period = match (self.lie, &mut self.impostor) {
                (Some(lie), Some(impostor)) => {
                    impostor.tell(lie);
                    lie.period_ms()
                }
                _ => 5,
            };
            std::thread::sleep(Duration::from_millis(period));
        }
    }

    /// Time at which the fault really began, if its preparation took time, ns since the Unix epoch.
    pub fn began_ns(&mut self) -> Option<i64> {
        self.began_ns.take()
    }

    /// Ends the cell, reads its recordings, and returns every gap in them.
    ///
    /// # Errors
    /// A recording cannot be read.
    pub fn end(self) -> Result<Vec<Gap>> {
        let folder: PathBuf = self.cell.recordings();
        // Dropped after the cell: its recorder writes there until its end.
        let disk = self.disk;
        self.cell.end();
        let gaps = losses::gaps(&folder)?;
        drop(disk);
        Ok(gaps)
    }
}

/// Reason of a request without success.
fn reason(answer: &std::result::Result<Answer, BusError>) -> String {
    match answer {
        Ok(answer) => answer.message.clone(),
        Err(error) => error.to_string(),
    }
}
