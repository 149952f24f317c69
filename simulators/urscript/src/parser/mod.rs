//! Tokens to syntax, by recursive descent with a bounded depth.

mod expression;

use crate::error::CompileError;
use crate::lexer::{Position, Token, tokens};
use crate::syntax::{Block, Expression, Function, FunctionKind, Located, Scope, Statement};

/// Deepest nesting of blocks and of parentheses.
const DEPTH_MAX: usize = 80;

/// Longest `a + b + c ...`.
const CHAIN_MAX: usize = 100;

const KEYWORDS: [&str; 27] = [
    "def",
    "thread",
    "sec",
    "end",
    "if",
    "elif",
    "else",
    "while",
    "break",
    "continue",
    "return",
    "global",
    "local",
    "run",
    "kill",
    "join",
    "halt",
    "enter_critical",
    "exit_critical",
    "and",
    "or",
    "xor",
    "not",
    "True",
    "False",
    "true",
    "false",
];

/// A whole text: statements at the top level, most often one `def`.
pub fn parse(text: &str) -> Result<Block, CompileError> {
    let mut parser = Parser {
        tokens: tokens(text)?,
        at: 0,
        depth: 0,
    };
    let block = parser.block()?;
    match parser.peek() {
        Token::End => Ok(block),
        other => Err(parser
            .position()
            .error(format!("{} closes nothing", describe(other)))),
    }
}

struct Parser {
    tokens: Vec<(Token, Position)>,
    at: usize,
    depth: usize,
}

impl Parser {
    fn peek(&self) -> &Token {
        &self.tokens[self.at].0
    }

    fn peek_after(&self, n: usize) -> &Token {
        let last = self.tokens.len() - 1;
        &self.tokens[(self.at + n).min(last)].0
    }

    fn position(&self) -> Position {
        self.tokens[self.at].1
    }

    fn advance(&mut self) {
        // The last token is `End`; nothing lies beyond it.
        self.at = (self.at + 1).min(self.tokens.len() - 1);
    }

    fn is_word(&self, word: &str) -> bool {
        matches!(self.peek(), Token::Name(n) if n == word)
    }

    fn take_word(&mut self, word: &str) -> bool {
        let found = self.is_word(word);
        if found {
            self.advance();
        }
        found
    }

    fn is_symbol(&self, symbol: &str) -> bool {
        matches!(self.peek(), Token::Symbol(s) if *s == symbol)
    }

    fn take_symbol(&mut self, symbol: &str) -> bool {
        let found = self.is_symbol(symbol);
        if found {
            self.advance();
        }
        found
    }

    fn expect_symbol(&mut self, symbol: &str) -> Result<(), CompileError> {
        if self.take_symbol(symbol) {
            return Ok(());
        }
        Err(self.position().error(format!(
            "{symbol:?} belongs here, not {}",
            describe(self.peek())
        )))
    }

    fn expect_word(&mut self, word: &str) -> Result<(), CompileError> {
        if self.take_word(word) {
            return Ok(());
        }
        Err(self.position().error(format!(
            "{word:?} belongs here, not {}",
            describe(self.peek())
        )))
    }

    fn expect_name(&mut self) -> Result<String, CompileError> {
        match self.peek() {
            Token::Name(name) if !KEYWORDS.contains(&name.as_str()) => {
                let name = name.clone();
                self.advance();
                Ok(name)
            }
            other => Err(self
                .position()
                .error(format!("a name belongs here, not {}", describe(other)))),
        }
    }

    fn deeper<T>(
        &mut self,
        inner: impl FnOnce(&mut Self) -> Result<T, CompileError>,
    ) -> Result<T, CompileError> {
        if self.depth >= DEPTH_MAX {
            return Err(self
                .position()
                .error(format!("nested deeper than {DEPTH_MAX}")));
        }
        self.depth += 1;
        let result = inner(self);
        self.depth -= 1;
        result
    }

    fn block(&mut self) -> Result<Block, CompileError> {
        self.deeper(|parser| {
            let mut block = Vec::new();
            loop {
                while parser.take_symbol(";") {}
                let closed = *parser.peek() == Token::End
                    || ["end", "elif", "else"].iter().any(|w| parser.is_word(w));
                if closed {
                    return Ok(block);
                }
                let position = parser.position();
                block.push((parser.statement()?, position));
            }
        })
    }

