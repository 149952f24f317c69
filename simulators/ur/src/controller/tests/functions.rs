//! The everyday functions of URScript: values of expressions, and their effects on the robot.

use tangent_rtde::codec::Value;
use tangent_urscript::Robot;

use crate::controller::Message;
use crate::rig::Rig;

fn texts(rig: &Rig) -> Vec<String> {
    rig.messages
        .iter()
        .filter_map(|m| match m {
            Message::Text(text) => Some(text.clone()),
            _ => None,
        })
        .collect()
}

/// Text of an expression's value.
fn text(expression: &str) -> String {
    let mut rig = Rig::cb3();
    rig.run(&format!("def f():\n textmsg({expression})\nend\n"), 3);
    assert_eq!(rig.exceptions(), Vec::<&str>::new(), "{expression}");
    texts(&rig).concat()
}

/// Exception of an expression.
fn fails(expression: &str) -> String {
    let mut rig = Rig::cb3();
    rig.run(&format!("def f():\n x = {expression}\nend\n"), 3);
    rig.exceptions().concat()
}

#[test]
fn texts_are_cut_and_joined() {
    for (expression, value) in [
        (r#"str_cat("a", 1.5)"#, "a1.5"),
        (r#"str_at("robot", 2)"#, "b"),
        (r#"str_len("robot")"#, "5"),
        (r#"str_empty("")"#, "True"),
        (r#"str_sub("robot", 1, 3)"#, "obo"),
        (r#"str_sub("robot", 3)"#, "ot"),
        (r#"str_find("robot robot", "bot")"#, "2"),
        (r#"str_find("robot robot", "bot", 3)"#, "8"),
        (r#"str_find("robot", "arm")"#, "-1"),
        (r#"to_num("12") + 1"#, "13"),
        (r#"to_num(" -1.5e1 ")"#, "-15"),
        (r#"to_str(p[1, 0, 0, 0, 0, 0])"#, "p[1, 0, 0, 0, 0, 0]"),
    ] {
        assert_eq!(text(expression), value, "{expression}");
    }
    assert_eq!(fails(r#"to_num("x")"#), "to_num: \"x\" is not a number");
    assert_eq!(fails(r#"str_at("ab", 2)"#), "index 2 is out of range");
}

#[test]
fn bits_lists_and_matrices() {
    for (expression, value) in [
        ("binary_list_to_integer([True, False, True])", "5"),
        ("binary_list_to_integer(integer_to_binary_list(-7))", "-7"),
        ("integer_to_binary_list(2)[1]", "True"),
        ("size([1, 2, 3])", "3"),
        ("size([[1, 2, 3], [4, 5, 6]])", "[2, 3]"),
        ("make_list(3, 7)", "[7, 7, 7]"),
        ("normalize([3, 4])", "[0.6, 0.8]"),
        ("transpose([[1, 2], [3, 4]])", "[[1, 3], [2, 4]]"),
        ("[[1, 2], [3, 4]] * [1, 1]", "[3, 7]"),
        ("[[1, 2], [3, 4]] * [[0, 1], [1, 0]]", "[[2, 1], [4, 3]]"),
        ("[[1, 2], [3, 4]] * 2", "[[2, 4], [6, 8]]"),
        ("inv([[2, 0], [0, 4]])[1, 1]", "0.25"),
        ("[1, 2] / 2", "[0.5, 1]"),
        ("point_dist(p[1,0,0,0,0,0], p[1,0,2,1,0,0])", "2"),
        ("pose_dist(p[0,0,0,0,0,0], p[0,0,0,0,0.5,0])", "0.5"),
        (
            "interpolate_pose(p[0,0,0,0,0,0], p[1,0,0,0,0,0], 0.25)",
            "p[0.25, 0, 0, 0, 0, 0]",
        ),
        (
            "floor(1000 * rotvec2rpy(rpy2rotvec([0, 0, 0.5004]))[2])",
            "500",
        ),
        (
            "wrench_trans(p[0, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0])",
            "[1, 0, 0, 0, 0, 1]",
        ),
        ("log(2, 8)", "3"),
    ] {
        assert_eq!(text(expression), value, "{expression}");
    }
    assert_eq!(
        fails("inv([[1, 1], [1, 1]])"),
        "inv: the matrix has no inverse"
    );
    assert_eq!(fails("inv([[1, 1]])"), "inv: the matrix has no inverse");
    assert_eq!(
        fails("[[1, 1]] * [1, 2, 3]"),
        "a matrix of 1 rows and 2 columns times a list of another size"
    );
}

#[test]
fn outputs_are_set_and_read_back() {
    let mut rig = Rig::cb3();
    rig.run(
        "def f():
           set_configurable_digital_out(1, True)
           set_tool_digital_out(0, True)
           set_standard_analog_out(1, 0.25)
           set_analog_outputdomain(1, 1)
           write_output_boolean_register(70, True)
           textmsg(get_configurable_digital_out(1), get_digital_out(9))
           textmsg(get_standard_analog_out(1), read_output_boolean_register(70))
           set_payload_mass(1.5)
           set_payload_cog([0.01, 0, 0.05])
           textmsg(get_target_payload())
           set_payload(2, [0, 0, 0.1])
           set_target_payload(2.5, [0, 0, 0.2], [0, 0, 0, 0, 0, 0], 0.1)
           set_tool_voltage(24)
         end",
        3,
    );
    assert_eq!(rig.exceptions(), Vec::<&str>::new());
    assert_eq!(texts(&rig), ["TrueTrue", "0.25True", "1.5"]);
    assert_eq!(rig.controller.registers.digital_outputs, 1 << 9 | 1 << 16);
    let summary = rig.controller.summary();
    let shown = |name: &str| rig.controller.output(name, &summary);
    assert_eq!(shown("standard_analog_output1"), Value::Double(2.5));
    assert_eq!(shown("payload"), Value::Double(2.5));
    assert_eq!(shown("payload_cog"), Value::Vector3d([0.0, 0.0, 0.2]));
    assert_eq!(
        fails("set_tool_voltage(5)"),
        "set_tool_voltage: 5 V, but must be 0, 12 or 24"
    );
    assert_eq!(
        fails("get_tool_digital_in(2)"),
        "there is no register or port 2"
    );
}

#[test]
fn movec_follows_its_arc() {
    let mut rig = Rig::cb3();
    rig.run(
        "def f():
           here = get_target_tcp_pose()
           movec(pose_add(here, p[0, 0.05, 0.05, 0, 0, 0]), pose_add(here, p[0, 0.1, 0, 0, 0, 0]), a=0.5, v=0.1)
           write_output_integer_register(0, 1)
         end",
        1,
    );
    let start = rig.controller.tcp_pose(true);
    let mut highest: f64 = 0.0;
    for _ in 0..400 {
        rig.cycle();
        let [x, y, z, ..] = rig.controller.tcp_pose(true);
        let (dy, dz) = (y - start[1] - 0.05, z - start[2]);
        assert!((dy.hypot(dz) - 0.05).abs() < 1e-3, "off the arc");
        assert!((x - start[0]).abs() < 1e-3);
        highest = highest.max(dz);
    }
    assert_eq!(rig.exceptions(), Vec::<&str>::new());
    assert_eq!(rig.out(0), 1);
    assert!((highest - 0.05).abs() < 1e-3);
}

#[test]
fn a_blocking_popup_waits_for_the_operator() {
    let mut rig = Rig::cb3();
    rig.run(
        "def f():
           popup(\"note\", title=\"t\", blocking=False)
           write_output_integer_register(0, 1)
           popup(\"stop\", blocking=True)
           write_output_integer_register(0, 2)
         end",
        50,
    );
    assert_eq!(rig.out(0), 1);
    rig.controller.close_popup();
    rig.cycles(2);
    assert_eq!(rig.out(0), 2);
}

/// A client moves the arm in a critical section of one thread, and kills it from another's.
#[test]
fn a_critical_section_that_waits_lets_others_run() {
    let mut rig = Rig::cb3();
    rig.run(
        "def f():
           thread along():
             enter_critical
             while True:
               speedj([0.1, 0, 0, 0, 0, 0], 1, 0.008)
             end
             exit_critical
           end
           handle = run along()
           i = 0
           while i < 20:
             enter_critical
             sync()
             exit_critical
             i = i + 1
           end
           enter_critical
           kill handle
           stopj(2)
           exit_critical
           write_output_integer_register(0, 1)
         end",
        80,
    );
    assert_eq!(rig.exceptions(), Vec::<&str>::new());
    assert_eq!(rig.out(0), 1);
}
