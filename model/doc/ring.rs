{
    use glam::{DVec2, DVec3};
    use slitpose_model::*;
    let cell = |k: i32| {
        let (sin, cos) = (std::f64::consts::FRAC_PI_3 * f64::from(k)).sin_cos();
        let (out, along) = (DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0));
        let rising = if k % 2 == 0 { 1.0 } else { -1.0 };
        Cell {
            detector: Detector {
                centre_base_m: 25e-3 * out,
                x_axis_base: (along + rising * DVec3::Z) * std::f64::consts::FRAC_1_SQRT_2,
                normal_base: -out,
                length_m: 12e-3,
                width_m: 1e-3,
                responsivity_a_per_w: 0.54,
                dark_current_a: 0.0,
                interelectrode_ohm: None,
                saturation_a: None,
                faint_a: DEFAULT_FAINT_A,
            },
            slit: Slit {
                distance_m: 5e-3,
                width_m: 0.6e-3,
                length_m: 10e-3,
                offset_m: DVec2::ZERO,
                tilt_rad: DVec3::ZERO,
                thickness_m: 0.0,
            },
            emitter: Emitter {
                position_tool_m: 10e-3 * out,
                axis_tool: out,
                radiant_intensity_w_per_sr: 3.16e-3,
                profile: Profile::from_half_angle(55_f64.to_radians()),
            },
            effects: Effects::default(),
        }
    };
    Scene { cells: (0..6).map(cell).collect(), ..Scene::default() }
}
