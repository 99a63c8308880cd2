"""How far a command is: a bar on a terminal, a line now and then elsewhere."""

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import rich.console
import rich.progress

from ..studies.progress import Progress

_SECONDS_BETWEEN_LINES = 10.0


@contextlib.contextmanager
def resumable(kept: str = "batches") -> Iterator[None]:
    """Say how to go on, of what is interrupted within it."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; finished {kept} are kept: run the same command to go on."
        ) from None


class Display:
    """Shows the progress of whatever runs within it."""

    def __init__(self, console: rich.console.Console):
        self._console, self._start = console, time.monotonic()
        self._last_line = -_SECONDS_BETWEEN_LINES
        self._bar = rich.progress.Progress(
            rich.progress.BarColumn(bar_width=30),
            rich.progress.TextColumn("{task.description}", markup=False),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("preparing", total=None)

    def __enter__(self) -> "Display":
        self._bar.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._bar.__exit__(*exception)

    def __call__(self, event: Progress) -> None:
        """Show an event; print its line, if it has one."""
        if event.line:
            self._console.out(event.line)
        seconds = time.monotonic() - self._start
        words = (
            [f"{event.done:,} of {event.total:,} {event.unit}"] if event.total else []
        )
        if event.fresh:
            speed = event.fresh / seconds
            words.append(f"{speed:,.0f} {event.unit}/s")
            words.append(f"{(event.total - event.done) / speed:,.0f} s left")
        words = f"{seconds:5.0f} s  {', '.join([*words, event.doing])}"
        total = event.total or None
        self._bar.update(
            self._task, completed=event.done, total=total, description=words
        )
        is_due = seconds - self._last_line > _SECONDS_BETWEEN_LINES
        if not self._console.is_terminal and is_due:
            self._last_line = seconds
            self._console.out(words)
