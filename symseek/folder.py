"""The output folder: whole files or none."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .checks import SceneError

RECORD = "result.json"


@contextmanager
def staging(out: Path) -> Iterator[Path]:
    """A folder to write into, whose files move to `out` when the block ends without an exception.

    It lies inside `out`: moving is then a renaming, and a folder that cannot be written is known at once.
    Files that an earlier record there names and this run did not write are removed: no old video beside a new
    mesh.

    Raises:
        SceneError: `out` cannot be made or written.
    """
    made = [p for p in (out, *out.parents) if not p.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=".symseek-", dir=out))
    except OSError as problem:
        _unmake(made)
        raise SceneError(
            str(out),
            "",
            f"the output folder cannot be written ({problem.strerror})",
            "give another one by --out",
        ) from None
    try:
        yield stage
        _remove_old(out, stage)
        # the record goes last: where it stands, all it names stands
        for file in sorted(stage.iterdir(), key=lambda f: f.name == RECORD):
            os.replace(file, out / file.name)
    except BaseException:
        shutil.rmtree(stage, ignore_errors=True)
        _unmake(made)
        raise
    stage.rmdir()


def _remove_old(out: Path, stage: Path) -> None:
    try:
        names = json.loads((out / RECORD).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return
    for name in names:
        if isinstance(name, str) and Path(name).name == name and not (stage / name).exists():
            (out / name).unlink(missing_ok=True)


def _unmake(made: list[Path]) -> None:
    for folder in made:
        try:
            folder.rmdir()
        except OSError:  # not there, or in use by now
            return
