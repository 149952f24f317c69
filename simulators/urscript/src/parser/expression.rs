//! Expressions, by precedence.

use super::{CHAIN_MAX, Parser, describe};
use crate::error::CompileError;
use crate::lexer::{Position, Token};
use crate::syntax::{Binary, Call, Expression, Located};

impl Parser {
    pub(super) fn expression(&mut self) -> Result<Located, CompileError> {
        self.deeper(|parser| parser.binary(0))
    }

    /// Precedence climbing; `level` is the loosest operator taken here.
    fn binary(&mut self, level: u8) -> Result<Located, CompileError> {
        let mut left = self.unary(level)?;
        let mut operators = 0;
        while let Some((operator, strength)) = self.operator() {
            if strength < level {
                break;
            }
            let position = self.position();
            // The tree leans left as deep as the chain is long, and walking it recurses.
            operators += 1;
            if operators > CHAIN_MAX {
                return Err(position.error(format!("more than {CHAIN_MAX} operators in a row")));
            }
            self.advance();
            let right = self.deeper(|parser| parser.binary(strength + 1))?;
            left = Located {
                expression: Expression::Binary(operator, Box::new(left), Box::new(right)),
                position,
            };
        }
        Ok(left)
    }

    fn operator(&self) -> Option<(Binary, u8)> {
        let spelt = match self.peek() {
            Token::Symbol(s) => s,
            Token::Name(n) => n.as_str(),
            _ => return None,
        };
        Some(match spelt {
            "or" => (Binary::Or, 0),
            "xor" => (Binary::Xor, 0),
            "and" => (Binary::And, 1),
            "==" => (Binary::Equal, 3),
            "!=" => (Binary::NotEqual, 3),
            "<" => (Binary::Less, 3),
            "<=" => (Binary::LessOrEqual, 3),
            ">" => (Binary::Greater, 3),
            ">=" => (Binary::GreaterOrEqual, 3),
            "+" => (Binary::Add, 4),
            "-" => (Binary::Subtract, 4),
            "*" => (Binary::Multiply, 5),
            "/" => (Binary::Divide, 5),
            "%" => (Binary::Remainder, 5),
            _ => return None,
        })
    }

    fn unary(&mut self, level: u8) -> Result<Located, CompileError> {
        let position = self.position();
        if self.take_word("not") {
            let inner = self.deeper(|parser| parser.binary(level.max(2)))?;
            return Ok(Located {
                expression: Expression::Not(Box::new(inner)),
                position,
            });
        }
        if self.take_symbol("-") {
            let inner = self.deeper(|parser| parser.unary(6))?;
            return Ok(Located {
                expression: Expression::Negate(Box::new(inner)),
                position,
            });
        }
        if self.take_symbol("+") {
            return self.deeper(|parser| parser.unary(6));
        }
        self.postfix()
    }

    fn postfix(&mut self) -> Result<Located, CompileError> {
        let mut value = self.primary()?;
        while self.is_symbol("[") {
            let position = self.position();
            self.advance();
            let indices = self.items("]")?;
            value = Located {
                expression: Expression::Index(Box::new(value), indices),
                position,
            };
            self.check_chain(position, &value)?;
        }
        Ok(value)
    }

    /// `x[0][0][0]...` nests without recursion here, but walking it later recurses.
    fn check_chain(&self, position: Position, value: &Located) -> Result<(), CompileError> {
        let mut length = 0;
        let mut inner = &value.expression;
        while let Expression::Index(array, _) = inner {
            inner = &array.expression;
            length += 1;
        }
        if length > 4 {
            return Err(position.error("more than 4 indices in a row"));
        }
        Ok(())
    }

    fn items(&mut self, close: &str) -> Result<Vec<Located>, CompileError> {
        let mut items = Vec::new();
        while !self.take_symbol(close) {
            items.push(self.expression()?);
            if !self.take_symbol(",") && !self.is_symbol(close) {
                self.expect_symbol(close)?;
            }
        }
        Ok(items)
    }

    fn primary(&mut self) -> Result<Located, CompileError> {
        let position = self.position();
        let expression = match self.peek().clone() {
            Token::Integer(n) => {
                self.advance();
                Expression::Integer(n)
            }
            Token::Float(x) => {
                self.advance();
                Expression::Float(x)
            }
            Token::Text(text) => {
                self.advance();
                Expression::Text(text)
            }
            Token::Symbol("(") => {
                self.advance();
                let inner = self.expression()?;
                self.expect_symbol(")")?;
                return Ok(inner);
            }
            Token::Symbol("[") => {
                self.advance();
                Expression::List(self.items("]")?)
            }
            Token::Name(name) => match name.as_str() {
                "True" | "true" => {
                    self.advance();
                    Expression::Bool(true)
                }
                "False" | "false" => {
                    self.advance();
                    Expression::Bool(false)
                }
                "run" => {
                    self.advance();
                    Expression::Run(self.call()?)
                }
                _ if matches!(self.peek_after(1), Token::Symbol("(")) => {
                    Expression::Call(self.call()?)
                }
                // `p[0]` is an element of a variable called p, `p[0, 0, 0, 0, 0, 0]` is a pose.
                "p" if matches!(self.peek_after(1), Token::Symbol("[")) => {
                    self.advance();
                    self.advance();
                    let items = self.items("]")?;
                    if items.len() == 6 {
                        Expression::Pose(items)
                    } else {
                        let array = Located {
                            expression: Expression::Name("p".to_owned()),
                            position,
                        };
                        Expression::Index(Box::new(array), items)
                    }
                }
                _ => Expression::Name(self.expect_name()?),
            },
            other => {
                return Err(
                    position.error(format!("a value belongs here, not {}", describe(&other)))
                );
            }
        };
        Ok(Located {
            expression,
            position,
        })
    }

    fn call(&mut self) -> Result<Call, CompileError> {
        let name = self.expect_name()?;
        self.expect_symbol("(")?;
        let mut arguments = Vec::new();
        while !self.take_symbol(")") {
            let keyword = match (self.peek(), self.peek_after(1)) {
                (Token::Name(name), Token::Symbol("=")) => {
                    let name = name.clone();
                    self.advance();
                    self.advance();
                    Some(name)
                }
                _ => None,
            };
            arguments.push((keyword, self.expression()?));
            if !self.take_symbol(",") && !self.is_symbol(")") {
                self.expect_symbol(",")?;
            }
        }
        Ok(Call { name, arguments })
    }
}
