"""How much the engine does between two looks at the page's wishes, and how often it shows where the models are."""

from __future__ import annotations

import os
import sys
import threading
import time

ROUND = 0.02
"""Seconds between two looks at what the page wants."""
FIRST = 0.006
"""Seconds until the first one after nothing moved: what the mouse does is to be seen at once."""
PUBLISH = 1 / 40
"""Seconds between two snapshots, at the least; and at most a quarter of the time goes into making them."""

NICE = 5
"""Of the solver's threads, beside those that draw, and the browser's."""


def yields() -> None:
    """Lets this thread take what time is left; where threads have no priorities of their own, nothing."""
    if sys.platform == "linux":
        thread = threading.get_native_id()
        own = os.getpriority(os.PRIO_PROCESS, thread)
        os.setpriority(os.PRIO_PROCESS, thread, max(NICE, own))  # not everyone may go back


class Pace:
    """Times of one thread."""

    def __init__(self) -> None:
        self._iteration = 1e-3
        """seconds that one of all models takes."""
        self._published, self._publishing = 0.0, 0.0

    def iterations(self, seconds: float) -> int:
        """How many fit, one at the least."""
        return max(1, int(seconds / self._iteration))

    def took(self, seconds: float, iterations: int) -> None:
        """Learns from those that were made."""
        one = seconds / iterations
        # making the maps of a new scale is not what an iteration takes
        self._iteration += 0.3 * (one - self._iteration) if one < 4 * self._iteration else self._iteration

    def early(self) -> bool:
        """Whether the last snapshots are still new."""
        return time.perf_counter() - self._published < max(PUBLISH, 4 * self._publishing)

    def published(self, begun: float) -> None:
        """Snapshots were made from then until now."""
        self._published = time.perf_counter()
        self._publishing = self._published - begun
