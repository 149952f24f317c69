//! Processes that must end: after a panic in one of their threads, or when a loop stands still.
//! Each is a real process, started by its test.

use std::io::Read;
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use tangent_live::timed;
use tangent_runtime::log::Log;
use tangent_runtime::systemd::Notify;
use tangent_runtime::{Beat, Stop, ending, watchdog};

const PATIENCE: Duration = Duration::from_secs(60);

/// Starts one of the tests below that are processes of their own.
fn start(role: &str, environment: &[(&str, &str)]) -> Child {
    let role = format!("ending::{role}");
    Command::new(std::env::current_exe().unwrap())
        .args([&role, "--exact", "--ignored", "--nocapture"])
        .envs(environment.iter().copied())
        .env_remove("RUST_BACKTRACE")
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Exit status and output of the process.
fn end(mut child: Child) -> (ExitStatus, String) {
    let until = Instant::now() + PATIENCE;
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if Instant::now() > until {
            child.kill().unwrap();
            panic!("it lives on");
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    let mut said = String::new();
    child.stderr.unwrap().read_to_string(&mut said).unwrap();
    (status, said)
}

/// Set-up by `main` for a process of services.
fn service_process() -> Stop {
    ending::on_panic();
    Log::start(std::io::stderr()).unwrap().install();
    let stop = Stop::new();
    ending::in_order(&stop);
    stop
}

/// Actions of `main` at its end.
fn last_words() -> ! {
    let code = i32::from(ending::cause().is_some());
    tangent_runtime::log::flush(PATIENCE);
    std::process::exit(code)
}

fn spawn(name: &str, body: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new()
        .name(name.into())
        .spawn(body)
        .unwrap();
}

#[test]
#[ignore = "a process of another test"]
fn role_panics() {
    let stop = service_process();
    spawn("netft", || {
        let period_s = 1.0 / 0.0_f64;
        let _ = Duration::from_secs_f64(period_s);
    });
    assert!(stop.wait(PATIENCE));
    last_words();
}

#[test]
fn a_panic_in_any_thread_ends_the_process_and_is_named() {
    timed(|| {
        let (status, said) = end(start("role_panics", &[]));
        assert_eq!(status.code(), Some(1), "{said}");
        assert!(said.contains("thread `netft` panicked at"), "{said}");
        assert!(
            said.contains("cannot convert float seconds to Duration"),
            "{said}"
        );
    });
}

#[test]
#[ignore = "a process of another test"]
fn role_does_not_end() {
    let _stop = service_process();
    spawn("netft", || panic!("the first"));
    // A service that does not look at its stop.
    loop {
        std::thread::park();
    }
}

#[test]
fn a_process_that_does_not_end_in_order_is_killed() {
    timed(|| {
        let (status, said) = end(start("role_does_not_end", &[]));
        assert_eq!(status.code(), Some(1), "{said}");
        assert!(said.contains("the first"), "{said}");
        assert!(said.contains("is killed"), "{said}");
    });
}

#[test]
#[ignore = "a process of another test"]
fn role_command_panics() {
    ending::on_panic();
    spawn("worker", || panic!("on the way"));
    // A command that waits for its worker without end.
    loop {
        std::thread::park();
    }
}

#[test]
fn a_command_without_services_ends_at_once() {
    timed(|| {
        let (status, said) = end(start("role_command_panics", &[]));
        assert_eq!(status.code(), Some(1), "{said}");
        assert!(said.contains("thread `worker` panicked"), "{said}");
        assert!(said.contains("on the way"), "{said}");
    });
}

#[test]
#[ignore = "a process of another test"]
fn role_stands_still() {
    let stop = service_process();
    watchdog::watch(&stop, Notify::from_environment()).unwrap();
    spawn("rtde-loop", || {
        let beat = Beat::new("rtde");
        for _ in 0..20 {
            beat.beat();
            std::thread::sleep(watchdog::TICK / 2);
        }
        // Represents a wait that never ends.
        loop {
            std::thread::park();
        }
    });
    assert!(stop.wait(PATIENCE));
    last_words();
}

#[test]
fn a_loop_that_stands_still_ends_the_process_and_systemd_is_notified() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        let environment = [
            ("NOTIFY_SOCKET", path.to_str().unwrap()),
            ("WATCHDOG_USEC", "2000000"),
        ];
        let child = start("role_stands_still", &environment);
        let mut heard = Vec::new();
        while heard.last().is_none_or(|last| last != "STOPPING=1") {
            let mut bytes = [0; 512];
            let length = socket
                .recv(&mut bytes)
                .expect("a word before the process ends");
            heard.push(String::from_utf8(bytes[..length].to_vec()).unwrap());
        }
        let (status, said) = end(child);
        assert_eq!(status.code(), Some(1), "{said}");
        assert!(said.contains("the loop of rtde has not run for"), "{said}");

        assert_eq!(heard[0], "READY=1");
        let stood = heard
            .iter()
            .position(|word| word.starts_with("STATUS=the loop of rtde"))
            .unwrap();
        // The watchdog was notified while the loop ran, and no longer once the stall was detected.
        assert!(heard[1..stood].iter().all(|word| word == "WATCHDOG=1"));
        assert!(stood > 10);
        assert_eq!(heard[stood + 1..], ["STOPPING=1"]);
    });
}
