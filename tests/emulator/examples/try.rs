use slitpose::scene_file::Shipped;
use slitpose::simulator::{Trajectory, TrajectoryKind};
use slitpose_emulator::rig::{Rig,open_image,default_image_path};
use slitpose_emulator::world::NoiseSource;
use slitpose_protocol::{Command, Decoder, Message};
fn main() {
    let image = open_image(None).unwrap();
    println!("flash {} ram {}", image.flash_bytes(), image.static_ram_bytes());
    let scene = Shipped::named("wide").unwrap().read().unwrap();
    let mut rig = Rig::boot(&image, &scene, Trajectory::of_kind(TrajectoryKind::Smooth, 1, 10.0), NoiseSource::Seeded(1)).unwrap();
    let m = rig.machine();
    println!("boot {:?} now {} pc {:x} {:?}", m.device_clock_origin(), m.now(), m.cpu.pc(), m.cpu.last_fault());
    for f in rig.faults() { println!("{f}"); }
    let t = std::time::Instant::now();
    println!("{:?}", rig.run_for(0.3));
    let m = rig.machine(); let load = m.awake_ticks() as f64 / m.now() as f64;
    println!("configured {} resets {:?} fault {:?} load {}", m.board.usb_host.is_configured(), m.resets(), m.cpu.last_fault(), load);
    rig.set_open(true);
    rig.run_for(0.05);
    rig.send(Command::Start);
    let secs: f64 = std::env::args().nth(1).map_or(1.0, |s| s.parse().unwrap());
    let a0 = (rig.machine().awake_ticks(), rig.now());
    let i0 = rig.machine().cpu.instructions();
    let t1 = std::time::Instant::now();
    println!("{:?}", rig.run_for(secs));
    let w = t1.elapsed().as_secs_f64();
    println!("wall {:.3} device {secs} ratio {:.2}, {:.1} MIPS, load {:.3} stack {}", w, secs / w, (rig.machine().cpu.instructions() - i0) as f64 / w / 1e6, (rig.machine().awake_ticks() - a0.0) as f64 / (rig.now() - a0.1) as f64, 0); println!("stack {}", rig.stack_bytes());
    let bytes = rig.take_bytes();
    let mut d = Decoder::<1024>::new();
    let mut b = &bytes[..];
    let (mut n, mut batches) = (0, 0);
    while let Some(m) = d.next::<Message>(&mut b) {
        match m { Ok(Message::Batch(_)) => batches += 1, Ok(m) => if n < 12 { n += 1; println!("{m:?}") }, Err(e) => println!("{e}") }
    }
    println!("bytes {} batches {batches} counters {:?}", bytes.len(), d.counters());
    for f in rig.faults().iter().take(20) { println!("{f}"); }
    let _ = t;
    // profile
    let out = std::process::Command::new("nm").args(["-C", "-n"]).arg(default_image_path()).output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout).to_string();
    let mut syms: Vec<(u32, String)> = text.lines().filter_map(|l| { let mut p = l.splitn(3, ' '); let a = u32::from_str_radix(p.next()?, 16).ok()?; let k = p.next()?; if !"tT".contains(k) { return None } let n: String = p.next()?.chars().take(110).collect(); if n.starts_with('$') { return None } Some((a, n)) }).collect();
    syms.sort();
    let mut counts = std::collections::HashMap::new();
    let mut total = 0;
    let mut last = rig.machine().cpu.instructions();
    for _ in 0..200_000 {
        let end = rig.now() + 199;
        rig.machine().run_until(end);
        let i = rig.machine().cpu.instructions();
        if i != last {
            let pc = rig.machine().cpu.pc();
            let k = syms.partition_point(|s| s.0 <= pc) - 1;
            let mut name = syms[k].1.clone();
            if name.contains("mem::memcpy") || name.contains("aeabi_memcpy") { let lr = rig.machine().cpu.state().r[14]; let k = syms.partition_point(|s| s.0 <= lr) - 1; name = format!("{name} <- {}+{:x}", syms[k].1, lr - syms[k].0); }
            *counts.entry(name).or_insert(0u32) += 1;
            total += 1;
        }
        last = i;
    }
    let mut v: Vec<_> = counts.into_iter().collect();
    v.sort_by_key(|x| std::cmp::Reverse(x.1));
    for (name, c) in v.iter().take(28) { println!("{:5.1} % {name}", 100.0 * *c as f64 / total as f64); }
}
