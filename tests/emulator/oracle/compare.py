#!/usr/bin/env python3
"""Random instructions on the emulator and on Unicorn; registers, flags and memory must agree.

The encodings below are written from the ARMv7-M ARM (DDI0403, A7.7), independently of the emulator's decoder.
A pattern has one character per bit; letters are fields. Register fields avoid SP and PC unless a form is about
them, and combinations the manual calls UNPREDICTABLE are not generated.
"""
import argparse
import collections
import random
import struct
import subprocess
import sys

from unicorn import UC_ARCH_ARM, UC_ERR_FETCH_UNMAPPED, UC_MODE_MCLASS, UC_MODE_THUMB, UC_PROT_ALL, Uc, UcError
from unicorn import arm_const as arm

CODE, DATA, DATA_BYTES = 0x1000_0000, 0x2000_0000, 0x400
SET_FLAGS = CODE + 0x800
GENERAL = list(range(13)) + [14]

# Forms: name, pattern, and what to do: None, or a function (rng, fields, state) that prepares the trial.
FORMS = []


def form(name, pattern, prepare=None, **choices):
    pattern = pattern.replace(" ", "")
    assert len(pattern) in (16, 32), (name, len(pattern))
    FORMS.append((name, pattern, prepare, choices))


def encode(pattern, fields):
    left = {letter: pattern.count(letter) for letter in fields}
    word = 0
    for character in pattern:
        if character in "01":
            bit = int(character)
        else:
            left[character] -= 1
            bit = fields[character] >> left[character] & 1
        word = word << 1 | bit
    return [word] if len(pattern) == 16 else [word >> 16, word & 0xFFFF]


def draw(rng, pattern, choices):
    """A value for each field; register letters d n m a t u take general registers in four bits."""
    fields = {}
    for letter in sorted(set(pattern) - set("01")):
        bits = pattern.count(letter)
        if letter in choices:
            fields[letter] = rng.choice(choices[letter])
        elif letter in "dnmatu" and bits == 4:
            fields[letter] = rng.choice(GENERAL)
        else:
            fields[letter] = rng.getrandbits(bits)
    return fields


def differ(*letters):
    """The registers of these fields must differ."""
    def check(rng, fields, state):
        return len({fields[letter] for letter in letters}) == len(letters)
    return check


# ---- data processing -------------------------------------------------------------------------------------
for number, name in enumerate(["lsl", "lsr", "asr"]):
    form(name + "_imm16", f"000{number:02b}iiiiimmmddd")
form("add_reg16", "0001100mmmnnnddd")
form("sub_reg16", "0001101mmmnnnddd")
form("add_imm3", "0001110iiinnnddd")
form("sub_imm3", "0001111iiinnnddd")
for number, name in enumerate(["mov", "cmp", "add", "sub"]):
    form(name + "_imm8", f"001{number:02b}dddiiiiiiii")
for number, name in enumerate("and eor lsl lsr asr adc sbc ror tst rsb cmp cmn orr mul bic mvn".split()):
    form(name + "16", f"010000{number:04b}mmmddd")
form("add_high", "01000100Dmmmmddd", D=[0, 0, 1], d=list(range(5)))
# Unicorn keeps the low bits of SP that the architecture does not have.
form("add_sp_high", "010001001mmmm101", lambda r, f, s: s["r"].__setitem__(f["m"], s["r"][f["m"]] & ~3) is None)
form("cmp_high", "01000101Nmmmmnnn", N=[1], n=[0, 1, 2, 3, 4, 6], m=GENERAL)
form("mov_high", "01000110Dmmmmddd", D=[0, 1], d=[0, 1, 2, 3, 4, 6], m=GENERAL + [13, 15])
form("adr16", "10100dddiiiiiiii")
form("add_rd_sp", "10101dddiiiiiiii")
form("add_sp", "101100000iiiiiii")
form("sub_sp", "101100001iiiiiii")
for number, name in enumerate(["sxth", "sxtb", "uxth", "uxtb"]):
    form(name + "16", f"10110010{number:02b}mmmddd")
for number, name in [(0, "rev"), (1, "rev16"), (3, "revsh")]:
    form(name + "_16", f"10111010{number:02b}mmmddd")

