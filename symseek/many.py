"""Many images by one scene file: each a reconstruction of its own, shared out over processes."""

from __future__ import annotations

import copy
import csv
import multiprocessing
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .checks import SceneError, suggest
from .pipeline import run
from .scene import build, find, read

TABLE = "batch.csv"
LEAN = ("output.video=false", "output.views=false", "output.potentials=false")
"""What is left out of a batch unless it is asked for."""
MEASURES = ("length", "radius", "volume", "area", "asymmetry", "contour_residual_px", "supported_share")


@dataclass
class Entry:
    """What became of one image."""

    image: str
    folder: str = ""
    """with its files, in the batch's."""
    objects: list[dict[str, Any]] = field(default_factory=list)
    """a row of the table each."""
    error: str = ""
    """why there are none."""

    @property
    def trusted(self) -> bool:
        """Whether all objects are there and trusted."""
        return not self.error and all(row["trusted"] for row in self.objects)


def batch(
    scene: str | Path,
    images: Sequence[str | Path],
    out: str | Path | None = None,
    device: str = "cpu",
    *,
    axes: str | Path | None = None,
    overrides: Iterable[str] = (),
    processes: int | None = None,
    callback: Callable[[Entry], None] = lambda entry: None,
) -> list[Entry]:
    """Reconstruct the objects of a scene file in each of many images, as `symseek batch` does.

    Args:
        scene: a scene file; each image in turn takes the place of its first view's.
        images: their paths.
        out: folder with one for each image, named as it is, and the table batch.csv; None: out/NAME-batch.
        device: Warp device.
        axes: CSV file with the header image,object,x,y and a line for each point of a rough axis, in order: for images
            in which objects lie elsewhere than in the scene file. Images by file name.
        overrides: KEY=VALUE texts. Video, views and potentials are left out unless asked for here.
        processes: how many at a time; None: one a core.
        callback: called with each image's entry, in the order of `images`.

    Returns:
        An entry for each image; one at fault does not stop the others.

    Raises:
        SceneError: scene file, axes or folder at fault, or images that share a name.
    """
    path = find(scene)
    text = read(path, (*LEAN, *overrides))
    given = _axes(Path(axes)) if axes is not None else {}
    name = str(text.get("name") or (path.parent.name if path.stem == "scene" else path.stem))
    out = Path("out") / f"{name}-batch" if out is None else Path(out)
    jobs, taken = [], {}
    for image in map(Path, images):
        if image.stem in taken:
            raise SceneError(str(image), "", f"has the name of {taken[image.stem]}", "rename one: results go by name")
        taken[image.stem] = image
        jobs.append((_placed(text, image, given.pop(image.name, {}), path), path, image, out / image.stem, device))
    if given:
        stray = next(iter(given))
        known = suggest(stray, [image.name for image in taken.values()])
        raise SceneError(str(axes), "image", f"{stray!r} is not among the images", f"remove its lines{known}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise SceneError(str(out), "", f"cannot be made ({problem.strerror})", "give another folder by --out") from None
    entries = []
    count = max(1, min(processes or os.cpu_count() or 1, len(jobs)))
    # fresh processes: a copy of one that has threads may hang
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
        for entry in pool.map(_one, jobs):
            entries.append(entry)
            callback(entry)
    _write_table(out / TABLE, entries, str(text.get("units", "px")))
    return entries


def _axes(path: Path) -> dict[str, dict[str, list[list[float]]]]:
    """Rough axes by image and object."""
    axes: dict[str, dict[str, list[list[float]]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = csv.DictReader(file)
            if set(lines.fieldnames or ()) < {"image", "object", "x", "y"}:
                raise SceneError(str(path), "line 1", "the header is not image,object,x,y", "write it as the first line")
            for number, line in enumerate(lines, start=2):
                try:
                    point = [float(line["x"]), float(line["y"])]
                except (TypeError, ValueError):
                    shown = f"{line['x']!r}, {line['y']!r}"
                    raise SceneError(str(path), f"line {number}", f"{shown} is not a point", "give two numbers") from None
                axes.setdefault(line["image"], {}).setdefault(line["object"], []).append(point)
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise SceneError(str(path), "", f"cannot be read ({problem})", "give a CSV file") from None
    return axes


def _placed(text: Mapping[str, Any], image: Path, axes: dict[str, list], source: Path) -> dict[str, Any]:
    """The tables of a scene with another image and other axes."""
    data = copy.deepcopy(dict(text))
    views, objects = data.get("view"), data.get("object")
    if not isinstance(views, list) or not views or not isinstance(objects, list):
        raise SceneError(str(source), "view", "is missing", 'add a [[view]] with image = "photo.jpg" and an [[object]]')
    views[0]["image"] = str(image.absolute())
    names = [str(o.get("name", data.get("name", source.stem))) for o in objects]
    for name, points in axes.items():
        if name not in names:
            raise SceneError(str(source), "object", f"none is called {name!r}, which the axes of {image.name} name")
        objects[names.index(name)]["spine"] = points
    return data


def _one(job: tuple[dict[str, Any], Path, Path, Path, str]) -> Entry:
    """One image, in a process of its own."""
    data, source, image, folder, device = job
    entry = Entry(str(image))
    try:
        result = run(build(data, source.parent, str(image), image.stem), folder, device, threads=1)
    except SceneError as problem:
        entry.error = str(problem)
    except (OSError, MemoryError, RuntimeError) as problem:
        entry.error = f"{image}: {type(problem).__name__}: {problem}"
    else:
        entry.folder = folder.name
        for o in [*result.objects, *result.lines]:
            row = {key: _single(o.measures[key]) for key in MEASURES if key in o.measures}
            state = {"iterations": o.iterations, "converged": o.converged, "trusted": o.trusted}
            entry.objects.append({"object": o.name, **row, **state, "warnings": "; ".join(o.warnings)})
    return entry


def _single(value: Any) -> float:
    """A measure as one number: the mean of a residual, the largest of a profile."""
    return value["mean"] if isinstance(value, dict) else max(value) if isinstance(value, list) else value


def _write_table(path: Path, entries: list[Entry], unit: str) -> None:
    """A line for each object, or for an image without any; units in the header."""
    units = {"length": unit, "radius": unit, "area": f"{unit}2", "volume": f"{unit}3"}
    named = {key: f"{key}_{units[key]}" if key in units else key for key in MEASURES}
    header = ["image", "object", *named.values(), "iterations", "converged", "trusted", "warnings", "error"]
    part = path.with_suffix(".part")
    with part.open("w", newline="", encoding="utf-8") as file:
        lines = csv.DictWriter(file, header, restval="")
        lines.writeheader()
        for entry in entries:
            for row in entry.objects or [{}]:
                row = {named.get(key, key): value for key, value in row.items()}
                lines.writerow({"image": entry.image, **row, "error": entry.error})
    part.replace(path)
