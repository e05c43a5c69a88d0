"""Live poses of a running daemon, by its datagrams (``slitpose run --publish``)."""

from __future__ import annotations

import array
import contextlib
import dataclasses
import socket
import struct
import time
from typing import Iterator, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._native import SlitposeError
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

#: How often poses are asked for: a request lasts three seconds.
_RENEWAL_S = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class LivePose:
    """One pose, as it was sent. What it lacks is NaN, or ``None``."""

    #: The board: 24 hexadecimal digits.
    device: str
    #: Number of the scan, counted by the board.
    sequence: int
    #: Number of the datagram, from 1: gaps are poses that were not received.
    datagram: int
    #: Datagrams that the full queue of this follower refused; of UDP unknown.
    missed: int
    status: Status
    cells_used: int
    #: Cells that contradict all others: bit k is cell k.
    excluded_cells: int
    redundancy: int
    #: The instant of the pose by the board's clock, s.
    time_s: float
    #: The same by UTC, ns since 1970, and by CLOCK_MONOTONIC; ``None`` while unknown.
    host_utc_ns: Optional[int]
    host_monotonic_ns: Optional[int]
    #: (3,) m.
    translation_m: NDArray[np.float64]
    #: (4,) quaternion x, y, z, w.
    rotation_xyzw: NDArray[np.float64]
    #: (6, 6) of (dt, dr) in the base frame: m², m·rad, rad².
    covariance: NDArray[np.float64]
    #: (6,) velocity in the base frame: m/s, rad/s.
    twist: NDArray[np.float64]
    #: (6,) its standard deviations.
    twist_sigma: NDArray[np.float64]
    #: Brightness of all light relative to scene or calibration.
    light_level: float
    #: Why a pose has no velocity: a word of ``Poses.words["no_twist"]``.
    no_twist: str
    #: Whether it was computed, not measured.
    simulated: bool
    #: Whether scans before this one were passed over because the daemon is late.
    behind: bool

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
    address: str, *, device: Optional[str] = None, timeout_s: Optional[float] = None
) -> Iterator[LivePose]:
    """Each pose of a running daemon, as it comes, until the iteration is left.

    The queue of a socket holds some hundred poses: a loop that takes longer misses some, as the numbers of the
    datagrams show.

    :param address: as given to ``slitpose run --publish``: ``unix:PATH`` or ``udp:127.0.0.1:PORT``.
    :param device: the board, 24 hexadecimal digits; ``None``: all.
    :param timeout_s: end the iteration after so long without a pose; ``None``: wait for ever.
    :raises slitpose.SlitposeError: there is no daemon, or it has no place for a follower.
    :raises ValueError: an address or a board that cannot be.
    """
    board = bytes(12) if device is None else bytes.fromhex(device)
    if len(board) != 12:
        raise ValueError(f"device = {device!r}; give 24 hexadecimal digits")
    family, target = _parsed(address)
    return _follow(address, family, target, board, timeout_s)


def _parsed(address: str) -> tuple[int, Union[str, tuple[str, int]]]:
    kind, _, rest = address.partition(":")
    host, _, port = rest.rpartition(":")
    if kind == "unix" and rest:
        return socket.AF_UNIX, rest
    if kind == "udp" and host and port.isdecimal():
        host = host.strip("[]")
        return (socket.AF_INET6 if ":" in host else socket.AF_INET), (host, int(port))
    raise ValueError(f"{address!r} is no address for poses; give unix:PATH or udp:127.0.0.1:PORT")


def _follow(
    address: str, family: int, target: Union[str, tuple[str, int]], board: bytes, timeout_s: Optional[float]
) -> Iterator[LivePose]:
    with contextlib.ExitStack() as sockets:
        ask = link = sockets.enter_context(socket.socket(family, socket.SOCK_DGRAM))
        rights = []
        cookie, asked_s, last_s = 0, -np.inf, time.monotonic()
        try:
            if family == socket.AF_UNIX:
                # A queue of its own: the daemon sends from the far end, which it gets with each request.
                link, far = map(sockets.enter_context, socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM))
                rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [far.fileno()]))]
            ask.connect(target)
            while timeout_s is None or time.monotonic() - last_s < timeout_s:
                if time.monotonic() - asked_s >= _RENEWAL_S:
                    ask.sendmsg([_request(board, cookie)], rights)
                    asked_s = time.monotonic()
                wait_s = _RENEWAL_S if timeout_s is None else min(_RENEWAL_S, timeout_s)
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
                    yield LivePose.of(received)
                    last_s = time.monotonic()
        except OSError as error:
            reason = error.strerror or error
            raise SlitposeError(f"{address}: {reason}; start `slitpose run --publish {address}` first") from error


def _request(board: bytes, cookie: int) -> bytes:
    return _REQUEST.pack(b"SLPQ", _VERSION, _REQUEST.size, _FOLLOW, 0, board, cookie)
