//! The ranges of the suite. `docs/simulation.md` gives the source of each that belongs to hardware.
//!
//! A pair is the lowest and the highest value; draws are uniform between them unless the name of
//! the range ends in `_LOG`: those are uniform in the logarithm.

/// Angle of the tool off the normal at touchdown, rad: 0 to 25°.
pub const LANDED_RAD: (f64, f64) = (0.0, 0.436_332_312_998_582_4);
/// Stiffness of the contact, N/m.
pub const STIFFNESS_N_PER_M_LOG: (f64, f64) = (1e3, 1e5);
/// Stiffness of a soft tip, N/m.
pub const SOFT_STIFFNESS_N_PER_M_LOG: (f64, f64) = (500.0, 3e3);
/// Stiffness of surface and tip over that of the contact as seen from the flange.
pub const TIP_OVER_CELL_LOG: (f64, f64) = (1.1, 4.0);
/// Depth to which the force presses a square tip into the surface at most, m.
pub const DENT_MAX_M: f64 = 5e-4;
/// That depth for a soft tip, m.
pub const SOFT_DENT_MAX_M: f64 = 3e-3;
/// Stiffness of tool and wrist across the tool's axis over that along it.
pub const ACROSS_OVER_ALONG: (f64, f64) = (0.3, 1.0);
/// Give of tool and wrist across the tool's axis under the pressing force at most, m.
pub const GIVE_MAX_M: f64 = 3e-3;
/// Stiffness of tool and wrist against turning, Nm/rad.
pub const TURNING_NM_PER_RAD_LOG: (f64, f64) = (100.0, 1000.0);
/// Sliding friction.
pub const FRICTION: (f64, f64) = (0.05, 0.9);
/// Static friction over sliding friction.
pub const STATIC_RATIO: (f64, f64) = (1.0, 1.25);
/// Pressing force, N.
pub const FORCE_N_LOG: (f64, f64) = (1.0, 30.0);
/// Speed of the path, m/s.
pub const SPEED_M_PER_S: (f64, f64) = (0.005, 0.08);
/// Time that the path takes at that speed, s; the length stays within [`LENGTH_M`].
pub const PATH_S: (f64, f64) = (8.0, 14.0);
/// Length of the path, m.
pub const LENGTH_M: (f64, f64) = (0.06, 0.4);
/// Tilt of the surface's normal at the start against the vertical, rad.
pub const FACING_RAD: (f64, f64) = (0.0, 0.5);

/// Radius of a round tip, m.
pub const ROUND_M: (f64, f64) = (0.002, 0.012);
/// Radius of a flat, ring or soft tip, m.
pub const PAD_M: (f64, f64) = (0.004, 0.014);
/// Share of the draws whose tip is stated as unknown.
pub const UNKNOWN_SHARE: f64 = 0.15;

/// Natural frequency of the servo, Hz.
pub const SERVO_HZ: (f64, f64) = (10.0, 25.0);
/// Damping ratio of the servo.
pub const SERVO_DAMPING: (f64, f64) = (0.7, 1.0);
/// Natural frequency of one joint over that of the servo.
pub const BANDWIDTH_RATIO: (f64, f64) = (0.85, 1.15);
/// Periods from a command to the target that follows it; one of them is the exchange with the
/// robot's program.
pub const DELAY_CYCLES: (usize, usize) = (1, 3);
/// White noise of the measured joint velocities, rad/s.
pub const VELOCITY_NOISE_RAD_PER_S_LOG: (f64, f64) = (1e-4, 2e-3);
/// Amplitude of the position error that repeats with the joint's angle, rad.
pub const RIPPLE_RAD: (f64, f64) = (0.0, 5e-5);
/// Constant error of a joint's position, rad, either sign.
pub const JOINT_OFFSET_RAD: f64 = 3e-4;

/// Error of the tip's position along x, y and z, m, either sign.
pub const TIP_POSITION_M: [f64; 3] = [0.001, 0.001, 0.002];
/// Tilt of the tip's true axes, rad.
pub const TIP_TILT_RAD: (f64, f64) = (0.0, 0.017_453_292_519_943_295);
/// Rotation of the sensor's true axes, rad.
pub const SENSOR_ROTATION_RAD: (f64, f64) = (0.0, 0.034_906_585_039_886_59);
/// Payload, kg.
pub const PAYLOAD_KG: (f64, f64) = (0.2, 0.8);
/// Error of the payload's mass, kg, either sign.
pub const PAYLOAD_ERROR_KG: f64 = 0.02;
/// Error of the payload's centre of mass, m, either sign.
pub const COM_ERROR_M: f64 = 0.002;

/// Coloured noise of the forces, N.
pub const COLOURED_N: (f64, f64) = (0.01, 0.1);
/// Torque of the coloured noise over its force, m.
pub const COLOURED_LEVER_M: f64 = 0.02;
/// Correlation time of the coloured noise, s.
pub const CORRELATION_S_LOG: (f64, f64) = (0.02, 0.5);
/// Amplitude of the vibration while the arm moves, N.
pub const VIBRATION_N: (f64, f64) = (0.0, 0.2);
/// Frequency of the vibration, Hz.
pub const VIBRATION_HZ: (f64, f64) = (8.0, 25.0);
/// Cross-talk.
pub const CROSS_TALK: (f64, f64) = (0.0, 0.01);
/// Latency of the wrench, s.
pub const LATENCY_S: (f64, f64) = (0.0, 0.008);
/// Pull of the cable, N/rad.
pub const CABLE_N_PER_RAD: (f64, f64) = (0.0, 0.3);
/// Warm-up drift of the force zero, N.
pub const DRIFT_N: (f64, f64) = (0.0, 0.3);
/// Relative change of the friction along the surface.
pub const FRICTION_VARIATION: (f64, f64) = (0.0, 0.2);
/// Wavelength of that change, m.
pub const FRICTION_WAVELENGTH_M: (f64, f64) = (0.01, 0.1);

/// Lowest manipulability at the start and at the corners of the path: nearer to a singularity, the
/// place is drawn again.
pub const MANIPULABILITY_MIN: f64 = 0.025;
