"""The three boards as circuits: detector's board (six of it), emitter's board (six), carrier of the Nucleo (one).

Values are those of firmware/README.md (analogue front end, emitter drive, parts) and firmware/PARTS.md. Nets of the
carrier are global names: `GATE_0`, `OUT_1_0` (electrode X1 of cell 0 at the cable), `ADC_1_0` (at the converter's pin).
"""
from __future__ import annotations

from dataclasses import dataclass

from . import catalogue as c
from .circuit import NO_CONNECTION, Circuit, Kind

CELLS = range(6)

# Contacts of the cable between carrier and detector's board.
DETECTOR_CABLE = ("+9V", "+5VA", "VREF", "GND", "OUT1", "OUT2")

# Signal of the table firmware/wiring.csv to net of the carrier. A row that is not here must be open on the carrier.
NET_OF_SIGNAL = {
    **{f"I_X{electrode} of cell {cell}": f"ADC_{electrode}_{cell}" for electrode in (1, 2) for cell in CELLS},
    **{f"gate of emitter {cell}": f"GATE_{cell}" for cell in CELLS},
    "emitter supply": "EMITTERS_ON",
    "level line of emitters 0 to 2": "DAC_A",
    "level line of emitters 3 to 5": "DAC_B",
    "USB DM": "USB_DM",
    "USB DP": "USB_DP",
    "trigger input": "TRIGGER",
    "frame output": "FRAME",
    "pose ready": "POSE_READY",
    "pose output": "POSE_TX",
}
OPEN_SIGNALS = ("serial TX", "serial RX", "light LD2", "debugger SWDIO", "debugger SWCLK")
NET_OF_RAIL = {
    "ground": "GND",
    "analogue ground": "GND",
    "3.3 V": "+3V3",
    "5 V": NO_CONNECTION,  # 5 V fed in here would flow back into the host's USB
    "5 V input (E5V)": "E5V",
    "V_DDA (AVDD)": "AVDD",
}


@dataclass(frozen=True)
class FrontEnd:
    """R_f and C_f of the twelve stages."""

    r_f: Kind
    c_f: Kind


ORDERABLE = FrontEnd(c.resistor("100k", "0.1 %"), c.C_6P8)
WIDE = FrontEnd(c.resistor("324k", "0.1 %"), c.C_3P3)


def detector(front_end: FrontEnd = ORDERABLE) -> Circuit:
    """Both stages of a cell beside their detector."""
    board = Circuit("detector")
    board.add("J1", c.JST_6, "connector", **{f"p{i + 1}": net for i, net in enumerate(DETECTOR_CABLE)})
    board.add("R3", c.resistor("1k"), "cathode", p1="+9V", p2="CATHODE")
    board.add("C3", c.C_1U, "cathode", p1="CATHODE", p2="GND")
    board.add("D1", c.PSD, "cathode", A1="ANODE1", A2="ANODE2", K1="CATHODE", K2="CATHODE")
    board.add(
        "U1", c.OPA2320, "stages", **{
            "A+": "VREF", "A-": "ANODE1", "AOUT": "OUT1", "B+": "VREF", "B-": "ANODE2", "BOUT": "OUT2", "V+": "+5VA", "V-": "GND",
        },
    )
    for stage in ("1", "2"):
        board.add(f"R{stage}", front_end.r_f, "stages", p1=f"ANODE{stage}", p2=f"OUT{stage}")
        board.add(f"C{stage}", front_end.c_f, "stages", p1=f"ANODE{stage}", p2=f"OUT{stage}")
    board.add("C4", c.C_100N, "supply", p1="+5VA", p2="GND")
    board.add("C5", c.C_1U, "supply", p1="+5VA", p2="GND")
    board.add("C6", c.C_100N, "supply", p1="VREF", p2="GND")
    return board


def emitter() -> Circuit:
    """One emitter and two pads for its wires."""
    board = Circuit("emitter")
    board.add("D1", c.LED, "emitter", A="ANODE", K="CATHODE")
    board.add("TP1", c.PAD, "emitter", p1="ANODE")
    board.add("TP2", c.PAD, "emitter", p1="CATHODE")
    return board


def carrier() -> Circuit:
    board = Circuit("carrier")
    _supplies(board)
    _nucleo(board)
    for cell in CELLS:
        _input(board, cell)
    for pair in range(3):
        _driver_pair(board, pair)
    return board


