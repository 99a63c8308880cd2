"""Seconds against bias for every knob of fidelity, on this machine.

Runs `hmdjit trade-off`, which leaves its CSV and its picture beside the page, and
writes `trade_off.md`. Further options are those of `hmdjit trade-off`.

    python examples/trade_off.py
"""

import os
import sys

import jax
import pages

from hmdjit.cli.main import run
from hmdjit.estimates.intervals import Z95
from hmdjit.trade_off import trade_off


def cells(row: trade_off.Row, is_on_front: bool) -> list[str]:
    """Say what a setting costs, and how far off it is; bold on the front."""
    name = row.setting if row.technique == "head_movement" else row.technique
    name += " †" * row.is_other_device
    bias, error = (100 * x / row.reference_mtcd for x in (row.bias, Z95 * row.bias_se))
    return [
        f"**{name}**" if is_on_front else name,
        f"{bias:+.2f} ± {error:.2f}",
        f"{1e3 * row.s_per_session:.2g}",
        f"{row.seconds_to(0.01):.2g}",
    ]


def main() -> None:
    """Measure, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    options, further = parser.parse_known_args()
    jax.config.update("jax_num_cpu_devices", min(os.cpu_count() or 1, 2))
    if code := run(["trade-off", *further, "--out", str(options.out.parent)]):
        sys.exit(code)
    rows = trade_off.read_csv(options.out.with_name("trade_off.csv"))
    blended = [row for row in rows if row.technique == "head_movement"]
    others = [row for row in rows if row not in blended and row.knob == "technique"]
    front = trade_off.front_of(blended)
    head = ("setting", "bias of MTCD, %", "ms per session", "s to 1 %")
    table = pages.table(head, [cells(row, row in front) for row in blended + others])
    pages.write(__file__, {"settings": table}, options.out)


if __name__ == "__main__":
    main()
