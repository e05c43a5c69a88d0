//! Codes and noise of each channel without light.

use slitpose_model::Pair;
use slitpose_protocol::{AdcScaling, Level};

use super::bench::{Bench, BenchError, sample};
use super::lighting;
use super::pins::{ELECTRODES, electrode, level_line};
use super::sampling::Codes;
use slitpose_head::finding::Finding;
use slitpose_head::front_end::dark_word_noise_a;
use slitpose_head::scene_file::SceneFile;

/// Scans for the mean codes, and for the noise: a standard deviation from 1 000 scans is off by 2 %.
const ZERO_SCANS: usize = 200;
const NOISE_SCANS: usize = 1_000;

/// Largest difference from the zero code, codes: reference divider of 1 % resistors 1.3, offsets of both amplifiers
/// 2.6 (`firmware/README.md`, analogue front end), offset of the converter 4, and 2 in hand.
const ZERO_TOLERANCE: f64 = 10.0;

/// Codes from the end of the converter's range that count as the end.
const RAIL_CODES: f64 = 2.0;

/// Most light of emitters at level 0, both electrodes together, codes: the mean of 200 words lit minus dark is known to
/// 0.1 codes, and a level buffer that rests at 0.2 V is 80 and more.
const OFF_TOLERANCE: f64 = 2.0;

/// Noise relative to the front end of the scene: quiet, somewhat noisy, too noisy.
const QUIET: f64 = 0.4;
const NOISY: f64 = 1.3;
const TOO_NOISY: f64 = 2.0;

pub(super) fn zero(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let (mut board, _) = bench.connect()?;
    let configuration = lighting::at(lighting::alone(&bench.schedule()?), Level(0));
    let sampling = sample(&mut board, configuration, ZERO_SCANS)?;
    let channels = (0..sampling.cells()).map(|cell| Zero {
        codes: [0, 1].map(|electrode| sampling.dark(cell, electrode).mean),
        dark_current_a: 0.5 * bench.scene.scene.cells.get(cell).map_or(0.0, |cell| cell.detector.dark_current_a),
    });
    let mut findings = judge_zero(&channels.collect::<Vec<_>>(), &sampling.scaling);
    findings.push(judge_off(&sampling.all_light(), &sampling.scaling));
    Ok(findings)
}

/// Mean dark codes of a cell, and the dark current of each of its electrodes by the scene.
#[derive(Clone, Copy, Debug)]
struct Zero {
    codes: [f64; 2],
    dark_current_a: f64,
}

fn judge_zero(cells: &[Zero], scaling: &AdcScaling) -> Vec<Finding> {
    let top = f64::from((1_u32 << scaling.bits) - 1);
    let mut findings = Vec::new();
    let mut worst = 0.0_f64;
    for (cell, zero) in cells.iter().enumerate() {
        let expected = scaling.zero_code + zero.dark_current_a / scaling.amperes_per_code;
        for (side, code) in ELECTRODES.into_iter().zip(zero.codes) {
            let (name, off) = (electrode(cell, side), code - expected);
            let text = format!("{name}: code {code:.1} in the dark, expected {expected:.1} within {ZERO_TOLERANCE}");
            if code <= RAIL_CODES || code >= top - RAIL_CODES {
                let rail = if code <= RAIL_CODES { "ground" } else { "V_DDA" };
                let next_step = "measure the amplifier's output: at 0 V a short, a solder bridge or too much light at \
                                 the anode; at 5 V an open loop (R_f)";
                findings.push(Finding::failed("zero", format!("{text}: stuck at {rail}"), next_step));
            } else if off.abs() > ZERO_TOLERANCE {
                // Light moves codes in the direction of the scaling.
                let is_light = off * scaling.amperes_per_code > 0.0;
                let next_step = if is_light {
                    "cover the detector; if it stays so: leakage at the anode, V_ref, or the amplifier's offset"
                } else {
                    "measure V_ref (3.247 V at V_DDA = 3.3 V), and the amplifier's output against it"
                };
                findings.push(Finding::failed("zero", text, next_step));
            } else {
                worst = worst.max(off.abs());
            }
        }
    }
    if findings.is_empty() {
        let text = format!("{} words within {worst:.1} codes of their zero code", 2 * cells.len());
        findings.push(Finding::ok("zero", text));
    }
    findings
}

