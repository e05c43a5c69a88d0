//! Codes and noise of each channel without light.

use anyhow::Result;
use slitpose_protocol::{AdcScaling, Level};

use super::bench::{Bench, ELECTRODES, Wiring, sample};
use super::sampling::{self, Codes, Sampling};
use crate::doctor::{faulty_or, named};
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::{Failed, Warning};
use slitpose_head::front_end::dark_word_noise_a;

/// Scans for the mean codes, and for the noise: a standard deviation from 1 000 scans is off by 2 %.
const ZERO_SCANS: usize = 200;
const NOISE_SCANS: usize = 1_000;

/// Largest difference from the zero code, codes: reference divider of 1 % resistors 1.3, offsets of both amplifiers
/// 2.6 (`firmware/README.md`, analogue front end), offset of the converter 4, and 2 in hand.
const ZERO_TOLERANCE: f64 = 10.0;

/// Codes from the end of the converter's range that count as the end.
const RAIL_CODES: f64 = 2.0;

/// Most light with all gates off, both electrodes together, codes: the mean of 200 words is known to 0.1 codes. Emitters
/// are judged by their gates, as the level buffers do not reach 0 V (DS12288, table 74: from 0.2 V).
const OFF_TOLERANCE: f64 = 5.0;

/// Less than this share of the brightest cell's light is taken for light of another emitter.
const STRAY: f64 = 0.1;

/// Noise relative to the front end of the scene: quiet, somewhat noisy, too noisy.
const QUIET: f64 = 0.4;
const NOISY: f64 = 1.3;
const TOO_NOISY: f64 = 2.0;

pub(super) fn zero(bench: &mut Bench) -> Result<Vec<Finding>> {
    let (mut board, _) = bench.connect()?;
    let schedule = sampling::alone(&bench.schedule()?);
    let sampling = sample(&mut board, sampling::at(schedule.clone(), Level(0)), ZERO_SCANS)?;
    let at_nominal = sample(&mut board, sampling::at(schedule, Level::NOMINAL), ZERO_SCANS)?;
    let cells = 0..sampling.cells();
    let of = |sampling: &Sampling, cell: usize| [0, 1].map(|electrode| sampling.dark(cell, electrode).mean);
    let change = |cell: usize| of(&at_nominal, cell).iter().sum::<f64>() - of(&sampling, cell).iter().sum::<f64>();
    let changes: Vec<f64> = cells.clone().map(change).collect();
    let shining = shining(&changes);
    let channels = cells.map(|cell| Zero {
        codes: of(&sampling, cell),
        dark_current_a: 0.5 * bench.scene.scene.cells.get(cell).map_or(0.0, |cell| cell.detector.dark_current_a),
        shines: shining.contains(&cell),
    });
    let mut findings = judge_zero(&channels.collect::<Vec<_>>(), &sampling.scaling, bench.wiring);
    findings.push(judge_gates(&changes, bench.wiring));
    Ok(findings)
}

/// Mean dark codes of a cell, and the dark current of each of its electrodes by the scene.
#[derive(Clone, Copy, Debug)]
struct Zero {
    codes: [f64; 2],
    dark_current_a: f64,
    /// Its emitter shines while its gate is off, also at level 0 as far as its level line is above 0 V.
    shines: bool,
}

