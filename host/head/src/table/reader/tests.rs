use super::*;

fn table(text: &str) -> Result<TableReader, TableError> {
    TableReader::new("poses.csv", io::Cursor::new(text.as_bytes().to_vec()))
}

fn first_error(text: &str, column: &str) -> String {
    let read = || {
        let mut table = table(text)?;
        let column = table.column(column)?;
        while let Some(row) = table.next_row()? {
            row.number(column)?;
        }
        Ok::<_, TableError>(())
    };
    read().unwrap_err().to_string()
}

#[test]
fn columns_are_found_in_any_order_and_extra_ones_ignored() {
    let mut table = table("extra, b ,id\nx,2.5,first\n\ny, -1e-3,second\n").unwrap();
    let (id, b) = (table.column("id").unwrap(), table.column("b").unwrap());
    let row = table.next_row().unwrap().unwrap();
    assert_eq!((row.text(id), row.number(b).unwrap()), ("first", 2.5));
    let row = table.next_row().unwrap().unwrap();
    assert_eq!((row.text(id), row.number(b).unwrap()), ("second", -1e-3));
    assert!(table.next_row().unwrap().is_none());
}

#[test]
fn many_rows_at_a_time_are_those_that_come_one_by_one_up_to_the_same_error() {
    let text = "id, b\n1,2.5\n 2 ,\" -3 \"\n3,x\n4,5\n5\n6,7\n";
    for most in 1..8 {
        let mut table = table(text).unwrap();
        let (id, b) = (table.column("id").unwrap(), table.column("b").unwrap());
        let mut read = Vec::new();
        let damage = loop {
            match table.next_rows(most) {
                Ok(rows) => {
                    assert!((1..=most).contains(&rows.len()) && !rows.is_empty(), "{most}");
                    let line = |row: Row<'_>| {
                        let number = row.number(b).map_err(|error| error.to_string());
                        (row.text(id).to_owned(), row.number_of_row(), number)
                    };
                    read.extend(rows.iter().map(line));
                }
                Err(error) => break error.to_string(),
            }
        };
        let (rows, numbers): (Vec<_>, Vec<_>) = read.into_iter().map(|(id, row, number)| ((id, row), number)).unzip();
        assert_eq!(rows, [("1", 1), ("2", 2), ("3", 3), ("4", 4)].map(|(id, row)| (id.to_owned(), row)), "{most}");
        assert_eq!([&numbers[0], &numbers[1], &numbers[3]], [&Ok(2.5), &Ok(-3.0), &Ok(5.0)], "{most}");
        assert!(numbers[2].as_ref().unwrap_err().contains("row 3 (line 4)"), "{most}: {:?}", numbers[2]);
        assert!(damage.contains("row 5 (line 6)"), "{most}: {damage}");
    }
}

#[test]
fn a_byte_order_mark_is_no_part_of_the_first_name() {
    let table = table("\u{feff}id,b\n1,2\n").unwrap();
    assert_eq!(table.column("id").unwrap(), Column(0));
}

#[test]
fn messages_name_file_row_line_column_text_and_remedy() {
    let cases = [
        ("", "b", &["poses.csv is empty", "header row"][..]),
        ("id,b\n", "b", &["no row", "add at least one"]),
        ("id,c\n1,2\n", "b", &["line 1", "`b`", "id, c", "add"]),
        ("id;b\n1;2,5\n", "b", &["line 1", "semicolons", "save the file with commas"]),
        ("id\tb\n1\t2\n", "b", &["line 1", "tabs", "save the file with commas"]),
        ("b,b\n1,2\n", "b", &["line 1", "`b`", "twice", "rename"]),
        ("id,b\n1,2\n2,2 mm\n", "b", &["row 2 (line 3)", "`b`", "`2 mm`", "give one like"]),
        ("id,b\r\n1,2\r\n2,2 mm\r\n", "b", &["row 2 (line 3)", "`2 mm`"]),
        ("id,b\n1,\n", "b", &["row 1 (line 2)", "``", "give one like"]),
        ("id,b\n1,nan\n", "b", &["row 1", "`nan`", "finite"]),
        ("id,b\n1,1e999\n", "b", &["row 1", "`1e999`", "finite"]),
        ("id,b\n1,2\n3\n", "b", &["row 2 (line 3)", "1 fields", "header has 2", "correct"]),
    ];
    for (text, column, parts) in cases {
        let message = first_error(text, column);
        for part in parts {
            assert!(message.contains(part), "{text:?}: `{part}` is not in: {message}");
        }
    }
}

#[test]
fn rows_may_be_long_and_have_many_fields() {
    let names: Vec<String> = (0..200).map(|index| format!("column_{index}")).collect();
    let long = "x".repeat(5_000);
    let row = |value: &str| vec![value; names.len()].join(",");
    let mut table = table(&format!("{}\n{}\n{}", names.join(","), row("2.5"), row(&long))).unwrap();
    let last = table.column("column_199").unwrap();
    let rows = table.next_rows(5).unwrap();
    let found: Vec<&str> = rows.iter().map(|row| row.text(last)).collect();
    assert!(found == ["2.5", &long]);
}

#[test]
fn bytes_that_are_no_text_are_an_error_with_their_row() {
    let mut table = TableReader::new("poses.csv", io::Cursor::new(b"id,b\n1,2\n\xff,3\n")).unwrap();
    table.next_row().unwrap();
    let message = table.next_row().err().unwrap().to_string();
    assert!(message.contains("row 2 (line 3)") && message.contains("UTF-8"), "{message}");
}
