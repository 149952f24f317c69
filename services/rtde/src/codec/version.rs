//! Versions: of the controller's software, and of the protocol.

use std::fmt;

/// Protocol version of a connection; every connection starts in `V1`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Protocol {
    /// No frequency in the output set-up, no recipe id in output data.
    #[default]
    V1,
    /// What every controller since 3.4 speaks.
    V2,
}

impl Protocol {
    /// The number on the wire.
    pub fn number(self) -> u16 {
        match self {
            Self::V1 => 1,
            Self::V2 => 2,
        }
    }

    /// `None` for a version that does not exist; a controller answers such a request with 0.
    pub fn from_number(number: u16) -> Option<Self> {
        match number {
            1 => Some(Self::V1),
            2 => Some(Self::V2),
            _ => None,
        }
    }
}

/// Family of controllers; it determines the control rate and the available fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// CB3 and older: software 1 to 3, 125 Hz.
    Cb3,
    /// e-Series and later: software 5 and up, 500 Hz.
    ESeries,
}

impl fmt::Display for Series {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cb3 => "a CB3 robot (software 3, 125 Hz)",
            Self::ESeries => "an e-Series robot (software 5 or later, 500 Hz)",
        })
    }
}

impl Series {
    /// Control rate, Hz.
    pub fn rate_hz(self) -> f64 {
        match self {
            Self::Cb3 => 125.0,
            Self::ESeries => 500.0,
        }
    }

    /// One control cycle, s.
    pub fn period_s(self) -> f64 {
        match self {
            Self::Cb3 => 0.008,
            Self::ESeries => 0.002,
        }
    }
}

/// Version of the controller's software, as `GET_URCONTROL_VERSION` answers it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct ControllerVersion {
    /// 3 on CB3, 5 on e-Series.
    pub major: u32,
    /// Second number.
    pub minor: u32,
    /// Third number.
    pub bugfix: u32,
    /// Build number.
    pub build: u32,
}

impl ControllerVersion {
    /// First CB3 release whose registers 24 to 47 a client may use.
    pub const FLOOR_CB3: (u32, u32) = (3, 9);
    /// First e-Series release whose registers 24 to 47 a client may use.
    pub const FLOOR_E_SERIES: (u32, u32) = (5, 3);

    /// Without a build number.
    pub fn new(major: u32, minor: u32, bugfix: u32) -> Self {
        Self {
            major,
            minor,
            bugfix,
            build: 0,
        }
    }

    /// Family, from the major number.
    pub fn series(&self) -> Series {
        if self.major >= 4 {
            Series::ESeries
        } else {
            Series::Cb3
        }
    }

    /// Whether registers 24 to 47 and bits 64 to 127 are available to RTDE clients.
    pub fn has_upper_registers(&self) -> bool {
        let floor = match self.series() {
            Series::Cb3 => Self::FLOOR_CB3,
            Series::ESeries => Self::FLOOR_E_SERIES,
        };
        (self.major, self.minor) >= floor
    }
}

impl fmt::Display for ControllerVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            major,
            minor,
            bugfix,
            build,
        } = self;
        write!(f, "{major}.{minor}.{bugfix}.{build}")
    }
}

/// Number of control cycles per output package when a client requests `frequency_hz`. The
/// controller divides its rate only by whole numbers, so a request of 50 Hz gives 62.5 Hz on a CB3.
/// At least 1.
pub fn output_cycles(series: Series, frequency_hz: f64) -> u32 {
    if !frequency_hz.is_finite() || frequency_hz <= 0.0 {
        return 1;
    }
    // The small term makes 125/12.5 exactly 10 in spite of rounding.
    ((series.rate_hz() / frequency_hz + 1e-9).floor() as u32).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_register_floor_is_3_9_and_5_3() {
        for (version, open) in [
            ((3, 3, 0), false),
            ((3, 8, 9), false),
            ((3, 9, 0), true),
            ((3, 15, 8), true),
            ((5, 2, 9), false),
            ((5, 3, 0), true),
            ((5, 11, 0), true),
            ((10, 7, 0), true),
        ] {
            let v = ControllerVersion::new(version.0, version.1, version.2);
            assert_eq!(v.has_upper_registers(), open, "{v}");
        }
    }

    #[test]
    fn a_rate_that_does_not_divide_comes_out_faster() {
        assert_eq!(output_cycles(Series::Cb3, 50.0), 2);
        assert_eq!(output_cycles(Series::Cb3, 125.0), 1);
        assert_eq!(output_cycles(Series::Cb3, 500.0), 1);
        assert_eq!(output_cycles(Series::Cb3, 12.5), 10);
        assert_eq!(output_cycles(Series::ESeries, 125.0), 4);
        assert_eq!(output_cycles(Series::Cb3, f64::NAN), 1);
        assert_eq!(output_cycles(Series::Cb3, 0.0), 1);
    }
}
