//! Force mode and freedrive: what the arm does under a force, and when it stops yielding.

use tangent_urscript::Robot;

use crate::config::{ControllerConfig, Flavour};
use crate::plant::ArmPlant;
use crate::rig::Rig;

fn rig(flavour: Flavour) -> Rig {
    Rig::new(ControllerConfig {
        flavour,
        program_start_s: 0.0,
        compile_s_per_line: 0.0,
        ..ControllerConfig::default()
    })
}

fn position(rig: &Rig) -> [f64; 3] {
    let pose = rig.controller.tcp_pose(false);
    [pose[0], pose[1], pose[2]]
}

/// A table below the tool: 8 kN/m from 5 mm under the start.
fn press(rig: &mut Rig, cycles: usize) -> f64 {
    let table = position(rig)[2] - 0.005;
    let mut push = 0.0;
    for _ in 0..cycles {
        push = 8000.0 * (table - position(rig)[2]).max(0.0);
        let force = [0.0, 0.0, push, 0.0, 0.0, 0.0];
        let command = rig.controller.cycle(rig.arm.arm(), force);
        rig.arm.step(&command);
        rig.messages.extend(rig.controller.take_messages());
    }
    push
}

const PRESS: &str =
    "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-12,0,0,0], 2, [1,1,0.02,1,1,1])";

#[test]
fn force_mode_presses_with_the_wrench_while_the_program_moves_along() {
    for flavour in [Flavour::Cb3, Flavour::ESeries] {
        let mut rig = rig(flavour);
        let start = position(&rig);
        rig.controller.upload(&format!(
            "def go():
               force_mode_set_damping(0.025)
               {PRESS}
               sleep(2)
               goal = pose_add(get_target_tcp_pose(), p[0, 0.05, 0, 0, 0, 0])
               movel(goal, a=0.5, v=0.05)
               write_output_integer_register(0, 1)
               while True:
                 sync()
               end
             end\n"
        ));
        let seconds = (1.0 / rig.controller.config().flavour.period_s()) as usize;
        let force = press(&mut rig, 5 * seconds);
        assert_eq!(rig.exceptions(), Vec::<&str>::new());
        assert_eq!(rig.out(0), 1, "the line ends");
        assert!((force - 12.0).abs() < 0.3, "{flavour:?}: {force} N");
        let moved = position(&rig)[1] - start[1];
        assert!((moved - 0.05).abs() < 2e-3, "{flavour:?}: {moved} m");

        // The end of the program ends the mode.
        rig.controller.stop_program();
        let depth = position(&rig)[2];
        press(&mut rig, seconds);
        assert!((position(&rig)[2] - depth).abs() < 1e-4);
    }
}

#[test]
fn the_speed_of_a_compliant_axis_is_limited() {
    let mut rig = rig(Flavour::Cb3);
    rig.run(
        "def go():
           force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,40,0,0,0], 2, [1,1,0.02,1,1,1])
           sleep(1)
           write_output_float_register(0, get_actual_tcp_speed()[2])
           end_force_mode()
           sleep(0.5)
           write_output_float_register(1, norm(get_actual_tcp_speed()))
         end",
        250,
    );
    assert_eq!(rig.exceptions(), Vec::<&str>::new());
    assert!((rig.out_double(0) - 0.02).abs() < 1e-3);
    assert!(rig.out_double(1) < 1e-4);
}

#[test]
fn a_hand_guides_the_arm_only_while_it_may() {
    for (begin, end) in [
        ("teach_mode()", "end_teach_mode()"),
        ("freedrive_mode()", "end_freedrive_mode()"),
    ] {
        let mut rig = rig(Flavour::Cb3);
        rig.run(
            &format!("def go():\n {begin}\n sleep(2)\n {end}\n while True:\n  sync()\n end\nend\n"),
            20,
        );
        let start = position(&rig);
        rig.controller.push([0.0, 10.0, 0.0, 0.0, 0.0, 0.0]);
        rig.cycles(100);
        let guided = position(&rig)[1] - start[1];
        assert!(guided > 0.02, "{begin}: {guided} m");
        rig.controller.push([0.0; 6]);
        rig.cycles(50);
        assert!(rig.speed() < 1e-3, "{begin}: it stays where it is let go");
        rig.cycles(100);
        let held = position(&rig);
        rig.controller.push([0.0, 10.0, 0.0, 0.0, 0.0, 0.0]);
        rig.cycles(100);
        assert!((position(&rig)[1] - held[1]).abs() < 1e-4, "{end}");
        assert_eq!(rig.exceptions(), Vec::<&str>::new());
    }
}

#[test]
fn another_thread_may_move_a_compliant_arm() {
    let mut rig = rig(Flavour::Cb3);
    rig.run(
        "def go():
           thread along():
             q = get_target_joint_positions()
             q[0] = q[0] + 0.1
             movej(q, a=1, v=1)
             write_output_integer_register(0, 1)
           end
           force_mode(tool_pose(), [0,0,1,0,0,0], [0,0,20,0,0,0], 2, [1,1,0.05,1,1,1])
           movel(pose_add(get_target_tcp_pose(), p[0.01,0,0,0,0,0]))
           handle = run along()
           join handle
           force_mode(p[1,0,0,0,0,0], [0,0,1,0,0,0], [0,0,20,0,0,0], 1, [1,1,0.05,1,1,1])
           sleep(0.1)
           force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,20,0,0,0], 3, [1,1,0.05,1,1,1])
           sleep(0.1)
           stopj(2)
           write_output_integer_register(0, 2)
         end
         "
        .replace("tool_pose()", "get_actual_tcp_pose()")
        .trim_end(),
        600,
    );
    assert_eq!(rig.exceptions(), Vec::<&str>::new());
    assert_eq!(rig.out(0), 2);
}

#[test]
fn wrong_arguments_of_force_mode_say_what_is_allowed() {
    for (call, text) in [
        (
            "force_mode(p[0,0,0,0,0,0], [1,0,0,0,0,0], [0,0,0,0,0,0], 4, [1,1,1,1,1,1])",
            "force_mode: type is 4, but must be 1 to 3",
        ),
        (
            "force_mode(p[0,0,0,0,0,0], [1,0,0,0,0,0], [0,0,0,0,0,0], 2, [0,1,1,1,1,1])",
            "limits is 0, but must be above 0",
        ),
        (
            "force_mode_set_damping(2)",
            "force_mode_set_damping: damping is 2, but must be 0 to 1",
        ),
    ] {
        let mut rig = rig(Flavour::Cb3);
        rig.run(&format!("def go():\n {call}\nend\n"), 5);
        assert_eq!(rig.exceptions(), [text]);
    }
}
