//! The tool as a 6-DoF mouse, for programs that use libspnav: Blender, FreeCAD, and others.
//!
//! Such programs connect to the Unix socket of spacenavd. This is its protocol of version 0, which all of them speak; a
//! client that asks for a later one is told so. A message to a client is an event of eight 32-bit integers in the host's byte
//! order: kind (0: motion), x, y, z, rx, ry, rz, and the milliseconds since the event before. A message of a client is a
//! 32-bit float, its sensitivity, or the request for another version, `0x7faa5500 | version`, which has an answer of the
//! same form. (Source: `proto.h`, `spnav.c` of libspnav 1.1.)
//!
//! Displacement from the zero pose gives the rate, as that of a 6-DoF mouse does: at rest, at zero, or without a pose
//! nothing moves.

mod server;

use std::str::FromStr;

use glam::DVec3;
use slitpose_head::scene_file::Workspace;
use slitpose_model::{Pose, rotation_log};

pub(crate) use server::{SpacenavInput, SpacenavServer};

/// Full deflection of the usual devices: ±350 steps.
const FULL: f64 = 350.0;

/// Which axes of the base point to the right, up, and into the screen, as libspnav's users take the three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axes([(usize, f64); 3]);

impl FromStr for Axes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || {
            format!(
                "`{text}` does not name x, y and z once each; give the axes to the right, up and into the screen, such as x,z,y or y,z,-x"
            )
        };
        let axis = |name: &str| {
            let (sign, name) = name.strip_prefix('-').map_or((1.0, name), |name| (-1.0, name));
            ["x", "y", "z"].iter().position(|axis| *axis == name).map(|axis| (axis, sign))
        };
        let axes: Option<Vec<_>> = text.split(',').map(|name| axis(name.trim())).collect();
        let axes: [(usize, f64); 3] = axes.and_then(|axes| axes.try_into().ok()).ok_or_else(error)?;
        let mut named = axes.map(|(axis, _)| axis);
        named.sort_unstable();
        if named == [0, 1, 2] { Ok(Self(axes)) } else { Err(error()) }
    }
}

/// How the tool feels as a mouse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Feel {
    /// Full deflections at the edge of the workspace.
    pub gain: f64,
    /// Share of the workspace around zero in which an axis gives nothing, 0 to 1.
    pub dead_zone: f64,
    pub axes: Axes,
}

impl Feel {
    /// The motion of a tool at `pose`, relative to `zero`, in steps.
    fn motion(&self, workspace: &Workspace, zero: &Pose, pose: &Pose) -> [i32; 6] {
        let moved = (pose.translation_m - zero.translation_m) / workspace.half_extent_m;
        let turned = rotation_log(pose.rotation * zero.rotation.inverse()) / workspace.half_extent_rad;
        let [x, y, z] = self.axes.0.map(|(axis, sign)| sign * self.shaped(moved, axis));
        // A mirrored frame turns the other way round: in one that is left-handed, a rotation about the axis to the right has
        // the sign that its users expect of the device.
        let [rx, ry, rz] = self.axes.0.map(|(axis, sign)| sign * self.shaped(turned, axis));
        [x, y, z, rx, ry, rz].map(|value| value.round() as i32)
    }

