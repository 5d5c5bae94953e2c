"""Writing files so that a run that fails leaves an earlier good file as it was."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Gives a fresh path beside `path` to write to, and renames what was written there to `path` at the end.

    Whoever looks at `path` sees the old file or the whole new one, never part of it. If the block raises, what it
    wrote is removed and `path` is left alone. Missing parent folders are made.

    Args:
        path: Where the finished file goes.

    Yields:
        A path in the same folder and with the same suffix, since writers choose their format by it.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    aside = target.with_name(f".{target.stem}.{os.getpid()}-{secrets.token_hex(4)}{target.suffix}")
    try:
        yield aside
        os.replace(aside, target)
    finally:
        aside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Writes `text` as UTF-8 to `path`, whole or not at all."""
    with atomic_path(path) as aside:
        aside.write_text(text, encoding="utf-8")
