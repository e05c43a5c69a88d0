use slitpose::scene_file::Shipped;
use slitpose::simulator::{Trajectory, TrajectoryKind};
use slitpose_emulator::image::Image;
use slitpose_emulator::rig::Rig;
use slitpose_emulator::world::NoiseSource;
use slitpose_protocol::{Command, Decoder, Message};
fn main() {
    let image = Image::read(&Image::default_path()).unwrap();
    println!("flash {} ram {}", image.flash_bytes(), image.ram_bytes());
    let scene = Shipped::named("wide").unwrap().read().unwrap();
    let mut rig = Rig::boot(&image, &scene, Trajectory::of_kind(TrajectoryKind::Smooth, 1, 10.0), NoiseSource::Seeded(1)).unwrap();
    let m = rig.machine();
    println!("boot {:?} now {} pc {:x} {:?}", m.board().device_clock(), m.now(), m.cpu().pc(), m.cpu().last_fault());
    for f in rig.faults() { println!("{f}"); }
    let t = std::time::Instant::now();
    println!("{:?}", rig.run_for(0.3));
    let m = rig.machine(); let load = m.take_load();
    println!("configured {} resets {:?} fault {:?} load {}", m.board().usb_host.is_configured(), m.resets(), m.cpu().last_fault(), load);
    rig.set_open(true);
    rig.run_for(0.05);
    rig.send(Command::Start);
    let secs: f64 = std::env::args().nth(1).map_or(1.0, |s| s.parse().unwrap());
    rig.machine().take_load();
    let i0 = rig.machine().cpu().instructions();
    let t1 = std::time::Instant::now();
    println!("{:?}", rig.run_for(secs));
    let w = t1.elapsed().as_secs_f64();
    println!("wall {:.3} device {secs} ratio {:.2}, {:.1} MIPS, load {:.3} stack {}", w, secs / w, (rig.machine().cpu().instructions() - i0) as f64 / w / 1e6, rig.machine().take_load(), 0); println!("stack {}", rig.machine().stack_bytes());
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
}
