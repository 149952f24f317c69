//! One cell, and what can be done to it.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use tangent_runtime::clock;

use super::disk::SmallDisk;
use super::host_clock::Host;
use super::impostor::{Impostor, Lie};
use super::losses::{self, Gap};
use super::private_cell::{Layout, PrivateCell};
use super::processors::Takers;
use super::wire::Damage;

/// A cell, and what belongs to the faults.
pub struct Stage {
    /// The cell.
    pub cell: PrivateCell,
    disk: Result<SmallDisk>,
    lie: Option<Lie>,
    impostor: Option<Impostor>,
    takers: Option<Takers>,
    /// When the fault really began, where getting it ready took time.
    began_ns: Option<i64>,
}

impl Stage {
    /// Starts a cell in `folder`.
    ///
    /// # Errors
    /// As [`PrivateCell::start`].
    pub fn start(folder: &Path, port_offset: u16, layout: Layout, seed: u64) -> Result<Self> {
        std::fs::create_dir_all(folder)?;
        let disk = SmallDisk::mount(&folder.join("disk.img"), &folder.join("recordings"));
        Ok(Self {
            cell: PrivateCell::start(folder, port_offset, layout, seed)?,
            disk,
            lie: None,
            impostor: None,
            takers: None,
            began_ns: None,
        })
    }

    /// The recorder's disk.
    ///
    /// # Errors
    /// Why there is no small one.
    pub fn disk(&mut self) -> Result<&mut SmallDisk> {
        match &mut self.disk {
            Ok(disk) => Ok(disk),
            Err(error) => Err(anyhow!("a file system of its own takes root: {error:#}")),
        }
    }

    /// Damages the sensor's cable.
    ///
    /// # Errors
    /// None.
    pub fn wire(&mut self, damage: Damage) -> Result<()> {
        self.cell.sensor.set(damage);
        Ok(())
    }

    /// Sets the clock of a host forward, or back.
    ///
    /// # Errors
    /// In a layout where it has none of its own.
    pub fn step_clock(&mut self, host: Host, by_s: f64) -> Result<()> {
        self.cell
            .clocks
            .get(&host)
            .with_context(|| format!("{host:?} has no clock of its own"))?
            .step(by_s);
        Ok(())
    }

    /// Takes every core with SCHED_FIFO and `priority` for half a second.
    ///
    /// # Errors
    /// Where that is not granted.
    pub fn take_processors(&mut self, priority: u8) -> Result<()> {
        let takers = self.takers.insert(Takers::ready(priority)?);
        self.began_ns = Some(clock::now_ns());
        takers.start();
        Ok(())
    }

    /// Waits for the end of that.
    ///
    /// # Errors
    /// None.
    pub fn leave_processors(&mut self) -> Result<()> {
        self.takers = None;
        Ok(())
    }

    /// Tells this lie from now on, as often as it takes.
    ///
    /// # Errors
    /// When the bus refuses.
    pub fn lie(&mut self, lie: Lie) -> Result<()> {
        let mut impostor = Impostor::new(&self.cell.bus)?;
        let until = Instant::now() + Duration::from_secs(5);
        while !(impostor.is_heard(lie) && impostor.knows_the_controller()) {
            if Instant::now() > until {
                bail!("nobody listens to the impostor");
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

    /// Falls silent.
    ///
    /// # Errors
    /// None.
    pub fn tell_no_more_lies(&mut self) -> Result<()> {
        self.lie = None;
        self.impostor = None;
        Ok(())
    }

    /// After a protective stop: what a person does at the pendant, not before five seconds are
    /// over.
    ///
    /// # Errors
    /// When it is not unlocked in time.
    pub fn unlock(&mut self) -> Result<()> {
        let request = tangent_schemas::tangent::Request::default();
        let until = Instant::now() + Duration::from_secs(15);
        // Once it is released, there is no stop left to leave, and the next request is refused.
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
                bail!("the protective stop is not unlocked: {answer:?}");
            }
        }
    }

    /// What `tangent robot power-on` does, until the bridge has done it.
    ///
    /// # Errors
    /// When it refuses for too long.
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
                bail!("the robot is not powered on: {answer:?}");
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// The fault is the surface's own: wait for it.
    ///
    /// # Errors
    /// When the tool never comes to the edge.
    pub fn wait_for_the_edge(&mut self) -> Result<()> {
        let from = clock::now_ns();
        let until = Instant::now() + Duration::from_secs(20);
        while self.cell.evidence.lost_contact_ns(from).is_none() {
            if Instant::now() > until {
                bail!("the tool did not come to the edge");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        self.began_ns = self.cell.evidence.lost_contact_ns(from);
        Ok(())
    }

    /// Looks on, and lies where there is a lie to tell.
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

    /// When the fault really began, where getting it ready took time.
    pub fn began_ns(&mut self) -> Option<i64> {
        self.began_ns.take()
    }

    /// Ends the cell and reads its recordings: every hole in them.
    ///
    /// # Errors
    /// A recording that cannot be read.
    pub fn end(self) -> Result<Vec<Gap>> {
        let folder: PathBuf = self.cell.recordings();
        // Dropped after the cell: its recorder writes there to the end.
        let disk = self.disk;
        self.cell.end();
        let gaps = losses::gaps(&folder)?;
        drop(disk);
        Ok(gaps)
    }
}
