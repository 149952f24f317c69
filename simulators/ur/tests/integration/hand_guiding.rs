//! Freedrive at the wire: an external force sensor on RTDE, or a simulated hand, moves the arm.

use std::io::Write;

use crate::common::{PATIENCE, connect, rtde_answer, rtde_request, start};
use tangent_live::timed;
use tangent_simulated_ur::{ControllerConfig, Fault, Flavour};

#[test]
fn freedrive_follows_the_force_that_a_client_measures() {
    timed(|| {
        for flavour in [Flavour::Cb3, Flavour::ESeries] {
            let cell = start(ControllerConfig {
                flavour,
                ..ControllerConfig::default()
            });
            let mut rtde = connect(cell.endpoints().rtde);
            rtde.write_all(&rtde_request(b'V', &[0, 2])).unwrap();
            rtde.write_all(&rtde_request(b'I', b"external_force_torque"))
                .unwrap();
            assert_eq!(rtde_answer(&mut rtde), (b'V', vec![1]));
            assert_eq!(
                rtde_answer(&mut rtde),
                (b'I', [&[1], &b"VECTOR6D"[..]].concat())
            );
            let mut script = connect(cell.endpoints().secondary);
            script
                .write_all(
                    b"def guide():\n  ft_rtde_input_enable(True)\n  freedrive_mode()\n  while True:\n    sync()\n  end\nend\n",
                )
                .unwrap();
            assert!(cell.wait_for(PATIENCE, |s| s.program.as_deref() == Some("guide")));
            // 15 N along z of the flange, which points down in the start pose.
            let down = [0.0, 0.0, 15.0, 0.0, 0.0, 0.0_f64];
            let mut data = vec![1];
            data.extend(down.iter().flat_map(|x| x.to_be_bytes()));
            rtde.write_all(&rtde_request(b'U', &data)).unwrap();
            assert!(cell.wait_for(PATIENCE, |s| s.summary.tcp_speed[2] < -0.06));
            rtde.write_all(&rtde_request(b'U', &[&[1][..], &[0; 48]].concat()))
                .unwrap();
            assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-3));
        }
    });
}

#[test]
fn a_push_is_felt_and_moves_a_free_arm_only() {
    timed(|| {
        let cell = start(ControllerConfig::default());
        cell.fault(Fault::Push([0.0, 10.0, 0.0]));
        assert!(cell.wait_for(PATIENCE, |s| s.summary.tcp_force[1] == 10.0));
        assert!(cell.snapshot().unwrap().summary.qd.amax() < 1e-6);
        let mut script = connect(cell.endpoints().secondary);
        script
            .write_all(b"def guide():\n  teach_mode()\n  while True:\n    sync()\n  end\nend\n")
            .unwrap();
        assert!(cell.wait_for(PATIENCE, |s| s.summary.tcp_speed[1] > 0.04));
        script.write_all(b"stop program\n").unwrap();
        assert!(cell.wait_for(PATIENCE, |s| s.summary.qd.amax() < 1e-6));
    });
}
