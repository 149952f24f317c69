//! Runs a program one control cycle at a time: threads take turns, each until it waits for the next
//! frame.

use crate::builtins::{Outcome, Wait};
use crate::compile::{Op, Program, Slot};
use crate::error::{RuntimeError, ScriptError};
use crate::lexer::Position;
use crate::limits::{CALLS_MAX, INSTRUCTIONS_PER_FRAME, STACK_MAX, THREADS_MAX};
use crate::robot::{Motion, Robot};
use crate::value::Value;

/// Result of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    /// The program continues in the next frame.
    Running,
    /// The program has ended.
    Ended,
    /// The program failed and is over.
    Failed(RuntimeError),
}

/// A running program.
#[derive(Debug)]
pub struct Machine {
    program: Program,
    globals: Vec<Option<Value>>,
    threads: Vec<Thread>,
    next_id: i32,
    /// Thread whose motion the arm executes.
    owner: Option<i32>,
    halted: bool,
    line: u32,
}

#[derive(Debug)]
struct Thread {
    id: i32,
    calls: Vec<CallFrame>,
    stack: Vec<Value>,
    wait: Wait,
}

#[derive(Debug)]
struct CallFrame {
    code: usize,
    at: usize,
    locals: Vec<Option<Value>>,
}

/// Result of a thread's turn.
enum Turn {
    Waits,
    Ended,
}

impl Machine {
    /// Creates a machine that is ready to run the first frame.
    pub fn new(program: Program) -> Self {
        let mut machine = Self {
            globals: vec![None; program.globals.len()],
            threads: Vec::new(),
            next_id: 1,
            owner: None,
            halted: false,
            line: 0,
            program,
        };
        // The main program is thread 0, which no handle in the program names.
        let main = machine.thread(0, 0, Vec::new());
        machine.threads.push(main);
        machine
    }

    /// The program.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// The line that the main program executes, counted from 1.
    pub fn line(&self) -> u32 {
        self.line
    }

    /// Whether a thread waits for a motion.
    pub fn in_motion(&self) -> bool {
        self.threads.iter().any(|t| t.wait.is_motion())
    }

    /// A global variable's value, for tests and for display.
    pub fn global(&self, name: &str) -> Option<&Value> {
        let n = self.program.globals.iter().position(|g| g == name)?;
        self.globals[n].as_ref()
    }

    /// One control cycle: every thread runs until it waits.
    pub fn frame(&mut self, robot: &mut dyn Robot) -> Frame {
        let mut budget = INSTRUCTIONS_PER_FRAME;
        if self.owner.is_some_and(|owner| self.is_free(owner)) && !robot.moving() {
            self.owner = None;
        }
        let ids: Vec<i32> = self.threads.iter().map(|t| t.id).collect();
        let mut fresh: Vec<i32> = ids;
        while let Some((id, rest)) = fresh.split_first().map(|(a, b)| (*a, b.to_vec())) {
            fresh = rest;
            let last = self.next_id;
            // A thread may have been killed by one before it.
            let Some(index) = self.threads.iter().position(|t| t.id == id) else {
                continue;
            };
            let mut thread = self.threads.swap_remove(index);
            let turn = self.turn(&mut thread, robot, &mut budget);
            if id == 0 {
                self.line = self.position_of(&thread).line;
            }
            match turn {
                Ok(Turn::Waits) => {
                    self.threads.push(thread);
                    let n = self.threads.len() - 1;
                    // Keeps the order of turns the order of starts.
                    self.threads[..=n].sort_by_key(|t| t.id);
                }
                Ok(Turn::Ended) => {
                    self.released(id);
                    if id == 0 {
                        return Frame::Ended;
                    }
                }
                Err(cause) => {
                    let Position { line, column } = self.position_of(&thread);
                    return Frame::Failed(RuntimeError {
                        line,
                        column,
                        cause,
                    });
                }
            }
            if self.halted {
                return Frame::Ended;
            }
            fresh.extend(last..self.next_id);
        }
        Frame::Running
    }

    fn thread(&self, id: i32, code: usize, arguments: Vec<Value>) -> Thread {
        Thread {
            id,
            calls: vec![self.call_frame(code, arguments)],
            stack: Vec::new(),
            wait: Wait::Not,
        }
    }

    fn call_frame(&self, code: usize, arguments: Vec<Value>) -> CallFrame {
        let mut locals: Vec<Option<Value>> = arguments.into_iter().map(Some).collect();
        locals.resize(self.program.codes[code].locals.len(), None);
        CallFrame {
            code,
            at: 0,
            locals,
        }
    }