OPS = {0: "and", 1: "bic", 2: "orr", 3: "orn", 4: "eor", 8: "add", 10: "adc", 11: "sbc", 13: "sub", 14: "rsb"}
for number, name in OPS.items():
    form(name + "_w", f"1110101{number:04b}Snnnn0iiiddddiittmmmm", t=[0, 1, 2, 3])
    form(name + "_imm_w", f"11110i0{number:04b}Snnnn0iiiddddiiiiiiii")
for number, name in [(0, "tst"), (4, "teq"), (8, "cmn"), (13, "cmp")]:
    form(name + "_w", f"1110101{number:04b}1nnnn0iii1111iittmmmm", t=[0, 1, 2, 3])
    form(name + "_imm_w", f"11110i0{number:04b}1nnnn0iii1111iiiiiiii")
for number, name in [(2, "mov"), (3, "mvn")]:
    form(name + "_w", f"1110101{number:04b}S11110iiiddddiittmmmm", t=[0, 1, 2, 3])
    form(name + "_imm_w", f"11110i0{number:04b}S11110iiiddddiiiiiiii")
form("pkh", "111010101100nnnn0iiiddddiit0mmmm", t=[0, 1])
form("addw", "11110i100000nnnn0iiiddddiiiiiiii")
form("subw", "11110i101010nnnn0iiiddddiiiiiiii")
form("adr_add", "11110i10000011110iiiddddiiiiiiii")
form("adr_sub", "11110i10101011110iiiddddiiiiiiii")
form("movw", "11110i100100iiii0iiiddddiiiiiiii")
form("movt", "11110i101100iiii0iiiddddiiiiiiii")
form("sbfx", "111100110100nnnn0iiiddddii0wwwww", lambda r, f, s: f["i"] + f["w"] <= 31)
form("ubfx", "111100111100nnnn0iiiddddii0wwwww", lambda r, f, s: f["i"] + f["w"] <= 31)
form("bfi", "111100110110nnnn0iiiddddii0bbbbb", lambda r, f, s: f["b"] >= f["i"])
form("bfc", "11110011011011110iiiddddii0bbbbb", lambda r, f, s: f["b"] >= f["i"])
for number, name in enumerate(["lsl", "lsr", "asr", "ror"]):
    form(name + "_reg_w", f"111110100{number:02b}Snnnn1111dddd0000mmmm")
for number, name in enumerate(["xtah", "uxtah", "sxtab16", "uxtab16", "sxtab", "uxtab"]):
    form(name, f"11111010{number:04b}nnnn1111dddd10rrmmmm")
    form(name + "_plain", f"11111010{number:04b}11111111dddd10rrmmmm")
form("uqsub8", "111110101100nnnn1111dddd0101mmmm")
for number, name in enumerate(["rev", "rev16", "rbit", "revsh"]):
    form(name + "_w", f"111110101001mmmm1111dddd10{number:02b}nnnn",
         lambda r, f, s: f.__setitem__("m", f["n"]) is None)
form("clz", "111110101011mmmm1111dddd1000nnnn", lambda r, f, s: f.__setitem__("m", f["n"]) is None)

# ---- multiplication --------------------------------------------------------------------------------------
form("mul_w", "111110110000nnnn1111dddd0000mmmm")
form("mla", "111110110000nnnnaaaadddd0000mmmm")
form("mls", "111110110000nnnnaaaadddd0001mmmm")
form("smlaxy", "111110110001nnnnaaaadddd00xymmmm")
form("smulxy", "111110110001nnnn1111dddd00xymmmm")
LONG = [("smull", "000", "0000"), ("umull", "010", "0000"), ("smlal", "100", "0000"),
        ("umlal", "110", "0000")]
for name, op, low in LONG:
    form(name, f"111110111{op}nnnnaaaadddd{low}mmmm", differ("a", "d"))
form("sdiv", "111110111001nnnn1111dddd1111mmmm")
form("udiv", "111110111011nnnn1111dddd1111mmmm")

