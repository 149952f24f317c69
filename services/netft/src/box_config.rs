//! Configuration of the sensor box, read over HTTP: units, scales, rate.

use std::io::Read as _;
use std::time::Duration;

use crate::codec::FT_RATE_HZ;
use crate::{BoxConfigError, NetftError};

/// Largest length of an answer that is read, bytes: a real one has about 6 kB.
const ANSWER_MAX: u64 = 256 * 1024;

/// Newtons per unit of force, by the unit names that boxes use. Case, spaces, dots and dashes are
/// ignored.
const FORCE_UNITS: [(&str, f64); 10] = [
    ("n", 1.0),
    ("kn", 1000.0),
    ("lb", POUND_FORCE_N),
    ("lbf", POUND_FORCE_N),
    ("klb", 1000.0 * POUND_FORCE_N),
    ("klbf", 1000.0 * POUND_FORCE_N),
    ("kg", KILOGRAM_FORCE_N),
    ("kgf", KILOGRAM_FORCE_N),
    ("g", KILOGRAM_FORCE_N / 1000.0),
    ("gf", KILOGRAM_FORCE_N / 1000.0),
];

/// Newton metres per unit of torque.
const TORQUE_UNITS: [(&str, f64); 9] = [
    ("nm", 1.0),
    ("nmm", 0.001),
    ("knm", 1000.0),
    ("lbin", POUND_FORCE_N * INCH_M),
    ("lbfin", POUND_FORCE_N * INCH_M),
    ("lbft", POUND_FORCE_N * 12.0 * INCH_M),
    ("lbfft", POUND_FORCE_N * 12.0 * INCH_M),
    ("kgcm", KILOGRAM_FORCE_N / 100.0),
    ("kgfcm", KILOGRAM_FORCE_N / 100.0),
];

const POUND_FORCE_N: f64 = 4.448_221_615_260_5;
const KILOGRAM_FORCE_N: f64 = 9.806_65;
const INCH_M: f64 = 0.0254;

/// Present configuration of a box.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxConfig {
    /// Product.
    pub product: String,
    /// Serial number; empty if the box does not state it.
    pub serial: String,
    /// Name of the calibration in use; empty if the box does not state it.
    pub calibration: String,
    /// N per count.
    pub newton_per_count: f64,
    /// Nm per count.
    pub newton_metre_per_count: f64,
    /// Records per second; `None` if the box does not state it.
    pub rate_hz: Option<f64>,
    /// Records per buffered datagram; `None` if the box does not state it.
    pub buffer_records: Option<u32>,
    /// Whether the box transforms its readings into another frame, as configured on its web page.
    pub transformed: bool,
    /// Number of the box's own low-pass filter, 0 for off; `None` if the box does not state it.
    pub filter: Option<u32>,
}

/// Plausible range of one count, N and Nm. Sensors in use are near 1e-6; the range includes the
/// largest units and coarsest counts.
const PER_COUNT: (f64, f64) = (1e-12, 10.0);
/// Range of the record rate of a box, Hz.
const RATE_HZ: (f64, f64) = (1.0, FT_RATE_HZ);

impl BoxConfig {
    /// Reads `/netftapi2.xml`, within `timeout` in total.
    ///
    /// # Errors
    /// The box does not answer, or its answer is not valid.
    pub fn fetch(address: &str, http_port: u16, timeout: Duration) -> Result<Self, NetftError> {
        let text = get(address, http_port, "/netftapi2.xml", timeout)?;
        Self::parse(&text).map_err(|reason| NetftError::Configuration {
            address: format!("{address}:{http_port}"),
            reason,
        })
    }

    /// Sets the rate of records, Hz, and the number of records per datagram of buffered streams;
    /// `None`: unchanged. The box may choose the nearest possible values.
    ///
    /// # Errors
    /// The box does not answer or refuses.
    pub fn set_rate(
        address: &str,
        http_port: u16,
        rate_hz: Option<f64>,
        buffer_records: Option<u32>,
        timeout: Duration,
    ) -> Result<(), NetftError> {
        let rate = rate_hz.map(|hz| format!("comrdtrate={}", hz.round()));
        let buffer = buffer_records.map(|records| format!("comrdtbsiz={records}"));
        let values: Vec<String> = [rate, buffer].into_iter().flatten().collect();
        if values.is_empty() {
            return Ok(());
        }
        let path = format!("/comm.cgi?{}", values.join("&"));
        get(address, http_port, &path, timeout).map(drop)
    }

