//! URScript programs as the controller runs them: what the arm does, what is reported and where.

use proptest::prelude::*;
use tangent_urscript::{CompileError, Program};

use crate::config::ControllerConfig;
use crate::controller::Message;
use crate::modes::{RuntimeState, SafetyMode};
use crate::rig::Rig;

fn compile(text: &str) -> Result<Program, CompileError> {
    Program::compile(text, false)
}

/// Runs a program's body for a few cycles.
fn run(body: &str) -> Rig {
    let mut rig = Rig::cb3();
    rig.run(&format!("def test():\n{body}\nend\n"), 20);
    rig
}

fn result(body: &str) -> i32 {
    let rig = run(body);
    assert_eq!(rig.exceptions(), Vec::<&str>::new(), "{body}");
    rig.out(0)
}

#[test]
fn arithmetic_and_control_flow() {
    let out = |e: &str| result(&format!("write_output_integer_register(0, {e})"));
    assert_eq!(out("1 + 2 * 3 - -4"), 11);
    assert_eq!(out("(1 + 2) * 3"), 9);
    assert_eq!(out("17 % 5"), 2);
    assert_eq!(out("floor(7 / 2)"), 3);
    assert_eq!(out("[5, 6, 7][1]"), 6);
    assert_eq!(out("get_list_length([1, 2, 3])"), 3);
    assert_eq!(
        result(
            "i = 0\nsum = 0\nwhile True:\n i = i + 1\n if i == 3:\n continue\n elif i > 5:\n break\n else:\n sum = sum + i\n end\nend\nwrite_output_integer_register(0, sum)"
        ),
        1 + 2 + 4 + 5
    );
    assert_eq!(
        result("if not (1 > 2) and (False or 2 >= 2):\n write_output_integer_register(0, 7)\nend"),
        7
    );
}

#[test]
fn functions_globals_and_locals() {
    let text = "
      global total = 0
      def add(a, b=10):
        local x = a + b
        total = total + x
        return x
      end
      def fib(n):
        if n < 2:
          return n
        end
        return fib(n - 1) + fib(n - 2)
      end
      add(1)
      add(b=1, a=2)
      write_output_integer_register(0, total + fib(10))";
    assert_eq!(result(text), 11 + 3 + 55);
}

#[test]
fn lists_are_copied_and_elements_assigned() {
    assert_eq!(
        result(
            "a = [1, 2, 3]\nb = a\nb[0] = 9\nq = p[0,0,0,0,0,4]\nq[1] = 2\nwrite_output_integer_register(0, a[0] * 100 + b[0] * 10 + floor(q[1] + q[5]))"
        ),
        196
    );
}

#[test]
fn newlines_end_nothing() {
    // As ur_rtde uploads it: a number that its loader put behind the newline, and a statement
    // behind the number.
    let text = "global a = # comment\n0    global b = # another\n5    global c = 2\nwrite_output_integer_register(0, a + b * 10 + c)";
    assert_eq!(result(text), 52);
    assert_eq!(
        result("p = [1, 2]\nwrite_output_integer_register(0, p[1] )"),
        2
    );
}

#[test]
fn threads_take_turns_and_can_be_killed() {
    let mut rig = Rig::cb3();
    rig.run(
        "def test():
           global n = 0
           thread count():
             while True:
               enter_critical
               n = n + 1
               exit_critical
               write_output_integer_register(0, n)
               sync()
             end
           end
           handle = run count()
           i = 0
           while i < 5:
             sync()
             i = i + 1
           end
           kill handle
           write_output_integer_register(1, n)
           while True:
             sync()
           end
         end",
        40,
    );
    assert_eq!(rig.out(0), rig.out(1));
    assert!((4..=6).contains(&rig.out(1)), "{}", rig.out(1));
}

#[test]
fn killing_a_handle_that_never_ran_kills_no_thread() {
    assert_eq!(
        result("handle = 0\nkill handle\njoin handle\nwrite_output_integer_register(0, 3)"),
        3
    );
}

#[test]
fn join_waits_for_the_end() {
    assert_eq!(
        result(
            "thread t():\n sleep(0.03)\n write_output_integer_register(0, 1)\nend\nh = run t()\njoin h\nwrite_output_integer_register(0, 1 + read_output_integer_register(0))"
        ),
        2
    );
}