    fn position_of(&self, thread: &Thread) -> Position {
        let position = thread.calls.last().and_then(|call| {
            let positions = &self.program.codes[call.code].positions;
            positions.get(call.at.saturating_sub(1)).copied()
        });
        position.unwrap_or_default()
    }

    /// Releases the arm of a thread that has ended.
    fn released(&mut self, id: i32) {
        if self.owner == Some(id) {
            self.owner = None;
        }
    }

    /// Whether the thread does not wait for a motion of its own.
    fn is_free(&self, id: i32) -> bool {
        !self
            .threads
            .iter()
            .any(|t| t.id == id && t.wait.is_motion())
    }

    fn turn(
        &mut self,
        thread: &mut Thread,
        robot: &mut dyn Robot,
        budget: &mut u32,
    ) -> Result<Turn, ScriptError> {
        if !self.resumes(thread, robot)? {
            return Ok(Turn::Waits);
        }
        thread.wait = Wait::Not;
        loop {
            let Some(call) = thread.calls.last_mut() else {
                return Ok(Turn::Ended);
            };
            let op = self.program.codes[call.code].ops[call.at].clone();
            call.at += 1;
            let cost = 1 + thread.stack.last().map_or(0, Value::weight) as u32 / 16;
            *budget = budget.saturating_sub(cost);
            if *budget == 0 {
                return Err(ScriptError::TooMuchTime);
            }
            match op {
                Op::Call(code) => {
                    if thread.calls.len() >= CALLS_MAX {
                        return Err(ScriptError::TooManyCalls);
                    }
                    let arguments = arguments(thread, self.program.codes[code].parameters);
                    thread.calls.push(self.call_frame(code, arguments));
                }
                Op::Return => {
                    thread.calls.pop();
                    if thread.calls.is_empty() {
                        return Ok(Turn::Ended);
                    }
                }
                Op::Run(code) => {
                    // The running thread is not in the list.
                    if self.threads.len() + 1 >= THREADS_MAX {
                        return Err(ScriptError::TooManyThreads);
                    }
                    let arguments = arguments(thread, self.program.codes[code].parameters);
                    let id = self.next_id;
                    self.next_id += 1;
                    let started = self.thread(id, code, arguments);
                    self.threads.push(started);
                    thread.stack.push(Value::Integer(id));
                }
                Op::Kill => {
                    let id = pop(thread).integer()?;
                    // 0 is no thread: a handle that was never run.
                    if id > 0 && id == thread.id {
                        return Ok(Turn::Ended);
                    }
                    if id > 0 {
                        self.threads.retain(|t| t.id != id);
                        self.released(id);
                    }
                }
                Op::Join => {
                    let id = pop(thread).integer()?;
                    if id > 0 && self.threads.iter().any(|t| t.id == id) {
                        thread.wait = Wait::Join(id);
                        return Ok(Turn::Waits);
                    }
                }
                Op::Halt => {
                    self.halted = true;
                    return Ok(Turn::Ended);
                }
                Op::Builtin(builtin)
                    if *budget < INSTRUCTIONS_PER_FRAME / 2 && builtin.takes_turns() =>
                {
                    // Tried again in the next frame.
                    if let Some(call) = thread.calls.last_mut() {
                        call.at -= 1;
                    }
                    thread.wait = Wait::Frame;
                    return Ok(Turn::Waits);
                }
                Op::Builtin(builtin) => {
                    let arguments = arguments(thread, builtin.parameters.len());
                    match (builtin.call)(robot, &arguments)? {
                        Outcome::Value(value) => thread.stack.push(value),
                        Outcome::Wait(wait) => {
                            thread.stack.push(Value::None);
                            thread.wait = wait;
                            return Ok(Turn::Waits);
                        }
                        Outcome::Move(motion, wait) => {
                            self.start(thread.id, motion, robot)?;
                            thread.stack.push(Value::None);
                            thread.wait = wait;
                            return Ok(Turn::Waits);
                        }
                    }
                }
                other => self.plain(other, thread)?,
            }
            if thread.stack.len() > STACK_MAX {
                return Err(ScriptError::OutOfStack);
            }
        }
    }

    fn start(&mut self, id: i32, motion: Motion, robot: &mut dyn Robot) -> Result<(), ScriptError> {
        if self.owner.is_some_and(|owner| owner != id) && robot.moving() {
            return Err(ScriptError::AnotherThreadMoves);
        }
        self.owner = Some(id);
        robot.start_motion(motion)
    }