/// Light of emitters whose level is 0.
fn judge_off(light: &[Pair<f64>], scaling: &AdcScaling) -> Finding {
    let codes: Vec<f64> = light.iter().map(|pair| pair.total_a() / scaling.amperes_per_code.abs()).collect();
    let lit: Vec<usize> = (0..codes.len()).filter(|&cell| codes[cell].abs() > OFF_TOLERANCE).collect();
    let most = codes.iter().fold(0.0_f64, |most, codes| most.max(codes.abs()));
    let Some(&first) = lit.first() else {
        return Finding::ok("level 0", format!("no light from emitters at level 0, at most {most:.2} codes"));
    };
    let list = lit.iter().map(|&cell| format!("{cell} ({:.0} codes)", codes[cell])).collect::<Vec<_>>().join(", ");
    let line = level_line(first).filter(|(_, emitters)| lit.iter().all(|emitter| emitters.contains(emitter)));
    let at = line.map_or_else(String::new, |(name, _)| format!(": {name} does not go to 0 V"));
    Finding::failed(
        "level 0",
        format!("emitters shine at level 0 on cells {list}{at}"),
        "measure the level line and the switch behind it: 0 V at level 0, 1.65 V at nominal",
    )
}

pub(super) fn noise(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let (mut board, _) = bench.connect()?;
    // One conversion a word: the converter's codes themselves.
    let mut schedule = bench.schedule()?;
    schedule.oversampling = 1;
    let sampling = sample(&mut board, lighting::at(lighting::alone(&schedule), Level(0)), NOISE_SCANS)?;
    let scene = single_conversions(bench.scene);
    let channels = (0..sampling.cells()).map(|cell| Noise {
        codes: [0, 1].map(|electrode| sampling.dark(cell, electrode)),
        promised: dark_word_noise_a(&scene, cell, &sampling.scaling).unwrap_or(f64::INFINITY)
            / sampling.scaling.amperes_per_code.abs(),
    });
    Ok(judge_noise(&channels.collect::<Vec<_>>()))
}

/// The scene with words of one conversion.
fn single_conversions(scene: &SceneFile) -> SceneFile {
    let mut scene = scene.clone();
    if let Some(front_end) = &mut scene.front_end {
        front_end.oversampling = 1;
    }
    scene
}

/// Statistics of a cell's dark words, and the rms that the front end of the scene gives them.
#[derive(Clone, Copy, Debug)]
struct Noise {
    codes: [Codes; 2],
    promised: f64,
}