#[test]
fn a_loop_without_motion_is_a_protective_stop() {
    let rig = run("while True:\n i = 1\nend");
    assert_eq!(rig.exceptions().len(), 1);
    assert!(
        rig.exceptions()[0]
            .starts_with("The program used too much time without instructing the robot")
    );
    assert_eq!(rig.controller.safety(), SafetyMode::ProtectiveStop);
    assert_eq!(rig.controller.runtime(), RuntimeState::Stopped);
}

#[test]
fn an_unknown_name_is_reported_and_nothing_starts() {
    let mut rig = Rig::cb3();
    rig.run("def test():\n  sync()\n  fly_away(1)\nend\n", 5);
    assert_eq!(rig.exceptions(), ["compile_error_name_not_found:fly_away:"]);
    assert!(!rig.messages.iter().any(|m| matches!(m, Message::Key(..))));
    let error = compile("def test():\n  sync()\n  x = y + 1\nend\n").unwrap_err();
    assert_eq!((error.line, error.unknown_name), (3, true));
    // Not on CB3.
    assert!(compile("get_freedrive_status()").is_err());
    assert!(Program::compile("get_freedrive_status()", true).is_ok());
}

#[test]
fn only_the_owner_of_a_motion_stops_it() {
    let mut rig = Rig::cb3();
    rig.run(
        "def test():
           thread go():
             while True:
               speedj([0.2, 0, 0, 0, 0, 0], 1.0, 0.008)
             end
           end
           run go()
           sleep(0.2)
           stopj(2.0)
         end",
        60,
    );
    assert_eq!(
        rig.exceptions(),
        ["Another thread is already controlling the robot"]
    );
}

#[test]
fn speedj_moves_and_stopj_stops_and_slider_stretches() {
    let mut rig = Rig::cb3();
    let program = "def test():
       i = 0
       while i < 50:
         speedj([0, 0.2, 0, 0, 0, 0], 2.0, 0.008)
         i = i + 1
       end
       write_output_integer_register(0, 1)
       stopj(2.0)
       write_output_integer_register(0, 2)
     end";
    let start = rig.arm.joints()[1];
    rig.run(program, 30);
    assert!((rig.speed() - 0.2).abs() < 1e-9);
    rig.cycles(60);
    assert_eq!(rig.out(0), 2);
    assert!(rig.speed() < 1e-6);
    let full = rig.arm.joints()[1] - start;
    assert!((0.06..0.09).contains(&full), "{full}");
    assert_eq!(rig.controller.safety(), SafetyMode::Normal);

    rig.controller.set_slider(0.5);
    rig.run(program, 30);
    assert!((rig.speed() - 0.1).abs() < 1e-9);
    rig.cycles(40);
    // Each call takes two cycles now.
    assert!(rig.speed() > 0.09);
}

#[test]
fn speedj_goes_on_after_its_time_or_brakes_as_configured() {
    let program =
        "def test():\n speedj([0, 0.2, 0, 0, 0, 0], 2.0, 0.2)\n while True:\n sync()\n end\nend\n";
    for stops in [false, true] {
        let mut rig = Rig::new(ControllerConfig {
            speedj_stops_after_t: stops,
            ..ControllerConfig::default()
        });
        rig.run(program, 100);
        assert_eq!(rig.speed() < 1e-6, stops);
    }
}

#[test]
fn a_program_that_ends_at_speed_ends_in_a_protective_stop() {
    let mut rig = Rig::cb3();
    rig.run(
        "def test():\n speedj([1, 0, 0, 0, 0, 0], 10, 0.3)\nend\n",
        80,
    );
    assert_eq!(rig.controller.safety(), SafetyMode::ProtectiveStop);
    assert!(rig.speed() < 1e-6);
}

#[test]
fn movej_and_movel_arrive() {
    let mut rig = Rig::cb3();
    rig.run(
        "def test():
           q = get_actual_joint_positions()
           q[0] = q[0] + 0.3
           movej(q, a=2.0, v=1.0)
           write_output_float_register(0, get_actual_joint_positions()[0] - q[0])
           goal = pose_trans(p[0, 0, -0.05, 0, 0, 0], get_target_tcp_pose())
           movel(goal, a=1.0, v=0.1)
           d = pose_sub(get_target_tcp_pose(), goal)
           write_output_float_register(1, norm([d[0], d[1], d[2]]))
           write_output_integer_register(0, 1)
         end",
        400,
    );
    assert_eq!(rig.exceptions(), Vec::<&str>::new());
    assert_eq!(rig.out(0), 1);
    assert!(rig.out_double(0).abs() < 2e-3, "{}", rig.out_double(0));
    assert!(rig.out_double(1).abs() < 5e-4, "{}", rig.out_double(1));
}

