"""The blending curve that flickers least, and how it depends on head and refresh rate.

First `hmdjit fit` as it is: Kim et al.'s constants fitted anew, as little flicker as
possible at the detail loss of their own. Then the same for refresh rates and heads,
with fewer scenes and sessions. Writes `fitted_curves.md`, and the first curve and its
pictures beside it. Further options are those of `hmdjit fit`, and hold for all fits.

    python examples/fitted_curves.py --rates 60 90 --heads fixating seated
"""

import contextlib
import io
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import pages

import hmdjit as hj
from hmdjit.cli.main import run

HEADS = ("fixating", "seated", "free_viewing", "tracker_noise")
RATES_HZ = (60.0, 72.0, 90.0, 120.0)
FEWER = ["--scenes", "coffee", "grass", "rocket", "text", "--sessions", "32"]
FEWER += ["--held-out", "none"]
NAMES = {  # in a curve's file and in the tables
    "w_min": "w_min",
    "w_lb": "w_lb",
    "h_max_deg_s": "h_max, deg/s",
    "closeness[0]": "d (closeness)",
}


def fit(*options: str, out: Path) -> tuple[dict[str, Any] | None, str]:
    """Fit a curve; its file, None where no curve was found, and what was said."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = run(["fit", *options, "--out", str(out)])
    text = said.getvalue()
    print(text, file=sys.stderr)
    if code:
        return None, text.splitlines()[-1]
    return tomllib.loads(out.read_text(encoding="utf-8")), text


def short(number: float) -> str:
    """Two digits, or all of a large number's."""
    return f"{number:.0f}" if abs(number) >= 10 else f"{number:.2g}"


def numbers(curve: dict[str, Any], digits: str = "") -> list[tuple[str, str]]:
    """Return each number of a curve and its interval, in the order of `NAMES`."""
    write = short if not digits else lambda number: format(number, digits)
    values, bounds = curve["head_movement"], curve["fit"]["interval_95"]
    values = values | {"closeness[0]": values["closeness"][0]}
    return [
        (write(values[name]), "[{}, {}]".format(*map(write, bounds[name])))
        for name in NAMES
    ]


def first_table(curve: dict[str, Any]) -> str:
    """Lay out a fitted curve beside Kim et al.'s constants."""
    kim = hj.techniques.HeadMovement()
    theirs = [kim.w_min, kim.w_lb, kim.h_max_deg_s, kim.closeness[0]]
    rows = [
        (name, *cells, f"{float(their):.3g}")
        for name, cells, their in zip(
            NAMES.values(), numbers(curve, ".3g"), theirs, strict=True
        )
    ]
    head = ("", "fitted", "95 % (bootstrap over sessions)", "Kim et al.")
    return pages.table(head, rows)


def sentences(said: str) -> str:
    """Pick what `hmdjit fit` says about held-out sessions and scenes."""
    found, where = [], ""
    for line in said.splitlines():
        if line.startswith("Held-out"):
            where = f"{line} "
        elif line.startswith(
            ("At equal detail loss", "Than Kim", "The front does not")
        ):
            found.append(f"- {where}{line}")
    return "\n".join(found)


def row(name: str, options: Sequence[str]) -> list[str]:
    """Fit a curve for a head and a rate, as a row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        curve, said = fit(*options, out=Path(folder) / "curve.toml")
    if curve is None:
        return [name, said, *[""] * len(NAMES)]
    gain = curve["fit"].get("gain_at_equal_detail_percent")
    less = "not known" if gain is None else "{mean:.1f} [{low:.1f}, {high:.1f}]"
    cells = [" ".join(both) for both in numbers(curve)]
    return [name, *cells, less.format_map(gain or {})]


def main() -> None:
    """Fit them all, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--heads", nargs="+", default=HEADS)
    parser.add_argument("--rates", nargs="+", type=float, default=RATES_HZ)
    options, further = parser.parse_known_args()
    jax.config.update("jax_num_cpu_devices", 2)
    curve, said = fit(*further, out=options.out.with_suffix(".toml"))
    if curve is None:
        sys.exit(said)
    cases = dict.fromkeys(
        [(options.heads[0], rate) for rate in options.rates]
        + [(head, options.rates[0]) for head in options.heads]
    )
    rows = [
        row(
            f"{head}, {rate:g} Hz",
            ["--head", head, "--refresh", str(rate), *(further or FEWER)],
        )
        for head, rate in cases
    ]
    blocks = {
        "fitted": first_table(curve),
        "gain": sentences(said),
        "heads": pages.table(["head", *NAMES.values(), "less flicker, %"], rows),
    }
    pages.write(__file__, blocks, options.out)


if __name__ == "__main__":
    main()
