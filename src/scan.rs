//! `tangent scan`: the points that the depth camera of a running cell sees, or has seen in a
//! recording, become a file for `tangent region`.

use std::fs;
use std::io::{IsTerminal, stdin};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde_json::json;
use tangent_client::session;
use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_scan::{LiveScan, Scan, ScanError, Seen, of_recording};

use crate::cli;
use crate::output::{Outcome, bad_usage, file_to_write, print_json};
use crate::table::paragraph;
use crate::terminal;

/// Longest wait for an image before the keys and the time are looked at.
const LOOK: Duration = Duration::from_millis(20);
/// Time between two lines about the scan where there is no progress bar.
const SAY_EVERY: Duration = Duration::from_secs(5);

/// Makes a scan and writes its file.
///
/// # Errors
/// The cell or the recording gives no points, or the file cannot be written.
pub fn run(args: &cli::Scan, config: &CellConfig, json: bool) -> Result<Outcome> {
    let file = file(args)?;
    let scan = match &args.recording {
        Some(recording) => of_recording(recording, config),
        None => {
            let stop = Stop::on_signals().context("watching for Ctrl-C")?;
            let bus = session::join(config)?;
            live(args, config, &bus, &stop)
        }
    };
    let scan = scan.map_err(|error| match error {
        // What the cell or the recording does is no error of the call.
        ScanError::Nothing { .. } | ScanError::Bus(_) => error.into(),
        error => bad_usage(error),
    })?;
    fs::write(&file, scan.to_ply(&config.cell.name))
        .with_context(|| format!("writing {}", file.display()))?;
    report(&file, &scan, json)
}

/// The file to write. A folder that does not exist is told now, not after the arm was guided.
fn file(args: &cli::Scan) -> Result<PathBuf> {
    if let Some(output) = args.output.as_ref().filter(|file| !is_ply(file)) {
        return Err(bad_usage(format!(
            "--output {}: a scan is a PLY file: choose a name that ends in .ply",
            output.display()
        )));
    }
    let file = file_to_write(
        args.output.as_ref(),
        format!("{}.ply", args.name),
        args.force,
    )?;
    let folder = (file.parent()).filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        return Err(bad_usage(format!(
            "--output {}: there is no folder {}: make it first",
            file.display(),
            folder.display()
        )));
    }
    Ok(file)
}

fn is_ply(file: &Path) -> bool {
    file.extension().is_some_and(|ending| ending == "ply")
}

/// Looks until Enter, Ctrl-C or the end of the time.
fn live(args: &cli::Scan, config: &CellConfig, bus: &Bus, stop: &Stop) -> Result<Scan, ScanError> {
    let mut scan = LiveScan::open(bus, config)?;
    stop_at_enter(stop);
    let begun = Instant::now();
    let until = args.duration_s.map(|s| begun + Duration::from_secs_f64(s));
    terminal::say(&match args.duration_s {
        Some(s) => format!("scanning for {s} s: Enter or Ctrl-C ends it earlier"),
        None => "scanning: let the camera see the surface from 0.2 to 0.5 m, and move it slowly; Enter or \
                 Ctrl-C ends the scan"
            .to_owned(),
    });
    let shows = std::io::stderr().is_terminal();
    let bar = shows.then(|| terminal::bar(0, "{wide_msg}"));
    let (mut said, mut said_at) = (Vec::new(), begun);
    while !stop.is_stopped() && until.is_none_or(|until| Instant::now() < until) {
        scan.look(LOOK);
        let now = Instant::now();
        let seen = scan.seen(now);
        tell(&seen, &mut said);
        if let Some(bar) = &bar {
            bar.set_message(seen.words());
        } else if now - said_at > SAY_EVERY {
            said_at = now;
            terminal::say(&seen.words());
        }
    }
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    scan.finish()
}

/// Says what is missing, and that it is there again, once each.
fn tell(seen: &Seen, said: &mut Vec<&'static str>) {
    if seen.missing == *said {
        return;
    }
    for words in seen.missing.iter().filter(|words| !said.contains(words)) {
        terminal::say(words);
    }
    if seen.missing.is_empty() {
        terminal::say("camera and arm are there");
    }
    said.clone_from(&seen.missing);
}

/// Ends the scan at a line of the input. The end of the input is no such line: a script has none.
fn stop_at_enter(stop: &Stop) {
    let stop = stop.clone();
    // It may wait for a line for ever; the process ends without it.
    std::thread::spawn(move || {
        if stdin()
            .read_line(&mut String::new())
            .is_ok_and(|read| read > 0)
        {
            stop.trigger();
        }
    });
}

fn report(file: &Path, scan: &Scan, json: bool) -> Result<Outcome> {
    let is_whole = scan.lost.is_empty();
    if json {
        let (low, high) = scan.bounds_m();
        print_json(&json!({
            "file": file.display().to_string(),
            "points": scan.points.len(),
            "images": scan.images,
            "images_received": scan.tally.received,
            "left_out": scan.tally.left_out(),
            "lost": scan.lost,
            "area_cm2": scan.area_cm2,
            "low_m": low,
            "high_m": high,
        }))?;
    } else {
        println!(
            "{}: written: {} points, {:.0} cm² seen",
            file.display(),
            scan.points.len(),
            scan.area_cm2
        );
        for note in scan.notes() {
            paragraph(2, &format!("note: {note}"));
        }
        println!(
            "Next: tangent region {} --outline ... --approach 0,0,-1",
            file.display()
        );
    }
    Ok(if is_whole {
        Outcome::Done
    } else {
        Outcome::Lossy
    })
}