    fn shaped(&self, deflection: DVec3, axis: usize) -> f64 {
        // A workspace without extent along an axis has no motion along it.
        let deflection = Some(deflection[axis]).filter(|value| value.is_finite()).unwrap_or(0.0);
        let beyond = (deflection.abs() - self.dead_zone).max(0.0) / (1.0 - self.dead_zone);
        (FULL * self.gain * beyond).min(FULL).copysign(deflection)
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::os::unix::net::UnixStream;
    use std::path::Path;
    use std::time::Duration;

    use glam::DVec3;
    use slitpose_head::scene_file::Workspace;
    use slitpose_model::Pose;

    use super::server::{MAX_CLIENTS, SpacenavServer};
    use super::*;

    /// Longer than any answer takes on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(60);

    fn start(path: &Path) -> SpacenavServer {
        let feel = Feel { gain: 1.0, dead_zone: 0.0, axes: "x,z,y".parse().unwrap() };
        let workspace = Workspace { half_extent_m: DVec3::splat(3.5e-3), half_extent_rad: DVec3::splat(0.35) };
        SpacenavServer::start(path, feel, workspace).unwrap()
    }

    fn connect(path: &Path) -> UnixStream {
        let stream = UnixStream::connect(path).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// The next event: kind, motion, period.
    fn event(stream: &mut UnixStream) -> (i32, [i32; 6], i32) {
        let mut bytes = [0; 32];
        stream.read_exact(&mut bytes).unwrap();
        let numbers: Vec<i32> = bytes.as_chunks().0.iter().map(|word| i32::from_ne_bytes(*word)).collect();
        (numbers[0], numbers[1..7].try_into().unwrap(), numbers[7])
    }

    /// Shows a pose as soon as the server takes it.
    fn show(server: &SpacenavServer, pose: Option<Pose>) {
        while !server.input.see(pose) {
            std::thread::yield_now();
        }
    }

    fn at(x_m: f64) -> Option<Pose> {
        Some(Pose::from_vectors(DVec3::new(x_m, 0.0, 1e-3), DVec3::new(0.0, 0.0, 0.1)))
    }

    /// Says hello, and waits until the server has let this client in: it answers.
    fn greeted(server: &SpacenavServer, path: &Path) -> UnixStream {
        let mut stream = connect(path);
        stream.write_all(&0x7faa_5501_u32.to_ne_bytes()).unwrap();
        show(server, None);
        let mut answer = [0; 4];
        stream.read_exact(&mut answer).unwrap();
        assert_eq!(u32::from_ne_bytes(answer), 0x7faa_5500, "version 0");
        stream
    }

    #[test]
    fn a_client_gets_motion_and_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("spnav");
        let server = start(&path);
        let mut client = greeted(&server, &path);
        show(&server, at(2e-3));
        let (kind, motion, period_ms) = event(&mut client);
        assert_eq!((kind, motion), (0, [200, 100, 0, 0, 100, 0]));
        assert!((0..=1000).contains(&period_ms), "{period_ms}");
        // Without a pose it rests, and says so once.
        show(&server, None);
        assert_eq!(event(&mut client).1, [0; 6]);
        show(&server, None);
        client.write_all(&0.5_f32.to_ne_bytes()).unwrap();
        show(&server, None);
        show(&server, at(-2e-3));
        assert_eq!(event(&mut client).1, [-100, 50, 0, 0, 50, 0], "half as sensitive");
        server.input.zero();
        show(&server, at(1e-3));
        assert_eq!(event(&mut client).1, [0; 6]);
        show(&server, at(2e-3));
        assert_eq!(event(&mut client).1, [50, 0, 0, 0, 0, 0], "relative to the new zero");
    }

    #[test]
    fn clients_that_leave_say_nonsense_or_are_too_many_harm_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("spnav");
        let server = start(&path);
        let mut client = greeted(&server, &path);
        drop(connect(&path));
        // Once it is let in, the one before is gone.
        let mut odd = greeted(&server, &path);
        odd.write_all(&f32::NAN.to_ne_bytes()).unwrap();
        odd.write_all(&[1, 2, 3]).unwrap();
        show(&server, None);
        let rest: Vec<_> = (0..MAX_CLIENTS).map(|_| connect(&path)).collect();
        show(&server, at(2e-3));
        assert_eq!(event(&mut client).1[0], 200);
        assert_eq!(event(&mut odd).1[0], 200);
        // The last are not let in.
        let closed =
            rest.into_iter().filter_map(|mut stream| stream.read(&mut [0; 32]).ok().filter(|count| *count == 0));
        assert_eq!(closed.count(), 2);
        drop(server);
        assert!(!path.exists());
    }

