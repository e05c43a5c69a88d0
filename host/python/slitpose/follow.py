"""Live poses of a running daemon, by its datagrams or from its shared memory (``slitpose run --publish``)."""

from __future__ import annotations

import array
import contextlib
import dataclasses
import errno
import fcntl
import mmap
import os
import re
import socket
import struct
import time
from typing import Iterator, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._native import SlitposeError, fence, rotation_vectors
from .poses import Poses, Status

#: The layout of a pose datagram, ``struct slitpose_pose`` of slitpose_pose.h.
DATAGRAM = np.dtype(
    [
        ("magic", "S4"), ("version", "<u2"), ("size", "<u2"), ("flags", "<u4"), ("status", "<u2"),
        ("cells_used", "<u2"), ("device", "V12"), ("excluded_cells", "<u2"), ("redundancy", "<u2"),
        ("datagram", "<u8"), ("missed", "<u8"), ("sequence", "<u8"), ("device_time_ns", "<u8"),
        ("host_monotonic_ns", "<u8"), ("host_utc_ns", "<u8"), ("host_uncertainty_ns", "<u8"),
        ("arrival_monotonic_ns", "<u8"), ("published_monotonic_ns", "<u8"), ("translation_m", "<f8", 3),
        ("rotation_xyzw", "<f8", 4), ("covariance", "<f8", (6, 6)), ("linear_m_per_s", "<f8", 3),
        ("angular_rad_per_s", "<f8", 3), ("twist_sigma", "<f8", 6),
        ("light_level", "<f8"), ("no_twist", "<u8"),
    ]
)  # fmt: skip

_VERSION = 1
_HAS_HOST_TIME, _IS_SIMULATED, _IS_BEHIND = 4, 16, 32
_REQUEST = struct.Struct("<4sHHHH12sQ")
_ANSWER = struct.Struct("<4sHHHHIQ")
_FOLLOW = 2
_PROVE, _REFUSED = 1, 2

#: How often poses are asked for: a request lasts three seconds. As often a memory is asked whether it is written.
_RENEWAL_S = 1.0

# Shared memory, as slitpose_pose.h has it.
_MEMORY_HEAD = b"SLPM\x01\0\0\0"
_RINGS, _RECORDS = 8, 256
_HEAD_BYTES, _RECORD_BYTES = 64, 576
_RING_BYTES = _HEAD_BYTES + _RECORDS * _RECORD_BYTES
_MEMORY_BYTES = _HEAD_BYTES + _RINGS * _RING_BYTES

#: How long a loop sleeps between two looks at shared memory.
_LOOK_S = 2e-4


