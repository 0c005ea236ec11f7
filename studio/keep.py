"""What the studio reads and writes: scene files, images and autosaves, all under the folder that it was started in."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from symseek.cameras import read_cameras
from symseek.checks import SceneError, Table
from symseek.scene import TOP_KEYS, Scene, find, load, read

from .session import Session
from .shelf import Shelf
from .state import PALETTE, Item, State

IMAGES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".npy"}
SCENE_MOST = 10_000_000
"""Bytes of a scene file."""
LISTED = 500
"""Files that the picker shows."""
AUTOSAVE = ".symseek-studio"
PAIR = " + "
"""Between the left and the right image of a stereo pair."""
ALPHA = 0.2
"""Of the paper's (15), for a pair that says nothing of it: depths are then right up to a factor."""


class Folder:
    """The folder that the studio was started in; nothing outside is read or written.

    Args:
        root: the folder.
    """

    def __init__(self, root: Path):
        self.root = root.resolve()
        self._ours: set[Path] = set()

    def inside(self, path: str | Path) -> Path:
        """The path with its links followed.

        Raises:
            SceneError: it leads out of the folder.
        """
        full = (self.root / path).resolve()
        if not full.is_relative_to(self.root):
            raise SceneError(str(path), "", f"lies outside {self.root}", "start the studio in the folder that holds it")
        return full

    def listing(self) -> list[str]:
        """Images and scene files in the folder and below, without hidden folders; relative to it."""
        found: list[str] = []
        for folder, below, files in os.walk(self.root):
            below[:] = sorted(name for name in below if not name.startswith("."))
            for name in sorted(files):
                path = Path(folder, name)
                if path.suffix.lower() in IMAGES or (path.suffix == ".toml" and _is_scene(path)):
                    found.append(str(path.relative_to(self.root)))
                if len(found) == LISTED:
                    return found
        return found

    def open(self, path: str) -> tuple[Session, bool]:
        """A session on an image or a scene file; whether it was brought back from an autosave.

        Raises:
            SceneError: the file is at fault, or lies outside the folder.
        """
        state, base, scene = self._read(path)
        session = Session(state, base, Path(path).name, scene)
        kept = self._autosave(path)
        if not kept.is_file():
            return session, False
        try:
            before = State.of(kept.read_text(encoding="utf-8"))
            if before.pictures != state.pictures or before == state:
                return session, False
            restored = Session(before, base, Path(path).name, scene)
        except (KeyError, ValueError):  # from another version, or the scene is another by now
            return session, False
        return restored, True

    def first(self, path: str) -> State:
        """What the file itself holds."""
        return self._read(path)[0]

    def _read(self, path: str) -> tuple[State, Path, Scene | None]:
        """State, folder of its images, and the scene if it was read for that."""
        if path.startswith("skimage:"):
            return State({"view": [{"image": path}], "name": path.removeprefix("skimage:")}), self.root, None
        if PAIR in path and not (self.root / path).exists():
            return self._pair(*path.split(PAIR, 1))
        full = find(self.inside(path))
        if full.suffix == ".toml":
            state, scene = self._scene(full)
            return state, full.parent, scene
        return State({"name": _named(full), "view": [{"image": full.name}]}), full.parent, None

    def _pair(self, left: str, right: str) -> tuple[State, Path, None]:
        """Two photographs by two eyes side by side that look the same way."""
        full = self.inside(left)
        images = [full.name, os.path.relpath(self.inside(right), full.parent)]
        views = [
            {"name": name, "image": image, "projection": "stereo", "alpha": alpha}
            for name, image, alpha in zip(("left", "right"), images, (ALPHA, -ALPHA), strict=True)
        ]
        return State({"name": _named(full), "view": views}), full.parent, None

    def _scene(self, full: Path) -> tuple[State, Scene]:
        if full.is_file() and full.stat().st_size > SCENE_MOST:
            raise SceneError(full.name, "", f"has {full.stat().st_size / 1e6:.0f} MB", "a scene file is a few kB of text")
        text = read(full)
        self._all_inside(text, full)
        scene = load(full)
        listed = {"object"} if "view" in text else {"object", "view"}  # a cameras' file lists views by its own paths
        top = {"name": scene.name, **{k: v for k, v in scene.text.items() if k not in listed}}
        tables = [{"name": scene.name, **table} for table in scene.text["object"]]
        items = [Item(k + 1, table, PALETTE[k % len(PALETTE)]) for k, table in enumerate(tables)]
        return State.of(State(top, tuple(items)).text()), scene

    def _all_inside(self, text: Mapping[str, Any], full: Path) -> None:
        """Refuses a scene that reads anything outside."""
        views, paths = text.get("view", []), [text.get("cameras"), text.get("images")]
        for view in views if isinstance(views, list) else []:
            for key in ("image", "ignore", "frames"):
                value = view.get(key, "") if isinstance(view, Mapping) else ""
                paths += value if isinstance(value, list) else [value]
        for name in paths:
            if isinstance(name, str) and not name.startswith("skimage:"):
                self.inside(full.parent / os.path.expandvars(os.path.expanduser(name)))
        if "cameras" in text:
            for shot in read_cameras(Table(text, str(full), "", TOP_KEYS), full.parent).values():
                self.inside(shot.path)

    def autosave(self, path: str, session: Session) -> None:
        """Keeps the state of what was opened as `path`."""
        write_whole(self._autosave(path), session.state.text())

    def _autosave(self, path: str, kind: str = "json") -> Path:
        return self.inside(Path(AUTOSAVE) / (path.replace(os.sep, "__").replace("/", "__").replace(":", "_") + f".{kind}"))

    def shelf(self, path: str) -> Shelf:
        """Where the frames of a moving scene are kept that was opened as `path`."""
        return Shelf(self._autosave(path, "frames"))

    def save(self, session: Session, name: str) -> Path:
        """Writes the scene file NAME.toml beside the image.

        Raises:
            SceneError: it is not finished, the name is no file's, or a file of that name was there before.
        """
        tables = {**session.tables(), "name": name}
        session.scenery.build(tables)  # checks the name
        return self.write(session, f"{name}.toml", toml(tables))

    def write(self, session: Session, name: str, text: str) -> Path:
        """Writes a file beside the image.

        Raises:
            SceneError: a file of that name was there before, or it would lie outside.
        """
        full = self.inside(session.base / name)
        if full.exists() and full not in self._ours:
            raise SceneError(full.name, "", "is there already", "choose another name")
        write_whole(full, text)
        self._ours.add(full)
        return full


