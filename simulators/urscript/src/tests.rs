//! Texts that are not programs are refused within bounds, without a panic.

use proptest::prelude::*;

use crate::compile::Program;
use crate::error::{CompileError, RuntimeError, ScriptError};

fn compile(text: &str) -> Result<Program, CompileError> {
    Program::compile(text, false)
}

#[test]
fn hostile_texts_are_refused() {
    let deep_parentheses = format!("x = {}1{}", "(".repeat(5000), ")".repeat(5000));
    let long_sum = format!("x = 1{}", " + 1".repeat(100_000));
    let deep_blocks = format!("{}{}", "if True:\n".repeat(5000), "end\n".repeat(5000));
    let indices = format!("x = y{}", "[0]".repeat(10_000));
    let minus = format!("x = {}1", "- ".repeat(100_000));
    for text in [deep_parentheses, long_sum, deep_blocks, indices, minus] {
        assert!(compile(&text).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_text_makes_it_panic(text in "[a-z0-9_ \\n\\[\\](){}:=+*/%<>!,.\"#-]{0,200}") {
        let _ = compile(&text);
    }
}

#[test]
fn a_runtime_error_names_the_place_the_value_and_what_is_allowed() {
    let error = RuntimeError {
        line: 2,
        column: 5,
        cause: ScriptError::ArgumentOutOfRange {
            function: "servoj",
            name: "gain",
            value: 3000.0,
            least: 100.0,
            most: 2000.0,
        },
    };
    assert_eq!(
        error.to_string(),
        "line 2, column 5: servoj: gain is 3000, but must be 100 to 2000"
    );
    assert!(!error.is_overrun());
}
