//! Syntax to instructions: names become slots, calls are checked, keyword arguments are put in
//! order.
//!
//! Variables of the program's outermost function are visible in the functions and threads inside
//! it, as those declared `global` are; everything else that a function assigns is its own.

use std::collections::HashMap;

use crate::builtins::{Builtin, find};
use crate::error::CompileError;
use crate::lexer::Position;
use crate::names::{collect_functions, for_each_statement, global_names, place, unknown};
use crate::parser::parse;
use crate::syntax::{
    Binary, Block, Call, Expression, Function, FunctionKind, Located, Scope, Statement,
};
use crate::value::Value;

/// Most variables of one function.
const LOCALS_MAX: usize = 128;
/// Most items in one list literal, arguments of one call, parameters of one function.
const ITEMS_MAX: usize = 512;

#[derive(Clone, Debug)]
pub enum Op {
    Constant(Value),
    Load(Slot),
    Store(Slot),
    /// Takes the value, then the indices from the stack.
    StoreElement(Slot, usize),
    List(usize),
    Pose,
    Element(usize),
    Not,
    Negate,
    Binary(Binary),
    Jump(usize),
    JumpIfFalse(usize),
    /// Jumps and keeps the value if it is that; else drops it.
    JumpIfKeep(bool, usize),
    Call(usize),
    Builtin(&'static Builtin),
    Run(usize),
    Kill,
    Join,
    Return,
    Drop,
    Halt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    Local(usize),
    Global(usize),
}

#[derive(Clone, Debug)]
pub struct Code {
    pub name: String,
    pub parameters: usize,
    pub locals: Vec<String>,
    pub ops: Vec<Op>,
    pub positions: Vec<Position>,
}

/// A program ready to run.
#[derive(Clone, Debug)]
pub struct Program {
    pub(super) codes: Vec<Code>,
    pub(super) globals: Vec<String>,
    name: String,
    secondary: bool,
}

impl Program {
    /// Compiles a whole program: one `def` or `sec` with its contents, or plain statements.
    /// `e_series` determines which built-in functions exist.
    ///
    /// # Errors
    /// The text is not a valid program; the error gives line, column and reason.
    pub fn compile(text: &str, e_series: bool) -> Result<Self, CompileError> {
        let mut block = parse(text)?;
        let mut name = "script".to_owned();
        let mut secondary = false;
        let single = block.len() == 1 && matches!(block[0].0, Statement::Function(_));
        if single && let Some((Statement::Function(function), _)) = block.pop() {
            name = function.name;
            secondary = function.kind == FunctionKind::Secondary;
            block = function.body;
        }
        let mut functions = Vec::new();
        collect_functions(&block, &mut functions);
        let mut globals = HashMap::new();
        let mut order = Vec::new();
        for name in global_names(&block, &functions) {
            globals.insert(name.clone(), order.len());
            order.push(name);
        }
        // Code 0 is the program's body. A function defined twice: the later one counts.
        let names: HashMap<&str, usize> = functions
            .iter()
            .enumerate()
            .map(|(i, f)| (f.name.as_str(), i + 1))
            .collect();
        let context = Context {
            functions: &functions,
            names,
            globals,
            e_series,
        };
        let mut codes = vec![FunctionCompiler::new(&context, &name, &[])?.finish(&block)?];
        for function in &functions {
            let parameters: Vec<String> =
                function.parameters.iter().map(|(n, _)| n.clone()).collect();
            if parameters.len() > ITEMS_MAX {
                return Err(function.position.error("too many parameters"));
            }
            let mut compiler = FunctionCompiler::new(&context, &function.name, &parameters)
                .map_err(|e| function.position.error(e.reason))?;
            compiler.declare(&function.body, function.position)?;
            codes.push(compiler.finish(&function.body)?);
        }
        Ok(Self {
            codes,
            globals: order,
            name,
            secondary,
        })
    }

    /// The program's name; `script` for plain statements.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A `sec` program: runs in one frame beside the main program.
    pub fn is_secondary(&self) -> bool {
        self.secondary
    }

    /// Names of all functions and threads in it.
    pub fn functions(&self) -> impl Iterator<Item = &str> {
        self.codes.iter().skip(1).map(|c| c.name.as_str())
    }
}

struct Context<'a> {
    functions: &'a [&'a Function],
    names: HashMap<&'a str, usize>,
    globals: HashMap<String, usize>,
    e_series: bool,
}

struct FunctionCompiler<'a> {
    context: &'a Context<'a>,
    code: Code,
    locals: HashMap<String, usize>,
    /// Where `continue` goes, and jumps of `break` yet to be aimed.
    loops: Vec<(usize, Vec<usize>)>,
}

