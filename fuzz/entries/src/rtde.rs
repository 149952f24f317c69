//! Universal Robots: RTDE packages, the bridge that receives them, the dashboard's lines and the
//! primary stream.

use nalgebra::{Matrix6, Vector3, Vector6};
use tangent_actuation::Command;
use tangent_actuation::MotionLimits;
use tangent_actuation::velocity::{Posture, VelocityLimits};
use tangent_rtde::bridge::{Bridge, BridgeConfig};
use tangent_rtde::codec::{Framer, PACKAGE_BYTES_MAX, Protocol, Reply, Request};
use tangent_rtde::dashboard::{Lines, polyscope_version, ur_size};
use tangent_rtde::primary::PrimaryReader;
use tangent_rtde::program::RegisterMap;
use tangent_schemas::JointArray;

/// Splits the bytes into packages, and decodes each as a request and as a reply of both protocol
/// versions. A decoded package is encoded and decoded again, and must stay equal.
pub fn rtde_packages(data: &[u8]) {
    let mut framer = Framer::new(PACKAGE_BYTES_MAX);
    let mut rest = data;
    while !rest.is_empty() {
        let taken = framer.push(rest);
        rest = &rest[taken..];
        let mut packages = 0;
        while let Ok(Some(package)) = framer.next_package() {
            packages += 1;
            for protocol in [Protocol::V1, Protocol::V2] {
                check_request(package.kind, package.payload, protocol);
                check_reply(package.kind, package.payload, protocol);
            }
        }
        if taken == 0 && packages == 0 {
            return;
        }
    }
}

fn check_request(kind: u8, payload: &[u8], protocol: Protocol) {
    let Ok(read) = Request::decode(kind, payload, protocol) else {
        return;
    };
    let mut bytes = Vec::new();
    if read.encode(protocol, &mut bytes).is_ok() {
        let mut framer = Framer::new(bytes.len());
        framer.push(&bytes);
        if let Ok(Some(package)) = framer.next_package() {
            let again = Request::decode(package.kind, package.payload, protocol);
            // Compared as text, since a frequency may be NaN.
            assert_eq!(format!("{again:?}"), format!("{:?}", Ok::<_, ()>(read)));
        }
    }
}

fn check_reply(kind: u8, payload: &[u8], protocol: Protocol) {
    let Ok(read) = Reply::decode(kind, payload, protocol) else {
        return;
    };
    let mut bytes = Vec::new();
    if read.encode(protocol, &mut bytes).is_ok() {
        let mut framer = Framer::new(bytes.len());
        framer.push(&bytes);
        if let Ok(Some(package)) = framer.next_package() {
            let again = Reply::decode(package.kind, package.payload, protocol);
            assert_eq!(format!("{again:?}"), format!("{:?}", Ok::<_, ()>(read)));
        }
    }
}

/// Runs a bridge whose controller sends the bytes. It never commands a value that is not finite.
pub fn rtde_bridge(data: &[u8]) {
    let registers = RegisterMap::new(24).expect("24 is a base that fits");
    let mut bridge = Bridge::new(BridgeConfig {
        registers,
        model: "ur5".to_owned(),
        series: None,
        rate_hz: None,
        wrench: None,
        limits: VelocityLimits {
            motion: MotionLimits {
                speed_rad_per_s: Vector6::repeat(1.0),
                position_lower_rad: Vector6::repeat(-6.3),
                position_upper_rad: Vector6::repeat(6.3),
                tool_speed_max_m_per_s: 0.25,
                tool_turn_rate_max_rad_per_s: 1.0,
                workspace_lower_m: Vector3::repeat(-1.0),
                workspace_upper_m: Vector3::repeat(1.0),
            },
            acceleration_rad_per_s2: Vector6::repeat(4.0),
            response_s: 0.04,
            patience_cycles: 2,
            silence_latch_s: 0.1,
        },
        speed_scaling_min: 0.01,
        seed: 1,
    });
    let mut out = Vec::new();
    if bridge.open(0.0, &mut out).is_err() {
        return;
    }
    let mut framer = Framer::new(PACKAGE_BYTES_MAX);
    framer.push(data);
    let posture = Posture {
        q: Vector6::zeros(),
        tool_m: Vector3::zeros(),
        tool_jacobian: Matrix6::zeros(),
    };
    let mut values = JointArray::default();
    values.extend([0.1; 6]);
    let mut now_s = 0.0;
    while let Ok(Some(package)) = framer.next_package() {
        now_s += 0.008;
        if bridge.package(package, now_s, &mut out).is_err() {
            return;
        }
        let wanted = Command {
            cycle: bridge.cycle(),
            kind: 1,
            values: &values,
            acceleration: 1.0,
            activation: 1,
        };
        if bridge
            .command(&posture, Some(&wanted), now_s, &mut out)
            .is_err()
        {
            return;
        }
        assert!(bridge.period_s().is_finite() && bridge.period_s() > 0.0);
        assert!(bridge.latency_s().is_finite());
        out.clear();
    }
}

/// Reads lines of the dashboard server in pieces of any length.
pub fn dashboard_lines(data: &[u8]) {
    let mut lines = Lines::default();
    for piece in data.chunks(61) {
        if lines.push(piece).is_err() {
            return;
        }
        while let Some(line) = lines.next_line() {
            assert!(!line.contains('\n'));
            let _ = polyscope_version(&line);
            let _ = ur_size(&line);
        }
    }
}

/// Reads the primary stream in pieces of any length.
pub fn primary_stream(data: &[u8]) {
    let mut reader = PrimaryReader::default();
    for piece in data.chunks(97) {
        if reader.push(piece).is_err() {
            return;
        }
    }
}
