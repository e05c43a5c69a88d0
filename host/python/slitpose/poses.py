"""Poses as arrays."""

from __future__ import annotations

import enum
import inspect
from typing import TYPE_CHECKING, Any, Optional, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


#: Unit and meaning of each array of :class:`Poses`.
_ABOUT = {
    name: ("m/s, rad/s" if name.endswith("twist") and unit else unit, meaning) for name, unit, meaning, _ in _native.COLUMNS
}

#: The words that the numbers of an array stand for.
_WORDS = {name: tuple(words) for name, _, _, words in _native.COLUMNS if words}


class Poses:
    """Poses and what is known of them, a row each (N): an array for each quantity, as listed below and by :meth:`describe`.

    What a row lacks is NaN, in columns of integers 0. Numbers stand for words where :attr:`words` has some. Arrays that
    only captures have (time, velocity, truth) are absent where rows of currents were solved; those of the filter are absent
    without one. :meth:`columns` has the arrays that are there.
    ``covariance`` (N, 6, 6) is that of (dt, dr) in the base frame; ``twist`` (N, 6) has linear and angular velocity.
    Bit k of ``free_directions`` is that of ``slitpose.AXES[k]``, bit k of ``excluded_cells`` that of cell k. ``device`` has
    indices of :attr:`devices`.
    """

    sequence: NDArray[np.uint64]
    device: NDArray[np.uint8]
    time_s: NDArray[np.float64]
    host_monotonic_ns: NDArray[np.uint64]
    host_utc_ns: NDArray[np.uint64]
    host_uncertainty_ns: NDArray[np.uint64]
    status: NDArray[np.uint8]
    reason: NDArray[np.uint8]
    free_directions: NDArray[np.uint8]
    translation_m: NDArray[np.float64]
    rotation_xyzw: NDArray[np.float64]
    covariance: NDArray[np.float64]
    cells_used: NDArray[np.uint16]
    chi2: NDArray[np.float64]
    redundancy: NDArray[np.uint16]
    verified: NDArray[np.uint8]
    unnoticed_sigmas: NDArray[np.float64]
    excluded_cells: NDArray[np.uint16]
    twist: NDArray[np.float64]
    twist_sigma: NDArray[np.float64]
    no_twist: NDArray[np.uint8]
    filtered_translation_m: NDArray[np.float64]
    filtered_rotation_xyzw: NDArray[np.float64]
    filtered_covariance: NDArray[np.float64]
    filtered_twist: NDArray[np.float64]
    filtered_twist_sigma: NDArray[np.float64]
    filtered_no_twist: NDArray[np.uint8]
    filtered_lag_s: NDArray[np.float64]
    filtered_frames: NDArray[np.uint64]
    light_level: NDArray[np.float64]
    simulated: NDArray[np.bool_]
    truth_translation_m: NDArray[np.float64]
    truth_rotation_xyzw: NDArray[np.float64]
    condition: NDArray[np.float64]
    iterations: NDArray[np.uint16]

    #: The words for the numbers of each array that has some.
    words = _WORDS

    #: The words for ``reason``.
    reasons = _WORDS["reason"]

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            if name in _ABOUT:
                step = "give filter_s to replay" if name.startswith("filtered_") else "only poses of captures have it"
                raise AttributeError(f"these poses have no {name}: {step}")
            raise AttributeError(f"poses have no {name}; see Poses.describe()")

    def __init__(
        self,
        *,
        devices: Sequence[str] = (),
        losses: Sequence[str] = (),
        remarks: Sequence[str] = (),
        **columns: NDArray[Any],
    ) -> None:
        #: The boards: 24 hexadecimal digits each.
        self.devices = tuple(devices)
        #: What was damaged or lost, in words; empty: nothing.
        self.losses = tuple(losses)
        #: What else was remarkable.
        self.remarks = tuple(remarks)
        unknown = columns.keys() - _ABOUT.keys()
        if unknown:
            raise TypeError(f"{sorted(unknown)} are no arrays of poses; see Poses.describe()")
        self.__dict__.update({name: columns[name] for name in _ABOUT if columns.get(name) is not None})

    @staticmethod
    def describe() -> str:
        """The arrays, with their units and meanings, a line each."""
        lines = (f"{name:24}{unit:12}{meaning}" for name, (unit, meaning) in _ABOUT.items())
        return "\n".join(lines)

    def __len__(self) -> int:
        return len(self.status)

    def __repr__(self) -> str:
        counts = ", ".join(f"{Status(s).name} {n}" for s, n in zip(*np.unique(self.status, return_counts=True)))
        return f"<Poses: {len(self)} rows: {counts or 'none'}>"

    def __getitem__(self, rows: Any) -> Poses:
        """The poses of a slice, a mask or an array of indices; views where numpy gives views."""
        if np.ndim(np.empty(len(self))[rows]) != 1:
            raise ValueError(f"{rows!r} gives no rows; give a slice, a mask or an array of indices")
        return self._with({name: column[rows] for name, column in self.columns().items()}, self.losses)

    def _with(self, columns: dict[str, NDArray[Any]], losses: Sequence[str]) -> Poses:
        return Poses(**columns, devices=self.devices, losses=losses, remarks=self.remarks)

    def columns(self) -> dict[str, NDArray[Any]]:
        """The arrays that are there, by name."""
        return {name: value for name, value in self.__dict__.items() if name in _ABOUT}

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(N,) whether the row has a pose."""
        found: NDArray[np.bool_] = self.status <= Status.degraded
        return found

    @property
    def rotation_rad(self) -> NDArray[np.float64]:
        """(N, 3) rotation vectors, rad."""
        return _native.rotation_vectors(self.rotation_xyzw)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(N, 6) standard deviations of the pose: m, rad."""
        sigma: NDArray[np.float64] = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return sigma

    def error(
        self, translation_m: Optional[ArrayLike] = None, rotation: Optional[ArrayLike] = None
    ) -> NDArray[np.float64]:
        """(N, 6) errors, the perturbation of :attr:`covariance` from truth to pose: t̂ − t, m, and log(R̂ Rᵀ), rad.

        The truth is that of a simulated board, or a reference: as many `translation_m`, and `rotation` as rotation vectors
        or quaternions.
        """
        if translation_m is None or rotation is None:
            if translation_m is not rotation:
                raise ValueError("half a reference; give both translation_m and rotation")
            if not getattr(self, "simulated", np.zeros(0)).any():
                raise ValueError("these poses have no truth; give translation_m and rotation of a reference")
            translation_m, rotation = self.truth_translation_m, self.truth_rotation_xyzw
        true_m, true = np.asarray(translation_m, np.float64), np.asarray(rotation, np.float64)
        if true_m.shape != (len(self), 3) or true.shape not in [(len(self), 3), (len(self), 4)]:
            raise ValueError(f"the reference has the shapes {true_m.shape} and {true.shape}; give a pose for each row")
        if true.shape[1] == 3:
            true = _native.quaternions(np.ascontiguousarray(true))
        (v, w), (true_v, true_w) = ((q[:, :3], q[:, 3:]) for q in (self.rotation_xyzw, true))
        dot = np.sum(v * true_v, axis=1, keepdims=True)
        turned = np.hstack([true_w * v - w * true_v - np.cross(v, true_v), w * true_w + dot])
        return np.hstack([self.translation_m - true_m, _native.rotation_vectors(turned)])

    def nees(self, error: Optional[NDArray[np.float64]] = None) -> NDArray[np.float64]:
        """(N,) normalised estimation errors squared, eᵀP⁻¹e, of :meth:`error` or of these errors e (N, 6), by the covariance
        P: 6 in the mean if P is right. NaN without a pose."""
        error = self.error() if error is None else error
        found = np.full(len(self), np.nan)
        e, has_pose = error[self.has_pose], self.has_pose
        found[has_pose] = np.sum(e * np.linalg.solve(self.covariance[has_pose], e[..., np.newaxis])[..., 0], axis=1)
        return found

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
        if "sequence" in self.columns():
            data |= {"sequence": self.sequence, "time_s": self.time_s}
            utc = self.host_utc_ns.astype("datetime64[ns]")
            utc[self.host_utc_ns == 0] = np.datetime64("NaT")
            data["host_utc"] = utc
            data["device"] = words(self.device, self.devices)
        for name in ("status", "reason"):
            data[name] = words(getattr(self, name), _WORDS[name])
        data |= axes("", self.translation_m, pose[:3]) | axes("", self.rotation_rad, pose[3:])
        data |= axes("q", self.rotation_xyzw, "xyzw") | axes("sigma_", self.sigma, pose)
        for name in ("condition", "chi2", "redundancy", "iterations", "cells_used", "excluded_cells"):
            data[name] = getattr(self, name)
        data["verified"] = words(self.verified, _WORDS["verified"])
        if "twist" in self.columns():
            data |= axes("", self.twist, speed) | axes("sigma_", self.twist_sigma, speed)
        if "filtered_twist" in self.columns():
            data |= axes("filtered_", self.filtered_translation_m, pose[:3])
            data |= axes("filtered_", _native.rotation_vectors(self.filtered_rotation_xyzw), pose[3:])
        if "simulated" in self.columns():
            data["simulated"] = self.simulated
            data |= axes("truth_", self.truth_translation_m, pose[:3])
            data |= axes("truth_", _native.rotation_vectors(self.truth_rotation_xyzw), pose[3:])
        for name, column in self.columns().items():
            if column.ndim == 1 and name not in data:
                data[name] = words(column, _WORDS[name]) if name in _WORDS else column
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
            own = [number[piece["device"]] for number, piece in zip(numbers, columns) if "device" in piece]
            joined["device"] = np.concatenate(own).astype(np.uint8)
        losses = tuple(dict.fromkeys(text for piece in pieces for text in piece.losses))
        remarks = tuple(dict.fromkeys(text for piece in pieces for text in piece.remarks))
        return cls(**joined, devices=devices, losses=losses, remarks=remarks)


Poses.__doc__ = f"{inspect.getdoc(Poses)}\n\n{Poses.describe()}"