    fn statement(&mut self) -> Result<Statement, CompileError> {
        let word = match self.peek() {
            Token::Name(name) => name.clone(),
            _ => return Ok(Statement::Expression(self.expression()?)),
        };
        match word.as_str() {
            "def" => Ok(Statement::Function(self.function(FunctionKind::Def)?)),
            "thread" => Ok(Statement::Function(self.function(FunctionKind::Thread)?)),
            "sec" => Ok(Statement::Function(self.function(FunctionKind::Secondary)?)),
            "if" => self.branch(),
            "while" => {
                self.advance();
                let condition = self.expression()?;
                self.expect_symbol(":")?;
                let body = self.block()?;
                self.expect_word("end")?;
                Ok(Statement::While(condition, body))
            }
            "return" => self.leave(),
            "global" => self.declaration(Scope::Global),
            "local" => self.declaration(Scope::Local),
            "kill" => {
                self.advance();
                Ok(Statement::Kill(self.expression()?))
            }
            "join" => {
                self.advance();
                Ok(Statement::Join(self.expression()?))
            }
            "break" => Ok(self.word(Statement::Break)),
            "continue" => Ok(self.word(Statement::Continue)),
            "halt" => Ok(self.word(Statement::Halt)),
            "enter_critical" => Ok(self.word(Statement::EnterCritical)),
            "exit_critical" => Ok(self.word(Statement::ExitCritical)),
            _ => self.assignment_or_expression(),
        }
    }

    fn word(&mut self, statement: Statement) -> Statement {
        self.advance();
        statement
    }

    fn leave(&mut self) -> Result<Statement, CompileError> {
        let line = self.position().line;
        self.advance();
        // The one place where a line's end counts: `return` alone, followed by another statement.
        let alone = self.position().line != line
            || *self.peek() == Token::End
            || self.is_word("end")
            || self.is_symbol(";");
        Ok(Statement::Return(if alone {
            None
        } else {
            Some(self.expression()?)
        }))
    }

    fn declaration(&mut self, scope: Scope) -> Result<Statement, CompileError> {
        self.advance();
        let name = self.expect_name()?;
        self.expect_symbol("=")?;
        Ok(Statement::Assign {
            scope,
            name,
            indices: Vec::new(),
            value: self.expression()?,
        })
    }

    fn assignment_or_expression(&mut self) -> Result<Statement, CompileError> {
        if matches!(self.peek_after(1), Token::Symbol("=")) {
            let name = self.expect_name()?;
            self.advance();
            return Ok(Statement::Assign {
                scope: Scope::Plain,
                name,
                indices: Vec::new(),
                value: self.expression()?,
            });
        }
        let left = self.expression()?;
        if !self.is_symbol("=") {
            return Ok(Statement::Expression(left));
        }
        let Expression::Index(array, indices) = left.expression else {
            return Err(left.position.error("only a variable can be assigned to"));
        };
        let Expression::Name(name) = array.expression else {
            return Err(left
                .position
                .error("only an element of a variable can be assigned to"));
        };
        self.advance();
        Ok(Statement::Assign {
            scope: Scope::Plain,
            name,
            indices,
            value: self.expression()?,
        })
    }

    fn branch(&mut self) -> Result<Statement, CompileError> {
        self.advance();
        let mut arms = Vec::new();
        loop {
            let condition = self.expression()?;
            self.expect_symbol(":")?;
            arms.push((condition, self.block()?));
            if self.take_word("elif") {
                continue;
            }
            let mut otherwise = Vec::new();
            if self.take_word("else") {
                self.expect_symbol(":")?;
                otherwise = self.block()?;
            }
            self.expect_word("end")?;
            return Ok(Statement::If(arms, otherwise));
        }
    }

    fn function(&mut self, kind: FunctionKind) -> Result<Function, CompileError> {
        let position = self.position();
        self.advance();
        let name = self.expect_name()?;
        let mut parameters: Vec<(String, Option<Located>)> = Vec::new();
        self.expect_symbol("(")?;
        while !self.take_symbol(")") {
            let name = self.expect_name()?;
            let default = if self.take_symbol("=") {
                Some(self.expression()?)
            } else {
                None
            };
            parameters.push((name, default));
            if !self.take_symbol(",") && !self.is_symbol(")") {
                self.expect_symbol(",")?;
            }
        }
        self.expect_symbol(":")?;
        let body = self.block()?;
        self.expect_word("end")?;
        Ok(Function {
            kind,
            name,
            parameters,
            body,
            position,
        })
    }
}

fn describe(token: &Token) -> String {
    match token {
        Token::Name(name) => format!("{name:?}"),
        Token::Integer(n) => n.to_string(),
        Token::Float(x) => x.to_string(),
        Token::Text(_) => "a text".to_owned(),
        Token::Symbol(s) => format!("{s:?}"),
        Token::End => "the end of the program".to_owned(),
    }
}
