//! Fields of a controller: their types, and the releases that introduced them.
//!
//! Types and releases are those of the vendor's RTDE guide. Register families are matched by
//! pattern.

use super::{ControllerVersion, DataType, Series};
use DataType::{Bool, Double, Int32, Uint8, Uint32, Uint64, Vector3d, Vector6Int32, Vector6d};

/// First release with a field: `(minor, bugfix)` of software 3 and of software 5; `None` if no
/// release has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Availability {
    /// CB3, software 3.
    pub cb3: Option<(u32, u32)>,
    /// e-Series, software 5.
    pub e_series: Option<(u32, u32)>,
}

/// Available since RTDE exists.
const ALWAYS: Availability = since((0, 0), (0, 0));
const UPPER: Availability = since((9, 0), (3, 0));

const fn since(cb3: (u32, u32), e_series: (u32, u32)) -> Availability {
    Availability {
        cb3: Some(cb3),
        e_series: Some(e_series),
    }
}

const fn e_series_only(minor: u32) -> Availability {
    Availability {
        cb3: None,
        e_series: Some((minor, 0)),
    }
}

/// Type of a field, and its availability.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Type on the wire.
    pub data_type: DataType,
    /// First releases that have it.
    pub availability: Availability,
}

impl Field {
    /// Whether a controller of this version has it.
    pub fn exists_on(&self, version: &ControllerVersion) -> bool {
        let (major, first) = match version.series() {
            Series::Cb3 => (3, self.availability.cb3),
            Series::ESeries => (5, self.availability.e_series),
        };
        first.is_some_and(|(minor, bugfix)| {
            (version.major, version.minor, version.bugfix) >= (major, minor, bugfix)
                // RTDE itself is as old as software 3.4; fields without a date are on every
                // controller that speaks it.
                || (minor, bugfix) == (0, 0)
        })
    }
}

