//! Text to tokens. Newlines do not end a statement: statements are separated by their tokens.

use crate::error::CompileError;

/// Longest text of a program, bytes.
pub const PROGRAM_BYTES_MAX: usize = 1 << 20;

/// Position of a token, counted from 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    pub line: u32,
    pub column: u32,
}

impl Position {
    pub fn error(self, reason: impl Into<String>) -> CompileError {
        CompileError {
            line: self.line,
            column: self.column,
            reason: reason.into(),
            unknown_name: false,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub enum Token {
    Name(String),
    Integer(i32),
    Float(f64),
    Text(String),
    Symbol(&'static str),
    End,
}

/// Longest match first.
const SYMBOLS: [&str; 21] = [
    "==", "!=", "<=", ">=", "(", ")", "[", "]", "{", "}", ",", ":", ";", "=", "<", ">", "+", "-",
    "*", "/", "%",
];

pub fn tokens(text: &str) -> Result<Vec<(Token, Position)>, CompileError> {
    let mut position = Position { line: 1, column: 1 };
    if text.len() > PROGRAM_BYTES_MAX {
        return Err(position.error(format!(
            "a program of {} bytes; at most {PROGRAM_BYTES_MAX} are accepted",
            text.len()
        )));
    }
    let bytes = text.as_bytes();
    let mut out = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let start = at;
        match bytes[at] {
            b'\n' => {
                at += 1;
                position.line += 1;
                position.column = 1;
                continue;
            }
            b if b.is_ascii_whitespace() => at += 1,
            b'#' => at = end_of(bytes, at, |b| b != b'\n'),
            b'"' => {
                at = end_of(bytes, at + 1, |b| b != b'"' && b != b'\n');
                if bytes.get(at) != Some(&b'"') {
                    return Err(position.error("a text without its closing quote"));
                }
                let inner = text.get(start + 1..at).unwrap_or_default();
                out.push((Token::Text(inner.to_owned()), position));
                at += 1;
            }
            b if b.is_ascii_alphabetic() || b == b'_' => {
                at = end_of(bytes, at, |b| b.is_ascii_alphanumeric() || b == b'_');
                out.push((Token::Name(text[start..at].to_owned()), position));
            }
            b if b.is_ascii_digit() || b == b'.' => {
                at = end_of_number(bytes, at);
                out.push((number(&text[start..at], position)?, position));
            }
            _ => {
                let rest = &bytes[at..];
                let symbol = SYMBOLS.iter().find(|s| rest.starts_with(s.as_bytes()));
                let Some(symbol) = symbol else {
                    let c = text[at..].chars().next().unwrap_or('?');
                    return Err(position.error(format!("{c:?} has no meaning here")));
                };
                out.push((Token::Symbol(symbol), position));
                at += symbol.len();
            }
        }
        position.column += (at - start) as u32;
    }
    out.push((Token::End, position));
    Ok(out)
}

fn end_of(bytes: &[u8], from: usize, belongs: impl Fn(u8) -> bool) -> usize {
    let rest = bytes[from..].iter().position(|b| !belongs(*b));
    rest.map_or(bytes.len(), |n| from + n)
}

fn end_of_number(bytes: &[u8], from: usize) -> usize {
    let mut at = end_of(bytes, from, |b| b.is_ascii_digit() || b == b'.');
    if matches!(bytes.get(at), Some(b'e' | b'E')) {
        let digits = at + 1 + usize::from(matches!(bytes.get(at + 1), Some(b'+' | b'-')));
        if bytes.get(digits).is_some_and(u8::is_ascii_digit) {
            at = end_of(bytes, digits, |b| b.is_ascii_digit());
        }
    }
    at
}

fn number(text: &str, position: Position) -> Result<Token, CompileError> {
    if let Ok(integer) = text.parse::<i32>() {
        return Ok(Token::Integer(integer));
    }
    match text.parse::<f64>() {
        Ok(float) if float.is_finite() => Ok(Token::Float(float)),
        _ => Err(position.error(format!("{text:?} is not a number"))),
    }
}
