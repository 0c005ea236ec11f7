"""The studio in headless Chromium with software WebGL: updates of the page a second, time from mouse to answer.

`python -m benchmarks.studio [--quick] [--out FILE.md]`. An update is a frame for which new geometry went to the graphics
card, counted in the page; the answer to the mouse is the first one after a movement while a model at rest is held.
Wall-clock times, best of five: they are worth as much as the machine was quiet.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from symseek import cli
from symseek.studio.session import Session
from tests.browser import Hand, chromium, opened

from .tables import Headed, command, headed, machine

MODELS = (1, 14, 43)
RUNS, SECONDS, MOVES = 5, 5.0, 15
SPINE = np.array([[160, 143], [174, 233], [260, 278], [361, 311], [454, 342]])
TILE = np.array([200, 150])
"""Size of one squash among many [px]."""
COUNT = """
window.uploads = []; window.frames = []; window.moved = 0; window.answer = 0; window.last = 0;
let fresh = false;
const now = () => performance.timeOrigin + performance.now();
for (const [name, at] of [["bufferData", 1], ["bufferSubData", 2]]) {
  const before = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    if (given[at] && given[at].byteLength > 2000) {
      window.last = performance.now();
      if (!fresh) { fresh = true; window.uploads.push(now()); }
      if (window.moved && !window.answer) window.answer = performance.now() - window.moved;
    }
    return before.apply(this, given);
  };
}
const tick = () => { fresh = false; window.frames.push(now()); requestAnimationFrame(tick); };
requestAnimationFrame(tick);
window.addEventListener("pointermove", () => { if (!window.moved) window.moved = performance.now(); }, true);
"""


def many(folder: Path, count: int) -> None:
    """An image of squashes side by side, and its scene."""
    squash = Image.open(cli.demos()["squash"].parent / "squash.jpg")
    across = int(np.ceil(np.sqrt(count)))
    size = TILE if count > 1 else np.array(squash.size)
    small = squash.resize(tuple(map(int, size)), Image.Resampling.LANCZOS)
    picture = Image.new("RGB", (across * int(size[0]), -(-count // across) * int(size[1])))
    lines = ['[[view]]\nimage = "many.png"']
    for k in range(count):
        corner = np.array([k % across, k // across]) * size
        picture.paste(small, tuple(map(int, corner)))
        spine = (SPINE * size / squash.size + corner).round(1).tolist()
        lines.append(f'[[object]]\nname = "squash {k}"\nspine = {spine}')
    picture.save(folder / "many.png")
    (folder / "many.toml").write_text("\n\n".join(lines) + "\n")


def updates(hand: Hand) -> tuple[float, float, float]:
    """Updates and frames of the page and iterations of a model a second, from its start until the models are at rest."""
    engine, best = hand.studio.engine, (0.0, 0.0, 0.0)
    for _ in range(RUNS):
        engine.reset().result(120)
        time.sleep(1.0)
        hand.page.evaluate("window.uploads = []; window.frames = []")
        engine.run().result(120)
        began = time.time()
        while engine.going() and time.time() < began + SECONDS:
            time.sleep(0.002)
        end = time.time()
        iterations = float(np.mean([s.iteration for s in engine.snapshots.values()]))
        time.sleep(0.5)
        logs = hand.page.evaluate("[window.uploads, window.frames]")
        counts = [sum(began <= t / 1000 <= end for t in log) for log in logs]
        found = tuple(count / (end - began) for count in (*counts, iterations))
        best = max(best, found)
    return best


def answers(hand: Hand, session: Session) -> tuple[float, float]:
    """Median and least milliseconds from a movement of the mouse to the model's answer, a model at rest being held."""
    hand.press("Run")
    hand.at_rest()
    hand.press("Pull")
    hand.wait(lambda: hand.studio.page.tool == "Pull")
    snapshot = hand.studio.engine.snapshots[1]
    edge = session.view.camera.project(snapshot.tube[6, 12])
    hand.drag(edge, edge + np.array([4.0, -4.0]), 5)
    times = []
    for k in range(MOVES):
        hand.wait(lambda: not hand.studio.engine.going(), 60)
        hand.wait(lambda: hand.page.evaluate("performance.now() - window.last > 500"), 60)  # else an older one's answer
        hand.page.evaluate("window.moved = 0; window.answer = 0")
        x, y = hand.at(edge + np.array([4.0, -4.0 if k % 2 else -10.0]))
        hand.page.mouse.move(x, y)
        hand.wait(lambda: hand.page.evaluate("window.answer"), 20)
        times.append(hand.page.evaluate("window.answer"))
    hand.let_go()
    return float(np.median(times)), min(times)


def measure(quick: bool) -> Headed:
    """The table."""
    table = [["models", "updates/s", "frames/s", "iterations/s each", "mouse to answer, ms", "least"]]
    for count in MODELS[: 2 if quick else 3]:
        with tempfile.TemporaryDirectory() as name:
            many(Path(name), count)
            with opened(["many.toml"], Path(name), script=COUNT) as hand:
                session = hand.studio.page.session
                assert session is not None
                hand.wait(lambda count=count: len(hand.studio.engine.snapshots) == count, 120)
                rates, answer = updates(hand), answers(hand, session)
        table.append([str(count), *(f"{r:.0f}" for r in (*rates, *answer))])
    return [("updates of the page, best of five; the mouse's spring, median of fifteen movements", table)]


def run(quick: bool) -> Callable[[bool], str]:
    """Measures, and returns what writes the report."""
    if chromium() is None:
        return lambda markdown: "no Chromium here: as root, apt-get install chromium\n"
    tables = measure(quick)
    return lambda markdown: headed(tables, machine(), markdown)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs it from the command line."""
    return command(arguments, "studio", "The studio's speed on the page.", "without 43 models", run)


if __name__ == "__main__":
    sys.exit(main())