# ---- branches and status ---------------------------------------------------------------------------------
form("b_cond16", "1101cccciiiiiiii", c=list(range(14)))
form("b16", "11100iiiiiiiiiii")
form("b_cond_w", "11110sccccjjjjjj10J0Kkkkkkkkkkkk", c=list(range(14)))
form("b_w", "11110siiiiiiiiii10J1Kkkkkkkkkkkk")
form("bl", "11110siiiiiiiiii11J1Kkkkkkkkkkkk")
form("cbz", "1011o0i1iiiiinnn")


def odd_target(letter):
    def prepare(rng, fields, state):
        state["r"][fields[letter]] |= 1
        state["r"][fields[letter]] &= 0x0FFF_FFFF
        return True
    return prepare


form("bx", "010001110mmmm000", odd_target("m"), m=GENERAL)
form("blx", "010001111mmmm000", odd_target("m"), m=list(range(13)))
form("mrs_apsr", "1111001111101111100 0dddd00000000")
form("msr_apsr", "111100111000nnnn1000100000000000")
form("nop", "1011111100000000")
form("dmb", "11110011101111111000111101011111")

# ---- loads and stores ------------------------------------------------------------------------------------
SIZES = [("b", 1), ("h", 2), ("w", 4)]


def aim(base, offset, aligned=1, span=4):
    """Points the base register so that `base + offset(fields, state)` lies in the data."""
    def prepare(rng, fields, state):
        target = DATA + rng.randrange(0, DATA_BYTES - span)
        target -= target % aligned
        register = fields[base] if isinstance(base, str) else base
        state["r"][register] = (target - offset(fields, state)) & 0xFFFF_FFFF
        return True
    return prepare


def both(*steps):
    return lambda rng, fields, state: all(step(rng, fields, state) for step in steps)


form("ldr_literal16", "01001dddiiiiiiii", lambda r, f, s: f["i"] * 4 + 8 < 0x200)
form("ldr_literal_w", "11111000U1011111tttt0000iiiiiiii", lambda r, f, s: f["U"] == 1 and f["i"] < 0x1F0)
for op, name, size in [(0, "str", 4), (1, "strh", 2), (2, "strb", 1), (3, "ldrsb", 1), (4, "ldr", 4), (5, "ldrh", 2),
                       (6, "ldrb", 1), (7, "ldrsh", 2)]:
    form(name + "_reg16", f"0101{op:03b}mmmnnnttt", both(differ("m", "n"), aim("n", lambda f, s: s["r"][f["m"]])))
for op, name, scale in [("01100", "str", 4), ("01101", "ldr", 4), ("01110", "strb", 1), ("01111", "ldrb", 1),
                        ("10000", "strh", 2), ("10001", "ldrh", 2)]:
    form(name + "_imm16", f"{op}iiiiinnnttt", aim("n", lambda f, s, scale=scale: f["i"] * scale))
form("str_sp", "10010tttiiiiiiii", aim(13, lambda f, s: 4 * f["i"], 4))
form("ldr_sp", "10011tttiiiiiiii", aim(13, lambda f, s: 4 * f["i"], 4))
for bits, (suffix, size) in enumerate(SIZES):
    for load in (0, 1):
        for sign in ([0, 1] if load and suffix != "w" else [0]):
            name = ("ldrs" if sign else "ldr" if load else "str") + suffix
            head = f"1111100{sign}"
            form(name + "_imm12", f"{head}1{bits:02b}{load}nnnnttttiiiiiiiiiiii", aim("n", lambda f, s: f["i"]))
            form(name + "_reg_w", f"{head}0{bits:02b}{load}nnnntttt000000iimmmm",
                 both(differ("m", "n"), aim("n", lambda f, s: s["r"][f["m"]] << f["i"])))
            form(name + "_minus", f"{head}0{bits:02b}{load}nnnntttt1100iiiiiiii", aim("n", lambda f, s: -f["i"]))
            form(name + "_pre", f"{head}0{bits:02b}{load}nnnntttt11U1iiiiiiii",
                 both(differ("n", "t"), aim("n", lambda f, s: f["i"] if f["U"] else -f["i"])))
            form(name + "_post", f"{head}0{bits:02b}{load}nnnntttt10U1iiiiiiii",
                 both(differ("n", "t"), aim("n", lambda f, s: 0)))
            form(name + "_unprivileged", f"{head}0{bits:02b}{load}nnnntttt1110iiiiiiii", aim("n", lambda f, s: f["i"]))
