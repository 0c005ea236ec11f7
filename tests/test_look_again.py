"""Scenes in which some tubes move: what hides them is found as if all were looked at."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from symseek.sim.visibility import FURTHER, WANDERED, Visibility
from tests.test_visibility import Scene, level, refresh, upright


def test_what_moved_is_seen_as_if_all_were_looked_at_anew():
    """Eight crossing bars, of which one or two move at a time; masks by pixels and the places where outlines meet."""
    rng = np.random.default_rng(8)
    scenes: list[Any] = [upright(40 + 35 * i, 2.0 * i) for i in range(4)] + [
        level(45 + 35 * i, 1.0 + 2 * i) for i in range(4)
    ]
    some, at = Visibility(None), np.stack(np.meshgrid(np.arange(200), np.arange(200)), axis=-1)
    refresh(some, scenes)
    for _ in range(6):
        for k in rng.choice(8, rng.integers(1, 3), replace=False):
            scenes[k].nodes = scenes[k].nodes + rng.uniform(-9, 9, 3) * [1, 1, 0.4]
        refresh(some, scenes)
        fresh: list[Any] = [Scene(scene.nodes) for scene in scenes]
        refresh(Visibility(None), fresh)
        for scene, other in zip(scenes, fresh, strict=True):
            masks = [np.zeros((200, 200), bool) if s.hidden[0][0] is None else s.hidden[0][0].at(at) for s in (scene, other)]
            np.testing.assert_array_equal(masks[0], masks[1])
            if len(other.meetings[0][0]):
                assert KDTree(scene.meetings[0][0]).query(other.meetings[0][0])[0].max() <= WANDERED * FURTHER**6
