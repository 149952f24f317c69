//! `tangent ui`: the operator's page, in a process of its own.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use serde_json::json;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop, ending, watchdog};
use tangent_sensing::{StaticPose, identify_payload};
use tangent_ui::access::{self, Role as PageRole};
use tangent_ui::{Calibration, CalibrationStep, Calibrator, Config, Reporter, Tools};

use crate::calibrate;
use crate::cli::{POSES, Ui, UiRole};
use crate::output::{Outcome, bad_usage, print_json};
use crate::page_teacher::PageTeacher;

/// Name of the person whose token is valid for one run of the page.
const LOCAL: &str = "local";

/// Serves the page until SIGINT or SIGTERM, or gives a person a token.
///
/// # Errors
/// The address or the file of the tokens cannot be used, or the cell cannot be reached.
pub fn run(args: &Ui, mut cell: CellConfig, json: bool) -> Result<Outcome> {
    if let Some(name) = &args.new_token {
        return new_token(name, args.role, &cell, json);
    }
    cell.ui.address = args.address.unwrap_or(cell.ui.address);
    let model = tangent_compose::model(&cell)?;
    let mut config = Config::from_cell(&cell, &model).map_err(bad_usage)?;
    // Without people of its own, the page is for whoever started it.
    let token = match config.tokens.is_empty() {
        true => Some(
            config
                .tokens
                .add_for_this_process(LOCAL, PageRole::Engineer)?,
        ),
        false => None,
    };
    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    ending::in_order(&stop);
    cell.zenoh
        .identify(&roles::identity(tangent_ui::SERVICE, &cell.cell.name));
    // Pages are for people: they need no real-time priority.
    cell.realtime.enabled = false;
    let bus = Bus::open_until(&cell, Role::Client, None, &stop)?;
    watchdog::watch(&stop, None).context("starting the watchdog")?;
    let report: Reporter = Arc::new(|recording: &Path| {
        tangent_report::write_for(&[recording.to_owned()])
            .map(|(_, page)| page)
            .map_err(|error| error.to_string())
    });
    let teach = Arc::new(PageTeacher::new(&bus, &cell, model));
    let calibrate: Calibrator = {
        let (bus, cell, poses) = (bus.clone(), cell, Mutex::new(Vec::new()));
        Arc::new(move |step| {
            // A pose is added whole, so the list is usable after a panic too.
            let mut poses = poses.lock().unwrap_or_else(PoisonError::into_inner);
            calibration_step(step, &mut poses, &bus, &cell)
        })
    };
    let tools = Tools {
        report: Some(report),
        calibrate: Some(calibrate),
        teach: Some(teach),
    };
    tangent_ui::run(config, &bus, &stop, tools, |address| {
        let mut page = format!("http://{address}/");
        if let Some(token) = &token {
            page += &format!("#token={token}");
        }
        // The address is also for programs, which read the first line.
        let printed = if json {
            print_json(&json!({ "page": page }))
        } else {
            println!("{page}");
            Ok(())
        };
        if let Err(error) = printed {
            tracing::warn!("the page's address cannot be printed: {error:#}");
        }
        if args.open
            && let Err(error) = open::that(&page)
        {
            tracing::warn!("no browser was opened: {error}");
        }
    })?;
    bus.close();
    Ok(Outcome::Done)
}

/// One step of the payload's calibration.
fn calibration_step(
    step: CalibrationStep,
    poses: &mut Vec<StaticPose>,
    bus: &Bus,
    cell: &CellConfig,
) -> Calibration {
    let mut state = Calibration {
        done: true,
        wanted: usize::from(POSES),
        ..Calibration::default()
    };
    match step {
        CalibrationStep::Begin => poses.clear(),
        CalibrationStep::Pose => match tangent_calibrate::pose(bus, cell) {
            Ok(pose) => poses.push(pose),
            Err(error) => {
                state.done = false;
                state.message = format!("{:#}", anyhow::Error::from(error));
            }
        },
    }
    state.poses = poses.len();
    match identify_payload(poses, &cell.robot.gravity_in_base()) {
        Ok(found) => {
            state.cell_file = Some(calibrate::cell_file(&found, poses.len(), cell));
            state.warnings = tangent_calibrate::warnings(&found, cell);
        }
        // Some poses are missing still.
        Err(error) if state.done && !poses.is_empty() => state.message = error.to_string(),
        Err(_) => {}
    }
    state
}

fn new_token(name: &str, role: UiRole, cell: &CellConfig, json: bool) -> Result<Outcome> {
    let Some(file) = &cell.ui.tokens else {
        return Err(bad_usage(
            "[ui] tokens is not set: name the file in the cell file, as in tokens = \"ui_tokens.toml\", and give it with \
             --cell",
        ));
    };
    let role = match role {
        UiRole::Operator => PageRole::Operator,
        UiRole::Engineer => PageRole::Engineer,
    };
    let token = access::new_person(file, name, role).map_err(bad_usage)?;
    if json {
        print_json(&json!({ "name": name, "role": role.to_string(), "token": token }))?;
    } else {
        println!("{token}");
        eprintln!(
            "token of {name} ({role}); its digest is in {}. It is shown only once. A running page takes it at its next \
             start",
            file.display()
        );
    }
    Ok(Outcome::Done)
}
