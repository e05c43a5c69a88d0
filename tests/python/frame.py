"""Reads the frames that a board sends to a motor controller by the table at the head of
`firmware/src/pose/frame.rs`, and by nothing else."""

import os
import re
import struct
import zlib

PAGE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "firmware", "src", "pose", "frame.rs")
FORMATS = {"u8": "B", "u16": "H", "u32": "I", "f32": "f"}


def table():
    """(first byte, format, what it is) of every row, and the number of bytes."""
    with open(PAGE, encoding="utf-8") as page:
        text = page.read().split("//! | byte | type | unit | is |\n//! |---|---|---|---|\n", 1)[1]
    rows, end = [], 0
    for line in text.splitlines():
        if not line.startswith("//! |"):
            break
        place, kind, _, meaning = (cell.strip() for cell in line.removeprefix("//! |").removesuffix("|").split("|"))
        first, last = (int(number) for number in (re.findall(r"\d+", place) * 2)[:2])
        match = re.fullmatch(r"(?:(\d+) )?`(\w+)`", kind)
        form = (match[1] or "") + FORMATS[match[2]] if match else f"{last + 1 - first}s"
        if first != end or struct.calcsize("<" + form) != last + 1 - first:
            raise ValueError(f"row {place}")
        rows.append((first, form, meaning))
        end = last + 1
    return rows, end


def frames(stream):
    """Values by first byte of each frame whose checksum is right, and how many bytes belong to none."""
    rows, length = table()
    found, others, at = [], 0, 0
    while at < len(stream):
        frame = stream[at : at + length]
        checksum = zlib.crc32(frame[:-4]).to_bytes(4, "little")
        if len(frame) == length and frame[:2] == b"\xa5\x5a" and frame[-4:] == checksum:
            values = {first: struct.unpack_from("<" + form, frame, first) for first, form, _ in rows}
            found.append({first: value if len(value) > 1 else value[0] for first, value in values.items()})
            at += length
        else:
            others += 1
            at += 1
    return found, others
