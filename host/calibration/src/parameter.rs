//! What calibration may change of a head: the parameters of its cells, and how a cell follows from them.

use std::fmt;

use glam::{DMat3, DQuat, DVec2, DVec3};
use slitpose_model::{
    Cell, Converters, MAX_CONVERTER, MAX_NONLINEARITY, Opening, Profile, Stray, Window, rotation_exp,
};

/// Refractive index of a cover that the scene does not mention: clear resin.
pub(crate) const RESIN_INDEX: f64 = 1.52;

/// A parameter of a cell, as a deviation from the scene, SI units.
///
/// Detectors and slits shift and turn in the scene's own cell frame; emitters in the tool frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// The detector, and with it a slit on the base, along the cell's x, y or z: metres.
    DetectorShift(u8),
    /// Component of the detector's rotation vector, radians.
    DetectorTurn(u8),
    /// The slit along the detector's x, metres.
    SlitOffset,
    /// Distance of the slit from the detector, metres.
    SlitDistance,
    /// Width of the slit, metres.
    SlitWidth,
    /// Component of the slit's rotation vector, radians.
    SlitTilt(u8),
    /// Thickness of the mask, metres.
    MaskThickness,
    /// The emitter along the tool's x, y or z: metres.
    EmitterShift(u8),
    /// Rotation of the emitter's axis about one of two directions across it, radians.
    EmitterTilt(u8),
    /// Natural logarithm of the emitter's intensity.
    LogIntensity,
    /// Exponent of the emitter's profile.
    ProfileExponent,
    /// Term of [`slitpose_model::ProfileShape::radial`].
    ProfileRadial(u8),
    /// Term of [`slitpose_model::ProfileShape::azimuthal`].
    ProfileAzimuthal(u8),
    /// Thickness of the detector's cover, metres.
    WindowThickness,
    /// Legendre coefficient of the detector's non-linearity in ξ = 2·X_A/Lx, of this order: metres.
    Nonlinearity(u8),
    /// Stray current of an electrode with the tool at home, amperes.
    Stray(u8),
    /// Relative change of the stray light of both electrodes by the tool's translation: term 0 to 2 along x, y or z, per
    /// metre; then the terms of [`Stray::quadratic_a_per_m2`], per square metre.
    StrayLevel(u8),
    /// The same, added on electrode 2 and taken from electrode 1: stray light that wanders along the detector.
    StrayBalance(u8),
    /// Change of the stray light of an electrode by the tool's rotation, a term of [`Stray::turning_a`], those of electrode 1
    /// first: amperes.
    StrayTurning(u8),
    /// Gain of electrode 2 over that of electrode 1, relative.
    ElectrodeGain,
    /// Legendre coefficient of the curve of the converters of all first or second electrodes, of this order: amperes.
    Converter(u8, u8),
}

/// Quantities of one kind, one for each term.
pub(crate) struct Kind {
    of: fn(u8) -> Quantity,
    name: &'static str,
    terms: &'static [&'static str],
    unit: &'static str,
    /// Quantities with the same number have one size, which the data may tell, though the tolerances do not; `None`: the
    /// tolerances do.
    pub(crate) family: Option<usize>,
    /// What deviates, and by which key of `[tolerance]`.
    pub(crate) part: (&'static str, &'static str),
}

const ONE: &[&str] = &[""];
const XYZ: &[&str] = &["x", "y", "z"];
const SQUARES: &[&str] = &["xx", "yy", "zz", "xy", "yz", "zx"];
const TWO: &[&str] = &["1", "2"];
const FOUR: &[&str] = &["1", "2", "3", "4"];
const ORDERS: &[&str] = &["1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11"];
/// Orders 0 and 1 of a converter's curve are stray current and gain.
const CURVE: &[&str] = &["2", "3", "4", "5", "6", "7", "8", "9"];
const _: () = assert!(ORDERS.len() == MAX_NONLINEARITY - 1 && CURVE.len() == MAX_CONVERTER - 2);

