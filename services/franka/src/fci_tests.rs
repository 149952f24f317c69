//! The codec against the independent client's own types, in both directions, and against arbitrary
//! bytes.

use franka::wire::robot::v5;
use franka::wire::{ROBOT_COMMAND_PORT, f64s_to_f64, f64s_to_wire};
use proptest::prelude::*;
use zerocopy::{FromBytes, IntoBytes};

use crate::fci::*;

fn message(bytes: &[u8]) -> (u32, u32, Vec<u8>) {
    let mut framer = Framer::new();
    framer.push(bytes);
    let message = framer.next_message().unwrap().unwrap();
    assert_eq!(bytes.len(), HEADER_BYTES + message.payload.len());
    (message.command, message.id, message.payload.to_vec())
}

fn encoded(request: &Request) -> (u32, Vec<u8>) {
    let mut bytes = Vec::new();
    request.encode(77, &mut bytes);
    let (command, id, payload) = message(&bytes);
    assert_eq!(id, 77);
    let whole = Message {
        command,
        id,
        payload: &payload,
    };
    assert_eq!(Request::decode(&whole).as_ref(), Ok(request));
    (command, payload)
}

fn ramp<const N: usize>(from: f64) -> [f64; N] {
    std::array::from_fn(|i| from + 0.25 * i as f64)
}

#[test]
fn numbers_are_the_other_clients() {
    assert_eq!(VERSION, v5::ROBOT_VERSION);
    assert_eq!(PORT, ROBOT_COMMAND_PORT);
    assert_eq!(ERROR_NAMES, franka::ERROR_NAMES);
    assert_eq!(STATE_BYTES, size_of::<v5::RobotState>());
    assert_eq!(COMMAND_BYTES, size_of::<v5::RobotCommand>());
    for number in 0..=30u32 {
        let names = |ours: Option<String>, theirs: Option<String>| {
            assert_eq!(
                ours.is_some(),
                theirs.is_some(),
                "{number}: {ours:?} {theirs:?}"
            );
        };
        let byte = number as u8;
        names(
            Command::from_number(number).map(|x| format!("{x:?}")),
            v5::Command::from_u32(number).map(|x| format!("{x:?}")),
        );
        names(
            MoveStatus::from_number(byte).map(|x| format!("{x:?}")),
            v5::MoveStatus::from_u8(byte).map(|x| format!("{x:?}")),
        );
        names(
            RobotMode::from_number(byte).map(|x| format!("{x:?}")),
            v5::RobotMode::from_u8(byte).map(|x| format!("{x:?}")),
        );
        names(
            StopStatus::from_number(byte).map(|x| format!("{x:?}")),
            v5::StopMoveStatus::from_u8(byte).map(|x| format!("{x:?}")),
        );
        names(
            RecoveryStatus::from_number(byte).map(|x| format!("{x:?}")),
            v5::AutomaticErrorRecoveryStatus::from_u8(byte).map(|x| format!("{x:?}")),
        );
    }
    for (ours, theirs) in [
        (
            MoveStatus::ReflexAborted.number(),
            v5::MoveStatus::ReflexAborted.to_u8(),
        ),
        (
            MoveStatus::NotPossible.number(),
            v5::MoveStatus::CommandNotPossibleRejected.to_u8(),
        ),
        (
            RecoveryStatus::ManualRecoveryRequired.number(),
            v5::AutomaticErrorRecoveryStatus::ManualErrorRecoveryRequiredRejected.to_u8(),
        ),
        (
            RobotMode::UserStopped.number(),
            v5::RobotMode::UserStopped.to_u8(),
        ),
        (
            MotionMode::JointVelocity.number(),
            v5::MotionGeneratorMode::JointVelocity.to_u8(),
        ),
        (
            ControllerMode::External.number(),
            v5::ControllerMode::ExternalController.to_u8(),
        ),
    ] {
        assert_eq!(ours, theirs);
    }
}

