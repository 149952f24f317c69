//! One fault after the other on one cell: let it happen, watch, end it, measure.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use tangent_runtime::clock;

use super::catalogue::{Case, Outcome};
use super::disk::SmallDisk;
use super::evidence::Control;
use super::host_clock::Host;
use super::impostor::{Impostor, Lie};
use super::losses::{self, Gap};
use super::private_cell::{Layout, PrivateCell, REFERENCE_N};
use super::processors::Takers;
use super::wire::Damage;

/// No fault may press harder: the larger of twice the reference and 10 N.
pub const FORCE_MAX_N: f64 = if 2.0 * REFERENCE_N > 10.0 {
    2.0 * REFERENCE_N
} else {
    10.0
};
/// Force that the controller may show more or less than is true while it slides again, in the mean, N.
pub const SHOWN_MAX_N: f64 = 0.5;
/// How long the task after a fault slides.
const AGAIN: Duration = Duration::from_secs(3);
/// After a fault has ended, what was lost in it may still come to light for so long, ns.
const AFTER_NS: i64 = 1_000_000_000;
const MS: f64 = 1e-6;

/// What was measured of the task after a fault that ended one.
#[derive(Clone, Copy, Debug)]
pub struct Again {
    /// Highest force from its start to its end, N.
    pub peak_force_n: f64,
    /// Force shown less the true one while it slid, in the mean, N.
    pub shown_minus_true_n: f64,
    /// Its retraction ended off the surface.
    pub retracted: bool,
}

