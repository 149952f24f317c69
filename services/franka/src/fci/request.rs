//! Requests of a client to the robot, over TCP.

use super::CodecError;
use super::frame::{Message, put_frame};
use super::wire::{Wire, exact, numbered, wire_struct};

numbered! {
    /// The commands of version 5.
    pub enum Command: u32 {
        /// Opens the session.
        Connect = 0,
        /// Starts a motion; answered twice, at its start and at its end.
        Move = 1,
        /// Stops the motion.
        StopMove = 2,
        /// Reads a virtual wall.
        GetCartesianLimit = 3,
        /// Thresholds of contacts and collisions.
        SetCollisionBehavior = 4,
        /// Stiffness of the robot's own joint controller.
        SetJointImpedance = 5,
        /// Stiffness of the robot's own Cartesian controller.
        SetCartesianImpedance = 6,
        /// Selects the axes that can be guided by hand.
        SetGuidingMode = 7,
        /// Stiffness frame on the end effector.
        SetEeToK = 8,
        /// Pose of the end effector in the nominal end effector's frame.
        SetNeToEe = 9,
        /// Load on the flange.
        SetLoad = 10,
        /// Cut-off frequencies.
        SetFilters = 11,
        /// Leaves a reflex.
        AutomaticErrorRecovery = 12,
        /// Sends compiled code of the robot's model.
        LoadModelLibrary = 13,
    }
}

numbered! {
    /// Controller that produces the torques of a motion.
    pub enum MoveController: u32 {
        /// The robot's joint controller.
        JointImpedance = 0,
        /// The robot's Cartesian controller.
        CartesianImpedance = 1,
        /// The client's torques.
        External = 2,
    }
}

numbered! {
    /// Type of a motion's commands.
    pub enum MoveGenerator: u32 {
        /// Joint positions.
        JointPosition = 0,
        /// Joint velocities.
        JointVelocity = 1,
        /// Poses.
        CartesianPosition = 2,
        /// Twists.
        CartesianVelocity = 3,
    }
}

wire_struct! {
    /// Largest deviation allowed in a motion.
    pub struct Deviation {
        /// Translation, m.
        pub translation_m: f64,
        /// Rotation, rad.
        pub rotation_rad: f64,
        /// Elbow, rad.
        pub elbow_rad: f64,
    }
}

impl Deviation {
    /// So large that it never ends a torque motion (libfranka's own default).
    pub const WIDE: Self = Self {
        translation_m: 10.0,
        rotation_rad: 3.12,
        elbow_rad: 2.0 * std::f64::consts::PI,
    };
}

wire_struct! {
    /// Thresholds of external torque (Nm per joint) and force (N, Nm in base axes). Between lower
    /// and upper threshold the robot reports a contact; beyond the upper one it reports a collision
    /// and stops. "Acceleration" applies while the motion accelerates, "nominal" otherwise.
    pub struct CollisionBehavior {
        /// Nm.
        pub lower_torque_acceleration: [f64; 7],
        /// Nm.
        pub upper_torque_acceleration: [f64; 7],
        /// Nm.
        pub lower_torque_nominal: [f64; 7],
        /// Nm.
        pub upper_torque_nominal: [f64; 7],
        /// N, Nm.
        pub lower_force_acceleration: [f64; 6],
        /// N, Nm.
        pub upper_force_acceleration: [f64; 6],
        /// N, Nm.
        pub lower_force_nominal: [f64; 6],
        /// N, Nm.
        pub upper_force_nominal: [f64; 6],
    }
}

wire_struct! {
    /// Load on the flange.
    pub struct Load {
        /// Mass, kg.
        pub mass_kg: f64,
        /// Centre of mass, flange axes, m.
        pub com_in_flange_m: [f64; 3],
        /// Inertia about the centre of mass, column by column, kg m².
        pub inertia_kg_m2: [f64; 9],
    }
}

wire_struct! {
    /// Cut-off frequencies, Hz.
    pub struct Filters {
        /// Joint positions.
        pub joint_position_hz: f64,
        /// Joint velocities.
        pub joint_velocity_hz: f64,
        /// Poses.
        pub cartesian_position_hz: f64,
        /// Twists.
        pub cartesian_velocity_hz: f64,
        /// Torques.
        pub controller_hz: f64,
    }
}

/// One request.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // few of them live, and none in a cycle
pub enum Request {
    /// Opens the session, with the protocol version and the port for the states.
    Connect {
        /// Protocol version.
        version: u16,
        /// UDP port for the states.
        udp_port: u16,
    },
    /// Starts a motion.
    Move {
        /// Controller that produces the torques.
        controller: MoveController,
        /// Type of the commands.
        generator: MoveGenerator,
        /// Largest deviation from the path.
        path_deviation: Deviation,
        /// Largest deviation from the goal.
        goal_deviation: Deviation,
    },
    /// Stops the motion.
    StopMove,
    /// Number of the wall.
    GetCartesianLimit(i32),
    /// Sets the thresholds of contacts and collisions.
    SetCollisionBehavior(CollisionBehavior),
    /// Nm/rad.
    SetJointImpedance([f64; 7]),
    /// N/m, Nm/rad.
    SetCartesianImpedance([f64; 6]),
    /// Axes that can be guided by hand, and whether the null space can.
    SetGuidingMode([bool; 6], bool),
    /// Column by column, m.
    SetEeToK([f64; 16]),
    /// Column by column, m.
    SetNeToEe([f64; 16]),
    /// Sets the load on the flange.
    SetLoad(Load),
    /// Sets the cut-off frequencies.
    SetFilters(Filters),
    /// Leaves a reflex.
    AutomaticErrorRecovery,
    /// Architecture and operating system of the requested code.
    LoadModelLibrary(u8, u8),
}