/// Fields that a controller sends, without the registers.
#[rustfmt::skip]
const OUTPUTS: &[(&str, DataType, Availability)] = &[
    ("timestamp", Double, ALWAYS),
    ("target_q", Vector6d, ALWAYS),
    ("target_qd", Vector6d, ALWAYS),
    ("target_qdd", Vector6d, ALWAYS),
    ("target_current", Vector6d, ALWAYS),
    ("target_moment", Vector6d, ALWAYS),
    ("actual_q", Vector6d, ALWAYS),
    ("actual_qd", Vector6d, ALWAYS),
    ("actual_current", Vector6d, ALWAYS),
    ("joint_control_output", Vector6d, ALWAYS),
    ("actual_TCP_pose", Vector6d, ALWAYS),
    ("actual_TCP_speed", Vector6d, ALWAYS),
    ("actual_TCP_force", Vector6d, ALWAYS),
    ("target_TCP_pose", Vector6d, ALWAYS),
    ("target_TCP_speed", Vector6d, ALWAYS),
    ("actual_digital_input_bits", Uint64, ALWAYS),
    ("actual_digital_output_bits", Uint64, ALWAYS),
    ("joint_temperatures", Vector6d, ALWAYS),
    ("actual_execution_time", Double, ALWAYS),
    ("robot_mode", Int32, ALWAYS),
    ("joint_mode", Vector6Int32, ALWAYS),
    ("safety_mode", Int32, ALWAYS),
    ("safety_status", Int32, since((10, 0), (4, 0))),
    ("actual_tool_accelerometer", Vector3d, ALWAYS),
    ("speed_scaling", Double, ALWAYS),
    ("target_speed_fraction", Double, ALWAYS),
    ("actual_momentum", Double, ALWAYS),
    ("actual_main_voltage", Double, ALWAYS),
    ("actual_robot_voltage", Double, ALWAYS),
    ("actual_robot_current", Double, ALWAYS),
    ("actual_joint_voltage", Vector6d, ALWAYS),
    ("runtime_state", Uint32, ALWAYS),
    ("elbow_position", Vector3d, since((5, 0), (0, 0))),
    ("elbow_velocity", Vector3d, since((5, 0), (0, 0))),
    ("robot_status_bits", Uint32, ALWAYS),
    ("safety_status_bits", Uint32, ALWAYS),
    ("analog_io_types", Uint32, ALWAYS),
    ("standard_analog_input0", Double, ALWAYS),
    ("standard_analog_input1", Double, ALWAYS),
    ("standard_analog_output0", Double, ALWAYS),
    ("standard_analog_output1", Double, ALWAYS),
    ("io_current", Double, ALWAYS),
    ("euromap67_input_bits", DataType::Uint32, ALWAYS),
    ("euromap67_output_bits", DataType::Uint32, ALWAYS),
    ("euromap67_24V_voltage", Double, ALWAYS),
    ("euromap67_24V_current", Double, ALWAYS),
    ("tool_mode", Uint32, ALWAYS),
    ("tool_analog_input_types", Uint32, ALWAYS),
    ("tool_analog_input0", Double, ALWAYS),
    ("tool_analog_input1", Double, ALWAYS),
    ("tool_output_voltage", Int32, ALWAYS),
    ("tool_output_current", Double, ALWAYS),
    ("tool_temperature", Double, ALWAYS),
    ("tcp_force_scalar", Double, ALWAYS),
    ("tool_output_mode", Uint8, ALWAYS),
    ("tool_digital_output0_mode", Uint8, ALWAYS),
    ("tool_digital_output1_mode", Uint8, ALWAYS),
    ("tcp_offset", Vector6d, ALWAYS),
    ("payload", Double, since((11, 0), (5, 1))),
    ("payload_cog", Vector3d, since((11, 0), (5, 1))),
    ("payload_inertia", Vector6d, since((15, 0), (11, 0))),
    ("script_control_line", Uint32, since((14, 0), (9, 0))),
    ("ft_raw_wrench", Vector6d, e_series_only(9)),
    ("joint_position_deviation_ratio", Double, e_series_only(11)),
    ("collision_detection_ratio", Double, e_series_only(15)),
    ("time_scale_source", Int32, e_series_only(17)),
    ("encoder0_raw", Int32, e_series_only(0)),
    ("encoder1_raw", Int32, e_series_only(0)),
    ("actual_current_window", Vector6d, e_series_only(12)),
    ("actual_robot_energy_consumed", Double, e_series_only(18)),
    ("actual_current_as_torque", Vector6d, e_series_only(23)),
    ("actual_TCP_acceleration", Vector6d, e_series_only(23)),
    ("output_bit_registers0_to_31", Uint32, ALWAYS),
    ("output_bit_registers32_to_63", Uint32, ALWAYS),
    ("input_bit_registers0_to_31", Uint32, ALWAYS),
    ("input_bit_registers32_to_63", Uint32, ALWAYS),
];

/// Fields that a client may send, without the registers.
#[rustfmt::skip]
const INPUTS: &[(&str, DataType, Availability)] = &[
    ("speed_slider_mask", Uint32, ALWAYS),
    ("speed_slider_fraction", Double, ALWAYS),
    ("standard_digital_output_mask", Uint8, ALWAYS),
    ("standard_digital_output", Uint8, ALWAYS),
    ("configurable_digital_output_mask", Uint8, ALWAYS),
    ("configurable_digital_output", Uint8, ALWAYS),
    ("tool_digital_output_mask", Uint8, ALWAYS),
    ("tool_digital_output", Uint8, ALWAYS),
    ("standard_analog_output_mask", Uint8, ALWAYS),
    ("standard_analog_output_type", Uint8, ALWAYS),
    ("standard_analog_output_0", Double, ALWAYS),
    ("standard_analog_output_1", Double, ALWAYS),
    ("input_bit_registers0_to_31", Uint32, ALWAYS),
    ("input_bit_registers32_to_63", Uint32, ALWAYS),
    ("external_force_torque", Vector6d, since((3, 0), (0, 0))),
];

