"""Pages of numbers: their text is written by hand, their tables by a command.

A page lies beside the script that fills it, under the same name. What stands between
`<!-- name -->` and `<!-- end -->` is replaced by what the script measured, and the
first line by the command, the versions and the machine that measured it.

Makes the pages and pictures whose numbers are of another model than today's, which
wants an idle machine for an hour or two; or names them. Traces are those of `heads.py`.

    python examples/pages.py --traces FOLDER
    python examples/pages.py --check heads trade_off
"""

import argparse
import contextlib
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import jax
import PIL.Image

from hmdjit.cli.main import run
from hmdjit.studies.identity import made_by

FOLDER = Path(__file__).parent
STUDY = "default_study_ratios.png"
"""Picture of `hmdjit study` as it is."""
SCENES = "scenes.png"
"""Picture of `contact_sheet.py`."""
OF_THE_MODEL = (
    "all_techniques",
    "dynamic_regions",
    "fitted_curves",
    "ghosting",
    "heads",
    "reproductions",
    "sensitivities",
    "static_edges",
)
OF_THE_MODEL += ("techniques", "time_to_one_percent", "trade_off")
"""Pages whose numbers another model changes; others tell errors and speed."""

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


def filled(page: str, blocks: Mapping[str, str], *, some: bool = False) -> str:
    """Replace the blocks of a page, or `some` of them.

    **Errors:** `ValueError` unless the blocks are those that the page has.
    """
    names = {found[1] for found in _BLOCK.finditer(page)}
    if not names >= set(blocks) or (names != set(blocks) and not some):
        raise ValueError(f"blocks must be {sorted(names)}, got {list(blocks)}.")

    def fill(found: re.Match) -> str:
        name = found[1]
        if name not in blocks:
            return found[0]
        return f"<!-- {name} -->\n\n{blocks[name]}\n\n<!-- end -->"

    return _BLOCK.sub(fill, page)


def write(
    script: str, blocks: Mapping[str, str], out: Path, *, is_measured: bool = True
) -> None:
    """Fill the page of a script, and write it to a file.

    **Arguments:** `is_measured`: on this machine, now; else its name is left out.

    **Errors:** `ValueError` unless the blocks are those that the page has.
    """
    page = Path(script).with_suffix(".md").read_text(encoding="utf-8")
    text = filled(page, blocks)
    # Where a folder lies on this machine tells nobody anything.
    words = [Path(w).name if os.path.isabs(w) else w for w in sys.argv[1:]]
    command = shlex.join(["python", f"examples/{Path(script).name}", *words])
    made = f"*Made by `{command}`: {made_by()}"
    if is_measured:
        made += f", JAX {jax.__version__}, {processor()}, {os.cpu_count()} cores"
    out.write_text(f"{made}.*\n" + text.partition("\n")[2], encoding="utf-8")
    print(f"Wrote {out}.")


def is_old(file: Path) -> bool:
    """Whether a page or a picture is of another version or model than today's."""
    if file.suffix == ".md":
        line = file.read_text(encoding="utf-8").partition("\n")[0]
        return f": {made_by()}" not in line
    with PIL.Image.open(file) as picture:
        return picture.info.get("Source") != made_by()


def old(folder: Path) -> list[str]:
    """Name the pages and the pictures beside them that are to be made again."""
    files = [
        file for name in OF_THE_MODEL for file in folder.glob(f"{name}*.[mp][dn]*")
    ]
    return sorted(
        file.name for file in (folder / STUDY, folder / SCENES, *files) if is_old(file)
    )


def main() -> None:
    """Make what is old, or name it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="how their names begin (default: all)")
    parser.add_argument("--check", action="store_true", help="name them, make none")
    parser.add_argument("--traces", help="folder of SET_PERSON_*.csv, for `heads.py`")
    options = parser.parse_args()
    names = tuple(options.names) or ""
    found = [file for file in old(FOLDER) if file.startswith(names)]
    if options.check:
        sys.exit(f"not of {made_by()}: {', '.join(found)}" if found else 0)
    if STUDY in found:
        with tempfile.TemporaryDirectory() as folder:
            if code := run(["study", "--out", folder]):
                sys.exit(code)
            shutil.copy(Path(folder) / "ratios.png", FOLDER / STUDY)
    if SCENES in found:
        subprocess.run([sys.executable, str(FOLDER / "contact_sheet.py")], check=True)
    for name in OF_THE_MODEL:
        if any(file.startswith(name) for file in found):
            command = [sys.executable, str(FOLDER / f"{name}.py")]
            if name == "heads":
                command += ["--traces", options.traces or parser.error("name --traces")]
                command += ["--scenes", "coffee", "grass", "text", "noise"]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
