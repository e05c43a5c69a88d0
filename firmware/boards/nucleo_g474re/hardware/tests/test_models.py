"""Each behavioural model against the data sheet's figures that it is made from. Needs ngspice."""
import unittest

from design import benches, models
from design.spice import Deck


def deck(name, elements):
    bench = Deck(name)
    bench.add(elements)
    return bench


FOLLOWER = "Vp vp 0 5\nX1 in out vp 0 out {sense} opa2320\nCl out 0 50p\n"


class Amplifier(unittest.TestCase):
    def test_phase_margin_is_47_degrees_with_50_pf(self):
        bench = deck("follower", FOLLOWER.format(sense="probe") + "Vi in 0 2.5\n" + benches.PROBE.format(inverting="out"))
        loop = benches._loop(bench.run("ac dec 200 1e5 1e8", ["v(out)"]))
        self.assertAlmostEqual(loop.margin_deg, 47, delta=1.5)

    def test_gain_bandwidth_product_is_20_mhz(self):
        bench = deck("gain", FOLLOWER.format(sense="probe") + "Vi in 0 2.5\n" + benches.PROBE.format(inverting="out"))
        row = bench.run("ac lin 1 1e6 1e6", ["v(out)"])[0]
        self.assertAlmostEqual(abs(complex(*row[1:3])), 20, delta=1)

    def test_slew_rate_is_10_volts_per_microsecond(self):
        bench = deck("slew", FOLLOWER.format(sense="out") + "Vi in 0 pulse(1 4 1u 1n 1n 1)")
        rows = bench.run("tran 5n 3u", ["v(out)"])
        crossing = [next(row[0] for row in rows if row[1] > level) for level in (1.5, 3.5)]
        self.assertAlmostEqual(2 / (crossing[1] - crossing[0]) * 1e-6, 10, delta=0.5)

    def test_noise_is_7_nanovolts(self):
        bench = deck("noise", FOLLOWER.format(sense="out") + "Vi in 0 dc 2.5 ac 1")
        row = bench.run("noise v(out) Vi lin 1 1e4 1e4\nsetplot noise1", ["onoise_spectrum"])[0]
        self.assertAlmostEqual(row[-1] * 1e9, 7, delta=0.1)

    def test_output_stays_within_its_rails(self):
        bench = deck("rails", FOLLOWER.format(sense="out") + "Vi in 0 5.4")
        self.assertLess(bench.run("op", ["v(out)"])[0][-1], 5.0)


class Others(unittest.TestCase):
    def test_transistor_has_the_resistances_of_its_sheet(self):
        for gate_v, ohm in ((4.0, 1.0), (2.5, 1.5)):
            bench = deck("fet", f"Vg g 0 {gate_v}\nId 0 d 10m\nX1 d g 0 ntr4003n")
            self.assertAlmostEqual(bench.run("op", ["v(d)"])[0][-1] / 10e-3, ohm, delta=0.1 * ohm)

    def test_transistor_has_0_33_siemens_at_100_ma(self):
        bench = deck("fet", "Vg g 0 dc 2 ac 1\nVd d 0 3\nX1 d g s ntr4003n\nIs s 0 100m\nCs s 0 1")
        row = bench.run("ac lin 1 1e4 1e4", ["i(vd)"])[0]
        self.assertAlmostEqual(abs(complex(*row[1:3])), 0.33, delta=0.033)

    def test_diodes_have_the_forward_voltages_of_their_sheets(self):
        for model, amperes, volts in (("emitter", 0.1, 1.65), ("schottky", 1e-3, 0.29), ("schottky", 1e-2, 0.35)):
            bench = deck(model, f"Ia 0 a {amperes}\nD1 a 0 {model}")
            self.assertAlmostEqual(bench.run("op", ["v(a)"])[0][-1], volts, delta=0.06 * volts, msg=f"{model} {amperes}")
