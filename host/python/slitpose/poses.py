"""Poses as arrays."""

from __future__ import annotations

import dataclasses
import enum
from typing import TYPE_CHECKING, Any, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from . import _native

if TYPE_CHECKING:
    import pandas


class SlitposeWarning(UserWarning):
    """Something about the data that is worth knowing."""


class DataLossWarning(SlitposeWarning):
    """Input data were damaged or lost; what remains is whole."""



class Status(enum.IntEnum):
    """Whether there is a pose; the numbers are those of datagrams. Only the first two have a pose."""

    converged = 0
    degraded = 1
    ambiguous = 2
    unobservable = 3
    too_dark = 4
    diverged = 5


class CellStatus(enum.IntEnum):
    """Geometry of a cell's spot: whole, cut by an end of the detector, none, or the emitter behind the slit."""

    lit = 0
    clipped = 1
    dark = 2
    behind = 3


class Flag(enum.IntFlag):
    """What the light of a cell does beyond geometry."""

    saturated = 1
    faint = 2
    facing_away = 4


class Reading(enum.IntEnum):
    """What was measured of a cell: currents, a limit of detector or converter, or nothing."""

    light = 0
    saturated = 1
    missing = 2


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Poses:
    """Poses and what is known of them, a row each (N). What a row lacks is NaN, in columns of integers 0.

    Columns that only streams have (``device`` to ``truth_rotation_xyzw``) are ``None`` where rows of currents were
    solved; those of the filter are ``None`` without one.
    """

    #: (N,) numbers of :class:`Status`.
    status: NDArray[np.uint8]
    #: (N,) why a pose is degraded: numbers of :attr:`reasons`.
    reason: NDArray[np.uint8]
    #: (N,) of an unobservable pose, coordinates that are free: bit k is that of ``slitpose.AXES[k]``.
    free_directions: NDArray[np.uint8]
    #: (N, 3) m.
    translation_m: NDArray[np.float64]
    #: (N, 4) quaternion x, y, z, w.
    rotation_xyzw: NDArray[np.float64]
    #: (N, 6, 6) of (dt, dr) in the base frame: m², m·rad, rad².
    covariance: NDArray[np.float64]
    #: (N,) condition number of the scaled normal equations.
    condition: NDArray[np.float64]
    #: (N,) sum of the squared normalised residuals.
    chi2: NDArray[np.float64]
    #: (N,) data minus unknowns.
    redundancy: NDArray[np.uint16]
    #: (N,) refinement steps.
    iterations: NDArray[np.uint16]
    #: (N,) how many cells entered.
    cells_used: NDArray[np.uint16]
    #: (N,) cells that contradict all others: bit k is cell k.
    excluded_cells: NDArray[np.uint16]
    #: (N,) how well redundancy checked the pose: 0 not, 1 weakly, 2 well.
    verified: NDArray[np.uint8]
    #: (N,) greatest shift of the pose by one undetected outlier, in its σ.
    unnoticed_sigmas: NDArray[np.float64]

    #: (N,) the board: index of :attr:`devices`.
    device: Optional[NDArray[np.uint8]] = None
    #: (N,) number of the scan, counted by the board.
    sequence: Optional[NDArray[np.uint64]] = None
    #: (N,) the instant of the pose by the board's clock, s.
    time_s: Optional[NDArray[np.float64]] = None
    #: (N,) the same by the host's CLOCK_MONOTONIC, ns; 0 while unknown.
    host_monotonic_ns: Optional[NDArray[np.uint64]] = None
    #: (N,) the same by UTC, ns since 1970; 0 while unknown.
    host_utc_ns: Optional[NDArray[np.uint64]] = None
    #: (N,) greatest error of both, ns; 0 while unknown.
    host_uncertainty_ns: Optional[NDArray[np.uint64]] = None
    #: (N, 6) velocity in the base frame: m/s, rad/s.
    twist: Optional[NDArray[np.float64]] = None
    #: (N, 6) its standard deviations.
    twist_sigma: Optional[NDArray[np.float64]] = None
    #: (N,) whether the currents were computed, not measured.
    simulated: Optional[NDArray[np.bool_]] = None
    #: (N, 3) m, the true pose of simulated boards.
    truth_translation_m: Optional[NDArray[np.float64]] = None
    #: (N, 4) quaternion x, y, z, w.
    truth_rotation_xyzw: Optional[NDArray[np.float64]] = None

    #: (N, 3) m, the pose filtered over many scans.
    filtered_translation_m: Optional[NDArray[np.float64]] = None
    #: (N, 4) quaternion x, y, z, w.
    filtered_rotation_xyzw: Optional[NDArray[np.float64]] = None
    #: (N, 6, 6) as :attr:`covariance`.
    filtered_covariance: Optional[NDArray[np.float64]] = None
    #: (N, 6) as :attr:`twist`.
    filtered_twist: Optional[NDArray[np.float64]] = None
    #: (N, 6) its standard deviations.
    filtered_twist_sigma: Optional[NDArray[np.float64]] = None
    #: (N,) time after which half of a small step has come through the filter, s.
    filtered_lag_s: Optional[NDArray[np.float64]] = None

    #: The boards: 24 hexadecimal digits each.
    devices: tuple[str, ...] = ()
    #: What was damaged or lost, in words; empty: nothing.
    losses: tuple[str, ...] = ()
    #: What else was remarkable.
    remarks: tuple[str, ...] = ()

    #: The words for :attr:`reason`.
    reasons = tuple(_native.REASONS)

    def __len__(self) -> int:
        return len(self.status)

    def __repr__(self) -> str:
        counts = ", ".join(f"{Status(s).name} {n}" for s, n in zip(*np.unique(self.status, return_counts=True)))
        return f"<Poses: {len(self)} rows: {counts or 'none'}>"

    def __getitem__(self, rows: Any) -> Poses:
        """The poses of a slice, a mask or an array of indices; views where numpy gives views."""
        if np.ndim(np.empty(len(self))[rows]) != 1:
            raise ValueError(f"{rows!r} gives no rows; give a slice, a mask or an array of indices")
        return dataclasses.replace(self, **{name: column[rows] for name, column in self.columns().items()})

    def columns(self) -> dict[str, NDArray[Any]]:
        """The arrays that are there, by name."""
        fields = ((field.name, getattr(self, field.name)) for field in dataclasses.fields(self))
        return {name: value for name, value in fields if isinstance(value, np.ndarray)}

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(N,) whether the row has a pose."""
        return self.status <= Status.degraded

    @property
    def rotation_rad(self) -> NDArray[np.float64]:
        """(N, 3) rotation vectors, rad."""
        return _native.rotation_vectors(self.rotation_xyzw)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(N, 6) standard deviations of the pose: m, rad."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    def to_frame(self) -> pandas.DataFrame:
        """As a pandas DataFrame, units in the names of its columns; covariances as standard deviations."""
        import pandas

        def axes(prefix: str, values: NDArray[np.float64], suffixes: Sequence[str]) -> dict[str, NDArray[np.float64]]:
            return {f"{prefix}{name}": values[:, k] for k, name in enumerate(suffixes)}

        pose = [f"{axis}_{'m' if axis[0] == 't' else 'rad'}" for axis in _native.AXES]
        speed = [*(f"v{a}_m_per_s" for a in "xyz"), *(f"w{a}_rad_per_s" for a in "xyz")]
        def words(codes: NDArray[Any], categories: Sequence[str]) -> Any:
            return pandas.Categorical.from_codes(codes, categories=pandas.Index(categories))

        data: dict[str, Any] = {}
        if self.sequence is not None and self.device is not None:
            data |= {"sequence": self.sequence, "time_s": self.time_s}
            if self.host_utc_ns is not None:
                utc = self.host_utc_ns.astype("datetime64[ns]")
                utc[self.host_utc_ns == 0] = np.datetime64("NaT")
                data["host_utc"] = utc
            data["device"] = words(self.device, self.devices)
        data["status"] = words(self.status, _native.STATUSES)
        data["reason"] = words(self.reason, _native.REASONS)
        data |= axes("", self.translation_m, pose[:3]) | axes("", self.rotation_rad, pose[3:])
        data |= axes("q", self.rotation_xyzw, "xyzw") | axes("sigma_", self.sigma, pose)
        for name in ("condition", "chi2", "redundancy", "iterations", "cells_used", "excluded_cells"):
            data[name] = getattr(self, name)
        data["verified"] = words(self.verified, _native.VERIFIED)
        if self.twist is not None and self.twist_sigma is not None:
            data |= axes("", self.twist, speed) | axes("sigma_", self.twist_sigma, speed)
        if self.filtered_translation_m is not None and self.filtered_rotation_xyzw is not None:
            data |= axes("filtered_", self.filtered_translation_m, pose[:3])
            data |= axes("filtered_", _native.rotation_vectors(self.filtered_rotation_xyzw), pose[3:])
        if self.simulated is not None:
            data["simulated"] = self.simulated
        if self.truth_translation_m is not None and self.truth_rotation_xyzw is not None:
            data |= axes("truth_", self.truth_translation_m, pose[:3])
            data |= axes("truth_", _native.rotation_vectors(self.truth_rotation_xyzw), pose[3:])
        return pandas.DataFrame(data)

    @classmethod
    def concatenate(cls, pieces: Sequence[Poses]) -> Poses:
        """The rows of all `pieces`, in their order. Losses and remarks are those of all."""
        if not pieces:
            raise ValueError("no poses to join; give at least one piece")
        devices = tuple(dict.fromkeys(name for piece in pieces for name in piece.devices))
        filled = [piece for piece in pieces if len(piece)] or [pieces[0]]
        columns = [piece.columns() for piece in filled]
        names = list(dict.fromkeys(name for piece in columns for name in piece))
        joined: dict[str, Any] = {}
        for name in names:
            shape = next(piece[name] for piece in columns if name in piece)
            empty = [np.full((len(piece), *shape.shape[1:]), np.nan) for piece in filled]
            joined[name] = np.concatenate([own.get(name, nothing) for own, nothing in zip(columns, empty)])
        if "device" in joined:
            numbers = [np.array([devices.index(name) for name in piece.devices] or [0]) for piece in filled]
            own = [number[piece.device] for number, piece in zip(numbers, filled) if piece.device is not None]
            joined["device"] = np.concatenate(own).astype(np.uint8)
        losses = tuple(dict.fromkeys(text for piece in pieces for text in piece.losses))
        remarks = tuple(dict.fromkeys(text for piece in pieces for text in piece.remarks))
        return cls(**joined, devices=devices, losses=losses, remarks=remarks)