#[test]
fn requests_are_the_other_clients_bytes() {
    let deviation = |x| Deviation {
        translation_m: x,
        rotation_rad: x + 1.0,
        elbow_rad: x + 2.0,
    };
    let theirs_deviation = |x: f64| v5::Deviation::new(x, x + 1.0, x + 2.0);
    let check = |request: Request, command: v5::Command, payload: &[u8]| {
        let (number, bytes) = encoded(&request);
        assert_eq!(
            (number, &bytes[..]),
            (command.to_u32(), payload),
            "{request:?}"
        );
    };
    check(
        Request::Connect {
            version: 5,
            udp_port: 40_000,
        },
        v5::Command::Connect,
        v5::ConnectRequest::new(5, 40_000).as_bytes(),
    );
    check(
        Request::Move {
            controller: MoveController::External,
            generator: MoveGenerator::JointVelocity,
            path_deviation: deviation(0.5),
            goal_deviation: deviation(7.0),
        },
        v5::Command::Move,
        v5::MoveRequest::new(
            v5::MoveControllerMode::ExternalController,
            v5::MoveMotionGeneratorMode::JointVelocity,
            theirs_deviation(0.5),
            theirs_deviation(7.0),
        )
        .as_bytes(),
    );
    check(Request::StopMove, v5::Command::StopMove, &[]);
    check(
        Request::AutomaticErrorRecovery,
        v5::Command::AutomaticErrorRecovery,
        &[],
    );
    let behavior = CollisionBehavior {
        lower_torque_acceleration: ramp(1.0),
        upper_torque_acceleration: ramp(10.0),
        lower_torque_nominal: ramp(20.0),
        upper_torque_nominal: ramp(30.0),
        lower_force_acceleration: ramp(40.0),
        upper_force_acceleration: ramp(50.0),
        lower_force_nominal: ramp(60.0),
        upper_force_nominal: ramp(70.0),
    };
    check(
        Request::SetCollisionBehavior(behavior),
        v5::Command::SetCollisionBehavior,
        v5::SetCollisionBehaviorRequest::new(
            &ramp(1.0),
            &ramp(10.0),
            &ramp(20.0),
            &ramp(30.0),
            &ramp(40.0),
            &ramp(50.0),
            &ramp(60.0),
            &ramp(70.0),
        )
        .as_bytes(),
    );
    check(
        Request::SetJointImpedance(ramp(3.0)),
        v5::Command::SetJointImpedance,
        v5::SetJointImpedanceRequest::new(&ramp(3.0)).as_bytes(),
    );
    check(
        Request::SetCartesianImpedance(ramp(3.0)),
        v5::Command::SetCartesianImpedance,
        v5::SetCartesianImpedanceRequest::new(&ramp(3.0)).as_bytes(),
    );
    check(
        Request::SetGuidingMode([true, false, true, false, false, true], true),
        v5::Command::SetGuidingMode,
        v5::SetGuidingModeRequest::new(&[true, false, true, false, false, true], true).as_bytes(),
    );
    check(
        Request::SetEeToK(ramp(0.0)),
        v5::Command::SetEEToK,
        v5::SetEEToKRequest::new(&ramp(0.0)).as_bytes(),
    );
    check(
        Request::SetNeToEe(ramp(0.0)),
        v5::Command::SetNEToEE,
        v5::SetNEToEERequest::new(&ramp(0.0)).as_bytes(),
    );
    check(
        Request::SetLoad(Load {
            mass_kg: 0.7,
            com_in_flange_m: ramp(0.1),
            inertia_kg_m2: ramp(0.01),
        }),
        v5::Command::SetLoad,
        v5::SetLoadRequest::new(0.7, &ramp(0.1), &ramp(0.01)).as_bytes(),
    );
    check(
        Request::SetFilters(Filters {
            joint_position_hz: 1.0,
            joint_velocity_hz: 2.0,
            cartesian_position_hz: 3.0,
            cartesian_velocity_hz: 4.0,
            controller_hz: 5.0,
        }),
        v5::Command::SetFilters,
        v5::SetFiltersRequest::new(1.0, 2.0, 3.0, 4.0, 5.0).as_bytes(),
    );
    check(
        Request::GetCartesianLimit(-3),
        v5::Command::GetCartesianLimit,
        v5::GetCartesianLimitRequest::new(-3).as_bytes(),
    );
    check(
        Request::LoadModelLibrary(0, 1),
        v5::Command::LoadModelLibrary,
        v5::LoadModelLibraryRequest::new(
            v5::LoadModelLibraryArchitecture::X64,
            v5::LoadModelLibrarySystem::Windows,
        )
        .as_bytes(),
    );
}