const fn kind(
    of: fn(u8) -> Quantity,
    (name, terms): (&'static str, &'static [&'static str]),
    unit: &'static str,
    family: Option<usize>,
    part: (&'static str, &'static str),
) -> Kind {
    Kind { of, name, terms, unit, family, part }
}

const STRAY: (&str, &str) = ("stray light", "stray_relative");
const PROFILE: (&str, &str) = ("emitter, profile", "profile_relative");
const CONVERTERS: (&str, &str) = ("converters, linearity", "nonlinearity_mm");

/// All kinds, in the order of calibration files.
static KINDS: [Kind; 25] = {
    use Quantity as Q;
    [
        kind(Q::DetectorShift, ("detector", XYZ), "m", None, ("detector, place", "position_mm")),
        kind(Q::DetectorTurn, ("detector_turn", XYZ), "rad", None, ("detector, direction", "angle_deg")),
        kind(|_| Q::SlitOffset, ("slit_x", ONE), "m", None, ("slit, place along the detector", "position_mm")),
        kind(|_| Q::SlitDistance, ("slit_distance", ONE), "m", None, ("slit, distance", "position_mm")),
        kind(|_| Q::SlitWidth, ("slit_width", ONE), "m", None, ("slit, width", "slit_width_mm")),
        kind(Q::SlitTilt, ("slit_turn", XYZ), "rad", None, ("slit, direction", "angle_deg")),
        kind(|_| Q::MaskThickness, ("mask_thickness", ONE), "m", None, ("mask, thickness", "slit_width_mm")),
        kind(Q::EmitterShift, ("emitter", XYZ), "m", None, ("emitter, place", "position_mm")),
        kind(Q::EmitterTilt, ("emitter_tilt", TWO), "rad", None, ("emitter, axis", "emitter_angle_deg")),
        kind(|_| Q::LogIntensity, ("log_intensity", ONE), "1", None, ("emitter, intensity", "emitter_gain_relative")),
        kind(|_| Q::ProfileExponent, ("profile_exponent", ONE), "1", None, PROFILE),
        kind(Q::ProfileRadial, ("profile_radial", FOUR), "1", Some(0), PROFILE),
        kind(Q::ProfileAzimuthal, ("profile_azimuthal", FOUR), "1", Some(1), PROFILE),
        kind(|_| Q::WindowThickness, ("window_thickness", ONE), "m", None, ("cover, thickness", "window_mm")),
        kind(|k| Q::Nonlinearity(k + 1), ("nonlinearity", ORDERS), "m", Some(2), ("detector, linearity", CONVERTERS.1)),
        kind(Q::Stray, ("stray", TWO), "A", Some(3), STRAY),
        kind(Q::StrayLevel, ("stray_level", XYZ), "1/m", Some(4), STRAY),
        kind(|k| Q::StrayLevel(k + 3), ("stray_level", SQUARES), "1/m^2", Some(5), STRAY),
        kind(Q::StrayBalance, ("stray_balance", XYZ), "1/m", Some(6), STRAY),
        kind(|k| Q::StrayBalance(k + 3), ("stray_balance", SQUARES), "1/m^2", Some(7), STRAY),
        kind(Q::StrayTurning, ("stray_turning_1", XYZ), "A", Some(9), STRAY),
        kind(|k| Q::StrayTurning(k + 3), ("stray_turning_2", XYZ), "A", Some(9), STRAY),
        kind(|_| Q::ElectrodeGain, ("electrode_gain", ONE), "1", None, ("electrodes, gain", "electrode_gain_relative")),
        kind(|k| Q::Converter(0, k + 2), ("converter_1", CURVE), "A", Some(8), CONVERTERS),
        kind(|k| Q::Converter(1, k + 2), ("converter_2", CURVE), "A", Some(8), CONVERTERS),
    ]
};

pub(crate) const FAMILIES: usize = 10;

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, term) = self.kind();
        write!(f, "{}{}{term}", kind.name, if term.is_empty() { "" } else { "_" })
    }
}

