//! Light of the emitters: each alone, whether its own cell sees it, by both electrodes, as bright as the scene says; and
//! along with each other one, how much of it other cells see.
//!
//! With emitters lit one by one, a cell is read while its own emitter is lit only. If a cell is dark then, all emitters
//! are lit in pairs, too, and where the light of the dark cell's emitter goes shows in the words of its partners.
//!
//! For the light of others, what a cell has more than by its own emitter alone comes from the other one of the slot,
//! through a gap in the baffles or by reflection. All pairs are lit in as few configurations as there are partners.

use anyhow::Result;
use slitpose_model::Pair;
use slitpose_protocol::{Level, Schedule};

use super::bench::{Bench, ELECTRODES, Wiring, is_shared_level, sample};
use super::sampling::{self, Expected, LIT};
use crate::device::Conversation;
use crate::doctor::named;
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::Failed;

/// Scans of each configuration: the mean of a word lit minus dark is then known to 0.05 codes of some 1 400.
const SCANS: usize = 200;

/// Shares of the scene's light at home that emitters of one part number may have: the figures of such parts spread from
/// 0.6 to 1.6 times their typical value (not checked against the data sheet of this part).
const STRENGTH: std::ops::RangeInclusive<f64> = 0.6..=1.6;

/// Least difference of both electrodes over their sum by which they can be told apart.
const ASYMMETRY: f64 = 0.05;

/// Cells whose light and words do not belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Exchange {
    /// The gates are on each other's drivers.
    Gates,
    /// The detectors are on each other's inputs.
    Cells,
    /// Either of both: their emitters share a level line, so that no measurement tells.
    Unknown,
}

pub(super) fn take(bench: &mut Bench) -> Result<Vec<Finding>> {
    let expected = bench.expected()?;
    let (mut board, _) = bench.connect()?;
    let schedule = bench.schedule()?;
    let sampling = sample(&mut board, sampling::at(sampling::alone(&schedule), Level::NOMINAL), SCANS)?;
    let own = sampling.all_light();
    let saturated: Vec<usize> = (0..own.len())
        .filter(|&cell| {
            [0, 1]
                .into_iter()
                .any(|electrode| sampling.scaling.is_saturated(sampling.lit(cell, electrode).mean.round() as u16, 1))
        })
        .collect();
    let mut exchanges = Vec::new();
    if (0..own.len()).any(|cell| is_dark(own[cell], expected.own[cell])) {
        for (first, second) in exchanged(&responses(&mut board, &schedule, &own, SCANS)?, &own, &expected.own) {
            exchanges.push((first, second, tell(&mut board, &schedule, [first, second], &expected.own)?));
        }
    }
    Ok(judge(&own, &expected.own, &saturated, &exchanges, bench.wiring))
}

fn is_dark(light: Pair<f64>, expected: Pair<f64>) -> bool {
    !is_lit(light.i_x1_a, expected) && !is_lit(light.i_x2_a, expected)
}

fn is_lit(current_a: f64, expected: Pair<f64>) -> bool {
    current_a >= 0.5 * LIT * expected.total_a()
}

/// Pairs of cells that are dark with their own emitters, and lit while both emitters of the pair are.
fn exchanged(responses: &[Vec<Pair<f64>>], own: &[Pair<f64>], expected: &[Pair<f64>]) -> Vec<(usize, usize)> {
    let dark = |cell: usize| is_dark(own[cell], expected[cell]);
    let lit_by = |cell: usize, emitter: usize| !is_dark(responses[cell][emitter], expected[cell]);
    let pairs = (0..own.len()).flat_map(|first| (first + 1..own.len()).map(move |second| (first, second)));
    pairs.filter(|&(i, j)| dark(i) && dark(j) && lit_by(i, j) && lit_by(j, i)).collect()
}

/// Tells exchanged gates from exchanged cells: both emitters are lit together, the second at level 0. Level lines stay
/// with their drivers, so exchanged gates light the first emitter and its cell, exchanged cells the word of the second.
fn tell(board: &mut Conversation, base: &Schedule, pair: [usize; 2], expected: &[Pair<f64>]) -> Result<Exchange> {
    let [first, second] = pair;
    let others = (0..usize::from(base.cells)).filter(|emitter| !pair.contains(emitter));
    let groups: Vec<Vec<usize>> = std::iter::once(pair.to_vec()).chain(others.map(|emitter| vec![emitter])).collect();
    let mut configuration = sampling::at(sampling::grouped(base, &groups), Level::NOMINAL);
    configuration.levels[second] = Level(0);
    match sample(board, configuration, SCANS) {
        Ok(sampling) => {
            Ok(if is_dark(sampling.light(first), expected[first]) { Exchange::Cells } else { Exchange::Gates })
        }
        Err(error) if is_shared_level(&error) => Ok(Exchange::Unknown),
        Err(error) => Err(error),
    }
}