/// Every field of a state has its own value, so that an exchange of two fields is detected.
#[test]
fn a_state_is_read_as_the_other_client_writes_it() {
    let mut bytes = [0u8; STATE_BYTES];
    bytes[..8].copy_from_slice(&123_456_789u64.to_le_bytes());
    for (i, chunk) in bytes[8..8 + 284 * 8].chunks_exact_mut(8).enumerate() {
        chunk.copy_from_slice(&(1.0 + i as f64).to_le_bytes());
    }
    let modes = 8 + 284 * 8;
    bytes[modes] = 2;
    bytes[modes + 1] = 2;
    bytes[modes + 2 + 25] = 1;
    bytes[modes + 2 + 41 + 6] = 1;
    bytes[modes + 84] = 4;
    bytes[modes + 85..].copy_from_slice(&0.75f64.to_le_bytes());
    let theirs = v5::RobotState::read_from_bytes(&bytes).unwrap();
    let ours = RobotState::decode(&bytes).unwrap();
    assert_eq!(ours.message_id, theirs.message_id.get());
    macro_rules! same {
        ($($ours:ident $theirs:ident),* $(,)?) => {$(
            assert_eq!(ours.$ours, f64s_to_f64(&{ theirs.$theirs }), stringify!($ours));
        )*};
    }
    same!(
        o_t_ee O_T_EE, o_t_ee_d O_T_EE_d, f_t_ee F_T_EE, ee_t_k EE_T_K, f_t_ne F_T_NE, ne_t_ee NE_T_EE,
        i_ee I_ee, f_x_cee F_x_Cee, i_load I_load, f_x_cload F_x_Cload, elbow elbow, elbow_d elbow_d,
        tau_j tau_J, tau_j_d tau_J_d, dtau_j dtau_J, q q, q_d q_d, dq dq, dq_d dq_d, ddq_d ddq_d,
        joint_contact joint_contact, cartesian_contact cartesian_contact, joint_collision joint_collision,
        cartesian_collision cartesian_collision, tau_ext_hat_filtered tau_ext_hat_filtered,
        o_f_ext_hat_k O_F_ext_hat_K, k_f_ext_hat_k K_F_ext_hat_K, o_dp_ee_d O_dP_EE_d, o_ddp_o O_ddP_O,
        elbow_c elbow_c, delbow_c delbow_c, ddelbow_c ddelbow_c, o_t_ee_c O_T_EE_c, o_dp_ee_c O_dP_EE_c,
        o_ddp_ee_c O_ddP_EE_c, theta theta, dtheta dtheta,
    );
    assert_eq!(ours.m_ee, { theirs.m_ee }.get());
    assert_eq!(ours.m_load, { theirs.m_load }.get());
    assert_eq!(ours.motion_generator_mode, theirs.motion_generator_mode);
    assert_eq!(ours.controller_mode, theirs.controller_mode);
    assert_eq!(
        ours.errors,
        ErrorFlags::only(ErrorFlags::COMMUNICATION_CONSTRAINTS)
    );
    assert_eq!(
        ours.errors.to_string(),
        "communication_constraints_violation"
    );
    assert_eq!(
        ours.reflex_reason,
        ErrorFlags::only(ErrorFlags::JOINT_REFLEX)
    );
    assert_eq!(ours.mode(), RobotMode::Reflex);
    assert_eq!(ours.control_command_success_rate, 0.75);
    let mut again = Vec::new();
    ours.encode(&mut again);
    assert_eq!(again, bytes);
}

#[test]
fn an_answer_is_what_the_other_client_reads_and_writes() {
    let answer = RobotCommand {
        message_id: 99,
        q_c: ramp(1.0),
        dq_c: ramp(2.0),
        o_t_ee_c: ramp(3.0),
        o_dp_ee_c: ramp(4.0),
        elbow_c: ramp(5.0),
        valid_elbow: false,
        motion_finished: true,
        tau_j_d: ramp(6.0),
    };
    let mut bytes = Vec::new();
    answer.encode(&mut bytes);
    let theirs = v5::RobotCommand {
        message_id: 99.into(),
        motion: v5::MotionGeneratorCommand {
            q_c: f64s_to_wire(&ramp(1.0)),
            dq_c: f64s_to_wire(&ramp(2.0)),
            O_T_EE_c: f64s_to_wire(&ramp(3.0)),
            O_dP_EE_c: f64s_to_wire(&ramp(4.0)),
            elbow_c: f64s_to_wire(&ramp(5.0)),
            valid_elbow: 0,
            motion_generation_finished: 1,
        },
        control: v5::ControllerCommand {
            tau_J_d: f64s_to_wire(&ramp(6.0)),
        },
    };
    assert_eq!(bytes, theirs.as_bytes());
    assert_eq!(RobotCommand::decode(theirs.as_bytes()), Ok(answer));
}

