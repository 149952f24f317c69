//! Waves that are shorter than those of `sheet`, under a small ball and with the settings of a
//! cell: the rows on waves of `docs/estimators.md`.

use tangent_simulation::{AdmittanceScenario, Evaluation, FileError, evaluate_admittance};

/// A raster over waves of 4 mm and `wavelength_m`, with a tip that nobody has described.
fn run(wavelength_m: f64) -> Evaluation {
    let file = format!("{}/../../scenarios/sheet.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&file).unwrap();
    let overrides = [
        "plant.surface.amplitude_m=[0.004,0.0]".to_owned(),
        format!("plant.surface.wavelength_m=[{wavelength_m},0.15]"),
        "plant.tool.tip={shape=\"round\",radius_m=0.005}".to_owned(),
        "plant.start.tilt_rad=0.1".to_owned(),
        "task.path.length_m=0.08".to_owned(),
        "estimation={}".to_owned(),
    ];
    let none = |_: &str| Err(FileError::new("no file"));
    let scenario = AdmittanceScenario::parse(&file, &text, &overrides, &none).unwrap();
    evaluate_admittance(&scenario).unwrap()
}

#[test]
fn the_estimate_follows_waves_and_says_how_well() {
    for (wavelength_m, most_deg, nees_most) in
        [(0.12, 1.5, 2.0), (0.08, 3.5, 2.0), (0.06, 7.0, 3.0)]
    {
        let run = run(wavelength_m);
        let figures = run.figures;
        let normal = figures.normal_error_settled_deg.unwrap().mean;
        let nees = figures.normal_nees_per_dof.unwrap();
        println!(
            "{wavelength_m} m: normal {normal:.2} deg, NEES {nees:.2}, force {:?} N",
            figures.force.rmse_n
        );
        assert_eq!(run.phase, "done", "{:?}", run.fault);
        assert!(normal <= most_deg, "{wavelength_m} m: {normal} deg");
        assert!(
            (0.3..=nees_most).contains(&nees),
            "{wavelength_m} m: {nees}"
        );
    }
}