    /// Parses the text of `/netftapi2.xml`.
    ///
    /// # Errors
    /// Not XML, a missing or unusable value, or an unknown unit.
    pub fn parse(text: &str) -> Result<Self, BoxConfigError> {
        let document = roxmltree::Document::parse(text)?;
        let missing = |tag: &str| BoxConfigError::Missing {
            tag: tag.to_owned(),
        };
        let find = |tag: &str| {
            document
                .descendants()
                .find(|node| node.has_tag_name(tag))
                .and_then(|node| node.text())
                .map(str::trim)
                .filter(|text| !text.is_empty())
        };
        let number = |tag: &str| -> Result<Option<f64>, BoxConfigError> {
            find(tag)
                .map(|text| {
                    text.parse::<f64>()
                        .ok()
                        .filter(|value| value.is_finite())
                        .ok_or_else(|| BoxConfigError::NotANumber {
                            tag: tag.to_owned(),
                            text: text.to_owned(),
                        })
                })
                .transpose()
        };
        let scale = |tag: &str| match number(tag)? {
            Some(counts) if counts > 0.0 => Ok(counts),
            Some(counts) => Err(BoxConfigError::CountsNotPositive {
                tag: tag.to_owned(),
                counts,
            }),
            None => Err(missing(tag)),
        };
        // Being positive and finite is not enough: no sensor has counts far outside this range.
        let per_count = |tag: &str, unit: f64| -> Result<f64, BoxConfigError> {
            let counts = scale(tag)?;
            let value = unit / counts;
            let (least, most) = PER_COUNT;
            if (least..=most).contains(&value) {
                return Ok(value);
            }
            Err(BoxConfigError::CountOutOfRange {
                tag: tag.to_owned(),
                counts,
                value,
                least,
                most,
            })
        };
        let rate_hz = number("comrdtrate")?;
        if let Some(rate_hz) = rate_hz
            && !(RATE_HZ.0..=RATE_HZ.1).contains(&rate_hz)
        {
            return Err(BoxConfigError::RateOutOfRange {
                rate_hz,
                least: RATE_HZ.0,
                most: RATE_HZ.1,
            });
        }
        let unit = |tag: &str, units: &[(&'static str, f64)]| {
            let text = find(tag).ok_or_else(|| missing(tag))?;
            convert(text, units).ok_or_else(|| BoxConfigError::UnknownUnit {
                tag: tag.to_owned(),
                text: text.to_owned(),
                known: units.iter().map(|(name, _)| *name).collect(),
            })
        };
        let mut transformed = false;
        for axis in ["x", "y", "z", "rx", "ry", "rz"] {
            // A box without a transform states 0; one that has all six values in one element is
            // handled below.
            transformed |= number(&format!("cfgtf{axis}"))
                .unwrap_or(None)
                .unwrap_or(0.0)
                != 0.0;
        }
        if let Some(list) = find("cfgtfx") {
            transformed |= list
                .split([';', ',', ' '])
                .filter_map(|number| number.parse::<f64>().ok())
                .any(|number| number != 0.0);
        }
        Ok(Self {
            product: find("prodname").unwrap_or_default().to_owned(),
            serial: find("setserial").unwrap_or_default().to_owned(),
            calibration: find("cfgname")
                .or(find("calsn"))
                .unwrap_or_default()
                .to_owned(),
            newton_per_count: per_count("cfgcpf", unit("scfgfu", &FORCE_UNITS)?)?,
            newton_metre_per_count: per_count("cfgcpt", unit("scfgtu", &TORQUE_UNITS)?)?,
            rate_hz,
            buffer_records: number("comrdtbsiz")?.map(|n| n.clamp(0.0, 1e6) as u32),
            transformed,
            filter: number("setuserfilter")?.map(|n| n.clamp(0.0, 1e6) as u32),
        })
    }

    /// N and Nm per count, in the order of a record's counts.
    pub fn scales(&self) -> [f64; 6] {
        let (n, nm) = (self.newton_per_count, self.newton_metre_per_count);
        [n, n, n, nm, nm, nm]
    }
}

fn convert(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    let plain: String = text
        .chars()
        .filter(|c| !matches!(c, ' ' | '-' | '.' | '·' | '_' | '*'))
        .collect();
    // The case of the first letter matters: mN is not MN, and neither is a known unit.
    if plain.starts_with('m') || plain.starts_with('M') {
        return None;
    }
    let plain = plain.to_lowercase();
    units
        .iter()
        .find(|(name, _)| *name == plain)
        .map(|(_, value)| *value)
}

fn get(address: &str, port: u16, path: &str, timeout: Duration) -> Result<String, NetftError> {
    let unreachable = |reason: String| NetftError::Unreachable {
        address: format!("{address}:{port}"),
        reason,
    };
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(timeout))
        .max_redirects(0)
        .max_redirects_will_error(false)
        .http_status_as_error(false)
        .build()
        .into();
    let mut answer = agent
        .get(format!("http://{address}:{port}{path}"))
        .call()
        .map_err(|error| unreachable(error.to_string()))?;
    let status = answer.status().as_u16();
    if !(200..400).contains(&status) {
        return Err(NetftError::Configuration {
            address: format!("{address}:{port}"),
            reason: BoxConfigError::HttpStatus {
                path: path.to_owned(),
                status,
            },
        });
    }
    let mut text = Vec::new();
    answer
        .body_mut()
        .as_reader()
        .take(ANSWER_MAX)
        .read_to_end(&mut text)
        .map_err(|error| unreachable(error.to_string()))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{Command, Record, Status};
    use crate::stream::Stream;
    use proptest::prelude::*;

