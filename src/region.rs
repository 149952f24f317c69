//! `tangent region`: a part of a mesh or a scan becomes a task file.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::json;
use tangent_check::{FileKind, OnCell, check_file};
use tangent_compose::model;
use tangent_control::Pattern;
use tangent_mechanics::{Base, Pose, Tip};
use tangent_region::{
    Draft, Match, Mesh, MeshFrame, RegionOptions, Selection, draft, from_matches, pose, read,
};
use tangent_runtime::CellConfig;
use tangent_runtime::config::Law;

use crate::cli::{Region, RegionPattern};
use crate::output::{Outcome, bad_usage, file_to_write, print_json};
use crate::table::paragraph;

/// Places of --match that differ by more than this are told, m.
const MATCHED_M: f64 = 0.002;

/// Makes a task of a region, and writes its file.
///
/// # Errors
/// The mesh, the region or an option is not usable, or the file cannot be written.
pub fn run(args: &Region, config: &CellConfig, json: bool) -> Result<Outcome> {
    let name = match &args.name {
        Some(name) => name.clone(),
        None => stem(&args.file)?,
    };
    let file = file_to_write(args.output.as_ref(), format!("{name}.toml"), args.force)?;
    let mut notes = Vec::new();
    let surface = surface(args, config, &mut notes)?;
    let model = model(config)?;
    let flange_from_tool = config.tool.flange_from_tool();
    let travels = config.controller.law == Law::HybridAdmittance && !args.no_start;
    let source = args.file.display().to_string();
    let options = RegionOptions {
        name: &name,
        source: &source,
        selection: selection(args),
        approach: args.approach,
        rows_along: args.rows_along,
        outline_m: args.outline.as_ref().map(|ring| ring.0.clone()),
        holes_m: args.hole.iter().map(|ring| ring.0.clone()).collect(),
        pattern: match args.pattern {
            RegionPattern::Raster => Pattern::Raster,
            RegionPattern::Contour => Pattern::Contour,
            RegionPattern::Spiral => Pattern::Spiral,
        },
        edge_pass: args.edge_pass,
        edge_force_n: args.edge_force_n,
        edge_speed_m_per_s: args.edge_speed,
        radius_m: radius_m(args, config)?,
        spacing_m: args.spacing_m,
        margin_m: args.margin_m,
        touch_m: args.touch,
        force_n: args.force_n,
        speed_m_per_s: args.speed,
        dose_n_s_per_cm2: args.dose,
        clearance_m: args.clearance_m,
        arm: travels.then_some((&model, &flange_from_tool)),
    };
    let mut draft = draft(&surface, &options).map_err(|error| bad_usage(error.to_string()))?;
    notes.append(&mut draft.notes);
    draft.notes = notes;
    fs::write(&file, &draft.text).with_context(|| format!("writing {}", file.display()))?;
    report(&file, &name, &draft, json)
}

fn stem(file: &Path) -> Result<String> {
    let stem = file.file_stem().and_then(|stem| stem.to_str());
    stem.filter(|stem| !stem.is_empty() && stem.len() <= 64)
        .map(ToOwned::to_owned)
        .ok_or_else(|| bad_usage("the file's name gives no task's name: state --name"))
}

fn selection(args: &Region) -> Selection {
    let angle_rad = args.angle_deg.to_radians();
    match (args.seed, args.facing) {
        (Some(at_m), _) => Selection::Seed { at_m, angle_rad },
        (None, Some(direction)) => Selection::Facing {
            direction,
            angle_rad,
        },
        (None, None) => Selection::All,
    }
}

/// The mesh or the scan in base axes.
fn surface(args: &Region, config: &CellConfig, notes: &mut Vec<String>) -> Result<Mesh> {
    let usage = |error: tangent_region::RegionError| bad_usage(error.to_string());
    if args.file.extension().is_some_and(|ending| ending == "mcap") {
        let scan = tangent_scan::of_recording(&args.file, config).map_err(bad_usage)?;
        notes.append(&mut scan.notes());
        return Mesh::of_points(scan.points).map_err(usage);
    }
    let mesh = read(&args.file).map_err(usage)?;
    let base_from_mesh: Pose<Base, MeshFrame> = if !args.matches.is_empty() {
        let matches: Vec<Match> = (args.matches.iter())
            .map(|(in_mesh, in_base)| Match {
                in_mesh: *in_mesh,
                in_base: *in_base,
            })
            .collect();
        let (pose, left_m) = from_matches(&matches).map_err(usage)?;
        if left_m > MATCHED_M {
            notes.push(format!(
                "the places of --match fit the mesh within {:.1} mm only",
                left_m * 1e3
            ));
        }
        pose
    } else if args.frame.is_empty() {
        Pose::identity()
    } else {
        pose(&args.frame).map_err(usage)?
    };
    mesh.placed(args.scale, &base_from_mesh).map_err(usage)
}

fn radius_m(args: &Region, config: &CellConfig) -> Result<f64> {
    match (args.radius_m, config.tool.tip.tip()) {
        (Some(radius_m), _) => Ok(radius_m),
        (None, Tip::Flat { radius_m } | Tip::Ring { radius_m } | Tip::Soft { radius_m }) => {
            Ok(radius_m)
        }
        (None, Tip::Round { .. } | Tip::Unknown) => Err(bad_usage(
            "the radius of the tip's contact is not known: state --radius-m, or a flat, ring or soft tip with its \
             radius in [tool.tip] of the cell file",
        )),
    }
}

fn report(file: &Path, name: &str, draft: &Draft, json: bool) -> Result<Outcome> {
    let (_, findings) = check_file(file, Some(FileKind::Task), None::<&OnCell>);
    let good = findings.errors.is_empty();
    let origin: [f64; 3] = draft.plane.origin.into();
    if json {
        print_json(&json!({
            "file": file.display().to_string(),
            "good": good,
            "errors": findings.errors,
            "name": name,
            "strokes": draft.strokes,
            "edge_strokes": draft.edge_strokes,
            "lifts": draft.lifts,
            "length_m": draft.length_m,
            "area_cm2": draft.area_cm2,
            "steepest_deg": draft.steepest_deg,
            "touch_m": origin,
            "start_joints_rad": draft.start_joints_rad,
            "notes": draft.notes,
        }))?;
    } else {
        println!(
            "{}: written: {} strokes with {} lifts, {:.0} mm, on {:.1} cm² up to {:.0}° steep",
            file.display(),
            draft.strokes,
            draft.lifts,
            draft.length_m * 1e3,
            draft.area_cm2,
            draft.steepest_deg
        );
        for error in &findings.errors {
            paragraph(2, error);
        }
        for note in &draft.notes {
            paragraph(2, &format!("note: {note}"));
        }
        println!("Next: tangent check {}", file.display());
    }
    Ok(if good {
        Outcome::Done
    } else {
        Outcome::Refused
    })
}