def _named(path: Path) -> str:
    """A name for what an image shows: without letters that a file's name could not have."""
    return "".join(c if c.isalnum() or c in " ._-" else "-" for c in path.stem).strip(" .")[:60] or "object"


def _is_scene(path: Path) -> bool:
    """Whether a TOML file speaks of views, which a project's own files do not."""
    try:
        with path.open("rb") as file:
            return path.stat().st_size < SCENE_MOST and b"[[view]]" in file.read(100_000)
    except OSError:
        return False


def write_whole(path: Path, text: str) -> None:
    """Writes a file, the whole of it or nothing.

    Raises:
        SceneError: the folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, half = tempfile.mkstemp(prefix=".symseek-", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(half, 0o644)
        os.replace(half, path)
    except OSError as problem:
        raise SceneError(path.name, "", f"cannot be written ({problem.strerror})", "make room, or allow it") from None


def toml(tables: Mapping[str, Any]) -> str:
    """A scene's tables as the text of its file: numbers as they are, tables within tables in one line."""
    heads = [(k, v) for k, v in tables.items() if not isinstance(v, Mapping) and not _is_tables(v)]
    lines = [f"{_key(k)} = {_value(v)}" for k, v in heads]
    for key, value in tables.items():
        for table in [value] if isinstance(value, Mapping) else value if _is_tables(value) else []:
            lines += ["", f"[{_key(key)}]" if isinstance(value, Mapping) else f"[[{_key(key)}]]"]
            lines += [f"{_key(k)} = {_value(v, True)}" for k, v in table.items() if v is not None]
    return "\n".join(lines) + "\n"


def _is_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(v, Mapping) for v in value)


def _key(key: str) -> str:
    return key if key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key) else _value(key)


def _value(value: Any, lines: bool = False) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, list | tuple):
        parts = [_value(v) for v in value]
        return "[\n    " + ",\n    ".join(parts) + ",\n]" if lines and _is_tables(value) else "[" + ", ".join(parts) + "]"
    return repr(value)
