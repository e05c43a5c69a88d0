"""Where everything stands on the sheets: one page for the detector's board, five for the carrier. Unit 1.27 mm."""
from __future__ import annotations

from . import boards
from .circuit import Circuit
from .drawing import Sheet, check


def detector_sheets() -> tuple[Circuit, list[Sheet]]:
    board = boards.detector()
    s = Sheet(board, "detector", "slitpose: detector's board", "A4")
    s.frame(8, 12, 92, 50, "cable from the carrier")
    s.put("J1", 20, 36)
    for i, name in enumerate(("9 V for the cathode", "5 V for the amplifier", "reference, about 3.247 V", "ground", "output of X1", "output of X2")):
        s.text(f"{i + 1}: {name}", 48, 26 + 4 * i, 1.27)
    s.flag("+9V", 50, 56), s.flag("+5VA", 66, 56), s.flag("GND", 82, 56)
    s.frame(8, 66, 92, 56, "detector and filter of its cathode")
    s.power("+9V", 20, 80)
    s.put("R3", 27, 80, 90)
    s.wire((20, 80), (24, 80))
    s.wire((30, 80), (50, 80))
    s.put("C3", 38, 85)
    s.wire((38, 80), (38, 82))
    s.put("D1", 52, 95)
    s.wire((50, 80), (50, 88))
    s.wire((50, 84), (54, 84), (54, 88))
    s.frame(104, 12, 116, 110, "transimpedance stages: V = VREF - I R_f; anode lines guarded with VREF")
    for stage, y in ((1, 40), (2, 88)):
        s.put("U1", 160, y, unit=stage)
        s.label("VREF", 148, y - 2, (-1, 0))
        s.wire((148, y - 2), (154, y - 2))
        s.wire((124, y + 2), (154, y + 2))
        s.label(f"ANODE{stage}", 124, y + 2, (-1, 0))
        s.put(f"R{stage}", 160, y + 12, 90)
        s.put(f"C{stage}", 160, y + 20, 90)
        s.wire((140, y + 2), (140, y + 12), (157, y + 12))
        s.wire((140, y + 12), (140, y + 20), (157, y + 20))
        s.wire((166, y), (196, y))
        s.wire((180, y), (180, y + 12), (163, y + 12))
        s.wire((180, y + 12), (180, y + 20), (163, y + 20))
        s.label(f"OUT{stage}", 196, y)
    s.frame(8, 125, 122, 29, "supply of the amplifier, filter of the reference")
    s.put("U1", 24, 142, unit=3)
    s.put("C4", 44, 142), s.put("C5", 66, 142)
    s.put("C6", 102, 142)
    s.wire((94, 137), (102, 137), (102, 139))
    s.label("VREF", 94, 137, (-1, 0))
    s.text("C4 and C6 within 2 mm of U1", 70, 152, 1.27)
    s.finish()
    check(board, [s])
    return board, [s]


def emitter_sheets() -> tuple[Circuit, list[Sheet]]:
    board = boards.emitter()
    s = Sheet(board, "emitter", "slitpose: emitter's board", "A4")
    s.frame(8, 12, 92, 50, "emitter and its two wires")
    s.put("TP2", 30, 24), s.put("D1", 54, 34), s.put("TP1", 30, 44)
    s.wire((30, 24), (54, 24), (54, 31))
    s.wire((30, 44), (54, 44), (54, 37))
    s.label("CATHODE", 40, 24), s.label("ANODE", 40, 44)
    s.text("TP1: contact 1 of the emitter's connector, 5 V; TP2: contact 2, its current sink", 12, 54, 1.27)
    s.finish()
    check(board, [s])
    return board, [s]


def carrier_sheets() -> tuple[Circuit, list[Sheet]]:
    board = boards.carrier()
    sheets = [_nucleo(board), _supplies(board), _inputs(board), _drivers(board)]
    for sheet in sheets:
        sheet.finish()
    check(board, sheets)
    return board, sheets


