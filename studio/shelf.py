"""The frames that a film has been through, kept beside the autosave: a studio that is opened again goes on from there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np

from symseek import __version__

HEAD = 32
"""Bytes that say of what the frames are."""


class Shelf:
    """A file of one record a frame, see `sim.kept.taken`; one that cannot be written is done without.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path):
        self.path = path
        self._kept: tuple[bytes, list[np.ndarray]] | None = None
        """what the file holds."""

    def keep(self, state: str, records: Sequence[np.ndarray]) -> None:
        """Makes the file hold these.

        Args:
            state: text of the session's state that they are of.
            records: of each frame.
        """
        head = _head(state)
        known = 0
        if self._kept is not None and self._kept[0] == head:
            held = self._kept[1]
            same = len(held) <= len(records) and all(a is b for a, b in zip(held, records, strict=False))
            known = len(held) if same else 0
        try:
            if known:
                with self.path.open("ab") as file:
                    file.writelines(record.tobytes() for record in records[known:])
            else:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                handle, half = tempfile.mkstemp(prefix=".symseek-", dir=self.path.parent)
                with os.fdopen(handle, "wb") as file:
                    file.writelines([head, *(record.tobytes() for record in records)])
                os.replace(half, self.path)
            self._kept = head, list(records)
        except OSError:
            self._kept = None

    def has(self, state: str) -> bool:
        """Whether there are frames of that state."""
        try:
            with self.path.open("rb") as file:
                return file.read(HEAD) == _head(state) and bool(file.read(1))
        except OSError:
            return False

    def records(self, state: str, kind: np.dtype) -> list[np.ndarray]:
        """Those that are there, whole ones, each of shape (1,); none of another state."""
        if not self.has(state):
            return []
        data = self.path.read_bytes()[HEAD:]
        return list(np.frombuffer(data[: len(data) // kind.itemsize * kind.itemsize], kind)[:, None])

    def clear(self) -> None:
        """Forgets them."""
        self._kept = None
        self.path.unlink(missing_ok=True)


def _head(state: str) -> bytes:
    return sha256(f"{__version__} {state}".encode()).digest()
