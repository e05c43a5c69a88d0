#!/usr/bin/env python3
"""Writes what boot loaders and drives take, from an image as it was linked:

    firmware_files.py IMAGE.elf     writes IMAGE.bin and IMAGE.dfu beside it

IMAGE.dfu is in the DfuSe format (ST UM0391) with the suffix of USB DFU 1.1, for ST's boot loader in flash at 0x08000000.
"""

import binascii
import pathlib
import struct
import sys

FLASH = 0x0800_0000
VENDOR, PRODUCT, ANY_RELEASE = 0x0483, 0xDF11, 0xFFFF
DFUSE_VERSION, DFU_SPECIFICATION = 1, 0x011A
SUFFIX_BYTES = 16


def flash_content(elf):
    """What the image puts into flash from its start on: gaps read as erased flash."""
    if elf[:6] != b"\x7fELF\x01\x01":
        raise SystemExit("firmware_files: not a 32-bit little-endian ELF file")
    (table,) = struct.unpack_from("<I", elf, 28)
    entry_bytes, entries = struct.unpack_from("<HH", elf, 42)
    content = bytearray()
    for number in range(entries):
        kind, offset, _, address, size = struct.unpack_from("<5I", elf, table + number * entry_bytes)
        if kind == 1 and size:  # PT_LOAD
            start = address - FLASH
            if start < 0:
                raise SystemExit(f"firmware_files: bytes for {address:#x}, which is before flash")
            content.extend(b"\xff" * (start + size - len(content)))
            content[start : start + size] = elf[offset : offset + size]
    return bytes(content)


def dfuse(content):
    element = struct.pack("<II", FLASH, len(content)) + content
    target = struct.pack("<6sBI255sII", b"Target", 0, 1, b"slitpose board", len(element), 1) + element
    whole = struct.pack("<5sBIB", b"DfuSe", DFUSE_VERSION, 11 + len(target), 1) + target
    whole += struct.pack("<4H3sB", ANY_RELEASE, PRODUCT, VENDOR, DFU_SPECIFICATION, b"UFD", SUFFIX_BYTES)
    return whole + struct.pack("<I", binascii.crc32(whole) ^ 0xFFFF_FFFF)


image = pathlib.Path(sys.argv[1])
content = flash_content(image.read_bytes())
image.with_suffix(".bin").write_bytes(content)
image.with_suffix(".dfu").write_bytes(dfuse(content))