#[test]
fn runtime_errors_say_where() {
    for (body, text) in [
        ("x = [1, 2][7]", "index 7 is out of range"),
        ("x = 1 / 0", "division by zero"),
        (
            "x = read_input_integer_register(48)",
            "there is no register or port 48",
        ),
        ("x = 1 + \"a\"", "+ does not work with an int and a text"),
        ("speedj([0, 0, 0], 1, 1)", "six numbers are needed, not 3"),
        (
            "local y = \"1\"\nif y:\nend",
            "a bool is needed, not a text",
        ),
    ] {
        let rig = run(body);
        assert_eq!(rig.exceptions(), [text], "{body}");
    }
}

#[test]
fn hostile_programs_are_bounded() {
    for body in [
        "def f(x):\n return f(x + 1)\nend\nf(0)",
        "x = [1]\nwhile True:\n x = [x, x]\nend",
        "s = \"a\"\nwhile True:\n s = str_cat(s, s)\nend",
        "thread t():\n while True:\n sync()\n end\nend\nwhile True:\n run t()\nend",
        "thread t():\n run t()\n sync()\nend\nrun t()\nwhile True:\n sync()\nend",
    ] {
        let rig = run(body);
        assert_eq!(rig.exceptions().len(), 1, "{body}");
    }
}

#[test]
fn secondary_programs_leave_the_main_one_alone() {
    let mut rig = Rig::cb3();
    rig.run("def main():\n while True:\n  sync()\n end\nend\n", 5);
    rig.run("sec aside():\n set_digital_out(3, True)\nend\n", 2);
    assert_eq!(rig.controller.program_name(), Some("main"));
    assert_eq!(rig.controller.registers.digital_outputs, 8);
    rig.run("sec slow():\n sleep(1)\nend\n", 2);
    assert_eq!(rig.exceptions(), ["Runtime is too much behind"]);
    assert_eq!(rig.controller.program_name(), Some("main"));
}

#[test]
fn a_new_program_replaces_the_running_one() {
    let mut rig = Rig::cb3();
    rig.run("def one():\n while True:\n  sync()\n end\nend\n", 5);
    rig.run("textmsg(\"hello \", 5)", 3);
    let keys: Vec<String> = rig
        .messages
        .iter()
        .filter_map(|m| match m {
            Message::Key(title, name) => Some(format!("{} {name}", &title[12..])),
            Message::Text(text) => Some(text.clone()),
            _ => None,
        })
        .collect();
    assert_eq!(
        keys,
        [
            "STARTED one",
            "STOPPED one",
            "STARTED script",
            "hello 5",
            "STOPPED script"
        ]
    );
}

#[test]
fn the_start_takes_its_time() {
    let mut rig = Rig::new(ControllerConfig {
        program_start_s: 0.08,
        compile_s_per_line: 0.0,
        ..ControllerConfig::default()
    });
    rig.run("def one():\n while True:\n  sync()\n end\nend\n", 8);
    assert!(!rig.controller.is_playing());
    rig.cycles(4);
    assert!(rig.controller.is_playing());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_words_make_it_panic(words in prop::collection::vec(prop::sample::select(vec![
        "def", "f", "(", ")", ":", "end", "while", "True", "if", "elif", "else", "x", "=", "1", "2.5", "[", "]", ",",
        "p", "run", "kill", "join", "thread", "return", "break", "continue", "global", "local", "sync", "speedj", "not",
        "and", "or", "-", "+", "/", "\"s\"", "\n", "enter_critical", "exit_critical", "halt", "stopj", "sleep",
        "read_input_integer_register", "x[0]", "f()", "sync()", "x = 1\n", "def f():\n", "end\n",
    ]), 0..60)) {
        let text = words.join(" ");
        if compile(&text).is_ok() {
            let mut rig = Rig::cb3();
            rig.run(&text, 3);
        }
    }
}