impl Quantity {
    fn all() -> impl Iterator<Item = (Self, &'static Kind, &'static str)> {
        KINDS.iter().flat_map(|kind| kind.terms.iter().zip(0..).map(move |(term, k)| ((kind.of)(k), kind, *term)))
    }

    /// Its kind and its term; of an order that no file has, those of the first.
    pub(crate) fn kind(&self) -> (&'static Kind, &'static str) {
        Self::all().find(|(quantity, ..)| quantity == self).map_or((&KINDS[0], ""), |(_, kind, term)| (kind, term))
    }

    /// All quantities of one cell, in the order of calibration files.
    pub fn of_cell() -> impl Iterator<Item = Self> {
        Self::all().map(|(quantity, ..)| quantity).filter(|quantity| !matches!(quantity, Self::Converter(..)))
    }

    /// All quantities that the cells of a head share.
    pub fn of_head() -> impl Iterator<Item = Self> {
        Self::all().map(|(quantity, ..)| quantity).filter(|quantity| matches!(quantity, Self::Converter(..)))
    }

    /// Whether it changes the light of an emitter on whatever it falls.
    pub(crate) fn is_of_emitter(&self) -> bool {
        matches!(
            self,
            Self::EmitterShift(_)
                | Self::EmitterTilt(_)
                | Self::LogIntensity
                | Self::ProfileExponent
                | Self::ProfileRadial(_)
                | Self::ProfileAzimuthal(_)
        )
    }

    /// The quantity of this name.
    pub fn named(name: &str) -> Option<Self> {
        let is_named = |(_, kind, term): &(Self, &Kind, &str)| {
            name.strip_prefix(kind.name).is_some_and(|rest| rest.strip_prefix('_').unwrap_or(rest) == *term)
        };
        Self::all().find(is_named).map(|(quantity, ..)| quantity)
    }

    /// The unit of its values.
    pub fn unit(&self) -> &'static str {
        self.kind().0.unit
    }
}

/// Σ cₖ·Pₖ as a polynomial: coefficients of x⁰, x¹, …
fn powers<const N: usize>(legendre: &[f64; N]) -> [f64; N] {
    // (k+1)·P_{k+1} = (2k+1)·x·P_k − k·P_{k−1} (Bonnet).
    let (mut before, mut current) = ([0.0; N], [0.0; N]);
    current[0] = 1.0;
    let mut sum = [0.0; N];
    for (k, coefficient) in legendre.iter().enumerate() {
        for (sum, power) in sum.iter_mut().zip(current) {
            *sum += coefficient * power;
        }
        let order = k as f64;
        let mut next = [0.0; N];
        for i in 0..N {
            let shifted = if i > 0 { current[i - 1] } else { 0.0 };
            next[i] = ((2.0 * order + 1.0) * shifted - order * before[i]) / (order + 1.0);
        }
        (before, current) = (current, next);
    }
    sum
}

/// The least that positive dimensions shrink to on the way, metres.
const MIN_M: f64 = 1e-6;

/// Deviations of one cell, gathered before they act on it.
#[derive(Default)]
struct Deviations {
    detector_shift: DVec3,
    detector_turn: DVec3,
    slit_tilt: DVec3,
    emitter_tilt: [f64; 2],
    nonlinearity: [f64; MAX_NONLINEARITY],
    stray: Stray,
    stray_level: [f64; 9],
    stray_balance: [f64; 9],
    converter: [[f64; MAX_CONVERTER]; 2],
    electrode_gain: f64,
}