    fn xml(force: &str, torque: &str) -> String {
        format!(
            "<?xml version=\"1.0\"?><netft><prodname>Net F/T</prodname><setserial>FT12345</setserial>\
             <cfgcpf>1000000</cfgcpf><cfgcpt>2000000</cfgcpt><scfgfu>{force}</scfgfu><scfgtu>{torque}</scfgtu>\
             <comrdtrate>7000</comrdtrate><comrdtbsiz>7</comrdtbsiz><cfgtfx>0;0;0;0;0;0</cfgtfx></netft>"
        )
    }

    #[test]
    fn every_unit_of_the_maker_is_converted() {
        for (unit, newton) in [
            ("N", 1.0),
            ("kN", 1e3),
            ("lbf", 4.4482216152605),
            ("lb", 4.4482216152605),
            ("klbf", 4448.2216152605),
            ("kgf", 9.80665),
            ("kg", 9.80665),
            ("g", 0.00980665),
        ] {
            let found = BoxConfig::parse(&xml(unit, "N-m")).unwrap();
            assert!(
                (found.newton_per_count * 1e6 / newton - 1.0).abs() < 1e-12,
                "{unit}"
            );
        }
        for (unit, newton_metre) in [
            ("N-m", 1.0),
            ("Nm", 1.0),
            ("N-mm", 1e-3),
            ("kN-m", 1e3),
            ("lbf-in", 0.1129848290276167),
            ("lbf-ft", 1.3558179483314004),
            ("in-lbf", f64::NAN),
            ("kgf-cm", 0.0980665),
            ("kg-cm", 0.0980665),
        ] {
            let found = BoxConfig::parse(&xml("N", unit));
            if newton_metre.is_nan() {
                assert!(found.is_err());
                continue;
            }
            let ratio = found.unwrap().newton_metre_per_count * 2e6 / newton_metre;
            assert!((ratio - 1.0).abs() < 1e-12, "{unit}");
        }
    }

    #[test]
    fn the_filter_is_read_if_the_box_reports_it() {
        let plain = xml("N", "N-m");
        assert_eq!(BoxConfig::parse(&plain).unwrap().filter, None);
        let told = plain.replace("<netft>", "<netft><setuserfilter>3</setuserfilter>");
        assert_eq!(BoxConfig::parse(&told).unwrap().filter, Some(3));
    }

    #[test]
    fn an_unknown_unit_is_refused_by_name() {
        let error = BoxConfig::parse(&xml("stone", "N-m")).unwrap_err();
        let error = error.to_string();
        assert!(error.starts_with("<scfgfu> is `stone`"), "{error}");
        assert!(error.contains("known are n, kn, lb, "), "{error}");
        assert!(BoxConfig::parse(&xml("mN", "N-m")).is_err());
        assert!(BoxConfig::parse(&xml("N", "MN-m")).is_err());
    }

