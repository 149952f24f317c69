//! Plays one fault on a cell: provokes it, observes the cell, ends it, and measures.

use std::collections::BTreeMap;
use std::time::Duration;

use tangent_compose::with_causes;
use tangent_runtime::clock;

use crate::catalogue::{Case, Outcome};
use crate::error::{Context, FaultsError, Result, bail};
use crate::evidence::Control;
use crate::row::{Again, Row, without_figures};
use crate::stage::Stage;

/// Time for which the task after a fault slides.
const AGAIN: Duration = Duration::from_secs(3);
/// Number of times that a fault is provoked if the task had ended before it.
const TRIES: usize = 3;
const MS: f64 = 1e-6;

/// Provokes one fault while the tool slides.
///
/// # Errors
/// The cell does not slide before the fault, or does not recover after it.
pub fn play(stage: &mut Stage, case: &Case, allow_ms: f64) -> Result<Row> {
    let begun_ns = clock::now_ns();
    let from_ns = match provoke(stage, case)? {
        Ok(from_ns) => from_ns,
        Err(reason) => {
            let remark = format!("skipped: {}", with_causes(&reason));
            return Ok(without_figures(case, true, &remark));
        }
    };
    stage.watch(Duration::from_secs_f64(case.watch_s));
    let watched_ns = clock::now_ns();
    (case.repair)(stage)?;
    let repaired_ns = clock::now_ns();
    let evidence = &stage.cell.evidence;
    let went_on = evidence.slid_at_all(watched_ns - 600_000_000);
    if case.outcome == Outcome::Ends {
        // The fault is over; this shows that no motion restarts by itself.
        stage.watch(Duration::from_millis(700));
    }
    let still_ns = clock::now_ns();
    stage.cell.wait_for_all(repaired_ns)?;
    let to_ns = clock::now_ns();
    let evidence = &stage.cell.evidence;
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
        let (again, last) = start_again(stage)?;
        row.judge_again(&again, &last);
        row.again = Some(again);
        row.ended_ns = clock::now_ns();
    }
    Ok(row)
}

/// Provokes the fault while the tool slides. Returns the time at which it began, ns since the Unix
/// epoch, or the reason why it cannot be provoked here.
///
/// A busy machine may end the task in the moment before the fault, so that nothing is left for the
/// fault to end: it is then repaired, and provoked in another task.
fn provoke(stage: &mut Stage, case: &Case) -> Result<std::result::Result<i64, FaultsError>> {
    for _ in 0..TRIES {
        stage.cell.slide()?;
        let asked_ns = clock::now_ns();
        if let Err(reason) = (case.provoke)(stage) {
            return Ok(Err(reason));
        }
        let from_ns = stage.began_ns().unwrap_or(asked_ns);
        if stage.cell.evidence.has_task_at(from_ns) {
            return Ok(Ok(from_ns));
        }
        eprintln!("{}: the task had ended before the fault", case.name);
        (case.repair)(stage)?;
        stage.cell.wait_for_all(clock::now_ns())?;
    }
    bail!("the task ended before the fault, {TRIES} times")
}

/// Checks that all services have recovered: another task slides and is stopped.
fn start_again(stage: &mut Stage) -> Result<(Again, Control)> {
    let from_ns = clock::now_ns();
    stage.cell.slide().context("after the fault")?;
    let slid_from_ns = clock::now_ns();
    stage.watch(AGAIN);
    let slid_to_ns = clock::now_ns();
    let (retracted, last) = stage.cell.stop_task().context("after the fault")?;
    let evidence = &stage.cell.evidence;
    let again = Again {
        peak_force_n: evidence.peak_n(from_ns, clock::now_ns()),
        shown_minus_true_n: evidence
            .shown_minus_true_n(slid_from_ns, slid_to_ns)
            .context("the task after the fault does not slide")?,
        retracted,
    };
    Ok((again, last))
}
