"""What a run yields, and whether it is to be trusted."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .assembly import Assembly
from .fields import Cut
from .measure import contour_support, map_agreement, shape_measures, share_of, support_measures
from .potential import Potential, PotentialPicture
from .problem import Settings, View
from .surface import occluding_contour, refine

LEAST_SUPPORT = 0.6
"""Share of the contour that image data must support."""
LEAST_AGREEMENT, LEAST_CERTAINTY = 0.98, 0.85
"""Of the tube with the foreground map, and of the map itself; see `map_agreement`."""
MOST_OUTSIDE, MOST_CUT = 0.02, 0.5
"""Share of the contour that may lie beyond the image; and where it is an end that does."""
PARTIAL = "the object leaves the image: what lies beyond the border is a guess, and with it length, volume and area"
"""Said of such an object, which may be trusted as far as it is seen."""
MOST_HIDDEN = 0.5
"""Share of the contour that may be hidden."""
UNREST = 0.015
"""How far nodes may still move (root mean square) in the last tenth of a run that did not converge, in greatest radii."""
FOLDED = 0.25
"""Relative difference of the mesh's volume from that of its rings, beyond which the tube must have folded."""


@dataclass(frozen=True)
class Seen:
    """An object's occluding contour in one view."""

    contour: list[np.ndarray]
    """its pieces, shape (n, 2) each, image px."""
    support: list[np.ndarray]
    """for each piece, which points image data supports, shape (n,), bool."""
    hidden: list[np.ndarray]
    """for each piece, which points another object hides, shape (n,), bool."""


@dataclass
class ObjectResult:
    """One reconstructed object, in world units."""

    name: str
    tube: np.ndarray
    """shape (F, N_x, N_s, 3)."""
    spine: np.ndarray
    """shape (F, N_s, 3)."""
    velocity: np.ndarray
    """shape (F, N_x, N_s, 3), over the last step with mass [world units per unit of time]; 0 without."""
    vertices: np.ndarray
    """of the smooth watertight surface, shape (V, 3)."""
    faces: np.ndarray
    """shape (F, 3), outward."""
    seen: list[Seen]
    """its contour in each view."""
    measures: dict[str, Any]
    history: list[tuple[np.ndarray, np.ndarray, float, list[Cut]]]
    """tube (N_x, N_s, 3), spine (N_s, 3), sigma [px] and the tube's discontinuities, from the first tube to the last."""
    cuts: list[Cut] = field(default_factory=list)
    """the tube's discontinuities at the end, see `fields.cuts`."""
    iterations: int = 0
    converged: bool = True
    trusted: bool = True
    warnings: list[str] = field(default_factory=list)
    time: np.ndarray = field(default_factory=lambda: np.zeros(1))
    """of each frame, shape (F,) [s], or frames where the rate is not known."""
    notes: list[str] = field(default_factory=list)
    """for each frame of a moving scene nothing, or why it is not to be trusted."""

    @property
    def contour(self) -> list[np.ndarray]:
        """`Seen.contour` of the first view."""
        return self.seen[0].contour

    @property
    def support(self) -> list[np.ndarray]:
        """`Seen.support` of the first view."""
        return self.seen[0].support

    @property
    def hidden(self) -> list[np.ndarray]:
        """`Seen.hidden` of the first view."""
        return self.seen[0].hidden


@dataclass
class Result:
    """What a run yields."""

    objects: list[ObjectResult]
    potentials: list[PotentialPicture]
    foreground: np.ndarray | None
    """shape (H, W), first object's map in the first view's image, in [0, 1]."""
    seconds: dict[str, float]
    settings: Settings
    views: list[View] = field(default_factory=list)
    """of a moving scene, with the images of its last frame."""


