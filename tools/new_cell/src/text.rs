//! The text of a cell file.

use std::fmt::Write as _;

use crate::answers::{NewCell, Ranges, Sensor, is_franka};

/// The file of a cell, as TOML with comments. It is not checked here.
pub fn text(cell: &NewCell) -> String {
    let mut text = format!(
        "# A cell, made by `tangent cell new`. Measure every value marked \"set\". Keys that are left out have the\n\
         # defaults shown in deploy/cell.toml. `tangent check FILE` checks this file, `tangent doctor --cell FILE` the\n\
         # machine, the robot and the sensor.\n\n\
         [cell]\nname = {}\n\n[robot]\n",
        quoted(&cell.name)
    );
    let franka = is_franka(&cell.model);
    if franka {
        text += "driver = \"franka\"\n";
    }
    let _ = writeln!(
        text,
        "model = {}\naddress = {}",
        quoted(&cell.model),
        quoted(&cell.robot_address)
    );
    if franka {
        text += FRANKA;
    } else {
        text += "power_on = false                    # switch the arm on by hand, on the pendant\n";
    }
    text += "\n";
    text += &sensor(&cell.sensor);
    text += TOOL;
    text += if franka { FRANKA_END } else { UR_END };
    text
}

fn sensor(sensor: &Sensor) -> String {
    let range = |ranges: &Ranges| {
        let (f, t) = (ranges.force_n, ranges.torque_nm);
        format!(
            "force_range_n = [{f:?}, {f:?}, {f:?}]    # set: from the sensor's data sheet\n\
             torque_range_nm = [{t:?}, {t:?}, {t:?}]\n"
        )
    };
    match sensor {
        Sensor::Netft { address } => format!(
            "[sensor]\naddress = {}\nforce_range_n = [130.0, 130.0, 400.0]    # set: ranges of the calibration in use\n\
             torque_range_nm = [10.0, 10.0, 10.0]\n\n{MOUNTING}",
            quoted(address)
        ),
        Sensor::Ur { ranges } => format!(
            "[sensor]\ndriver = \"ur\"                       # the sensor in the arm's flange\n\
             rate_hz = 500.0\nfilter_cutoff_hz = 30.0             # this sensor has more noise than a Net F/T\n{}\
             zero_drift_n_per_min = 0.5          # it drifts by 1 to 2 N while it warms up\n\
             zero_drift_nm_per_min = 0.02\nzero_jump_max_n = 2.0\nzero_jump_max_nm = 0.2\n\n",
            range(ranges)
        ),
        Sensor::Topic {
            key,
            rate_hz,
            ranges,
        } => {
            let cutoff_hz = (0.2 * rate_hz).clamp(1.0, 50.0);
            format!(
                "[sensor]\ndriver = \"topic\"                    # a WrenchStamped that another program publishes\n\
                 rate_hz = {rate_hz:?}\nfilter_cutoff_hz = {cutoff_hz:?}\n{}\n\
                 [sensor.topic]\nkey = {}\n\n{MOUNTING}",
                range(ranges),
                quoted(key)
            )
        }
        Sensor::Joints => {
            "# The robot estimates the wrench; there is no sensor box.\n[sensor]\naddress = \"none\"\n\n"
                .to_owned()
        }
    }
}

/// A TOML string.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(quoted, "\\u{:04X}", u32::from(c));
            }
            c => quoted.push(c),
        }
    }
    quoted + "\""
}

const MOUNTING: &str = "\
[sensor.flange_from_sensor]         # set: pose of the sensor on the flange
translation_m = [0.0, 0.0, 0.045]
rotation_vector_rad = [0.0, 0.0, 0.0]

";

const TOOL: &str = "\
[tool]                              # set: everything behind the sensor (`tangent calibrate payload`)
mass_kg = 0.3
com_in_sensor_m = [0.0, 0.0, 0.05]

[tool.flange_from_tool]             # set: origin at the contact point, z out of the tool
translation_m = [0.0, 0.0, 0.165]
rotation_vector_rad = [0.0, 0.0, 0.0]

[tool.tip]                          # set: \"flat\", \"ring\", \"round\" or \"soft\", with radius_m
kind = \"unknown\"                    # nothing is concluded from the torque

";

const UR_END: &str = "\
[limits]                            # set: limits that the arm must never exceed
tool_speed_max_m_per_s = 0.1
force_max_n = 30.0
workspace_min_m = [-0.8, -0.8, 0.0]
workspace_max_m = [0.8, 0.8, 1.0]

[zenoh]
connect = [\"tcp/127.0.0.1:7447\"]
# To admit other hosts, use certificates: `tangent keys new`, docs/security.md.
listen = [\"tcp/127.0.0.1:7447\"]

[estimators]
run = [\"reactive\", \"quadratic\", \"gaussian_process\", \"blend\"]
active = \"blend\"
";

const FRANKA: &str = "
[robot.franka]
# External torques and forces at which the robot reports a contact, and at which it stops by itself.
contact_torque_nm = [15.0, 15.0, 15.0, 15.0, 8.0, 8.0, 8.0]
collision_torque_nm = [40.0, 40.0, 40.0, 40.0, 12.0, 12.0, 12.0]
contact_force_n_nm = [20.0, 20.0, 20.0, 8.0, 8.0, 8.0]
collision_force_n_nm = [60.0, 60.0, 60.0, 20.0, 20.0, 20.0]
tool_inertia_kg_m2 = [0.001, 0.001, 0.001]          # set: about the tool's centre of mass
";

const FRANKA_END: &str = "\
[limits]                            # set: limits that the arm must never exceed
tool_speed_max_m_per_s = 0.25
force_max_n = 40.0
workspace_min_m = [0.1, -0.6, 0.0]
workspace_max_m = [0.85, 0.6, 1.0]

[zenoh]
connect = [\"tcp/127.0.0.1:7447\"]
# To admit other hosts, use certificates: `tangent keys new`, docs/security.md.
listen = [\"tcp/127.0.0.1:7447\"]

[estimators]
run = [\"reactive\"]                  # from touch; with a depth camera see deploy/cell.karacan.toml
active = \"reactive\"
wrench = \"law\"

[controller]
law = \"unified_force_impedance\"
";