fn judge(
    own: &[Pair<f64>],
    expected: &[Pair<f64>],
    saturated: &[usize],
    exchanges: &[(usize, usize, Exchange)],
    wiring: Wiring,
) -> Vec<Finding> {
    let mut findings: Vec<Finding> = exchanges.iter().map(|&exchange| of_exchange(exchange, wiring)).collect();
    let is_exchanged = |cell: usize| exchanges.iter().any(|&(first, second, _)| [first, second].contains(&cell));
    for cell in (0..own.len()).filter(|&cell| !is_exchanged(cell)) {
        findings.push(of_cell(cell, own[cell], expected[cell], saturated.contains(&cell), wiring));
    }
    findings.push(of_order(own, expected));
    findings
}

fn of_exchange((first, second, exchange): (usize, usize, Exchange), wiring: Wiring) -> Finding {
    let gates = format!("{} and {}", wiring.gate(first), wiring.gate(second));
    let cells = format!(
        "{} and {}, {} and {}",
        wiring.electrode(first, ELECTRODES[0]),
        wiring.electrode(second, ELECTRODES[0]),
        wiring.electrode(first, ELECTRODES[1]),
        wiring.electrode(second, ELECTRODES[1])
    );
    let (what, next_step) = match exchange {
        Exchange::Gates => (format!("gates exchanged: {gates}"), "exchange the two gate lines"),
        Exchange::Cells => (format!("inputs exchanged: {cells}"), "exchange the plugs of the two detectors"),
        Exchange::Unknown => (
            format!("gates exchanged ({gates}), or inputs ({cells})"),
            "look at the 3.3 ohm of both emitters with an oscilloscope: they show which gate lights which emitter",
        ),
    };
    Finding::failed("emitters", format!("cells {first} and {second} see each other's emitters; {what}"), next_step)
}

fn of_cell(cell: usize, own: Pair<f64>, expected: Pair<f64>, is_saturated: bool, wiring: Wiring) -> Finding {
    let share = own.total_a() / expected.total_a();
    // Rounded, and without the sign of what rounds to nothing.
    let micro = |current_a: f64| (current_a * 1e9).round() / 1e3 + 0.0;
    let text = format!(
        "cell {cell}: {:.3} and {:.3} uA by its emitter alone, {:.3} and {:.3} uA by the scene; {share:.2} of that",
        micro(own.i_x1_a),
        micro(own.i_x2_a),
        micro(expected.i_x1_a),
        micro(expected.i_x2_a)
    );
    let lit = [own.i_x1_a, own.i_x2_a].map(|current_a| is_lit(current_a, expected));
    let gate = wiring.gate(cell);
    let dark = format!("dark; emitter {cell} gives no light, or its light does not reach the detector ({gate})");
    let dead = usize::from(lit[0]);
    let one_sided = format!("{} sees no light, the other electrode does", wiring.electrode(cell, ELECTRODES[dead]));
    let [weak, strong] = ["weak", "strong"].map(|what| format!("emitter {cell} is {what}, expected 0.6 to 1.6"));
    let too_much = "move the tool to its home pose; if it is there, lower the emitter's level or its current";
    let no_light = "measure its 3.3 ohm: 329 mV in its slot if the emitter is lit, then look at the detector's cathode, its \
                    plug and the slit; 0 V if it is not: gate, switch, emitter";
    let no_anode = "look for an open anode, a shorted input or a dead amplifier: the amplifier's output must fall in the \
                    cell's slot";
    let too_weak = "measure its 3.3 ohm (329 mV at nominal), clean emitter and slit; then change the emitter";
    let too_strong = "measure its 3.3 ohm (329 mV at nominal): the current is too high, or the tool too close";
    let faults = [
        (is_saturated, Failed, "saturated", too_much),
        (lit == [false; 2], Failed, &*dark, no_light),
        (lit != [true; 2], Failed, &*one_sided, no_anode),
        (share < *STRENGTH.start(), Failed, &*weak, too_weak),
        (!STRENGTH.contains(&share), Failed, &*strong, too_strong),
    ];
    named("emitters", text, &faults)
}

/// Whether electrodes may be exchanged, where the spot is far enough from the middle.
fn of_order(own: &[Pair<f64>], expected: &[Pair<f64>]) -> Finding {
    let asymmetry = |pair: &Pair<f64>| (pair.i_x2_a - pair.i_x1_a) / pair.total_a();
    let lit = (0..own.len()).filter(|&cell| !is_dark(own[cell], expected[cell]));
    let seen: Vec<usize> = lit.filter(|&cell| asymmetry(&expected[cell]).abs() >= ASYMMETRY).collect();
    let wrong = |&cell: &usize| asymmetry(&own[cell]) * asymmetry(&expected[cell]) < -0.25 * ASYMMETRY * ASYMMETRY;
    let exchanged: Vec<String> = seen.iter().copied().filter(wrong).map(|cell| cell.to_string()).collect();
    if !exchanged.is_empty() {
        let text = format!("cells {}: I_X1 and I_X2 exchanged, by the spots at home", exchanged.join(", "));
        return Finding::failed("electrodes", text, "exchange the wires of the two anodes");
    }
    if seen.is_empty() {
        let text = "at home the spots are in the middle, so exchanged electrodes of a cell do not show; move the tool and \
                    look at `slitpose run`, which names them";
        return Finding::skipped("electrodes", text);
    }
    let cells = seen.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    Finding::ok("electrodes", format!("the spots of cells {cells} are on the side that the scene predicts"))
}

