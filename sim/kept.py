"""What a moving scene's run keeps after each frame, so that one that was stopped goes on from its last whole frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .follow import Follower

WORDS = 160
"""Longest note that is kept, in bytes."""


class Kept:
    """A file of one record a frame: nodes, velocities and notes of all tubes, to the bit.

    Args:
        path: of the file.
        stamp: what names the scene; a file with another one is not gone on from.
        resume: go on from what is there; else it is begun anew.

    Raises:
        ValueError: there is nothing to go on from, or it is of another scene.
    """

    def __init__(self, path: Path, stamp: str, resume: bool):
        self.path, head = path, stamp.encode().ljust(64)[:64]
        self._bytes = b""
        if resume:
            if not path.is_file():
                raise ValueError(f"there is no {path.name} to go on from")
            data = path.read_bytes()
            if data[:64] != head:
                raise ValueError(f"{path.name} is of another scene, or of other settings")
            self._bytes = data[64:]
        else:
            path.write_bytes(head)

    def restore(self, followers: Sequence[Follower]) -> int:
        """Sets the tubes to where they were before the last whole frame; returns how many frames they have then.

        That frame is solved once more, so that its potentials are there.
        """
        kind = _record(followers)
        records = np.frombuffer(self._bytes[: len(self._bytes) // kind.itemsize * kind.itemsize], kind)[:-1]
        with self.path.open("r+b") as file:
            file.truncate(64 + records.nbytes)
        put_back(followers, records)
        return 1 + len(records)

    def add(self, followers: Sequence[Follower]) -> None:
        """Keeps the last frame."""
        with self.path.open("ab") as file:
            file.write(taken(followers).tobytes())


def taken(followers: Sequence[Follower]) -> np.ndarray:
    """One record: the last frame of all tubes, to the bit."""
    record = np.zeros(1, _record(followers))
    for k, follower in enumerate(followers):
        own, state = record[f"{k}"], follower.scene.state
        own["tube"], own["spine"] = follower.states[-1]
        own["velocity"], own["spine_velocity"] = state.velocity.numpy(), state.spine_velocity.numpy()
        own["note"], own["time"] = follower.notes[-1].encode(), follower.scene.time
        own["seen"], own["off"] = follower.seen[-1], follower.off[-1]
    return record


def put_back(followers: Sequence[Follower], records: np.ndarray, first: bool = False) -> None:
    """Adds frames to those that the tubes have been through, and sets them to where the last one ended.

    Args:
        followers: the tubes.
        records: of the frames, see `taken`.
        first: the records begin with the first frame, and all that was after it is forgotten.
    """
    for follower in followers if first else ():
        for each in (follower.states, follower.notes, follower.seen, follower.off):
            each.clear()
    for record in records:
        for k, follower in enumerate(followers):
            own = record[f"{k}"]
            follower.states.append((own["tube"].copy(), own["spine"].copy()))
            follower.notes.append(own["note"].decode(errors="ignore"))
            follower.seen.append(float(own["seen"]))
            follower.off.append(float(own["off"]))
    if len(records):
        for k, follower in enumerate(followers):
            own, scene = records[-1][f"{k}"], follower.scene
            scene.rewind(follower.states[-1])
            scene.state.velocity.assign(own["velocity"])
            scene.state.spine_velocity.assign(own["spine_velocity"])
            scene.resting = not (own["velocity"].any() or own["spine_velocity"].any())
            scene.time = float(own["time"])


def _record(followers: Sequence[Follower]) -> np.dtype:
    def own(follower: Follower) -> np.dtype:
        n, r = follower.scene.model.nodes, follower.scene.model.rings
        nodes = [("tube", "<f4", (n, 3)), ("spine", "<f4", (r, 3))]
        nodes += [("velocity", "<f4", (n, 3)), ("spine_velocity", "<f4", (r, 3))]
        return np.dtype([*nodes, ("note", f"S{WORDS}"), ("time", "<f8"), ("seen", "<f8"), ("off", "<f8")])

    return np.dtype([(f"{k}", own(follower)) for k, follower in enumerate(followers)])
