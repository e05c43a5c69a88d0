//! Control loops on shared memory, and daemons that are killed.
#![cfg(target_os = "linux")]

use std::process::{Child, Command, Stdio};

use slitpose_tests::process::{Finished, address_said, compile, name_in};
use slitpose_tests::slitpose;

#[test]
fn a_loop_on_shared_memory_notices_a_killed_daemon_and_the_next_takes_its_memory_over() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let address = format!("shm:{}", name_in(folder.path(), "pose"));
    let client = compile("host/examples/c/follow_pose.c", folder.path());
    let follow = |count: &str| {
        let mut command = Command::new(&client);
        command.args([&address, count]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts")
    };
    let start = || {
        let arguments = ["run", "--config", "none", "--device", "sim", "--format", "none", "--publish", &address];
        let mut daemon = slitpose!().spawn(arguments);
        assert_eq!(address_said(&mut daemon, "poses at "), address);
        daemon
    };
    let refused = |client: Child| Finished::of(client).assert_said(1, &["Connection refused"]);

    let mut first = start();
    assert_eq!(Finished::of(follow("50")).done().lines().count(), 50);
    let endless = follow("-1");
    let second = slitpose!().run(["run", "--config", "none", "--device", "sim", "--publish", &address]);
    second.assert_refused(1, &["another program serves", &address]);
    first.kill().and_then(|()| first.wait()).expect("killed");
    refused(endless);
    refused(follow("1"));

    let third = start();
    assert_eq!(Finished::of(follow("50")).done().lines().count(), 50);
    Finished::interrupted(third).done();
    refused(follow("1"));
}
