//! One output package of the robot, decoded.

use std::ops::RangeInclusive;

use crate::codec::{DataType, Value};
use crate::program::RegisterMap;

/// Fields requested of every robot, before the registers; all exist since software 3.9.
const FIELDS: [(&str, DataType); 11] = [
    ("timestamp", DataType::Double),
    ("actual_q", DataType::Vector6d),
    ("actual_qd", DataType::Vector6d),
    ("target_qd", DataType::Vector6d),
    ("robot_mode", DataType::Int32),
    ("safety_mode", DataType::Int32),
    ("runtime_state", DataType::Uint32),
    ("robot_status_bits", DataType::Uint32),
    ("safety_status_bits", DataType::Uint32),
    ("speed_scaling", DataType::Double),
    ("target_speed_fraction", DataType::Double),
];

/// Names of the output recipe, in order.
pub fn output_names(registers: &RegisterMap) -> Vec<String> {
    FIELDS
        .iter()
        .map(|(name, _)| (*name).to_owned())
        .chain(registers.output_names())
        .collect()
}

/// Types of the output recipe, in order.
pub fn output_types() -> Vec<DataType> {
    FIELDS
        .iter()
        .map(|(_, t)| *t)
        .chain([DataType::Int32; 7])
        .chain([DataType::Double; 6])
        .collect()
}

/// Types of the input recipe, in order; its names are [`RegisterMap::input_names`].
pub fn input_types() -> Vec<DataType> {
    [DataType::Int32; 4]
        .into_iter()
        .chain([DataType::Double; 7])
        .collect()
}

/// The robot's state from one package.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Since the controller started, s.
    pub timestamp_s: f64,
    /// Measured, rad.
    pub q: [f64; 6],
    /// Measured, rad/s.
    pub qd: [f64; 6],
    /// Target joint speeds of the robot's own controller, rad/s.
    pub qd_target: [f64; 6],
    /// Robot mode; [`crate::status::robot_mode_text`] names each value.
    pub robot_mode: i32,
    /// Safety mode; [`crate::status::safety_mode_text`] names each value.
    pub safety_mode: i32,
    /// State of the program; [`crate::status::runtime_state_text`] names each value.
    pub runtime_state: u32,
    /// Bit 0 power on, 1 program running.
    pub robot_status_bits: u32,
    /// Bit 0 normal, 1 reduced, others are stops.
    pub safety_status_bits: u32,
    /// Limiter's scaling, 0 to 1.
    pub speed_scaling: f64,
    /// Slider, 0 to 1.
    pub target_speed_fraction: f64,
    /// Out int B+0.
    pub program_state: i32,
    /// Out int B+1.
    pub sequence_used: i32,
    /// Out int B+2.
    pub ident: i32,
    /// Out int B+3.
    pub session: i32,
    /// Out int B+4.
    pub cause: i32,
    /// Out int B+5.
    pub loops: i32,
    /// Out int B+6.
    pub stale_max: i32,
    /// Out double B+0..5: given to `speedj`, rad/s.
    pub qd_commanded: [f64; 6],
    /// Force that the robot itself feels, if the bridge requested it: N, then Nm; not checked.
    pub wrench: Option<[f64; 6]>,
}

impl Sample {
    /// From the values of the output recipe; `None` when they are not those.
    pub fn from_values(values: &[Value]) -> Option<Self> {
        let mut rest = values.iter();
        let sample = Self {
            timestamp_s: rest.next()?.as_double()?,
            q: rest.next()?.as_vector6d()?,
            qd: rest.next()?.as_vector6d()?,
            qd_target: rest.next()?.as_vector6d()?,
            robot_mode: rest.next()?.as_int32()?,
            safety_mode: rest.next()?.as_int32()?,
            runtime_state: rest.next()?.as_uint32()?,
            robot_status_bits: rest.next()?.as_uint32()?,
            safety_status_bits: rest.next()?.as_uint32()?,
            speed_scaling: rest.next()?.as_double()?,
            target_speed_fraction: rest.next()?.as_double()?,
            program_state: rest.next()?.as_int32()?,
            sequence_used: rest.next()?.as_int32()?,
            ident: rest.next()?.as_int32()?,
            session: rest.next()?.as_int32()?,
            cause: rest.next()?.as_int32()?,
            loops: rest.next()?.as_int32()?,
            stale_max: rest.next()?.as_int32()?,
            qd_commanded: {
                let mut qd = [0.0; 6];
                for v in &mut qd {
                    *v = rest.next()?.as_double()?;
                }
                qd
            },
            wrench: None,
        };
        rest.next().is_none().then_some(sample)
    }

    /// From the values of the output recipe, followed by the force that the robot itself feels;
    /// `None` when they are not those.
    pub fn from_values_with_wrench(values: &[Value]) -> Option<Self> {
        let (wrench, values) = values.split_last()?;
        Some(Self {
            wrench: Some(wrench.as_vector6d()?),
            ..Self::from_values(values)?
        })
    }

