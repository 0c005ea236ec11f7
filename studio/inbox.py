"""Calls from any thread that one thread answers, in the order in which they came."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any


class Inbox:
    """What is to be done between two rounds of a thread."""

    def __init__(self) -> None:
        self._calls: list[tuple[Callable[[], Any], Future]] = []
        self._wake = threading.Condition()
        self._closed = False

    def call(self, what: Callable[[], Any]) -> Future:
        """Has something done.

        Raises:
            RuntimeError: the thread is at its end.
        """
        answer: Future = Future()
        with self._wake:
            if self._closed:
                raise RuntimeError("the engine is closed")
            self._calls.append((what, answer))
            self._wake.notify()
        return answer

    def close(self) -> None:
        """Ends the thread."""
        with self._wake:
            self._closed = True
            self._wake.notify()

    def take(self, idle: bool) -> list[tuple[Callable[[], Any], Future]] | None:
        """What has come; waits for it where the thread is idle. None at the end."""
        with self._wake:
            if idle and not self._calls and not self._closed:
                self._wake.wait()
            calls, self._calls = self._calls, []
            if not self._closed:
                return calls
        for _, answer in calls:
            answer.cancel()
        return None

    def pause(self, seconds: float) -> None:
        """Waits, unless something has come."""
        with self._wake:
            if not self._calls and not self._closed:
                self._wake.wait(seconds)


def answered(calls: list[tuple[Callable[[], Any], Future]], then: Callable[[], None]) -> None:
    """Does what is asked, then something more, and only then gives the answers."""
    outcomes: list[tuple[Future, Any, Exception | None]] = []
    for what, answer in calls:
        try:
            outcomes.append((answer, what(), None))
        except Exception as problem:
            outcomes.append((answer, None, problem))
    if calls:
        then()
    for answer, value, problem in outcomes:
        if problem is None:
            answer.set_result(value)
        else:
            answer.set_exception(problem)