    #[test]
    fn what_is_missing_or_wrong_is_named() {
        let good = xml("N", "N-m");
        assert_eq!(BoxConfig::parse(&good).unwrap().serial, "FT12345");
        assert!(!BoxConfig::parse(&good).unwrap().transformed);
        for (from, to, says) in [
            ("<cfgcpf>1000000</cfgcpf>", "", "<cfgcpf> is missing"),
            ("1000000", "0", "<cfgcpf> is 0"),
            ("1000000", "many", "<cfgcpf> is `many`"),
            ("1000000", "inf", "<cfgcpf> is `inf`"),
            ("1000000", "1e300", "<cfgcpf> is 1"),
            ("1000000", "1e-300", "N or Nm"),
            (">7000<", ">1e-30<", "<comrdtrate> is 1e-30"),
            (">7000<", ">0<", "<comrdtrate> is 0"),
            (">7000<", ">1e9<", "from 1 to 7000"),
            (">7000<", ">-7000<", "<comrdtrate> is -7000"),
            ("<scfgtu>N-m</scfgtu>", "", "<scfgtu> is missing"),
            ("</netft>", "", "not XML"),
        ] {
            let error = BoxConfig::parse(&good.replace(from, to)).unwrap_err();
            let error = error.to_string();
            assert!(error.contains(says), "{error}");
        }
        let turned = good.replace("0;0;0;0;0;0", "0;0;0;0;0;45");
        assert!(BoxConfig::parse(&turned).unwrap().transformed);
    }

    /// Uses an accepted answer the way the service does, up to a wrench.
    fn use_it(found: &BoxConfig) {
        let rate_hz = found.rate_hz.unwrap_or(7000.0);
        assert!(Duration::try_from_secs_f64(3.0 / rate_hz).is_ok());
        let mut stream = Stream::new(Command::RealTime, rate_hz, Duration::from_millis(50));
        let record = Record {
            rdt_sequence: 1,
            ft_sequence: u32::MAX,
            status: Status(0),
            counts: [i32::MIN, i32::MAX, 0, -1, 1, i32::MIN],
        };
        stream.take(&record, Duration::ZERO);
        stream.take(&record, Duration::from_secs(1 << 40));
        assert!((1..=7000).contains(&stream.step()));
        for (counts, scale) in record.counts.iter().zip(found.scales()) {
            assert!((f64::from(*counts) * scale).abs() < 1e12);
        }
    }

    /// Numbers as a box could write them, including any double.
    fn number() -> impl Strategy<Value = String> {
        prop_oneof![
            any::<u64>().prop_map(|bits| f64::from_bits(bits).to_string()),
            any::<u64>().prop_map(|bits| format!("{:e}", f64::from_bits(bits))),
            (-3i32..12).prop_map(|digits| 10f64.powi(digits).to_string()),
            prop::sample::select(vec!["1e-30", "-0", "0", "1e308", "NaN", "inf", "7000", ""])
                .prop_map(str::to_owned),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn whatever_numbers_are_accepted_can_be_used(force in number(), torque in number(), rate in number(), buffer in number(), filter in number()) {
            let text = format!(
                "<netft><cfgcpf>{force}</cfgcpf><cfgcpt>{torque}</cfgcpt><scfgfu>klbf</scfgfu><scfgtu>N-mm</scfgtu>\
                 <comrdtrate>{rate}</comrdtrate><comrdtbsiz>{buffer}</comrdtbsiz><setuserfilter>{filter}</setuserfilter></netft>"
            );
            if let Ok(found) = BoxConfig::parse(&text) {
                use_it(&found);
            }
        }
    }

    proptest! {
        #[test]
        fn garbage_is_refused(text in "\\PC{0,300}") {
            prop_assert!(BoxConfig::parse(&text).is_err());
        }

        #[test]
        fn a_damaged_answer_never_panics(at in 0usize..300, with in any::<u8>()) {
            let mut bytes = xml("N", "N-m").into_bytes();
            let at = at % bytes.len();
            bytes[at] = with;
            if let Ok(found) = BoxConfig::parse(&String::from_utf8_lossy(&bytes)) {
                prop_assert!(found.newton_per_count > 0.0 && found.newton_metre_per_count > 0.0);
            }
        }
    }
}