def _nucleo(board: Circuit) -> Sheet:
    s = Sheet(board, "nucleo", "slitpose carrier: Nucleo, USB, lab", "A3")
    s.frame(6, 8, 176, 116, "NUCLEO-G474RE, Morpho connectors: contacts by firmware/wiring.csv")
    s.put("CN7", 48, 58), s.put("CN10", 134, 58)
    s.text("Contacts without a wire stay open. CN10-35 and CN10-37 may carry I_X2 of cells 1 and 2: never use them.", 12, 115, 1.4)
    s.text("Do the continuity check of firmware/README.md before anything is connected.", 12, 119, 1.4)
    s.frame(188, 8, 128, 76, "the MCU's own USB (VBUS is not sensed)")
    s.put("J3", 206, 42)
    s.put("R11", 232, 66), s.put("R12", 250, 66)
    s.put("U3", 286, 34)
    s.put("C14", 270, 66)
    for reference, net, x in (("R11", "CC1", 232), ("R12", "CC2", 250), ("C14", "USB_VBUS", 270)):
        s.wire((x, 63), (x, 59), (x + 2, 59))
        s.label(net, x + 2, 59)
    s.frame(188, 90, 128, 100, "lab clock and motor controller (3.3 V logic)")
    s.put("J4", 202, 112)
    s.put("U4", 290, 112)
    s.put("R13", 222, 148, 90)
    s.label("LAB_TRIGGER", 216, 148, (-1, 0)), s.wire((216, 148), (219, 148))
    s.wire((225, 148), (280, 148))
    s.put("R14", 236, 155), s.wire((236, 148), (236, 152))
    s.put("D4", 266, 156), s.wire((266, 148), (266, 151))
    s.label("TRIGGER", 280, 148)
    for i, (reference, lab, net) in enumerate((("R15", "LAB_FRAME", "FRAME"), ("R16", "LAB_READY", "POSE_READY"), ("R17", "LAB_POSE", "POSE_TX"))):
        y = 168 + 8 * i
        s.put(reference, 222, y, 90)
        s.label(lab, 216, y, (-1, 0)), s.wire((216, y), (219, y))
        s.label(net, 230, y), s.wire((225, y), (230, y))
    s.frame(6, 130, 176, 60, "pads for wires to CN9, where solder bridges leave PC4 and PC5 there")
    for reference, net, x in (("TP2", "ADC_2_1", 30), ("TP3", "ADC_2_2", 100)):
        s.put(reference, x, 150)
        s.wire((x, 150), (x, 154), (x + 4, 154))
        s.label(net, x + 4, 154)
    s.text("TP2 to CN9-2 if CN10-34 does not reach PC4, TP3 to CN9-1 if CN10-6 does not reach PC5", 12, 164, 1.4)
    s.text("(SB28 and SB3: firmware/README.md, solder bridges).", 12, 168, 1.4)
    return s