impl Request {
    /// Command of the request.
    pub fn command(&self) -> Command {
        match self {
            Self::Connect { .. } => Command::Connect,
            Self::Move { .. } => Command::Move,
            Self::StopMove => Command::StopMove,
            Self::GetCartesianLimit(_) => Command::GetCartesianLimit,
            Self::SetCollisionBehavior(_) => Command::SetCollisionBehavior,
            Self::SetJointImpedance(_) => Command::SetJointImpedance,
            Self::SetCartesianImpedance(_) => Command::SetCartesianImpedance,
            Self::SetGuidingMode(..) => Command::SetGuidingMode,
            Self::SetEeToK(_) => Command::SetEeToK,
            Self::SetNeToEe(_) => Command::SetNeToEe,
            Self::SetLoad(_) => Command::SetLoad,
            Self::SetFilters(_) => Command::SetFilters,
            Self::AutomaticErrorRecovery => Command::AutomaticErrorRecovery,
            Self::LoadModelLibrary(..) => Command::LoadModelLibrary,
        }
    }

    /// Encodes and appends the whole message; the reply has the same `id`.
    pub fn encode(&self, id: u32, out: &mut Vec<u8>) {
        put_frame(self.command().number(), id, out, |out| match self {
            Self::Connect { version, udp_port } => [*version, *udp_port].put(out),
            Self::Move {
                controller,
                generator,
                path_deviation,
                goal_deviation,
            } => {
                [controller.number(), generator.number()].put(out);
                [*path_deviation, *goal_deviation].put(out);
            }
            Self::StopMove | Self::AutomaticErrorRecovery => {}
            Self::GetCartesianLimit(wall) => wall.put(out),
            Self::SetCollisionBehavior(behavior) => behavior.put(out),
            Self::SetJointImpedance(stiffness) => stiffness.put(out),
            Self::SetCartesianImpedance(stiffness) => stiffness.put(out),
            Self::SetGuidingMode(axes, null_space) => {
                axes.put(out);
                null_space.put(out);
            }
            Self::SetEeToK(pose) | Self::SetNeToEe(pose) => pose.put(out),
            Self::SetLoad(load) => load.put(out),
            Self::SetFilters(filters) => filters.put(out),
            Self::LoadModelLibrary(architecture, system) => [*architecture, *system].put(out),
        });
    }

    /// Decodes a message.
    ///
    /// # Errors
    /// The command or a mode is unknown, or the payload has the wrong length.
    pub fn decode(message: &Message<'_>) -> Result<Self, CodecError> {
        let unknown = |what, got| CodecError::Unknown { what, got };
        let command = Command::from_number(message.command)
            .ok_or_else(|| unknown("command", message.command))?;
        let payload = message.payload;
        Ok(match command {
            Command::Connect => {
                let [version, udp_port] = exact("a connect request", payload)?;
                Self::Connect { version, udp_port }
            }
            Command::Move => {
                let request: MovePayload = exact("a move request", payload)?;
                Self::Move {
                    controller: MoveController::from_number(request.controller)
                        .ok_or_else(|| unknown("controller mode", request.controller))?,
                    generator: MoveGenerator::from_number(request.generator)
                        .ok_or_else(|| unknown("motion generator mode", request.generator))?,
                    path_deviation: request.path_deviation,
                    goal_deviation: request.goal_deviation,
                }
            }
            Command::StopMove => {
                let [] = exact::<[u8; 0]>("a stop request", payload)?;
                Self::StopMove
            }
            Command::GetCartesianLimit => {
                Self::GetCartesianLimit(exact("a request for a wall", payload)?)
            }
            Command::SetCollisionBehavior => {
                Self::SetCollisionBehavior(exact("collision thresholds", payload)?)
            }
            Command::SetJointImpedance => {
                Self::SetJointImpedance(exact("joint stiffnesses", payload)?)
            }
            Command::SetCartesianImpedance => {
                Self::SetCartesianImpedance(exact("Cartesian stiffnesses", payload)?)
            }
            Command::SetGuidingMode => {
                let [x, y, z, rx, ry, rz, null_space] = exact("a guiding mode", payload)?;
                Self::SetGuidingMode([x, y, z, rx, ry, rz], null_space)
            }
            Command::SetEeToK => Self::SetEeToK(exact("a stiffness frame", payload)?),
            Command::SetNeToEe => Self::SetNeToEe(exact("an end effector's frame", payload)?),
            Command::SetLoad => Self::SetLoad(exact("a load", payload)?),
            Command::SetFilters => Self::SetFilters(exact("filters", payload)?),
            Command::AutomaticErrorRecovery => {
                let [] = exact::<[u8; 0]>("a recovery request", payload)?;
                Self::AutomaticErrorRecovery
            }
            Command::LoadModelLibrary => {
                let [architecture, system] = exact("a request for the model", payload)?;
                Self::LoadModelLibrary(architecture, system)
            }
        })
    }
}

wire_struct! {
    /// Payload of a move request.
    pub struct MovePayload {
        /// Number of the [`MoveController`].
        pub controller: u32,
        /// Number of the [`MoveGenerator`].
        pub generator: u32,
        /// Largest deviation from the path.
        pub path_deviation: Deviation,
        /// Largest deviation from the goal.
        pub goal_deviation: Deviation,
    }
}
