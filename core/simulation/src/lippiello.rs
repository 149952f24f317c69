//! The figures that `tangent reproduce lippiello` states: four systems over the same seeds of
//! calibration error, and what to read off their runs.

use serde::Serialize;

use crate::Evaluation;
use crate::metrics::object_pose::{CalibrationError, ObjectPoseFigures};

/// The scenario that is reproduced.
pub const SCENARIO: &str = "lippiello_plane";

/// The four systems.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum System {
    /// The paper's law and filter with the camera alone: its first simulation.
    PaperVision,
    /// The paper's law and filter with all measurements: its second.
    PaperAll,
    /// Our law and filter with the camera alone.
    OursVision,
    /// Our law and filter with all measurements.
    OursAll,
}

impl System {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::PaperVision,
        Self::PaperAll,
        Self::OursVision,
        Self::OursAll,
    ];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::PaperVision => "paper's law and filter, vision only",
            Self::PaperAll => "paper's law and filter, vision + force + joints",
            Self::OursVision => "default law and object_pose, vision only",
            Self::OursAll => "default law and object_pose, vision + force + joints",
        }
    }

    /// Overrides of the scenario.
    pub fn overrides(self) -> Vec<String> {
        let (law, filter, measurements) = match self {
            Self::PaperVision => ("paper", "object_pose_paper", "vision"),
            Self::PaperAll => ("paper", "object_pose_paper", "all"),
            Self::OursVision => ("default", "object_pose", "vision"),
            Self::OursAll => ("default", "object_pose", "all"),
        };
        vec![
            format!("controller=\"{law}\""),
            format!("task.estimators=[\"{filter}\"]"),
            format!("estimation.measurements=\"{measurements}\""),
        ]
    }
}

/// Pressing force that the paper's task asks for, N.
const REFERENCE_N: f64 = 20.0;
/// At most this share of the peak is to be left.
const PEAK_SHARE: f64 = 0.75;

/// One figure. `here` is the median over the seeds; goals are upper bounds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LippielloFigure {
    /// Which system, or which two.
    pub row: String,
    /// What is measured.
    pub metric: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Median over the seeds; null where a run has no such figure.
    pub here: Option<f64>,
    /// Largest over the seeds.
    pub worst: Option<f64>,
    /// At most this; null where nothing is promised.
    pub goal: Option<f64>,
    /// `here` is within `goal`.
    pub met: Option<bool>,
}

/// The runs of one system, one per seed.
pub struct Runs {
    /// Which system.
    pub system: System,
    /// In order of the seeds.
    pub runs: Vec<Evaluation>,
}

type Pick = fn(&ObjectPoseFigures) -> Option<f64>;

/// All figures of section 4 from the runs of all four systems, in the order of [`System::ALL`].
pub fn figures(runs: &[Runs]) -> Vec<LippielloFigure> {
    let mut table = Vec::new();
    let of = |system: System| {
        runs.iter()
            .find(|r| r.system == system)
            .map_or(&[][..], |r| &r.runs)
    };
    for system in System::ALL {
        let ours = system == System::OursAll;
        let goal = |value: f64| ours.then_some(value);
        let mut add = |metric, unit, goal, pick: Pick| {
            let values = picked(of(system), pick);
            table.push(figure(system.name().to_owned(), metric, unit, values, goal));
        };
        add(
            "position error along the normal, 1 s after contact",
            "mm",
            goal(0.3),
            |f| Some(f.along_normal_settled_m? * 1e3),
        );
        add(
            "orientation error about the plane's axes, 1 s after contact",
            "deg",
            goal(0.2),
            |f| f.about_surface_settled_deg,
        );
        add(
            "position error in the plane, 1 s after contact",
            "mm",
            None,
            |f| Some(f.across_normal_settled_m? * 1e3),
        );
        add(
            "normal force during the circle, RMSE",
            "N",
            goal(0.2),
            |f| f.sliding_force_rmse_n,
        );
        add(
            "other forces after the transient, largest",
            "N",
            goal(0.3),
            |f| f.lateral_force_max_n,
        );
        add(
            "moments after the transient, largest",
            "Nm",
            goal(0.1),
            |f| f.moment_max_nm,
        );
        add("peak force at contact", "N", goal(30.0), |f| {
            f.peak_at_contact_n
        });
        add(
            "circle: position in the plane against the estimated object, RMSE",
            "mm",
            goal(1.0),
            |f| Some(f.path_on_estimate_rmse_m? * 1e3),
        );
        add(
            "circle: position in the plane against the true object, RMSE",
            "mm",
            None,
            |f| Some(f.path_on_object_rmse_m? * 1e3),
        );
    }
    for (all, vision, goal) in [
        (System::PaperAll, System::PaperVision, false),
        (System::OursAll, System::OursVision, true),
        (System::OursAll, System::PaperVision, true),
    ] {
        let row = format!("{}, over {}", all.name(), vision.name());
        let mut add = |metric, limit: f64, pick: Pick| {
            // Of the medians: a single seed's error may be anything down to nothing.
            let share = median(&picked(of(all), pick))
                .zip(median(&picked(of(vision), pick)))
                .map(|(a, b)| a / b);
            let values = share.map(|s| vec![s]);
            table.push(figure(
                row.clone(),
                metric,
                "",
                values,
                (goal && limit.is_finite()).then_some(limit),
            ));
        };
        add("position error along the normal, share left", 0.1, |f| {
            f.along_normal_settled_m
        });
        add(
            "orientation error about the plane's axes, share left",
            0.1,
            |f| f.about_surface_settled_deg,
        );
        // No peak lies below the force that is asked for: where the camera alone leaves less than
        // that to take away, there is no goal.
        let vision_peak = median(&picked(of(vision), |f| f.peak_at_contact_n));
        let within_reach = vision_peak.is_none_or(|n| PEAK_SHARE * n >= REFERENCE_N);
        let share = if within_reach {
            PEAK_SHARE
        } else {
            f64::INFINITY
        };
        add("peak force at contact, share", share, |f| {
            f.peak_at_contact_n
        });
    }
    calibration(of(System::OursAll), &mut table);
    table
}

