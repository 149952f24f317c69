//! Texts that are not programs are refused within bounds, without a panic.

use proptest::prelude::*;

use crate::compile::Program;
use crate::error::CompileError;

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
