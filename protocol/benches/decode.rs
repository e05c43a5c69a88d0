//! How many scans a second the codec takes: batches of four scans, six cells, lit and
//! dark words, which is what a board sends at 4 kHz.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use slitpose_protocol::{
    Batch, BatchBuilder, Decoder, EmitterSet, Level, MAX_MESSAGE_BYTES, MAX_SCAN_BYTES, Message, Schedule, encode,
};

const SCANS_PER_BATCH: u64 = 4;
const BATCHES: u64 = 250;

fn schedule() -> Schedule {
    Schedule {
        tick_hz: 170_000_000,
        frame_ticks: 42_500,
        slots: [EmitterSet::of(&[0, 3]), EmitterSet::of(&[1, 4]), EmitterSet::of(&[2, 5]), EmitterSet::DARK]
            .into_iter()
            .collect(),
        slot_ticks: 5_800,
        settling_ticks: 2_210,
        conversion_ticks: 148,
        oversampling: 4,
        cells: 6,
    }
}

fn builder(schedule: &Schedule, first: u64) -> BatchBuilder<{ 4 * MAX_SCAN_BYTES }> {
    let mut builder = BatchBuilder::new(1, schedule, SCANS_PER_BATCH as usize);
    for sequence in first..first + SCANS_PER_BATCH {
        let mut scan = builder.blank();
        scan.sequence = sequence;
        scan.tick = sequence * u64::from(schedule.frame_ticks);
        scan.levels_mut().fill(Level::NOMINAL);
        for (k, pair) in scan.lit_mut().iter_mut().enumerate() {
            *pair = [8_000 + 257 * k as u16, 9_000 + sequence as u16];
        }
        assert!(builder.push(&scan));
    }
    builder
}

fn codec(criterion: &mut Criterion) {
    let schedule = schedule();
    let mut stream = Vec::new();
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    for batch in 0..BATCHES {
        let builder = builder(&schedule, batch * SCANS_PER_BATCH);
        let message = Message::Batch(builder.batch().expect("scans were pushed"));
        stream.extend(encode(&message, &mut buffer).expect("four scans fit"));
    }

    let mut group = criterion.benchmark_group("codec");
    group.throughput(Throughput::Elements(BATCHES * SCANS_PER_BATCH));
    group.bench_function("decode scans", |bencher| {
        let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
        bencher.iter(|| {
            let mut input = black_box(stream.as_slice());
            while let Some(result) = decoder.next::<Message>(&mut input) {
                let Ok(Message::Batch(batch)) = result else {
                    panic!("only batches were encoded");
                };
                for scan in batch.scans(&schedule).expect("the schedule it was made by") {
                    black_box(scan);
                }
            }
        });
    });
    group.throughput(Throughput::Elements(SCANS_PER_BATCH));
    group.bench_function("encode scans", |bencher| {
        let builder = builder(&schedule, 4_000_000);
        let batch: Batch<'_> = builder.batch().expect("scans were pushed");
        let message = Message::Batch(batch);
        bencher.iter(|| encode(black_box(&message), &mut buffer).map(<[u8]>::len));
    });
    group.finish();
}

criterion_group!(benches, codec);
criterion_main!(benches);
