//! Reasons why a text is no program, and why a running program fails.

use crate::limits::{CALLS_MAX, LIST_DEPTH_MAX, LIST_ITEMS_MAX, TEXT_BYTES_MAX, THREADS_MAX};

/// Error of [`crate::Program::compile`]: the text is not a program that this controller runs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {reason}")]
pub struct CompileError {
    /// Line, counted from 1.
    pub line: u32,
    /// Column, counted from 1.
    pub column: u32,
    /// What is wrong and what is allowed.
    pub reason: String,
    /// The text is well formed, but calls or reads a name that does not exist. The controller
    /// reports these on its ports, but not texts that are not well formed.
    pub unknown_name: bool,
}

/// Where and why a running program failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("line {line}, column {column}: {cause}")]
pub struct RuntimeError {
    /// Line, counted from 1.
    pub line: u32,
    /// Column, counted from 1.
    pub column: u32,
    /// What the program did wrong.
    pub cause: ScriptError,
}

impl RuntimeError {
    /// Whether the program did not leave the frame; the controller then stops protectively.
    pub fn is_overrun(&self) -> bool {
        self.cause == ScriptError::TooMuchTime
    }
}

/// What a running program did wrong, in the controller's words if they are known.
///
/// The texts are those that a pendant shows. Kinds of values are the words of
/// [`crate::Value::kind`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScriptError {
    /// A value of another type than the operation or function takes.
    #[error("{needed} is needed, not {found}")]
    Kind {
        /// Type that is taken.
        needed: &'static str,
        /// Type of the value.
        found: &'static str,
    },
    /// A value that is neither a pose nor a list, where six numbers are needed.
    #[error("six numbers are needed, not {found}")]
    NoSixNumbers {
        /// Type of the value.
        found: &'static str,
    },
    /// A list of another length than six, where six numbers are needed.
    #[error("six numbers are needed, not {count}")]
    NotSix {
        /// Length of the list.
        count: usize,
    },
    /// The length of a value that has none.
    #[error("{kind} has no length")]
    NoLength {
        /// Type of the value.
        kind: &'static str,
    },
    /// An element of a value that has none.
    #[error("{kind} has no elements")]
    NoElements {
        /// Type of the value.
        kind: &'static str,
    },
    /// The negative of a value that has none.
    #[error("{kind} has no negative")]
    NoNegative {
        /// Type of the value.
        kind: &'static str,
    },
    /// An operator between types that it does not join.
    #[error("{operator} does not work with {left} and {right}")]
    Operands {
        /// The operator.
        operator: &'static str,
        /// Type of the value before it.
        left: &'static str,
        /// Type of the value after it.
        right: &'static str,
    },
    /// An element beyond the end of a list or pose.
    #[error("index {index} is out of range")]
    IndexOutOfRange {
        /// Index, counted from 0.
        index: i32,
    },
    /// A division by zero.
    #[error("division by zero")]
    DivisionByZero,
    /// A variable that is read before it is assigned.
    #[error("{name} is used before it has a value")]
    NoValueYet {
        /// Name of the variable.
        name: String,
    },

    /// A list that is too long or nested too deeply.
    #[error(
        "a list with {elements} elements, {depth} deep; at most {LIST_ITEMS_MAX}, {LIST_DEPTH_MAX} deep"
    )]
    ListTooLarge {
        /// Number of elements, those of lists inside included.
        elements: usize,
        /// Levels of lists.
        depth: u8,
    },
    /// The lists of all programs together are too large.
    #[error("out of memory for lists")]
    OutOfListMemory,
    /// A text that is too long.
    #[error("a text longer than {TEXT_BYTES_MAX} bytes")]
    TextTooLong {
        /// Length, bytes.
        bytes: usize,
    },
    /// Functions call each other too deeply.
    #[error("calls nest deeper than {CALLS_MAX}")]
    TooManyCalls,
    /// Too many threads run at once.
    #[error("more than {THREADS_MAX} threads")]
    TooManyThreads,
    /// An expression or a call needs too many values at once.
    #[error("out of stack")]
    OutOfStack,
    /// The program looped without moving, sleeping or syncing.
    #[error(
        "The program used too much time without instructing the robot what to do. Consider using a Wait or sync() to split program sequences that do not move the robot"
    )]
    TooMuchTime,
    /// Two threads move the arm.
    #[error("Another thread is already controlling the robot")]
    AnotherThreadMoves,

    /// An argument outside the range of its function.
    #[error("{function}: {name} is {value}, but must be {least} to {most}")]
    ArgumentOutOfRange {
        /// Name of the function.
        function: &'static str,
        /// Name of the argument.
        name: &'static str,
        /// The argument.
        value: f64,
        /// Least value that is allowed.
        least: f64,
        /// Greatest value that is allowed.
        most: f64,
    },
    /// An argument that must be positive and is not.
    #[error("{name} is {value}, but must be above 0")]
    NotPositive {
        /// Name of the argument.
        name: &'static str,
        /// The argument.
        value: f64,
    },
    /// A number that is infinite or not a number.
    #[error("{value} is not a finite number")]
    NotFinite {
        /// The number.
        value: f64,
    },
    /// A pose or joint positions with a number that is infinite or not a number.
    #[error("a motion was requested with a number that is not finite")]
    MotionNotFinite {
        /// The six numbers.
        numbers: [f64; 6],
    },
    /// A register or port that does not exist.
    #[error("there is no register or port {number}")]
    NoPort {
        /// Its number.
        number: i32,
    },
    /// `get_inverse_kin` of a pose that the arm cannot reach.
    #[error("get_inverse_kin: no solution found")]
    NoSolution,
    /// `movej` to a pose that the arm cannot reach.
    #[error("movej: no joint positions for this pose")]
    NoJointPositions,
    /// A list of another length than three, where three numbers are needed.
    #[error("three numbers are needed, not {count}")]
    NotThree {
        /// Length of the list.
        count: usize,
    },
    /// A matrix times something of another size.
    #[error("a matrix of {rows} rows and {columns} columns times a list of another size")]
    Sizes {
        /// Rows of the matrix.
        rows: usize,
        /// Columns of the matrix.
        columns: usize,
    },
    /// The inverse of a matrix that has none.
    #[error("inv: the matrix has no inverse")]
    Singular,
    /// The number in a text that is none.
    #[error("to_num: {text:?} is not a number")]
    NoNumber {
        /// The text.
        text: String,
    },
    /// `assert` of a condition that does not hold.
    #[error("assert: the condition does not hold")]
    Asserted,
    /// A supply of the tool that does not exist.
    #[error("set_tool_voltage: {value} V, but must be 0, 12 or 24")]
    ToolVoltage {
        /// The voltage, V.
        value: f64,
    },
    /// A direction of gravity that is not the one of an upright arm.
    #[error("set_gravity: {direction:?}, but the simulated arm stands upright")]
    Tilted {
        /// The direction that was set.
        direction: Vec<f64>,
    },
    /// The robot has no force/torque sensor.
    #[error("zero_ftsensor: no force/torque sensor")]
    NoForceSensor,
    /// The first argument of `rtde_set_watchdog` is not a text.
    #[error("rtde_set_watchdog: the first argument names an input variable")]
    WatchdogWithoutName {
        /// Type of the argument.
        found: &'static str,
    },
    /// A watchdog for an input that does not exist.
    #[error("rtde_set_watchdog: no input variable {variable:?}")]
    UnknownInput {
        /// Name of the input.
        variable: String,
    },
    /// A watchdog with an action that does not exist.
    #[error("rtde_set_watchdog: action {action:?}; allowed are ignore, pause, stop")]
    UnknownAction {
        /// The action, in lower case.
        action: String,
    },
    /// More watchdogs than the controller holds.
    #[error("rtde_set_watchdog: too many watchdogs")]
    TooManyWatchdogs {
        /// Most watchdogs at once.
        most: usize,
    },
}