/// A field that a controller can send, by name; inputs can be read back under their own names.
pub fn output_field(name: &str) -> Option<Field> {
    table(OUTPUTS, name)
        .or_else(|| register(name, "output_"))
        .or_else(|| register(name, "input_"))
}

/// A field that a client can send, by name.
pub fn input_field(name: &str) -> Option<Field> {
    table(INPUTS, name).or_else(|| register(name, "input_"))
}

fn table(table: &[(&str, DataType, Availability)], name: &str) -> Option<Field> {
    let (_, data_type, availability) = table.iter().find(|(n, _, _)| *n == name)?;
    Some(Field {
        data_type: *data_type,
        availability: *availability,
    })
}

/// `PREFIX{bit,int,double}_register_INDEX`.
fn register(name: &str, prefix: &str) -> Option<Field> {
    let (family, index) = name.strip_prefix(prefix)?.split_once("_register_")?;
    let canonical = index == "0" || (!index.starts_with('0') && index.len() <= 3);
    if !canonical || !index.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let index: u32 = index.parse().ok()?;
    let (data_type, exists, upper) = match family {
        "bit" => (Bool, (64..128).contains(&index), true),
        "int" => (Int32, index < 48, index >= 24),
        "double" => (Double, index < 48, index >= 24),
        _ => return None,
    };
    exists.then_some(Field {
        data_type,
        availability: if upper { UPPER } else { ALWAYS },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn registers_by_pattern() {
        for (name, expected) in [
            ("output_int_register_0", Some(Int32)),
            ("output_int_register_47", Some(Int32)),
            ("output_int_register_48", None),
            ("output_int_register_007", None),
            ("output_int_register_", None),
            ("output_int_register_-1", None),
            ("output_int_register_+1", None),
            ("output_double_register_24", Some(Double)),
            ("output_bit_register_64", Some(Bool)),
            ("output_bit_register_63", None),
            ("output_bit_register_127", Some(Bool)),
            ("output_bit_register_128", None),
            ("output_bit_registers0_to_31", Some(Uint32)),
            ("input_double_register_3", Some(Double)),
            ("actual_q", Some(Vector6d)),
            ("actual_Q", None),
            ("", None),
        ] {
            assert_eq!(output_field(name).map(|f| f.data_type), expected, "{name}");
        }
        assert_eq!(input_field("output_int_register_0"), None);
        assert_eq!(
            input_field("speed_slider_fraction").map(|f| f.data_type),
            Some(Double)
        );
    }

    #[test]
    fn versions_gate_fields() {
        let exists = |name: &str, v: (u32, u32, u32)| {
            output_field(name)
                .unwrap()
                .exists_on(&ControllerVersion::new(v.0, v.1, v.2))
        };
        assert!(!exists("output_int_register_24", (3, 8, 0)));
        assert!(exists("output_int_register_24", (3, 9, 0)));
        assert!(exists("output_int_register_23", (3, 4, 0)));
        assert!(!exists("output_int_register_24", (5, 2, 0)));
        assert!(exists("output_int_register_24", (5, 3, 0)));
        assert!(!exists("payload", (5, 5, 0)));
        assert!(exists("payload", (5, 5, 1)));
        assert!(!exists("ft_raw_wrench", (3, 15, 8)));
        assert!(exists("ft_raw_wrench", (5, 11, 0)));
        assert!(exists("ft_raw_wrench", (10, 7, 0)));
        assert!(exists("tcp_offset", (3, 15, 8)));
        assert!(exists("payload_inertia", (3, 15, 8)));
    }

    #[test]
    fn no_name_stands_twice() {
        for table in [OUTPUTS, INPUTS] {
            for (i, (name, _, _)) in table.iter().enumerate() {
                assert!(table[i + 1..].iter().all(|(n, _, _)| n != name), "{name}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_text_is_looked_up_without_panic(name in "\\PC{0,60}", index in any::<u64>()) {
            output_field(&name);
            input_field(&format!("input_int_register_{index}"));
        }
    }
}
