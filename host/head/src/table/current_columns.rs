//! The columns that hold currents: `i_x1_0_a,i_x2_0_a,i_x1_1_a,…`.

use slitpose_model::Pair;

use super::reader::{Column, Row, TableError, TableReader};

/// Where a table keeps the two currents of each cell.
#[derive(Clone, Debug)]
pub struct CurrentColumns {
    cells: Vec<[Column; 2]>,
}

impl CurrentColumns {
    /// Finds the columns of all cells by name.
    pub fn find(table: &TableReader, cells: usize) -> Result<Self, TableError> {
        let pair =
            |cell: usize| Ok([table.column(&format!("i_x1_{cell}_a"))?, table.column(&format!("i_x2_{cell}_a"))?]);
        Ok(Self { cells: (0..cells).map(pair).collect::<Result<_, _>>()? })
    }

    /// The currents of one cell in a row.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn pair(&self, row: &Row<'_>, cell: usize) -> Result<Pair<f64>, TableError> {
        let [i_x1, i_x2] = self.cells[cell];
        Ok(Pair { i_x1_a: row.number(i_x1)?, i_x2_a: row.number(i_x2)? })
    }
}
