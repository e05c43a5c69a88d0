"""Reads packets of a board by what the documentation of the crate `slitpose-protocol` says of them, and by
nothing else: the list of schemas is what that page includes, and all else is written after the page."""

import os
import struct
import zlib

PAGE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "protocol", "src", "lib.rs")
MESSAGES = 9


def schemas():
    """(name, fields) of every kind, messages first."""
    with open(os.path.join(os.path.dirname(PAGE), "schemas.txt"), encoding="utf-8") as listed:
        return [tuple(line.split(":", 1)) for line in listed.read().splitlines()]


def key(name, fields):
    """What a board says of a kind in its hello."""
    state = 0xCBF29CE484222325
    for byte in f"{name}:{fields}".encode("ascii"):
        state = (state ^ byte) * 0x100000001B3 % 2**64
    return state


def parts(text, separator):
    """Splits at separators that stand in no brackets."""
    depth, begin, found = 0, 0, []
    for at, character in enumerate(text):
        depth += (character in "{([") - (character in "})]")
        if character == separator and depth == 0:
            found.append(text[begin:at])
            begin = at + 1
    return found + [text[begin:]] if text else []


def packets(stream):
    """Payloads of the packets of a stream whose checksums agree, and how many do not."""
    found, damaged = [], 0
    for packet in stream.split(b"\0")[:-1]:
        data, at = bytearray(), 0
        while at < len(packet):
            code = packet[at]
            data += packet[at + 1 : at + code]
            at += code
            if code < 255 and at < len(packet):
                data.append(0)
        payload, checksum = bytes(data[:-4]), data[-4:]
        if not packet:
            continue
        if at == len(packet) and zlib.crc32(payload).to_bytes(4, "little") == checksum:
            found.append(payload)
        else:
            damaged += 1
    return found, damaged


class Payload:
    """The values of a payload, one after the other."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, length):
        taken = self.data[self.at : self.at + length]
        if len(taken) < length:
            raise ValueError("a payload that ends too soon")
        self.at += length
        return taken

    def varint(self):
        value, shift = 0, 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def value(self, kind):
        if kind.startswith("?"):
            return self.value(kind[1:]) if self.take(1)[0] else None
        if kind.startswith("["):
            item, count = kind[1:-1].split(";")
            count = self.varint() if count.startswith("..") else int(count)
            return [self.value(item) for _ in range(count)]
        if kind in ("u8", "bool"):
            return self.take(1)[0]
        if kind in ("u16", "u32", "u64"):
            return self.varint()
        if kind in ("f32", "f64"):
            return struct.unpack("<f" if kind == "f32" else "<d", self.take(int(kind[1:]) // 8))[0]
        if kind in ("bytes", "str"):
            data = self.take(self.varint())
            return data.decode() if kind == "str" else data
        raise ValueError(f"no type {kind}")

    def fields(self, text):
        return dict(self.field(field) for field in parts(text, ","))

    def field(self, text):
        at = min((text.index(mark) for mark in " {(" if mark in text), default=len(text))
        name, rest = text[:at], text[at:]
        if rest.startswith("{"):
            return name, self.fields(rest[1:-1])
        if rest.startswith("("):
            return name, self.variant(parts(rest[1:-1], "|"))
        return name, self.value(rest[1:])

    def variant(self, variants):
        """An enum: the name of its variant and what is in it."""
        text = variants[self.varint()]
        at = min((text.index(mark) for mark in "{(" if mark in text), default=len(text))
        name, rest = text[:at], text[at:]
        if rest.startswith("{"):
            return {name: self.fields(rest[1:-1])}
        return {name: self.variant(parts(rest[1:-1], "|"))} if rest else name

    def end(self):
        if self.at != len(self.data):
            raise ValueError("bytes left over")


def message(data, kinds):
    """Name and fields of what a board says."""
    payload = Payload(data)
    name, fields = kinds[:MESSAGES][payload.varint()]
    values = payload.fields(fields)
    payload.end()
    return name, values


def request(data, kinds):
    """Number, name and fields of what a host asks."""
    payload = Payload(data)
    number = payload.varint()
    name, fields = kinds[MESSAGES:][payload.varint()]
    values = payload.fields(fields)
    payload.end()
    return number, name, values
