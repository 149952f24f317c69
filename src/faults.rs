//! `tangent faults`: provokes every failure of the table on a private simulated cell, and measures
//! the reactions.

use anyhow::Result;
use serde_json::{Value, json};
use tangent_faults::{Campaign, FORCE_MAX_N, Row, SHOWN_MAX_N, Setup, known};

use crate::cli::Faults;
use crate::output::{Outcome, print_json};
use crate::table::{Columns, paragraph};

/// Provokes all faults, or those that are named.
///
/// # Errors
/// A name is unknown, or a cell does not start.
pub fn run(args: &Faults, json: bool) -> Result<Outcome> {
    if args.list {
        return list(json);
    }
    let campaign = Campaign {
        faults: args.faults.clone(),
        allow_ms: args.allow_ms,
        folder: args.folder.clone(),
        setup: Setup {
            program: std::env::current_exe()?,
            port_offset: args.port_offset,
            seed: args.seed,
        },
    };
    let rows = campaign.run()?;
    if json {
        print_json(&json!({
            "allow_ms": args.allow_ms,
            "force_max_n": FORCE_MAX_N,
            "shown_minus_true_max_n": SHOWN_MAX_N,
            "rows": rows.iter().map(row_json).collect::<Vec<_>>(),
        }))?;
    } else {
        print(&rows, args.allow_ms);
    }
    Ok(if rows.iter().any(|row| !row.met && !row.skipped) {
        Outcome::Failed
    } else if rows.iter().any(|row| row.skipped) {
        Outcome::Lossy
    } else {
        Outcome::Done
    })
}

fn list(json: bool) -> Result<Outcome> {
    let all = known();
    if json {
        let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
        print_json(&json!({ "faults": names }))?;
    } else {
        let mut table = Columns::new(&["fault", "what happens"]);
        all.iter().for_each(|(name, what)| table.row([name, what]));
        table.print(0);
    }
    Ok(Outcome::Done)
}

fn row_json(row: &Row) -> Value {
    json!({
        "fault": row.fault,
        "what": row.what,
        "notices": row.notices,
        "outcome": row.outcome.name(),
        "noticed_ms": row.noticed_ms,
        "noticed_bound_ms": row.noticed_bound_ms,
        "safe_ms": row.safe_ms,
        "bound_ms": row.bound_ms,
        "peak_force_n": row.peak_force_n,
        "messages_lost": row.lost.values().sum::<u64>(),
        "lost_by_topic": row.lost,
        "messages_lost_outside": row.lost_outside.values().sum::<u64>(),
        "lost_outside_by_topic": row.lost_outside,
        "again_peak_force_n": row.again.map(|again| again.peak_force_n),
        "again_shown_minus_true_n": row.again.map(|again| again.shown_minus_true_n),
        "again_retracted": row.again.map(|again| again.retracted),
        "met": row.met,
        "skipped": row.skipped,
        "remark": row.remark,
    })
}

fn print(rows: &[Row], allow_ms: f64) {
    let ms = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.0}"));
    let newtons = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.2}"));
    let mut table = Columns::new(&[
        "fault", ">seen ms", ">of", ">safe ms", ">of", ">peak N", ">lost", ">next N", ">error N",
        "verdict",
    ]);
    for row in rows {
        table.row([
            row.fault.to_string(),
            ms(row.noticed_ms),
            ms(row.noticed_bound_ms),
            ms(row.safe_ms),
            ms(row.bound_ms),
            format!("{:.2}", row.peak_force_n),
            row.lost.values().sum::<u64>().to_string(),
            newtons(row.again.map(|again| again.peak_force_n)),
            newtons(row.again.map(|again| again.shown_minus_true_n)),
            match (row.met, row.remark.as_str()) {
                (true, _) => "met".to_owned(),
                (false, remark) => remark.to_owned(),
            },
        ]);
    }
    table.print(0);
    paragraph(
        0,
        &format!(
            "Seen: time until the fault is detected; safe: until the arm is; each with its bound, which may be exceeded by \
             {allow_ms:.0} ms (--allow-ms). The force may not exceed {FORCE_MAX_N:.0} N. Lost: messages missing from the \
             recording within the fault. Next: peak force of the task after the fault; error: its mean shown force minus the \
             true one, which may be {SHOWN_MAX_N} N. That task must leave the surface."
        ),
    );
}