    #[test]
    fn a_client_that_reads_late_learns_that_the_tool_rests() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("spnav");
        let server = start(&path);
        let (mut client, mut late) = (greeted(&server, &path), greeted(&server, &path));
        // More events than the queue of one that does not read holds.
        for _ in 0..4_000 {
            show(&server, at(2e-3));
            assert_eq!(event(&mut client).1, [200, 100, 0, 0, 100, 0]);
        }
        show(&server, None);
        assert_eq!(event(&mut client).1, [0; 6]);
        let mut read = 0;
        while event(&mut late).1 != [0; 6] {
            read += 1;
        }
        assert!((1..4_000).contains(&read), "{read}");
    }

    const WORKSPACE: Workspace = Workspace { half_extent_m: DVec3::splat(4e-3), half_extent_rad: DVec3::splat(0.25) };

    fn feel(axes: &str) -> Feel {
        Feel { gain: 1.0, dead_zone: 0.1, axes: axes.parse().unwrap() }
    }

    #[test]
    fn axes_are_read_or_refused() {
        assert_eq!("y,-z,-x".parse(), Ok(Axes([(1, 1.0), (2, -1.0), (0, -1.0)])));
        for text in ["", "x,y", "x,y,y", "x,y,z,x", "x,y,w", "--x,y,z", "x;y;z"] {
            assert!(text.parse::<Axes>().is_err(), "{text}");
        }
    }

    /// libspnav's `spnav_posrot_moveobj` (util.c) moves an object in OpenGL's frame (x right, y up, z out of the screen,
    /// right-handed) by (x, y, -z) and turns it about (rx, ry, -rz). With x to the right, y away and z up, that has to be
    /// the motion of the tool.
    #[test]
    fn an_object_in_opengl_follows_the_tool() {
        let opengl = |motion: [i32; 6]| {
            let [x, y, z, rx, ry, rz] = motion.map(f64::from);
            (DVec3::new(x, y, -z), DVec3::new(rx, ry, -rz))
        };
        let opengl_from_base = |v: DVec3| DVec3::new(v.x, v.z, -v.y);
        let (t, r) = (DVec3::new(1e-3, -2e-3, 3e-3), DVec3::new(0.05, 0.1, -0.15));
        let still = Feel { dead_zone: 0.0, ..feel("x,z,y") };
        let motion = still.motion(&WORKSPACE, &Pose::HOME, &Pose::from_vectors(t, r));
        let (moved, turned) = opengl(motion);
        assert!(moved.distance(opengl_from_base(t) / 4e-3 * FULL) < 1.0, "{moved}");
        assert!(turned.distance(opengl_from_base(r) / 0.25 * FULL) < 1.0, "{turned}");
    }

    #[test]
    fn deflection_grows_from_the_dead_zone_to_the_edge_and_no_further() {
        let x = |x_m: f64, zero_m: f64| {
            let at = |x_m| Pose::from_vectors(DVec3::new(x_m, 0.0, 0.0), DVec3::ZERO);
            feel("x,z,y").motion(&WORKSPACE, &at(zero_m), &at(x_m))[0]
        };
        assert_eq!((x(0.39e-3, 0.0), x(-0.39e-3, 0.0)), (0, 0));
        assert_eq!((x(2.2e-3, 0.0), x(-2.2e-3, 0.0)), (175, -175));
        assert_eq!((x(4e-3, 0.0), x(0.1, 0.0)), (350, 350));
        assert_eq!((x(1e-3, 1e-3), x(3.2e-3, 1e-3)), (0, 175), "relative to zero");
        let flat = Workspace { half_extent_m: DVec3::new(4e-3, 4e-3, 0.0), ..WORKSPACE };
        assert_eq!(feel("x,y,z").motion(&flat, &Pose::HOME, &Pose::HOME), [0; 6], "an axis without extent");
    }
}
