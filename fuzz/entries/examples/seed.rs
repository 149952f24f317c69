//! Writes the initial inputs of every corpus: data that correct devices, services and users send.
//!
//! `cargo run --release -p tangent-fuzz --example seed`

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use tangent_franka::fci;
use tangent_mechanics::ModelData;
use tangent_netft::codec::{Command, Record, Request as RdtRequest, Status};
use tangent_recorder::{Record as Recorded, RecordingWriter};
use tangent_rtde::codec::{
    ControllerVersion, Protocol, Recipe, Reply, Request, Series, Slot, TextLevel, TextMessage,
};
use tangent_rtde::program::{ProgramConfig, RegisterMap};
use tangent_rtde::sample::{input_types, output_names, output_types};
use tangent_schemas::cdr::encode;
use tangent_schemas::{Message, definition, standard, tangent};

fn main() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus");
    let put = |target: &str, name: &str, bytes: &[u8]| {
        let folder = corpus.join(target);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(name), bytes).unwrap();
    };
    rtde(&put);
    devices(&put);
    franka(&put);
    bus(&put);
    files(&put);
}

type Put<'a> = &'a dyn Fn(&str, &str, &[u8]);

fn rtde(put: Put<'_>) {
    let registers = RegisterMap::new(24).unwrap();
    let names = output_names(&registers);
    let text = TextMessage {
        message: "hello".into(),
        source: "robot".into(),
        level: TextLevel::Info,
    };
    let mut requests = Vec::new();
    for request in [
        Request::ProtocolVersion(2),
        Request::ControllerVersion,
        Request::SetupOutputs {
            frequency_hz: Some(125.0),
            names: names.clone(),
        },
        Request::SetupInputs {
            names: registers.input_names(),
        },
        Request::Start,
        Request::Text(text.clone()),
        Request::Pause,
    ] {
        request.encode(Protocol::V2, &mut requests).unwrap();
    }
    put("rtde_packages", "requests", &requests);
    let types = output_types();
    let recipe = Recipe::new(1, types.clone()).unwrap();
    let values: Vec<_> = types.iter().map(|t| t.zero()).collect();
    let mut data = Vec::new();
    recipe.encode(&values, &mut data).unwrap();
    let slots = |types: Vec<_>| types.into_iter().map(Slot::Type).collect::<Vec<_>>();
    let mut replies = Vec::new();
    for reply in [
        Reply::ProtocolVersion { accepted: true },
        Reply::ControllerVersion(ControllerVersion::new(3, 15, 8)),
        Reply::SetupInputs {
            recipe_id: 1,
            slots: slots(input_types()),
        },
        Reply::SetupOutputs {
            recipe_id: Some(1),
            slots: slots(types),
        },
        Reply::Start { accepted: true },
        Reply::Data(&data),
        Reply::Data(&data),
        Reply::Text(text),
        Reply::Pause { accepted: true },
    ] {
        reply.encode(Protocol::V2, &mut replies).unwrap();
    }
    put("rtde_packages", "replies", &replies);
    put("rtde_bridge", "replies", &replies);
    let lines = "Connected: Universal Robots Dashboard Server\nRobotmode: RUNNING\nURSoftware 3.15.8.106339 (Mar 04 2022)\nUR5e\nUR5\n";
    put("dashboard_lines", "lines", lines.as_bytes());
    let mut primary =
        tangent_simulated_ur::primary::version(tangent_simulated_ur::Flavour::Cb3, 40.0);
    primary.extend_from_slice(&[0, 0, 0, 5, 16, 0, 0, 0, 4]);
    put("primary_stream", "version", &primary);
    let program = ProgramConfig {
        registers,
        session: 123_456_789,
        series: Series::Cb3,
        speed_max_rad_per_s: 1.0,
        acceleration_max_rad_per_s2: 8.0,
        stop_deceleration_rad_per_s2: 4.0,
        watchdog: true,
    };
    put("urscript", "bridge", program.render().unwrap().as_bytes());
    put(
        "urscript",
        "thread",
        b"def go():\n global x = [1, 2.5, True]\n thread t():\n  while True:\n   sync()\n  end\n end\n h = run t()\n movej([0,0,0,0,0,0], a=1.4, v=1.05)\n x[0] = norm(pose_trans(p[0,0,1,0,0,0], p[1,0,0,0,0,0]))\n if x[0] > 2 and not x[2]:\n  textmsg(\"big\", x)\n else:\n  halt\n end\n kill h\nend\n",
    );
}

fn devices(put: Put<'_>) {
    let mut datagrams = Vec::new();
    for n in 0..6_u32 {
        let record = Record {
            rdt_sequence: n + 1,
            ft_sequence: 100 + n,
            status: Status(if n == 4 {
                Status::SUMMARY | Status::SATURATION
            } else {
                0
            }),
            counts: [n as i32, -2, 3_000_000, -4, 5, i32::MIN],
        };
        datagrams.extend_from_slice(&record.to_bytes());
    }
    put("rdt_records", "records", &datagrams);
    let request = RdtRequest {
        command: Command::RealTime,
        sample_count: 0,
    };
    put("rdt_records", "request", &request.to_bytes());
    let xml = "<?xml version=\"1.0\"?><netft><prodname>Net F/T</prodname><setserial>FT12345</setserial><cfgcpf>1000000</cfgcpf><cfgcpt>2000000</cfgcpt><scfgfu>N</scfgfu><scfgtu>N-m</scfgtu><comrdtrate>7000</comrdtrate><comrdtbsiz>7</comrdtbsiz><cfgtfx>0;0;0;0;0;0</cfgtfx><setuserfilter>0</setuserfilter></netft>";
    put("box_xml", "plain", xml.as_bytes());
    let pounds = xml.replace(">N<", ">lbf<").replace(">N-m<", ">lbf-in<");
    put("box_xml", "pounds", pounds.as_bytes());
    let tiny = xml.replace("<comrdtrate>7000<", "<comrdtrate>1e-30<");
    put("box_xml", "rate_of_1e-30", tiny.as_bytes());
    for (name, kind, pixel) in [("millimetres", 0_u8, 2_usize), ("metres", 1, 4)] {
        let (width, height) = (40_usize, 30_usize);
        let mut image = vec![width as u8, height as u8, (width * pixel) as u8, 0, kind];
        for i in 0..width * height {
            let z = 0.4 + 0.001 * (i % width) as f32;
            match pixel {
                2 => image.extend_from_slice(&((z * 1000.0) as u16).to_le_bytes()),
                _ => image.extend_from_slice(&z.to_le_bytes()),
            }
        }
        put("depth_image", name, &image);
    }
}