def finish(
    scene: Assembly,
    k: int,
    potentials: list[Potential],
    history: list,
    iterations: int,
    converged: bool,
    diverged: bool,
) -> ObjectResult:
    """Measures object k as it is now, and says what speaks against it.

    Args:
        scene: with the final state.
        k: which object.
        potentials: its finest ones, one for each view.
        history: snapshots, see `ObjectResult`.
        iterations: done.
        converged: at rest at the finest scale.
        diverged: the solver had to go back to the last good state.
    """
    nodes, spine = scene.world(k)
    cuts = list(scene.weights.cuts[k])
    vertices, faces = refine(nodes, cuts=cuts)
    measures: dict[str, Any] = shape_measures(nodes, spine, cuts, scene.weights.spine_cuts[k])
    seen, supports, hidden, own, ends, left = [], [], [], {}, np.zeros(2, bool), []
    for v, (view, potential) in enumerate(zip(scene.views, potentials, strict=True)):
        pieces, size = occluding_contour(nodes, view.camera, cuts), view.image.shape[:2]
        space, map_, hider = scene.spaces[k][v], scene.maps[k][v], scene.hidden[k][v]
        inside = space.inside if scene.settings.potential == "map" else np.zeros((0, 0))
        support = [contour_support(p, n, potential, inside, map_.half_width) for p, n in pieces]
        on = [_in_image(p, size) for p, _ in pieces]
        hides = [np.zeros(len(p), bool) if hider is None else hider.near(p, potential.sigma) for p, _ in pieces]
        within = [s.only(i) for s, i in zip(support, on, strict=True)]
        unseen = [h[i] for h, i in zip(hides, on, strict=True)]
        own[view.name] = support_measures(within, unseen)
        if scene.settings.potential == "map":
            agreement = map_agreement(nodes, view.camera, map_, cuts, hider, scene.others[k][v])
            own[view.name] |= dict(zip(("map_agreement", "map_certainty"), agreement, strict=True))
        seen.append(Seen([p for p, _ in pieces], [s.supported for s in support], hides))
        supports, hidden = supports + within, hidden + unseen
        length = np.concatenate([*(s.length for s in support), np.zeros(0)])
        outside = 1 - share_of(np.concatenate([*on, np.zeros(0, bool)]), length)
        held = _in_image(view.camera.project(spine[[0, -1]]), size)
        cut = MOST_OUTSIDE < outside < MOST_CUT and not held.all()
        left.append((outside, cut))
        ends |= held
    measures |= support_measures(supports, hidden)
    if scene.settings.potential == "map":  # as good as the worst view's
        measures |= {name: min(m[name] for m in own.values()) for name in ("map_agreement", "map_certainty")}
    if len(own) > 1:
        measures["views"] = own
    measures["partial"] = any(cut for _, cut in left) and not bool(ends.all())
    before = history[-1 - max(1, len(history) // 10)][0]
    moved = float(np.sqrt(((nodes - before) ** 2).sum(axis=2).mean()))
    unrest = not converged and moved > UNREST * max(measures["radius"])
    doubts = _doubts(measures, any(o > MOST_OUTSIDE and not cut for o, cut in left), iterations, unrest, diverged)
    return ObjectResult(
        name=scene.tubes[k].name,
        tube=nodes[None],
        spine=spine[None],
        velocity=scene.velocity(k)[None],
        vertices=vertices,
        faces=faces,
        seen=seen,
        measures=measures,
        history=history,
        cuts=cuts,
        iterations=iterations,
        converged=converged,
        trusted=not doubts,
        warnings=[*doubts, *[PARTIAL] * measures["partial"]],
    )


def _in_image(points: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Which image points, shape (n, 2), lie on a pixel of an image of `size` (height, width)."""
    h, w = size
    return np.all((points >= -0.5) & (points <= [w - 0.5, h - 0.5]), axis=1)


def _doubts(
    measures: dict[str, Any],
    left: bool,
    iterations: int,
    unrest: bool,
    diverged: bool,
) -> list[str]:
    doubts = []
    if diverged:
        doubts.append("the solver diverged and stopped at its last good state: try a lower solver.step or another axis")
    elif unrest:
        doubts.append(f"not at rest after {iterations} iterations: raise solver.iterations")
    share = measures["supported_share"]
    if share < LEAST_SUPPORT:
        doubts.append(
            f"only {share:.0%} of the contour lies on edges of the image: check the overlay, draw the axis nearer to the"
            " object's middle, or mark with not_here or ignore what it must not take"
        )
    if measures["hidden_share"] > MOST_HIDDEN:
        doubts.append(f"{measures['hidden_share']:.0%} of the contour is hidden: most of the shape is a guess")
    if measures.get("map_agreement", 1.0) < LEAST_AGREEMENT:
        doubts.append(
            "the tube departs from the foreground map: check both, and draw the axis nearer to the object's middle"
        )
    if measures.get("map_certainty", 1.0) < LEAST_CERTAINTY:
        doubts.append(
            "the object's colours and edges part it poorly from what is around it: check the foreground map, or mark with"
            " not_here or ignore what it must not take"
        )
    if left:
        doubts.append("the tube has left the image: what lies beyond the border is a guess")
    station, radius = np.array(measures["station"]), np.array(measures["radius"])
    rings = np.pi * np.trapezoid(radius**2, station)
    if abs(measures["volume"] - rings) > FOLDED * rings:
        doubts.append("the tube has folded: its surface and its rings enclose different volumes")
    return doubts