fn judge_zero(cells: &[Zero], scaling: &AdcScaling, wiring: Wiring) -> Vec<Finding> {
    let top = f64::from((1_u32 << scaling.bits) - 1);
    let mut findings = Vec::new();
    let (mut worst, mut count) = (0.0_f64, 0);
    for (cell, zero) in cells.iter().enumerate() {
        let expected = scaling.zero_code + zero.dark_current_a / scaling.amperes_per_code;
        for (side, code) in ELECTRODES.into_iter().zip(zero.codes) {
            let (name, off) = (wiring.electrode(cell, side), code - expected);
            let (is_low, is_high) = (code <= RAIL_CODES, code >= top - RAIL_CODES);
            let is_off = off.abs() > ZERO_TOLERANCE;
            // Light moves codes in the direction of the scaling.
            let is_light = off * scaling.amperes_per_code > 0.0;
            if is_off && is_light && zero.shines && !is_low && !is_high {
                continue;
            }
            if !is_off && !is_low && !is_high {
                (worst, count) = (worst.max(off.abs()), count + 1);
            }
            let text = format!("{name}: code {code:.1} in the dark, expected {expected:.1} within {ZERO_TOLERANCE}");
            let stuck = "measure the amplifier's output: at 0 V a short, a solder bridge or too much light at the anode; \
                         at 5 V an open loop (R_f)";
            let light =
                "cover the detector; if that does not help: leakage at the anode, V_ref, or the amplifier's offset";
            let other = "measure V_ref (3.247 V at V_DDA = 3.3 V), and the amplifier's output against it";
            let faults = [
                (is_low, Failed, "stuck at ground", stuck),
                (is_high, Failed, "stuck at V_DDA", stuck),
                (is_off && is_light, Failed, "", light),
                (is_off, Failed, "", other),
            ];
            findings.push(named("zero", text, &faults));
        }
    }
    faulty_or(findings, "zero", || format!("{count} channels within {worst:.1} codes of the zero code"))
}

/// Cells whose emitters shine while all gates are off. `changes`: of the codes of each cell in the dark slot, both
/// electrodes together, as the level of all emitters rises from 0 to nominal.
fn shining(changes: &[f64]) -> Vec<usize> {
    let most = changes.iter().fold(0.0_f64, |most, codes| most.max(codes.abs()));
    (0..changes.len()).filter(|&cell| changes[cell].abs() > OFF_TOLERANCE.max(STRAY * most)).collect()
}

fn judge_gates(changes: &[f64], wiring: Wiring) -> Finding {
    let shining = shining(changes);
    let list = |text: &dyn Fn(usize) -> String| shining.iter().map(|&cell| text(cell)).collect::<Vec<_>>().join(", ");
    if shining.is_empty() {
        let most = changes.iter().fold(0.0_f64, |most, codes| most.max(codes.abs()));
        let text = format!("no light from emitters while their gates are off, {most:.2} codes at most");
        return Finding::ok("gates off", text);
    }
    let emitters = list(&|cell| format!("{cell} ({:.0} codes)", changes[cell].abs()));
    let gates = list(&|cell| wiring.gate(cell));
    Finding::failed(
        "gates off",
        format!("emitters that shine while their gates are off: {emitters}"),
        format!("measure 0 V in the dark slot: {gates}; if it is 0 V, change the switch behind it"),
    )
}

pub(super) fn noise(bench: &mut Bench) -> Result<Vec<Finding>> {
    let (mut board, _) = bench.connect()?;
    // One conversion a word: the converter's codes themselves.
    let mut schedule = bench.schedule()?;
    schedule.oversampling = 1;
    let sampling = sample(&mut board, sampling::at(sampling::alone(&schedule), Level(0)), NOISE_SCANS)?;
    let channels = (0..sampling.cells()).map(|cell| Noise {
        codes: [0, 1].map(|electrode| sampling.dark(cell, electrode)),
        promised: dark_word_noise_a(&bench.scene, cell, &sampling.schedule, &sampling.scaling).unwrap_or(f64::INFINITY)
            / sampling.scaling.amperes_per_code.abs(),
    });
    Ok(judge_noise(&channels.collect::<Vec<_>>(), bench.wiring))
}

/// Statistics of a cell's dark words, and the rms that the front end of the scene gives them.
#[derive(Clone, Copy, Debug)]
struct Noise {
    codes: [Codes; 2],
    promised: f64,
}

