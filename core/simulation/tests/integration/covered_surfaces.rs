//! Coverage that closes on every surface of the contact suite, on cells drawn as the suite draws
//! them: misaligned landings, stiffness, friction, errors of frames and sensor.

use tangent_control::{CoverageResult, Phase};
use tangent_mechanics::Tip;
use tangent_simulation::AdmittanceLoop;
use tangent_simulation::suite::{SurfaceKind, draw};

/// Draws of each surface.
const DRAWS: u64 = 6;
const TIP: Tip = Tip::Flat { radius_m: 0.008 };
const DURATION_S: f64 = 400.0;
/// A region of 16 cm² beside the place where the tool touches down, with 5 N.
const TASK: [&str; 5] = [
    "duration_s=400.0",
    "task.timeouts.task_s=400.0",
    "task.force={reference_n=5.0}",
    "task.path={kind=\"region\",outline_m=[[0.0,0.025],[0.04,0.025],[0.04,0.065],[0.0,0.065]],margin_m=0.003,spacing_m=0.008,speed_m_per_s=0.03}",
    "task.coverage={radius_m=0.008,dose_n_s_per_cm2=[0.8,14.0]}",
];

/// A contact that is stiffer, kN/m, bounds the speed of the path so much that some places get more
/// than the band: `pace.hit_share` of the force up to its limit, over stiffness and delay.
const STIFF_KN_PER_M: f64 = 50.0;
/// Regions of which some place gets more than the band.
const BEYOND_MAX: u32 = 4;

struct Run {
    stiffness_kn_per_m: f64,
    end: Phase,
    fault: Option<tangent_control::Fault>,
    peak_n: f64,
    result: Option<CoverageResult>,
}

fn run(kind: SurfaceKind, number: u64) -> Run {
    let drawn = draw(kind, number, 1)
        .with_overrides(&TASK.map(str::to_owned))
        .unwrap();
    let stiffness_kn_per_m = drawn.conditions().stiffness_kn_per_m;
    let mut scenario = drawn.scenario;
    scenario.plant.tool.tip = Some(TIP);
    scenario.estimation.contact.tip = TIP;
    let mut cell = AdmittanceLoop::new(&scenario).unwrap();
    let mut run = Run {
        stiffness_kn_per_m,
        end: Phase::Idle,
        fault: None,
        peak_n: 0.0,
        result: None,
    };
    while cell.plant().time_s() < DURATION_S {
        cell.step(&mut |c| {
            run.end = c.output.phase;
            run.fault = c.output.fault;
            run.peak_n = run.peak_n.max(c.truth.wrench.force.norm());
        });
        if !run.end.is_active() && run.end != Phase::Idle {
            break;
        }
    }
    run.result = cell.controller().coverage_result();
    run
}

/// On the surface with a rim, the region may reach beyond it.
#[test]
fn regions_are_covered_on_every_surface_of_the_suite() {
    let (mut regions, mut within) = (0, 0);
    for kind in SurfaceKind::ALL {
        for number in 0..DRAWS {
            let run = run(kind, number);
            let name = format!("{} {number}", kind.name());
            println!(
                "{name}, {:.0} kN/m: {:?} {:?}, {:?}, peak {:.1} N",
                run.stiffness_kn_per_m, run.end, run.fault, run.result, run.peak_n
            );
            if kind == SurfaceKind::Edge {
                continue;
            }
            assert_eq!((run.end, run.fault), (Phase::Done, None), "{name}");
            let result = run.result.unwrap();
            assert!(
                result.under_cm2 <= 0.01 * result.area_cm2,
                "{name}: {result:?}"
            );
            let least = if run.stiffness_kn_per_m > STIFF_KN_PER_M {
                0.7
            } else {
                0.99
            };
            assert!(result.share >= least, "{name}: {result:?}");
            regions += 1;
            within += u32::from(result.share >= 0.99);
        }
    }
    assert!(within + BEYOND_MAX >= regions, "{within} of {regions}");
}
