//! Command lines that are refused before any work: each with its exit code, a message that names what is wrong and what to
//! do, and nothing on standard output. Those that need a board, a file or a place to write are beside what they are about.

use slitpose_tests::slitpose;

/// What is given to `slitpose`, its exit code (2: wrong usage), and what it says.
const REFUSED: &[(&str, i32, &[&str])] = &[
    ("", 2, &["Usage"]),
    ("frobnicate", 2, &["frobnicate"]),
    ("completions dish", 2, &["'dish'"]),
    ("run --device sim --scene wide,base,wide", 2, &["3 scenes for 1 boards"]),
    ("run --device sim --duration soon", 2, &["such as 10s"]),
    ("run --device sim --duration 0s", 2, &["such as 10s"]),
    ("run --device sim --speed 0", 2, &["such as 1 or 0.5"]),
    ("run --device sim --format xml", 2, &["ndjson"]),
    ("run --device sim --seed one", 2, &["--seed"]),
    ("run --device sim --scene bench --duration 1ms", 1, &["bench", "[front_end]", "add one"]),
    ("run --patience 0s --device /dev/no-such-board", 1, &["there is no /dev/no-such-board", "--device sim"]),
    ("run --patience 0s --device /dev/null", 1, &["cannot be opened as a serial port"]),
    ("run --patience 0s --device /etc/hosts", 1, &["file, not a serial port"]),
    ("run --patience 0s --device /", 1, &["folder, not a serial port"]),
    ("run --patience 0s --device auto", 1, &["no board found"]),
    ("run --patience 0s --device 0036002900544850025a0320", 1, &["is not there"]),
    ("run --device 3600290054485002", 2, &["is neither"]),
    ("run --device /dev/no-such-board --seed 1", 2, &["--seed", "/dev/no-such-board"]),
    ("run --device /dev/no-such-board --speed 1", 2, &["--speed", "/dev/no-such-board"]),
    ("run --device /dev/no-such-board --trajectory smooth", 2, &["--trajectory", "/dev/no-such-board"]),
    ("run --device sim --fault oclude:cell=1", 2, &["`oclude`", "`occlude` is"]),
    ("run --device sim --duration 1s --fault occlude:cell=6", 2, &["occlude:cell=6", "0 to 5"]),
    ("run --device /dev/null --fault flip", 2, &["--fault", "--device sim"]),
    ("run --config none --device sim --live 0.0.0.0:0", 1, &["0.0.0.0:0", "--live-token"]),
    ("model wide", 2, &["--poses"]),
    ("model wide --poses - --tier best", 2, &["paper, exact"]),
    ("model wide --poses - --tolerance 0", 2, &["between 0 and 1"]),
    ("model wide --poses - --tolerance 1", 2, &["between 0 and 1"]),
    ("model wide --poses no/such.csv", 1, &["cannot read no/such.csv", "give a CSV file"]),
    ("model wide --poses /dev/zero", 1, &["cannot read /dev/zero", "a device"]),
    (
        "model no/such.toml --poses -",
        1,
        &["no/such.toml", "wide, fine, redundant, orderable, spacemouse, maglev, base, bench"],
    ),
    ("solve wide", 2, &["--currents"]),
    ("replay", 2, &["<FILE>"]),
    ("replay /dev/null", 1, &["/dev/null", "no regular file"]),
    ("replay /dev/null --fault dead:emitter=1", 2, &["dead:emitter=1", "`simulate`"]),
    ("replay --live capture.mcap", 2, &["capture.mcap", "is no address"]),
    ("simulate", 2, &["--output"]),
    ("simulate --output /dev/null --fault hangup", 2, &["hangup", "--patience"]),
    ("simulate --output - --trajectory contct", 1, &["no motion is called contct (did you mean `contact`?)"]),
    ("scene check wied", 1, &["wied", "did you mean `wide`?"]),
    ("scene check bas", 1, &["bas", "did you mean `base`?"]),
    ("scene check bnech", 1, &["bnech", "did you mean `bench`?"]),
    ("scene check /dev/zero", 1, &["`/dev/zero`", "a device", "regular file"]),
    ("scene view wide --live [::]:0 --live-token short", 1, &["5 characters", "16"]),
    ("scene view wide --live [::]:0 --live-token correct:horse:battery", 1, &["`:` is none of them"]),
    ("scene export wide --python ./no-python --output x", 1, &["./no-python", "install Python 3.11", "--python"]),
    ("scene optimise wide", 1, &["--free"]),
    ("scene optimise wide --free slit", 2, &["there is no `slit`", "slit_width"]),
    ("scene optimise wide --free roll=9", 2, &["`9` are no bounds", "roll=0..90"]),
    ("scene optimise wide --free roll --lit 999", 2, &["'999'", "from 0 to 100"]),
    ("scene optimise wide --free roll --radius inf", 2, &["'inf'", "in mm"]),
    ("scene optimise bench --free full_scale", 1, &["no [front_end]", "leave full_scale out"]),
    ("scene map base --schedule 4000 --samples 10", 1, &["no [front_end]", "wide"]),
    (
        "scene map wide --schedule 30000 --samples 10",
        1,
        &["the frame period is 33.3 µs", "lower front_end.frame_rate_hz"],
    ),
    ("scene map bench --samples 10 --tolerance-study", 1, &["no pose anywhere in its workspace", "`wide`"]),
    ("scene map base --samples 10 --output no/m.svg", 1, &["no/m.svg is to be a folder"]),
    ("compare", 2, &["SCENE"]),
    ("compare wide no.toml", 1, &["cannot read scene `no.toml`"]),
    ("report", 2, &["--output"]),
    ("report bench --output no/report", 1, &["1 cells gives no pose at home", "unobservable", "wide"]),
    ("doctor --step dark", 2, &["--bring-up"]),
    ("doctor --bring-up --step 13", 2, &["`13`", "crosstalk"]),
    ("doctor --bring-up --bundle report.tar.gz", 2, &["--bundle"]),
    ("device list --search /dev/tty[", 2, &["/dev/tty[", "pattern"]),
    ("device info --device usb", 2, &["usb", "serial number", "device list"]),
];

#[test]
fn command_lines_that_cannot_be_followed_are_refused_with_what_to_do() {
    for (words, code, parts) in REFUSED {
        println!("slitpose {words}");
        slitpose!().run(words.split_whitespace()).assert_refused(*code, parts);
    }
}
