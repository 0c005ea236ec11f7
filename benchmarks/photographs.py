"""Real photographs against outlines traced by hand, with the axes as drawn and with clicks that miss.

`SYMSEEK_DATA=FOLDER python -m benchmarks.photographs [--quick] [--out FILE.md]` prints for each photograph that the folder's
`photo_axes.json` lists: IoU of the silhouettes, whether the result is trusted, and in how many of `JITTERS` runs with
`JITTER` px of error in the clicks the IoU is above `GOOD`. Hand outlines, good to about 1.5 px, cap it near .96.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import symseek
from symseek.cli import demos
from symseek.scene import build

from .tables import as_text, command

DATA = Path(os.environ.get("SYMSEEK_DATA", ""))
AXES = DATA / "photo_axes.json"
SCENES = Path(__file__).parents[1] / "tests" / "real"
GOOD = 0.93
"""IoU from which a silhouette is right."""
JITTER, JITTERS = 4.0, 5


def here() -> bool:
    """Whether SYMSEEK_DATA names the folder with the photographs."""
    return bool(os.environ.get("SYMSEEK_DATA")) and AXES.is_file()


def names() -> list[str]:
    """Of the photographs that have an axis and an outline."""
    return [name for name, entry in json.loads(AXES.read_text()).items() if isinstance(entry, dict)]


def scene_and_outline(name: str) -> tuple[symseek.Scene, np.ndarray]:
    """The scene, and the true silhouette as a mask of its image, shape (H, W), bool.

    Scene files for photographs lie in `SCENES` and in the package; cut-outs are laid on a plain ground.
    """
    entry = json.loads(AXES.read_text())[name]
    if entry["outline"] is None:
        return _cut_out(name, entry)
    scene = symseek.load(demos().get(name, SCENES / f"{name}.toml"))
    np.testing.assert_allclose(scene.tubes[0].spine, entry["axis"])
    return scene, filled([np.array(entry["outline"])], scene.views[0].image.shape[:2])


def _cut_out(name: str, entry: dict) -> tuple[symseek.Scene, np.ndarray]:
    layers = np.asarray(Image.open(DATA / entry["image"]).convert("RGBA"), np.float32) / 255
    margin = entry["margin"]
    padded = np.pad(layers, ((margin, margin), (margin, margin), (0, 0)))
    alpha = padded[..., 3:]
    image = padded[..., :3] * alpha + np.array(entry["background"], np.float32) / 255 * (1 - alpha)
    data = {"name": name, "view": [{"image": image}], "object": [{"spine": np.array(entry["axis"])}]}
    return build(data, Path(), name), alpha[..., 0] > 0.5


def filled(outlines: list[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Mask, shape (H, W), of the pixels within closed outlines, shape (n, 2) each (column, row)."""
    fine = 4  # subpixels along a side; pixel p covers p - 1/2 to p + 1/2
    mask = Image.new("1", (shape[1] * fine, shape[0] * fine))
    for outline in outlines:
        ImageDraw.Draw(mask).polygon([tuple(p) for p in (outline + 0.5) * fine - 0.5], fill=1)
    return np.asarray(mask).reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3)) > 0.5


def silhouette(result: symseek.Result, k: int = 0) -> np.ndarray:
    """Mask of the image, shape (H, W), that the projected triangles of object k cover."""
    view, o = result.scene.views[0], result.objects[k]
    corners = view.camera.project(o.vertices)[o.faces]
    return filled(list(corners), view.image.shape[:2])


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum() / (a | b).sum())


def attempt(scene: symseek.Scene, truth: np.ndarray) -> tuple[float, bool]:
    """IoU and the result's own mark."""
    result = symseek.reconstruct(scene)
    return overlap(silhouette(result), truth), result.objects[0].trusted


def missed(scene: symseek.Scene, seed: int) -> symseek.Scene:
    """The scene with `JITTER` pixels of error (one sigma) in its clicks."""
    tube = scene.tubes[0]
    spine = tube.spine + np.random.default_rng(seed).normal(scale=JITTER, size=tube.spine.shape)
    return replace(scene, tubes=[replace(tube, spine=spine)])


def measure(quick: bool) -> list[list[str]]:
    """A line for each photograph and one for all, head first."""
    jitters = 1 if quick else JITTERS
    table = [["photograph", "IoU", "trusted", f"good of {jitters} with misses", "trusted wrongly", "needless alarms"]]
    totals = np.zeros(4, int)
    for name in names():
        scene, truth = scene_and_outline(name)
        iou, trusted = attempt(scene, truth)
        tries = [attempt(missed(scene, seed), truth) for seed in range(jitters)]
        good = sum(i > GOOD for i, _ in tries)
        wrong = sum(t and i <= GOOD for i, t in [(iou, trusted), *tries])
        needless = sum(not t and i > GOOD for i, t in [(iou, trusted), *tries])
        totals += [iou > GOOD, good, wrong, needless]
        table.append([name, f"{iou:.3f}", "yes" if trusted else "no", str(good), str(wrong), str(needless)])
    return [*table, [f"above {GOOD}", str(totals[0]), "", *(str(n) for n in totals[1:])]]


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        if not here():
            return lambda markdown: "skipped: SYMSEEK_DATA does not name the folder with the photographs"
        table = measure(quick)
        return lambda markdown: as_text(table, markdown)

    return command(arguments, "photographs", "Real photographs.", "one run with misses", run)


if __name__ == "__main__":
    sys.exit(main())
