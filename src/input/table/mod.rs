//! Files that are tables: rows of named fields, as PLY and PCD have them.
//!
//! A format says where its rows stand and gives them as packed little-endian fields ([`Rows`]);
//! `plan` finds the coordinates, the colour and the columns among the fields; `reader` looks
//! through all rows once and hands them out in blocks.

mod ascii;
mod fixed;
mod plan;
mod reader;

pub(super) use ascii::{AsciiRows, Entry as AsciiEntry};
pub(super) use fixed::FixedRows;
pub(super) use plan::{Field, RowPlan, is_single, snake_case};
pub(super) use reader::{Rows, TableFacts, open_table};
