//! `cell.toml`: the file that ships, and what is said about files that are wrong.

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
    assert_eq!(shipped.tool, minimal.tool);
    let robot = tangent_runtime::config::RobotConfig {
        power_on: true,
        ..minimal.robot
    };
    assert_eq!(shipped.robot, robot);
}

/// What is replaced in the file that ships, by what, and what is said about it.
const MISTAKES: &[(&str, &str, &str)] = &[
    (
        "rtde_port = 30004",
        "rtde_prot = 30004",
        "cell.toml, line LINE: unknown key `robot.rtde_prot`, did you mean `rtde_port`?",
    ),
    (
        "force_max_n = 40.0",
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
        "mass_kg = 0.3",
        "mass_kg = \"heavy\"",
        "cell.toml, line LINE: `tool.mass_kg` = \"heavy\": invalid type: string \"heavy\", expected f64",
    ),
    (
        "mass_kg = 0.3",
        "mass_kg = nan",
        "cell.toml, line LINE: `tool.mass_kg` = nan is not allowed: from 0 to 20 kg",
    ),
    (
        "mode = \"realtime\"",
        "mode = \"fast\"",
        "cell.toml, line LINE: `sensor.mode` = \"fast\": unknown variant `fast`, expected `realtime` or `buffered`",
    ),
    (
        "name = \"cell1\"",
        "name = \"my cell\"",
        "cell.toml, line LINE: `cell.name` = \"my cell\" is not allowed: 1 to 32 letters, digits, `_` or `-`",
    ),
    (
        "translation_m = [0.0, 0.0, 0.15]",
        "translation_m = [0.0, 0.0]",
        "cell.toml, line LINE: `tool.flange_from_tool.translation_m` = [0.0, 0.0]: invalid length 2, expected an array of length 3",
    ),
    (
        "translation_m = [0.0, 0.0, 0.15]",
        "translation_m = [0.0, 0.0, 150.0]",
        "cell.toml, line LINE: `tool.flange_from_tool.translation_m` = [0.0, 0.0, 150.0] is not allowed: each from -5 to 5 m",
    ),
    (
        "joint_speed_max_rad_per_s = [1.0]",
        "joint_speed_max_rad_per_s = [1.0, -1.0, 1.0, 1.0, 1.0, 1.0]",
        "`limits.joint_speed_max_rad_per_s` = [1.0, -1.0, 1.0, 1.0, 1.0, 1.0] is not allowed: each from 0.001 to 10",
    ),
    (
        "workspace_min_m = [-1.2, -1.2, -0.5]",
        "workspace_min_m = [-1.2, 1.2, -0.5]",
        "`limits.workspace_min_m` = [-1.2, 1.2, -0.5] is not allowed: every coordinate below that of limits.workspace_max_m",
    ),
    (
        "connect = [\"tcp/127.0.0.1:7447\"]",
        "connect = [\"127.0.0.1\"]",
        "`zenoh.connect` = [\"127.0.0.1\"] is not allowed: a list of endpoints such as \"tcp/127.0.0.1:7447\"",
    ),
    (
        "lease_ms = 1000",
        "lease_ms = 20",
        "`zenoh.lease_ms` = 20 is not allowed: from 400 to 60000 ms (shorter leases expire falsely under load)",
    ),
    (
        "rtde_port = 30004",
        "rtde_port = 70000",
        "cell.toml, line LINE: `robot.rtde_port` = 70000: invalid value: integer `70000`, expected u16",
    ),
    (
        "register_base = 24",
        "register_base = 25",
        "`robot.register_base` = 25 is not allowed: 24 (the registers for external clients)",
    ),
    (
        "filter_cutoff_hz = 50.0",
        "filter_cutoff_hz = 5000.0",
        "`sensor.filter_cutoff_hz` = 5000.0 is not allowed: from 1 to 3150 Hz (at most 0.45 of sensor.rate_hz)",
    ),
    (
        "mass_kg = 0.3",
        "mass_kg = ",
        "cell.toml, line LINE: not TOML:",
    ),
    (
        "loop_priority = 80",
        "loop_priority = 100",
        "`realtime.loop_priority` = 100 is not allowed: from 1 to 99",
    ),
];

#[test]
fn every_mistake_is_named_with_file_line_key_value_and_what_is_allowed() {
    for (right, wrong, said) in MISTAKES {
        let index = DEFAULT_CELL
            .find(right)
            .unwrap_or_else(|| panic!("`{right}` is not in the file that ships"));
        let line = DEFAULT_CELL[..index].lines().count();
        let text = DEFAULT_CELL.replacen(right, wrong, 1);
        let error = CellConfig::parse("cell.toml", &text)
            .err()
            .unwrap_or_else(|| panic!("`{wrong}` was taken"))
            .to_string();
        // A line that begins with the key: `lines` counts it only when something stands before it.
        let said = said.replace(
            "LINE",
            &(line + usize::from(DEFAULT_CELL[..index].ends_with('\n'))).to_string(),
        );
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
fn relative_paths_start_at_the_files_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let text = DEFAULT_CELL.replace("# model_file", "model_file");
    std::fs::write(&path, text).unwrap();
    let config = CellConfig::load(&path).unwrap();
    assert_eq!(
        config.robot.model_file,
        Some(folder.path().join("my_arm.toml"))
    );
}
