//! CSV: one row per scan, with the columns of `solve` and those of a stream.

use std::io;
use std::io::Write;

use super::columns::{Device, Get, PoseColumn, columns};
use super::{Accounts, Sink};
use slitpose_tracking::pipeline::Record;

pub(super) struct Csv<W: Write> {
    writer: csv::Writer<W>,
    columns: Vec<PoseColumn>,
    device: Device,
    begun: bool,
    field: String,
}

impl<W: Write> Csv<W> {
    pub(super) fn new(output: W) -> Self {
        let (writer, field) = (csv::Writer::from_writer(output), String::new());
        Self { writer, columns: columns(), device: Device::default(), begun: false, field }
    }

    fn begin(&mut self) -> io::Result<()> {
        if !std::mem::replace(&mut self.begun, true) {
            self.writer.write_record(self.columns.iter().map(|(name, _)| name))?;
        }
        Ok(())
    }
}

impl<W: Write> Sink for Csv<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        use std::fmt::Write;
        self.begin()?;
        let Self { writer, columns, device, field, .. } = self;
        let row = device.row(record);
        for (_, get) in &*columns {
            field.clear();
            // Writing to a String cannot fail.
            let _ = match get {
                Get::Integer(get) => get(&row).map_or(Ok(()), |value| write!(field, "{value}")),
                Get::Number(get) => get(&row).map_or(Ok(()), |value| write!(field, "{value:?}")),
                Get::Word(get) => field.write_str(&get(&row)),
                Get::Flag(get) => write!(field, "{}", get(&row)),
            };
            writer.write_field(&*field)?;
        }
        Ok(writer.write_record(None::<&[u8]>)?)
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.writer.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.begin()?;
        self.writer.flush()
    }
}
