//! Seeded random poses, tables of them, and the way from one to the next.

use std::fmt::Write;

use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_model::Pose;

use crate::consistency;

/// A generator whose seed stands in the test's output.
pub fn generator(seed: u64) -> ChaCha8Rng {
    println!("seed {seed}");
    ChaCha8Rng::seed_from_u64(seed)
}

/// A pose as tables give it: millimetres, and a rotation vector in radians.
pub type PoseRow = [f64; 6];

/// Poses whose components are uniform within ±`half_mm` and ±`half_deg`.
pub fn in_box(rng: &mut ChaCha8Rng, half_mm: f64, half_deg: f64, count: usize) -> Vec<PoseRow> {
    (0..count).map(|_| one_in_box(rng, half_mm, half_deg)).collect()
}

pub fn one_in_box(rng: &mut ChaCha8Rng, half_mm: f64, half_deg: f64) -> PoseRow {
    let half_rad = half_deg.to_radians();
    std::array::from_fn(|axis| {
        let half = if axis < 3 { half_mm } else { half_rad };
        rng.random_range(-half..half)
    })
}

pub fn pose([tx, ty, tz, rx, ry, rz]: PoseRow) -> Pose {
    Pose { rotation: DQuat::from_scaled_axis(DVec3::new(rx, ry, rz)), translation_m: DVec3::new(tx, ty, tz) * 1e-3 }
}

/// The table that `slitpose model` reads, ids `<prefix>0`, `<prefix>1`, …
pub fn table(prefix: &str, rows: &[PoseRow]) -> String {
    let mut text = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n".to_owned();
    for (i, [tx, ty, tz, rx, ry, rz]) in rows.iter().enumerate() {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{prefix}{i},{tx:?},{ty:?},{tz:?},{rx:?},{ry:?},{rz:?}");
    }
    text
}

/// The rigid motion between two poses at a constant twist in the base frame: `share` of the way.
pub fn between(start: &Pose, end: &Pose, share: f64) -> Pose {
    let error = consistency::error(end, start);
    let turn = DVec3::new(error[3], error[4], error[5]) * share;
    Pose {
        rotation: DQuat::from_scaled_axis(turn) * start.rotation,
        translation_m: start.translation_m.lerp(end.translation_m, share),
    }
}