def _supplies(board: Circuit) -> Sheet:
    s = Sheet(board, "supplies", "slitpose carrier: supplies, reference, level lines", "A3")
    y = 26
    s.frame(6, 8, 200, 52, "5 V, at least 1 A")
    s.put("J1", 16, y + 2)
    s.wire((22, y), (34, y))
    s.put("F1", 37, y, 90)
    s.wire((40, y), (150, y))
    s.put("D1", 52, y + 7), s.wire((52, y), (52, y + 4))
    s.put("C1", 72, y + 7), s.wire((72, y), (72, y + 4))
    s.power("+5V", 96, y)
    s.put("JP1", 118, 46)
    s.text("JP1: close to power the Nucleo (JP5 on 5-6)", 132, 52, 1.3)
    s.put("R2", 153, y, 90)
    s.wire((156, y), (194, y))
    s.put("C4", 164, y + 7), s.wire((164, y), (164, y + 4))
    s.put("C5", 184, y + 7), s.wire((184, y), (184, y + 4))
    s.power("+5VA", 194, y)
    s.frame(212, 8, 104, 52, "supply of the emitters, on by PB5")
    s.put("U1", 264, 28)
    s.put("C2", 230, 35)
    s.wire((230, 32), (230, 26), (255, 26)), s.power("+5V", 230, 26)
    s.wire((255, 28), (248, 28), (248, 46), (244, 46)), s.label("EMITTERS_ON", 244, 46, (-1, 0))
    s.put("R1", 248, 51), s.wire((248, 46), (248, 48))
    s.wire((273, 26), (292, 26)), s.power("+5VE", 292, 26)
    s.wire((273, 28), (282, 28), (282, 26))
    s.put("C3", 282, 37), s.wire((273, 30), (282, 30), (282, 34))
    y = 82
    s.frame(6, 66, 310, 62, "9 V for the cathodes: 1.185 V (1 + 1200/182); 12 V in, 50 mA")
    s.put("J2", 16, y + 2)
    s.wire((22, y), (30, y))
    s.put("F2", 33, y, 90)
    s.wire((36, y), (50, y))
    s.put("D2", 53, y, 270)
    s.wire((56, y), (131, y))
    s.power("+12V", 70, y)
    s.put("D3", 82, y + 7), s.wire((82, y), (82, y + 4))
    s.put("C6", 102, y + 7), s.wire((102, y), (102, y + 4))
    s.put("U2", 140, y + 3)
    s.wire((124, y), (124, y + 2), (131, y + 2))
    s.put("C7", 120, y + 15), s.wire((131, y + 4), (120, y + 4), (120, y + 12))
    s.wire((149, y), (232, y)), s.power("+9V", 232, y)
    s.put("R3", 176, y + 7), s.wire((176, y), (176, y + 4))
    s.put("C8", 196, y + 7), s.wire((196, y), (196, y + 4))
    s.wire((149, y + 2), (164, y + 2), (164, y + 14), (196, y + 14), (196, y + 10))
    s.wire((176, y + 10), (176, y + 14), (176, y + 17))
    s.put("R4", 176, y + 20)
    s.put("C9", 218, y + 7), s.wire((218, y), (218, y + 4))
    y = 152
    s.frame(6, 134, 176, 66, "reference of the twelve stages: 4096 * 100 / 101.62 = code 4030.7")
    s.put("JP2", 40, y + 1)
    s.label("AREF_WIRE", 29, y + 3, (-1, 0)), s.wire((29, y + 3), (33, y + 3))
    s.put("TP1", 24, y + 18), s.wire((24, y + 18), (24, y + 22), (28, y + 22)), s.label("AREF_WIRE", 28, y + 22)
    s.text("TP1: wire to CN5-8 (V_REF+), if it is not the voltage of CN10-7;", 12, y + 32, 1.3)
    s.text("then cut JP2 1-2 and join 2-3.", 12, y + 36, 1.3)
    s.wire((47, y + 1), (66, y + 1))
    s.put("R5", 69, y + 1, 90)
    s.wire((72, y + 1), (146, y + 1)), s.label("VREF", 146, y + 1)
    for reference, x in (("R6", 82), ("C10", 102), ("C11", 124)):
        s.put(reference, x, y + 8)
        s.wire((x, y + 1), (x, y + 5))
    s.frame(188, 134, 128, 30, "level lines")
    for line, series, down, y2 in (("A", "R7", "R8", 144), ("B", "R9", "R10", 144)):
        x = 208 if line == "A" else 272
        s.put(series, x, y2, 90)
        s.label(f"DAC_{line}", x - 6, y2, (-1, 0)), s.wire((x - 6, y2), (x - 3, y2))
        s.wire((x + 3, y2), (x + 22, y2)), s.label(f"LEVEL_{line}", x + 22, y2)
        s.put(down, x + 10, y2 + 8), s.wire((x + 10, y2), (x + 10, y2 + 5))
    s.frame(188, 170, 128, 30, "3.3 V and V_DDA from the Nucleo; sources for the rule check")
    s.put("C12", 200, 188), s.put("C13", 220, 188)
    for i, net in enumerate(("+5V", "+3V3", "AVDD", "+12V", "+5VA", "GND")):
        s.flag(net, 240 + 12.0 * i, 190)
    return s


