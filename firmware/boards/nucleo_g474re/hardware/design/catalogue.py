"""Every part that the boards use, with its number and the origin of both.

`verified` is true where the part number or the pins were read in a data sheet or a transcription of it; `source` names
it. Numbers composed by a maker's numbering scheme (resistors, ceramic capacitors) are not verified: check that they
exist before ordering. Nothing here was bought.
"""
from __future__ import annotations

import re

from .circuit import Kind, Pin

SCHEME = "number composed by the maker's scheme"
PARTS = "firmware/PARTS.md"
TWO = (Pin("1", "1"), Pin("2", "2"))


def _ohms(text: str) -> float:
    match = re.fullmatch(r"([0-9.]+)(m|k|M|)", text)
    return float(match[1]) * {"m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}[match[2]]


def _code(ohms: float) -> str:
    """Yageo's notation: 3R3, 220R, 1K62, 1M2."""
    letter, unit = ("R", 1.0) if ohms < 1e3 else ("K", 1e3) if ohms < 1e6 else ("M", 1e6)
    whole, _, rest = f"{ohms / unit:.4g}".partition(".")
    return f"{whole}{letter}{rest}"


def resistor(text: str, tolerance: str = "1 %") -> Kind:
    """Thick film of 1 %, or thin film of 0.1 % and 25 ppm/K, size 0603."""
    ohms = _ohms(text)
    thin = tolerance == "0.1 %"
    number = f"RT0603BRD07{_code(ohms)}L" if thin else f"RC0603FR-07{_code(ohms)}L"
    return Kind(
        f"R {text} {tolerance}", "R", "R", TWO, f"{text} {tolerance}", "Resistor_SMD:R_0603_1608Metric", "Yageo", number,
        SCHEME, False, "r", ohms=ohms,
    )


def capacitor(farads: float, text: str, number: str, footprint: str = "C_0603_1608Metric", maker: str = "Murata") -> Kind:
    return Kind(
        f"C {text}", "C", "C", TWO, text, f"Capacitor_SMD:{footprint}", maker, number, SCHEME, False, "c", farads=farads,
    )


R_SENSE = Kind(
    "R 3.3 1 % 0.25 W", "R", "R", TWO, "3.3 1 %", "Resistor_SMD:R_1206_3216Metric", "Yageo", "RC1206FR-073R3L", SCHEME, False,
    "r", ohms=3.3,
)
C_3P3 = capacitor(3.3e-12, "3.3p C0G", "GRM1885C1H3R3BA01D")
C_6P8 = capacitor(6.8e-12, "6.8p C0G", "GRM1885C1H6R8BA01D")
C_33P = capacitor(33e-12, "33p C0G", "GRM1885C1H330JA01D")
C_470P = capacitor(470e-12, "470p C0G", "GRM1885C1H471JA01D")
C_1N = capacitor(1e-9, "1n C0G", "GRM1885C1H102JA01D")
C_10N = capacitor(10e-9, "10n X7R", "GRM188R71H103KA01D")
C_100N = capacitor(100e-9, "100n X7R", "GRM188R71H104KA93D")
C_1U = capacitor(1e-6, "1u 25V X7R", "GRM188R71E105KA12D")
C_10U = capacitor(10e-6, "10u 16V X5R", "GRM21BR61C106KE15L", "C_0805_2012Metric")
C_10U_35V = capacitor(10e-6, "10u 35V X5R", "GRM31CR6YA106KA12L", "C_1206_3216Metric")
C_100U = Kind(
    "C 100u", "C", "CP", (Pin("1", "+"), Pin("2", "-")), "100u 10V", "Capacitor_SMD:CP_Elec_6.3x5.8", "Panasonic", "EEEFK1A101P",
    SCHEME, False, "c", farads=100e-6,
)
C_470U = Kind(
    "C 470u", "C", "CP", (Pin("1", "+"), Pin("2", "-")), "470u 10V", "Capacitor_SMD:CP_Elec_8x10", "Panasonic", "EEEFK1A471P",
    SCHEME, False, "c", farads=470e-6,
)

OPA2320 = Kind(
    "OPA2320", "U", "OPA2", (
        Pin("3", "A+", "input", 1), Pin("2", "A-", "input", 1), Pin("1", "AOUT", "output", 1),
        Pin("5", "B+", "input", 2), Pin("6", "B-", "input", 2), Pin("7", "BOUT", "output", 2),
        Pin("8", "V+", "power_in", 3), Pin("4", "V-", "power_in", 3),
    ), "OPA2320", "Package_SO:VSSOP-8_3x3mm_P0.65mm", "Texas Instruments", "OPA2320AIDGKR",
    "SBOS513F; pins are those of every dual amplifier in 8 pins", True, "opa2320",
)
SWITCH = Kind(
    "SN74LVC1G3157", "U", "SPDT", (
        Pin("3", "B1"), Pin("1", "B2"), Pin("4", "A"), Pin("6", "S", "input"), Pin("5", "VCC", "power_in"),
        Pin("2", "GND", "power_in"),
    ), "SN74LVC1G3157", "Package_TO_SOT_SMD:SOT-23-6", "Texas Instruments", "SN74LVC1G3157DBVR",
    "SCES424C p. 2 (pins), SCES424M (figures)", True, "spdt",
)
NMOS = Kind(
    "NTR4003N", "Q", "NMOS", (Pin("1", "G", "input"), Pin("2", "S"), Pin("3", "D")), "NTR4003N",
    "Package_TO_SOT_SMD:SOT-23", "onsemi", "NTR4003NT1G", "NTR4003N/D rev. 4 p. 1, 2", True, "nmos",
)
BAT54S = Kind(
    "BAT54S", "D", "PAIR", (Pin("1", "A"), Pin("2", "K"), Pin("3", "COM")), "BAT54S", "Package_TO_SOT_SMD:SOT-23", "onsemi",
    "BAT54SLT1G", "pins and figures of the type, from sheets of other makers (Comchip, Diotech)", True, "bat54s",
)
ESD2 = Kind(
    "USBLC6-2", "U", "ESD2", (
        Pin("1", "IO1"), Pin("6", "IO1"), Pin("3", "IO2"), Pin("4", "IO2"), Pin("5", "VBUS"), Pin("2", "GND"),
    ), "USBLC6-2SC6", "Package_TO_SOT_SMD:SOT-23-6", "STMicroelectronics", "USBLC6-2SC6", "transcription of the sheet", True,
    "esd2",
)
ESD4 = Kind(
    "USBLC6-4", "U", "ESD4", (
        Pin("1", "IO1"), Pin("3", "IO2"), Pin("4", "IO3"), Pin("6", "IO4"), Pin("5", "VBUS"), Pin("2", "GND"),
    ), "USBLC6-4SC6", "Package_TO_SOT_SMD:SOT-23-6", "STMicroelectronics", "USBLC6-4SC6", "pins from KiCad's library", False,
    "esd4",
)
LOAD_SWITCH = Kind(
    "TPS22918", "U", "LOADSW", (
        Pin("1", "VIN", "power_in"), Pin("3", "ON", "input"), Pin("4", "CT"), Pin("6", "VOUT", "power_out"), Pin("5", "QOD"),
        Pin("2", "GND", "power_in"),
    ), "TPS22918", "Package_TO_SOT_SMD:SOT-23-6", "Texas Instruments", "TPS22918DBVR", "SLVSD76C, pin configuration and functions", True,
)
REGULATOR = Kind(
    "TPS7A4901", "U", "LDO", (
        Pin("8", "IN", "power_in"), Pin("5", "EN", "input"), Pin("6", "NR"), Pin("1", "OUT", "power_out"), Pin("2", "FB", "input"),
        Pin("3", "NC", "no_connect"), Pin("7", "DNC", "no_connect"), Pin("4", "GND", "power_in"), Pin("9", "PAD", "passive"),
    ), "TPS7A4901", "Package_SO:HVSSOP-8-1EP_3x3mm_P0.65mm_EP1.57x1.89mm", "Texas Instruments", "TPS7A4901DGNR",
    "SBVS121E (figures); pins from a public symbol made after it", True,
)
PSD = Kind(
    "S3932", "D", "PSD", (Pin("1", "A1"), Pin("2", "K1"), Pin("3", "A2"), Pin("4", "K2")), "S3932", "slitpose:S3932", "Hamamatsu",
    "S3932", "KPSD1002E (figures); the order of the four pins and the land pattern", False, "psd",
)
LED = Kind(
    "VSMY1850", "D", "LED", (Pin("1", "K"), Pin("2", "A")), "VSMY1850", "LED_SMD:LED_0805_2012Metric", "Vishay", "VSMY1850",
    f"83397 rev. 1.5, in {PARTS}; which pad is the cathode", False, "led",
)
SCHOTTKY = Kind(
    "SS14", "D", "SCHOTTKY", (Pin("1", "K"), Pin("2", "A")), "SS14", "Diode_SMD:D_SMA", "onsemi", "SS14", "type", False,
)
TVS_5V = Kind(
    "SMBJ5.0A", "D", "TVS", (Pin("1", "K"), Pin("2", "A")), "SMBJ5.0A", "Diode_SMD:D_SMB", "Littelfuse", "SMBJ5.0A", "type", False,
)
TVS_15V = Kind(
    "SMAJ15A", "D", "TVS", (Pin("1", "K"), Pin("2", "A")), "SMAJ15A", "Diode_SMD:D_SMA", "Littelfuse", "SMAJ15A", "type", False,
)
FUSE_5V = Kind(
    "fuse 1.1 A", "F", "FUSE", TWO, "1.1A hold", "Fuse:Fuse_1812_4532Metric", "Bourns", "MF-MSMF110-2", "type", False,
)
FUSE_12V = Kind(
    "fuse 0.1 A", "F", "FUSE", TWO, "0.1A hold", "Fuse:Fuse_1812_4532Metric", "Bourns", "MF-MSMF010-2", "type", False,
)


def _row(count: int) -> tuple[Pin, ...]:
    return tuple(Pin(str(number), str(number)) for number in range(1, count + 1))


JST_6 = Kind(
    "SH 6", "J", "CONN6", _row(6), "BM06B-SRSS-TB", "Connector_JST:JST_SH_BM06B-SRSS-TB_1x06-1MP_P1.00mm_Vertical", "JST",
    "BM06B-SRSS-TB", "JST SH catalogue: 2 to 15 ways; this number by its scheme", False, "cable",
)
JST_2 = Kind(
    "SH 2", "J", "CONN2", _row(2), "BM02B-SRSS-TB", "Connector_JST:JST_SH_BM02B-SRSS-TB_1x02-1MP_P1.00mm_Vertical", "JST",
    "BM02B-SRSS-TB", "JST SH catalogue: 2 to 15 ways; this number by its scheme", False, "cable",
)
JST_LAB = Kind(
    "PH 6", "J", "CONN6", _row(6), "B6B-PH-K-S", "Connector_JST:JST_PH_B6B-PH-K_1x06_P2.00mm_Vertical", "JST", "B6B-PH-K-S",
    "JST PH catalogue", False,
)
TERMINAL = Kind(
    "terminal 2", "J", "CONN2", _row(2), "1715721", "TerminalBlock_Phoenix:TerminalBlock_Phoenix_MKDS-1,5-2-5.08_1x02_P5.08mm_Horizontal",
    "Phoenix Contact", "1715721", "type", False,
)
MORPHO = Kind(
    "morpho 38", "J", "MORPHO", _row(38), "2x19 socket", "Connector_PinHeader_2.54mm:PinHeader_2x19_P2.54mm_Vertical", "Samtec",
    "SSQ-119-03-G-D", "UM2505 Tables 15 and 16 (contacts, by firmware/wiring.csv); number of the socket", False,
)
USB_C = Kind(
    "USB-C", "J", "USBC", (
        Pin("A4", "VBUS"), Pin("A9", "VBUS"), Pin("B4", "VBUS"), Pin("B9", "VBUS"), Pin("A5", "CC1"), Pin("B5", "CC2"),
        Pin("A7", "D-"), Pin("B7", "D-"), Pin("A6", "D+"), Pin("B6", "D+"), Pin("A8", "SBU1"), Pin("B8", "SBU2"),
        Pin("A1", "GND"), Pin("A12", "GND"), Pin("B1", "GND"), Pin("B12", "GND"), Pin("S1", "SHIELD"),
    ), "USB4105-GF-A", "Connector_USB:USB_C_Receptacle_GCT_USB4105-xx-A_16P_TopMnt_Horizontal", "GCT", "USB4105-GF-A",
    "contacts of the USB-C standard", False,
)
PAD = Kind("pad", "TP", "TP", (Pin("1", "1"),), "pad", "TestPoint:TestPoint_Pad_D1.5mm", "", "", "copper", True, on_bill=False)
JUMPER3 = Kind(
    "solder jumper", "JP", "JUMPER3", (Pin("1", "A"), Pin("2", "C"), Pin("3", "B")), "1-2 joined",
    "Jumper:SolderJumper-3_P1.3mm_Bridged12_RoundedPad1.0x1.5mm", "", "", "copper", True, "jumper12", on_bill=False,
)
JUMPER2 = Kind(
    "open jumper", "JP", "JUMPER2", (Pin("1", "A"), Pin("2", "B")), "open", "Jumper:SolderJumper-2_P1.3mm_Open_RoundedPad1.0x1.5mm",
    "", "", "copper", True, on_bill=False,
)