signed = lambda f, s: 4 * f["i"] if f["U"] else -4 * f["i"]
for load, name in [(0, "strd"), (1, "ldrd")]:
    form(name, f"11101001U1 0{load}nnnnttttuuuuiiiiiiii".replace(" ", "").replace("U10", "U10"),
         both(differ("t", "u"), aim("n", signed, 4, 8)))
    form(name + "_pre", f"11101001U11{load}nnnnttttuuuuiiiiiiii", both(differ("t", "u", "n"), aim("n", signed, 4, 8)))
    form(name + "_post", f"11101000U11{load}nnnnttttuuuuiiiiiiii",
         both(differ("t", "u", "n"), aim("n", lambda f, s: 0, 4, 8)))


def block(base, count_bits, decrement=False):
    """A register list of at least two without the base, and a base that fits."""
    def prepare(rng, fields, state):
        register = fields[base] if isinstance(base, str) else base
        if register < 13:
            fields["l"] &= ~(1 << register)
        words = bin(fields["l"]).count("1") + fields.get("P", 0)
        down = 4 * words if decrement else 0
        return words >= 2 and aim(base, lambda f, s: -down, 4, 80)(rng, fields, state)
    return prepare


def ldm_low(rng, fields, state):
    return fields["l"] != 0 and aim("n", lambda f, s: 0, 4, 80)(rng, fields, state)


form("ldm16", "11001nnnllllllll", ldm_low)
form("stm16", "11000nnnllllllll", block("n", 8))
form("push", "1011010Pllllllll", block(13, 8, True))
form("pop", "10111100llllllll", block(13, 8))
for load, name in [(0, "stm"), (1, "ldm")]:
    form(name + "_w", f"1110100010W{load}nnnn0P0lllllllllllll", block("n", 13), n=list(range(13)))
    form(name + "db", f"1110100100W{load}nnnn0P0lllllllllllll", block("n", 13, True), n=list(range(13)))
form("tbb", "111010001101nnnn111100000000mmmm", both(differ("n", "m"), aim("n", lambda f, s: s["r"][f["m"]])))
form("tbh", "111010001101nnnn111100000001mmmm", both(differ("n", "m"), aim("n", lambda f, s: 2 * s["r"][f["m"]])))
form("ldrex", "111010000101nnnntttt1111iiiiiiii", aim("n", lambda f, s: 4 * f["i"], 4))
form("ldrexb", "111010001101nnnntttt111101001111", aim("n", lambda f, s: 0))
form("ldrexh", "111010001101nnnntttt111101011111", aim("n", lambda f, s: 0, 2))

# ---- floating point --------------------------------------------------------------------------------------
# D, N, M are the lowest bits of the S registers in q (Sd), p (Sn) and o (Sm).
for name, opc, op in [("vmul", "0D10", 0), ("vnmul", "0D10", 1), ("vadd", "0D11", 0), ("vsub", "0D11", 1),
                      ("vdiv", "1D00", 0)]:
    form(name, f"11101110{opc}ppppqqqq1010N{op}M0oooo")
form("vmov_imm", "111011101D11iiiiqqqq10100000iiii")
for name, opc2, high in [("vmov", 0, 0), ("vabs", 0, 1), ("vneg", 1, 0), ("vsqrt", 1, 1), ("vcmp", 4, 0),
                         ("vcmpe", 4, 1), ("vcvt_from_u32", 8, 0), ("vcvt_from_s32", 8, 1), ("vcvtr_u32", 12, 0),
                         ("vcvt_u32", 12, 1), ("vcvtr_s32", 13, 0), ("vcvt_s32", 13, 1)]:
    form(name, f"111011101D11{opc2:04b}qqqq1010{high}1M0oooo")
