//! Time of `tangent report` on a recording of ten minutes: a UR5 at 125 Hz with four estimators and
//! the truth, and a sensor at 7 kHz. The recording is made first, of a simulated wipe.
//!
//! ```sh
//! cargo bench --bench report                      # reading it, and figures and page with it
//! KEEP=/tmp/ten.mcap cargo bench --bench report   # keeps the recording, for a profiler
//! ```

// The macro generates a function without documentation.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::{Path, PathBuf};

use criterion::{Criterion, criterion_group, criterion_main};
use tangent_recorder::Record;
use tangent_report::{Part, read};
use tangent_schemas::standard::{Header, Wrench, WrenchStamped};
use tangent_schemas::tangent::WrenchStatus;
use tangent_schemas::{Message, cdr};
use tangent_simulation::{AdmittanceScenario, evaluate_admittance_with, no_files};

#[path = "../tools/report/src/tests/tape.rs"]
mod tape;

use tape::Tape;

const ESTIMATORS: [&str; 4] = ["blend", "reactive", "quadratic", "gaussian_process"];
/// Sensor records per cycle of 8 ms, at 7 kHz.
const RECORDS: u32 = 56;

fn scenario() -> AdmittanceScenario {
    let text = include_str!("../scenarios/pipe_ideal.toml");
    let (rest, _) = text.split_once("[task.path]").unwrap();
    let line =
        "[task.path]\nkind = \"line\"\nto_m = [0.1, 0.0]\nspeed_m_per_s = 0.02\nstrokes = 118\n";
    let timeouts = "[task.timeouts]\ntask_s = 900.0\n";
    let changed = [String::from("duration_s=900.0")];
    AdmittanceScenario::parse(
        "ten_minutes",
        &format!("{rest}{line}{timeouts}"),
        &changed,
        &no_files,
    )
    .unwrap()
}

/// A raw record of the sensor, packed by the recorder.
fn put_raw(tape: &mut Tape, number: u32, stamp_ns: i64, bytes: &mut Vec<u8>) {
    let step = |k: u32| f64::from((number.wrapping_mul(k) >> 7) & 1023) * 0.001;
    let wrench = WrenchStamped {
        header: Header::new(stamp_ns, "sensor"),
        wrench: Wrench {
            force: (&nalgebra::Vector3::new(step(31), step(57), 3.0 + step(91))).into(),
            torque: (&nalgebra::Vector3::new(step(13), step(17), step(19))).into(),
        },
    };
    cdr::encode(&wrench, bytes).unwrap();
    tape.writer
        .write(&Record {
            publisher: [7; 16],
            topic: "/wrench/raw",
            type_name: WrenchStamped::NAME,
            definition: Some(&WrenchStamped::definition()),
            sequence: number + 1,
            log_time_ns: stamp_ns as u64 + 50_000,
            publish_time_ns: stamp_ns as u64,
            bytes,
        })
        .unwrap();
}

fn record(path: &Path) {
    let mut tape = Tape::create(path);
    let (mut number, mut bytes) = (0_u32, Vec::new());
    evaluate_admittance_with(&scenario(), |cycle| {
        number += 1;
        for k in 0..RECORDS {
            let at = tape.start_ns + i64::from(number) * 8_000_000 + i64::from(k) * 142_857;
            put_raw(&mut tape, number * RECORDS + k, at, &mut bytes);
        }
        tape.cycle(1000 + u64::from(number), 0.008, cycle);
        let at = tape.start_ns + (cycle.arm.time_s * 1e9) as i64;
        if let Some(estimate) = cycle.estimate {
            for name in &ESTIMATORS[1..] {
                tape.estimate(name, 1000 + u64::from(number), at, estimate);
            }
        }
        let status = WrenchStatus {
            header: Header::new(at, "sensor"),
            ..WrenchStatus::default()
        };
        tape.put("/wrench/status", at, &status);
    })
    .unwrap();
    assert!(number > 70_000, "{number} cycles");
    tape.writer.finish().unwrap();
}

fn report(c: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let path =
        std::env::var_os("KEEP").map_or_else(|| folder.path().join("ten.mcap"), PathBuf::from);
    record(&path);
    let files = [path];
    let mut group = c.benchmark_group("report on ten minutes");
    group.sample_size(10);
    group.bench_function("figures", |b| {
        b.iter(|| read(&files, Part::default(), false).unwrap().report.steps);
    });
    group.bench_function("figures and page", |b| {
        b.iter(|| read(&files, Part::default(), true).unwrap().report.steps);
    });
    group.finish();
}

criterion_group!(benches, report);
criterion_main!(benches);
