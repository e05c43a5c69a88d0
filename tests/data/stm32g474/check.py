#!/usr/bin/env python3
"""Compares the rows of facts.csv whose source is a header with ST's headers.

    tests/data/stm32g474/check.py CMSIS_DEVICE_G4 STM32G4XX_HAL_DRIVER

CMSIS_DEVICE_G4 and STM32G4XX_HAL_DRIVER are checkouts of STMicroelectronics/cmsis_device_g4 (v1.2.4) and
STMicroelectronics/stm32g4xx_hal_driver (c8820e3de6f3). A row's name is the macro, the member of a structure or the
interrupt that the header has in that line; names of this project's own are read by the reader. Python 3.11.
"""
import csv
import re
import sys
from pathlib import Path

CMSIS, HAL = (Path(folder) for folder in sys.argv[1:3])


def macros(lines):
    """Macros of a header, with the line of each."""
    found, at = {}, 0
    while at < len(lines):
        start, text = at, lines[at]
        while text.rstrip().endswith("\\"):
            at += 1
            text = text.rstrip()[:-1] + " " + lines[at]
        match = re.match(r"\s*#define\s+(\w+)\s+(.*)", re.sub(r"/\*.*?(\*/|$)", "", text))
        if match:
            found.setdefault(match[1], (start + 1, match[2].strip()))
        at += 1
    return found


def members(lines):
    """Members of structures and interrupts, with the line and the value of each."""
    found, fields = {}, []
    for number, line in enumerate(lines, 1):
        if "typedef struct" in line:
            fields = []
        if match := re.match(r"\s*(?:__IOM?|__I)?\s*uint(\d+)_t\s+(\w+)(?:\[(\d+)U?\])?;(.*)", line):
            fields.append((number, match[2], int(match[1]) // 8, int(match[3] or 1), match[4]))
        if match := re.match(r"\}\s*(\w+_TypeDef);", line):
            offset = 0
            for at, name, size, count, comment in fields:
                offset += -offset % size
                said = re.search(r"offset:\s*(0x[0-9A-Fa-f]+)", comment)
                # Blocks shared by several units are described from the first unit's base.
                is_shared = match[1].startswith("DMAMUX")
                found[f"{match[1]}.{name}"] = (at, int(said[1], 16) if is_shared and said else offset)
                offset += size * count
        if match := re.match(r"\s*(\w+_IRQn)\s*=\s*(\d+)\s*,", line):
            found[match[1]] = (number, int(match[2]))
    return found


def evaluate(text, known):
    text = re.sub(r"\(\s*uint\d+_t\s*\*?\s*\)", "", text)
    text = re.sub(r"\b(0x[0-9A-Fa-f]+|\d+)[UL]+\b", r"\1", text)
    text = re.sub(r"\b[A-Z]\w*\b", lambda name: str(evaluate(known[name[0]][1], known)), text)
    return eval(text, {"__builtins__": {}})


def main():
    device = (CMSIS / "Include/stm32g474xx.h").read_text(errors="replace").splitlines()
    headers = {"CMSIS": (macros(device), members(device))}
    everything = dict(headers["CMSIS"][0])
    for path in sorted((HAL / "Inc").glob("stm32g4xx_*.h")):
        found = macros(path.read_text(errors="replace").splitlines())
        headers[path.name.removeprefix("stm32g4xx_")] = (found, {})
        everything = found | everything
    checked = wrong = 0
    for row in csv.DictReader((Path(__file__).parent / "facts.csv").open()):
        name = row["fact"]
        match = re.fullmatch(r"(CMSIS|HAL (\S+)):(\d+)", row["source"])
        if not match:
            continue
        defined, described = headers[match[2] or "CMSIS"]
        if name in described:
            line, value = described[name]
        elif name in defined:
            line, value = defined[name][0], evaluate(defined[name][1], everything)
        else:
            # A number in a header under another name: only that the line has it.
            value = int(row["value"], 0)
            at_line = [text for at, text in defined.values() if at == int(match[3])]
            numbers = re.findall(r"0x[0-9A-Fa-f]+|\d+", " ".join(at_line))
            line = int(match[3]) if value in [int(number, 0) for number in numbers] else None
        if name.startswith("LL_ADC_CHANNEL_"):
            value = value >> 26 & 31
        checked += 1
        if (line, value) != (int(match[3]), int(row["value"], 0)):
            wrong += 1
            print(f"{name}: {row['value']} in line {match[3]}; the header has {value} in line {line}")
    print(f"{checked} rows compared, {wrong} differ")
    return wrong != 0


if __name__ == "__main__":
    sys.exit(main())
