//! What an arm that answers late costs on curved surfaces: while a command is under way, the arm
//! moves on and the surface turns under the tool.

use tangent_simulation::evaluate_admittance;
use tangent_simulation::suite::{SurfaceKind, draw};

/// Mean over several cells of the force's RMS error while sliding, N, with strokes of 60 mm/s on
/// `surface`, without errors of the hardware.
fn force_error_n(surface: SurfaceKind, compensated: bool) -> f64 {
    let overrides = [
        "plant.errors={}".to_owned(),
        "plant.sensor.drift_n=0.0".to_owned(),
        "plant.start.tilt_rad=0.0".to_owned(),
        "task.force.reference_n=5.0".to_owned(),
        "task.path={kind='line',to_m=[0.1,0.0],speed_m_per_s=0.06,strokes=2}".to_owned(),
        format!("control.path.delay_compensated={compensated}"),
    ];
    let cells = 8;
    let errors = (0..cells).map(|number| {
        let draw = draw(surface, number, 1).with_overrides(&overrides).unwrap();
        let run = evaluate_admittance(&draw.scenario).unwrap();
        run.figures.force.rmse_n.unwrap()
    });
    errors.sum::<f64>() / cells as f64
}

#[test]
fn a_late_arm_holds_the_force_over_a_curved_surface() {
    for surface in [SurfaceKind::Pipe, SurfaceKind::Sphere] {
        let (with, without) = (force_error_n(surface, true), force_error_n(surface, false));
        println!("{}: {with:.3} N, without {without:.3} N", surface.name());
        assert!(with < 0.9 * without, "{}: {with} {without}", surface.name());
    }
}