/// The cell of the scene with `values` in force. Converters span 0 to `full_scale_a`.
pub(crate) fn cell_with(nominal: &Cell, full_scale_a: f64, values: impl IntoIterator<Item = (Quantity, f64)>) -> Cell {
    let mut cell = nominal.clone();
    let mut by = Deviations { stray: cell.effects.stray.unwrap_or_default(), ..Deviations::default() };
    for (quantity, value) in values {
        let index = |k: u8| usize::from(k);
        match quantity {
            Quantity::DetectorShift(k) => by.detector_shift[index(k)] += value,
            Quantity::DetectorTurn(k) => by.detector_turn[index(k)] += value,
            Quantity::SlitOffset => cell.slit.offset_m += DVec2::new(value, 0.0),
            Quantity::SlitDistance => cell.slit.distance_m = (cell.slit.distance_m + value).max(MIN_M),
            Quantity::SlitWidth => cell.slit.width_m = (cell.slit.width_m + value).max(MIN_M),
            Quantity::SlitTilt(k) => by.slit_tilt[index(k)] += value,
            Quantity::MaskThickness => cell.slit.thickness_m = (cell.slit.thickness_m + value).max(0.0),
            Quantity::EmitterShift(k) => cell.emitter.position_tool_m[index(k)] += value,
            Quantity::EmitterTilt(k) => by.emitter_tilt[index(k)] += value,
            Quantity::LogIntensity => cell.emitter.radiant_intensity_w_per_sr *= libm::exp(value),
            Quantity::ProfileExponent => {
                if let Profile::Cosine { exponent } = &mut cell.emitter.profile {
                    *exponent = (*exponent + value).max(0.0);
                }
            }
            Quantity::ProfileRadial(k) => cell.effects.profile.radial[index(k)] += value,
            Quantity::ProfileAzimuthal(k) => cell.effects.profile.azimuthal[index(k)] += value,
            Quantity::WindowThickness => {
                let given = cell.effects.window.unwrap_or(Window { thickness_m: 0.0, refractive_index: RESIN_INDEX });
                cell.effects.window = Some(Window { thickness_m: (given.thickness_m + value).max(0.0), ..given });
            }
            Quantity::Nonlinearity(k) => by.nonlinearity[index(k)] += value,
            Quantity::Stray(e) => by.stray.constant_a[index(e)] += value,
            Quantity::StrayLevel(k) => by.stray_level[index(k)] += value,
            Quantity::StrayBalance(k) => by.stray_balance[index(k)] += value,
            Quantity::StrayTurning(k) => by.stray.turning_a.as_flattened_mut()[index(k)] += value,
            Quantity::ElectrodeGain => by.electrode_gain += value,
            Quantity::Converter(e, k) => by.converter[index(e)][index(k)] += value,
        }
    }
    by.act_on(&mut cell, full_scale_a);
    cell
}

impl Deviations {
    /// Stray light with its change by the pose.
    fn stray_that_follows(&self) -> Stray {
        let mut stray = self.stray;
        for (electrode, sign) in [-1.0, 1.0].into_iter().enumerate() {
            let home_a = stray.constant_a[electrode];
            let change = |term: usize| home_a * (self.stray_level[term] + sign * self.stray_balance[term]);
            for (axis, value) in stray.linear_a_per_m[electrode].iter_mut().enumerate() {
                *value += change(axis);
            }
            for (product, value) in stray.quadratic_a_per_m2[electrode].iter_mut().enumerate() {
                *value += change(3 + product);
            }
        }
        stray
    }

