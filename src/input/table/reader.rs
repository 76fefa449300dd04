//! Rows of a table as blocks of points: looked through once, then handed out in any order.

use std::fmt::Debug;

use glam::DVec3;
use rayon::prelude::*;

use super::plan::RowPlan;
use crate::input::crs::Crs;
use crate::input::foreign::{
    CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, RowBlock, RowBuffer, ScanPart,
    Unread,
};
use crate::input::placing::decimal_lattice;
use crate::points::Scalar;

/// Rows of a file in blocks of at most `MOST_BLOCK_ROWS`, each of packed little-endian fields.
pub trait Rows: Debug + Send + Sync {
    /// Number of blocks.
    fn block_count(&self) -> usize;

    /// Replaces `packed` by the rows of a block. Returns the most digits after the point among its
    /// coordinates, and nothing where they are not decimal text or one has very many.
    fn read(&self, block: usize, packed: &mut Vec<u8>) -> Result<Option<u32>, ForeignFault>;

    /// What is wrong with the first of the rows that were left out so far, which only happens where
    /// damaged ones are to be.
    fn left_out(&self) -> Option<ForeignFault> {
        None
    }
}

/// What one look at a block tells.
#[derive(Clone, Copy, Debug)]
struct Survey {
    rows: u64,
    kept: u64,
    low: DVec3,
    high: DVec3,
    digits: Option<u32>,
}

/// What a format knows about its table before rows are read.
#[derive(Debug)]
pub struct TableFacts {
    /// Format and variant.
    pub format: String,
    /// Whether the file declares coordinates in single precision.
    pub is_single: bool,
    /// Where it was taken from.
    pub part: ScanPart,
    /// Whether coordinates have the pose applied.
    pub applies_pose: bool,
    /// What is left out.
    pub skipped: Vec<(String, u64)>,
    /// What is odd.
    pub warnings: Vec<String>,
    /// Rows that the file claims, if damaged ones are to be left out; else none may be damaged.
    pub salvaged: Option<u64>,
}

/// A table as a scan.
#[derive(Debug)]
pub struct TableReader<R> {
    rows: R,
    plan: RowPlan,
    facts: ForeignFacts,
    /// Coordinates are rounded to single precision: text that is declared so.
    rounds: bool,
    applies_pose: bool,
}

/// Opens a table behind the interface that all formats have.
pub fn open_table(
    rows: impl Rows + 'static,
    plan: RowPlan,
    facts: TableFacts,
) -> Result<Box<dyn ForeignReader>, ForeignFault> {
    Ok(Box::new(TableReader::open(rows, plan, facts)?))
}

impl<R: Rows> TableReader<R> {
    /// Looks through all rows.
    pub fn open(rows: R, plan: RowPlan, table: TableFacts) -> Result<Self, ForeignFault> {
        let blocks = 0..rows.block_count();
        let look = |packed: &mut Vec<u8>, block| survey(&rows, &plan, block, packed);
        let surveys: Vec<Result<Survey, ForeignFault>> =
            blocks.into_par_iter().map_init(Vec::new, look).collect();
        let mut fault = None;
        let take = |survey| match survey {
            Err(found) if table.salvaged.is_some() => {
                fault.get_or_insert(found);
                Ok(Survey::NOTHING)
            }
            survey => survey,
        };
        let surveys = surveys.into_iter().map(take).collect::<Result<Vec<Survey>, _>>()?;
        let (mut points, mut total) = (0, 0);
        let mut blocks = Vec::with_capacity(surveys.len());
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let mut digits = Some(0);
        for survey in &surveys {
            blocks.push(RowBlock { first_point: points, points: survey.kept, part: 0 });
            points += survey.kept;
            total += survey.rows;
            bounds = [bounds[0].min(survey.low), bounds[1].max(survey.high)];
            digits = digits.zip(survey.digits).map(|(a, b)| a.max(b));
        }
        if points == 0 {
            bounds = [DVec3::ZERO; 2];
        }
        let is_integer = |scalar| !matches!(scalar, Scalar::F32 | Scalar::F64);
        let is_whole = plan.axes.iter().all(|&(_, scalar)| is_integer(scalar));
        let digits = if is_whole { Some(0) } else { digits.filter(|_| !surveys.is_empty()) };
        let decimal = digits.filter(|&digits| decimal_lattice(bounds, digits).is_some());
        let coordinates = match decimal {
            Some(digits) => CoordinateKind::Decimal { digits },
            None if table.is_single => CoordinateKind::F32,
            None => CoordinateKind::F64,
        };
        let rounds = coordinates == CoordinateKind::F32;
        if rounds {
            let nearest = |v: DVec3| v.as_vec3().as_dvec3();
            bounds = bounds.map(nearest);
        }
        let lost = table.salvaged.map_or(0, |claimed| claimed.saturating_sub(total));
        let fault = rows.left_out().or(fault);
        let reason = fault.map_or("the file ends before them".into(), |fault| fault.to_string());
        let unread = Unread { part: 0, reason, points: lost };
        let facts = ForeignFacts {
            format: table.format,
            points,
            dropped_points: total - points,
            bounds,
            coordinates,
            columns: plan.columns.clone(),
            parts: vec![ScanPart { points: total + lost, ..table.part }],
            blocks,
            crs: Crs::default(),
            skipped: table.skipped,
            warnings: table.warnings,
            unread: if lost > 0 { vec![unread] } else { Vec::new() },
        };
        Ok(TableReader { rows, plan, facts, rounds, applies_pose: table.applies_pose })
    }
}

impl Survey {
    /// Of a block that cannot be read.
    const NOTHING: Survey = Survey {
        rows: 0,
        kept: 0,
        low: DVec3::INFINITY,
        high: DVec3::NEG_INFINITY,
        digits: Some(0),
    };
}

fn survey(
    rows: &impl Rows,
    plan: &RowPlan,
    block: usize,
    packed: &mut Vec<u8>,
) -> Result<Survey, ForeignFault> {
    let digits = rows.read(block, packed)?;
    let mut survey =
        Survey { rows: 0, kept: 0, low: DVec3::INFINITY, high: DVec3::NEG_INFINITY, digits };
    for row in packed.chunks_exact(plan.row_bytes) {
        let position = plan.position(row);
        survey.rows += 1;
        if position.is_finite() {
            survey.kept += 1;
            survey.low = survey.low.min(position);
            survey.high = survey.high.max(position);
        }
    }
    Ok(survey)
}

impl<R: Rows> ForeignReader for TableReader<R> {
    fn facts(&self) -> &ForeignFacts {
        &self.facts
    }

    fn applies_poses(&self) -> bool {
        self.applies_pose
    }

    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        let RowBuffer { positions, attributes, scratch } = rows;
        positions.clear();
        attributes.clear();
        self.rows.read(block, scratch)?;
        for row in scratch.chunks_exact(self.plan.row_bytes) {
            let position = self.plan.position(row);
            if position.is_finite() {
                let nearest = position.as_vec3().as_dvec3();
                positions.push(if self.rounds { nearest } else { position });
                self.plan.append_attributes(row, attributes);
            }
        }
        Ok(())
    }
}
