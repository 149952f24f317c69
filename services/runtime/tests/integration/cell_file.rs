//! `cell.toml`: the shipped file, and the errors for wrong files.
use tangent_runtime::CellConfig;
use tangent_runtime::config::DEFAULT_CELL;

#[test]
fn the_file_that_ships_shows_every_default_as_it_is() {
    let shipped = CellConfig::default_cell();
    let minimal = CellConfig::parse(
        "minimal",
        "[cell]\nname = \"cell1\"\n[robot]\nmodel = \"ur5\"\naddress = \"127.0.0.1\"\n[sensor]\naddress = \"127.0.0.1\"\n\
         [tool]\nmass_kg = 0.3\ncom_in_sensor_m = [0.0, 0.0, 0.05]\nflange_from_tool = { translation_m = [0.0, 0.0, 0.15] }\n",
    )
    .unwrap();
    assert_eq!(shipped.zenoh, minimal.zenoh);
    assert_eq!(shipped.limits, minimal.limits);
    assert_eq!(shipped.recorder, minimal.recorder);
    assert_eq!(shipped.realtime, minimal.realtime);
    assert_eq!(shipped.simulator, minimal.simulator);
    assert_eq!(shipped.controller, minimal.controller);
    let robot = tangent_runtime::config::RobotConfig {
        power_on: true,
        ..minimal.robot
    };
    assert_eq!(shipped.robot, robot);
}

/// Beginning of a line of the shipped file (its last occurrence), the line in its place, and the
/// error.
const MISTAKES: &[(&str, &str, &str)] = &[
    (
        "rtde_port =",
        "rtde_prot = 30004",
        "cell.toml, line LINE: unknown key `robot.rtde_prot`, did you mean `rtde_port`?",
    ),
    (
        "force_max_n =",
        "force_max = 40.0",
        "cell.toml, line LINE: unknown key `limits.force_max`, did you mean `force_max_n`?",
    ),
    (
        "[recorder]",
        "[recoder]",
        "cell.toml, line LINE: unknown key `recoder`, did you mean `recorder`?",
    ),
    ("mass_kg = 0.3", "", "cell.toml: `tool.mass_kg` is missing"),
    (
        "mass_kg =",
        "mass_kg = \"heavy\"",
        "cell.toml, line LINE: `tool.mass_kg` = \"heavy\": invalid type: string \"heavy\", expected f64",
    ),
    (
        "mass_kg =",
        "mass_kg = nan",
        "cell.toml, line LINE: `tool.mass_kg` = nan is not allowed: from 0 to 20 kg",
    ),
    (
        "mode =",
        "mode = \"fast\"",
        "cell.toml, line LINE: `sensor.mode` = \"fast\": unknown variant `fast`, expected `realtime` or `buffered`",
    ),
    (
        "name =",
        "name = \"my cell\"",
        "cell.toml, line LINE: `cell.name` = \"my cell\" is not allowed: 1 to 32 letters, digits, `_` or `-`",
    ),
    (
        "translation_m =",
        "translation_m = [0.0, 0.0]",
        "cell.toml, line LINE: `tool.flange_from_tool.translation_m` = [0.0, 0.0]: invalid length 2, expected an array of length 3",
    ),
    (
        "translation_m =",
        "translation_m = [0.0, 0.0, 150.0]",
        "cell.toml, line LINE: `tool.flange_from_tool.translation_m` = [0.0, 0.0, 150.0] is not allowed: each from -5 to 5 m",
    ),
    (
        "joint_speed_max_rad_per_s =",
        "joint_speed_max_rad_per_s = [1.0, -1.0, 1.0, 1.0, 1.0, 1.0]",
        "`limits.joint_speed_max_rad_per_s` = [1.0, -1.0, 1.0, 1.0, 1.0, 1.0] is not allowed: each from 0.001 to 10",
    ),
    (
        "workspace_min_m =",
        "workspace_min_m = [-1.2, 1.2, -0.5]",
        "`limits.workspace_min_m` = [-1.2, 1.2, -0.5] is not allowed: every coordinate below that of limits.workspace_max_m",
    ),
    (
        "connect =",
        "connect = [\"127.0.0.1\"]",
        "`zenoh.connect` = [\"127.0.0.1\"] is not allowed: a list of endpoints such as \"tcp/127.0.0.1:7447\"",
    ),
    (
        "lease_ms =",
        "lease_ms = 20",
        "`zenoh.lease_ms` = 20 is not allowed: from 400 to 60000 ms (shorter leases expire falsely under load)",
    ),
    (
        "rtde_port =",
        "rtde_port = 70000",
        "cell.toml, line LINE: `robot.rtde_port` = 70000: invalid value: integer `70000`, expected u16",
    ),
    (
        "register_base =",
        "register_base = 20",
        "`robot.register_base` = 20 is not allowed: from 24 to 40",
    ),
    (
        "filter_cutoff_hz =",
        "filter_cutoff_hz = 5000.0",
        "`sensor.filter_cutoff_hz` = 5000.0 is not allowed: from 1 to 3150 Hz (at most 0.45 of sensor.rate_hz)",
    ),
    ("mass_kg =", "mass_kg = ", "cell.toml, line LINE: not TOML:"),
    (
        "loop_priority =",
        "loop_priority = 100",
        "`realtime.loop_priority` = 100 is not allowed: from 1 to 99",
    ),
];