    fn act_on(self, cell: &mut Cell, full_scale_a: f64) {
        let detector = &mut cell.detector;
        let (x, z) = (detector.x_axis_base, detector.normal_base);
        let base_from_cell = |x: DVec3, z: DVec3| DMat3::from_cols(x, z.cross(x), z);
        let nominal = (detector.centre_base_m, base_from_cell(x, z));
        let to_base = |v: DVec3| nominal.1 * v;
        detector.centre_base_m += to_base(self.detector_shift);
        let turn = rotation_exp(to_base(self.detector_turn));
        detector.x_axis_base = (turn * x).normalize();
        // Perpendicular to rounding, as the model demands.
        detector.normal_base = (turn * z).normalize();
        // The slit's own rotation acts after that of the scene.
        let tilt: DQuat = rotation_exp(self.slit_tilt) * rotation_exp(cell.slit.tilt_rad);
        cell.slit.tilt_rad = slitpose_model::rotation_log(tilt);
        if cell.effects.opening == Opening::RidingSlit {
            // A slit on the tool stays where it is while its detector moves.
            let slit = &mut cell.slit;
            let cell_from_base = base_from_cell(detector.x_axis_base, detector.normal_base).transpose();
            let place = nominal.0 + nominal.1 * slit.offset_m.extend(slit.distance_m) - detector.centre_base_m;
            let place = cell_from_base * place;
            (slit.offset_m, slit.distance_m) = (place.truncate(), place.z.max(MIN_M));
            let turned = DQuat::from_mat3(&(cell_from_base * nominal.1));
            slit.tilt_rad = slitpose_model::rotation_log(turned * rotation_exp(slit.tilt_rad));
        }
        cell.slit.thickness_m = cell.slit.thickness_m.min(1.9 * cell.slit.distance_m);

        let (first, second) = cell.emitter.axis_tool.any_orthonormal_pair();
        let tilt = first * self.emitter_tilt[0] + second * self.emitter_tilt[1];
        cell.emitter.axis_tool = (rotation_exp(tilt) * cell.emitter.axis_tool).normalize();

        let effects = &mut cell.effects;
        if self.nonlinearity != [0.0; MAX_NONLINEARITY] {
            let given = std::mem::take(&mut effects.nonlinearity_m);
            let own = powers(&self.nonlinearity).into_iter().enumerate();
            effects.nonlinearity_m = own.map(|(k, value)| value + given.get(k).copied().unwrap_or(0.0)).collect();
        }
        if self.stray != Stray::default() {
            effects.stray = Some(self.stray_that_follows());
        }
        effects.electrode_gain[0] *= 1.0 - 0.5 * self.electrode_gain;
        effects.electrode_gain[1] *= 1.0 + 0.5 * self.electrode_gain;
        if self.converter != [[0.0; MAX_CONVERTER]; 2] && effects.converters.is_none() {
            let curves_a = self.converter.map(|curve| powers(&curve).into_iter().collect());
            effects.converters = Some(Converters { full_scale_a, curves_a });
        }
    }
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::SPACEMOUSE;

    use super::*;

    #[test]
    fn names_are_distinct_and_lead_back() {
        for quantity in Quantity::of_cell().chain(Quantity::of_head()) {
            assert_eq!(Quantity::named(&quantity.to_string()), Some(quantity));
        }
    }

    /// What the tool carries does not move with the base's parts.
    #[test]
    fn a_slit_on_the_tool_stays_where_it_is_while_its_detector_moves() {
        let nominal = SPACEMOUSE.read().expect("the scene").scene.cells[1].clone();
        let place = |cell: &Cell| {
            let (x, z) = (cell.detector.x_axis_base, cell.detector.normal_base);
            let base_from_cell = DMat3::from_cols(x, z.cross(x), z);
            let axes = base_from_cell * DMat3::from_quat(rotation_exp(cell.slit.tilt_rad));
            (cell.detector.centre_base_m + base_from_cell * cell.slit.offset_m.extend(cell.slit.distance_m), axes)
        };
        let moved =
            [(Quantity::DetectorShift(1), 1e-4), (Quantity::DetectorTurn(0), 0.02), (Quantity::DetectorTurn(2), 0.01)];
        let (found, before) = (cell_with(&nominal, 1e-5, moved), place(&nominal));
        assert!((found.detector.centre_base_m - nominal.detector.centre_base_m).length() > 0.9e-4);
        let after = place(&found);
        assert!((after.0 - before.0).length() < 1e-15, "{} {}", after.0, before.0);
        assert!((after.1 - before.1).to_cols_array().iter().all(|part| part.abs() < 1e-12));
    }