impl<'a> FunctionCompiler<'a> {
    fn new(
        context: &'a Context<'a>,
        name: &str,
        parameters: &[String],
    ) -> Result<Self, CompileError> {
        let mut compiler = Self {
            context,
            code: Code {
                name: name.to_owned(),
                parameters: parameters.len(),
                locals: Vec::new(),
                ops: Vec::new(),
                positions: Vec::new(),
            },
            locals: HashMap::new(),
            loops: Vec::new(),
        };
        for parameter in parameters {
            compiler.local(parameter, Position::default())?;
        }
        Ok(compiler)
    }

    fn local(&mut self, name: &str, position: Position) -> Result<usize, CompileError> {
        if let Some(slot) = self.locals.get(name) {
            return Ok(*slot);
        }
        let slot = self.code.locals.len();
        if slot >= LOCALS_MAX {
            return Err(position.error(format!("more than {LOCALS_MAX} variables in one function")));
        }
        self.locals.insert(name.to_owned(), slot);
        self.code.locals.push(name.to_owned());
        Ok(slot)
    }

    fn declare(&mut self, body: &Block, position: Position) -> Result<(), CompileError> {
        let mut names: Vec<String> = Vec::new();
        let globals = &self.context.globals;
        for_each_statement(body, &mut |statement, _| {
            if let Statement::Assign { name, scope, .. } = statement {
                let own = match scope {
                    Scope::Local => true,
                    Scope::Global => false,
                    Scope::Plain => !globals.contains_key(name),
                };
                if own {
                    names.push(name.clone());
                }
            }
        });
        for name in names {
            self.local(&name, position)?;
        }
        Ok(())
    }

    fn finish(mut self, body: &Block) -> Result<Code, CompileError> {
        self.block(body)?;
        let position = body.last().map_or(Position::default(), |(_, p)| *p);
        self.emit(Op::Constant(Value::None), position);
        self.emit(Op::Return, position);
        Ok(self.code)
    }

    fn emit(&mut self, op: Op, position: Position) -> usize {
        self.code.ops.push(op);
        self.code.positions.push(position);
        self.code.ops.len() - 1
    }

    fn aim(&mut self, jump: usize) {
        let here = self.code.ops.len();
        match &mut self.code.ops[jump] {
            Op::Jump(to) | Op::JumpIfFalse(to) | Op::JumpIfKeep(_, to) => *to = here,
            _ => {}
        }
    }

    fn slot(&self, name: &str) -> Option<Slot> {
        let local = self.locals.get(name).map(|n| Slot::Local(*n));
        local.or_else(|| self.context.globals.get(name).map(|n| Slot::Global(*n)))
    }

    fn known(&self, name: &str, position: Position) -> Result<Slot, CompileError> {
        self.slot(name).ok_or_else(|| unknown(name, position))
    }

    fn block(&mut self, block: &Block) -> Result<(), CompileError> {
        block
            .iter()
            .try_for_each(|(statement, position)| self.statement(statement, *position))
    }

    fn statement(&mut self, statement: &Statement, position: Position) -> Result<(), CompileError> {
        match statement {
            Statement::Function(_) => {}
            Statement::Assign {
                scope,
                name,
                indices,
                value,
            } => {
                let slot = match (scope, self.context.globals.get(name)) {
                    (Scope::Global, Some(n)) => Slot::Global(*n),
                    _ => self.known(name, position)?,
                };
                for index in indices {
                    self.expression(index)?;
                }
                self.expression(value)?;
                let op = if indices.is_empty() {
                    Op::Store(slot)
                } else {
                    Op::StoreElement(slot, indices.len())
                };
                self.emit(op, position);
            }
            Statement::Expression(value) => {
                self.expression(value)?;
                self.emit(Op::Drop, position);
            }
            Statement::If(arms, otherwise) => {
                let mut ends = Vec::new();
                for (condition, body) in arms {
                    self.expression(condition)?;
                    let skip = self.emit(Op::JumpIfFalse(0), condition.position);
                    self.block(body)?;
                    ends.push(self.emit(Op::Jump(0), position));
                    self.aim(skip);
                }
                self.block(otherwise)?;
                for end in ends {
                    self.aim(end);
                }
            }
            Statement::While(condition, body) => {
                let start = self.code.ops.len();
                self.expression(condition)?;
                let leave = self.emit(Op::JumpIfFalse(0), condition.position);
                self.loops.push((start, vec![leave]));
                self.block(body)?;
                self.emit(Op::Jump(start), position);
                for jump in self.loops.pop().map(|(_, jumps)| jumps).unwrap_or_default() {
                    self.aim(jump);
                }
            }
            Statement::Break | Statement::Continue => {
                let Some((start, _)) = self.loops.last() else {
                    return Err(position.error("break and continue belong into a while"));
                };
                let jump = self.emit(Op::Jump(*start), position);
                if *statement == Statement::Break
                    && let Some((_, jumps)) = self.loops.last_mut()
                {
                    jumps.push(jump);
                }
            }
            Statement::Return(value) => {
                match value {
                    Some(value) => self.expression(value)?,
                    None => {
                        self.emit(Op::Constant(Value::None), position);
                    }
                }
                self.emit(Op::Return, position);
            }
            Statement::Kill(thread) => {
                self.expression(thread)?;
                self.emit(Op::Kill, position);
            }
            Statement::Join(thread) => {
                self.expression(thread)?;
                self.emit(Op::Join, position);
            }
            // A thread runs until it waits, so that no other interrupts it. In a section that
            // waits, others run, as on the controller: clients move the arm in a section of one
            // thread and kill that thread from a section of another.
            Statement::EnterCritical | Statement::ExitCritical => {}
            Statement::Halt => {
                self.emit(Op::Halt, position);
            }
        }
        Ok(())
    }

