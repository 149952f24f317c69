//! Registers, and digital and analog inputs and outputs, which RTDE clients and programs write.

use tangent_rtde::codec::Value;

/// Inputs and outputs. Values persist until they are overwritten or the controller restarts.
#[derive(Clone, Debug)]
pub struct Registers {
    /// Written by clients, read by programs.
    pub input: Bank,
    /// Written by programs, read by clients.
    pub output: Bank,
    /// Bits 0-7 standard, 8-15 configurable, 16-17 tool.
    pub digital_inputs: u64,
    /// Bits 0-7 standard, 8-15 configurable, 16-17 tool.
    pub digital_outputs: u64,
    /// Share of the range, 0 to 1.
    pub analog_outputs: [f64; 2],
    /// Bit 0 and 1: 0 current, 1 voltage.
    pub analog_types: u8,
    /// Force and torque on the tool according to a client, N and Nm.
    pub external_force: [f64; 6],
}

/// One direction's registers.
#[derive(Clone, Debug)]
pub struct Bank {
    /// 0 to 47.
    pub integers: [i32; 48],
    /// 0 to 47.
    pub doubles: [f64; 48],
    /// 0 to 127.
    pub bits: u128,
}

impl Default for Bank {
    fn default() -> Self {
        Self {
            integers: [0; 48],
            doubles: [0.0; 48],
            bits: 0,
        }
    }
}

impl Default for Registers {
    fn default() -> Self {
        Self {
            input: Bank::default(),
            output: Bank::default(),
            digital_inputs: 0,
            digital_outputs: 0,
            analog_outputs: [0.0; 2],
            analog_types: 0,
            external_force: [0.0; 6],
        }
    }
}

impl Bank {
    fn get(&self, rest: &str) -> Option<Value> {
        let (family, index) = match rest {
            "bit_registers0_to_31" => return Some(Value::Uint32(self.bits as u32)),
            "bit_registers32_to_63" => return Some(Value::Uint32((self.bits >> 32) as u32)),
            _ => rest.split_once("_register_")?,
        };
        let index: usize = index.parse().ok()?;
        match family {
            "int" => self.integers.get(index).map(|x| Value::Int32(*x)),
            "double" => self.doubles.get(index).map(|x| Value::Double(*x)),
            "bit" if index < 128 => Some(Value::Bool(self.bits >> index & 1 == 1)),
            _ => None,
        }
    }

    fn set(&mut self, rest: &str, value: &Value) {
        let word = |bits: u128, shift: u32, x: u32| {
            bits & !(u128::from(u32::MAX) << shift) | u128::from(x) << shift
        };
        match (rest, value) {
            ("bit_registers0_to_31", Value::Uint32(x)) => self.bits = word(self.bits, 0, *x),
            ("bit_registers32_to_63", Value::Uint32(x)) => self.bits = word(self.bits, 32, *x),
            _ => {
                let Some(index) = rest
                    .split_once("_register_")
                    .and_then(|(_, index)| index.parse::<usize>().ok())
                else {
                    return;
                };
                match value {
                    Value::Int32(x) => {
                        if let Some(register) = self.integers.get_mut(index) {
                            *register = *x;
                        }
                    }
                    Value::Double(x) => {
                        if let Some(register) = self.doubles.get_mut(index) {
                            *register = *x;
                        }
                    }
                    Value::Bool(on) if index < 128 => self.set_bit(index, *on),
                    _ => {}
                }
            }
        }
    }

    /// Sets bit `index`, 0 to 127.
    pub fn set_bit(&mut self, index: usize, on: bool) {
        let bit = 1u128 << (index & 127);
        if on {
            self.bits |= bit;
        } else {
            self.bits &= !bit;
        }
    }
}

impl Registers {
    /// Value of a register by its RTDE name; `None` if no register has this name.
    pub fn get(&self, name: &str) -> Option<Value> {
        if let Some(rest) = name.strip_prefix("input_") {
            self.input.get(rest)
        } else {
            self.output.get(name.strip_prefix("output_")?)
        }
    }

    /// Takes the fields of one input package. Masked outputs change only where their mask has a
    /// bit.
    pub fn write(&mut self, names: &[String], values: &[Value]) {
        let byte = |name: &str| {
            let at = names.iter().position(|n| n == name)?;
            match values.get(at) {
                Some(Value::Uint8(x)) => Some(u64::from(*x)),
                _ => None,
            }
        };
        for (group, shift) in [
            ("standard_digital_output", 0),
            ("configurable_digital_output", 8),
            ("tool_digital_output", 16),
        ] {
            if let (Some(mask), Some(x)) = (byte(&format!("{group}_mask")), byte(group)) {
                self.digital_outputs =
                    self.digital_outputs & !(mask << shift) | (x & mask) << shift;
            }
        }
        let mask = byte("standard_analog_output_mask").unwrap_or(0);
        if mask != 0
            && let Some(kind) = byte("standard_analog_output_type")
        {
            self.analog_types = (u64::from(self.analog_types) & !mask | kind & mask) as u8;
        }
        for (name, value) in names.iter().zip(values) {
            if let Some(rest) = name.strip_prefix("input_") {
                self.input.set(rest, value);
                continue;
            }
            match (name.as_str(), value) {
                ("standard_analog_output_0", Value::Double(x)) if mask & 1 != 0 => {
                    self.analog_outputs[0] = x.clamp(0.0, 1.0);
                }
                ("standard_analog_output_1", Value::Double(x)) if mask & 2 != 0 => {
                    self.analog_outputs[1] = x.clamp(0.0, 1.0);
                }
                ("external_force_torque", Value::Vector6d(x)) => self.external_force = *x,
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_and_banks() {
        let mut registers = Registers::default();
        let names: Vec<String> = [
            "standard_digital_output_mask",
            "standard_digital_output",
            "input_int_register_24",
            "input_bit_register_64",
            "input_bit_registers32_to_63",
        ]
        .map(String::from)
        .to_vec();
        registers.digital_outputs = 0b1000_0001;
        let values = [
            Value::Uint8(0b11),
            Value::Uint8(0b110),
            Value::Int32(-7),
            Value::Bool(true),
            Value::Uint32(5),
        ];
        registers.write(&names, &values);
        assert_eq!(registers.digital_outputs, 0b1000_0010);
        assert_eq!(
            registers.get("input_int_register_24"),
            Some(Value::Int32(-7))
        );
        assert_eq!(
            registers.get("output_int_register_24"),
            Some(Value::Int32(0))
        );
        assert_eq!(
            registers.get("input_bit_register_64"),
            Some(Value::Bool(true))
        );
        assert_eq!(
            registers.get("input_bit_registers32_to_63"),
            Some(Value::Uint32(5))
        );
        assert_eq!(registers.get("output_int_register_48"), None);
    }
}
