//! What emitter pins and converters do against what a schedule asks for, tick by tick; and what the words are against the
//! light of the model.

use super::talk::{Talk, at_rest};
use super::{dma_ticks, inputs, level_line, trigger_ticks};
use slitpose_emulator::facts;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::world::{Drive, Hold, Record, TIER};
use slitpose_firmware::pcb::default_scaling;
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::WIDE;
use slitpose_model::{CompiledScene, Pair, Pose, Reading};
use slitpose_protocol::{Command, Configuration, Level, RawScan, Schedule};

/// By so much the emitters of a lit last slot go off ahead of the slot's end if the frame has an
/// idle rest: 0.2 µs, rounded (firmware/README.md, "A frame").
const OFF_LEAD_S: std::ops::Range<f64> = 0.15e-6..0.25e-6;

/// Ticks after the start of a slot within which the level lines have its levels: the compare that
/// writes them comes one tick after the update that switches the gates.
const LEVEL_TICKS: u64 = 1;

/// Checks every change of the gates and every hold against the instants of `schedule`, for the
/// frames that are whole; gives their number.
pub fn check_pins(record: &Record, configuration: &Configuration, start: Ticks) -> u64 {
    let Configuration { schedule, levels, .. } = configuration;
    let frame_ticks = u64::from(schedule.frame_ticks);
    let (cells, oversampling) = (usize::from(schedule.cells), u64::from(schedule.oversampling));
    let wired = inputs();
    // Before the first frame the converters work for nobody.
    let holds = record.holds.as_ref().expect("asked for by `run`");
    let holds = &holds[holds.partition_point(|hold| hold.at < start)..];
    let leading = leading_cells(schedule, holds.first().map_or(start, |hold| hold.at) - start);
    let holds_a_frame = 2 * schedule.slots.len() * (leading + cells) * usize::from(schedule.oversampling);
    let frames = holds.len() / holds_a_frame;
    for (n, frame) in holds.chunks_exact(holds_a_frame).enumerate() {
        let mut held = frame.iter();
        for slot in 0..schedule.slots.len() {
            let ahead = std::iter::repeat_n((0, oversampling * u64::from(schedule.conversion_ticks)), leading);
            for (cell, earlier) in ahead.chain((0..cells).map(|cell| (cell, 0))) {
                let inputs = wired.map(|inputs| inputs[cell]);
                let first = schedule.first_sample_ticks(slot, cell).expect("it has them") - earlier;
                for conversion in 0..oversampling {
                    let at = start + n as u64 * frame_ticks + first + conversion * u64::from(schedule.conversion_ticks);
                    let pair = [held.next(), held.next()];
                    let [Some(first), Some(second)] = pair else { panic!("holds are whole") };
                    let title = format!("frame {n}, slot {slot}, cell {cell}, conversion {conversion}");
                    assert!((at..=at + trigger_ticks()).contains(&first.at), "{title}: {first:?} instead of {at}");
                    let expected = [1, 2].map(|adc| Hold { at: first.at, adc, channel: inputs[usize::from(adc) - 1] });
                    assert_eq!([*first, *second], expected, "{title}");
                }
            }
        }
    }
    // A Stop may cut the last frame short behind its last hold.
    let uncut = frames.saturating_sub(1) as u64;
    let expected = gate_edges(record, schedule, start, uncut);
    let end = expected.last().map_or(start, |edge| edge.0) + 1 + dma_ticks();
    let seen: Vec<_> = record.edges().into_iter().filter(|edge| edge.0 < end).collect();
    for (seen, expected) in seen.iter().zip(&expected) {
        let late = expected.0..=expected.0 + dma_ticks();
        assert!(seen.1 == expected.1 && late.contains(&seen.0), "{seen:?}, not {expected:?}, of a start at {start}");
    }
    // While DMA is late the frame behind may have begun.
    let most = expected.len() + usize::from(dma_ticks() > 0);
    assert!((expected.len()..=most).contains(&seen.len()), "{} edges, {} expected", seen.len(), expected.len());
    check_levels(record, schedule, levels, start, uncut);
    frames as u64
}