form("vcmp_zero", "111011101D110101qqqq1010e1000000")
form("vmov_to_core", "111011100001pppptttt1010N0010000")
form("vmov_from_core", "111011100000pppptttt1010N0010000")
form("vmov_scalar_to_core", "1110111000x1pppptttt101100010000")
form("vmov_scalar_from_core", "1110111000x0pppptttt101100010000")
form("vmov_pair_to_core", "111011000101uuuutttt101000M1oooo", both(differ("t", "u"), lambda r, f, s: f["o"] < 15))
form("vmov_pair_from_core", "111011000100uuuutttt101000M1oooo", lambda r, f, s: f["o"] < 15)
form("vmov_double_to_core", "111011000101uuuutttt10110001oooo", differ("t", "u"))
form("vmov_double_from_core", "111011000100uuuutttt10110001oooo")
form("vmrs", "1110111011110001tttt101000010000")
form("vmrs_apsr", "11101110111100011111101000010000")
form("vmsr", "1110111011100001tttt101000010000",
     lambda r, f, s: s["r"].__setitem__(f["t"], s["r"][f["t"]] & 0xF000_009F) is None)
for load, name in [(0, "vst"), (1, "vld")]:
    form(name + "r", f"11101101UD0{load}nnnnqqqq1010iiiiiiii", aim("n", signed, 4))
    form(name + "r_double", f"11101101U00{load}nnnnqqqq1011iiiiiiii", aim("n", signed, 4, 8))


def float_block(decrement, double):
    def prepare(rng, fields, state):
        first = 2 * fields["q"] + (0 if double else fields["D"])
        words = fields["i"] * (2 if double else 1)
        if words == 0 or first + words > 32:
            return False
        fields["i"] = words
        down = 4 * words if decrement else 0
        return aim("n", lambda f, s: -down, 4, 140)(rng, fields, state)
    return prepare


COUNTS = {"i": list(range(1, 17))}
for load, name in [(0, "vstm"), (1, "vldm")]:
    form(name, f"111011001DW{load}nnnnqqqq1010iiiiiiii", float_block(False, False), **COUNTS)
    form(name + "db", f"111011010D1{load}nnnnqqqq1010iiiiiiii", float_block(True, False), **COUNTS)
    form(name + "_double", f"1110110010W{load}nnnnqqqq1011iiiiiiii", float_block(False, True), **COUNTS)
    form(name + "db_double", f"11101101001{load}nnnnqqqq1011iiiiiiii", float_block(True, True), **COUNTS)

# Forms that may not stand in an IT block, or only at its end.
NOT_IN_IT = {name for name, *_ in FORMS if name.startswith(("b_", "b1", "bl", "bx", "cb", "tb", "cmp_high"))}

SPECIAL_WORDS = [0, 1, 0xFFFF_FFFF, 0x8000_0000, 0x7FFF_FFFF, 0xFFFF, 0x8000, 0x7FFF, 0x80, 0x7F, 0xFF, 32, 31, 33]
SPECIAL_FLOATS = [0, 1 << 31, 0x7F80_0000, 0xFF80_0000, 0x7FC0_0000, 0xFFC1_2345, 0x7F81_2345, 0xFFA0_0000, 1,
                  0x8000_0001, 0x007F_FFFF, 0x0080_0000, 0x7F7F_FFFF, 0xFF7F_FFFF, 0x3F80_0000, 0xBF80_0000,
                  0x4F00_0000, 0xCF00_0000, 0x4F80_0000, 0x3F00_0000, 0x3FC0_0000, 0x4020_0000, 0x477F_E000,
                  0x477F_F000, 0x3380_0000, 0x3300_0000, 0x3880_0000, 0x387F_F000]


def word(rng):
    kind = rng.random()
    if kind < 0.15:
        return rng.choice(SPECIAL_WORDS)
    return rng.getrandbits(32) if kind < 0.8 else rng.getrandbits(rng.randrange(1, 32))


def float_word(rng):
    kind = rng.random()
    if kind < 0.25:
        return rng.choice(SPECIAL_FLOATS)
    if kind < 0.5:
        return struct.unpack("<I", struct.pack("<f", rng.uniform(-4, 4)))[0]
    if kind < 0.6:
        return struct.unpack("<I", struct.pack("<f", rng.randrange(-70000, 70000) / 4))[0]
    if kind < 0.75:  # numbers whose products and quotients are near the ends of the range
        return rng.getrandbits(1) << 31 | rng.choice([63, 64, 65, 1, 2, 0, 190, 191, 253, 254]) << 23 | rng.getrandbits(23)
    return rng.getrandbits(32)


