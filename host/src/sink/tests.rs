//! The output of each format.

use slitpose_model::{MotionPrior, Photocurrents, Solver, Start};

use super::{Account, Format, open};
use crate::clock::HostTime;
use crate::link::DeviceId;
use crate::pipeline::Record;

fn record(host_time: Option<HostTime>) -> Record {
    Record {
        device: DeviceId(*b"simulated\0\0\0"),
        sequence: 0,
        device_time_s: 0.0,
        host_time,
        arrival: None,
        solution: Solver::<f64>::empty().solve(&Photocurrents::default(), Start::Cold, &MotionPrior::AT_REST),
        twist: None,
        filtered: None,
        simulated: true,
        truth: None,
    }
}

#[test]
fn host_times_are_written_only_where_they_are_known() {
    let time = HostTime { monotonic_ns: 90_000_250_000, utc_ns: 1_700_000_090_000_250_000, uncertainty_ns: 140_000 };
    let records = [record(None), record(Some(time))];
    let written = |format| {
        let mut output = Vec::new();
        let mut sink = open(format, &mut output, false).unwrap();
        for record in &records {
            sink.pose(record).unwrap();
        }
        sink.finish(&Account::default).unwrap();
        drop(sink);
        String::from_utf8(output).unwrap()
    };
    let [monotonic, utc, uncertainty] = [time.monotonic_ns, time.utc_ns, time.uncertainty_ns];
    let (ndjson, csv) = (written(Format::Ndjson), written(Format::Csv));
    let lines: Vec<&str> = ndjson.lines().collect();
    let device = r#""device":"73696d756c61746564000000""#;
    assert!(lines[0].contains(device) && !lines[0].contains("host_"), "{}", lines[0]);
    let times = format!(r#""host_monotonic_ns":{monotonic},"host_utc_ns":{utc},"host_uncertainty_ns":{uncertainty},"#);
    assert!(lines[1].contains(device) && lines[1].contains(&times), "{}", lines[1]);
    let lines: Vec<&str> = csv.lines().collect();
    assert!(lines[0].ends_with(",device,host_monotonic_ns,host_utc_ns,host_uncertainty_ns"), "{csv}");
    assert!(lines[1].ends_with(",73696d756c61746564000000,,,"), "{csv}");
    assert!(lines[2].ends_with(&format!(",{monotonic},{utc},{uncertainty}")), "{csv}");
}