/// Words ahead of those of the cells in each slot, if the first conversion after a frame's start comes `first` ticks
/// behind it. The first conversion more than a millisecond after the one before may be wrong (ES0430), so that there
/// has to be one; where half a millisecond is never exceeded there is none.
fn leading_cells(schedule: &Schedule, first: Ticks) -> usize {
    let leading = usize::from(first < schedule.first_sample_ticks(0, 0).expect("it has a cell"));
    let idle = schedule.frame_ticks - schedule.slots.len() as u32 * schedule.slot_ticks;
    let conversions = u32::from(schedule.cells) * u32::from(schedule.oversampling);
    let pause = idle + schedule.slot_ticks - conversions * schedule.conversion_ticks;
    assert!(leading == 1 || pause < 170_000, "a pause of {pause} ticks");
    assert!(leading == 0 || pause > 85_000, "a pause of {pause} ticks");
    leading
}

/// By so much the emitters went off ahead of the end of a lit last slot, in frames whose idle rests begin at
/// `rests`: the earliest, where transfers take their time.
fn off_lead_ticks(record: &Record, rests: impl Iterator<Item = Ticks>) -> Ticks {
    let most = (OFF_LEAD_S.end * TICKS_PER_SECOND as f64) as Ticks;
    let mut drives = record.drives.iter();
    let leads = rests.filter_map(|rest| {
        let dark = drives.find(|drive| drive.at + most >= rest && drive.gates == 0)?;
        Some((rest + most).saturating_sub(dark.at))
    });
    let lead = leads.max().expect("it goes dark").saturating_sub(most);
    assert!(OFF_LEAD_S.contains(&(lead as f64 / TICKS_PER_SECOND as f64)), "{lead} ticks");
    lead
}

/// Changes of the gates in the first `frames` frames of `schedule`.
fn gate_edges(record: &Record, schedule: &Schedule, start: Ticks, frames: u64) -> Vec<(Ticks, u8)> {
    let (slot_ticks, frame_ticks) = (u64::from(schedule.slot_ticks), u64::from(schedule.frame_ticks));
    let slots = schedule.slots.len() as u64;
    let has_rest = frame_ticks > slots * slot_ticks;
    let is_lit = schedule.slots.last().is_some_and(|set| !set.is_dark());
    let rests = (0..frames).map(|n| start + n * frame_ticks + slots * slot_ticks);
    let lead = if has_rest && is_lit && frames > 0 { off_lead_ticks(record, rests) } else { 0 };
    let mut edges: Vec<(Ticks, u8)> = Vec::new();
    for frame in (0..frames).map(|n| start + n * frame_ticks) {
        for (slot, set) in (0..).zip(&schedule.slots) {
            edges.push((frame + slot * slot_ticks, set.0 as u8));
        }
        if has_rest {
            edges.push((frame + slots * slot_ticks - lead, 0));
        }
    }
    let mut gates = 0;
    edges.retain(|edge| std::mem::replace(&mut gates, edge.1) != edge.1);
    edges
}

/// DAC code of a level: nominal is the middle of the DAC's range (firmware/README.md, "Emitter drive").
pub fn level_code(level: Level) -> u16 {
    let nominal = f64::from(1 << (facts::bits("DAC_bits") - 1));
    (level.relative() * nominal).round() as u16
}

/// Checks that in each lit slot the level lines of its emitters have their codes from just after
/// its start to its end.
fn check_levels(record: &Record, schedule: &Schedule, levels: &[Level], start: Ticks, frames: u64) {
    let lines: Vec<_> = (0..levels.len()).map(level_line).collect();
    let mut drives = record.drives.iter().peekable();
    let mut now = Drive { at: 0, gates: 0, levels: [0; 2] };
    for frame in 0..frames {
        for (slot, set) in (0..).zip(&schedule.slots) {
            let slot_begin = start + frame * u64::from(schedule.frame_ticks) + slot * u64::from(schedule.slot_ticks);
            // Behind the gates and the other line.
            let begin = slot_begin + LEVEL_TICKS + 2 * dma_ticks();
            let end = slot_begin + u64::from(schedule.slot_ticks);
            while let Some(drive) = drives.next_if(|drive| drive.at <= begin) {
                now = *drive;
            }
            loop {
                for emitter in set.emitters() {
                    let (line, code) = (lines[emitter], level_code(levels[emitter]));
                    assert_eq!(now.levels[line], code, "frame {frame}, slot {slot}, line {line}: {now:?}");
                }
                match drives.next_if(|drive| drive.at < end) {
                    Some(drive) => now = *drive,
                    None => break,
                }
            }
        }
    }
}

