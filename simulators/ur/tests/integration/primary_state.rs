//! The robot state of the primary port, parsed as the Universal Robots Client Library does.

use std::io::Read;
use std::net::TcpStream;

use crate::common::{connect, start_model};
use tangent_live::timed;
use tangent_mechanics::ModelData;
use tangent_simulated_device::Ports;
use tangent_simulated_ur::ControllerConfig;

/// Takes big-endian values off the front, as `comm::BinParser`.
struct Parser<'a>(&'a [u8]);

impl Parser<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self.0.split_at(N);
        self.0 = rest;
        head.try_into().unwrap()
    }
    fn u32(&mut self) -> u32 {
        u32::from_be_bytes(self.bytes())
    }
    fn f64(&mut self) -> f64 {
        f64::from_be_bytes(self.bytes())
    }
    fn six(&mut self) -> [f64; 6] {
        std::array::from_fn(|_| self.f64())
    }
}

/// Body of the part of this type in the first robot state.
fn part(stream: &mut TcpStream, kind: u8) -> Vec<u8> {
    loop {
        let mut head = [0; 5];
        stream.read_exact(&mut head).unwrap();
        let length = u32::from_be_bytes(head[..4].try_into().unwrap()) as usize;
        let mut body = vec![0; length - 5];
        stream.read_exact(&mut body).unwrap();
        if head[4] != 16 {
            continue;
        }
        let mut rest = body.as_slice();
        while let Some(head) = rest.first_chunk::<4>() {
            let (part, after) = rest.split_at(u32::from_be_bytes(*head) as usize);
            if part[4] == kind {
                return part[5..].to_vec();
            }
            rest = after;
        }
    }
}

#[test]
fn the_kinematics_are_in_the_order_that_clients_parse() {
    timed(|| {
        let config = ControllerConfig::default();
        let address = "127.0.0.1".parse().unwrap();
        let cell = start_model(address, Ports::Ephemeral, &config, "ur5").unwrap();
        let rows = ModelData::builtin("ur5").unwrap().dh.rows;
        let mut stream = connect(cell.endpoints().primary);

        let body = part(&mut stream, 5);
        let mut kinematics = Parser(&body);
        let _checksum: [u32; 6] = std::array::from_fn(|_| kinematics.u32());
        let [theta, a, d, alpha] = std::array::from_fn(|_| kinematics.six());
        let _calibration_status = kinematics.u32();
        assert!(kinematics.0.is_empty());

        let body = part(&mut stream, 6);
        let mut configuration = Parser(&body[(12 + 12 + 5) * 8..]);
        let same = std::array::from_fn(|_| configuration.six());
        assert_eq!([a, d, alpha, theta], same);

        // A shoulder at 0.089 m, two links of 0.4 m, three right angles.
        for (i, row) in rows.iter().take(6).enumerate() {
            assert_eq!(
                [theta[i], a[i], d[i], alpha[i]],
                [row.theta_offset_rad, row.a_m, row.d_m, row.alpha_rad]
            );
        }
    });
}
