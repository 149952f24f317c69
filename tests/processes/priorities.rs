//! Tests the order of priorities while another program occupies the processor with SCHED_FIFO, at
//! every level between two of ours.
//!
//! Robot, sensor, loop, estimator and router share one core with the program that takes it. Threads
//! with a higher priority than that program must not be affected; those with a lower one may be
//! late, and then the arm is safe and a new task can be started.

use std::time::{Duration, Instant};

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;
use tangent_runtime::clock::now_ns;
use tangent_runtime::config::RealtimeConfig;
use tangent_runtime::realtime::{in_scheduled_thread, try_schedule};

use crate::cell::{Cell, Observer, PATIENCE, set};
use crate::common::wait_for;
use tangent_live::live;

const NAMES: [&str; 5] = [
    "router",
    "simulator",
    "netft",
    "rtde controller",
    "estimator",
];
/// Time for which the processor is occupied: less than what Linux grants to real-time threads in
/// each second.
const TAKEN: Duration = Duration::from_millis(400);
/// Largest force during any fault, N: the larger of twice the reference and 10 N.
const FORCE_MAX_N: f64 = 10.0;

/// Restricts the calling thread, and the threads that it starts from now on, to these CPUs.
fn keep_to(cpus: &CpuSet) {
    sched_setaffinity(Pid::from_raw(0), cpus).unwrap();
}

/// Occupies the CPU of the calling thread with `priority`. Returns the beginning and the end, ns
/// since the Unix epoch.
fn take_the_processor(priority: u8, cpus: CpuSet) -> (i64, i64) {
    in_scheduled_thread(priority, |granted| {
        granted.unwrap();
        keep_to(&cpus);
        let (began, until) = (now_ns(), Instant::now() + TAKEN);
        while Instant::now() < until {
            std::hint::spin_loop();
        }
        (began, now_ns())
    })
    .unwrap()
}

#[test]
fn threads_above_a_program_that_takes_the_processor_are_not_affected() {
    live(|| {
        let order = RealtimeConfig::default()
            .order()
            .map(|(_, priority)| priority);
        let [_, the_loop, sensor, bus, estimator, camera] = order;
        if let Err(why) = try_schedule(order[0]) {
            eprintln!("skipped, because SCHED_FIFO is not granted: {why}");
            return;
        }
        let all = sched_getaffinity(Pid::from_raw(0)).unwrap();
        let first = (0..CpuSet::count())
            .find(|&i| all.is_set(i).unwrap())
            .unwrap();
        let mut one = CpuSet::new();
        one.set(first).unwrap();

        keep_to(&one);
        // The whole cell has to fit on one core.
        let mut cell = Cell::new(|cell| set(cell, "sensor.rate_hz", 500.0));
        cell.start_all(&NAMES);
        keep_to(&all);
        let observer = Observer::join(&cell);
        observer.slide(&cell, &cell.long_task());

        // All our threads have a higher priority than these.
        for priority in [camera + 5, 60, estimator - 1] {
            let (began, ended) = take_the_processor(priority, one);
            wait_for("the controller speaks again", PATIENCE, || {
                observer.controls(ended).len().gt(&10).then_some(())
            });
            let seen = observer.controls(began);
            let goes_on = seen.iter().filter(|seen| {
                let fault = seen.message.fault;
                assert!(fault.is_empty(), "priority {priority}: {fault}");
                // A loss of contact for 24 ms is caused by the surface, and contact follows it.
                matches!(
                    seen.message.phase_text.as_str(),
                    "slide" | "seek" | "contact"
                )
            });
            // A shared machine may stall for some cycles.
            let share = goes_on.count() as f64 / seen.len() as f64;
            assert!(
                share > 0.9,
                "priority {priority}: slides {share} of the time"
            );
            observer.pressed_at_most(FORCE_MAX_N, began);
        }

        // Between two of our priorities: the arm is safe, no process ends, and a task can be
        // started again.
        for priority in [estimator + 1, bus + 1, sensor + 1, the_loop + 1] {
            let (began, ended) = take_the_processor(priority, one);
            wait_for("the controller speaks again", PATIENCE, || {
                observer.controls(ended).len().gt(&10).then_some(())
            });
            observer.pressed_at_most(FORCE_MAX_N, began);
            cell.assert_running(&NAMES);
            let still = wait_for("it slides on, or the task has ended", PATIENCE, || {
                let last = observer.controls(ended).pop()?;
                match last.message.phase_text.as_str() {
                    "slide" => Some(true),
                    "fault" | "done" | "idle" => Some(false),
                    _ => None,
                }
            });
            if !still {
                let task = cell.task(
                    false,
                    "kind = \"line\"\nto_m = [0.1, 0.0]\nspeed_m_per_s = 0.02\nstrokes = 20",
                );
                observer.slide(&cell, &task);
            }
        }
    });
}
