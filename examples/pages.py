"""Pages of numbers: their text is written by hand, their tables by a command.

A page lies beside the script that fills it, under the same name. What stands between
`<!-- name -->` and `<!-- end -->` is replaced by what the script measured, and the
first line by the command, the versions and the machine that measured it.
"""

import argparse
import contextlib
import os
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import jax

import hmdjit as hj

_BLOCK = re.compile(r"<!-- (?!end )(\w+) -->\n.*?<!-- end -->", re.S)


def arguments(script: str, about: str | None) -> argparse.ArgumentParser:
    """Start the command line of a page's script, with the page as `--out`."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    page = Path(script).with_suffix(".md")
    parser.add_argument("--out", type=Path, default=page, help="the page to write")
    return parser


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def processor() -> str:
    """Return the processor's name, where the system tells it."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def write(
    script: str, blocks: Mapping[str, str], out: Path, *, is_measured: bool = True
) -> None:
    """Fill the page of a script, and write it to a file.

    **Arguments:** `is_measured`: on this machine, now; else its name is left out.

    **Errors:** `ValueError` unless the blocks are those that the page has.
    """
    page = Path(script).with_suffix(".md").read_text(encoding="utf-8")
    names = [found[1] for found in _BLOCK.finditer(page)]
    if sorted(names) != sorted(blocks):
        raise ValueError(f"blocks must be {names}, got {list(blocks)}.")
    fill = lambda found: f"<!-- {found[1]} -->\n\n{blocks[found[1]]}\n\n<!-- end -->"
    text = _BLOCK.sub(fill, page)
    command = shlex.join(["python", f"examples/{Path(script).name}", *sys.argv[1:]])
    made = f"*Made by `{command}`: hmdjit {hj.__version__}"
    if is_measured:
        made += f", JAX {jax.__version__}, {processor()}, {os.cpu_count()} cores"
    out.write_text(f"{made}.*\n" + text.partition("\n")[2], encoding="utf-8")
    print(f"Wrote {out}.")