#[test]
fn replies_come_back_as_they_were_and_padding_is_let_be() {
    use Command as C;
    let replies = [
        (
            C::Connect,
            ReplyBody::Connect(ConnectStatus::IncompatibleVersion, 5),
        ),
        (C::Move, ReplyBody::Move(MoveStatus::MotionStarted)),
        (C::StopMove, ReplyBody::Stop(StopStatus::Success)),
        (C::SetLoad, ReplyBody::Setter(SetterStatus::InvalidArgument)),
        (
            C::GetCartesianLimit,
            ReplyBody::Wall(SetterStatus::Success, ramp(1.0), ramp(2.0), true),
        ),
        (
            C::AutomaticErrorRecovery,
            ReplyBody::Recovery(RecoveryStatus::ManualRecoveryRequired),
        ),
        (C::LoadModelLibrary, ReplyBody::Model(false)),
    ];
    for (command, body) in replies {
        let reply = Reply {
            command,
            id: 5,
            body,
        };
        let mut bytes = Vec::new();
        reply.encode(&mut bytes);
        let (number, id, mut payload) = message(&bytes);
        payload.extend([0xAA; 3]);
        let padded = Message {
            command: number,
            id,
            payload: &payload,
        };
        assert_eq!(Reply::decode(&padded), Ok(reply));
    }
}

proptest! {
    /// Arbitrary bytes are a message, an error, or incomplete; never a panic, and never more than
    /// was sent.
    #[test]
    fn hostile_bytes_are_refused(chunks in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..200), 0..20)) {
        let mut framer = Framer::new();
        let (mut given, mut taken) = (0, 0);
        'chunks: for chunk in &chunks {
            given += chunk.len();
            framer.push(chunk);
            loop {
                match framer.next_message() {
                    Ok(Some(message)) => {
                        taken += HEADER_BYTES + message.payload.len();
                        let _ = Request::decode(&message);
                        let _ = Reply::decode(&message);
                    }
                    Ok(None) => break,
                    Err(_) => break 'chunks,
                }
            }
        }
        prop_assert!(taken <= given);
    }

    /// Payloads of every command and any content, with a correct header.
    #[test]
    fn hostile_payloads_are_refused(command in 0u32..16, payload in proptest::collection::vec(any::<u8>(), 0..450)) {
        let message = Message { command, id: 1, payload: &payload };
        if let Ok(request) = Request::decode(&message) {
            let mut bytes = Vec::new();
            request.encode(1, &mut bytes);
            prop_assert_eq!(bytes.len(), HEADER_BYTES + payload.len());
        }
        let _ = Reply::decode(&message);
    }

    #[test]
    fn datagrams_of_another_length_are_refused(datagram in proptest::collection::vec(any::<u8>(), 0..3000)) {
        prop_assert_eq!(RobotState::decode(&datagram).is_ok(), datagram.len() == STATE_BYTES);
        prop_assert_eq!(RobotCommand::decode(&datagram).is_ok(), datagram.len() == COMMAND_BYTES);
    }

    #[test]
    fn a_stream_is_cut_the_same_wherever_it_is_broken(cut in 0usize..500) {
        let mut bytes = Vec::new();
        let load = Request::SetJointImpedance([3000.0; 7]);
        for id in 0..4 {
            load.encode(id, &mut bytes);
            Request::StopMove.encode(id + 100, &mut bytes);
        }
        let cut = cut.min(bytes.len());
        let mut framer = Framer::new();
        let mut ids = Vec::new();
        for part in [&bytes[..cut], &bytes[cut..]] {
            framer.push(part);
            while let Some(message) = framer.next_message().unwrap() {
                ids.push(message.id);
            }
        }
        prop_assert_eq!(ids, [0, 100, 1, 101, 2, 102, 3, 103]);
    }
}