/// Runs `configuration` for `ms` from a Start on, then stops; gives the scans and the tick at which
/// the first frame began on the pins.
pub fn run(bench: &mut Talk, configuration: &Configuration, ms: f64) -> (Vec<RawScan>, Ticks) {
    bench.accept(&Command::Configure(configuration.clone()));
    bench.forget();
    bench.record().holds = Some(Vec::new());
    bench.accept(&Command::Start);
    bench.run_ms(ms);
    let schedule = &configuration.schedule;
    let period = if schedule.slots.len() == 1 { schedule.frame_ticks } else { schedule.slot_ticks };
    let zero = bench.rig.machine.board.timers[0].origin().expect("the frame timer runs");
    bench.accept(&Command::Stop);
    // What the link still holds.
    bench.run_ms(5.0);
    let lit_slots = configuration.schedule.slots.iter().enumerate().find(|(_, set)| !set.is_dark());
    let (slot, set) = lit_slots.expect("a schedule has light");
    let lit = bench.record().drives.iter().find(|drive| drive.gates != 0).expect("it lights");
    assert_eq!(lit.gates, set.0 as u8, "the first lit slot comes first");
    let seen = lit.at - slot as u64 * u64::from(configuration.schedule.slot_ticks);
    // The first update of the timer, which starts at the end of a period.
    let start = zero + u64::from(period);
    assert!((0..=dma_ticks()).contains(&(seen - start)), "{} ticks from the timer to the pins", seen - start);
    (bench.ear.scans.clone(), start)
}

/// Checks that `scans` follow one another one frame apart and none is missing.
pub fn check_counters(scans: &[RawScan], schedule: &Schedule) {
    for pair in scans.windows(2) {
        assert_eq!(pair[1].sequence, pair[0].sequence + 1, "sequence");
        assert_eq!(pair[1].tick, pair[0].tick + u64::from(schedule.frame_ticks), "tick of {}", pair[1].sequence);
    }
}

/// Ticks from the pins' first edge to the tick of the first scan: the same for all scans, as their
/// ticks and the pins' frames both are one frame apart.
pub fn tick_offset(bench: &mut Talk, scans: &[RawScan], start: Ticks) -> i64 {
    (bench.origin() + scans[0].tick) as i64 - start as i64
}

/// Light on `cell` in its slot, for a level of its own emitter of 1.
fn light_on(plan: &CompiledScene<f64>, schedule: &Schedule, cell: usize, levels: &[Level], pose: &Pose) -> Pair<f64> {
    let slot = schedule.lit_slot(cell).expect("each cell is lit");
    let mut sum = Pair::<f64>::default();
    for emitter in schedule.slots[slot].emitters() {
        let pair = plan.crosstalk(cell, emitter, pose);
        let share = levels[emitter].relative() / levels[cell].relative();
        sum.i_x1_a += share * pair.i_x1_a;
        sum.i_x2_a += share * pair.i_x2_a;
    }
    sum
}

/// The largest difference between what the host's front end makes of `scans` and the light of the
/// model on each cell, the tool at rest where each electrode has another, in codes of one conversion.
pub fn worst_codes(scans: &[RawScan], configuration: &Configuration) -> f64 {
    let Configuration { schedule, .. } = configuration;
    let (scene, scaling) = (WIDE.read().expect("shipped"), default_scaling());
    let stage = Stage::new(&scene, schedule, &scaling);
    let plan = CompiledScene::<f64>::compile(&scene.scene, TIER).expect("the scene is valid");
    let cells = usize::from(schedule.cells);
    let pose = at_rest().pose(0.0);
    let expected: Vec<_> = (0..cells).map(|cell| light_on(&plan, schedule, cell, scans[0].levels(), &pose)).collect();
    let mut worst: f64 = 0.0;
    for scan in scans {
        let currents = stage.photocurrents(scan);
        for (cell, expected) in expected.iter().enumerate() {
            let Reading::Light(seen) = currents.cells[cell] else {
                panic!("scan {}, cell {cell}: {:?}", scan.sequence, currents.cells[cell]);
            };
            let code_a = scaling.amperes_per_code.abs() / scan.levels()[cell].relative();
            let differences = [seen.i_x1_a - expected.i_x1_a, seen.i_x2_a - expected.i_x2_a];
            worst = differences.iter().map(|a| (a / code_a).abs()).fold(worst, f64::max);
        }
    }
    worst
}