def _inputs(board: Circuit) -> Sheet:
    s = Sheet(board, "inputs", "slitpose carrier: detectors' cables, filters", "A3")
    for cell in boards.CELLS:
        x, y, base = 6 + 156 * (cell % 2), 8 + 62 * (cell // 2), 100 * (cell + 1)
        s.frame(x, y, 154, 58, f"cell {cell}")
        s.put(f"J{base}", x + 8, y + 30)
        s.put(f"R{base}", x + 24, y + 11, 90)
        s.label("VREF", x + 18, y + 11, (-1, 0)), s.wire((x + 18, y + 11), (x + 21, y + 11))
        s.label(f"VREF_{cell}", x + 30, y + 11), s.wire((x + 27, y + 11), (x + 30, y + 11))
        s.put(f"U{base}", x + 60, y + 30)
        for electrode, y0, y1 in ((1, 28, 14), (2, 32, 40)):
            s.wire((x + 69, y + y0), (x + 76, y + y0), (x + 76, y + y1), (x + 82, y + y1))
            s.put(f"R{base + electrode}", x + 85, y + y1, 90)
            s.wire((x + 88, y + y1), (x + 138, y + y1))
            s.put(f"C{base + electrode}", x + 96, y + y1 + 6), s.wire((x + 96, y + y1), (x + 96, y + y1 + 3))
            s.put(f"D{base + electrode}", x + 123, y + y1 + 7), s.wire((x + 123, y + y1), (x + 123, y + y1 + 2))
            s.label(f"ADC_{electrode}_{cell}", x + 138, y + y1)
    return s


def _drivers(board: Circuit) -> Sheet:
    s = Sheet(board, "emitters", "slitpose carrier: current sinks of the emitters", "A2")
    for pair in range(3):
        base, y = 700 + 100 * pair, 8 + 88 * pair
        s.frame(6, y, 448, 84, f"emitters {pair} and {pair + 3}: I = level (10/50.2) / 3.3 ohm while the gate pin is high")
        for half, emitter in enumerate((pair, pair + 3)):
            _driver(s, 14 + 150 * half, y + 10, base + 10 + 10 * half, f"U{base}", half + 1, emitter)
        x, row = 322, y + 24
        s.put(f"U{base}", x, row, unit=3)
        s.put(f"C{base}", x + 18, row)
        s.put(f"C{base + 1}", x + 40, row)
        s.put(f"U{base + 1}", x + 90, row)
    return s


def _driver(s: Sheet, x: float, y: float, n: int, amplifier: str, unit: int, emitter: int) -> None:
    s.text(f"emitter {emitter}", x, y - 1, 1.5)
    s.put(f"U{n}", x + 22, y + 18)
    s.wire((x + 20, y + 25), (x + 20, y + 34))
    s.label(f"GATE_{emitter}", x + 14, y + 30, (-1, 0)), s.wire((x + 14, y + 30), (x + 20, y + 30))
    s.put(f"R{n}", x + 20, y + 37)
    s.put(f"C{n}", x + 44, y + 50)
    s.put(f"R{n + 1}", x + 38, y + 18, 90)
    s.wire((x + 30, y + 18), (x + 35, y + 18))
    s.wire((x + 41, y + 18), (x + 62, y + 18))
    s.put(f"R{n + 2}", x + 48, y + 25), s.wire((x + 48, y + 18), (x + 48, y + 22))
    s.put(amplifier, x + 68, y + 20, unit=unit)
    s.wire((x + 74, y + 20), (x + 83, y + 20))
    s.put(f"R{n + 3}", x + 86, y + 20, 90)
    s.wire((x + 89, y + 20), (x + 96, y + 20))
    s.put(f"Q{n}", x + 100, y + 20)
    s.put(f"C{n + 1}", x + 68, y + 32, 90)
    s.wire((x + 62, y + 22), (x + 60, y + 22), (x + 60, y + 32), (x + 65, y + 32))
    s.wire((x + 71, y + 32), (x + 78, y + 32), (x + 78, y + 20))
    s.put(f"R{n + 4}", x + 68, y + 42, 90)
    s.wire((x + 60, y + 32), (x + 60, y + 42), (x + 65, y + 42))
    s.wire((x + 71, y + 42), (x + 102, y + 42), (x + 102, y + 26))
    s.put(f"R{n + 5}", x + 102, y + 48), s.wire((x + 102, y + 42), (x + 102, y + 45))
    s.put(f"J{n}", x + 128, y + 6, mirrored=True)
    s.wire((x + 102, y + 14), (x + 102, y + 8), (x + 122, y + 8))
    s.label(f"DRAIN_{emitter}", x + 106, y + 8)
