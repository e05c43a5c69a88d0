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
                        (row.text(id).to_owned(), row.number, number)
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
fn a_first_line_for_spreadsheets_is_no_header() {
    let mut table = table("sep=,\r\nid,b\r\n1,2\r\n").unwrap();
    let b = table.column("b").unwrap();
    assert_eq!(table.next_row().unwrap().unwrap().number(b).unwrap(), 2.0);
}

#[test]
fn messages_name_file_row_line_column_text_and_remedy() {
    let cases = [
        ("", "b", &["poses.csv is empty", "header row"][..]),
        ("id,b\n", "b", &["no row", "add at least one"]),
        ("id,c\n1,2\n", "b", &["line 1", "`b`", "id, c", "add"]),
        ("id;b\n1;2,5\n", "b", &["line 1", "semicolons", "save the file with commas"]),
        ("id\tb\n1\t2\n", "b", &["line 1", "tabs", "save the file with commas"]),
        ("id b\n1 2\n", "b", &["line 1", "blanks", "save the file with commas"]),
        ("sep=;\nid;b\n1;2\n", "b", &["line 1", "semicolons", "save the file with commas"]),
        ("# id,b\n1,2\n", "id", &["`id`", "the # before the header"]),
        ("# a table of mine\nid,b\n1,2\n", "b", &["row 1 (line 2)", "remove lines of comments"]),
        ("id,b\n1,2,5\n", "b", &["row 1 (line 2)", "3 fields", "decimals begin with a point"]),
        ("1,2\n1,2\n", "b", &["`b`", "names of the columns above the numbers"]),
        ("ID,TX_MM\n1,2\n", "tx_mm", &["`tx_mm`", "rename TX_MM"]),
        ("id,tx (mm)\n1,2\n", "tx_mm", &["`tx_mm`", "rename tx (mm)"]),
        ("id,i_x1_1_na,i_x1_0_na\n1,2,3\n", "i_x1_0_a", &["`i_x1_0_a`", "rename i_x1_0_na"]),
        ("id,qx,qy,qz,qw\n1,0,0,0,1\n", "rx_rad", &["`rx_rad`", "rotation vectors", "rotation_vectors"]),
        ("b,b\n1,2\n", "b", &["line 1", "`b`", "twice", "rename"]),
        ("id,b\n1,2\n2,2 mm\n", "b", &["row 2 (line 3)", "`b`", "`2 mm`", "give one like"]),
        ("id,b\r\n1,2\r\n2,2 mm\r\n", "b", &["row 2 (line 3)", "`2 mm`"]),
        ("id,b\r1,2\r2,2 mm\r", "b", &["row 2 (", "`2 mm`"]),
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
fn what_has_no_end_is_refused_before_it_is_all_in_memory() {
    for begin in ["", "id,b\n1,\""] {
        // 16 EiB of no line feed.
        let endless = io::Cursor::new(begin).chain(io::repeat(b'x'));
        let message = TableReader::new("poses.csv", endless).err().unwrap().to_string();
        let line = 1 + begin.matches('\n').count();
        assert!(message.contains(&format!("line {line}: a row of more than 1048576 bytes")), "{message}");
    }
    let mut three = table("id,b\n1,2\n3,4\n5,6\n").unwrap().of_at_most(2);
    assert_eq!(three.next_rows(9).unwrap().len(), 2);
    let message = three.next_rows(9).err().unwrap().to_string();
    assert!(message.contains("more than 2 rows") && message.contains("fewer"), "{message}");
    // Long rows come a few at a time.
    let long = "x".repeat(MAX_ROW_BYTES as usize / 2);
    let mut many = table(&format!("id\n{}", format!("{long}\n").repeat(9))).unwrap();
    assert_eq!([9; 4].map(|most| many.next_rows(most).unwrap().len()), [2; 4]);
}