fn judge_noise(cells: &[Noise]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for (cell, noise) in cells.iter().enumerate() {
        for (side, codes) in ELECTRODES.into_iter().zip(noise.codes) {
            let share = codes.rms / noise.promised;
            let text = format!(
                "{}: {:.2} codes rms in {} different codes, {:.2} codes by the scene's front end",
                electrode(cell, side),
                codes.rms,
                codes.distinct,
                noise.promised
            );
            let failed =
                |why: &str, next_step: &'static str| Finding::failed("noise", format!("{text}: {why}"), next_step);
            if share < QUIET {
                let next_step = "a word that hardly changes: the input is shorted or at a rail; measure at the pin";
                findings.push(failed("too quiet", next_step));
            } else if codes.step > 1 {
                let next_step = "codes are missing: V_REF+ and V_DDA decoupling; ES0430 on converters that run at once";
                findings.push(failed(&format!("codes come in steps of {}", codes.step), next_step));
            } else if share > TOO_NOISY {
                let next_step = "compare with the other channels: C_f, decoupling and ground of this amplifier, guard of \
                                 its anode line, light that flickers";
                findings.push(failed("too noisy", next_step));
            } else if share > NOISY {
                let next_step = "look for ripple on V_ref and supplies; or raise front_end.raw_noise_lsb of the scene";
                findings.push(Finding::warning("noise", text, next_step));
            } else {
                (least, most) = (least.min(codes.rms), most.max(codes.rms));
            }
        }
    }
    if findings.is_empty() {
        let promised = cells.iter().fold(0.0_f64, |most, cell| most.max(cell.promised));
        let text = format!(
            "{} words of one conversion with {least:.2} to {most:.2} codes rms, {promised:.2} by the scene's front end; \
             codes in steps of 1",
            2 * cells.len()
        );
        findings.push(Finding::ok("noise", text));
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    const SCALING: AdcScaling =
        AdcScaling { zero_code: 4_031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 };

    fn zero_of(change: impl Fn(&mut Vec<Zero>)) -> Vec<Finding> {
        let mut cells = vec![Zero { codes: [4_028.0, 4_033.0], dark_current_a: 0.0 }; 6];
        change(&mut cells);
        judge_zero(&cells, &SCALING)
    }

    #[test]
    fn words_off_zero_are_named_by_signal_and_pin() {
        assert!(matches!(&zero_of(|_| ())[..], [finding] if finding.grade == Grade::Ok));
        let stuck = zero_of(|cells| cells[4].codes[1] = 0.0);
        assert_eq!(stuck.len(), 1);
        assert!(stuck[0].text.contains("I_X2 of cell 4 (PB11") && stuck[0].text.contains("stuck at ground"));
        assert!(zero_of(|cells| cells[0].codes[0] = 4_095.0)[0].text.contains("stuck at V_DDA"));
        let bright = zero_of(|cells| cells[1].codes[0] = 3_991.0);
        assert!(bright[0].next_step.as_ref().is_some_and(|step| step.starts_with("cover")), "{bright:?}");
        let high = zero_of(|cells| cells[1].codes[0] = 4_051.0);
        assert!(high[0].next_step.as_ref().is_some_and(|step| step.contains("V_ref")), "{high:?}");
        // 100 nA of dark current are 40 codes.
        let dark = zero_of(|cells| cells[1] = Zero { codes: [3_991.0; 2], dark_current_a: 100e-9 });
        assert_eq!(dark[0].grade, Grade::Ok, "{dark:?}");
    }

    #[test]
    fn light_at_level_0_names_the_line_if_all_of_it_is_on_one() {
        let pair = |codes: f64| Pair { i_x1_a: 0.5 * codes * 2.5e-9, i_x2_a: 0.5 * codes * 2.5e-9 };
        let judged = |codes: [f64; 6]| judge_off(&codes.map(pair), &SCALING);
        assert_eq!(judged([0.5, 0.0, -0.5, 0.0, 0.0, 0.0]).grade, Grade::Ok);
        let stuck = judged([2_000.0, 2_000.0, 2_000.0, 0.0, 0.0, 0.0]);
        assert!(stuck.grade == Grade::Failed && stuck.text.contains("PA4"), "{stuck}");
        let both = judged([2_000.0, 0.0, 0.0, 2_000.0, 0.0, 0.0]);
        assert!(both.grade == Grade::Failed && !both.text.contains("PA4"), "{both}");
    }

    #[test]
    fn too_noisy_too_quiet_and_stepping_channels_are_told_apart() {
        let good = Codes { mean: 4_031.0, rms: 1.05, distinct: 8, step: 1 };
        let with = |codes: Codes| {
            let mut cells = vec![Noise { codes: [good; 2], promised: 1.04 }; 6];
            cells[1].codes[0] = codes;
            judge_noise(&cells)
        };
        assert!(matches!(&with(good)[..], [finding] if finding.grade == Grade::Ok));
        let found = |codes, grade, words: &str| {
            let findings = with(codes);
            assert!(findings.len() == 1 && findings[0].grade == grade, "{findings:?}");
            assert!(
                findings[0].text.contains("I_X1 of cell 1 (PA1") && findings[0].text.contains(words),
                "{findings:?}"
            );
        };
        found(Codes { rms: 5.0, ..good }, Grade::Failed, "too noisy");
        found(Codes { rms: 1.6, ..good }, Grade::Warning, "1.60 codes rms");
        found(Codes { rms: 0.0, distinct: 1, step: 0, ..good }, Grade::Failed, "too quiet");
        found(Codes { rms: 4.0, distinct: 3, step: 8, ..good }, Grade::Failed, "steps of 8");
    }
}
