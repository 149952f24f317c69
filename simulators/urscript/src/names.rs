//! Names in a program: functions, global variables, and the places of arguments.

use std::collections::HashSet;

use crate::error::CompileError;
use crate::lexer::Position;
use crate::syntax::{Block, Call, Function, Located, Scope, Statement};

pub fn collect_functions<'a>(block: &'a Block, out: &mut Vec<&'a Function>) {
    for_each_statement(block, &mut |statement, _| {
        if let Statement::Function(function) = statement {
            out.push(function);
            collect_functions(&function.body, out);
        }
    });
}

/// All statements of a block and of its ifs and whiles, not those of functions inside.
pub fn for_each_statement<'a>(block: &'a Block, visit: &mut dyn FnMut(&'a Statement, Position)) {
    for (statement, position) in block {
        visit(statement, *position);
        match statement {
            Statement::If(arms, otherwise) => {
                for (_, body) in arms {
                    for_each_statement(body, visit);
                }
                for_each_statement(otherwise, visit);
            }
            Statement::While(_, body) => for_each_statement(body, visit),
            _ => {}
        }
    }
}

pub fn global_names(main: &Block, functions: &[&Function]) -> Vec<String> {
    let mut seen = HashSet::new();
    let mut order = Vec::new();
    let mut add = |name: &String| {
        if seen.insert(name.clone()) {
            order.push(name.clone());
        }
    };
    for_each_statement(main, &mut |statement, _| {
        if let Statement::Assign { name, .. } = statement {
            add(name);
        }
    });
    for function in functions {
        for_each_statement(&function.body, &mut |statement, _| {
            if let Statement::Assign {
                name,
                scope: Scope::Global,
                ..
            } = statement
            {
                add(name);
            }
        });
    }
    order
}

/// Arguments in the order of the parameters.
pub fn place<'c>(
    call: &'c Call,
    parameters: &[&str],
    position: Position,
) -> Result<Vec<Option<&'c Located>>, CompileError> {
    let mut places: Vec<Option<&Located>> = vec![None; parameters.len()];
    for (i, (keyword, value)) in call.arguments.iter().enumerate() {
        let at = match keyword {
            Some(keyword) => parameters.iter().position(|p| p == keyword),
            None => Some(i),
        };
        match at.and_then(|at| places.get_mut(at)) {
            Some(place @ None) => *place = Some(value),
            Some(Some(_)) => {
                return Err(position.error(format!("{} gets an argument twice", call.name)));
            }
            None => {
                return Err(position.error(format!(
                    "{} takes {} ({}), not {}",
                    call.name,
                    parameters.len(),
                    parameters.join(", "),
                    keyword
                        .clone()
                        .unwrap_or_else(|| call.arguments.len().to_string())
                )));
            }
        }
    }
    Ok(places)
}

pub fn unknown(name: &str, position: Position) -> CompileError {
    CompileError {
        unknown_name: true,
        ..position.error(format!("compile_error_name_not_found:{name}:"))
    }
}