def random_state(rng):
    return {"r": [word(rng) for _ in range(13)] + [DATA + 0x200, word(rng), CODE],
            "xpsr": rng.getrandbits(5) << 27 | 1 << 24,
            "s": [float_word(rng) for _ in range(32)],
            "fpscr": rng.getrandbits(4) << 28 | 0x9F,
            "data": bytes(rng.getrandbits(8) for _ in range(DATA_BYTES))}


def instruction(rng, state, forms):
    """Name and halfwords of one instruction that `state` suits."""
    while True:
        name, pattern, prepare, choices = rng.choice(forms)
        fields = draw(rng, pattern, choices)
        if prepare is None or prepare(rng, fields, state):
            return name, encode(pattern, fields)


IT_FORMS = [entry for entry in FORMS if entry[2] is None and entry[0] not in NOT_IN_IT]


def if_then(rng):
    """An IT block of one to four instructions, which do not address memory."""
    condition, length = rng.randrange(14), rng.randrange(1, 5)
    pattern = [condition & 1] + [rng.getrandbits(1) for _ in range(length - 1)]
    mask = 0
    for bit in pattern[1:]:
        mask = mask << 1 | bit
    mask = (mask << 1 | 1) << (4 - length)
    code, names = [0xBF00 | condition << 4 | mask], []
    for _ in range(length):
        name, halves = instruction(rng, random_state(rng), IT_FORMS)
        names.append(name)
        code += halves
    return "it:" + "+".join(names), code, 1 + length


def exclusive(rng, state):
    """LDREX and STREX of one address, or with CLREX between them."""
    n, t, d, u = rng.sample(GENERAL, 4)
    size = rng.choice([1, 2, 4])
    state["r"][n] = DATA + size * rng.randrange(0x80)
    if size == 4:
        offset = rng.randrange(64)
        load, store = [0xE850 | n, t << 12 | 0xF00 | offset], [0xE840 | n, u << 12 | d << 8 | offset]
    else:
        low = {1: 0x40, 2: 0x50}[size]
        load, store = [0xE8D0 | n, t << 12 | 0xF0F | low], [0xE8C0 | n, u << 12 | 0xF00 | low | d]
    clear = rng.choice([[], [0xF3BF, 0x8F2F]])
    return "exclusive", load + clear + store, 2 + len(clear) // 2


def trial(rng, only):
    state = random_state(rng)
    if not only and rng.random() < 0.01:
        name, code, steps = exclusive(rng, state)
    elif not only and rng.random() < 0.08:
        name, code, steps = if_then(rng)
    else:
        forms = [entry for entry in FORMS if entry[0].startswith(only)] if only else FORMS
        name, code = instruction(rng, state, forms)
        steps = 1
    # Literal loads read what follows.
    state["code"] = code + [rng.getrandbits(16) for _ in range(0x100)] if "literal" in name else code + [0xBF00]
    state.update(name=name, steps=steps, length=len(code))
    return state


def line(t):
    words = t["r"] + [t["xpsr"]] + t["s"] + [t["fpscr"], t["steps"]]
    code = ",".join(f"{half:04x}" for half in t["code"])
    return " ".join(f"{value:x}" for value in words) + f" {code} {t['data'].hex()}\n"


CORE = [getattr(arm, f"UC_ARM_REG_R{n}") for n in range(13)] + [arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR, arm.UC_ARM_REG_PC]
SINGLE = [getattr(arm, f"UC_ARM_REG_S{n}") for n in range(32)]


