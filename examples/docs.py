"""Render the documentation: the guide, a page per technique, and the whole API.

pdoc renders docstrings and the pages of `examples/guide/`; the facts and the numbers of
techniques come from their classes and from `techniques.md`. Needs `hmdjit[docs,study]`.

    python examples/docs.py --out docs-build
"""

import argparse
import dataclasses
import inspect
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hmdjit as hj

FOLDER = Path(__file__).parent
GUIDE = ("concepts", "units", "how_sure")
"""Pages of `guide/`, in their order."""


def measured() -> tuple[list[str], dict[str, list[str]]]:
    """Head of the table of `techniques.md`, and its rows by id."""
    text = (FOLDER / "techniques.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- techniques -->\n\n(.*?)\n\n<!-- end -->", text, re.S)
    lines = [line.strip("| ").split(" | ") for line in table.splitlines()]
    return lines[0], {line[0].strip("`"): line for line in lines[2:]}


def techniques() -> Iterator[tuple[str, str]]:
    """Name and page of each family of techniques."""
    families: dict[type, list[hj.techniques.AbstractTechnique]] = {}
    for id in hj.techniques.IDS:
        technique = hj.techniques.by_id(id)
        families.setdefault(type(technique), []).append(technique)
    head, rows = measured()
    for kind, members in families.items():
        first = members[0]
        parameters = [
            f"- `{field.name}`: {getattr(first, field.name)!r}"
            for field in dataclasses.fields(kind)
        ]
        known = [rows[one.id] for one in members if one.id in rows]
        lines = [
            f"# {kind.__name__}",
            inspect.cleandoc(kind.__doc__ or ""),
            f"**Ids:** {', '.join(f'`{one.id}`' for one in members)}.",
            f"**Needs:** {', '.join(sorted(first.needs))}; "
            f"{first.sample_offsets_px.shape[1]} samples per pixel and frame.",
            "**Parameters** of the first id:\n\n" + "\n".join(parameters or ["none"]),
        ]
        if known:
            table = [head, ["---"] * len(head), *known]
            told = "\n".join(f"| {' | '.join(row)} |" for row in table)
            lines.append(
                f"**What it costs, removes and keeps** in the study:\n\n{told}"
            )
        yield kind.__name__.lower(), "\n\n".join(lines) + "\n"


def write(folder: Path) -> list[str]:
    """Write the pages as modules that have a docstring alone; return their names."""
    pages = {n: (FOLDER / "guide" / f"{n}.md").read_text("utf-8") for n in GUIDE}
    pages |= dict(techniques())
    guide = folder / "guide"
    guide.mkdir()
    first = "# Guide to hmdjit\n\nConcepts, units, how sure numbers are; techniques.\n"
    for name, text in {"__init__": first, **pages}.items():
        (guide / f"{name}.py").write_text(f"{text!r}\n", encoding="utf-8")
    return [f"guide.{name}" for name in pages]


def main() -> None:
    """Render all to a folder."""
    import pdoc
    import pdoc.render

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs-build"))
    parser.add_argument("--guide", action="store_true", help="without the API")
    options = parser.parse_args()
    pdoc.render.configure(docformat="markdown", search=not options.guide)
    with tempfile.TemporaryDirectory() as name:
        sys.path.insert(0, name)
        write(Path(name))
        wanted = ["guide"] if options.guide else ["guide", "hmdjit"]
        pdoc.pdoc(*wanted, output_directory=options.out)
    for picture in FOLDER.glob("*.png"):
        shutil.copy(picture, options.out)
    print(f"Wrote {options.out / 'index.html'}.")


if __name__ == "__main__":
    main()
