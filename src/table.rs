//! Tables and paragraphs on standard output, as wide as the terminal and 80 columns otherwise.

use std::io::{self, IsTerminal};

use comfy_table::presets::NOTHING;
use comfy_table::{Cell, CellAlignment, ColumnConstraint, ContentArrangement, Table};

/// Width of output that goes to a file or a pipe.
const WIDTH: u16 = 80;

/// Columns of the terminal on standard output, or 80.
fn width() -> u16 {
    terminal_size::terminal_size().map_or(WIDTH, |(columns, _)| columns.0)
}

fn empty() -> Table {
    let mut table = Table::new();
    table
        .load_preset(NOTHING)
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(width());
    table
}

/// A table with a header. Columns whose name begins with `>` are aligned to the right; the sign
/// itself is not shown. Cells that do not fit are wrapped, except for names in the first column.
pub struct Columns {
    table: Table,
    right: Vec<bool>,
    /// Widest cell of the first column, characters.
    first: usize,
}

/// Names up to this width are not wrapped.
const NAME_MAX: usize = 38;

impl Columns {
    /// A table without rows.
    pub fn new(names: &[&str]) -> Self {
        let right: Vec<bool> = names.iter().map(|name| name.starts_with('>')).collect();
        let mut columns = Self {
            table: empty(),
            right,
            first: 0,
        };
        if names.iter().any(|name| !name.trim_matches('>').is_empty()) {
            let header: Vec<Cell> = columns.cells(names.iter().map(|n| n.trim_start_matches('>')));
            columns.table.set_header(header);
        }
        columns
    }

    /// Adds a row.
    pub fn row<T: ToString>(&mut self, cells: impl IntoIterator<Item = T>) {
        let cells = self.cells(cells);
        let first = cells
            .first()
            .map_or(0, |cell| cell.content().chars().count());
        self.first = self.first.max(first);
        self.table.add_row(cells);
    }

    fn cells<T: ToString>(&self, cells: impl IntoIterator<Item = T>) -> Vec<Cell> {
        let right = self.right.iter().chain(std::iter::repeat(&false));
        cells
            .into_iter()
            .zip(right)
            .map(|(cell, right)| {
                let alignment = if *right {
                    CellAlignment::Right
                } else {
                    CellAlignment::Left
                };
                Cell::new(cell).set_alignment(alignment)
            })
            .collect()
    }

    /// Prints the table with this indent.
    pub fn print(self, indent: u16) {
        println!("{}", self.text(indent));
    }

    /// The table as text, with this indent.
    pub fn text(mut self, indent: u16) -> String {
        let last = self.right.len().saturating_sub(1);
        for (index, column) in self.table.column_iter_mut().enumerate() {
            let before = if index == 0 { indent } else { 0 };
            column.set_padding((before, if index == last { 0 } else { 2 }));
            if index == 0 && self.first <= NAME_MAX {
                column.set_constraint(ColumnConstraint::ContentWidth);
            }
        }
        self.table.trim_fmt()
    }
}

/// Prints a text with an indent, wrapped at words.
pub fn paragraph(indent: u16, text: &str) {
    println!("{}", wrapped(indent, text));
}

/// Prints one line of a message with an indent: wrapped at words on a terminal, in one piece
/// elsewhere, where programs search it.
pub fn message(indent: u16, line: &str) {
    if io::stdout().is_terminal() {
        // Excerpts of a file are aligned by their leading spaces.
        let text = line.trim_start();
        let spaces = u16::try_from(line.len() - text.len()).unwrap_or(0);
        paragraph(indent + spaces, text);
    } else {
        println!("{:1$}{line}", "", usize::from(indent));
    }
}

/// A text with an indent, wrapped at words.
pub fn wrapped(indent: u16, text: &str) -> String {
    let mut table = empty();
    table.add_row([text]);
    for column in table.column_iter_mut() {
        column.set_padding((indent, 0));
    }
    table.trim_fmt()
}