    fn resumes(&self, thread: &mut Thread, robot: &mut dyn Robot) -> Result<bool, ScriptError> {
        let step = robot.step_s();
        Ok(match &mut thread.wait {
            Wait::Not | Wait::Frame => true,
            Wait::Sleep(left) => {
                *left -= step;
                *left <= 1e-9
            }
            Wait::MotionFor(left) => {
                // The speed slider stretches time.
                *left -= step * robot.speed_fraction();
                *left <= 1e-9
            }
            Wait::Motion => robot.motion_done(),
            Wait::Join(id) => !self.threads.iter().any(|t| t.id == *id),
            Wait::Popup => !robot.popup_is_open(),
            Wait::Socket(wait) => match wait.later(robot.sockets(), step)? {
                Some(value) => {
                    // The call has pushed an empty result before it waited.
                    pop(thread);
                    thread.stack.push(value);
                    true
                }
                None => false,
            },
        })
    }

    /// Instructions that touch only the thread and the variables.
    fn plain(&mut self, op: Op, thread: &mut Thread) -> Result<(), ScriptError> {
        match op {
            Op::Constant(value) => thread.stack.push(value),
            Op::Load(slot) => {
                let value = self.variable(thread, slot).clone();
                let value = value.ok_or_else(|| self.no_value_yet(thread, slot))?;
                thread.stack.push(value);
            }
            Op::Store(slot) => {
                let value = pop(thread);
                *self.variable(thread, slot) = Some(value);
            }
            Op::StoreElement(slot, n) => {
                let value = pop(thread);
                let indices = arguments(thread, n);
                let Some(old) = self.variable(thread, slot).clone() else {
                    return Err(self.no_value_yet(thread, slot));
                };
                let new = old.with_element(&indices, value)?;
                *self.variable(thread, slot) = Some(new);
            }
            Op::List(n) => {
                let items = arguments(thread, n);
                thread.stack.push(Value::list(items)?);
            }
            Op::Pose => {
                let items = arguments(thread, 6);
                let mut pose = [0.0; 6];
                for (x, item) in pose.iter_mut().zip(&items) {
                    *x = item.float()?;
                }
                thread.stack.push(Value::Pose(pose));
            }
            Op::Element(n) => {
                let indices = arguments(thread, n);
                let mut value = pop(thread);
                for index in &indices {
                    value = value.element(index)?;
                }
                thread.stack.push(value);
            }
            Op::Not => {
                let value = pop(thread).truth()?;
                thread.stack.push(Value::Bool(!value));
            }
            Op::Negate => {
                let value = pop(thread).negated()?;
                thread.stack.push(value);
            }
            Op::Binary(operator) => {
                let right = pop(thread);
                let left = pop(thread);
                thread.stack.push(Value::binary(operator, &left, &right)?);
            }
            Op::Jump(to) => jump(thread, to),
            Op::JumpIfFalse(to) => {
                if !pop(thread).truth()? {
                    jump(thread, to);
                }
            }
            Op::JumpIfKeep(keep, to) => {
                let value = pop(thread).truth()?;
                if value == keep {
                    thread.stack.push(Value::Bool(value));
                    jump(thread, to);
                }
            }
            // The rest is handled where threads are.
            _ => {
                pop(thread);
            }
        }
        Ok(())
    }

    fn variable<'m>(&'m mut self, thread: &'m mut Thread, slot: Slot) -> &'m mut Option<Value> {
        match (slot, thread.calls.last_mut()) {
            (Slot::Local(n), Some(call)) => &mut call.locals[n],
            (Slot::Local(n) | Slot::Global(n), _) => &mut self.globals[n],
        }
    }

    fn no_value_yet(&self, thread: &Thread, slot: Slot) -> ScriptError {
        let name = match (slot, thread.calls.last()) {
            (Slot::Local(n), Some(call)) => &self.program.codes[call.code].locals[n],
            (Slot::Local(n) | Slot::Global(n), _) => &self.program.globals[n],
        };
        ScriptError::NoValueYet { name: name.clone() }
    }
}

fn jump(thread: &mut Thread, to: usize) {
    if let Some(call) = thread.calls.last_mut() {
        call.at = to;
    }
}

/// The compiler balances pushes and pops; a missing value would be a defect of the compiler, and
/// reads as nothing.
fn pop(thread: &mut Thread) -> Value {
    thread.stack.pop().unwrap_or(Value::None)
}

fn arguments(thread: &mut Thread, n: usize) -> Vec<Value> {
    let from = thread.stack.len().saturating_sub(n);
    thread.stack.split_off(from)
}
