"""The wheel holds everything and runs without the repository; versions agree."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import symseek

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ["kernels", "sim", "render", "scenes", "studio"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The unpacked wheel, built from a copy so that no build folder is left in the repository."""
    path = tmp_path_factory.mktemp("wheel")
    unwanted = shutil.ignore_patterns(".*", "build", "dist", "out", "*.egg-info")
    shutil.copytree(ROOT, path / "copy", symlinks=True, ignore=unwanted)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
    ]
    subprocess.run([*command, "--wheel-dir", path, path / "copy"], check=True, capture_output=True)
    (file,) = path.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(path / "unpacked")
    return path / "unpacked"


def test_wheel_holds_every_module_and_scene(wheel):
    found = {str(f.relative_to(wheel)) for f in wheel.rglob("*") if f.is_file()}
    wanted = {f"symseek/{f.name}" for f in (ROOT / "symseek").iterdir() if f.is_file()}
    for folder in FOLDERS:
        files = [f for f in (ROOT / folder).rglob("*") if f.is_file() and "__pycache__" not in f.parts]
        wanted |= {f"symseek/{f.relative_to(ROOT)}" for f in files}
    assert len(wanted) > 40 and wanted <= found, wanted - found
    others = {name for name in found - wanted if ".dist-info/" not in name}
    assert not others, "only the package, not tests or benchmarks"
    assert any(name.endswith("licenses/LICENSE") for name in found)
    (entry,) = [f for f in wheel.rglob("entry_points.txt")]
    assert "symseek = symseek.cli:main" in entry.read_text()


def test_wheel_runs_away_from_the_repository(wheel, tmp_path):
    code = (
        "import symseek, symseek.pipeline, symseek.files, symseek.cli as cli\n"
        "print(symseek.__file__)\n"
        "print(len([symseek.load(p) for p in cli.demos().values()]))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(wheel)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    where, scenes = done.stdout.split("\n")[:2]
    assert Path(where).is_relative_to(wheel) and int(scenes) >= 2


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == symseek.__version__
    assert re.search(rf"^version: {symseek.__version__}$", (ROOT / "CITATION.cff").read_text(), re.M)
    assert f"## {symseek.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_every_package_folder_is_packed():
    packed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    there = {"symseek"}
    for folder in FOLDERS:
        inits = (ROOT / folder).rglob("__init__.py")
        there |= {"symseek." + ".".join(f.parent.relative_to(ROOT).parts) for f in inits}
    assert packed == there


def test_doctor_knows_every_dependency():
    from symseek.doctor import PACKAGES

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {re.split(r"[<>=]", d)[0] for d in project["dependencies"]} == set(PACKAGES)


def test_the_packages_know_only_those_below_them():
    """design.md: kernels imports only kernels, sim never render, render neither."""
    forbidden = {
        "kernels": ["sim", "render", "scenes"],
        "sim": ["render", "scenes"],
        "render": ["kernels", "sim", "scenes"],
    }
    for folder, others in forbidden.items():
        for file in (ROOT / folder).rglob("*.py"):
            bad = [o for o in others if re.search(rf"^\s*from \.+{o}\b|symseek\.{o}\b", file.read_text(), re.M)]
            assert not bad, f"{file} imports {bad}"


def test_no_file_has_grown_past_400_lines():
    files = [f for folder in [*FOLDERS, "symseek", "tests", "benchmarks"] for f in (ROOT / folder).rglob("*.py")]
    assert len(files) > 40
    long = {str(f.relative_to(ROOT)): n for f in files if (n := len(f.read_text().splitlines())) > 400}
    assert not long
