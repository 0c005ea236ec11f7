"""Warp's devices, without its chatter."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from .checks import SceneError

_USERS_OWN = "warp" in sys.modules  # imported before us: its settings are not ours to change
_CHATTER = "Could not find or load the NVIDIA CUDA driver"


def start_quietly() -> None:
    """Initialise Warp without a banner, and without a warning where there simply is no graphics card."""
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    ours = os.dup(2)
    with tempfile.TemporaryFile() as said:  # Warp's native part writes past sys.stderr
        os.dup2(said.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(ours, 2)
            os.close(ours)
            said.seek(0)
            lines = said.read().decode(errors="replace").splitlines(keepends=True)
            sys.stderr.writelines(line for line in lines if _CHATTER not in line)


def prepare(name: str) -> None:
    """Initialise Warp, quietly unless the caller's own script uses it, and look for a device.

    Raises:
        SceneError: there is no such device; the message lists those there are.
    """
    if not _USERS_OWN:
        start_quietly()
    import warp as wp

    try:
        wp.get_device(name)
    except (ValueError, RuntimeError):
        known = ", ".join(device.alias for device in wp.get_devices())
        raise SceneError("device", "", f"there is no {name!r}", f"this machine has {known}") from None


def cache() -> Path:
    """Folder of compiled kernels."""
    import warp as wp

    wp.init()
    return Path(str(wp.config.kernel_cache_dir))


def kernels_compiled() -> bool:
    """Whether some of our kernels lie in the cache, so that a run starts at once."""
    return any("symseek" in module.name for module in cache().iterdir())