// Light of other emitters.

/// Share of a cell's own light, beyond the prediction of the scene, at which light of another emitter is too much: at
/// the end of a detector of 12 mm it moves the spot by 1 % of 6 mm, 60 µm, the position error of the detector itself
/// (S3932 data sheet, typical).
const TOLERANCE: f64 = 0.01;

/// Largest change of a cell's own light during the measurement.
const STILL: f64 = 3e-3;

pub(super) fn take_crosstalk(bench: &mut Bench) -> Result<Vec<Finding>> {
    let expected = bench.expected()?;
    let (mut board, _) = bench.connect()?;
    let schedule = bench.schedule()?;
    let alone = sampling::at(sampling::alone(&schedule), Level::NOMINAL);
    let before = sample(&mut board, alone.clone(), SCANS)?.all_light();
    let responses = responses(&mut board, &schedule, &before, SCANS)?;
    let after = sample(&mut board, alone, SCANS)?.all_light();
    Ok(judge_crosstalk(&responses, &after, &expected))
}

/// `[cell][emitter]`: light of each emitter on each cell; `own`: that of its own emitter, measured before.
fn responses(
    board: &mut Conversation,
    base: &Schedule,
    own: &[Pair<f64>],
    scans: usize,
) -> Result<Vec<Vec<Pair<f64>>>> {
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

fn judge_crosstalk(responses: &[Vec<Pair<f64>>], own_after: &[Pair<f64>], expected: &Expected) -> Vec<Finding> {
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

    fn with(cell: usize, light: Pair<f64>) -> Vec<Pair<f64>> {
        let mut own = vec![OWN; 6];
        own[cell] = light;
        own
    }

    #[test]
    fn strong_emitters_and_saturated_cells_are_named_and_centred_spots_do_not_tell_electrodes_apart() {
        let bright = with(5, Pair { i_x1_a: 5.7e-6, i_x2_a: 5.7e-6 });
        let findings = judge(&bright, &[OWN; 6], &[1], &[], Wiring::Nucleo);
        assert_eq!(findings.iter().filter(|finding| finding.grade == Failed).count(), 2, "{findings:?}");
        assert!(findings[1].text.contains("saturated") && findings[5].text.contains("emitter 5 is strong"));
        assert_eq!(findings[6].grade, Grade::Skipped);
    }

    #[test]
    fn electrodes_are_told_apart_by_spots_beside_the_middle() {
        let aside = Pair { i_x1_a: 3.0e-6, i_x2_a: 3.8e-6 };
        let mut expected = vec![OWN; 6];
        expected[2] = aside;
        assert_eq!(of_order(&with(2, aside), &expected).grade, Grade::Ok);
        let turned = of_order(&with(2, Pair { i_x1_a: 3.8e-6, i_x2_a: 3.0e-6 }), &expected);
        assert!(turned.grade == Failed && turned.text.contains("cells 2:"), "{turned}");
    }

    #[test]
    fn stray_light_that_the_scene_predicts_is_no_missing_baffle() {
        for (share, predicted, grade) in [(0.009, 0.0, Grade::Ok), (0.05, 0.045, Grade::Ok), (0.05, 0.0, Failed)] {
            let stray = Pair { i_x1_a: 2.0 * share * OWN.i_x1_a, i_x2_a: 0.0 };
            let expected = Expected { own: vec![OWN; 2], stray: vec![vec![predicted; 2]; 2] };
            let findings = judge_crosstalk(&[vec![OWN, Pair::default()], vec![stray, OWN]], &[OWN; 2], &expected);
            assert_eq!([findings[0].grade, findings[1].grade], [Grade::Ok, grade], "{share} {predicted}");
        }
    }

    #[test]
    fn dark_cells_and_moving_tools_are_not_taken_for_stray_light() {
        let mut responses = vec![vec![Pair::default(); 2]; 2];
        responses[0][0] = OWN;
        let expected = Expected { own: vec![OWN; 2], stray: vec![vec![0.0; 2]; 2] };
        let findings = judge_crosstalk(&responses, &[Pair { i_x1_a: 3.5e-6, ..OWN }; 2], &expected);
        let grades: Vec<_> = findings.iter().map(|finding| (finding.place.as_ref(), finding.grade)).collect();
        assert_eq!(grades, [("still", Grade::Warning), ("crosstalk", Grade::Ok), ("crosstalk", Failed)]);
    }
}