fn judge_noise(cells: &[Noise], wiring: Wiring) -> Vec<Finding> {
    let mut findings = Vec::new();
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for (cell, Noise { codes, promised }) in cells.iter().enumerate() {
        for (side, Codes { rms, distinct, step, .. }) in ELECTRODES.into_iter().zip(*codes) {
            let name = wiring.electrode(cell, side);
            let text = format!(
                "{name}: {rms:.2} codes rms, {distinct} different codes; {promised:.2} codes rms expected from the scene's \
                 front end"
            );
            (least, most) = (least.min(rms), most.max(rms));
            let share = rms / promised;
            let steps = format!("codes come in steps of {step}");
            let missing = "codes are missing: V_REF+ and V_DDA decoupling; ES0430 on converters that run at once";
            let loud = "compare with the other channels: C_f, decoupling and ground of this amplifier, guard of its anode \
                        line, light that flickers";
            let ripple = "look for ripple on V_ref and supplies; or raise front_end.raw_noise_lsb of the scene";
            let faults = [
                (share < QUIET, Failed, "too quiet", "the input is shorted or at a rail: measure at the pin"),
                (step > 1, Failed, &*steps, missing),
                (share > TOO_NOISY, Failed, "too noisy", loud),
                (share > NOISY, Warning, "", ripple),
            ];
            findings.push(named("noise", text, &faults));
        }
    }
    faulty_or(findings, "noise", || {
        let promised = cells.iter().fold(0.0_f64, |most, cell| most.max(cell.promised));
        format!(
            "{} channels with {least:.2} to {most:.2} codes rms in one conversion, {promised:.2} expected from the scene's \
             front end; codes in steps of 1",
            2 * cells.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    const SCALING: AdcScaling =
        AdcScaling { zero_code: 4_031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 };

    #[test]
    fn words_off_zero_are_named_by_signal_and_pin() {
        let good = Zero { codes: [4_028.0, 4_033.0], dark_current_a: 0.0, shines: false };
        for (zero, words) in [
            (Zero { codes: [4_028.0, 0.0], ..good }, &["I_X2 of cell 1 (PC4", "stuck at ground"][..]),
            (Zero { codes: [4_095.0, 4_033.0], ..good }, &["stuck at V_DDA"]),
            (Zero { codes: [3_991.0, 4_033.0], ..good }, &["; cover the detector"]),
            (Zero { codes: [4_051.0, 4_033.0], ..good }, &["; measure V_ref"]),
            // 100 nA of dark current are 40 codes.
            (Zero { codes: [3_991.0; 2], dark_current_a: 100e-9, shines: false }, &["12 channels"]),
            // Light of an emitter that its gate does not darken is named by the gate.
            (Zero { codes: [3_961.0; 2], dark_current_a: 0.0, shines: true }, &["10 channels"]),
        ] {
            let found = judge_zero(&[good, zero, good, good, good, good], &SCALING, Wiring::Nucleo);
            assert!(found.len() == 1 && words.iter().all(|word| found[0].to_string().contains(word)), "{found:?}");
        }
    }

    #[test]
    fn too_noisy_too_quiet_and_stepping_channels_are_told_apart() {
        let good = Codes { mean: 4_031.0, rms: 1.05, distinct: 8, step: 1 };
        for (codes, grade, words) in [
            (good, Grade::Ok, "12 channels"),
            (Codes { rms: 5.0, ..good }, Failed, "too noisy"),
            (Codes { rms: 1.6, ..good }, Warning, "1.60 codes rms"),
            (Codes { rms: 0.0, distinct: 1, step: 0, ..good }, Failed, "too quiet"),
            (Codes { rms: 4.0, distinct: 3, step: 8, ..good }, Failed, "steps of 8"),
        ] {
            let mut cells = vec![Noise { codes: [good; 2], promised: 1.04 }; 6];
            cells[1].codes[0] = codes;
            let found = judge_noise(&cells, Wiring::Nucleo);
            assert!(found.len() == 1 && found[0].grade == grade && found[0].text.contains(words), "{found:?}");
            assert!(grade == Grade::Ok || found[0].text.contains("I_X1 of cell 1 (PA1"), "{found:?}");
        }
    }
}
