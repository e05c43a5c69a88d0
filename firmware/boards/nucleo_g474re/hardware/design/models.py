"""Behavioural SPICE models, each built from the figures of a data sheet; no maker's model file is used.

Typical figures at 25 °C unless marked. What a model leaves out is named with it.
"""
from __future__ import annotations

from math import pi

# OPA2320. SBOS513F, specifications (typical, 5 V): gain-bandwidth product 20 MHz; phase margin 47 degrees with 50 pF at
# unity gain; slew rate 10 V/us; open-loop gain 132 dB; noise 7 nV/sqrt(Hz) at 10 kHz; input capacitance 5 pF
# differential, 4 pF common mode. SBOS513E p. 14: open-loop output impedance 90 ohm. SBOS513D p. 1: output within
# 10 mV of the rails, 1.45 mA per amplifier.
GBW_HZ = 20e6
SLEW_V_PER_S = 10e6
OPEN_LOOP_GAIN = 10 ** (132 / 20)
NOISE_V = 7e-9
OUTPUT_OHM = 90.0
# Second pole, chosen so that the model has 47 degrees with 50 pF (`tests.test_models` measures it).
SECOND_POLE_HZ = 69e6
KELVIN = 300.0
BOLTZMANN, CHARGE = 1.380649e-23, 1.602176634e-19

_CC = 10e-12
_NOISE_OHM = NOISE_V**2 / (4 * BOLTZMANN * KELVIN)


def opamp(gbw_hz: float = GBW_HZ) -> str:
    """Subcircuit `opa2320`: inputs, rails, output, and the node that the gain stage takes as its inverting input. Tied to
    `inm` that is the amplifier; apart from it the loop is open for a measurement of the loop gain.

    Left out: flicker noise (1/f below some kilohertz, which lit minus dark removes), common-mode rejection, bias current,
    drift.
    """
    limit = SLEW_V_PER_S * _CC
    return f"""
.subckt opa2320 inp inm vp vn out sense
Cp inp 0 4p
Cm inm 0 4p
Cd inp inm 5p
Rn noise 0 {_NOISE_OHM:.6g}
En p noise inp 0 1
Bg 0 g I={limit:.6g}*tanh({2 * pi * gbw_hz * _CC / limit:.6g}*(v(p)-v(sense)))
Cg g 0 {_CC:.6g} ic=0
Rg g 0 {OPEN_LOOP_GAIN / (2 * pi * gbw_hz * _CC):.6g}
Vhi vp hi 40m
Vlo lo vn 40m
Dhi g hi clamp
Dlo lo g clamp
E2 s 0 g 0 1
R2 s q 1
C2 q 0 {1 / (2 * pi * SECOND_POLE_HZ):.6g}
Eo o 0 q 0 1
Ro o out {OUTPUT_OHM:.6g}
Iq vp vn 1.45m
.ends
.model clamp d(is=1e-14 n=0.05)
"""


# NTR4003N. NTR4003N/D rev. 4 p. 2: R_DS(on) 1.0 ohm at 4 V and 1.5 ohm at 2.5 V (10 mA), C_iss 21 pF, C_oss 19.7 pF,
# C_rss 8.1 pF at 5 V, threshold 0.8 to 1.4 V at 250 uA; g_FS 0.33 S at 10 mA. With a threshold of 1.1 V the two
# resistances give KP = 0.74 A/V2 in series with 0.54 ohm, which is 0.33 S at 100 mA. The sheet's 0.33 S at 10 mA is more
# than that: `stiff` has it, and a square law then has 1 S at 100 mA. Left out: subthreshold current, voltage
# dependence of capacitances.
def nmos(stiff: bool = False, threshold_v: float = 1.1) -> str:
    kp, series = (5.4, 0.2) if stiff else (0.74, 0.54)
    return f"""
.subckt ntr4003n d g s
M1 d g si si fet
Rs si s {series}
Cgd g d 8.1p
Cgs g s 12.9p
Cds d s 11.6p
Dsub s d body
.ends
.model fet nmos(level=1 vto={threshold_v} kp={kp} lambda=0.02)
.model body d(is=1e-12 n=1.1)
"""


# BAT54 (Comchip, Diotech): 0.22 V at 0.1 mA, 0.29 V at 1 mA, 0.35 V at 10 mA, 7.6 pF at 1 V. USBLC6-2: 3.5 pF.
# VSMY1850 (83397 rev. 1.5): 1.65 V at 100 mA; SN74LVC1G3157 (SCES424M): 7 to 9 ohm at 3 V, 5.2 pF off, 17.3 pF on,
# break before make.
COMMON = """
.model schottky d(is=2.2e-8 n=1.0 rs=2 cjo=10p vj=0.4 m=0.4)
.model emitter d(is=1.6e-18 n=1.5 rs=1.5 cjo=20p)
.model throw sw(ron=9 roff=1e9 vt=1.65 vh=0.2)
.subckt spdt b1 b2 a s vcc gnd
Sb2 a b2 s gnd throw
Bn ns gnd v=3.3-v(s,gnd)
Sb1 a b1 ns gnd throw
Cb1 b1 gnd 5.2p
Cb2 b2 gnd 5.2p
Ca a gnd 17.3p
.ends
"""


def detector_line(name: str, a1: str, a2: str, cathode: str, light: str, position: float, ohm: float, farad: float, sections: int = 40) -> str:
    """The detector as a resistive line with its capacitance to the cathode spread along it. The current of node `light`
    (1 V is 1 A) enters at `position` from anode 1 (0) to anode 2 (1), out of the cathode."""
    lines = []
    nodes = [a1, *(f"{name}_{i}" for i in range(1, sections)), a2]
    for i in range(sections):
        lines.append(f"R{name}_{i} {nodes[i]} {nodes[i + 1]} {ohm / sections:.8g}")
    for i, node in enumerate(nodes):
        share = 0.5 if i in (0, sections) else 1.0
        lines.append(f"C{name}_{i} {cathode} {node} {farad * share / sections:.8g}")
    lines.append(f"G{name}_light {cathode} {nodes[round(position * sections)]} {light} 0 1")
    return "\n".join(lines)


def detector_lump(name: str, a1: str, a2: str, cathode: str, light: str, ohm: float, farad_1: float, farad_2: float) -> str:
    """The detector as firmware/analogue has it: resistance between the anodes, capacitance lumped at each; all current
    leaves at anode 1."""
    return f"""R{name} {a1} {a2} {ohm:.8g}
C{name}_1 {cathode} {a1} {farad_1:.8g}
C{name}_2 {cathode} {a2} {farad_2:.8g}
G{name}_light {cathode} {a1} {light} 0 1"""
