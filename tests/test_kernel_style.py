"""How kernels are written (style): groups of arguments in order, what may be imported, no launches."""

import ast
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "kernels"
GROUPS = ["model", "state in", "scalars", "out"]


def _is(node: ast.expr, name: str) -> bool:
    return ast.unparse(node).startswith(name)


def _argument_faults(kernel: ast.FunctionDef, lines: list[str]) -> list[str]:
    """Group comments that are missing or out of order, and names that do not say their group."""
    found, faults, group = [], [], None
    first = kernel.args.args[0].lineno if kernel.args.args else kernel.lineno
    by_line = {a.lineno: a for a in kernel.args.args}
    for number in range(kernel.lineno + 1, kernel.body[0].lineno):
        comment = re.fullmatch(r"\s*# (.*)", lines[number - 1])
        if comment:
            group = comment[1]
            found.append(group)
        elif number in by_line:
            name, kind = by_line[number].arg, ast.unparse(by_line[number].annotation or ast.Constant(None))
            suffix = {"state in": "_in", "out": "_out"}.get(group or "", "")
            if suffix and not name.endswith(suffix):
                faults.append(f"{name} of group '{group}' does not end in {suffix}")
            if not suffix and name.endswith(("_in", "_out")):
                faults.append(f"{name} ends like a state array")
            if (group == "scalars") != (kind in ("int", "float")):
                faults.append(f"{name}: {kind} in group '{group}'")
    if found != [g for g in GROUPS if g in found] or "out" not in found or not lines[first - 2].strip() == f"# {found[0]}":
        faults.append(f"groups are {found}, not {GROUPS} in this order")
    return faults


def _faults(source: str) -> list[str]:
    """Everything a kernel module does against the style."""
    tree, lines, faults = ast.parse(source), source.splitlines(), []
    if not ast.get_docstring(tree):
        faults.append("module without docstring")
    for node in ast.walk(tree):
        if isinstance(node, ast.Import) and [a.name for a in node.names] != ["warp"]:
            faults.append(f"imports {ast.unparse(node)}")
        if isinstance(node, ast.ImportFrom) and (node.level != 1 or node.module):
            faults.append(f"imports {ast.unparse(node)}")
        if isinstance(node, ast.Call) and _is(node.func, "wp.launch"):
            faults.append("launches")
        if isinstance(node, ast.FunctionDef):
            if not ast.get_docstring(node):
                faults.append(f"{node.name} without docstring")
            if any(_is(d, "wp.kernel") for d in node.decorator_list):
                if ast.unparse(node.decorator_list[0]) != "wp.kernel(enable_backward=False)":
                    faults.append(f"{node.name} compiles backward code")
                faults += [f"{node.name}: {f}" for f in _argument_faults(node, lines)]
    return faults


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda p: p.name)
def test_kernel_modules_keep_the_style(path):
    source = path.read_text()
    assert not source or not _faults(source)


GOOD = '''"""Doc."""
import warp as wp
from . import image

@wp.kernel(enable_backward=False)
def step(
    # model
    mass: wp.array[float],
    # state in
    tube_in: wp.array[wp.vec3],
    # scalars
    dt: float,
    # out
    tube_out: wp.array[wp.vec3],
):
    """Sets."""
    i = wp.tid()
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("import warp as wp", "import warp as wp\nimport numpy as np"),
        ("from . import image", "from ..sim import model"),
        ("i = wp.tid()", "wp.launch(step, 1)"),
        ("(enable_backward=False)", ""),
        ('    """Sets."""\n', ""),
        ("    # model\n", ""),
        ("# state in", "# state"),
        ("tube_in", "tube"),
        ("tube_out", "tube_new"),
        ("mass:", "mass_in:"),
        ("dt: float", "dt: wp.array[float]"),
        ("    # scalars\n    dt: float,\n    # out\n", "    # out\n    # scalars\n    dt: float,\n"),
    ],
)
def test_the_check_finds_each_fault(old, new):
    assert not _faults(GOOD)
    assert old in GOOD and _faults(GOOD.replace(old, new))