    /// Whether every number is finite and physically possible; a controller never sends others. A
    /// finite number beyond all arms would overflow later computations.
    pub fn is_usable(&self) -> bool {
        let within = |values: &[f64], most: f64| values.iter().all(|x| x.abs() <= most);
        within(&self.q, JOINT_MAX)
            && within(&self.qd, JOINT_MAX)
            && within(&self.qd_target, JOINT_MAX)
            && (0.0..=TIMESTAMP_MAX_S).contains(&self.timestamp_s)
            && [self.speed_scaling, self.target_speed_fraction]
                .iter()
                .all(|fraction| FRACTION.contains(fraction))
    }

    /// Limiter times slider, 0 to 1.
    pub fn scaling(&self) -> f64 {
        (self.speed_scaling * self.target_speed_fraction).clamp(0.0, 1.0)
    }
}

/// Largest joint angle, rad, and speed, rad/s; beyond any UR joint.
const JOINT_MAX: f64 = 100.0;
/// Range of the limiter's scaling and of the slider: fractions from 0 to 1, and a hundredth for
/// rounding in the controller.
const FRACTION: RangeInclusive<f64> = -0.01..=1.01;
/// Longest running time of a controller, s: thirty years.
const TIMESTAMP_MAX_S: f64 = 1e9;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;
    use tangent_mechanics::{Arm, ModelData, Pose};

    fn bits() -> impl Strategy<Value = f64> {
        prop_oneof![-10.0f64..10.0, any::<u64>().prop_map(f64::from_bits)]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Every accepted sample gives a finite pose, twist and scaling.
        #[test]
        fn what_is_usable_can_be_used(q in prop::array::uniform6(bits()), qd in prop::array::uniform6(bits()), time in bits(), scaling in bits(), slider in bits()) {
            let sample = Sample {
                q, qd,
                timestamp_s: time,
                speed_scaling: scaling,
                target_speed_fraction: slider,
                ..Sample::default()
            };
            if !sample.is_usable() {
                return Ok(());
            }
            let arm = Arm::<6>::new(&ModelData::builtin("ur5").unwrap()).unwrap();
            let (tool, jacobian) = arm.tool_and_jacobian(&Vector6::from(q), &Pose::<tangent_mechanics::Flange, tangent_mechanics::Tool>::identity());
            prop_assert!(tool.translation().iter().all(|x| x.is_finite()));
            prop_assert!((jacobian * Vector6::from(qd)).iter().all(|x| x.is_finite()));
            prop_assert!((0.0..=1.0).contains(&sample.scaling()));
        }
    }

    #[test]
    fn what_no_arm_has_is_refused() {
        for bad in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
            let with = |change: fn(&mut Sample, f64)| {
                let mut sample = Sample::default();
                change(&mut sample, bad);
                sample
            };
            for sample in [
                with(|s, x| s.q[3] = x),
                with(|s, x| s.qd[0] = x),
                with(|s, x| s.qd_target[5] = x),
                with(|s, x| s.timestamp_s = x),
                with(|s, x| s.speed_scaling = x),
                with(|s, x| s.target_speed_fraction = x),
            ] {
                assert!(!sample.is_usable(), "{bad}: {sample:?}");
            }
        }
        assert!(Sample::default().is_usable());
    }

    /// The bug: both fractions were checked against the bound of a joint angle, 100.
    #[test]
    fn a_speed_fraction_beyond_0_to_1_is_refused() {
        let usable = |scaling, slider| {
            Sample {
                speed_scaling: scaling,
                target_speed_fraction: slider,
                ..Sample::default()
            }
            .is_usable()
        };
        assert!(usable(0.0, 1.0) && usable(1.0, 0.0) && usable(1.0 + 1e-6, -1e-6));
        for bad in [-0.5, 1.1, 2.0, 100.0] {
            assert!(!usable(bad, 1.0) && !usable(1.0, bad), "{bad}");
        }
    }
    use crate::codec::{ControllerVersion, input_field, output_field};

    #[test]
    fn the_recipes_exist_on_the_oldest_robots_taken() {
        let registers = RegisterMap::new(40).unwrap();
        for version in [
            ControllerVersion::new(3, 9, 0),
            ControllerVersion::new(5, 3, 0),
        ] {
            for (name, data_type) in output_names(&registers).iter().zip(output_types()) {
                let field = output_field(name).unwrap();
                assert_eq!(field.data_type, data_type, "{name}");
                assert!(field.exists_on(&version), "{name}");
            }
            for (name, data_type) in registers.input_names().iter().zip(input_types()) {
                let field = input_field(name).unwrap();
                assert_eq!(field.data_type, data_type, "{name}");
                assert!(field.exists_on(&version), "{name}");
            }
        }
        assert_eq!(output_names(&registers).len(), output_types().len());
    }

    #[test]
    fn only_the_right_values_make_a_sample() {
        let mut values: Vec<Value> = output_types().into_iter().map(DataType::zero).collect();
        assert_eq!(Sample::from_values(&values), Some(Sample::default()));
        values.push(Value::Double(0.0));
        assert_eq!(Sample::from_values(&values), None);
        *values.last_mut().unwrap() = Value::Vector6d([1.0; 6]);
        let with_wrench = Sample::from_values_with_wrench(&values);
        assert_eq!(with_wrench.and_then(|sample| sample.wrench), Some([1.0; 6]));
        values.truncate(20);
        assert_eq!(Sample::from_values(&values), None);
    }
}