def _supplies(board: Circuit) -> None:
    block = "supplies"
    # 5 V, 1 A.
    board.add("J1", c.TERMINAL, block, p1="IN_5V", p2="GND")
    board.add("F1", c.FUSE_5V, block, p1="IN_5V", p2="+5V")
    board.add("D1", c.TVS_5V, block, K="+5V", A="GND")
    board.add("C1", c.C_470U, block, **{"+": "+5V", "-": "GND"})
    board.add("JP1", c.JUMPER2, block, A="+5V", B="E5V")
    # Emitters.
    board.add("C2", c.C_1U, block, p1="+5V", p2="GND")
    board.add(
        "U1", c.LOAD_SWITCH, block, VIN="+5V", GND="GND", ON="EMITTERS_ON", CT="SOFT_START", QOD="+5VE", VOUT="+5VE",
    )
    board.add("R1", c.resistor("10k"), block, p1="EMITTERS_ON", p2="GND")
    board.add("C3", c.C_1N, block, p1="SOFT_START", p2="GND")
    # Amplifiers.
    board.add("R2", c.resistor("4.7"), block, p1="+5V", p2="+5VA")
    board.add("C4", c.C_100U, block, **{"+": "+5VA", "-": "GND"})
    board.add("C5", c.C_10U, block, p1="+5VA", p2="GND")
    # Cathodes.
    board.add("J2", c.TERMINAL, block, p1="IN_12V", p2="GND")
    board.add("F2", c.FUSE_12V, block, p1="IN_12V", p2="FUSED_12V")
    board.add("D2", c.SCHOTTKY, block, A="FUSED_12V", K="+12V")
    board.add("D3", c.TVS_15V, block, K="+12V", A="GND")
    board.add("C6", c.C_10U_35V, block, p1="+12V", p2="GND")
    board.add(
        "U2", c.REGULATOR, block, IN="+12V", EN="+12V", NR="NOISE", OUT="+9V", FB="FEEDBACK", GND="GND", PAD="GND",
        NC=NO_CONNECTION, DNC=NO_CONNECTION,
    )
    board.add("C7", c.C_10N, block, p1="NOISE", p2="GND")
    board.add("R3", c.resistor("1.2M"), block, p1="+9V", p2="FEEDBACK")
    board.add("R4", c.resistor("182k"), block, p1="FEEDBACK", p2="GND")
    board.add("C8", c.C_10N, block, p1="+9V", p2="FEEDBACK")
    board.add("C9", c.C_10U, block, p1="+9V", p2="GND")
    # Reference.
    board.add("JP2", c.JUMPER3, block, A="AVDD", C="VREF_SOURCE", B="AREF_WIRE")
    board.add("TP1", c.PAD, block, p1="AREF_WIRE")
    board.add("R5", c.resistor("1.62k", "0.1 %"), block, p1="VREF_SOURCE", p2="VREF")
    board.add("R6", c.resistor("100k", "0.1 %"), block, p1="VREF", p2="GND")
    board.add("C10", c.C_10U, block, p1="VREF", p2="GND")
    board.add("C11", c.C_100N, block, p1="VREF", p2="GND")
    board.add("C12", c.C_10U, block, p1="+3V3", p2="GND")
    board.add("C13", c.C_100N, block, p1="AVDD", p2="GND")
    # Level lines.
    for line, (series, down) in {"A": ("R7", "R8"), "B": ("R9", "R10")}.items():
        board.add(series, c.resistor("100"), block, p1=f"DAC_{line}", p2=f"LEVEL_{line}")
        board.add(down, c.resistor("100k"), block, p1=f"LEVEL_{line}", p2="GND")


# Contacts of the Morpho connectors that the carrier uses; all others are open.
CN7 = {
    1: "GATE_4", 2: "GATE_5", 3: "TRIGGER", 6: "E5V", 8: "GND", 16: "+3V3", 19: "GND", 20: "GND", 22: "GND", 28: "ADC_1_0",
    30: "ADC_1_1", 32: "DAC_A", 35: "ADC_1_4", 36: "ADC_1_3", 37: "ADC_1_5", 38: "ADC_1_2",
}
CN10 = {
    1: "GATE_3", 2: "GATE_2", 4: "GATE_0", 6: "ADC_2_2", 7: "AVDD", 9: "GND", 12: "USB_DP", 13: "DAC_B", 14: "USB_DM", 15: "ADC_2_0",
    18: "ADC_2_4", 19: "GATE_1", 20: "GND", 21: "POSE_TX", 22: "ADC_2_3", 23: "POSE_READY", 26: "ADC_2_5", 29: "EMITTERS_ON",
    32: "GND", 33: "FRAME", 34: "ADC_2_1",
}