fn franka(put: Put<'_>) {
    let mut stream = Vec::new();
    for (id, request) in [
        fci::Request::Connect {
            version: fci::VERSION,
            udp_port: 4000,
        },
        fci::Request::StopMove,
        fci::Request::SetJointImpedance([100.0; 7]),
        fci::Request::SetGuidingMode([true; 6], false),
        fci::Request::AutomaticErrorRecovery,
    ]
    .into_iter()
    .enumerate()
    {
        request.encode(id as u32, &mut stream);
    }
    put("fci_stream", "requests", &stream);
    let mut stream = Vec::new();
    for (command, body) in [
        (
            fci::Command::Connect,
            fci::ReplyBody::Connect(fci::ConnectStatus::Success, fci::VERSION),
        ),
        (
            fci::Command::SetLoad,
            fci::ReplyBody::Setter(fci::SetterStatus::Success),
        ),
        (fci::Command::LoadModelLibrary, fci::ReplyBody::Model(false)),
    ] {
        fci::Reply {
            command,
            id: 7,
            body,
        }
        .encode(&mut stream);
    }
    put("fci_stream", "replies", &stream);
    let mut datagram = Vec::new();
    fci::RobotState::default().encode(&mut datagram);
    put("fci_datagrams", "state", &datagram);
    datagram.clear();
    fci::RobotCommand::torque(5, [0.5; 7], false).encode(&mut datagram);
    put("fci_datagrams", "command", &datagram);
}

fn message<M: Message + Default>(put: Put<'_>, kind: u8) {
    let mut bytes = Vec::new();
    encode(&M::default(), &mut bytes).unwrap();
    bytes.insert(0, kind);
    put("cdr", &M::NAME.replace('/', "_"), &bytes);
}

fn bus(put: Put<'_>) {
    message::<tangent::ArmState>(put, 0);
    message::<tangent::ArmCommand>(put, 1);
    message::<tangent::WrenchStatus>(put, 2);
    message::<tangent::NormalEstimate>(put, 3);
    message::<tangent::FeatureArray>(put, 4);
    message::<tangent::ObjectEstimate>(put, 5);
    message::<tangent::SurfaceSegment>(put, 6);
    message::<tangent::SurfaceAhead>(put, 7);
    message::<tangent::ControlState>(put, 8);
    message::<tangent::ShapingState>(put, 9);
    message::<tangent::Health>(put, 10);
    message::<tangent::ContactTruth>(put, 11);
    message::<tangent::Request>(put, 12);
    message::<tangent::Answer>(put, 13);
    message::<standard::WrenchStamped>(put, 14);
    message::<standard::PoseWithCovarianceStamped>(put, 15);
    message::<standard::Image>(put, 16);
    message::<standard::CameraInfo>(put, 17);
    message::<standard::MarkerArray>(put, 18);
    message::<standard::TFMessage>(put, 19);
    message::<tangent::OperatorCommand>(put, 20);
    message::<tangent::CoverageState>(put, 21);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seed.mcap");
    let mut writer = RecordingWriter::create(&path).unwrap();
    let mut bytes = Vec::new();
    encode(&tangent::Answer::default(), &mut bytes).unwrap();
    let text = definition::definition(tangent::Answer::NAME);
    writer
        .attach("cell.toml", "[cell]\nname = \"cell1\"\n", 1)
        .unwrap();
    for sequence in 0..5 {
        let record = Recorded {
            topic: "/answer",
            publisher: [0; 16],
            type_name: tangent::Answer::NAME,
            definition: text.as_deref(),
            sequence,
            log_time_ns: u64::from(sequence),
            publish_time_ns: u64::from(sequence),
            bytes: &bytes,
        };
        writer.write(&record).unwrap();
    }
    writer.finish().unwrap();
    let whole = fs::read(&path).unwrap();
    put("recording", "whole", &whole);
    put("recording", "torn", &whole[..whole.len() / 2]);
}

fn files(put: Put<'_>) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    for (target, name, path) in [
        ("cell_file", "cell", "deploy/cell.toml"),
        ("cell_file", "franka", "deploy/cell.franka.toml"),
        ("cell_file", "secured", "deploy/cell.compose.tls.toml"),
        ("task_file", "circle", "deploy/tasks/circle.toml"),
        ("task_file", "raster", "deploy/tasks/raster.toml"),
        ("task_file", "waypoints", "deploy/tasks/waypoints.toml"),
        (
            "scenario_file",
            "pipe_realistic",
            "scenarios/pipe_realistic.toml",
        ),
        ("scenario_file", "torus", "scenarios/torus.toml"),
    ] {
        put(target, name, &fs::read(root.join(path)).unwrap());
    }
    put(
        "model_file",
        "ur5",
        ModelData::builtin_text("ur5").unwrap().as_bytes(),
    );
}
