//! Light of other emitters: each cell is read with its own emitter alone, and along with each other one.
//!
//! Two emitters are lit in one slot. What a cell has more than by its own emitter alone is light of the other one,
//! through a gap in the baffles or by reflection. All pairs are lit in as few configurations as there are partners.

use slitpose_model::Pair;
use slitpose_protocol::{Level, Schedule};

use super::bench::{Bench, BenchError, sample};
use super::sampling;
use super::sampling::Expected;
use crate::device::Conversation;
use slitpose_head::finding::Finding;

/// Scans of each configuration: the mean of a word lit minus dark is then known to 0.05 codes of some 1 400.
const SCANS: usize = 200;

/// Share of a cell's own light, beyond the prediction of the scene, at which light of another emitter is too much: at
/// the end of a detector of 12 mm it moves the spot by 1 % of 6 mm, 60 µm, the position error of the detector itself
/// (S3932 data sheet, typical).
const TOLERANCE: f64 = 0.01;

/// Least share of the scene's light of a cell that is to be judged.
const LIT: f64 = 0.15;

/// Largest change of a cell's own light during the measurement.
const STILL: f64 = 3e-3;

pub(super) fn take(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let expected = bench.expected()?;
    let (mut board, _) = bench.connect()?;
    let schedule = bench.schedule()?;
    let alone = sampling::at(sampling::alone(&schedule), Level::NOMINAL);
    let before = sample(&mut board, alone.clone(), SCANS)?.all_light();
    let responses = responses(&mut board, &schedule, &before, SCANS)?;
    let after = sample(&mut board, alone, SCANS)?.all_light();
    Ok(judge(&responses, &after, &expected))
}

/// `[cell][emitter]`: light of each emitter on each cell; `own`: that of its own emitter, measured before.
pub(super) fn responses(
    board: &mut Conversation,
    base: &Schedule,
    own: &[Pair<f64>],
    scans: usize,
) -> Result<Vec<Vec<Pair<f64>>>, BenchError> {
    let mut responses = vec![vec![Pair::default(); own.len()]; own.len()];
    for (cell, own) in own.iter().enumerate() {
        responses[cell][cell] = *own;
    }
    for round in sampling::rounds(own.len()) {
        let light = sample(board, sampling::at(sampling::grouped(base, &round), Level::NOMINAL), scans)?.all_light();
        for group in round.iter().filter(|group| group.len() == 2) {
            for [cell, emitter] in [[group[0], group[1]], [group[1], group[0]]] {
                responses[cell][emitter] = Pair {
                    i_x1_a: light[cell].i_x1_a - own[cell].i_x1_a,
                    i_x2_a: light[cell].i_x2_a - own[cell].i_x2_a,
                };
            }
        }
    }
    Ok(responses)
}

fn judge(responses: &[Vec<Pair<f64>>], own_after: &[Pair<f64>], expected: &Expected) -> Vec<Finding> {
    let cells = responses.len();
    let own_a = |cell: usize| responses[cell][cell].total_a();
    let (lit, dark): (Vec<_>, Vec<_>) = (0..cells).partition(|&cell| own_a(cell) >= LIT * expected.own[cell].total_a());
    let mut findings = Vec::new();
    for &cell in &lit {
        let change = own_after[cell].total_a() / own_a(cell) - 1.0;
        if change.abs() > STILL {
            findings.push(Finding::warning(
                "still",
                format!("the light of cell {cell} changed by {:.2} % during the measurement", 1e2 * change),
                "fix the tool, let the emitters warm up, then take this step again",
            ));
        }
    }
    for &cell in &lit {
        let share = |emitter: usize| responses[cell][emitter].total_a() / own_a(cell);
        let row: Vec<String> = (0..cells)
            .map(|emitter| if emitter == cell { "own".to_owned() } else { percent(share(emitter)) })
            .collect();
        let text = format!("cell {cell}, in % of its own light, by emitters 0 to {}: {}", cells - 1, row.join(" "));
        let too_much: Vec<usize> = (0..cells)
            .filter(|&emitter| emitter != cell && share(emitter) > expected.stray[cell][emitter] + TOLERANCE)
            .collect();
        if too_much.is_empty() {
            findings.push(Finding::ok("crosstalk", text));
            continue;
        }
        let pairs: Vec<String> = too_much
            .iter()
            .map(|&emitter| format!("emitter {emitter} ({:.2} % by the scene)", 1e2 * expected.stray[cell][emitter]))
            .collect();
        let between: Vec<String> = too_much.iter().map(ToString::to_string).collect();
        findings.push(Finding::failed(
            "crosstalk",
            format!("{text}; too much by {}", pairs.join(", ")),
            format!(
                "close the baffle between cell {cell} and {}, and look for reflecting surfaces",
                between.join(", ")
            ),
        ));
    }
    if !dark.is_empty() {
        let list: Vec<String> = dark.iter().map(ToString::to_string).collect();
        let text = format!("cells {} see no light of their own emitters: see step emitters", list.join(", "));
        findings.push(Finding::failed("crosstalk", text, "take step emitters first"));
    }
    findings
}

/// In percent, without the sign of what rounds to nothing.
fn percent(share: f64) -> String {
    let rounded = (1e4 * share).round() / 1e2;
    format!("{:.2}", if rounded == 0.0 { 0.0 } else { rounded })
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    const OWN: Pair<f64> = Pair { i_x1_a: 3.4e-6, i_x2_a: 3.4e-6 };

    /// `stray`: shares of own light, `[cell][emitter]`.
    fn judged(stray: &[(usize, usize, f64)], predicted: f64) -> Vec<Finding> {
        let mut responses = vec![vec![Pair::default(); 6]; 6];
        for (cell, row) in responses.iter_mut().enumerate() {
            row[cell] = OWN;
        }
        for &(cell, emitter, share) in stray {
            responses[cell][emitter] = Pair { i_x1_a: 2.0 * share * OWN.i_x1_a, i_x2_a: 0.0 };
        }
        judge(&responses, &[OWN; 6], &Expected { own: vec![OWN; 6], stray: vec![vec![predicted; 6]; 6] })
    }

    #[test]
    fn a_missing_baffle_is_named_by_its_pair() {
        assert!(judged(&[(1, 2, 0.009)], 0.0).iter().all(|finding| finding.grade == Grade::Ok));
        assert!(judged(&[(1, 2, 0.05)], 0.045).iter().all(|finding| finding.grade == Grade::Ok));
        let findings = judged(&[(1, 2, 0.05), (2, 1, 0.05)], 0.0);
        let failed: Vec<_> = findings.iter().filter(|finding| finding.grade == Grade::Failed).collect();
        assert_eq!(failed.len(), 2);
        assert!(failed[0].text.contains("too much by emitter 2") && failed[0].text.contains("5.00"), "{}", failed[0]);
        assert!(failed[1].to_string().contains("between cell 2 and 1"), "{}", failed[1]);
    }

    #[test]
    fn dark_cells_and_moving_tools_are_not_taken_for_stray_light() {
        let mut responses = vec![vec![Pair::default(); 2]; 2];
        responses[0][0] = OWN;
        let expected = Expected { own: vec![OWN; 2], stray: vec![vec![0.0; 2]; 2] };
        let findings = judge(&responses, &[Pair { i_x1_a: 3.5e-6, ..OWN }; 2], &expected);
        let grades: Vec<_> = findings.iter().map(|finding| (finding.place.as_ref(), finding.grade)).collect();
        assert_eq!(grades, [("still", Grade::Warning), ("crosstalk", Grade::Ok), ("crosstalk", Grade::Failed)]);
    }
}