    /// Each part goes where its parameter says, in the cell's own frame; the scene's own tilts and gains stay.
    #[test]
    fn parts_deviate_as_their_parameters_say() {
        let file = slitpose_head::scene_file::WIDE.read().unwrap();
        let mut nominal = file.scene.cells[0].clone();
        nominal.slit.tilt_rad = DVec3::new(0.0, 0.0, 0.02);
        let with = |quantity, value| cell_with(&nominal, 1e-5, [(quantity, value)]);
        let close = |a: DVec3, b: DVec3, by: f64| assert!(a.distance(b) < by, "{a} {b}");
        let (x, z) = (nominal.detector.x_axis_base, nominal.detector.normal_base);
        // Right-handed: y completes x and the normal.
        let y = z.cross(x);
        for (k, axis) in [x, y, z].into_iter().enumerate() {
            let moved = with(Quantity::DetectorShift(k as u8), 1e-4).detector.centre_base_m;
            close(moved - nominal.detector.centre_base_m, axis * 1e-4, 1e-12);
            let moved = with(Quantity::EmitterShift(k as u8), 1e-4).emitter.position_tool_m;
            close(moved - nominal.emitter.position_tool_m, DVec3::AXES[k] * 1e-4, 1e-12);
        }
        // A turn of 10 mrad about the normal brings x towards y; half of its square is left.
        let turned = with(Quantity::DetectorTurn(2), 0.01).detector;
        close(turned.x_axis_base, x + y * 0.01, 1e-4);
        close(turned.normal_base, z, 1e-12);
        close(with(Quantity::SlitTilt(2), 0.01).slit.tilt_rad, DVec3::Z * 0.03, 1e-12);
        let axis = nominal.emitter.axis_tool;
        let tilted = with(Quantity::EmitterTilt(1), 0.03).emitter.axis_tool;
        assert!((tilted.angle_between(axis) - 0.03).abs() < 1e-9);
        // Gain of electrode 2 over 1, their mean as it was.
        let [first, second] = with(Quantity::ElectrodeGain, 0.01).effects.electrode_gain;
        assert!((second / first - 1.01).abs() < 1e-4 && (first + second - 2.0).abs() < 1e-12);
        let ratio = |cell: Cell| cell.emitter.radiant_intensity_w_per_sr / nominal.emitter.radiant_intensity_w_per_sr;
        assert!((ratio(with(Quantity::LogIntensity, 2.0_f64.ln())) - 2.0).abs() < 1e-12);
    }

    /// Light that falls on the detector's middle, brighter by a half 2 mm along x and moved towards electrode 2 by a
    /// fifth of it 1 mm along y and z.
    #[test]
    fn stray_light_brightens_as_a_whole_and_wanders_apart() {
        let values = [
            (Quantity::Stray(0), 2e-8),
            (Quantity::Stray(1), 2e-8),
            (Quantity::StrayLevel(0), 250.0),
            (Quantity::StrayBalance(3 + 4), 0.2e6),
        ];
        let cell = cell_with(&slitpose_head::scene_file::WIDE.read().unwrap().scene.cells[0], 1e-5, values);
        let stray = cell.effects.stray.unwrap();
        let at = |electrode: usize, [x, y, z]: [f64; 3]| {
            let (linear, quadratic) = (stray.linear_a_per_m[electrode], stray.quadratic_a_per_m2[electrode]);
            // Order of the products as documented at `Stray::quadratic_a_per_m2`.
            let products = [x * x, y * y, z * z, x * y, y * z, z * x];
            let sum =
                |coefficients: &[f64], terms: &[f64]| coefficients.iter().zip(terms).map(|(c, t)| c * t).sum::<f64>();
            stray.constant_a[electrode] + sum(&linear, &[x, y, z]) + sum(&quadratic, &products)
        };
        let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-14, "{found} {expected}");
        close(at(0, [2e-3, 0.0, 0.0]), 3e-8);
        close(at(1, [2e-3, 0.0, 0.0]), 3e-8);
        close(at(0, [0.0, 1e-3, 1e-3]), 1.6e-8);
        close(at(1, [0.0, 1e-3, 1e-3]), 2.4e-8);
    }

    #[test]
    fn legendre_polynomials_are_those_of_the_table() {
        // Abramowitz and Stegun 1972, table 22.9: P₅ = (63x⁵ − 70x³ + 15x)/8.
        let mut only = [0.0; 6];
        only[5] = 8.0;
        let found = powers(&only);
        for (found, expected) in found.into_iter().zip([0.0, 15.0, 0.0, -70.0, 0.0, 63.0]) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
    }
}
