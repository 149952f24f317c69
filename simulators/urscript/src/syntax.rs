//! Syntax tree of a program.

use crate::lexer::Position;

#[derive(Clone, Debug, PartialEq)]
pub enum Expression {
    Bool(bool),
    Integer(i32),
    Float(f64),
    Text(String),
    List(Vec<Located>),
    Pose(Vec<Located>),
    Name(String),
    Index(Box<Located>, Vec<Located>),
    Call(Call),
    Run(Call),
    Not(Box<Located>),
    Negate(Box<Located>),
    Binary(Binary, Box<Located>, Box<Located>),
}

/// An expression and its position.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    pub expression: Expression,
    pub position: Position,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Call {
    pub name: String,
    pub arguments: Vec<(Option<String>, Located)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binary {
    Or,
    Xor,
    And,
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
}

impl Binary {
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Or => "or",
            Self::Xor => "xor",
            Self::And => "and",
            Self::Equal => "==",
            Self::NotEqual => "!=",
            Self::Less => "<",
            Self::LessOrEqual => "<=",
            Self::Greater => ">",
            Self::GreaterOrEqual => ">=",
            Self::Add => "+",
            Self::Subtract => "-",
            Self::Multiply => "*",
            Self::Divide => "/",
            Self::Remainder => "%",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    Plain,
    Global,
    Local,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Statement {
    Assign {
        scope: Scope,
        name: String,
        indices: Vec<Located>,
        value: Located,
    },
    Expression(Located),
    If(Vec<(Located, Block)>, Block),
    While(Located, Block),
    Break,
    Continue,
    Return(Option<Located>),
    Kill(Located),
    Join(Located),
    EnterCritical,
    ExitCritical,
    Halt,
    Function(Function),
}

pub type Block = Vec<(Statement, Position)>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FunctionKind {
    Def,
    Thread,
    /// Runs beside the main program, in a single frame.
    Secondary,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Function {
    pub kind: FunctionKind,
    pub name: String,
    /// Names and default values of the parameters.
    pub parameters: Vec<(String, Option<Located>)>,
    pub body: Block,
    pub position: Position,
}