fn calibration(runs: &[Evaluation], table: &mut Vec<LippielloFigure>) {
    let row = "default law and object_pose, after one circle".to_owned();
    let stated = |f: &ObjectPoseFigures| f.calibration_stated;
    let last = |f: &ObjectPoseFigures| f.calibration_final;
    let mut add = |metric, pick: fn(&CalibrationError) -> f64, goal: Option<f64>| {
        let values = |which: &dyn Fn(&ObjectPoseFigures) -> Option<CalibrationError>| {
            runs.iter()
                .map(|r| which(r.object_pose.as_ref()?).map(|c| pick(&c)))
                .collect::<Option<Vec<f64>>>()
        };
        let share = median(&values(&last))
            .zip(median(&values(&stated)))
            .map(|(after, before)| after / before);
        table.push(figure(
            row.clone(),
            metric,
            "",
            share.map(|s| vec![s]),
            goal,
        ));
    };
    add(
        "camera's position along the normal, error left as a share",
        |c| c.along_normal_m,
        Some(0.2),
    );
    add(
        "camera's orientation about the plane's axes, error left as a share",
        |c| c.about_surface_deg,
        Some(0.2),
    );
    add(
        "camera's position in the plane, error left as a share",
        |c| c.across_normal_m,
        None,
    );
    add(
        "focal length, error left as a share",
        |c| c.focal_share,
        None,
    );
    let nees = picked(runs, |f| f.nees_per_dof);
    table.push(figure(
        row.clone(),
        "NEES per degree of freedom, pose and camera",
        "",
        nees.clone(),
        Some(2.0),
    ));
    let inverse = nees.map(|v| v.iter().map(|x| 1.0 / x).collect());
    table.push(figure(
        row.clone(),
        "one over the same: not too cautious either",
        "",
        inverse,
        Some(2.0),
    ));
    let cost: Option<Vec<f64>> = runs
        .iter()
        .map(|r| r.real_time_factor.map(|f| 1.0 / f))
        .collect();
    table.push(figure(
        row,
        "time that a simulated second takes",
        "s",
        cost,
        Some(0.02),
    ));
}

/// None as soon as one run lacks the figure: it must not make the others look good.
fn picked(runs: &[Evaluation], pick: Pick) -> Option<Vec<f64>> {
    let values: Option<Vec<f64>> = runs.iter().map(|r| pick(r.object_pose.as_ref()?)).collect();
    values.filter(|v| !v.is_empty())
}

fn median(values: &Option<Vec<f64>>) -> Option<f64> {
    let mut sorted = values.clone().filter(|v| !v.is_empty())?;
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    Some(0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]))
}

fn figure(
    row: String,
    metric: &'static str,
    unit: &'static str,
    values: Option<Vec<f64>>,
    goal: Option<f64>,
) -> LippielloFigure {
    let here = median(&values);
    LippielloFigure {
        row,
        metric,
        unit,
        here,
        worst: values.and_then(|v| v.into_iter().reduce(f64::max)),
        goal,
        met: goal.map(|goal| here.is_some_and(|here| here <= goal)),
    }
}
