"""`--set KEY=VALUE`: keys of a scene file changed from outside, before it is checked."""

from __future__ import annotations

import tomllib
from typing import Any

from .checks import SceneError


def apply(data: dict[str, Any], text: str, source: str) -> None:
    """Set one dotted key in `data`, in all tables of a list unless an index or a name picks one.

    Raises:
        SceneError: `text` is not KEY=VALUE, or leads nowhere.
    """
    key, equals, value = text.partition("=")
    field_name = f"--set {text}"
    if not equals or not all(key.strip().split(".")):
        raise SceneError(source, field_name, "is not KEY=VALUE", "write a dotted key, like solver.scheme=euler")
    try:
        parsed = tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()  # text without quotes
    *parents, last = key.strip().split(".")
    places: list[Any] = [data]
    for part in parents:
        found: list[Any] = []
        for place in places:
            if isinstance(place, list):
                picked = [t for i, t in enumerate(place) if part in (str(i), t.get("name") if isinstance(t, dict) else None)]
                found += picked or [t.setdefault(part, {}) for t in place if isinstance(t, dict) and not part.isdigit()]
            elif isinstance(place, dict):
                found.append(place.setdefault(part, {}))
        places = found
    tables = [t for place in places for t in (place if isinstance(place, list) else [place])]
    if not tables or not all(isinstance(t, dict) for t in tables):
        raise SceneError(
            source,
            field_name,
            f"there is nothing called {'.'.join(parents)}",
            "name a table of the scene file",
        )
    for table in tables:
        table[last] = parsed
