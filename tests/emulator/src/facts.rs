//! Numbers of the microcontroller, its board and the detectors from outside the project.
//!
//! Image and emulator come from one reading of the manual: an error of reading could be in both. The table,
//! `tests/data/stm32g474/facts.csv`, names a source for each number. The emulator has its registers and bits from there
//! (`build.rs`), and tests compare the image with it, which does not read it.

const TABLE: &str = include_str!("../../data/stm32g474/facts.csv");

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fact {
    /// ST's symbol where there is one.
    pub name: &'static str,
    /// Number, pin or contact.
    pub value: &'static str,
    /// Unit of a number, or what the value is.
    pub unit: &'static str,
    /// Document and place; `tests/data/stm32g474/README.md` has the keys.
    pub source: &'static str,
}

/// All rows, in their order.
pub fn all() -> impl Iterator<Item = Fact> {
    TABLE.lines().skip(1).map(|row| {
        let fields: Vec<&'static str> = row.split(',').collect();
        let [name, value, unit, source] = fields[..] else { panic!("four fields, not `{row}`") };
        Fact { name, value, unit, source }
    })
}

/// The row called `name`.
pub fn fact(name: &str) -> Fact {
    all().find(|fact| fact.name == name).unwrap_or_else(|| panic!("no fact is called `{name}`"))
}

/// Value of `name`: bits, an address, an offset or a whole number.
pub fn bits(name: &str) -> u32 {
    let value = fact(name).value;
    let number = value.strip_prefix("0x").map_or_else(|| value.parse(), |digits| u32::from_str_radix(digits, 16));
    number.unwrap_or_else(|_| panic!("`{name}` is {value}"))
}

/// Value of `name` in its unit.
pub fn number(name: &str) -> f64 {
    let value = fact(name).value;
    value.parse().unwrap_or_else(|_| panic!("`{name}` is {value}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn rows_have_a_value_a_unit_and_a_source_of_their_own_name() {
        let mut names = BTreeSet::new();
        for Fact { name, value, unit, source } in all() {
            assert!(names.insert(name), "`{name}` stands twice");
            assert!([name, value, unit, source].into_iter().all(|field| !field.is_empty()), "{name}");
        }
        assert!(names.len() > 500, "{} facts", names.len());
        assert_eq!((bits("FLASH_BASE"), number("t_LATR_ckmode_11")), (0x0800_0000, 2.125));
    }
}