@dataclasses.dataclass(frozen=True, eq=False)
class LivePose:
    """One pose, as it was sent. What it lacks is NaN, or ``None``.

    :ivar device: the board: 24 hexadecimal digits.
    :ivar sequence: number of the scan, counted by the board.
    :ivar datagram: number of the datagram, from 1: gaps are poses that were not received.
    :ivar missed: datagrams that the full queue of this follower refused; of UDP and shared memory unknown.
    :ivar status: whether there is a pose.
    :ivar cells_used: number of cells that entered.
    :ivar excluded_cells: cells that contradict all others: bit k is cell k.
    :ivar redundancy: data minus unknowns.
    :ivar time_s: the instant of the pose by the board's clock, s.
    :ivar host_utc_ns: the same by UTC, ns since 1970; ``None`` while unknown.
    :ivar host_monotonic_ns: the same by CLOCK_MONOTONIC of the daemon's machine; ``None`` while unknown.
    :ivar translation_m: (3,) m.
    :ivar rotation_xyzw: (4,) quaternion x, y, z, w.
    :ivar covariance: (6, 6) of (dt, dr) in the base frame: m², m·rad, rad².
    :ivar twist: (6,) velocity in the base frame: m/s, rad/s.
    :ivar twist_sigma: (6,) its standard deviations.
    :ivar light_level: brightness of all light relative to scene or calibration.
    :ivar no_twist: why a pose has no velocity: a word of ``Poses.words["no_twist"]``.
    :ivar simulated: whether it was computed, not measured.
    :ivar behind: whether the daemon is late and has skipped scans before this one.
    """

    device: str
    sequence: int
    datagram: int
    missed: int
    status: Status
    cells_used: int
    excluded_cells: int
    redundancy: int
    time_s: float
    host_utc_ns: Optional[int]
    host_monotonic_ns: Optional[int]
    translation_m: NDArray[np.float64]
    rotation_xyzw: NDArray[np.float64]
    covariance: NDArray[np.float64]
    twist: NDArray[np.float64]
    twist_sigma: NDArray[np.float64]
    light_level: float
    no_twist: str
    simulated: bool
    behind: bool

    @property
    def rotation_rad(self) -> NDArray[np.float64]:
        """(3,) rotation vector, rad."""
        rotation: NDArray[np.float64] = rotation_vectors(self.rotation_xyzw[np.newaxis])[0]
        return rotation

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(6,) standard deviations of the pose: m, rad."""
        sigma: NDArray[np.float64] = np.sqrt(np.diag(self.covariance))
        return sigma

    @classmethod
    def of(cls, datagram: bytes) -> LivePose:
        """The pose of a datagram.

        :raises ValueError: bytes of another kind or version.
        """
        if len(datagram) < DATAGRAM.itemsize or datagram[:6] != b"SLPP" + _VERSION.to_bytes(2, "little"):
            raise ValueError(f"{len(datagram)} bytes are no pose of version {_VERSION}")
        row = np.frombuffer(datagram, DATAGRAM, count=1)[0]
        flags = int(row["flags"])
        has_host_time = bool(flags & _HAS_HOST_TIME)
        return cls(
            device=row["device"].tobytes().hex(),
            sequence=int(row["sequence"]),
            datagram=int(row["datagram"]),
            missed=int(row["missed"]),
            status=Status(int(row["status"])),
            cells_used=int(row["cells_used"]),
            excluded_cells=int(row["excluded_cells"]),
            redundancy=int(row["redundancy"]),
            time_s=int(row["device_time_ns"]) * 1e-9,
            host_utc_ns=int(row["host_utc_ns"]) if has_host_time else None,
            host_monotonic_ns=int(row["host_monotonic_ns"]) if has_host_time else None,
            translation_m=row["translation_m"],
            rotation_xyzw=row["rotation_xyzw"],
            covariance=row["covariance"],
            twist=np.concatenate([row["linear_m_per_s"], row["angular_rad_per_s"]]),
            twist_sigma=row["twist_sigma"],
            light_level=float(row["light_level"]),
            no_twist=Poses.words["no_twist"][int(row["no_twist"])],
            simulated=bool(flags & _IS_SIMULATED),
            behind=bool(flags & _IS_BEHIND),
        )


def follow(
    address: str,
    *,
    device: Optional[str] = None,
    timeout_s: Optional[float] = None,
    duration_s: Optional[float] = None,
) -> Iterator[LivePose]:
    """Each pose of a running daemon, as it comes, until the iteration is left.

    The queue of a socket holds some 160 poses, 40 ms at 4 kHz: a loop that takes longer misses some, as the numbers of
    the datagrams show. Shared memory holds 256 of each board, and is looked at 5 000 times a second.

    :param address: as given to ``slitpose run --publish``: ``unix:PATH``, ``udp:127.0.0.1:PORT`` or ``shm:NAME``.
    :param device: the board, 24 hexadecimal digits; ``None``: all.
    :param timeout_s: end the iteration after so long without a pose; ``None``: wait for ever.
    :param duration_s: end the iteration after so long, with or without poses; ``None``: never.
    :raises slitpose.SlitposeError: there is no daemon, it has ended, or it has no place for a follower.
    :raises ValueError: an address or a board that cannot be.
    """
    if device is not None and not re.fullmatch("[0-9a-fA-F]{24}", device):
        raise ValueError(f"device = {device!r}; give 24 hexadecimal digits")
    board = bytes(12) if device is None else bytes.fromhex(device)
    if address.startswith("shm:") and address != "shm:":
        name = address[len("shm:") :]
        path = name if "/" in name else f"/dev/shm/{name}"
        return _follow_memory(address, path, board, timeout_s, duration_s)
    family, target = _parsed(address)
    return _follow(address, family, target, board, timeout_s, duration_s)


def _parsed(address: str) -> tuple[int, Union[str, tuple[str, int]]]:
    kind, _, rest = address.partition(":")
    host, _, port = rest.rpartition(":")
    if kind == "unix" and rest:
        return socket.AF_UNIX, rest
    if kind == "udp" and host and port.isdecimal():
        host = host.strip("[]")
        return (socket.AF_INET6 if ":" in host else socket.AF_INET), (host, int(port))
    raise ValueError(f"{address!r} is no address for poses; give unix:PATH, udp:127.0.0.1:PORT or shm:NAME")


def _follow(
    address: str,
    family: int,
    target: Union[str, tuple[str, int]],
    board: bytes,
    timeout_s: Optional[float],
    duration_s: Optional[float],
) -> Iterator[LivePose]:
    with contextlib.ExitStack() as sockets:
        ask = link = sockets.enter_context(socket.socket(family, socket.SOCK_DGRAM))
        rights = []
        cookie, asked_s, last_s, poses = 0, -np.inf, time.monotonic(), 0
        silence_s = np.inf if timeout_s is None else timeout_s
        end_s = np.inf if duration_s is None else last_s + duration_s
        try:
            if family == socket.AF_UNIX:
                # A queue of its own: the daemon sends from the far end, which it gets with each request.
                link, far = map(sockets.enter_context, socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM))
                rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [far.fileno()]))]
            ask.connect(target)
            while (now_s := time.monotonic()) < min(end_s, last_s + silence_s):
                if now_s - asked_s >= _RENEWAL_S:
                    ask.sendmsg([_request(board, cookie)], rights)
                    asked_s = now_s
                wait_s = min(_RENEWAL_S, silence_s, end_s - now_s)
                link.settimeout(max(wait_s, 1e-3))
                try:
                    received = link.recv(4096)
                except socket.timeout:
                    continue
                if len(received) == _ANSWER.size and received.startswith(b"SLPA"):
                    _, _, _, kind, _, _, cookie = _ANSWER.unpack(received)
                    if kind == _REFUSED:
                        raise SlitposeError(f"{address}: all places for followers are taken; end another one first")
                    if kind == _PROVE:
                        ask.sendmsg([_request(board, cookie)], rights)
                elif len(received) >= DATAGRAM.itemsize and received.startswith(b"SLPP"):
                    poses += 1
                    yield LivePose.of(received)
                    last_s = time.monotonic()
        except OSError as error:
            raise _gone(address, error, poses) from error


def _gone(address: str, error: OSError, poses: int) -> SlitposeError:
    step = f"start `slitpose run --publish {address}`"
    step = f"the daemon has ended after {poses} poses: {step} again" if poses else f"{step} first"
    return SlitposeError(f"{address}: {error.strerror or error}; {step}")


def _follow_memory(
    address: str, path: str, board: bytes, timeout_s: Optional[float], duration_s: Optional[float]
) -> Iterator[LivePose]:
    poses, begun_s = 0, time.monotonic()
    asked_s = last_s = begun_s
    silence_s = np.inf if timeout_s is None else timeout_s
    end_s = np.inf if duration_s is None else begun_s + duration_s
    try:
        with _Memory(path) as memory:
            while (now_s := time.monotonic()) < min(end_s, last_s + silence_s):
                if now_s - asked_s >= _RENEWAL_S:
                    memory.require_writer()
                    asked_s = now_s
                is_new = False
                for datagram in memory.new():
                    if board in (bytes(12), datagram[16:28]):
                        is_new = True
                        poses += 1
                        yield LivePose.of(datagram)
                        last_s = time.monotonic()
                        if last_s >= end_s:
                            return
                if not is_new:
                    time.sleep(_LOOK_S)
    except OSError as error:
        raise _gone(address, error, poses) from error


class _Memory(contextlib.ExitStack):
    """The rings of a daemon's shared memory."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self._file = self.enter_context(open(path, "rb"))
        if os.fstat(self._file.fileno()).st_size != _MEMORY_BYTES:
            raise OSError(errno.EINVAL, "this file is no memory of poses of this version")
        self._map = self.enter_context(mmap.mmap(self._file.fileno(), _MEMORY_BYTES, prot=mmap.PROT_READ))
        self._words = self.enter_context(memoryview(self._map).cast("Q"))
        if self._map[: len(_MEMORY_HEAD)] != _MEMORY_HEAD:
            raise OSError(errno.EINVAL, "this file is no memory of poses of this version")
        self.require_writer()
        self._taken = [self._count(ring) for ring in range(_RINGS)]

    def require_writer(self) -> None:
        """Asks for the lock that a daemon holds: ``struct flock`` of Linux."""
        asked = struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0)
        (kind,) = struct.unpack_from("h", fcntl.fcntl(self._file, fcntl.F_GETLK, asked))
        if kind == fcntl.F_UNLCK or self._words[1] == 0:
            raise OSError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))

    def new(self) -> Iterator[bytes]:
        """All poses that came since the last call."""
        for ring in range(_RINGS):
            count = self._count(ring)
            for number in range(max(self._taken[ring], count - _RECORDS), count):
                self._taken[ring] = number + 1
                datagram = self._copied(ring, number)
                if datagram is not None:
                    yield datagram

    def _count(self, ring: int) -> int:
        count = self._words[(_HEAD_BYTES + ring * _RING_BYTES) // 8]
        fence()
        return count

    def _copied(self, ring: int, number: int) -> Optional[bytes]:
        """The pose behind ``number`` others; ``None`` if it is not there, or not any more."""
        at = 2 * _HEAD_BYTES + ring * _RING_BYTES + number % _RECORDS * _RECORD_BYTES
        before = self._words[at // 8]
        fence()
        datagram = self._map[at + 8 : at + 8 + DATAGRAM.itemsize]
        fence()
        return datagram if before == self._words[at // 8] == 2 * (number + 1) else None


def _request(board: bytes, cookie: int) -> bytes:
    return _REQUEST.pack(b"SLPQ", _VERSION, _REQUEST.size, _FOLLOW, 0, board, cookie)
