"""Shared by all tests."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest


@pytest.fixture
def engine():
    """The studio's, as fast as it can."""
    from symseek.studio.engine import Engine

    engine = Engine()
    engine.speed = 1e6
    yield engine
    engine.close()
