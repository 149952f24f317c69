//! A closed-loop run written as a live system would record it. For tests, and for the benchmark of
//! the report.

use std::path::Path;

use tangent_estimation::NormalEstimate as Estimate;
use tangent_recorder::{Record, RecordingWriter};
use tangent_schemas::convert::{cut, joint_array};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmState, ContactTruth, ControlState, NormalEstimate};
use tangent_schemas::{Message, cdr};
use tangent_simulation::AdmittanceCycle;

/// Start of the run, ns since the Unix epoch.
pub const START_NS: i64 = 1_795_260_245_123_456_789;

/// A recording.
pub struct Tape {
    /// The file.
    pub writer: RecordingWriter,
    sequence: u32,
    /// Start of the run on tape, ns since the Unix epoch.
    pub start_ns: i64,
    /// Number of tasks before it.
    pub tasks_before: u64,
}

impl Tape {
    /// Creates the file.
    pub fn create(path: &Path) -> Self {
        let mut writer = RecordingWriter::create(path).unwrap();
        let facts = [
            ("scenario", "pipe_ideal"),
            ("controller", "default"),
            ("seed", "1"),
            ("version", "0.1.0"),
        ];
        let facts = facts.map(|(n, v)| (n.to_owned(), v.to_owned()));
        writer.metadata("tangent", facts.into()).unwrap();
        writer
            .attach("task-1.toml", "name = \"wipe <a> pipe\"", 1)
            .unwrap();
        Self {
            writer,
            sequence: 0,
            start_ns: START_NS,
            tasks_before: 0,
        }
    }

    /// Writes one message.
    pub fn put<M: Message>(&mut self, topic: &str, stamp_ns: i64, message: &M) {
        let mut bytes = Vec::new();
        cdr::encode(message, &mut bytes).unwrap();
        self.sequence += 1;
        self.writer
            .write(&Record {
                publisher: [0; 16],
                topic,
                type_name: M::NAME,
                definition: Some(&M::definition()),
                sequence: self.sequence,
                log_time_ns: stamp_ns as u64,
                publish_time_ns: stamp_ns as u64,
                bytes: &bytes,
            })
            .unwrap();
    }

    /// Writes the messages of one cycle.
    pub fn cycle(&mut self, number: u64, period_s: f64, cycle: &AdmittanceCycle<'_>) {
        let (arm, input, output, truth) = (cycle.arm, cycle.input, cycle.output, cycle.truth);
        let at = self.start_ns + (arm.time_s * 1e9).round() as i64;
        let header = || Header::new(at, "base");
        self.put(
            "/arm/state",
            at,
            &ArmState {
                header: header(),
                cycle: number,
                period_s,
                q: joint_array(&arm.q),
                qd: joint_array(&arm.qd),
                tool_pose: (&input.base_from_tool).into(),
                tool_twist: (&input.twist).into(),
                packet_to_command_s: 100e-6 + 1e-9 * number as f64,
                ..ArmState::default()
            },
        );
        if let Some(estimate) = cycle.estimate {
            self.estimate("blend", number, at, estimate);
        }
        self.put(
            "/control/state",
            at,
            &ControlState {
                header: header(),
                cycle: number,
                phase: output.phase as u8,
                phase_text: cut(output.phase.name()),
                task: cut("wipe a pipe"),
                activation: output.activation + self.tasks_before,
                estimator: cut("blend"),
                normal: (&output.normal).into(),
                force_reference_n: output.force_reference_n,
                force_n: output.force_n.unwrap_or(f64::NAN),
                path_reference: (&output.path_reference).into(),
                path_error_m: output.path_error_m,
                path_progress: output.path_progress,
                wrench_age_s: output.wrench_age_s,
                estimate_age_s: output.estimate_age_s,
                manipulability: output.manipulability,
                fault: output.fault.map(|f| f.text()).unwrap_or_default(),
                ..ControlState::default()
            },
        );
        // The simulator's clock differs a little from the bridge's.
        self.put(
            "/truth/contact",
            at + 150_000,
            &ContactTruth {
                header: Header::new(at + 150_000, "base"),
                point: (&truth.point).into(),
                normal: (&truth.normal).into(),
                in_contact: truth.in_contact,
                wrench: (&truth.wrench).into(),
                tool_pose: (&truth.base_from_tool).into(),
                ..ContactTruth::default()
            },
        );
    }

    /// Writes an estimate of one cycle.
    pub fn estimate(&mut self, name: &str, number: u64, at_ns: i64, estimate: &Estimate) {
        let mut covariance = [0.0; 9];
        for (i, value) in covariance.iter_mut().enumerate() {
            *value = estimate.covariance[(i / 3, i % 3)];
        }
        let message = NormalEstimate {
            header: Header::new(at_ns, "base"),
            cycle: number,
            estimator: cut(name),
            normal: (&estimate.normal).into(),
            covariance,
            validity: u8::from(!estimate.validity.is_valid()),
            ..NormalEstimate::default()
        };
        self.put(&format!("/estimate/{name}/normal"), at_ns, &message);
    }
}