def _nucleo(board: Circuit) -> None:
    block = "nucleo"
    for reference, contacts in (("CN7", CN7), ("CN10", CN10)):
        board.add(reference, c.MORPHO, block, **{f"p{i}": contacts.get(i, NO_CONNECTION) for i in range(1, 39)})
    # Where solder bridges leave PC4 and PC5 at CN9 only: wires from these pads.
    board.add("TP2", c.PAD, block, p1="ADC_2_1")
    board.add("TP3", c.PAD, block, p1="ADC_2_2")
    # The MCU's own USB. VBUS is not sensed.
    board.add(
        "J3", c.USB_C, block, **{
            "VBUS": "USB_VBUS", "CC1": "CC1", "CC2": "CC2", "D-": "USB_DM", "D+": "USB_DP", "SBU1": NO_CONNECTION,
            "SBU2": NO_CONNECTION, "GND": "GND", "SHIELD": "GND",
        },
    )
    board.add("R11", c.resistor("5.1k"), block, p1="CC1", p2="GND")
    board.add("R12", c.resistor("5.1k"), block, p1="CC2", p2="GND")
    board.add("U3", c.ESD2, block, IO1="USB_DM", IO2="USB_DP", VBUS="USB_VBUS", GND="GND")
    board.add("C14", c.C_100N, block, p1="USB_VBUS", p2="GND")
    # The lab's clock and the motor controller.
    board.add(
        "J4", c.JST_LAB, block, p1="LAB_TRIGGER", p2="GND", p3="LAB_FRAME", p4="LAB_READY", p5="LAB_POSE", p6="GND",
    )
    board.add(
        "U4", c.ESD4, block, IO1="LAB_TRIGGER", IO2="LAB_FRAME", IO3="LAB_READY", IO4="LAB_POSE", VBUS="+5V", GND="GND",
    )
    board.add("R13", c.resistor("1k"), block, p1="LAB_TRIGGER", p2="TRIGGER")
    board.add("R14", c.resistor("100k"), block, p1="TRIGGER", p2="GND")
    board.add("D4", c.BAT54S, block, A="GND", K="+3V3", COM="TRIGGER")
    for reference, lab, net in (("R15", "LAB_FRAME", "FRAME"), ("R16", "LAB_READY", "POSE_READY"), ("R17", "LAB_POSE", "POSE_TX")):
        board.add(reference, c.resistor("100"), block, p1=lab, p2=net)


def _input(board: Circuit, cell: int) -> None:
    """Cable of a detector's board; filter and clamp of its two lines."""
    block, base = f"input {cell}", 100 * (cell + 1)
    out, vref = [f"OUT_{electrode}_{cell}" for electrode in (1, 2)], f"VREF_{cell}"
    nets = {"OUT1": out[0], "OUT2": out[1], "VREF": vref}
    board.add(f"J{base}", c.JST_6, block, **{f"p{i + 1}": nets.get(net, net) for i, net in enumerate(DETECTOR_CABLE)})
    board.add(f"U{base}", c.ESD2, block, IO1=out[0], IO2=out[1], VBUS="+5VA", GND="GND")
    board.add(f"R{base}", c.resistor("100"), block, p1="VREF", p2=vref)
    for electrode in (1, 2):
        pin = f"ADC_{electrode}_{cell}"
        board.add(f"R{base + electrode}", c.resistor("220"), block, p1=out[electrode - 1], p2=pin)
        board.add(f"C{base + electrode}", c.C_470P, block, p1=pin, p2="GND")
        board.add(f"D{base + electrode}", c.BAT54S, block, A="GND", K="AVDD", COM=pin)


def _driver_pair(board: Circuit, pair: int) -> None:
    """Current sinks of opposite emitters, which share an amplifier."""
    base = 700 + 100 * pair
    block = f"pair {pair}"
    nets = {"V+": "+5VA", "V-": "GND"}
    for half, emitter_ in (("A", pair), ("B", pair + 3)):
        for pin, net in (("+", "SET"), ("-", "SUM"), ("OUT", "AMP")):
            nets[half + pin] = f"{net}_{emitter_}"
    board.add(f"U{base}", c.OPA2320, block, **nets)
    board.add(f"C{base}", c.C_100N, block, p1="+5VA", p2="GND")
    board.add(f"C{base + 1}", c.C_10U, block, p1="+5VE", p2="GND")
    board.add(
        f"U{base + 1}", c.ESD2, block, IO1=f"DRAIN_{pair}", IO2=f"DRAIN_{pair + 3}", VBUS="+5VE", GND="GND",
    )
    for offset, emitter_ in ((10, pair), (20, pair + 3)):
        n, line = base + offset, "A" if emitter_ < 3 else "B"
        board.add(
            f"U{n}", c.SWITCH, block, S=f"GATE_{emitter_}", B1="GND", B2=f"LEVEL_{line}", A=f"LIT_{emitter_}", VCC="+3V3", GND="GND",
        )
        board.add(f"C{n}", c.C_100N, block, p1="+3V3", p2="GND")
        board.add(f"R{n}", c.resistor("10k"), block, p1=f"GATE_{emitter_}", p2="GND")
        board.add(f"R{n + 1}", c.resistor("40.2k", "0.1 %"), block, p1=f"LIT_{emitter_}", p2=f"SET_{emitter_}")
        board.add(f"R{n + 2}", c.resistor("10k", "0.1 %"), block, p1=f"SET_{emitter_}", p2="GND")
        board.add(f"R{n + 3}", c.resistor("47"), block, p1=f"AMP_{emitter_}", p2=f"DRIVE_{emitter_}")
        board.add(f"C{n + 1}", c.C_33P, block, p1=f"SUM_{emitter_}", p2=f"AMP_{emitter_}")
        board.add(f"R{n + 4}", c.resistor("1k"), block, p1=f"SUM_{emitter_}", p2=f"SENSE_{emitter_}")
        board.add(f"Q{n}", c.NMOS, block, G=f"DRIVE_{emitter_}", S=f"SENSE_{emitter_}", D=f"DRAIN_{emitter_}")
        board.add(f"R{n + 5}", c.R_SENSE, block, p1=f"SENSE_{emitter_}", p2="GND")
        board.add(f"J{n}", c.JST_2, block, p1="+5VE", p2=f"DRAIN_{emitter_}")