/// What was measured of one fault.
#[derive(Clone, Debug)]
pub struct Row {
    /// The case's name.
    pub fault: &'static str,
    /// What was done.
    pub what: &'static str,
    /// Who has to notice.
    pub notices: &'static str,
    /// What has to become of the task.
    pub outcome: Outcome,
    /// From the fault to the first word or move in answer, ms.
    pub noticed_ms: Option<f64>,
    /// The bound on that without the allowance, ms.
    pub noticed_bound_ms: Option<f64>,
    /// From the fault until the tool slid no more, ms; none where the task goes on.
    pub safe_ms: Option<f64>,
    /// The bound on that without the allowance, ms.
    pub bound_ms: Option<f64>,
    /// Highest force from the fault to its end, N.
    pub peak_force_n: f64,
    /// Messages that the recording lacks within the fault, by topic.
    pub lost: BTreeMap<String, u64>,
    /// And outside of it, since the fault before.
    pub lost_outside: BTreeMap<String, u64>,
    /// The task after it; none where the task goes on.
    pub again: Option<Again>,
    /// Everything as it has to be.
    pub met: bool,
    /// What is not; or why it was skipped.
    pub remark: String,
    /// It could not be provoked here.
    pub skipped: bool,
    begun_ns: i64,
    from_ns: i64,
    to_ns: i64,
    /// When the task after it had ended.
    ended_ns: i64,
    impostor: Option<&'static str>,
}

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

    /// Sets the clock of a host.
    ///
    /// # Errors
    /// In a layout where it has none of its own.
    pub fn set_clock(&mut self, host: Host, ahead_s: f64) -> Result<()> {
        self.cell
            .clocks
            .get(&host)
            .with_context(|| format!("{host:?} has no clock of its own"))?
            .set(ahead_s);
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

    /// After a protective stop: what a person does at the pendant, not before five seconds are over.
    ///
    /// # Errors
    /// When nobody unlocks it in time.
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

    /// Provokes one fault on a sliding tool.
    ///
    /// # Errors
    /// When the cell does not slide before, or is not itself again after.
    pub fn play(&mut self, case: &Case, allow_ms: f64) -> Result<Row> {
        let begun_ns = clock::now_ns();
        self.cell.slide()?;
        let mut from_ns = clock::now_ns();
        if let Err(error) = (case.provoke)(self) {
            let remark = format!("skipped: {error:#}");
            return Ok(without_figures(case, true, &remark));
        }
        from_ns = self.began_ns.take().unwrap_or(from_ns);
        self.watch(Duration::from_secs_f64(case.watch_s));
        let watched_ns = clock::now_ns();
        (case.repair)(self)?;
        let repaired_ns = clock::now_ns();
        let evidence = &self.cell.evidence;
        let went_on = evidence.slid_at_all(watched_ns - 600_000_000);
        if case.outcome == Outcome::Ends {
            // Whatever is back again now: nobody goes on by itself.
            self.watch(Duration::from_millis(700));
        }
        let still_ns = clock::now_ns();
        self.cell.wait_for_all(repaired_ns)?;
        let to_ns = clock::now_ns();
        let evidence = &self.cell.evidence;
        let noticed = (case.noticed)(evidence, from_ns);
        let safe_until = match case.outcome {
            Outcome::Waits => noticed.unwrap_or(from_ns) + (case.stop_ms.max(200.0) / MS) as i64,
            _ => still_ns,
        };
        let safe = (case.outcome != Outcome::GoesOn)
            .then(|| evidence.safe_ns(from_ns, safe_until))
            .flatten();
        let since = |at: Option<i64>| at.map(|at| (at - from_ns) as f64 * MS);
        let mut row = Row {
            fault: case.name,
            what: case.what,
            notices: case.notices,
            outcome: case.outcome,
            noticed_ms: since(noticed),
            noticed_bound_ms: case.seen_within_ms(),
            safe_ms: since(safe),
            bound_ms: case.safe_within_ms(),
            peak_force_n: evidence.peak_n(from_ns, to_ns),
            lost: BTreeMap::new(),
            lost_outside: BTreeMap::new(),
            again: None,
            met: true,
            remark: String::new(),
            skipped: false,
            begun_ns,
            from_ns,
            to_ns,
            ended_ns: to_ns,
            impostor: case.impostor,
        };
        row.judge(case, went_on, allow_ms);
        if case.outcome == Outcome::Ends {
            let (again, last) = self.start_again()?;
            row.judge_again(&again, &last);
            row.again = Some(again);
            row.ended_ns = clock::now_ns();
        }
        Ok(row)
    }

    /// Everybody is back: another task slides and is stopped.
    fn start_again(&mut self) -> Result<(Again, Control)> {
        let from_ns = clock::now_ns();
        self.cell.slide().context("after the fault")?;
        let slid_from_ns = clock::now_ns();
        self.watch(AGAIN);
        let slid_to_ns = clock::now_ns();
        let (retracted, last) = self.cell.stop_task().context("after the fault")?;
        let evidence = &self.cell.evidence;
        let again = Again {
            peak_force_n: evidence.peak_n(from_ns, clock::now_ns()),
            shown_minus_true_n: evidence
                .shown_minus_true_n(slid_from_ns, slid_to_ns)
                .context("the task after the fault does not slide")?,
            retracted,
        };
        Ok((again, last))
    }

    /// Looks on, and lies where there is a lie to tell.
    fn watch(&mut self, time: Duration) {
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

    /// Ends the cell and reads its recordings: what is missing in each fault and around it.
    ///
    /// # Errors
    /// A recording that cannot be read.
    pub fn end(self, rows: &mut [Row]) -> Result<()> {
        let folder: PathBuf = self.cell.recordings();
        // Dropped after the cell: its recorder writes there to the end.
        let disk = self.disk;
        self.cell.end();
        let gaps = losses::gaps(&folder)?;
        drop(disk);
        for gap in &gaps {
            attribute(gap, rows);
        }
        Ok(())
    }
}

/// A row without figures.
pub fn without_figures(case: &Case, skipped: bool, remark: &str) -> Row {
    Row {
        fault: case.name,
        what: case.what,
        notices: case.notices,
        outcome: case.outcome,
        noticed_ms: None,
        noticed_bound_ms: case.seen_within_ms(),
        safe_ms: None,
        bound_ms: case.safe_within_ms(),
        peak_force_n: 0.0,
        lost: BTreeMap::new(),
        lost_outside: BTreeMap::new(),
        again: None,
        met: false,
        remark: remark.to_owned(),
        skipped,
        begun_ns: 0,
        from_ns: 0,
        to_ns: 0,
        ended_ns: 0,
        impostor: None,
    }
}

impl Row {
    fn fail(&mut self, why: &str) {
        self.met = false;
        if !self.remark.is_empty() {
            self.remark.push_str("; ");
        }
        self.remark.push_str(why);
    }

    fn judge(&mut self, case: &Case, went_on: bool, allow_ms: f64) {
        let late = |measured: Option<f64>, bound: Option<f64>| match (measured, bound) {
            (_, None) => false,
            (None, Some(_)) => true,
            (Some(ms), Some(bound)) => ms > bound + allow_ms,
        };
        if late(self.noticed_ms, self.noticed_bound_ms) {
            self.fail("not noticed in time");
        }
        match case.outcome {
            Outcome::GoesOn if !went_on => self.fail("the task did not go on"),
            Outcome::Ends | Outcome::Waits if late(self.safe_ms, self.bound_ms) => {
                self.fail("not safe in time");
            }
            Outcome::Waits if !went_on => self.fail("the path did not go on"),
            _ => {}
        }
        if self.peak_force_n > FORCE_MAX_N {
            self.fail("pressed too hard");
        }
    }

    fn judge_again(&mut self, again: &Again, last: &Control) {
        if again.peak_force_n > FORCE_MAX_N {
            self.fail("the task after it pressed too hard");
        }
        if again.shown_minus_true_n.is_nan() || again.shown_minus_true_n.abs() > SHOWN_MAX_N {
            self.fail("the task after it shows another force than is true");
        }
        if !again.retracted {
            self.fail(&format!(
                "the task after it did not leave the surface, phase {}: {}",
                last.phase.name(),
                last.fault
            ));
        }
    }

    /// Longest stretch that a hole and the fault have in common, ns.
    fn common_ns(&self, gap: &Gap) -> i64 {
        if self.to_ns == 0 {
            return i64::MIN;
        }
        gap.to_ns.min(self.to_ns + AFTER_NS) - gap.from_ns.max(self.from_ns)
    }
}

/// Writes a hole down where it belongs: to the fault that it shares the longest time with, else to the time before the next.
fn attribute(gap: &Gap, rows: &mut [Row]) {
    let add = |lost: &mut BTreeMap<String, u64>| {
        *lost.entry(gap.topic.clone()).or_default() += gap.messages;
    };
    let within = rows
        .iter_mut()
        .max_by_key(|row| row.common_ns(gap))
        .filter(|row| row.common_ns(gap) >= 0);
    if let Some(row) = within {
        // An impostor's messages have a count of their own.
        if !row.impostor.is_some_and(|key| gap.topic.starts_with(key)) {
            add(&mut row.lost);
        }
    } else if let Some(row) = rows
        .iter_mut()
        .find(|row| gap.within(row.begun_ns, row.from_ns) || gap.within(row.to_ns, row.ended_ns))
    {
        add(&mut row.lost_outside);
        if row.met {
            row.fail("messages are missing outside the fault");
        }
    }
}