class Oracle:
    def __init__(self):
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self.uc.mem_map(CODE, 0x1000, UC_PROT_ALL)
        self.uc.mem_map(DATA, 0x1000, UC_PROT_ALL)
        self.uc.mem_write(SET_FLAGS, struct.pack("<2H", 0xF380, 0x8C00))
        self.uc.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
        # The first floating-point instruction of a context sets the modes: VMOV S0, S0.
        self.uc.mem_write(CODE, struct.pack("<2H", 0xEEB0, 0x0A40))
        self.uc.emu_start(CODE | 1, 0xFFFF_FFFE, count=1)

    def run(self, t):
        uc = self.uc
        uc.mem_write(CODE, struct.pack(f"<{len(t['code'])}H", *t["code"]))
        uc.ctl_remove_cache(CODE, CODE + 0x400)
        uc.mem_write(DATA, t["data"])
        # Unicorn's own register write leaves the GE bits out: MSR APSR_nzcvqg, R0 sets them.
        uc.reg_write(arm.UC_ARM_REG_R0, t["xpsr"])
        uc.emu_start(SET_FLAGS | 1, 0xFFFF_FFFE, count=1)
        for register, value in zip(CORE[:15], t["r"]):
            uc.reg_write(register, value)
        for register, value in zip(SINGLE, t["s"]):
            uc.reg_write(register, value)
        uc.reg_write(arm.UC_ARM_REG_FPSCR, t["fpscr"])
        try:
            if t["steps"] == 1:
                uc.emu_start(CODE | 1, 0xFFFF_FFFE, count=1)
            else:  # An instruction count would also count inside the block what is skipped.
                uc.emu_start(CODE | 1, CODE + 2 * t["length"])
        except UcError as error:
            if error.errno != UC_ERR_FETCH_UNMAPPED:  # A branch that leaves the code has been taken.
                return f"fault {error}"
        r = [uc.reg_read(register) for register in CORE]
        s = [uc.reg_read(register) for register in SINGLE]
        memory = bytes(uc.mem_read(DATA, DATA_BYTES))
        return r, uc.reg_read(arm.UC_ARM_REG_XPSR), s, uc.reg_read(arm.UC_ARM_REG_FPSCR), memory


def parse(answer):
    if answer.startswith("fault"):
        return answer.strip()
    *words, memory = answer.split()
    words = [int(value, 16) for value in words]
    return words[:16], words[16], words[17:49], words[49], bytes.fromhex(memory)


def difference(ours, theirs):
    """What differs, in words; empty if nothing."""
    if isinstance(ours, str) or isinstance(theirs, str):
        if isinstance(ours, str) and isinstance(theirs, str):
            return ""
        return f"ours {ours if isinstance(ours, str) else 'ran'}, theirs {theirs if isinstance(theirs, str) else 'ran'}"
    found = []
    for n, (a, b) in enumerate(zip(ours[0], theirs[0])):
        if a != b:
            found.append(f"r{n} {a:08x}/{b:08x}")
    if (ours[1] ^ theirs[1]) & 0xF800_0000:
        found.append(f"apsr {ours[1]:08x}/{theirs[1]:08x}")
    for n, (a, b) in enumerate(zip(ours[2], theirs[2])):
        if a != b:
            found.append(f"s{n} {a:08x}/{b:08x}")
    # The emulator does not model cumulative exception flags.
    if (ours[3] ^ theirs[3]) & 0xF000_0000:
        found.append(f"fpscr {ours[3]:08x}/{theirs[3]:08x}")
    if ours[4] != theirs[4]:
        found.append("memory")
    return " ".join(found)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", help="the built example instruction_oracle")
    parser.add_argument("--count", type=int, default=200_000, help="trials")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 32))
    parser.add_argument("--only", default="", help="only forms whose name begins so")
    options = parser.parse_args()
    print(f"seed {options.seed}, {len(FORMS)} forms")
    rng, oracle = random.Random(options.seed), Oracle()
    executed, faults, differing, examples = 0, 0, collections.Counter(), {}
    for start in range(0, options.count, 20_000):
        trials = [trial(rng, options.only) for _ in range(min(20_000, options.count - start))]
        answers = subprocess.run([options.program], input="".join(map(line, trials)), text=True, check=True,
                                 stdout=subprocess.PIPE).stdout.splitlines()
        for t, answer in zip(trials, answers, strict=True):
            ours, theirs = parse(answer), oracle.run(t)
            executed += t["steps"]
            faults += isinstance(ours, str) and isinstance(theirs, str)
            what = difference(ours, theirs)
            if what:
                name = t["name"].split("+")[0]
                differing[name] += 1
                code = " ".join(f"{half:04x}" for half in t["code"][: t["length"]])
                examples.setdefault(name, f"{t['name']} [{code}] fpscr {t['fpscr']:08x}: ours/theirs {what}")
    print(f"{executed} instructions in {options.count} trials, {faults} faults on both sides, {differing.total()} differ")
    for name, count in differing.most_common():
        print(f"  {name}: {count}, e.g. {examples[name]}")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