#[test]
fn every_mistake_is_named_with_file_line_key_value_and_what_is_allowed() {
    for (begin, wrong, said) in MISTAKES {
        let mut lines: Vec<&str> = DEFAULT_CELL.lines().collect();
        let index = lines
            .iter()
            .rposition(|line| line.starts_with(begin))
            .unwrap_or_else(|| panic!("no line of the file that ships begins with `{begin}`"));
        lines[index] = wrong;
        let error = CellConfig::parse("cell.toml", &lines.join("\n"))
            .err()
            .unwrap_or_else(|| panic!("`{wrong}` was taken"))
            .to_string();
        let said = said.replace("LINE", &(index + 1).to_string());
        assert!(
            error.contains(&said),
            "`{wrong}` gave\n  {error}\ninstead of\n  {said}"
        );
    }
}

#[test]
fn a_missing_file_is_named() {
    let error = CellConfig::load(std::path::Path::new("/nowhere/cell.toml")).unwrap_err();
    assert!(
        error.to_string().starts_with("/nowhere/cell.toml: "),
        "{error}"
    );
}

#[test]
fn relative_paths_start_at_the_files_folder_and_the_text_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let text = DEFAULT_CELL.replace("# model_file", "model_file");
    std::fs::write(&path, &text).unwrap();
    let config = CellConfig::load(&path).unwrap();
    assert_eq!(config.text(), text);
    assert_eq!(
        config.robot.model_file,
        Some(folder.path().join("my_arm.toml"))
    );
}

#[test]
fn the_factory_calibration_corrects_the_model_and_a_wrong_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    std::fs::write(
        &path,
        DEFAULT_CELL.replace("# calibration_file", "calibration_file"),
    )
    .unwrap();
    let config = CellConfig::load(&path).unwrap();
    let missing = config.robot.model_data().unwrap_err().to_string();
    assert!(
        missing.starts_with("[robot] calibration_file = ") && missing.contains("No such file"),
        "{missing}"
    );
    let file = folder.path().join("calibration.conf");
    std::fs::write(&file, "[mounting]\ndelta_theta = [0]\n").unwrap();
    let short = config.robot.model_data().unwrap_err().to_string();
    assert!(short.contains("line 2: `delta_theta` = [0]"), "{short}");
    let zeros = "[0, 0, 0, 0, 0, 0]";
    let text = format!(
        "[mounting]\ndelta_theta = {zeros}\ndelta_a = [0, 0, 1e-3, 0, 0, 0]\n\
         delta_d = {zeros}\ndelta_alpha = {zeros}\n"
    );
    std::fs::write(&file, text).unwrap();
    let corrected = config.robot.model_data().unwrap();
    let table = tangent_mechanics::ModelData::builtin(&config.robot.model).unwrap();
    assert_eq!(
        corrected.dh.rows[2].a_m,
        table.dh.rows[2].a_m + 1e-3,
        "the third row alone"
    );
}

/// Contents of `[sensor]` for an arm's own sensor or a topic, and the error.
const SENSOR_MISTAKES: &[(&str, &str)] = &[
    (
        "",
        "`sensor.address` = \"\" is not allowed: a host name or an IP address of the Net F/T box; without a box, set sensor.driver",
    ),
    (
        "driver = \"ati\"",
        "`sensor.driver` = \"ati\": unknown variant `ati`, expected one of `netft`, `ur`, `topic`",
    ),
    (
        "driver = \"ur\"\nrate_hz = 500.0",
        "`sensor.force_range_n` = [130.0, 130.0, 400.0] is not allowed: the range of this sensor, from its data sheet",
    ),
    (
        "driver = \"ur\"\nforce_range_n = [50.0, 50.0, 50.0]\ntorque_range_nm = [10.0, 10.0, 10.0]",
        "`sensor.rate_hz` = 0 is not allowed: 500.0, the rate of the robot's packets",
    ),
    (
        "driver = \"ur\"\nrate_hz = 500.0\nforce_range_n = [50.0, 50.0, 50.0]\ntorque_range_nm = [10.0, 10.0, 10.0]\n\
         ur = { reading = \"force\" }",
        "`sensor.ur.reading` = \"force\": unknown variant `force`, expected `ft_raw_wrench` or `actual_TCP_force`",
    ),
    (
        "driver = \"ur\"\nrate_hz = 500.0\nforce_range_n = [50.0, 50.0, 50.0]\ntorque_range_nm = [10.0, 10.0, 10.0]\n\
         flange_from_sensor = { translation_m = [0.0, 0.0, 0.01] }",
        "none with sensor.driver = \"ur\": this sensor measures at the flange. Remove the table",
    ),
    (
        "address = \"127.0.0.1\"\nur = { reading = \"ft_raw_wrench\" }",
        "is not allowed: \"ur\" where there is a table [sensor.ur]",
    ),
    (
        "driver = \"topic\"\nforce_range_n = [50.0, 50.0, 50.0]\ntorque_range_nm = [10.0, 10.0, 10.0]",
        "`sensor.topic.key` = \"\" is not allowed: a topic's name without a leading /",
    ),
    (
        "driver = \"topic\"\nforce_range_n = [50.0, 50.0, 50.0]\ntorque_range_nm = [10.0, 10.0, 10.0]\n\
         topic = { key = \"wrench/tool\" }",
        "`sensor.topic.key` = \"wrench/tool\" is not allowed",
    ),
];

#[test]
fn an_impossible_sensor_is_reported_by_name() {
    for (sensor, said) in SENSOR_MISTAKES {
        let text = format!(
            "[cell]\nname = \"a\"\n[robot]\nmodel = \"ur5e\"\naddress = \"127.0.0.1\"\n[tool]\nmass_kg = 0.3\n\
             com_in_sensor_m = [0.0, 0.0, 0.05]\nflange_from_tool = {{ translation_m = [0.0, 0.0, 0.15] }}\n[sensor]\n{sensor}\n"
        );
        let error = CellConfig::parse("cell.toml", &text).unwrap_err();
        assert!(error.to_string().contains(said), "{sensor}: {error}");
    }
}