    fn expression(&mut self, located: &Located) -> Result<(), CompileError> {
        let position = located.position;
        let op = match &located.expression {
            Expression::Bool(b) => Op::Constant(Value::Bool(*b)),
            Expression::Integer(n) => Op::Constant(Value::Integer(*n)),
            Expression::Float(x) => Op::Constant(Value::Float(*x)),
            Expression::Text(text) => {
                Op::Constant(Value::text(text.clone()).map_err(|e| position.error(e.to_string()))?)
            }
            Expression::Name(name) => Op::Load(self.known(name, position)?),
            Expression::List(items) => {
                if items.len() > ITEMS_MAX {
                    return Err(position.error(format!("a list of more than {ITEMS_MAX} items")));
                }
                for item in items {
                    self.expression(item)?;
                }
                Op::List(items.len())
            }
            Expression::Pose(items) => {
                for item in items {
                    self.expression(item)?;
                }
                Op::Pose
            }
            Expression::Index(array, indices) => {
                self.expression(array)?;
                for index in indices {
                    self.expression(index)?;
                }
                if indices.is_empty() || indices.len() > 4 {
                    return Err(position.error("one to four indices belong into brackets"));
                }
                Op::Element(indices.len())
            }
            Expression::Not(inner) => {
                self.expression(inner)?;
                Op::Not
            }
            Expression::Negate(inner) => {
                self.expression(inner)?;
                Op::Negate
            }
            Expression::Binary(operator @ (Binary::And | Binary::Or), left, right) => {
                self.expression(left)?;
                let keep = *operator == Binary::Or;
                let jump = self.emit(Op::JumpIfKeep(keep, 0), position);
                self.expression(right)?;
                self.aim(jump);
                return Ok(());
            }
            Expression::Binary(operator, left, right) => {
                self.expression(left)?;
                self.expression(right)?;
                Op::Binary(*operator)
            }
            Expression::Run(call) => match self.context.names.get(call.name.as_str()) {
                Some(n) => {
                    self.arguments_of(*n, call, position)?;
                    Op::Run(*n)
                }
                None => return Err(unknown(&call.name, position)),
            },
            Expression::Call(call) => self.call(call, position)?,
        };
        self.emit(op, position);
        Ok(())
    }

    fn call(&mut self, call: &Call, position: Position) -> Result<Op, CompileError> {
        if let Some(n) = self.context.names.get(call.name.as_str()) {
            self.arguments_of(*n, call, position)?;
            return Ok(Op::Call(*n));
        }
        let builtin =
            find(&call.name, self.context.e_series).ok_or_else(|| unknown(&call.name, position))?;
        let places = place(call, builtin.parameters, position)?;
        for place in places {
            match place {
                Some(value) => self.expression(value)?,
                None => {
                    self.emit(Op::Constant(Value::None), position);
                }
            }
        }
        Ok(Op::Builtin(builtin))
    }

    fn arguments_of(
        &mut self,
        code: usize,
        call: &Call,
        position: Position,
    ) -> Result<(), CompileError> {
        let function = self.context.functions[code - 1];
        let names: Vec<&str> = function
            .parameters
            .iter()
            .map(|(n, _)| n.as_str())
            .collect();
        let places = place(call, &names, position)?;
        for (place, (name, default)) in places.into_iter().zip(&function.parameters) {
            match place.or(default.as_ref()) {
                Some(value) => self.expression(value)?,
                None => {
                    return Err(position.error(format!(
                        "{} is called without its argument {name:?}",
                        call.name
                    )));
                }
            }
        }
        Ok(())
    }
}
