"""Parts of a recording that are solved apart, on several machines, and joined to what the whole gives.

A pose depends on its scan and on the tracker, which carries the motion of the scans before. A part decodes the recording
from its beginning (clocks, settings and configuration are then as in the whole), solves some time before its first scan
without keeping the poses, and takes a digest of the tracker's state before its first scan and behind its last. Where the
state before a part is that behind the part before, all poses that follow are the same bits: the seam is closed.

A seam is closed where a session begins (:func:`slitpose.sessions`), because its tracker has no past, and where the warm-up
reaches back to the beginning of the session. Anywhere else it stays open however long the warm-up is: the states approach
each other, and then wander in the last bits. Such parts agree with the whole far below its noise (differences up to 1e-13 m
and 1e-11 rad were seen), but are not the same bits.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Optional, Sequence

from . import _native
from .captures import Options, PartOptions, Paths, _files, _native_options, _warn
from .poses import Poses

if TYPE_CHECKING:
    from typing_extensions import Unpack

#: Digests of the states of trackers, by board.
States = dict[str, Optional[int]]


class SeamError(_native.SlitposeError):
    """Parts that do not follow from each other."""

    def __init__(self, seams: Sequence[int]) -> None:
        super().__init__(
            f"the parts {list(seams)} do not go on with the bits that the ones before end with; split where sessions begin, "
            "or join them with same_bits=False"
        )
        #: The numbers of these parts.
        self.seams = tuple(seams)


@dataclasses.dataclass(frozen=True)
class Part:
    """The poses of a part, and what they depend on at both of its ends.

    :ivar before: state before the first scan of each board; ``None``: it has none in this part.
    :ivar behind: state behind the last scan of each board.
    :ivar from_s: where it begins, seconds after the beginning of the recording.
    :ivar to_s: where it ends.
    """

    poses: Poses
    before: States
    behind: States
    from_s: Optional[float]
    to_s: Optional[float]


def replay_part(
    paths: Paths, from_s: Optional[float], to_s: Optional[float], *, warm_up_s: float = 0.1, **options: Unpack[PartOptions]
) -> Part:
    """The poses between two times of a recording, as a replay of the whole gives them if the seam before is closed.

    Times are seconds after the beginning of the first file, by the host's clock; ``None``: from the beginning, to the end.
    A scan belongs to the part in which its bytes arrived. `options` are those of :func:`slitpose.replay`.

    Warnings are not raised, because losses before the part belong to other parts: :func:`join` raises them.
    """
    whole: Options = {**options, "from_s": from_s, "to_s": to_s}
    captures = _native.Captures(_files(paths), warm_up_s=warm_up_s, **_native_options(whole))
    columns = captures.read() or {}
    losses, remarks = tuple(captures.losses), tuple(captures.remarks)
    poses = Poses(**columns, devices=tuple(captures.devices), losses=losses, remarks=remarks)
    before = {device: state for device, state, _ in captures.seams}
    behind = {device: state for device, _, state in captures.seams}
    return Part(poses, before, behind, from_s, to_s)


def open_seams(parts: Sequence[Part]) -> list[int]:
    """The numbers of the parts that do not go on where the ones before end; `parts` in their order, without gaps."""
    if parts and parts[0].from_s is not None:
        raise ValueError(f"the first part begins at {parts[0].from_s} s; the first one has to have no beginning")
    for number in range(1, len(parts)):
        end_s, from_s = parts[number - 1].to_s, parts[number].from_s
        if end_s is None or from_s != end_s:
            raise ValueError(f"part {number} begins at {from_s} s, and the one before it ends at {end_s} s")
    states: States = {}
    seams = []
    for number, part in enumerate(parts):
        begun = {device: state for device, state in part.before.items() if state is not None}
        if number > 0 and any(states.get(device, state) != state for device, state in begun.items()):
            seams.append(number)
        states |= {device: state for device, state in part.behind.items() if state is not None}
    return seams


def join(parts: Sequence[Part], *, same_bits: bool = True) -> Poses:
    """The poses of all `parts`: the same bits as one replay of the whole; unless `same_bits`, poses that differ far less
    than their noise.

    :raises SeamError: seams are open, and the same bits are asked for.
    :warns slitpose.DataLossWarning: data were damaged or lost.
    """
    seams = open_seams(parts)
    if seams and same_bits:
        raise SeamError(seams)
    whole = Poses.concatenate([part.poses for part in parts])
    # The last part has decoded everything, and has counted all losses.
    whole = whole._with(whole.columns(), parts[-1].poses.losses)
    _warn(whole.remarks, whole.losses)
    return whole
