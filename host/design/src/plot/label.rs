//! Labels with symbols: text between `$` is set as a formula, `$X_A$` as italic X with a
//! small A below. `_` takes the next letter or a group in braces.

/// A run of letters of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) text: String,
    pub(super) italic: bool,
    pub(super) subscript: bool,
}

/// Splits a label into runs.
pub(super) fn runs(label: &str) -> Vec<Run> {
    let mut runs = Vec::new();
    for (index, part) in label.split('$').enumerate() {
        if index % 2 == 0 {
            push(&mut runs, part, false, false);
        } else {
            formula(&mut runs, part);
        }
    }
    runs
}

fn formula(runs: &mut Vec<Run>, text: &str) {
    let mut rest = text;
    while let Some((before, after)) = rest.split_once('_') {
        push(runs, before, true, false);
        let (subscript, after) = match after.strip_prefix('{').and_then(|group| group.split_once('}')) {
            Some(group) => group,
            None => after.split_at(after.chars().next().map_or(0, char::len_utf8)),
        };
        push(runs, subscript, false, true);
        rest = after;
    }
    push(runs, rest, true, false);
}

fn push(runs: &mut Vec<Run>, text: &str, italic: bool, subscript: bool) {
    if !text.is_empty() {
        runs.push(Run { text: text.to_owned(), italic, subscript });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(label: &str) -> String {
        let mark = |run: Run| match (run.italic, run.subscript) {
            (true, _) => format!("/{}/", run.text),
            (_, true) => format!("[{}]", run.text),
            _ => run.text,
        };
        runs(label).into_iter().map(mark).collect()
    }

    #[test]
    fn formulas_are_split_into_letters_and_subscripts() {
        assert_eq!(plain("spot $X_A$ / mm"), "spot /X/[A] / mm");
        assert_eq!(plain("$I_{rel}(γ)$"), "/I/[rel]/(γ)/");
        assert_eq!(plain("no formula"), "no formula");
        assert_eq!(plain("$x_"), "/x/");
    }
}
